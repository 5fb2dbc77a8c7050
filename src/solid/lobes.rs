//! The field of a split: the daughters' shapes carried through the planes around it and joined by a smooth
//! minimum, so that the sections on both sides say where the crotch lies.
//!
//! Lobe i is the signed distance G_i of daughter i at its first plane, moved and scaled:
//! f_i(x, w) = s G_i((x - C_i - d) / s + C_i) with d, s smooth in w (the height, rising towards the daughters).
//! Lobes are joined by smin(a, b) = min(a, b) - max(k - |a - b|, 0)² / (4 k). On daughter planes d and s come
//! from centroid and area; on the parent's planes, and k, from a least-squares fit to the parent's contour with a
//! weak prior on the extrapolated motion. What the fit leaves is added back by inverse-distance weights on the
//! contours of the planes beside the event and interpolated in w, so that the given sections are reproduced.

use super::event::{EventPlanes, EventSource, Plane};
use super::fit::least_squares;
use super::iso;
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use crate::spline::{Basis, ClosedCurve};

/// Points on a contour at which the fit is measured.
const FIT_POINTS: usize = 128;
/// Points on a contour from which the correction is extended.
const CORRECTION_POINTS: usize = 192;
/// Vertices of the polygon whose signed distance is the template: its chords are 1e-4 of the radius off.
const TEMPLATE_POINTS: usize = 512;
/// Gap between daughters, relative to their radius, below which their first plane already shows the blend.
const BLENDING_GAP: f64 = 0.3;
/// Blending radius that the prior expects, relative to the daughters' radius.
const EXPECTED_BLEND: f64 = 0.3;

/// Shift and scale of a lobe: dx, dy, s.
const PARAMS: usize = 3;

#[derive(Debug, Clone)]
struct Lobe {
    template: SegmentIndex,
    centre: Point2,
    area_mm2: f64,
}

impl Lobe {
    fn local(&self, p: Point2, params: &[f64]) -> Point2 {
        let shift = Vector2::new(params[0], params[1]);
        self.centre + (p - self.centre - shift) / params[2]
    }

    fn value(&self, p: Point2, params: &[f64]) -> f64 {
        params[2] * self.template.signed_distance_mm(self.local(p, params))
    }
}

#[derive(Debug, Clone)]
struct Correction {
    w: f64,
    points: Vec<Point2>,
    residuals: Vec<f64>,
    softening_mm2: f64,
    params: Vec<f64>,
}

impl Correction {
    /// Inverse-distance extension; the softening keeps it smooth at the points themselves.
    fn at(&self, p: Point2) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (q, r) in self.points.iter().zip(&self.residuals) {
            let d = (p - q).norm_squared() + self.softening_mm2;
            let w = 1.0 / (d * d);
            sum += w * r;
            weights += w;
        }
        sum / weights
    }
}

/// The field of one event.
#[derive(Debug, Clone)]
pub(super) struct LobeField {
    lobes: Vec<Lobe>,
    basis: Basis,
    control: Vec<f64>,
    blend_mm: f64,
    corrections: Vec<Correction>,
}

impl LobeField {
    /// Fits the field. `None` where a contour is degenerate.
    pub(super) fn fit(planes: &EventPlanes) -> Option<Self> {
        let radius = planes.mean_radius_mm();
        let blended = planes.daughters.len() > 1 && gap_mm(&planes.daughters[0]) < BLENDING_GAP * radius;
        let template_plane = &planes.daughters[usize::from(blended)];
        let lobes: Vec<Lobe> = template_plane.contours.iter().map(lobe).collect::<Option<_>>()?;
        let known: Vec<(f64, Vec<f64>)> = planes.daughters[usize::from(blended)..]
            .iter()
            .map(|plane| (plane.w, placed(&lobes, plane)))
            .collect();
        let mut fitter = Fitter { lobes: &lobes, radius, known };
        let mut unknown: Vec<&Plane> = vec![&planes.parents[0]];
        if blended {
            unknown.insert(0, &planes.daughters[0]);
        }
        let blend_mm = fitter.fit_with_blend(&unknown);
        for parent in &planes.parents[1..] {
            fitter.fit_plane(parent, blend_mm);
        }
        let mut known = fitter.known;
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let sites: Vec<f64> = known.iter().map(|k| k.0).collect();
        let rows: Vec<f64> = known.iter().flat_map(|k| k.1.iter().copied()).collect();
        let basis = Basis::not_a_knot(&sites).ok()?;
        let control = basis.interpolate(&sites, &rows, PARAMS * lobes.len());
        let mut field = Self { lobes, basis, control, blend_mm, corrections: Vec::new() };
        field.corrections = field.residual_corrections(planes);
        Some(field)
    }

