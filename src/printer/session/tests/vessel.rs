//! Jobs of the slicer's own kind, small: limits in the header, retractions with z-hop, wipes, `G92 E0` at each layer, a fan that
//! changes. Written here, so that they need none of the stages before the printer.

use crate::profile::{Dialect, Profile};
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

/// Height of a layer, mm.
pub(super) const LAYER_MM: f64 = 0.2;
/// Width of a bead, mm.
pub(super) const WIDTH_MM: f64 = 0.45;
/// Way from one end of a contour's chord to the other, mm.
const CHORD_MM: f64 = 0.6;
/// Inner and outer radius of the lowest layer, mm.
const RADII_MM: [f64; 2] = [6.0, 14.0];

/// A bent ring of contours and raster, a thick one: six lifts a layer, long lines, half a minute for a layer.
pub(super) fn filled(profile: &Profile, n_layers: u32) -> String {
    written(profile, n_layers, |writer, layer| writer.filled_layer(layer))
}

/// The wall of a vessel that splits, 1 mm of it: contours of short lines, slow for want of time to cool, no lift in the trunk but
/// from layer to layer, and one between the branches.
pub(super) fn wall(profile: &Profile, n_layers: u32) -> String {
    written(profile, n_layers, |writer, layer| writer.wall_layer(layer, layer >= n_layers / 2))
}

fn written(profile: &Profile, n_layers: u32, layer: impl Fn(&mut Writer<'_>, u32)) -> String {
    let mut writer = Writer { profile, text: String::new(), at: [0.0; 2] };
    profile.start_gcode().iter().chain(&limits(profile)).for_each(|line| writer.line(line));
    (0..n_layers).for_each(|n| layer(&mut writer, n));
    let end = profile.end_gcode(LAYER_MM * f64::from(n_layers));
    end.iter().for_each(|line| writer.line(line));
    writer.text
}

/// What the slicer sets in the header, in each firmware's words.
pub(super) fn limits(profile: &Profile) -> Vec<String> {
    let lines: &[&str] = match profile.firmware.dialect {
        Dialect::Marlin => {
            &["M201 X1200 Y1100 Z90 E4000", "M203 X300 Y300 Z9 E50", "M204 P900 R2500 T1300", "M205 J0.02"]
        }
        Dialect::Marlin1 => &[
            "M201 X1200 Y1100 Z90 E4000",
            "M203 X300 Y300 Z9 E50",
            "M204 P900 R2500 T1300",
            "M205 X7 Y7 Z0.3 E4",
        ],
        Dialect::RepRapFirmware => &[
            "M201 X1200 Y1100 Z90 E4000",
            "M203 X18000 Y18000 Z540 E3000",
            "M204 P900 T1300",
            "M566 X500 Y500 Z30 E300",
        ],
        Dialect::Klipper => &["SET_VELOCITY_LIMIT VELOCITY=280 ACCEL=2500 SQUARE_CORNER_VELOCITY=4"],
        Dialect::Repetier => &["M201 X900 Y900 Z90 E3500", "M202 X1300 Y1300 Z90 E3500", "M207 X18 Z0.3 E18"],
        Dialect::Smoothie => &["M203 X280 Y280 Z8", "M204 S1800 Z90", "M205 X0.04"],
    };
    lines.iter().map(|line| (*line).to_owned()).collect()
}

/// A closed contour: nearly a circle, but no place of it is like another.
struct Loop {
    centre: [f64; 2],
    radius: f64,
    /// Way from one end of a chord to the other, mm.
    chord_mm: f64,
    mm_min: u32,
}

impl Loop {
    /// Chords.
    fn n(&self) -> f64 {
        (TAU * self.radius / self.chord_mm).ceil()
    }

    fn point(&self, i: f64) -> [f64; 2] {
        let angle = TAU * i / self.n();
        let r = (0.1 * self.radius.min(1.0)).mul_add((3.0 * angle).cos(), self.radius);
        [r.mul_add(angle.cos(), self.centre[0]), r.mul_add(angle.sin(), self.centre[1])]
    }
}

struct Writer<'a> {
    profile: &'a Profile,
    text: String,
    at: [f64; 2],
}

