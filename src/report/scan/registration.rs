//! Where the replica in a scan lies on the model: a rigid transform, found without a hint.
//!
//! Starts: the principal axes of both bodies laid over each other, in every order and with every sign that makes a rotation and
//! that their spreads allow, each turned about the longest axis in steps (where two spreads are alike, axes say nothing). The best of
//! them are improved by iterated closest points with distances along the normals (Chen and Medioni, Image and Vision Computing
//! 10, 1992), weighted by Tukey's function, whose width follows the closer part of the distances: where a part of the replica is
//! shifted or missing, the pose is that of the rest. Everything is deterministic.
//!
//! The same is tried with the scan mirrored: only to be told, never to be used. A scale is estimated at the end, about the middle,
//! and not applied. What fits badly, or in several ways, is refused.

use super::body::{Moments, SurfacePoint};
use super::model::Model;
use crate::geom::{Point3, RigidTransform, Vector3};
use crate::progress::{Cancelled, Task};
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector};
use rayon::prelude::*;

/// Turns about the longest axis that are tried, how many of all starts are improved, and how many of those once more.
const N_TURNS: usize = 12;
const N_IMPROVED: usize = 8;
const N_KEPT: usize = 4;
/// Spreads along axes that are laid over each other differ at most by this factor.
const MOST_SPREAD: f64 = 1.6;
/// Places used for the starts, to improve them, and for the pose.
const N_ROUGH: usize = 200;
const N_BETTER: usize = 1000;
/// A place farther off than this counts as so far off, mm.
const FAR_MM: f64 = 3.0;
/// Steps of the search, and when it has settled, mm.
const ROUGH_STEPS: f64 = 12.0;
const BETTER_STEPS: f64 = 30.0;
const MOST_STEPS: f64 = 80.0;
const SETTLED_MM: f64 = 2e-5;
/// The part of the distances that the width of the weights follows, and that quantile of the unsigned normal distribution.
const CLOSER: f64 = 0.3;
const CLOSER_NORMAL: f64 = 0.3853;
/// Tukey's width over the standard deviation: 95 % efficient where all is normal.
const TUKEY: f64 = 4.685;
/// The width that the search begins with, mm, and what it becomes by each step.
const WIDE_MM: f64 = 2.0;
const NARROWER: f64 = 0.75;
/// The part of the places that may lead to a pose of their own, and by which factor that has to scatter less.
const PART: f64 = 0.6;
const DISTINCT: f64 = 0.85;
/// Poses that differ by less are the same one, mm at the corners of the part.
const SAME_POSE_MM: f64 = 1.0;
/// Another pose that is off by less than this factor, and a little, fits as well.
const AS_WELL: f64 = 1.25;
const AS_WELL_MM: f64 = 0.02;
/// A mirrored scan that is off by less than this part of what the scan is off is the better one.
const MIRRORED: f64 = 0.6;
/// A mirrored scan that is off by more than so many times as much is not tried further.
const FAR_WORSE: f64 = 4.0;
/// Least part of the surface that lies on the model.
const LEAST_ON_MODEL: f64 = 0.5;
/// A pose is not known if a corner may lie this far off (one standard deviation), mm.
const MOST_POSE_MM: f64 = 0.3;