    /// Corrections on the two planes nearest to the event on either side.
    fn residual_corrections(&self, planes: &EventPlanes) -> Vec<Correction> {
        let near = planes.parents.iter().take(2).chain(planes.daughters.iter().take(2));
        let mut corrections: Vec<Correction> = near
            .map(|plane| {
                let params = self.params(plane.w);
                let points = contour_points(plane, CORRECTION_POINTS);
                let residuals = points.iter().map(|&p| -self.joined(p, &params).0).collect();
                let spacing =
                    plane.contours.iter().map(Contour::perimeter_mm).sum::<f64>() / CORRECTION_POINTS as f64;
                Correction { w: plane.w, points, residuals, softening_mm2: (0.4 * spacing).powi(2), params }
            })
            .collect();
        corrections.sort_by(|a, b| a.w.total_cmp(&b.w));
        corrections
    }

    fn params(&self, w: f64) -> Vec<f64> {
        let mut params = Vec::new();
        Basis::combine(self.basis.at(w), &self.control, PARAMS * self.lobes.len(), &mut params);
        params
    }

    /// The smooth minimum and each lobe's own value.
    fn joined(&self, p: Point2, params: &[f64]) -> (f64, Vec<f64>) {
        let values = lobe_values(&self.lobes, p, params);
        (values.iter().copied().reduce(|a, b| smin(a, b, self.blend_mm)).unwrap_or(f64::INFINITY), values)
    }

    /// The field at (p, w), mm: negative inside.
    pub(super) fn value(&self, p: Point2, w: f64) -> f64 {
        self.at(w).value(p)
    }

    /// The field at one height, with what depends on the height alone computed once.
    pub(super) fn at(&self, w: f64) -> FieldAt<'_> {
        FieldAt { field: self, params: self.params(w), weights: self.correction_weights(w) }
    }

    /// Middle of lobe i at height w.
    pub(super) fn anchor(&self, i: usize, w: f64) -> Point2 {
        let params = self.params(w);
        self.lobes[i].centre + Vector2::new(params[PARAMS * i], params[PARAMS * i + 1])
    }

    /// Lagrange weights of the corrections, clamped beyond the outermost ones.
    fn correction_weights(&self, w: f64) -> Vec<f64> {
        let c = &self.corrections;
        let w = w.clamp(c[0].w, c[c.len() - 1].w);
        let others = |j: usize| c.iter().enumerate().filter(move |(m, _)| *m != j);
        (0..c.len()).map(|j| others(j).map(|(_, o)| (w - o.w) / (c[j].w - o.w)).product()).collect()
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
    /// The field at a point, mm.
    pub(super) fn value(&self, p: Point2) -> f64 {
        let (joined, values) = self.field.joined(p, &self.params);
        let nearest = values.iter().copied().fold(f64::INFINITY, f64::min);
        let soft: Vec<f64> = values.iter().map(|v| (-(v - nearest) / self.field.blend_mm).exp()).collect();
        let whole: f64 = soft.iter().sum();
        let mut sum = joined;
        for (i, share) in soft.iter().enumerate() {
            // A lobe this faint adds less than 1e-6 of a residual that is itself a fraction of a millimetre.
            if share / whole < 1e-6 {
                continue;
            }
            let lobe = &self.field.lobes[i];
            let local = lobe.local(p, &self.params[PARAMS * i..]) - lobe.centre;
            for (correction, weight) in self.field.corrections.iter().zip(&self.weights) {
                if weight.abs() < 1e-9 {
                    continue;
                }
                let there = &correction.params[PARAMS * i..];
                let at = lobe.centre + Vector2::new(there[0], there[1]) + local * there[2];
                sum += share / whole * weight * correction.at(at);
            }
        }
        sum
    }
}

/// smin(a, b) = min(a, b) - max(k - |a - b|, 0)² / (4 k).
fn smin(a: f64, b: f64, k: f64) -> f64 {
    let overlap = (k - (a - b).abs()).max(0.0);
    a.min(b) - overlap * overlap / (4.0 * k)
}

fn lobe_values(lobes: &[Lobe], p: Point2, params: &[f64]) -> Vec<f64> {
    lobes.iter().zip(params.chunks_exact(PARAMS)).map(|(l, c)| l.value(p, c)).collect()
}

fn lobe(contour: &Contour) -> Option<Lobe> {
    let fine = Contour::new(ClosedCurve::through(contour)?.resampled(TEMPLATE_POINTS, 0.0));
    let template = SegmentIndex::try_new(std::slice::from_ref(&fine))?;
    Some(Lobe { template, centre: fine.centroid(), area_mm2: fine.signed_area_mm2() })
}

