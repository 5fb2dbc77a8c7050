//! Loops around the first layer: a brim that holds the part down, a skirt that primes the nozzle.

use super::fill::{FillParams, Path, Role, Vertex};
use super::travel::Travel;
use super::{Bead, BeadKind, sequence, simplify};
use crate::ct::Warning;
use crate::geom::{Contour, Region};
use crate::profile::Profile;

/// Chord tolerance of the loops, mm: they are no part of the print.
const TOLERANCE_MM: f64 = 0.01;

/// No brim for steadiness is wider than this, mm: a part that needs more wants a raft or a wider base.
const MOST_BRIM_MM: f64 = 10.0;

/// Skirt and brim of the first layer, from the outside inward: the brim follows the outlines of the part and of the supports
/// beside it, as those of one thing, and the skirt runs round the convex hull of all. What would leave the bed is left out, and
/// said so.
pub(super) fn loops(
    material: &Region,
    supports: &Region,
    height_mm: f64,
    profile: &Profile,
    params: &FillParams,
) -> (Vec<Path>, Option<Warning>) {
    let outline = outline(material, supports, params.width_mm.max(profile.print.support_gap_mm));
    around(&outline, n_brim(material, height_mm, profile, params), profile, params)
}

/// The skirt round a raft, which holds down by itself; what would leave the bed is left out, and said so.
pub(super) fn skirt(raft: &Region, profile: &Profile, params: &FillParams) -> (Vec<Path>, Option<Warning>) {
    around(raft, 0, profile, params)
}

/// Loops that are laid as they are, each from its first vertex round to it.
pub(super) fn laid(loops: &[Path]) -> (Vec<Bead>, Vec<Travel>) {
    let bead = |path: &Path| {
        let mut vertices = path.vertices.clone();
        vertices.push(vertices[0]);
        Bead { kind: path.kind, points: sequence::bead_points(&vertices) }
    };
    let travel = Travel { via: Vec::new(), leaves_material: true };
    (loops.iter().map(bead).collect(), vec![travel; loops.len()])
}

