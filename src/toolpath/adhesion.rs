//! Loops around the first layer: a brim that holds the part down, a skirt that primes the nozzle.

use super::fill::{FillParams, Path, Role, Vertex};
use super::travel::Travel;
use super::{Bead, BeadKind, sequence, simplify};
use crate::ct::Warning;
use crate::geom::{Bounds2, Contour, Region, SegmentIndex};
use crate::profile::Profile;
use crate::slice::Layer;

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
    brim_mm: f64,
    profile: &Profile,
    params: &FillParams,
) -> (Vec<Path>, Option<Warning>) {
    let outline = outline(material, supports, params.width_mm.max(profile.print.support_gap_mm));
    around(&outline, n_brim(brim_mm, params), profile, params)
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

/// Loops of a brim.
pub(super) fn n_brim(brim_mm: f64, params: &FillParams) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative: validated")]
    let n_brim = (brim_mm / params.pitch_mm()).round() as usize;
    n_brim
}

/// How wide a brim the profile wants, or the part needs so that all that stands by itself stands steadily, mm. `placed`: material
/// and lumen of all layers on the bed.
pub(super) fn brim_mm(layers: &[Layer], placed: &[(Region, Region)], profile: &Profile) -> f64 {
    let print = &profile.print;
    if print.brim_slenderness <= 0.0 {
        return print.brim_mm;
    }
    let needed =
        |(foot, height_mm): (Region, f64)| steadying_brim_mm(&foot, height_mm, print.brim_slenderness);
    standing(layers, placed).into_iter().map(needed).fold(print.brim_mm, f64::max)
}

/// The brim that steadies what is so high and stands on a foot, mm: so that it stands on no less than its height by the
/// slenderness, for what pushes at its top turns it over the edge of what it stands on.
fn steadying_brim_mm(foot: &Region, height_mm: f64, slenderness: f64) -> f64 {
    // Of a narrow base the narrow side counts, however it is turned.
    ((height_mm / slenderness - foot.least_width_mm()) / 2.0).clamp(0.0, MOST_BRIM_MM)
}

/// An outer outline of a layer.
struct Outline<'a> {
    contour: &'a Contour,
    bounds: Bounds2,
    index: SegmentIndex,
}

impl<'a> Outline<'a> {
    fn all(material: &'a Region) -> Vec<Self> {
        let outer = material.contours.iter().filter(|c| c.is_ccw());
        let outline = |contour: &'a Contour| {
            let index = SegmentIndex::try_new(std::slice::from_ref(contour))?;
            Some(Self { contour, bounds: contour.bounds()?, index })
        };
        outer.filter_map(outline).collect()
    }

    /// Whether they share some of the plane. Where no edges cross one lies in the other with all of its vertices, or with none.
    fn meets(&self, other: &Self) -> bool {
        let has_of = |a: &Self, b: &Self| {
            b.contour.points.first().is_some_and(|&p| a.index.signed_distance_mm(p) <= TOLERANCE_MM)
        };
        let crosses = || other.contour.edges().any(|(a, b)| self.index.crosses(a, b));
        self.bounds.meets(other.bounds) && (has_of(self, other) || has_of(other, self) || crosses())
    }
}

/// What stands by itself: its outlines on the bed, in this layer and in the next.
struct Branch<'a> {
    foot: Vec<&'a Contour>,
    here: Vec<Outline<'a>>,
    next: Vec<Outline<'a>>,
}

impl<'a> Branch<'a> {
    fn of(on_bed: Outline<'a>) -> Self {
        Self { foot: vec![on_bed.contour], here: vec![on_bed], next: Vec::new() }
    }

    fn foot(&self) -> Region {
        Region::new(self.foot.iter().map(|&c| c.clone()).collect())
    }
}

