//! A job of rings, one on the other.

use std::fmt::Write;

/// How many, of how many sides each, and how much filament a side takes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rings {
    pub(crate) n_layers: u32,
    pub(crate) n_sides: u32,
    pub(crate) filament_mm: f64,
}

/// Its G-code between a beginning and an end.
pub(crate) fn job(start: &[String], rings: Rings, end: &[String]) -> String {
    job_around([100.0, 100.0], 10.0, start, rings, end)
}

/// The same, around this place, mm, with this radius, mm.
pub(crate) fn job_around(
    centre_mm: [f64; 2],
    radius_mm: f64,
    start: &[String],
    rings: Rings,
    end: &[String],
) -> String {
    let [x0_mm, y0_mm] = centre_mm;
    let mut text = start.join("\n");
    for layer in 0..rings.n_layers {
        let z_mm = 0.2 * f64::from(layer + 1);
        write!(
            text,
            "\n;LAYER:{layer}\nG1 Z{z_mm:.3} F600\nG0 X{:.3} Y{y0_mm:.3} F9000\nG1 F1800",
            x0_mm + radius_mm
        )
        .unwrap();
        for side in 1..=rings.n_sides {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(rings.n_sides);
            let (x_mm, y_mm) = (radius_mm.mul_add(angle.cos(), x0_mm), radius_mm.mul_add(angle.sin(), y0_mm));
            write!(text, "\nG1 X{x_mm:.3} Y{y_mm:.3} E{}", rings.filament_mm).unwrap();
        }
    }
    text + "\n" + &end.join("\n") + "\n"
}