/// Why a scan could not be laid over its model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// There is no body of the model's kind.
    #[error(
        "the scan shows no body like the model: its volume is {model_mm3:.0} mm³, {found}; scan the whole replica alone, in air, with voxels smaller than its wall"
    )]
    NoBody {
        /// What the model has, mm³.
        model_mm3: f64,
        /// What the scan has.
        found: String,
    },
    /// No pose fits.
    #[error(
        "nothing in the scan has the shape of the model: of the body that comes nearest {on_model_percent:.0} % of the surface can be laid on it, the rest is {off_mm:.2} mm off on average; see that it is the replica of this case, that it is more than noise, and that lengths in the file are in mm"
    )]
    NoFit {
        /// Part of the surface on the model, percent.
        on_model_percent: f64,
        /// Mean distance, far places cut off, mm.
        off_mm: f64,
    },
    /// Several poses fit.
    #[error(
        "the scan fits the model in more than one way (off by {off_mm:.3} mm, and by {other_mm:.3} mm after a turn of {turn_deg:.0} degrees): its shape does not tell how it lies, so that no place can be compared"
    )]
    Ambiguous {
        /// Mean distance of the best pose, mm.
        off_mm: f64,
        /// Mean distance of another one, mm.
        other_mm: f64,
        /// Between the two, degrees.
        turn_deg: f64,
    },
    /// Several bodies fit.
    #[error(
        "the scan shows more than one body that fits the model: scan one replica alone, or crop the image to it"
    )]
    SeveralBodies,
    /// The shape leaves a motion free.
    #[error(
        "the scan can be moved along or about the model without getting worse (by {pose_mm:.2} mm): its shape does not tell how it lies, so that no place can be compared"
    )]
    Loose {
        /// How far a corner may lie off, one standard deviation, mm.
        pose_mm: f64,
    },
}

/// Similarity from the scan's stack frame to the model's: scale, then rotation, then translation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    rotation: Rotation3<f64>,
    translation: Vector3,
    pub(super) scale: f64,
}

impl Pose {
    fn apply(&self, p: Point3) -> Point3 {
        self.rotation * (p * self.scale) + self.translation
    }

    fn rotate(&self, v: Vector3) -> Vector3 {
        self.rotation * v
    }

    /// After a small motion about `centre`: turn, shift, and growth (its logarithm).
    fn moved(&self, centre: Point3, turn: Vector3, shift: Vector3, growth: f64) -> Self {
        let small = Rotation3::from_scaled_axis(turn);
        let arm = self.translation - centre.coords;
        Self {
            rotation: small * self.rotation,
            translation: centre.coords + (small * arm) * growth.exp() + shift,
            scale: self.scale * growth.exp(),
        }
    }

    /// Without its scale, the place `about` of the scan kept where it is.
    fn rigid(&self, about: Point3) -> Self {
        let kept = self.apply(about);
        Self { translation: kept.coords - self.rotation * about.coords, scale: 1.0, ..*self }
    }

    pub(super) fn to_transform(self) -> RigidTransform {
        let axis = |v: Vector3| self.rotation * v;
        RigidTransform::from_axes(
            Point3::from(self.translation),
            axis(Vector3::x()),
            axis(Vector3::y()),
            axis(Vector3::z()),
        )
    }

    /// Where a place of the model lies in the scan.
    pub(super) fn back(&self, p: Point3) -> Point3 {
        (self.rotation.inverse() * (p - self.translation)) / self.scale
    }

    /// A direction of the model in the scan.
    pub(super) fn back_direction(&self, v: Vector3) -> Vector3 {
        self.rotation.inverse() * v
    }
}

/// How well a pose fits.
#[derive(Debug, Clone, Copy)]
struct Fit {
    pose: Pose,
    /// Mean unsigned distance, far places cut off, mm.
    off_mm: f64,
    on_model: f64,
}

/// A pose and what is known about it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Registered {
    /// Rigid.
    pub(super) pose: Pose,
    /// With the scale that fits best.
    pub(super) similar: Pose,
    /// Standard deviation of that scale; infinite where the scale is not told from a wall or heights that are off.
    pub(super) scale_sd: f64,
    /// Scatter of the surface about the model, robust standard deviation, mm.
    pub(super) scatter_mm: f64,
    /// Root mean square distance of the places that count, mm.
    pub(super) rms_mm: f64,
    /// Part of the places that count, 0 to 1.
    pub(super) fitted_part: f64,
    /// How far a corner of the part may lie off, one standard deviation, mm.
    pub(super) pose_mm: f64,
    pub(super) off_mm: f64,
    /// The mirrored scan, laid over the model by itself, and its mean distance, mm; `None` where it was far worse from the start.
    mirrored: Option<Pose>,
    pub(super) mirrored_off_mm: f64,
}

impl Registered {
    /// Whether the mirrored scan fits distinctly better.
    pub(super) fn is_mirrored(&self) -> bool {
        self.mirrored_off_mm < MIRRORED * self.off_mm
    }

