//! One layer's recorded beads against its planned ones: moved, turned, thinner, missing, or too much.
//!
//! Lengths and moments of the centre lines tell in one pass whether a layer is as planned but for a shift of all of it.
//! Where they do not, the lines are laid over one another: first in the order of printing (points at equal parts of
//! the length, robust affine fit), which knows turns, scales and mirroring; where the order does not fit, as where beads
//! are missing, by a shift alone (robust, point to line, from several starts). Then every place of one side that has none of
//! the other beside it is missing, or too much. Nothing of this moves what the figures of the report compare.

use super::bead::{Piece, Sums, pieces_of, planned};
use crate::geom::{Bounds2, Contour, Point2, Region, SegmentIndex, Vector2};
use crate::profile::BeadShape;
use crate::toolpath::{Bead, BeadKind, BeadModel, LayerPaths};
use nalgebra::Matrix2;

/// Centre lines of planned and recorded beads are the same within this, mm.
const SAME_LINE_MM: f64 = 0.1;
/// The lines lie over one another when most points are nearer than this, mm.
const FITTED_MM: f64 = 0.02;
/// The order of printing is the planned one when more than this part of the points come together.
const ALL_IN_ORDER: f64 = 0.9;
/// Points that are laid over one another.
const N_POINTS: usize = 240;
/// Pieces are looked at in steps of this, mm.
const STEP_MM: f64 = 0.4;

/// Where material was that was not planned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Where {
    Lumen,
    Wall,
    Outside,
}

impl Where {
    pub(super) const ALL: [Self; 3] = [Self::Lumen, Self::Wall, Self::Outside];
}

/// Which planned beads are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    LumenSkin,
    OuterSkin,
    Inside,
    Around,
}

impl Role {
    pub(super) const ALL: [Self; 4] = [Self::LumenSkin, Self::OuterSkin, Self::Inside, Self::Around];
}

/// Length and volume.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Amount {
    pub(super) length_mm: f64,
    pub(super) volume_mm3: f64,
}

impl Amount {
    fn add(&mut self, length_mm: f64, volume_mm3: f64) {
        self.length_mm += length_mm;
        self.volume_mm3 += volume_mm3;
    }
}

/// How the recorded beads lie: a planned place x is printed at centroid + shift + linear (x - centroid).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    pub(super) shift: Vector2,
    pub(super) linear: Matrix2<f64>,
}

/// What one layer came to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Matched {
    /// Planned centroid on the bed.
    pub(super) centroid: Vector2,
    pub(super) planned: Amount,
    pub(super) recorded: Amount,
    /// `None` where nothing fits.
    pub(super) motion: Option<Motion>,
    /// Recorded over planned volume and width, where both lie.
    pub(super) flow: Option<f64>,
    pub(super) width: Option<f64>,
    /// By [`Role`]; planned and missing.
    pub(super) roles: [[Amount; 2]; 4],
    /// By [`Where`].
    pub(super) extra: [Amount; 3],
}

/// Compares a layer.
pub(super) fn matched(layer: &LayerPaths, recorded: &[Piece], shape: BeadShape) -> Matched {
    let pieces = planned(layer, shape);
    let (plan, record) = (Sums::of(pieces.iter()), Sums::of(recorded.iter()));
    let amount = |s: &Sums| Amount { length_mm: s.length_mm, volume_mm3: s.volume_mm3 };
    let mut matched = Matched {
        centroid: plan.centroid,
        planned: amount(&plan),
        recorded: amount(&record),
        motion: None,
        flow: None,
        width: None,
        roles: [[Amount::default(); 2]; 4],
        extra: [Amount::default(); 3],
    };
    if plan.length_mm <= 0.0 || record.length_mm <= 0.0 {
        return matched;
    }
    let shift = record.centroid - plan.centroid;
    if plan.is_same_shape(&record) && lies_over(&pieces, recorded, shift) {
        matched.motion = Some(Motion { shift, linear: Matrix2::identity() });
        matched.flow = Some(record.volume_mm3 / plan.volume_mm3);
        matched.width = Some(record.mean_width_mm() / plan.mean_width_mm());
        return matched;
    }
    Overlay { layer, shape, pieces: &pieces, recorded, plan, record }.compare(&mut matched);
    matched
}

