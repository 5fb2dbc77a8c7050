//! How deep the material is under each point of its outline.
//!
//! Every outline (skin) is walked piece by piece. From the middle of a piece a ball is shrunk along the
//! inward normal until it touches the outline elsewhere: its radius is the distance to the medial axis,
//! so the segments from all skins, as long as their depths, divide the material among the skins without
//! gap or overlap (Ma, Bae, Choi: 3D medial axis point approximation using nearest neighbors and the
//! normal field, Vis. Comput. 28, 2012). The medial axis itself is never built.
//!
//! A touch whose radii open less than 120 degrees is no wall but a corner or a tight bend: beads there
//! are trimmed at the depth, and the wall's depth is carried over from its neighbours.
//!
//! Accuracy: that of the chords. Cost: two to three distance queries a piece.

use crate::geom::distance::Foot;
use crate::geom::{Contour, Point2, Region, SegmentIndex, Vector2};

/// Longest piece of a skin, mm: depth is sampled once a piece.
const PIECE_MM: f64 = 0.3;
/// Pieces between which the depth changes by more than this are halved, down to the shortest piece, mm: under the facets
/// of a coarse mesh, where an even wall is deeper in the middle of each.
const DEPTH_STEP_MM: f64 = 2e-3;
const SHORTEST_PIECE_MM: f64 = 0.07;
/// A corner that turns by more than this is sharp, rad (20 degrees): it is mitred or fanned, not smoothed
/// over.
const SHARP_RAD: f64 = 0.35;
/// Largest turn between two rays of a fan around a sharp inner corner, rad (10 degrees).
const FAN_STEP_RAD: f64 = 0.18;
/// Cosine of the largest opening of the radii that still counts as a corner (120 degrees).
const WALL_COS: f64 = -0.5;
/// A ball that sinks deeper than this into another outline is shrunk, mm.
const TOUCH_MM: f64 = 5e-4;
/// Share by which both skins of a wall may differ about its depth.
const SAME_WALL: f64 = 0.2;

/// What ended the growth of the ball under a point of the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Contact {
    /// The far side of a wall: contour and place of the touch.
    Wall { contour_idx: usize, edge_idx: usize, at: Point2 },
    /// A corner or a tight bend of the skin itself.
    Corner,
    /// Nothing within the depth that matters.
    Deep,
}

/// A vertex of a skin with what lies under it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// On the skin.
    pub(super) at: Point2,
    /// Into the material; not a unit vector at mitred corners: `at + depth * inward` lies `depth` deep.
    pub(super) inward: Vector2,
    /// Length of the skin that the sample stands for, mm.
    pub(super) share_mm: f64,
    /// Distance to the medial axis, mm, at most the cap.
    pub(super) depth_mm: f64,
    /// The wall's depth: as `depth_mm`, but carried over from the neighbours at corners.
    pub(super) wall_mm: f64,
    /// What lies at that depth.
    pub(super) contact: Contact,
    /// The contour's edge that begins at or before the sample, in the simplified outline.
    pub(super) edge_idx: usize,
    /// Whether the skin turns sharply outward here.
    pub(super) sharp: bool,
}

impl Sample {
    /// Whether two samples are of one wall, as far as their depths tell.
    pub(super) fn is_about_as_deep(&self, other: &Self) -> bool {
        (self.wall_mm - other.wall_mm).abs() < SAME_WALL * self.wall_mm
    }
}

/// One closed outline of the material.
#[derive(Debug, Clone)]
pub(super) struct Skin {
    /// In the outline's order; the material is on the left.
    pub(super) samples: Vec<Sample>,
    /// Whether the outline bounds a hole.
    pub(super) is_hole: bool,
}

/// The outlines of a layer, ready for distance queries.
#[derive(Debug)]
pub(super) struct Skins {
    /// One per contour.
    pub(super) skins: Vec<Skin>,
    /// Of the simplified outlines.
    pub(super) index: SegmentIndex,
    /// The simplified outlines.
    pub(super) contours: Vec<Contour>,
}

impl Skins {
    /// Measures the material of a layer; depths are cut off at `cap_mm`. `None` where there is no outline.
    pub(super) fn try_new(material: &Region, cap_mm: f64, tolerance_mm: f64) -> Option<Self> {
        let contours: Vec<Contour> = material
            .contours
            .iter()
            .map(|c| super::simplify::contour(c, tolerance_mm))
            .filter(|c| c.len() >= 3)
            .collect();
        let index = SegmentIndex::try_new(&contours)?;
        let probe = Probe { index: &index, cap_mm };
        let skins = contours.iter().map(|c| probe.skin(c)).collect();
        Some(Self { skins, index, contours })
    }
}

/// A straight piece of an edge and the ball under its middle.
#[derive(Debug, Clone, Copy)]
struct Piece {
    from: Point2,
    along: Vector2,
    length_mm: f64,
    edge_idx: usize,
    ball: Ball,
}

