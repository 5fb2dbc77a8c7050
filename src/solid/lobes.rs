//! The field of a split: the daughters' shapes carried through the planes around it and joined by a smooth
//! minimum, so that the sections on both sides say where the crotch lies.
//!
//! Lobe i is the signed distance G_i of daughter i at its first plane, moved and scaled:
//! f_i(x, w) = s G_i((x - C_i - d) / s + C_i) with d, s smooth in w (the height, rising towards the daughters).
//! Lobes are joined by a smooth minimum of radius k and roundness c (see [`Blend`]). On daughter planes d and s come
//! from centroid and area; on the parent's planes, and k and c, from a least-squares fit to the parent's contour with
//! a weak prior on the extrapolated motion. What the fit leaves is added back by inverse-distance weights on the
//! contours of the planes beside the event and interpolated in w, so that the given sections are reproduced.
//!
//! Templates and corrections are sampled once on grids ([`SmoothGrid`]), so that the field with its gradient costs
//! about a tenth of a microsecond.

use super::event::{EventPlanes, EventSource, Frame, Plane};
use super::fit::{Normal, least_squares};
use super::grid::{Jet, SmoothGrid, bounded_step_mm};
use super::iso;
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use crate::spline::{Basis, ClosedCurve};
use rayon::prelude::*;

/// Points on a contour at which the fit is measured.
const FIT_POINTS: usize = 128;
/// Points on a contour from which the correction is extended.
const CORRECTION_POINTS: usize = 192;
/// Vertices of the polygon whose signed distance is the template: its chords are 1e-4 of the radius off.
const TEMPLATE_POINTS: usize = 512;
/// Steps of a template's grid to its radius, and how far the grid reaches beyond the contour, in radii: where other
/// lobes and the crotch lie. Farther off the distance is computed.
const TEMPLATE_STEPS: f64 = 16.0;
const TEMPLATE_REACH: f64 = 1.2;
/// The same for a correction.
const CORRECTION_STEPS: f64 = 12.0;
const CORRECTION_REACH: f64 = 0.5;
/// Steps of the contours' grid to the smallest daughter's radius.
const CONTOUR_STEPS: f64 = 18.0;
/// Planes where the daughters have joined again that tell how they come there.
const REJOINED_PLANES: usize = 2;
/// Planes on either side of an event that are corrected.
const CORRECTED_PLANES: usize = 3;
/// Times that a correction is itself corrected by what it leaves at the contour's points.
const CORRECTION_ROUNDS: usize = 2;
/// Gap between daughters, relative to their radius, below which their first plane already shows the blend.
const BLENDING_GAP: f64 = 0.45;
/// Blending radius that the prior expects, relative to the daughters' radius.
const EXPECTED_BLEND: f64 = 0.3;
/// Roundness that the prior expects, its weight per mm of a third of the radius, and how far it may be from there:
/// at 0 the blend is a cubic, at 1/2 it would be flat in its middle.
const EXPECTED_ROUNDNESS: f64 = 0.25;
const ROUNDNESS_PRIOR: f64 = 0.3;
const MOST_ROUNDNESS: f64 = 0.4;

/// How far the logarithm of the blending radius may lie below and above the expected one: a crotch sharper than a
/// fiftieth of the radius is not resolved.
const LEAST_LN_BLEND: f64 = 2.7;
const MOST_LN_BLEND: f64 = 3.0;
/// How far the blend may lower the field in the middle between the daughters, as a fraction of half their gap: with
/// all of it they would be joined there.
const MOST_BLEND: f64 = 0.95;
/// Drop over the blending radius from which on a flatter blend may reach no farther: it would reach a third daughter.
const MOST_REACH: f64 = 0.25;
/// An extrapolated shift may exceed that of the step before by this fraction of the radius.
const MOST_ACCELERATION: f64 = 0.1;
/// A lobe never becomes smaller than this fraction of its template.
const LEAST_SCALE: f64 = 0.05;

/// Shift and scale of a lobe: dx, dy, s.
const PARAMS: usize = 3;

