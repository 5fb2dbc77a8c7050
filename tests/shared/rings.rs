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
    let mut text = start.join("\n");
    for layer in 0..rings.n_layers {
        let z_mm = 0.2 * f64::from(layer + 1);
        write!(text, "\n;LAYER:{layer}\nG1 Z{z_mm:.3} F600\nG0 X110.000 Y100.000 F9000\nG1 F1800").unwrap();
        for side in 1..=rings.n_sides {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(rings.n_sides);
            let (x_mm, y_mm) = (10.0_f64.mul_add(angle.cos(), 100.0), 10.0_f64.mul_add(angle.sin(), 100.0));
            write!(text, "\nG1 X{x_mm:.3} Y{y_mm:.3} E{}", rings.filament_mm).unwrap();
        }
    }
    text + "\n" + &end.join("\n") + "\n"
}