impl Writer<'_> {
    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// Gives its height, mm, and where its middle is.
    fn begin_layer(&mut self, layer: u32) -> (f64, [f64; 2]) {
        let z_mm = LAYER_MM * f64::from(layer + 1);
        self.line(&format!(";LAYER:{layer}\n;Z:{z_mm:.3}\n;HEIGHT:{LAYER_MM:.3}"));
        self.line("G92 E0");
        if layer > 0 {
            self.line(&format!("M106 S{}", 100 + 10 * layer));
        }
        (z_mm, [0.15_f64.mul_add(f64::from(layer), 100.0), 0.1_f64.mul_add(f64::from(layer), 90.0)])
    }

    fn wall_layer(&mut self, layer: u32, is_split: bool) {
        let (z_mm, centre) = self.begin_layer(layer);
        self.line(&format!("G0 Z{z_mm:.3} F600"));
        let branches: &[(f64, f64)] = if is_split { &[(-4.0, 2.2), (3.5, 1.8)] } else { &[(0.0, 3.2)] };
        for (i, (x_mm, lumen_mm)) in branches.iter().enumerate() {
            let centre = [centre[0] + x_mm, centre[1]];
            for (n, kind) in [(0.0, "External perimeter"), (2.0, "External perimeter"), (1.0, "Perimeter")] {
                self.line(&format!(";TYPE:{kind}"));
                let loop_of =
                    Loop { centre, radius: WIDTH_MM.mul_add(n, *lumen_mm), chord_mm: 0.25, mm_min: 600 };
                // Through material there is no need to draw the filament back.
                if n == 0.0 && i > 0 {
                    self.travel(loop_of.point(0.0), z_mm);
                } else {
                    self.go(loop_of.point(0.0), "F9000");
                }
                self.closed(&loop_of);
            }
        }
    }

    fn filled_layer(&mut self, layer: u32) {
        let (z_mm, centre) = self.begin_layer(layer);
        let [inner, outer] = RADII_MM.map(|r| r - 0.02 * f64::from(layer));
        for (radius, kind) in [(outer, "External perimeter"), (inner, "Perimeter")] {
            self.line(&format!(";TYPE:{kind}"));
            let contour = Loop { centre, radius, chord_mm: CHORD_MM, mm_min: 1800 };
            self.travel(contour.point(0.0), z_mm);
            self.closed(&contour);
        }
        self.line(";TYPE:Solid infill");
        self.raster(centre, [inner + WIDTH_MM, outer - WIDTH_MM], z_mm);
    }

    fn closed(&mut self, contour: &Loop) {
        let mut i = 1.0;
        while i <= contour.n() {
            self.bead(contour.point(i), contour.mm_min);
            i += 1.0;
        }
    }

    /// Parallel lines between the contours: above the lumen, left and right of it, below; each region without a break.
    fn raster(&mut self, centre: [f64; 2], [inner, outer]: [f64; 2], z_mm: f64) {
        let half = |r: f64, y: f64| (r * r - y * y).max(0.0).sqrt();
        let spans: [fn(f64, f64) -> [f64; 2]; 3] = [|_, o| [-o, o], |i, o| [-o, -i], |i, o| [i, o]];
        for (span, [from, to]) in [
            (spans[0], [-outer + 0.3, -inner]),
            (spans[1], [-inner, inner]),
            (spans[2], [-inner, inner]),
            (spans[0], [inner, outer - 0.3]),
        ] {
            let mut y = from;
            let mut is_back = false;
            let mut is_first = true;
            while y < to {
                let mut ends = span(half(inner, y), half(outer, y)).map(|x| [centre[0] + x, centre[1] + y]);
                if is_back {
                    ends.reverse();
                }
                if is_first {
                    self.travel(ends[0], z_mm);
                } else {
                    self.bead(ends[0], 2700);
                }
                self.bead(ends[1], 2700);
                (is_first, is_back) = (false, !is_back);
                y += WIDTH_MM;
            }
        }
    }

    /// Retracted and lifted; the first line of all goes straight there.
    fn travel(&mut self, to: [f64; 2], z_mm: f64) {
        let print = &self.profile.print;
        let (retract_mm, hop_mm, mm_s) = (print.retract_mm, print.z_hop_mm, print.retract_mm_s);
        if self.at == [0.0; 2] {
            self.line(&format!("G0 Z{z_mm:.3} F600"));
            self.go(to, "F9000");
            return;
        }
        self.line(&format!("G1 E-{retract_mm:.5} F{:.0}", 60.0 * mm_s));
        self.line(&format!("G0 Z{:.3} F600", z_mm + hop_mm));
        self.go(to, "F9000");
        self.line(&format!("G0 Z{z_mm:.3} F600"));
        self.line(&format!("G1 E{retract_mm:.5} F{:.0}", 60.0 * mm_s));
    }

    fn go(&mut self, to: [f64; 2], feedrate: &str) {
        self.line(&format!("G0 X{:.3} Y{:.3} {feedrate}", to[0], to[1]));
        self.at = to;
    }

    fn bead(&mut self, to: [f64; 2], mm_min: u32) {
        let length_mm = (to[0] - self.at[0]).hypot(to[1] - self.at[1]);
        let filament_mm2 = PI / 4.0 * self.profile.machine.filament_mm.powi(2);
        let e_mm = length_mm * WIDTH_MM * LAYER_MM / filament_mm2;
        writeln!(self.text, "G1 X{:.3} Y{:.3} E{e_mm:.5} F{mm_min}", to[0], to[1]).unwrap();
        self.at = to;
    }
}