#[derive(Debug, Clone)]
struct Lobe {
    distance: SmoothGrid,
    /// For points off the grid.
    outline: SegmentIndex,
    centre: Point2,
    area_mm2: f64,
}

impl Lobe {
    fn of(contour: &Contour) -> Option<Self> {
        let fine = Contour::new(ClosedCurve::through(contour)?.resampled(TEMPLATE_POINTS, 0.0));
        let outline = SegmentIndex::try_new(std::slice::from_ref(&fine))?;
        let area_mm2 = fine.signed_area_mm2();
        let radius = radius_mm(area_mm2);
        let bounds = fine.bounds()?.grown(TEMPLATE_REACH * radius);
        let step_mm = bounded_step_mm(bounds, radius / TEMPLATE_STEPS);
        let distance = SmoothGrid::sampled(bounds, step_mm, |p| outline.signed_distance_mm(p));
        Some(Self { distance, outline, centre: fine.centroid(), area_mm2 })
    }

    /// The template's distance and its gradient.
    fn template(&self, p: Point2) -> Jet {
        // The grid reaches beyond the outline: off it all is outside.
        self.distance.jet(p).unwrap_or_else(|| {
            let foot = self.outline.nearest(p);
            Jet { value: foot.distance_mm, slope: (p - foot.point) / foot.distance_mm.max(1e-12) }
        })
    }

    fn local(&self, p: Point2, params: &[f64]) -> Point2 {
        let shift = Vector2::new(params[0], params[1]);
        self.centre + (p - self.centre - shift) / params[2]
    }

    fn jet(&self, p: Point2, params: &[f64]) -> Jet {
        let template = self.template(self.local(p, params));
        Jet { value: params[2] * template.value, slope: template.slope }
    }

    /// Value and derivatives by dx, dy and s.
    fn derivatives(&self, p: Point2, params: &[f64]) -> (f64, [f64; PARAMS]) {
        let local = self.local(p, params);
        let Jet { value, slope } = self.template(local);
        (params[2] * value, [-slope.x, -slope.y, value - slope.dot(&(local - self.centre))])
    }
}

fn radius_mm(area_mm2: f64) -> f64 {
    (area_mm2.abs() / std::f64::consts::PI).sqrt()
}

/// What is added at one plane so that its contours are met: an inverse-distance extension of what the fit leaves
/// at the contour's points, sampled on a grid.
#[derive(Debug, Clone)]
struct Correction {
    w: f64,
    params: Vec<f64>,
    grid: SmoothGrid,
    /// For points off the grid: the mean of what the fit leaves.
    beyond: f64,
}

impl Correction {
    fn of(plane: &Plane, params: Vec<f64>, radius: f64, fitted: impl Fn(Point2) -> f64) -> Option<Self> {
        let points = contour_points(plane, CORRECTION_POINTS);
        let mut left: Vec<f64> = points.iter().map(|&p| -fitted(p)).collect();
        let whole: f64 = plane.contours.iter().map(Contour::perimeter_mm).sum();
        let softening_mm2 = (0.4 * whole / CORRECTION_POINTS as f64).powi(2);
        let bounds = Bounds2::of(points.iter().copied())?.grown(CORRECTION_REACH * radius);
        let beyond = left.iter().sum::<f64>() / left.len() as f64;
        let mut total = left.clone();
        let step_mm = bounded_step_mm(bounds, radius / CORRECTION_STEPS);
        let mut grid = SmoothGrid::sampled(bounds, step_mm, |p| extended(&points, &total, softening_mm2, p));
        for _ in 1..CORRECTION_ROUNDS {
            left = points.iter().map(|&p| -fitted(p) - grid.jet(p).map_or(beyond, |j| j.value)).collect();
            total.iter_mut().zip(&left).for_each(|(t, l)| *t += l);
            grid = SmoothGrid::sampled(bounds, step_mm, |p| extended(&points, &total, softening_mm2, p));
        }
        Some(Self { w: plane.w, params, grid, beyond })
    }

    fn jet(&self, p: Point2) -> Jet {
        self.grid.jet(p).unwrap_or(Jet { value: self.beyond, slope: Vector2::zeros() })
    }
}