    /// Whether the shape does not tell the scan from its mirror image.
    pub(super) fn may_be_mirrored(&self) -> bool {
        !self.is_mirrored() && MIRRORED * self.mirrored_off_mm < self.off_mm
    }
}

/// Lays the surface of a body over the model.
///
/// # Errors
/// [`Cancelled`]; within, [`Refusal`] where nothing fits, or several poses do. A mirrored scan is no error:
/// [`Registered::is_mirrored`].
pub(super) fn register(
    model: &Model,
    points: &[SurfacePoint],
    moments: &Moments,
    on_model_mm: f64,
    task: &Task<'_>,
) -> Result<Result<Registered, Refusal>, Cancelled> {
    let flip = Matrix3::from_diagonal(&mirror(Vector3::new(1.0, 1.0, 1.0)));
    task.check()?;
    let own = search(model, points, moments.centre(), moments.covariance(), on_model_mm);
    task.check()?;
    let centre = Point3::from(mirror(moments.centre().coords));
    let other = search(model, &mirrored(points), centre, flip * moments.covariance() * flip, on_model_mm);
    task.check()?;
    Ok(chosen(model, points, [&own, &other], on_model_mm))
}

fn mirror(v: Vector3) -> Vector3 {
    Vector3::new(-v.x, v.y, v.z)
}

fn mirrored(points: &[SurfacePoint]) -> Vec<SurfacePoint> {
    let of =
        |p: &SurfacePoint| SurfacePoint { at: Point3::from(mirror(p.at.coords)), normal: mirror(p.normal) };
    points.iter().map(of).collect()
}

/// What the search for the scan, and for its mirror image, comes to.
fn chosen(
    model: &Model,
    points: &[SurfacePoint],
    [own, other]: [&[Fit]; 2],
    on_model_mm: f64,
) -> Result<Registered, Refusal> {
    let (Some(best), Some(other)) = (own.first().copied(), other.first().copied()) else {
        return Err(Refusal::NoFit { on_model_percent: 0.0, off_mm: FAR_MM });
    };
    let is_mirrored = other.off_mm < MIRRORED * best.off_mm;
    let shown = if is_mirrored { other } else { best };
    if shown.on_model < LEAST_ON_MODEL {
        return Err(Refusal::NoFit { on_model_percent: 100.0 * shown.on_model, off_mm: shown.off_mm });
    }
    if !is_mirrored {
        unambiguous(model, own)?;
    }
    let mirrored = (other.off_mm < FAR_WORSE * best.off_mm).then_some(other.pose);
    let registered = settled(model, points, (&best.pose, mirrored), on_model_mm);
    if !is_mirrored && registered.pose_mm > MOST_POSE_MM {
        return Err(Refusal::Loose { pose_mm: registered.pose_mm });
    }
    Ok(registered)
}

/// Once more, from where it lies: other places, or a model seen otherwise.
pub(super) fn again(
    model: &Model,
    points: &[SurfacePoint],
    first: &Registered,
    on_model_mm: f64,
    task: &Task<'_>,
) -> Result<Registered, Cancelled> {
    task.check()?;
    let settled = settled(model, points, (&first.pose, first.mirrored), on_model_mm);
    task.check()?;
    Ok(settled)
}

/// Refuses where a pose that is another one fits nearly as well as the first.
fn unambiguous(model: &Model, fits: &[Fit]) -> Result<(), Refusal> {
    let Some((best, others)) = fits.split_first() else { return Ok(()) };
    let corners = model.corners();
    let as_well = |f: &&Fit| f.off_mm < AS_WELL * best.off_mm + AS_WELL_MM;
    match others.iter().filter(as_well).find(|f| apart_mm(&corners, &f.pose, &best.pose) > SAME_POSE_MM) {
        None => Ok(()),
        Some(other) => Err(Refusal::Ambiguous {
            off_mm: best.off_mm,
            other_mm: other.off_mm,
            turn_deg: best.pose.rotation.angle_to(&other.pose.rotation).to_degrees(),
        }),
    }
}