/// Whether points at equal parts of the length are the same, shifted: moments alone are blind to mirrored shapes.
fn lies_over(planned: &[Piece], recorded: &[Piece], shift: Vector2) -> bool {
    let pairs = along(planned, 24).into_iter().zip(along(recorded, 24));
    let off = pairs.map(|(p, r)| (p.0 + shift - r.0).norm()).collect::<Vec<_>>();
    median(&off) < FITTED_MM
}

fn median(values: &[f64]) -> f64 {
    super::super::image::median(values.iter().copied()).unwrap_or(f64::INFINITY)
}

/// `n` points at equal parts of the length, each with its piece.
fn along(pieces: &[Piece], n: usize) -> Vec<(Point2, usize)> {
    let total: f64 = pieces.iter().map(Piece::length_mm).sum();
    let step = total / n as f64;
    let (mut next, mut points) = (0.5 * step, Vec::with_capacity(n));
    for (i, piece) in pieces.iter().enumerate() {
        let length = piece.length_mm();
        while next < length && points.len() < n {
            points.push((piece.at(next / length), i));
            next += step;
        }
        next -= length;
    }
    points
}

fn index_of(pieces: &[Piece]) -> Option<SegmentIndex> {
    let contour = |p: &Piece| Contour::new(vec![p.from, p.to]);
    SegmentIndex::try_new(&pieces.iter().map(contour).collect::<Vec<_>>())
}

struct Overlay<'a> {
    layer: &'a LayerPaths,
    shape: BeadShape,
    pieces: &'a [Piece],
    recorded: &'a [Piece],
    plan: Sums,
    record: Sums,
}