/// Inverse-distance mean of the values at the points; the softening keeps it smooth at the points themselves.
fn extended(points: &[Point2], values: &[f64], softening_mm2: f64, p: Point2) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (q, value) in points.iter().zip(values) {
        let d = (p - q).norm_squared() + softening_mm2;
        let weight = 1.0 / (d * d);
        sum += weight * value;
        weights += weight;
    }
    sum / weights
}

/// The field of one event.
#[derive(Debug, Clone)]
pub(super) struct LobeField {
    lobes: Vec<Lobe>,
    basis: Basis,
    control: Vec<f64>,
    blend: Blend,
    corrections: Vec<Correction>,
    /// Of the spline in w through the corrections.
    correction_basis: Basis,
    /// One row a control point: the share that each correction has in it.
    correction_shares: Vec<f64>,
    /// A lobe that belongs to each daughter.
    lobe_of: Vec<usize>,
}

impl LobeField {
    /// Fits the field. `None` where a contour is degenerate.
    pub(super) fn fit(planes: &EventPlanes) -> Option<Self> {
        let radius = planes.mean_radius_mm();
        let known_side = planes.beyond.as_ref().map_or(&planes.daughters, |beyond| &beyond.planes);
        let blended = known_side.len() > 1
            && known_side[0].contours.len() > 1
            && gap_mm(&known_side[0]) < BLENDING_GAP * radius;
        let (blending, apart) = known_side.split_at(usize::from(blended));
        let lobes: Vec<Lobe> = apart[0].contours.par_iter().map(Lobe::of).collect::<Option<_>>()?;
        let known: Vec<(f64, Vec<f64>)> =
            apart.iter().map(|plane| (plane.w, placed(&lobes, plane))).collect();
        let most_drop_mm = if blended || planes.beyond.is_some() || lobes.len() < 2 {
            f64::INFINITY
        } else {
            MOST_BLEND * 0.5 * gap_mm(&planes.daughters[0])
        };
        let mut fitter = Fitter { lobes: &lobes, radius, most_drop_mm, known };
        let mut unknown: Vec<&Plane> = blending.iter().collect();
        unknown.extend(planes.beyond.as_ref().map(|_| &planes.daughters[0]));
        unknown.push(&planes.parents[0]);
        let blend = fitter.fit_with_blend(&unknown);
        for parent in planes.parents[1..].iter().chain(planes.rejoined.iter().take(REJOINED_PLANES)) {
            fitter.fit_plane(parent, blend);
        }
        let mut known = fitter.known;
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let sites: Vec<f64> = known.iter().map(|k| k.0).collect();
        let rows: Vec<f64> = known.iter().flat_map(|k| k.1.iter().copied()).collect();
        let basis = Basis::not_a_knot(&sites).ok()?;
        let control = basis.interpolate(&sites, &rows, PARAMS * lobes.len());
        let lobe_of = match &planes.beyond {
            Some(beyond) => (0..planes.daughters[0].contours.len())
                .map(|i| beyond.daughter_of.iter().position(|&d| d == i).unwrap_or(0))
                .collect(),
            None => (0..lobes.len()).collect(),
        };
        let mut field = Self {
            lobes,
            basis: basis.clone(),
            control,
            blend,
            corrections: Vec::new(),
            correction_basis: basis,
            correction_shares: Vec::new(),
            lobe_of,
        };
        field.corrections = field.residual_corrections(planes, radius)?;
        let sites: Vec<f64> = field.corrections.iter().map(|c| c.w).collect();
        let n = sites.len();
        let unit: Vec<f64> = (0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }).collect();
        field.correction_basis = Basis::not_a_knot(&sites).ok()?;
        field.correction_shares = field.correction_basis.interpolate(&sites, &unit, n);
        Some(field)
    }

    /// Corrections on the two planes nearest to the event on either side.
    fn residual_corrections(&self, planes: &EventPlanes, radius: f64) -> Option<Vec<Correction>> {
        let behind = planes.beyond.iter().flat_map(|beyond| beyond.planes.first());
        let near: Vec<&Plane> = planes
            .parents
            .iter()
            .take(CORRECTED_PLANES)
            .chain(planes.daughters.iter().take(CORRECTED_PLANES))
            .chain(behind)
            .collect();
        let mut corrections: Vec<Correction> = near
            .into_par_iter()
            .map(|plane| {
                let params = self.params(plane.w);
                Correction::of(plane, params.clone(), radius, |p| self.joined(p, &params))
            })
            .collect::<Option<_>>()?;
        corrections.sort_by(|a, b| a.w.total_cmp(&b.w));
        Some(corrections)
    }

    fn params(&self, w: f64) -> Vec<f64> {
        let mut params = Vec::new();
        Basis::combine(self.basis.at(w), &self.control, PARAMS * self.lobes.len(), &mut params);
        // Beyond the planes a spline may run off.
        params.iter_mut().skip(2).step_by(PARAMS).for_each(|s| *s = s.max(LEAST_SCALE));
        params
    }

    /// The smooth minimum of the lobes.
    fn joined(&self, p: Point2, params: &[f64]) -> f64 {
        let values = self.lobes.iter().zip(params.chunks_exact(PARAMS)).map(|(l, c)| l.jet(p, c));
        values.reduce(|a, b| self.blend.smin(a, b)).map_or(f64::INFINITY, |j| j.value)
    }

    /// The field at one height, with what depends on the height alone computed once.
    pub(super) fn at(&self, w: f64) -> FieldAt<'_> {
        FieldAt { field: self, params: self.params(w), weights: self.correction_weights(w) }
    }

    /// Middle of a lobe of daughter i at height w.
    pub(super) fn anchor(&self, i: usize, w: f64) -> Point2 {
        let params = self.params(w);
        let i = self.lobe_of[i];
        self.lobes[i].centre + Vector2::new(params[PARAMS * i], params[PARAMS * i + 1])
    }

    /// Weights of the corrections: the spline's through them, clamped beyond the outermost ones.
    fn correction_weights(&self, w: f64) -> Vec<f64> {
        let [low, high] = self.correction_basis.range();
        let mut weights = Vec::new();
        let span = self.correction_basis.at(w.clamp(low, high));
        Basis::combine(span, &self.correction_shares, self.corrections.len(), &mut weights);
        weights
    }
}