/// How far two poses bring a corner of the model apart, at most.
fn apart_mm(corners: &[Point3], a: &Pose, b: &Pose) -> f64 {
    corners.iter().map(|c| (b.apply(a.back(*c)) - c).norm()).fold(0.0, f64::max)
}

/// Poses that fit, the best first; each once.
fn search(
    model: &Model,
    points: &[SurfacePoint],
    centre: Point3,
    covariance: Matrix3<f64>,
    on_model_mm: f64,
) -> Vec<Fit> {
    let (rough, better) = (picked(points, N_ROUGH), picked(points, N_BETTER));
    let mut starts: Vec<Fit> = starts(model, centre, covariance)
        .into_par_iter()
        .map(|pose| assessed(model, &rough, pose, on_model_mm))
        .collect();
    starts.sort_by(|a, b| a.off_mm.total_cmp(&b.off_mm));
    starts.truncate(N_IMPROVED);
    let by_off = |fits: &mut Vec<Fit>| fits.sort_by(|a, b| a.off_mm.total_cmp(&b.off_mm));
    let stage = |fits: Vec<Fit>, points: &[SurfacePoint], n_steps: f64| -> Vec<Fit> {
        let improve = |fit: Fit| {
            let pose = improved(model, points, fit.pose, Freedom::Rigid, [WIDE_MM, n_steps]);
            assessed(model, points, pose, on_model_mm)
        };
        let mut fits: Vec<Fit> = fits.into_par_iter().map(improve).collect();
        by_off(&mut fits);
        fits
    };
    let corners = model.corners();
    let mut distinct: Vec<Fit> = Vec::new();
    for fit in stage(starts, &rough, ROUGH_STEPS) {
        if distinct.iter().all(|d| apart_mm(&corners, &d.pose, &fit.pose) > SAME_POSE_MM) {
            distinct.push(fit);
        }
    }
    distinct.truncate(N_KEPT);
    stage(distinct, &better, BETTER_STEPS)
}

/// Evenly picked, at most so many.
fn picked(points: &[SurfacePoint], n_most: usize) -> Vec<SurfacePoint> {
    let every = points.len().div_ceil(n_most).max(1);
    points.iter().skip(every / 2).step_by(every).copied().collect()
}

/// Principal axes over principal axes.
fn starts(model: &Model, centre: Point3, covariance: Matrix3<f64>) -> Vec<Pose> {
    let (to, to_spread) = axes(model.moments.covariance());
    let (from, from_spread) = axes(covariance);
    let mut starts = Vec::new();
    for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        let fits = (0..3).all(|i| {
            let ratio = from_spread[order[i]] / to_spread[i];
            (1.0 / MOST_SPREAD..=MOST_SPREAD).contains(&ratio)
        });
        // The natural order is tried, whatever is missing of the replica.
        if !fits && order != [0, 1, 2] {
            continue;
        }
        for signs in 0..8 {
            let sign = |i: usize| if signs >> i & 1 == 0 { 1.0 } else { -1.0 };
            let column = |i: usize| from.column(order[i]) * sign(i);
            let from = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            if from.determinant() < 0.0 {
                continue;
            }
            for turn in 0..N_TURNS {
                let angle = std::f64::consts::TAU * turn as f64 / N_TURNS as f64;
                let about = nalgebra::Unit::new_normalize(to.column(0).into_owned());
                let rotation = Rotation3::from_axis_angle(&about, angle)
                    * Rotation3::from_matrix_unchecked(to * from.transpose());
                let translation = model.moments.centre().coords - rotation * centre.coords;
                starts.push(Pose { rotation, translation, scale: 1.0 });
            }
        }
    }
    starts
}

/// Principal axes as the columns of a rotation, the longest first, and the spreads along them, mm.
fn axes(covariance: Matrix3<f64>) -> (Matrix3<f64>, [f64; 3]) {
    let eigen = covariance.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let column = |i: usize| eigen.eigenvectors.column(order[i]).into_owned();
    let third = column(0).cross(&column(1));
    let spread = order.map(|i| eigen.eigenvalues[i].max(1e-6).sqrt());
    (Matrix3::from_columns(&[column(0), column(1), third]), spread)
}