impl Overlay<'_> {
    fn compare(&self, matched: &mut Matched) {
        let (Some(planned), Some(recorded)) = (index_of(self.pieces), index_of(self.recorded)) else {
            return;
        };
        matched.motion = self.motion(&planned);
        let motion =
            matched.motion.unwrap_or(Motion { shift: Vector2::zeros(), linear: Matrix2::identity() });
        let volume_mm3 = self.recorded_sides(&planned, motion, matched);
        self.missing_sides(&recorded, motion, matched);
        let covered_mm3: f64 =
            matched.roles.iter().map(|[p, missing]| p.volume_mm3 - missing.volume_mm3).sum();
        matched.flow = (covered_mm3 > 0.0).then(|| volume_mm3 / covered_mm3);
    }

    /// The shift, unless an affine motion lays clearly more of the lines over planned ones: points in the order of printing
    /// slide along the lines where something was added or left out, which looks like a turn.
    fn motion(&self, planned: &SegmentIndex) -> Option<Motion> {
        let points = along(self.recorded, N_POINTS);
        let n_on_lines = |motion: &Motion| {
            let near = |(p, _): &&(Point2, usize)| {
                planned.nearest_within(self.planned_at(*motion, *p), 0.5 * FITTED_MM).is_some()
            };
            points.iter().filter(near).count()
        };
        let (affine, in_order) = self.in_order().unzip();
        if in_order.is_some_and(|part| part > ALL_IN_ORDER) {
            return affine;
        }
        match (self.shifted(planned), affine) {
            (Some(shift), Some(affine)) => {
                let clearly = n_on_lines(&affine) > n_on_lines(&shift) + N_POINTS / 20;
                Some(if clearly { affine } else { shift })
            }
            (shift, affine) => shift.or(affine),
        }
    }

    fn printed_at(&self, motion: Motion, p: Point2) -> Point2 {
        Point2::from(self.plan.centroid + motion.shift + motion.linear * (p.coords - self.plan.centroid))
    }

    fn planned_at(&self, motion: Motion, p: Point2) -> Point2 {
        let back = motion.linear.try_inverse().unwrap_or_else(Matrix2::identity);
        Point2::from(self.plan.centroid + back * (p.coords - self.plan.centroid - motion.shift))
    }

    /// The affine motion of points at the same part of the length, and the part of them that it brings together.
    fn in_order(&self) -> Option<(Motion, f64)> {
        if (self.record.length_mm / self.plan.length_mm - 1.0).abs() > 0.1 {
            return None;
        }
        let points = |pieces| along(pieces, N_POINTS).into_iter().map(|(p, _)| p);
        let pairs: Vec<(Point2, Point2)> = points(self.pieces).zip(points(self.recorded)).collect();
        let mut weights = vec![1.0; pairs.len()];
        let mut motion = None;
        for _ in 0..6 {
            let fitted = self.affine(&pairs, &weights)?;
            let off: Vec<f64> = pairs.iter().map(|(p, r)| (self.printed_at(fitted, *p) - r).norm()).collect();
            let usual = median(&off).max(1e-4);
            weights =
                off.iter().map(|d| if *d > 4.0 * usual { 0.0 } else { 1.0 / (1.0 + d / usual) }).collect();
            let together = off.iter().filter(|d| **d < 0.5 * FITTED_MM).count() as f64 / off.len() as f64;
            motion = (usual < FITTED_MM).then_some((fitted, together));
        }
        motion
    }

    /// Weighted least squares.
    fn affine(&self, pairs: &[(Point2, Point2)], weights: &[f64]) -> Option<Motion> {
        let total: f64 = weights.iter().sum();
        let mean = |get: fn(&(Point2, Point2)) -> Vector2| {
            pairs.iter().zip(weights).map(|(pair, w)| get(pair) * *w).sum::<Vector2>() / total
        };
        let (from, to) = (mean(|p| p.0.coords), mean(|p| p.1.coords));
        let (mut cross, mut own) = (Matrix2::zeros(), Matrix2::zeros());
        for ((p, r), w) in pairs.iter().zip(weights) {
            let (p, r) = (p.coords - from, r.coords - to);
            cross += r * p.transpose() * *w;
            own += p * p.transpose() * *w;
        }
        let linear: Matrix2<f64> = cross * own.try_inverse()?;
        let shift = to - self.plan.centroid - linear * (from - self.plan.centroid);
        linear.iter().all(|v| v.is_finite()).then_some(Motion { shift, linear })
    }

    /// The shift that lays most of the recorded lines over planned ones.
    fn shifted(&self, planned: &SegmentIndex) -> Option<Motion> {
        let points: Vec<Point2> = along(self.recorded, N_POINTS).into_iter().map(|(p, _)| p).collect();
        let corners = |pieces: &[Piece]| Bounds2::of(pieces.iter().flat_map(|p| [p.from, p.to]));
        let (a, b) = (corners(self.pieces)?, corners(self.recorded)?);
        let starts =
            [Vector2::zeros(), self.record.centroid - self.plan.centroid, b.min - a.min, b.max - a.max];
        let fits = |shift: &Vector2| {
            let near =
                points.iter().filter(|p| planned.nearest_within(**p - shift, 2.0 * FITTED_MM).is_some());
            near.count()
        };
        let settled = starts.map(|start| self.settled(planned, &points, start));
        // Of equal ones the first: not moved at all.
        let best = settled.into_iter().rev().max_by_key(fits)?;
        (2 * fits(&best) >= points.len()).then_some(Motion { shift: best, linear: Matrix2::identity() })
    }

    /// Point-to-line steps from a start.
    fn settled(&self, planned: &SegmentIndex, points: &[Point2], start: Vector2) -> Vector2 {
        let mut shift = start;
        for _ in 0..12 {
            let (mut normal, mut right) = (Matrix2::identity() * 1e-6, Vector2::zeros());
            let feet: Vec<_> = points.iter().map(|p| (*p - shift, planned.nearest(*p - shift))).collect();
            let usual = median(&feet.iter().map(|(_, f)| f.distance_mm).collect::<Vec<_>>()).max(5e-3);
            for (p, foot) in &feet {
                let piece = &self.pieces[foot.contour_idx];
                let along = (piece.to - piece.from) / piece.length_mm();
                let across = Vector2::new(-along.y, along.x);
                let weight = 1.0 / (1.0 + (foot.distance_mm / usual).powi(2));
                normal += across * across.transpose() * weight;
                right += across * (across.dot(&(p - foot.point)) * weight);
            }
            let Some(step) = normal.try_inverse().map(|inverse: Matrix2<f64>| inverse * right) else { break };
            shift += step;
            if step.norm() < 1e-5 {
                break;
            }
        }
        shift
    }

    /// Volume and width of the recorded beads on planned ones, and what lies beside all of them.
    fn recorded_sides(&self, planned: &SegmentIndex, motion: Motion, matched: &mut Matched) -> f64 {
        let (mut volume_mm3, mut widths) = (0.0, Vec::new());
        for piece in self.recorded {
            let (length_mm, n) = steps(piece);
            for part in (0..n).map(|i| (i as f64 + 0.5) / n as f64) {
                let own_mm3 = piece.volume_mm3 / n as f64;
                let at = piece.at(part);
                match planned.nearest_within(self.planned_at(motion, at), SAME_LINE_MM) {
                    Some(foot) => {
                        volume_mm3 += own_mm3;
                        widths.push(piece.width_mm / self.pieces[foot.contour_idx].width_mm);
                    }
                    None => matched.extra[self.place(at) as usize].add(length_mm, own_mm3),
                }
            }
        }
        matched.width = super::super::image::median(widths.into_iter());
        volume_mm3
    }

    fn place(&self, at: Point2) -> Where {
        if self.layer.lumen.contains(at) {
            Where::Lumen
        } else if self.layer.material.contains(at) {
            Where::Wall
        } else {
            Where::Outside
        }
    }

    fn missing_sides(&self, recorded: &SegmentIndex, motion: Motion, matched: &mut Matched) {
        let model = BeadModel::new(self.shape, self.layer.slot.height_mm);
        for bead in &self.layer.beads {
            let role = role(bead, &self.layer.lumen);
            for piece in pieces_of(bead, model).filter(|p| p.length_mm() > 0.0) {
                let (length_mm, n) = steps(&piece);
                for part in (0..n).map(|i| (i as f64 + 0.5) / n as f64) {
                    let [planned, missing] = &mut matched.roles[role as usize];
                    let volume_mm3 = piece.volume_mm3 / n as f64;
                    planned.add(length_mm, volume_mm3);
                    let at = self.printed_at(motion, piece.at(part));
                    if recorded.nearest_within(at, SAME_LINE_MM).is_none() {
                        missing.add(length_mm, volume_mm3);
                    }
                }
            }
        }
    }
}

/// A piece in steps: the length of each, and how many.
fn steps(piece: &Piece) -> (f64, usize) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "lengths on a bed")]
    let n = (piece.length_mm() / STEP_MM).ceil().max(1.0) as usize;
    (piece.length_mm() / n as f64, n)
}

/// What a bead is for: a skin belongs to the lumen where it lies along its outline.
fn role(bead: &Bead, lumen: &Region) -> Role {
    if !bead.kind.is_part() {
        return Role::Around;
    }
    if bead.kind != BeadKind::ExternalPerimeter {
        return Role::Inside;
    }
    let at_lumen = |p: &crate::toolpath::BeadPoint| {
        lumen.contours.iter().any(|c| {
            c.edges().any(|(a, b)| {
                (crate::geom::distance::nearest_on_segment(p.at, a, b) - p.at).norm() < 0.75 * p.width_mm
            })
        })
    };
    let step = bead.points.len().div_ceil(12).max(1);
    let looked: Vec<bool> = bead.points.iter().step_by(step).map(at_lumen).collect();
    let n_at_lumen = looked.iter().filter(|at| **at).count();
    if 2 * n_at_lumen > looked.len() { Role::LumenSkin } else { Role::OuterSkin }
}