/// [`LobeField`] at one height.
#[derive(Debug)]
pub(super) struct FieldAt<'a> {
    field: &'a LobeField,
    params: Vec<f64>,
    weights: Vec<f64>,
}

impl FieldAt<'_> {
    /// The field and its gradient at a point.
    pub(super) fn jet(&self, p: Point2) -> Jet {
        let n = self.field.lobes.len();
        let mut few = [Jet { value: 0.0, slope: Vector2::zeros() }; 4];
        let mut many = Vec::new();
        let jets: &mut [Jet] = if n <= few.len() {
            &mut few[..n]
        } else {
            many.resize(n, few[0]);
            &mut many
        };
        for ((jet, lobe), params) in
            jets.iter_mut().zip(&self.field.lobes).zip(self.params.chunks_exact(PARAMS))
        {
            *jet = lobe.jet(p, params);
        }
        let blend = self.field.blend;
        let k = blend.radius_mm;
        let joined = jets.iter().copied().reduce(|a, b| blend.smin(a, b)).unwrap_or(jets[0]);
        let nearest = jets.iter().map(|j| j.value).fold(f64::INFINITY, f64::min);
        // The corrections of the lobes, weighted by exp(-f / k): sums of the weights and of what they weigh.
        let (mut whole, mut whole_slope) = (0.0, Vector2::zeros());
        let (mut sum, mut sum_slope) = (0.0, Vector2::zeros());
        for (i, jet) in jets.iter().enumerate() {
            let weight = (-(jet.value - nearest) / k).exp();
            // A lobe this faint adds less than 1e-6 of a residual that is itself a fraction of a millimetre.
            if weight < 1e-6 {
                continue;
            }
            let correction = self.correction(i, p);
            whole += weight;
            whole_slope -= jet.slope * (weight / k);
            sum += weight * correction.value;
            sum_slope += correction.slope * weight - jet.slope * (correction.value * weight / k);
        }
        let mean = sum / whole;
        Jet { value: joined.value + mean, slope: joined.slope + (sum_slope - whole_slope * mean) / whole }
    }

    /// The correction at this height, looked up where lobe i was on the planes.
    fn correction(&self, i: usize, p: Point2) -> Jet {
        let lobe = &self.field.lobes[i];
        let here = &self.params[PARAMS * i..];
        let local = lobe.local(p, here) - lobe.centre;
        let mut sum = Jet { value: 0.0, slope: Vector2::zeros() };
        for (correction, weight) in self.field.corrections.iter().zip(&self.weights) {
            if weight.abs() < 1e-9 {
                continue;
            }
            let there = &correction.params[PARAMS * i..];
            let jet = correction.jet(lobe.centre + Vector2::new(there[0], there[1]) + local * there[2]);
            sum.value += weight * jet.value;
            sum.slope += jet.slope * (weight * there[2] / here[2]);
        }
        sum
    }
}