/// Shifts and scales that put the lobes onto a daughter plane's contours, by centroid and area.
fn placed(lobes: &[Lobe], plane: &Plane) -> Vec<f64> {
    let place = |(lobe, contour): (&Lobe, &Contour)| {
        let shift = contour.centroid() - lobe.centre;
        [shift.x, shift.y, (contour.signed_area_mm2() / lobe.area_mm2).sqrt()]
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
        // A parabola may run off where planes are far apart; a lobe never shrinks to nothing or doubles in a step.
        sum.iter_mut().skip(2).step_by(PARAMS).for_each(|s| *s = s.clamp(0.4, 2.0));
        sum
    }

    /// Weak priors: 0.15 for a shift of a third of the radius and a change in scale of 0.3.
    fn prior(&self, params: &[f64], expected: &[f64], out: &mut Vec<f64>) {
        let unit = self.radius / 3.0;
        for (i, (p, e)) in params.iter().zip(expected).enumerate() {
            let scale = if i % PARAMS == 2 { 0.3 / unit } else { 1.0 };
            out.push(0.15 * (p - e) / scale);
        }
    }

    /// Fits the unknown planes together with the blending radius, which is returned.
    fn fit_with_blend(&mut self, planes: &[&Plane]) -> f64 {
        let n = PARAMS * self.lobes.len();
        let expected: Vec<Vec<f64>> = planes.iter().map(|p| self.extrapolated(p.w)).collect();
        let points: Vec<Vec<Point2>> = planes.iter().map(|p| contour_points(p, FIT_POINTS)).collect();
        let expected_blend = (EXPECTED_BLEND * self.radius).ln();
        let mut start: Vec<f64> = expected.concat();
        start.push(expected_blend);
        let solution = least_squares(&start, |x, out| {
            let blend = x[n * planes.len()].clamp(expected_blend - 5.0, expected_blend + 3.0).exp();
            for (k, at) in points.iter().enumerate() {
                let params = &x[n * k..n * (k + 1)];
                self.residuals(at, params, blend, out);
                self.prior(params, &expected[k], out);
            }
            out.push(0.1 * self.radius / 3.0 * (x[n * planes.len()] - expected_blend));
        });
        for (k, plane) in planes.iter().enumerate() {
            self.known.push((plane.w, solution[n * k..n * (k + 1)].to_vec()));
        }
        solution[n * planes.len()].clamp(expected_blend - 5.0, expected_blend + 3.0).exp()
    }

    /// Fits one further plane with the blending radius given.
    fn fit_plane(&mut self, plane: &Plane, blend: f64) {
        let expected = self.extrapolated(plane.w);
        let points = contour_points(plane, FIT_POINTS);
        let solution = least_squares(&expected, |x, out| {
            self.residuals(&points, x, blend, out);
            self.prior(x, &expected, out);
        });
        self.known.push((plane.w, solution));
    }

    fn residuals(&self, points: &[Point2], params: &[f64], blend: f64, out: &mut Vec<f64>) {
        let mut safe = params.to_vec();
        safe.iter_mut().skip(2).step_by(PARAMS).for_each(|s| *s = s.max(0.05));
        for &p in points {
            let values = lobe_values(self.lobes, p, &safe);
            out.push(values.into_iter().reduce(|a, b| smin(a, b, blend)).unwrap_or(0.0));
        }
    }
}

/// The field of fitted lobes as an event's source.
#[derive(Debug)]
pub(super) struct LobeSource {
    field: LobeField,
    bounds: Bounds2,
    step_mm: f64,
}

impl LobeSource {
    /// Fits the field to the planes of an event. `None` where a contour is degenerate.
    pub(super) fn fit(planes: &EventPlanes) -> Option<Self> {
        let radius = |c: &Contour| (c.signed_area_mm2() / std::f64::consts::PI).sqrt();
        let least_radius = planes.daughters[0].contours.iter().map(radius).fold(f64::INFINITY, f64::min);
        Some(Self {
            field: LobeField::fit(planes)?,
            bounds: planes.bounds()?.grown(0.5 * planes.mean_radius_mm()),
            // Fine enough for the smallest daughter and for the gap at the apex.
            step_mm: least_radius / 18.0,
        })
    }
}

impl EventSource for LobeSource {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.field.value(p, w)
    }

    fn contours(&self, w: f64) -> Vec<Contour> {
        let at = self.field.at(w);
        let mut contours = iso::contours(&|p| at.value(p), self.bounds, self.step_mm);
        contours.retain(|c| c.signed_area_mm2() > self.step_mm * self.step_mm);
        contours
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        let at = self.field.at(w);
        iso::project(&|p| at.value(p), p, self.step_mm)
    }

    fn anchor(&self, i: usize, w: f64) -> Point2 {
        self.field.anchor(i, w)
    }
}
