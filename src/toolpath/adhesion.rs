//! Loops around the first layer: a brim that holds the part down, a skirt that primes the nozzle.

use super::fill::{FillParams, Path, Role, Vertex};
use super::{BeadKind, simplify};
use crate::ct::Warning;
use crate::geom::{Contour, Region};
use crate::profile::Profile;

/// Chord tolerance of the loops, mm: they are no part of the print.
const TOLERANCE_MM: f64 = 0.01;

/// Skirt and brim around the material of the first layer, from the outside inward. What would leave the
/// bed is left out, and said so.
pub(super) fn loops(
    material: &Region,
    profile: &Profile,
    params: &FillParams,
) -> (Vec<Path>, Option<Warning>) {
    let print = &profile.print;
    let pitch = params.pitch_mm();
    let outlines = material.contours.iter().filter(|c| c.is_ccw()).cloned().collect();
    let outline = Region::union_all([&Region::new(outlines)]);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative: validated")]
    let n_brim = (print.brim_mm / pitch).round() as usize;
    let brim = (0..n_brim).map(|i| (i as f64 + 0.5) * pitch);
    let skirt_begin = n_brim as f64 * pitch + print.skirt_distance_mm;
    let skirt = (0..print.skirt_loops).map(|i| skirt_begin + (f64::from(i) + 0.5) * pitch);
    let mut distances: Vec<f64> = brim.chain(skirt).collect();
    distances.reverse();
    let mut paths = Vec::new();
    let mut n_left_out = 0;
    for distance in distances {
        let grown = outline.offset(distance, TOLERANCE_MM);
        if inside_bed(&grown, profile, params.width_mm) {
            let outer = grown.contours.iter().filter(|c| c.is_ccw());
            paths.extend(outer.map(|c| path(c, params.width_mm)));
        } else {
            n_left_out += 1;
        }
    }
    let warning = (n_left_out > 0).then(|| {
        Warning::new(
            "toolpath.adhesion_outside_bed",
            format!("{n_left_out} loops of skirt or brim would leave the bed and are left out"),
        )
    });
    (paths, warning)
}

fn path(contour: &Contour, width_mm: f64) -> Path {
    let contour = simplify::contour(contour, TOLERANCE_MM);
    let vertices = contour.points.iter().map(|&at| Vertex { at, width_mm, room_mm: 0.0 }).collect();
    Path { kind: BeadKind::SkirtBrim, role: Role::Outer, closed: true, vertices }
}

fn inside_bed(region: &Region, profile: &Profile, width_mm: f64) -> bool {
    let [x, y, _] = profile.machine.bed_mm;
    region.bounds().is_none_or(|b| {
        let b = b.grown(width_mm / 2.0);
        b.min.x >= 0.0 && b.min.y >= 0.0 && b.max.x <= x && b.max.y <= y
    })
}