/// How two lobes are joined: smin(a, b) = min(a, b) - k phi(h), h = max(1 - |a - b| / k, 0),
/// phi(h) = c h² + (1/2 - 2 c) h³ / 3. The slope of phi at 1 is 1/2, so that smin is C1 where a = b. The roundness c
/// is 1/4 for the usual quadratic blend, 0 for the cubic one; a circular fillet is met to a hundredth by 0.38.
#[derive(Debug, Clone, Copy)]
struct Blend {
    radius_mm: f64,
    roundness: f64,
}

/// How far a smooth minimum lies below the smaller value, and the derivatives.
struct Drop {
    mm: f64,
    /// Weight of the larger value's gradient.
    share: f64,
    by_radius: f64,
    by_roundness: f64,
}

impl Blend {
    fn drop(self, apart: f64) -> Drop {
        let h = (1.0 - apart / self.radius_mm).max(0.0);
        let cubic = (0.5 - 2.0 * self.roundness) / 3.0;
        let (value, share) =
            (h * h * (self.roundness + cubic * h), h * (2.0 * self.roundness + 3.0 * cubic * h));
        Drop {
            mm: self.radius_mm * value,
            share,
            by_radius: value + share * (1.0 - h),
            by_roundness: self.radius_mm * h * h * (1.0 - 2.0 / 3.0 * h),
        }
    }

    fn smin(self, a: Jet, b: Jet) -> Jet {
        let (low, high) = if a.value <= b.value { (a, b) } else { (b, a) };
        let Drop { mm, share, .. } = self.drop(high.value - low.value);
        Jet { value: low.value - mm, slope: low.slope * (1.0 - share) + high.slope * share }
    }
}

/// Shifts and scales that put the lobes onto a daughter plane's contours, by centroid and area.
fn placed(lobes: &[Lobe], plane: &Plane) -> Vec<f64> {
    let place = |(lobe, contour): (&Lobe, &Contour)| {
        let shift = contour.centroid() - lobe.centre;
        [shift.x, shift.y, (contour.signed_area_mm2() / lobe.area_mm2).abs().sqrt()]
    };
    lobes.iter().zip(&plane.contours).flat_map(place).collect()
}

/// Smallest distance between two contours of a plane.
fn gap_mm(plane: &Plane) -> f64 {
    let mut gap = f64::INFINITY;
    for (i, contour) in plane.contours.iter().enumerate() {
        let Some(index) = SegmentIndex::try_new(std::slice::from_ref(contour)) else { continue };
        for other in &plane.contours[i + 1..] {
            gap = other.points.iter().map(|&p| index.nearest(p).distance_mm).fold(gap, f64::min);
        }
    }
    gap
}

/// Points spread over all contours of a plane, by arc length.
fn contour_points(plane: &Plane, n_points: usize) -> Vec<Point2> {
    let whole: f64 = plane.contours.iter().map(Contour::perimeter_mm).sum();
    plane
        .contours
        .iter()
        .flat_map(|c| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a share of n_points"
            )]
            let n = ((n_points as f64 * c.perimeter_mm() / whole).round() as usize).max(16);
            ClosedCurve::through(c).map_or_else(|| c.points.clone(), |curve| curve.resampled(n, 0.0))
        })
        .collect()
}