fn distance(model: &Model, p: &SurfacePoint, pose: &Pose) -> Option<(Point3, super::model::Hit)> {
    let q = pose.apply(p.at);
    model.near(q, pose.rotate(p.normal)).map(|hit| (q, hit))
}

fn assessed(model: &Model, points: &[SurfacePoint], pose: Pose, on_model_mm: f64) -> Fit {
    let off: Vec<f64> = points
        .iter()
        .map(|p| distance(model, p, &pose).map_or(FAR_MM, |(_, h)| h.distance_mm.abs().min(FAR_MM)))
        .collect();
    let n = off.len().max(1) as f64;
    Fit {
        pose,
        off_mm: off.iter().sum::<f64>() / n,
        on_model: off.iter().filter(|d| **d <= on_model_mm).count() as f64 / n,
    }
}

/// Unknowns of a step: turn, shift, growth; an even offset of both skins (a level that is a little off); a stretch of the heights, and an
/// offset of either skin.
const N: usize = 11;
const GROWTH: usize = 6;

/// Which of them a step has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Freedom {
    /// Turn and shift.
    Rigid,
    /// Growth as well, and the offset that must not be taken for it.
    Similar,
    /// Growth beside all else that may look like it: a wall too thin, heights too large.
    Growth,
}

impl Freedom {
    const fn has(self, i: usize) -> bool {
        match self {
            Self::Rigid => i < GROWTH,
            Self::Similar => i <= GROWTH + 1,
            Self::Growth => i != GROWTH + 1,
        }
    }
}

type MatrixN = SMatrix<f64, N, N>;
type VectorN = SVector<f64, N>;

/// The weighted normal equations of a step, about `centre`.
#[derive(Debug, Clone, Copy)]
struct System {
    own: MatrixN,
    right: VectorN,
    centre: Point3,
    /// Robust standard deviation of the distances, mm.
    scatter_mm: f64,
    /// Weighted sum of squares, and the number of places that count.
    squares: f64,
    weight: f64,
    n_counting: usize,
    n: usize,
}

fn system(model: &Model, points: &[SurfacePoint], pose: &Pose, least_width_mm: f64) -> Option<System> {
    let hits: Vec<(Point3, super::model::Hit)> =
        points.par_iter().filter_map(|p| distance(model, p, pose)).collect();
    let mut off: Vec<f64> = hits.iter().map(|(_, h)| h.distance_mm.abs()).collect();
    if off.len() < 12 {
        return None;
    }
    off.sort_by(f64::total_cmp);
    let scatter_mm = (crate::report::deviation::quantile(&off, CLOSER) / CLOSER_NORMAL).max(1e-4);
    let width = (TUKEY * scatter_mm).max(least_width_mm);
    let centre = Point3::from(hits.iter().map(|(q, _)| q.coords).sum::<Vector3>() / hits.len() as f64);
    let mut system = System {
        own: MatrixN::zeros(),
        right: VectorN::zeros(),
        centre,
        scatter_mm,
        squares: 0.0,
        weight: 0.0,
        n_counting: 0,
        n: points.len(),
    };
    for (q, hit) in &hits {
        let ratio = hit.distance_mm / width;
        if ratio.abs() >= 1.0 {
            continue;
        }
        let weight = (1.0 - ratio * ratio).powi(2);
        let arm = q - centre;
        let turn = arm.cross(&hit.normal);
        let n = hit.normal;
        let [outer, lumen] = hit.on_skin;
        let row = VectorN::from([
            turn.x,
            turn.y,
            turn.z,
            n.x,
            n.y,
            n.z,
            n.dot(&arm),
            1.0,
            n.z * arm.z,
            outer,
            lumen,
        ]);
        system.own += row * row.transpose() * weight;
        system.right -= row * (weight * hit.distance_mm);
        system.squares += weight * hit.distance_mm * hit.distance_mm;
        system.weight += weight;
        system.n_counting += 1;
    }
    (system.n_counting > N).then_some(system)
}