/// So many loops of brim round an outline, and the skirt round its convex hull beyond them.
fn around(
    outline: &Region,
    n_brim: usize,
    profile: &Profile,
    params: &FillParams,
) -> (Vec<Path>, Option<Warning>) {
    let print = &profile.print;
    let pitch = params.pitch_mm();
    let hull = outline.convex_hull();
    let brim = (0..n_brim).map(|i| (outline, (i as f64 + 0.5) * pitch));
    let skirt_begin = n_brim as f64 * pitch + print.skirt_distance_mm;
    let skirt = (0..print.skirt_loops).map(|i| (&hull, skirt_begin + (f64::from(i) + 0.5) * pitch));
    let mut loops: Vec<(&Region, f64)> = brim.chain(skirt).collect();
    loops.reverse();
    let mut paths = Vec::new();
    let mut n_left_out = 0;
    for (around, distance) in loops {
        let grown = around.offset(distance, TOLERANCE_MM);
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

/// The outlines of what stands on the bed, without holes; clefts between part and supports in which no loop has room, or which
/// the supports' air is, are closed.
fn outline(material: &Region, supports: &Region, cleft_mm: f64) -> Region {
    let part = material.without_holes();
    if supports.is_empty() {
        return part;
    }
    let both = Region::union_all([&part, supports]);
    let closed = both.offset(cleft_mm, TOLERANCE_MM).offset(-cleft_mm, TOLERANCE_MM);
    closed.union(&both).without_holes()
}

/// Loops of brim around a part so high.
pub(super) fn n_brim(material: &Region, height_mm: f64, profile: &Profile, params: &FillParams) -> usize {
    let print = &profile.print;
    let brim_mm = print.brim_mm.max(steadying_brim_mm(material, height_mm, print.brim_slenderness));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative: validated")]
    let n_brim = (brim_mm / params.pitch_mm()).round() as usize;
    n_brim
}

/// The brim that a part needs so that it stands on no less than its height by the slenderness, mm: what pushes at its top turns
/// it over the edge of what it stands on.
fn steadying_brim_mm(material: &Region, height_mm: f64, slenderness: f64) -> f64 {
    if slenderness <= 0.0 {
        return 0.0;
    }
    // Of a narrow base the narrow side counts, however it is turned.
    ((height_mm / slenderness - material.least_width_mm()) / 2.0).clamp(0.0, MOST_BRIM_MM)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;
    use crate::profile;
    use crate::toolpath::flow::BeadModel;

    #[test]
    fn a_slender_part_gets_the_brim_that_steadies_it() {
        let tube = Region::new(vec![Contour::circle(Point2::origin(), 4.0, 360)]);
        // 138 mm by 12 are 11.5 mm to stand on; there are 8.
        assert!((steadying_brim_mm(&tube, 138.0, 12.0) - 1.75).abs() < 0.01);
        assert!(steadying_brim_mm(&tube, 90.0, 12.0) < 1e-9, "steady by itself");
        assert!(steadying_brim_mm(&tube, 138.0, 0.0) < 1e-9, "not wanted");
        // A bar 40 by 4 mm, turned by 45 degrees.
        let turned = |x: f64, y: f64| Point2::new((x - y) / 2.0_f64.sqrt(), (x + y) / 2.0_f64.sqrt());
        let corners = [(-20.0, -2.0), (20.0, -2.0), (20.0, 2.0), (-20.0, 2.0)].map(|(x, y)| turned(x, y));
        let bar = Region::new(vec![Contour::new(corners.to_vec())]);
        assert!((steadying_brim_mm(&bar, 120.0, 12.0) - 3.0).abs() < 0.01, "10 mm are needed, 4 are there");
    }

    #[test]
    fn brim_and_skirt_go_round_supports_and_part_as_one() {
        // A disc, and columns beside it: one half a millimetre away, the air of supports, one farther off.
        let disc =
            |x: f64, radius: f64| Region::new(vec![Contour::circle(Point2::new(x, 100.0), radius, 240)]);
        let part = disc(100.0, 6.0);
        let supports = disc(109.5, 3.0).union(&disc(85.0, 3.0));
        let mut profile = profile::builtin("reference").unwrap();
        (profile.print.brim_mm, profile.print.skirt_loops, profile.print.support_gap_mm) = (4.0, 2, 0.5);
        let model = BeadModel::new(profile.print.bead_shape, 0.2);
        let params = FillParams { model, width_mm: 0.45, limits_mm: [0.3, 0.8], perimeters: 2 };
        let (loops, warning) = loops(&part, &supports, 1.0, &profile, &params);
        assert!(warning.is_none() && loops.len() > 9);
        let ring = |path: &Path| {
            let line = Region::new(vec![Contour::new(path.vertices.iter().map(|v| v.at).collect())]);
            let half_mm = params.width_mm / 2.0;
            line.offset(half_mm, 0.001).difference(&line.offset(-half_mm, 0.001))
        };
        let beads: Vec<Region> = loops.iter().map(ring).collect();
        let on_bed = part.union(&supports);
        for (i, bead) in beads.iter().enumerate() {
            let over = bead.intersection(&on_bed).area_mm2();
            assert!(over < 0.01 * bead.area_mm2(), "loop {i} runs over {over} mm2 of part and supports");
            for other in &beads[..i] {
                let twice = bead.intersection(other).area_mm2();
                assert!(twice < 0.02 * bead.area_mm2(), "loop {i} runs over another one by {twice} mm2");
            }
        }
        // Without supports the brim is a ring of its width around the disc.
        let (alone, _) = super::loops(&part, &Region::default(), 1.0, &profile, &params);
        let brim: f64 = alone[2..].iter().map(|path| ring(path).area_mm2()).sum();
        let width_mm = (4.0_f64 / 0.45).round() * 0.45;
        let expected = std::f64::consts::PI * ((6.0 + width_mm).powi(2) - 36.0);
        assert!((brim / expected - 1.0).abs() < 0.01, "{brim} {expected}");
    }
}