struct Fitter<'a> {
    lobes: &'a [Lobe],
    /// Mean radius of the daughters: the unit in which the priors are stated.
    radius: f64,
    /// Drop in the middle between the daughters beyond which they would be joined although they are apart.
    most_drop_mm: f64,
    /// Heights and parameters found so far.
    known: Vec<(f64, Vec<f64>)>,
}

impl Fitter<'_> {
    /// Parameters extrapolated to w from the (at most three) nearest known planes.
    fn extrapolated(&self, w: f64) -> Vec<f64> {
        let mut near: Vec<&(f64, Vec<f64>)> = self.known.iter().collect();
        near.sort_by(|a, b| (a.0 - w).abs().total_cmp(&(b.0 - w).abs()));
        near.truncate(3);
        let weight = |j: usize| -> f64 {
            let others = near.iter().enumerate().filter(|(m, _)| *m != j);
            others.map(|(_, o)| (w - o.0) / (near[j].0 - o.0)).product()
        };
        let weights: Vec<f64> = (0..near.len()).map(weight).collect();
        let n = PARAMS * self.lobes.len();
        let mut sum: Vec<f64> =
            (0..n).map(|i| near.iter().zip(&weights).map(|(k, w)| w * k.1[i]).sum()).collect();
        // Nor may a lobe overtake another because its motion bends.
        if let [first, second, _] = near[..] {
            let share = (w - first.0) / (first.0 - second.0);
            for i in (0..n).filter(|i| i % PARAMS != 2) {
                let most = ((first.1[i] - second.1[i]) * share).abs() + MOST_ACCELERATION * self.radius;
                sum[i] = first.1[i] + (sum[i] - first.1[i]).clamp(-most, most);
            }
        }
        // A parabola may run off where planes are far apart; a lobe stays of its template's order of size.
        sum.iter_mut().skip(2).step_by(PARAMS).for_each(|s| *s = s.clamp(0.4, 2.0));
        sum
    }

    /// Weak priors: 0.15 for a shift of a third of the radius and a change in scale of 0.3.
    fn prior(&self, params: &[f64], expected: &[f64], first: usize, normal: &mut Normal) {
        let unit = self.radius / 3.0;
        for (i, (p, e)) in params.iter().zip(expected).enumerate() {
            let scale = if i % PARAMS == 2 { 0.3 / unit } else { 1.0 };
            normal.add(0.15 * (p - e) / scale, first + i, &[0.15 / scale]);
        }
    }

    /// Fits the unknown planes together with the blend, which is returned.
    fn fit_with_blend(&mut self, planes: &[&Plane]) -> Blend {
        let n = PARAMS * self.lobes.len();
        let last = n * planes.len();
        let expected: Vec<Vec<f64>> = planes.iter().map(|p| self.extrapolated(p.w)).collect();
        let points: Vec<Vec<Point2>> = planes.iter().map(|p| contour_points(p, FIT_POINTS)).collect();
        let expected_blend = (EXPECTED_BLEND * self.radius).ln();
        let blend_of = |x: &[f64]| {
            let off = (x[last] - expected_blend).clamp(-LEAST_LN_BLEND, MOST_LN_BLEND);
            // Three lobes joined one after the other do not tell the law of two.
            let free = if self.lobes.len() == 2 { x[last + 1] } else { EXPECTED_ROUNDNESS };
            let roundness = free.clamp(0.0, MOST_ROUNDNESS);
            let unit = Blend { radius_mm: 1.0, roundness }.drop(0.0).mm.max(MOST_REACH);
            Blend { radius_mm: (expected_blend + off).exp().min(self.most_drop_mm / unit), roundness }
        };
        let mut start: Vec<f64> = expected.concat();
        start.extend([expected_blend, EXPECTED_ROUNDNESS]);
        let solution = least_squares(&start, |x, normal| {
            let blend = blend_of(x);
            for (k, at) in points.iter().enumerate() {
                let params = &x[n * k..n * (k + 1)];
                self.residuals(at, params, blend, |value, slopes, by_blend| {
                    let more = [by_blend[0] * blend.radius_mm, by_blend[1]];
                    normal.add_with(value, n * k, slopes, last, &more);
                });
                self.prior(params, &expected[k], n * k, normal);
            }
            let weight = 0.1 * self.radius / 3.0;
            normal.add(weight * (x[last] - expected_blend), last, &[weight]);
            let weight = ROUNDNESS_PRIOR * self.radius / 3.0;
            normal.add(weight * (x[last + 1] - EXPECTED_ROUNDNESS), last + 1, &[weight]);
        });
        for (k, plane) in planes.iter().enumerate() {
            self.known.push((plane.w, solution[n * k..n * (k + 1)].to_vec()));
        }
        blend_of(&solution)
    }

    /// Fits one further plane with the blend given.
    fn fit_plane(&mut self, plane: &Plane, blend: Blend) {
        let expected = self.extrapolated(plane.w);
        let points = contour_points(plane, FIT_POINTS);
        let solution = least_squares(&expected, |x, normal| {
            self.residuals(&points, x, blend, |value, slopes, _| normal.add(value, 0, slopes));
            self.prior(x, &expected, 0, normal);
        });
        self.known.push((plane.w, solution));
    }

    /// The joined field at each point, its derivatives by the parameters and by the blend's radius and roundness.
    fn residuals(
        &self,
        points: &[Point2],
        params: &[f64],
        blend: Blend,
        mut add: impl FnMut(f64, &[f64], [f64; 2]),
    ) {
        let mut safe = params.to_vec();
        safe.iter_mut().skip(2).step_by(PARAMS).for_each(|s| *s = s.max(LEAST_SCALE));
        let mut slopes = vec![0.0; params.len()];
        for &p in points {
            let (mut joined, mut by_blend) = (f64::INFINITY, [0.0; 2]);
            for (i, (lobe, params)) in self.lobes.iter().zip(safe.chunks_exact(PARAMS)).enumerate() {
                let (value, own) = lobe.derivatives(p, params);
                let drop = blend.drop((joined - value).abs());
                let share = if value <= joined { 1.0 - drop.share } else { drop.share };
                joined = joined.min(value) - drop.mm;
                by_blend = [
                    by_blend[0] * (1.0 - share) - drop.by_radius,
                    by_blend[1] * (1.0 - share) - drop.by_roundness,
                ];
                slopes[..PARAMS * i].iter_mut().for_each(|s| *s *= 1.0 - share);
                (0..PARAMS).for_each(|k| slopes[PARAMS * i + k] = share * own[k]);
            }
            add(joined, &slopes, by_blend);
        }
    }
}