/// An edge of an outline with its direction.
struct Edge {
    a: Point2,
    along: Vector2,
    length_mm: f64,
    edge_idx: usize,
}

#[derive(Debug, Clone, Copy)]
struct Ball {
    radius_mm: f64,
    contact: Contact,
}

struct Probe<'a> {
    index: &'a SegmentIndex,
    cap_mm: f64,
}

fn left_of(v: Vector2) -> Vector2 {
    Vector2::new(-v.y, v.x)
}

impl Probe<'_> {
    fn skin(&self, contour: &Contour) -> Skin {
        let pieces = self.pieces(contour);
        let mut samples = Vec::with_capacity(pieces.len());
        for i in 0..pieces.len() {
            let before = &pieces[(i + pieces.len() - 1) % pieces.len()];
            self.join(before, &pieces[i], &mut samples);
        }
        carry_wall_depth(&mut samples);
        Skin { samples, is_hole: !contour.is_ccw() }
    }

    fn pieces(&self, contour: &Contour) -> Vec<Piece> {
        let mut pieces: Vec<Piece> = Vec::with_capacity(2 * contour.len());
        for (edge_idx, (a, b)) in contour.edges().enumerate() {
            let length = (b - a).norm();
            if length <= 0.0 {
                continue;
            }
            let edge = Edge { a, along: (b - a) / length, length_mm: length, edge_idx };
            let (begin, mut longest_mm, mut n_pieces) = (pieces.len(), PIECE_MM, 0);
            loop {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a bed's size")]
                let n = ((length / longest_mm).ceil() as usize).max(1);
                // Asked again, as many pieces would be the same.
                if n != n_pieces {
                    n_pieces = n;
                    pieces.truncate(begin);
                    self.divide(&edge, n, &mut pieces);
                }
                let beside = &pieces[begin.saturating_sub(1)..];
                let step = |p: &[Piece]| (p[0].ball.radius_mm - p[1].ball.radius_mm).abs();
                longest_mm /= 2.0;
                if longest_mm < SHORTEST_PIECE_MM || beside.windows(2).all(|p| step(p) < DEPTH_STEP_MM) {
                    break;
                }
            }
        }
        pieces
    }

    /// Appends an edge in `n` equal pieces.
    fn divide(&self, edge: &Edge, n: usize, pieces: &mut Vec<Piece>) {
        let length_mm = edge.length_mm / n as f64;
        for i in 0..n {
            let from = edge.a + edge.along * (i as f64 * length_mm);
            let guess_mm = pieces.last().map_or(self.cap_mm, |p| p.ball.radius_mm);
            let middle = from + edge.along * (length_mm / 2.0);
            let ball = self.ball(middle, left_of(edge.along), guess_mm);
            pieces.push(Piece { from, along: edge.along, length_mm, edge_idx: edge.edge_idx, ball });
        }
    }

    /// The largest ball that touches the skin at `p` from inside. `guess_mm`: the neighbour's radius.
    fn ball(&self, p: Point2, inward: Vector2, guess_mm: f64) -> Ball {
        let mut radius = (1.25 * guess_mm).clamp(TOUCH_MM, self.cap_mm);
        let mut contact = None;
        // The radius falls quickly; the bound only guards against rounding.
        for _ in 0..40 {
            let nearer = self.index.nearest_within(p + inward * radius, (radius - TOUCH_MM).max(0.0));
            if let Some(foot) = nearer {
                let way = foot.point - p;
                let towards = 2.0 * inward.dot(&way);
                let smaller = way.norm_squared() / towards;
                if towards <= 0.0 || smaller >= radius {
                    break;
                }
                radius = smaller;
                contact = Some(foot);
            } else if contact.is_none() && radius < self.cap_mm {
                radius = (1.6 * radius).min(self.cap_mm);
            } else {
                break;
            }
        }
        Ball { radius_mm: radius, contact: contact.map_or(Contact::Deep, |q| touch(p, inward, radius, q)) }
    }

    /// The samples at the joint of two pieces: one, or a fan where the material wraps around a sharp corner.
    fn join(&self, before: &Piece, after: &Piece, samples: &mut Vec<Sample>) {
        let turn = before.along.perp(&after.along).atan2(before.along.dot(&after.along));
        let share_mm = 0.5 * (before.length_mm + after.length_mm);
        let base = |inward, ball: Ball, share_mm, sharp| Sample {
            at: after.from,
            inward,
            share_mm,
            depth_mm: ball.radius_mm,
            wall_mm: ball.radius_mm,
            contact: ball.contact,
            edge_idx: after.edge_idx,
            sharp,
        };
        if turn < -SHARP_RAD {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 18")]
            let n = (-turn / FAN_STEP_RAD).ceil() as usize;
            for i in 0..=n {
                let angle = turn * i as f64 / n as f64;
                let inward = nalgebra::Rotation2::new(angle) * left_of(before.along);
                let ball = self.ball(after.from, inward, before.ball.radius_mm);
                samples.push(base(inward, ball, share_mm / (n + 1) as f64, false));
            }
            return;
        }
        let middle = left_of(before.along) + left_of(after.along);
        // The mitre's length 1 / cos(turn / 2), bounded at needle-sharp corners.
        let inward = middle * (2.0 / middle.norm_squared().max(0.25));
        samples.push(base(inward, both(before.ball, after.ball), share_mm, turn > SHARP_RAD));
    }
}