impl System {
    /// What has no part in a step stays where it is.
    fn fixed(mut self, freedom: Freedom) -> Self {
        for i in (0..N).filter(|i| !freedom.has(*i)) {
            self.own.fixed_view_mut::<N, 1>(0, i).fill(0.0);
            self.own.fixed_view_mut::<1, N>(i, 0).fill(0.0);
            self.own[(i, i)] = 1.0;
            self.right[i] = 0.0;
        }
        self
    }

    fn step(self, freedom: Freedom) -> Option<VectorN> {
        let Self { mut own, right, .. } = self.fixed(freedom);
        // What the shape leaves free stays where it is.
        own += MatrixN::identity() * (1e-9 * own.trace());
        own.cholesky().map(|c| c.solve(&right))
    }

    /// Covariance of the step, each place counting by itself.
    fn covariance(self, freedom: Freedom) -> Option<MatrixN> {
        let sd = self.scatter_mm;
        let own = self.fixed(freedom).own;
        (own + MatrixN::identity() * (1e-12 * own.trace())).try_inverse().map(|m| m * (sd * sd))
    }
}

/// Steps until nothing moves. The weights begin `wide_mm` wide and become narrower: an end of a straight part is far off at first,
/// and alone tells how far along it lies.
fn improved(
    model: &Model,
    points: &[SurfacePoint],
    mut pose: Pose,
    freedom: Freedom,
    [wide_mm, most_steps]: [f64; 2],
) -> Pose {
    let reach_mm = model.corners().iter().map(|c| (c - model.moments.centre()).norm()).fold(1.0, f64::max);
    let mut width_mm = wide_mm;
    let mut n_steps = 0.0;
    while n_steps < most_steps {
        let Some(system) = system(model, points, &pose, width_mm) else { return pose };
        let is_narrow = width_mm <= TUKEY * system.scatter_mm;
        let centre = system.centre;
        let Some(x) = system.step(freedom) else { return pose };
        let (turn, shift) = (Vector3::new(x[0], x[1], x[2]), Vector3::new(x[3], x[4], x[5]));
        pose = pose.moved(centre, turn, shift, x[GROWTH]);
        if is_narrow && shift.norm() + reach_mm * (turn.norm() + x[GROWTH].abs()) < SETTLED_MM {
            return pose;
        }
        width_mm *= NARROWER;
        n_steps += 1.0;
    }
    pose
}

/// The rigid pose from all places. A part whose layers were shifted fits by no pose: where the lower or the upper places alone
/// lead to a pose that fits the closer ones distinctly better, it is that one.
fn rigid(model: &Model, points: &[SurfacePoint], start: &Pose) -> Pose {
    let heights: Vec<f64> = points.iter().map(|p| start.apply(p.at).z).collect();
    let mut sorted = heights.clone();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| crate::report::deviation::quantile(&sorted, part);
    let (lower, upper) = (at(PART), at(1.0 - PART));
    let only = |keep: &dyn Fn(f64) -> bool| -> Vec<SurfacePoint> {
        points.iter().zip(&heights).filter(|(_, z)| keep(**z)).map(|(p, _)| *p).collect()
    };
    let scatter = |pose: &Pose| system(model, points, pose, 0.0).map_or(f64::INFINITY, |s| s.scatter_mm);
    let whole = improved(model, points, *start, Freedom::Rigid, [WIDE_MM, MOST_STEPS]);
    // From the part alone: of a shifted other part, what lies along the shift would draw it aside again.
    let parts = [only(&|z| z <= lower), only(&|z| z >= upper)]
        .map(|part| improved(model, &part, *start, Freedom::Rigid, [WIDE_MM, MOST_STEPS]));
    let all =
        [(whole, DISTINCT * scatter(&whole)), (parts[0], scatter(&parts[0])), (parts[1], scatter(&parts[1]))];
    all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(whole, |best| best.0)
}