/// The field of fitted lobes as an event's source.
#[derive(Debug)]
pub(super) struct LobeSource {
    field: LobeField,
    frame: Frame,
}

impl LobeSource {
    /// Fits the field to the planes of an event. `None` where a contour is degenerate.
    pub(super) fn fit(planes: &EventPlanes) -> Option<Self> {
        let radius = |c: &Contour| radius_mm(c.signed_area_mm2());
        let least_radius = planes.daughters[0].contours.iter().map(radius).fold(f64::INFINITY, f64::min);
        let bounds = planes.bounds()?.grown(0.5 * planes.mean_radius_mm());
        let frame = Frame { bounds, step_mm: bounded_step_mm(bounds, least_radius / CONTOUR_STEPS) };
        Some(Self { field: LobeField::fit(planes)?, frame })
    }
}

impl EventSource for LobeSource {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.jet(p, w).value
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        self.field.at(w).jet(p)
    }

    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        let at = self.field.at(w);
        Box::new(move |p| at.jet(p))
    }

    fn frame(&self) -> Option<Frame> {
        Some(self.frame)
    }

    fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour> {
        iso::contours(&*self.slice(w), self.frame.bounds, self.frame.step_mm / finer)
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        iso::project(&*self.slice(w), p, self.frame.step_mm)
    }

    fn anchor(&self, i: usize, w: f64) -> Point2 {
        self.field.anchor(i, w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disk(p: Point2, x: f64, radius: f64) -> Jet {
        let to = p - Point2::new(x, 0.1 * x);
        Jet { value: to.norm() - radius, slope: to / to.norm().max(1e-12) }
    }

    /// Two disks that move apart with the height, joined by the law given.
    fn parting(law: impl Fn(Jet, Jet) -> Jet + Copy, w: f64) -> impl Fn(Point2) -> Jet {
        let x = 1.6 + 0.22 * (w + 6.0);
        move |p| law(disk(p, -x, 2.3), disk(p, x, 2.0))
    }

    fn circular(a: Jet, b: Jet) -> Jet {
        let k = 1.0 / (1.0 - 0.5f64.sqrt());
        let (low, high) = if a.value <= b.value { (a, b) } else { (b, a) };
        let h = (1.0 - (high.value - low.value) / k).max(0.0);
        let root = (1.0 - h * (h - 2.0)).sqrt();
        let share = 0.5 * (1.0 - (1.0 - h) / root);
        Jet {
            value: low.value - 0.5 * k * (1.0 + h - root),
            slope: low.slope * (1.0 - share) + high.slope * share,
        }
    }

    #[test]
    fn the_derivatives_of_a_blend_are_those_of_its_value() {
        const H: f64 = 1e-6;
        for roundness in [0.0, 0.25, 0.4] {
            for apart in [0.0, 0.3, 0.9, 1.3] {
                let at =
                    |radius_mm: f64, roundness: f64, apart: f64| Blend { radius_mm, roundness }.drop(apart);
                let drop = at(1.2, roundness, apart);
                let slope = |a: Drop, b: Drop| (a.mm - b.mm) / (2.0 * H);
                let by_radius = slope(at(1.2 + H, roundness, apart), at(1.2 - H, roundness, apart));
                let by_roundness = slope(at(1.2, roundness + H, apart), at(1.2, roundness - H, apart));
                let by_apart = slope(at(1.2, roundness, apart + 2.0 * H), at(1.2, roundness, apart)) * 1.0;
                assert!((drop.by_radius - by_radius).abs() < 1e-6);
                assert!((drop.by_roundness - by_roundness).abs() < 1e-6);
                assert!((drop.share + by_apart).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn crotches_of_any_blend_are_placed_by_the_sections_on_both_sides() {
        let sharp = |a: Jet, b: Jet| Blend { radius_mm: 0.3, roundness: 0.25 }.smin(a, b);
        let cubic = |a: Jet, b: Jet| Blend { radius_mm: 1.0, roundness: 0.0 }.smin(a, b);
        assert!(worst_between_planes(sharp) < 0.02);
        assert!(worst_between_planes(cubic) < 0.02);
        assert!(worst_between_planes(circular) < 0.04);
    }

    /// Farthest that the field fitted to planes 3 mm apart has its contours from the true ones between them.
    fn worst_between_planes(law: impl Fn(Jet, Jet) -> Jet + Copy) -> f64 {
        let bounds = Bounds2::of([Point2::new(-12.0, -6.0), Point2::new(12.0, 6.0)]).expect("two points");
        let plane = |w: f64| Plane { w, contours: iso::contours(&parting(law, w), bounds, 0.1) };
        let mut planes: Vec<Plane> = (-3..=6).map(|k| plane(3.0 * f64::from(k))).collect();
        planes.iter_mut().for_each(|p| p.contours.sort_by(|a, b| a.centroid().x.total_cmp(&b.centroid().x)));
        let first = planes.iter().position(|p| p.contours.len() == 2).expect("the disks part");
        let daughters = planes.split_off(first);
        planes.reverse();
        let event = [daughters[0].w - 3.0, daughters[0].w];
        let field =
            LobeField::fit(&EventPlanes { parents: planes, daughters, beyond: None, rejoined: Vec::new() })
                .expect("sound planes");
        let mut worst = 0.0f64;
        for share in [0.2, 0.4, 0.6, 0.8] {
            let w = event[0] + share * (event[1] - event[0]);
            let truth = parting(law, w);
            for contour in iso::contours(&|p| field.at(w).jet(p), bounds, 0.1) {
                worst = contour.points.iter().map(|&p| truth(p).value.abs()).fold(worst, f64::max);
            }
        }
        worst
    }
}