/// All that stands by itself on the bed: its foot, and up to which height it does, mm. Branches that meet stand together from
/// there on.
pub(super) fn standing(layers: &[Layer], placed: &[(Region, Region)]) -> Vec<(Region, f64)> {
    let Some((first, _)) = placed.first() else { return Vec::new() };
    let mut branches: Vec<Branch<'_>> = Outline::all(first).into_iter().map(Branch::of).collect();
    let mut stood = Vec::new();
    let mut height_mm = 0.0;
    for (layer, (material, _)) in layers.iter().zip(placed) {
        for outline in Outline::all(material) {
            let holds = |b: &Branch<'_>| b.here.iter().any(|o| o.meets(&outline));
            let on: Vec<usize> = (0..branches.len()).filter(|&i| holds(&branches[i])).collect();
            let Some((&first, others)) = on.split_first() else { continue };
            if !others.is_empty() {
                stood.push((branches[first].foot(), height_mm));
            }
            for &i in others.iter().rev() {
                let mut other = branches.remove(i);
                stood.push((other.foot(), height_mm));
                branches[first].foot.append(&mut other.foot);
                branches[first].here.append(&mut other.here);
                branches[first].next.append(&mut other.next);
            }
            branches[first].next.push(outline);
        }
        let (end, on): (Vec<_>, Vec<_>) = branches.into_iter().partition(|b| b.next.is_empty());
        stood.extend(end.iter().map(|b| (b.foot(), height_mm)));
        branches = on.into_iter().map(|b| Branch { here: b.next, next: Vec::new(), ..b }).collect();
        height_mm += layer.slot.height_mm;
    }
    stood.extend(branches.iter().map(|b| (b.foot(), height_mm)));
    stood
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
    use crate::slice::LayerSlot;
    use crate::toolpath::flow::BeadModel;

    #[test]
    fn a_slender_part_gets_the_brim_that_steadies_it() {
        let tube = Region::new(vec![Contour::circle(Point2::origin(), 4.0, 360)]);
        // 138 mm by 12 are 11.5 mm to stand on; there are 8.
        assert!((steadying_brim_mm(&tube, 138.0, 12.0) - 1.75).abs() < 0.01);
        assert!(steadying_brim_mm(&tube, 90.0, 12.0) < 1e-9, "steady by itself");
        // A bar 40 by 4 mm, turned by 45 degrees.
        let turned = |x: f64, y: f64| Point2::new((x - y) / 2.0_f64.sqrt(), (x + y) / 2.0_f64.sqrt());
        let corners = [(-20.0, -2.0), (20.0, -2.0), (20.0, 2.0), (-20.0, 2.0)].map(|(x, y)| turned(x, y));
        let bar = Region::new(vec![Contour::new(corners.to_vec())]);
        assert!((steadying_brim_mm(&bar, 120.0, 12.0) - 3.0).abs() < 0.01, "10 mm are needed, 4 are there");
    }

    /// The brim for layers of 1 mm.
    fn brim_for(materials: Vec<Region>, slenderness: f64) -> f64 {
        let mut profile = profile::builtin("reference").unwrap();
        profile.print.brim_slenderness = slenderness;
        let slot = |i: usize| LayerSlot { z_mid_mm: i as f64 + 0.5, height_mm: 1.0, ct_plane: None };
        let placed: Vec<_> = materials.into_iter().map(|m| (m, Region::default())).collect();
        let layer = |(i, (material, lumen)): (usize, &(Region, Region))| Layer {
            slot: slot(i),
            material: material.clone(),
            lumen: lumen.clone(),
        };
        let layers: Vec<Layer> = placed.iter().enumerate().map(layer).collect();
        brim_mm(&layers, &placed, &profile)
    }

    #[test]
    fn each_branch_that_stands_apart_is_steadied_up_to_where_it_meets_another() {
        // Three rods of radius 2 mm on a circle of 20 mm.
        let rods: Vec<Region> = (0..3)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 3.0).sin_cos();
                Region::new(vec![Contour::circle(Point2::new(20.0 * cos, 20.0 * sin), 2.0, 360)])
            })
            .collect();
        let all = Region::union_all(&rods);
        let alone = brim_for(vec![rods[0].clone(); 120], 12.0);
        assert!((alone - 3.0).abs() < 0.01, "10 mm are needed, 4 are there: {alone}");
        assert!((brim_for(vec![all.clone(); 120], 12.0) - alone).abs() < 0.01);
        assert!(brim_for(vec![all.clone(); 120], 0.0) < 1e-9, "not wanted");
        // Joined by a plate from 60 mm on: each is to stand alone up to there.
        let plate = Region::new(vec![Contour::circle(Point2::origin(), 23.0, 360)]);
        let joined: Vec<Region> =
            (0..120).map(|i| if i < 60 { all.clone() } else { plate.clone() }).collect();
        assert!((brim_for(joined, 12.0) - 0.5).abs() < 0.01);
        // One of them ends early; what stands in a tube stands with it.
        let high = |i| if i < 20 { all.clone() } else { rods[0].union(&rods[1]) };
        assert!((brim_for((0..120).map(high).collect(), 12.0) - alone).abs() < 0.01);
        let disc = |radius: f64| Region::new(vec![Contour::circle(Point2::origin(), radius, 360)]);
        let in_tube = disc(15.0).difference(&disc(14.0)).union(&disc(2.0));
        assert!(brim_for(vec![in_tube; 120], 12.0) < 1e-9);
    }

    #[test]
    fn what_lies_across_stands_on_what_is_below() {
        let rectangle = |x: f64, y: f64| {
            let corners = [(-x, -y), (x, -y), (x, y), (-x, y)].map(|(x, y)| Point2::new(x, y));
            Region::new(vec![Contour::new(corners.to_vec())])
        };
        // No vertex of the one bar lies in the other; together they are 140 mm high.
        let (bar, across) = (rectangle(20.0, 2.0), rectangle(2.0, 20.0));
        let crossed = (0..140).map(|i| if i < 10 { bar.clone() } else { across.clone() }).collect();
        assert!((brim_for(crossed, 12.0) - 3.833).abs() < 0.01);
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
        let (loops, warning) = loops(&part, &supports, profile.print.brim_mm, &profile, &params);
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
        let (alone, _) = super::loops(&part, &Region::default(), 4.0, &profile, &params);
        let brim: f64 = alone[2..].iter().map(|path| ring(path).area_mm2()).sum();
        let width_mm = (4.0_f64 / 0.45).round() * 0.45;
        let expected = std::f64::consts::PI * ((6.0 + width_mm).powi(2) - 36.0);
        assert!((brim / expected - 1.0).abs() < 0.01, "{brim} {expected}");
    }
}