/// What the ball under a joint is, from those under its two pieces.
fn both(a: Ball, b: Ball) -> Ball {
    match (a.contact, b.contact) {
        (Contact::Corner, Contact::Corner) | (Contact::Wall { .. }, Contact::Wall { .. }) => {
            Ball { radius_mm: 0.5 * (a.radius_mm + b.radius_mm), contact: b.contact }
        }
        (_, Contact::Corner) | (Contact::Deep, Contact::Wall { .. }) => b,
        _ => a,
    }
}

fn touch(p: Point2, inward: Vector2, radius: f64, foot: Foot) -> Contact {
    let from_centre = (foot.point - p) / radius - inward;
    if -inward.dot(&from_centre) < WALL_COS * from_centre.norm() {
        Contact::Wall { contour_idx: foot.contour_idx, edge_idx: foot.edge_idx, at: foot.point }
    } else {
        Contact::Corner
    }
}

/// At corners the wall's depth is interpolated along the skin between the nearest samples that are none.
fn carry_wall_depth(samples: &mut [Sample]) {
    let n = samples.len();
    let is_corner = |s: &Sample| s.contact == Contact::Corner;
    let Some(start) = samples.iter().position(|s| !is_corner(s)) else {
        // A body of nothing but bends: a thin rod. Its widest place says how it is to be filled.
        let widest = samples.iter().map(|s| s.depth_mm).fold(0.0, f64::max);
        samples.iter_mut().for_each(|s| s.wall_mm = widest);
        return;
    };
    let mut i = 0;
    while i < n {
        if !is_corner(&samples[(start + i) % n]) {
            i += 1;
            continue;
        }
        let run = (i..n).take_while(|&k| is_corner(&samples[(start + k) % n])).count();
        let (from, to) = (samples[(start + i - 1) % n].wall_mm, samples[(start + i + run) % n].wall_mm);
        let length: f64 = (i..=i + run).map(|k| samples[(start + k) % n].share_mm).sum();
        let mut passed = 0.0;
        for k in i..i + run {
            let s = &mut samples[(start + k) % n];
            passed += s.share_mm;
            // Never shallower than what was measured: that much is surely there.
            s.wall_mm = (from + (to - from) * passed / length.max(1e-9)).max(s.depth_mm);
        }
        i += run;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(inner: f64, outer: f64, shift: f64) -> Region {
        let hole = Contour::circle(Point2::new(shift, 0.0), inner, 120).reversed();
        Region::new(vec![Contour::circle(Point2::origin(), outer, 150), hole])
    }

    #[test]
    fn depth_in_a_ring_is_half_its_thickness_from_both_sides() {
        let skins = Skins::try_new(&ring(3.0, 4.0, 0.0), 1.5, 1e-6).unwrap();
        for s in skins.skins.iter().flat_map(|s| &s.samples) {
            assert!((s.depth_mm - 0.5).abs() < 2e-3, "{}", s.depth_mm);
            assert!(matches!(s.contact, Contact::Wall { .. }));
        }
        assert!(!skins.skins[0].is_hole && skins.skins[1].is_hole);
    }

    #[test]
    fn depth_follows_a_wall_of_varying_thickness() {
        let skins = Skins::try_new(&ring(3.0, 4.0, 0.3), 1.5, 1e-6).unwrap();
        let depths = skins.skins[1].samples.iter().map(|s| s.depth_mm);
        let (least, most) = depths.fold((f64::MAX, 0.0f64), |(a, b), d| (a.min(d), b.max(d)));
        assert!((least - 0.35).abs() < 3e-3 && (most - 0.65).abs() < 3e-3, "{least} {most}");
    }

    #[test]
    fn corners_of_a_bar_keep_the_depth_of_its_sides() {
        let bar = [(0., 0.), (20., 0.), (20., 1.), (0., 1.)].map(|(x, y)| Point2::new(x, y));
        let skins = Skins::try_new(&Region::new(vec![Contour::new(bar.to_vec())]), 1.5, 1e-6).unwrap();
        assert!(skins.skins[0].samples.iter().all(|s| (s.wall_mm - 0.5).abs() < 0.02));
        let corners = skins.skins[0].samples.iter().filter(|s| s.sharp).count();
        assert_eq!(corners, 4);
    }

    #[test]
    fn deep_material_is_cut_off_at_the_cap() {
        let disk = Region::new(vec![Contour::circle(Point2::origin(), 5.0, 200)]);
        let skins = Skins::try_new(&disk, 1.5, 1e-6).unwrap();
        assert!(skins.skins[0].samples.iter().all(|s| s.contact == Contact::Deep && s.depth_mm == 1.5));
    }
}