/// The final pose from all places, and what is known about it. The mirror image is laid over the same model by the same places,
/// so that the two distances can be compared.
fn settled(
    model: &Model,
    points: &[SurfacePoint],
    (start, mirrored_start): (&Pose, Option<Pose>),
    on_model_mm: f64,
) -> Registered {
    let pose = rigid(model, points, start);
    let of_mirrored = mirrored_start.map(|start| {
        let points = mirrored(points);
        let pose = rigid(model, &points, &start);
        (pose, assessed(model, &points, pose, on_model_mm).off_mm)
    });
    let similar = improved(model, points, pose, Freedom::Similar, [0.0, MOST_STEPS]);
    let about =
        Point3::from(points.iter().map(|p| p.at.coords).sum::<Vector3>() / points.len().max(1) as f64);
    let fit_of = |pose: &Pose| system(model, points, pose, 0.0);
    let at_similar = fit_of(&similar);
    let covariance = at_similar.and_then(|s| s.covariance(Freedom::Similar));
    let scale_sd = covariance.map_or(f64::INFINITY, |c| c[(GROWTH, GROWTH)].max(0.0).sqrt());
    // A wall too thin, or heights too large, look like growth until they may be what they are.
    let left = at_similar.and_then(|s| s.step(Freedom::Growth)).map_or(0.0, |x| x[GROWTH].abs());
    let is_size = left < SAME_GROWTH * (similar.scale - 1.0).abs();
    let is_scaled = is_scale(similar.scale - 1.0, scale_sd) && is_size;
    let is_told = is_scaled || !is_scale(similar.scale - 1.0, scale_sd);
    // A replica of another size lies evenly about the middle; one of the right size where it fits best.
    let pose = if is_scaled { similar.rigid(about) } else { pose };
    let shown = fit_of(if is_scaled { &similar } else { &pose });
    let pose_mm = shown.as_ref().and_then(|s| pose_sd_mm(model, s)).unwrap_or(f64::INFINITY);
    Registered {
        pose,
        similar: if is_told { similar } else { pose },
        scale_sd: if is_told { scale_sd } else { f64::INFINITY },
        scatter_mm: shown.as_ref().map_or(f64::INFINITY, |s| s.scatter_mm),
        rms_mm: shown.as_ref().map_or(f64::INFINITY, |s| (s.squares / s.weight).sqrt()),
        fitted_part: shown.as_ref().map_or(0.0, |s| s.n_counting as f64 / s.n as f64),
        pose_mm,
        off_mm: assessed(model, points, pose, on_model_mm).off_mm,
        mirrored: of_mirrored.map(|(pose, _)| pose),
        mirrored_off_mm: of_mirrored.map_or(f64::INFINITY, |(_, off_mm)| off_mm),
    }
}

/// A growth is one where no more than this part of it is left for what else may look like it.
const SAME_GROWTH: f64 = 0.5;
/// Smaller changes of scale are none, as a part.
const LEAST_SCALE: f64 = 0.002;

fn is_scale(change: f64, sd: f64) -> bool {
    change.abs() > (5.0 * sd).max(LEAST_SCALE)
}

impl Registered {
    /// The scale of the replica in percent, where it is not that of the model.
    pub(super) fn scaled_percent(&self) -> Option<f64> {
        let of_replica = 1.0 / self.similar.scale - 1.0;
        is_scale(self.similar.scale - 1.0, self.scale_sd).then_some(100.0 * of_replica)
    }
}

/// How far the pose leaves a corner of the model uncertain.
fn pose_sd_mm(model: &Model, system: &System) -> Option<f64> {
    let all = system.covariance(Freedom::Similar)?;
    let covariance = all.fixed_view::<6, 6>(0, 0).into_owned();
    let at = |corner: &Point3| {
        let arm = (corner - system.centre).cross_matrix();
        let mut map = SMatrix::<f64, 3, 6>::zeros();
        map.fixed_view_mut::<3, 3>(0, 0).copy_from(&-arm);
        map.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        (map * covariance * map.transpose()).trace().max(0.0).sqrt()
    };
    model.corners().iter().map(at).reduce(f64::max)
}
