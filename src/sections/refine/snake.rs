//! A closed active contour on the edge of the lumen (Kass, Witkin, Terzopoulos, Int. J. Computer Vision 1, 1988).
//!
//! External force: along the normal, towards the steepest fall of the grey values within reach, found below the pixel
//! on the profile filtered by the derivative of a Gaussian as wide as the blur (Canny, IEEE Trans. PAMI 8, 1986).
//! Internal force: that of a thin elastic rod, the fourth derivative along the curve. Each step is implicit in it. On a
//! closed curve of evenly spaced points the system is cyclic, so it is solved exactly, wave by wave. The mean and the
//! first wave, which make an ellipse, cost no energy: a round vessel is not shrunk.
//!
//! Behind a thin wall the grey value falls on, so that the steepest fall of the filtered profile lies outside the lumen's
//! edge: by how much follows from the levels of lumen, wall and tissue, the wall's thickness and the blur ([`Fall`]),
//! and is taken back.
//!
//! A contour starts from the one found in the plane below, brought to the place and size of its own first
//! contour, where that stays within reach of it; else from its own. From there it goes to the half level first: the steepest
//! fall is looked for near it, or noise far away would be taken for the edge.
//!
//! What it does not do: no balloon force, no change of topology; the planes are coupled by the start alone.
//!
//! Accuracy: without noise it is on the edge within a hundredth of a millimetre. Under noise the steepest fall is a poorer
//! witness than the half level: with noise of a tenth of the contrast and a thin wall its mean error is about twice that of the
//! half level, which is why it is offered and not the default. The table of the three boundaries is printed by
//! `cargo test --release --lib sections::accuracy::table -- --ignored --nocapture`.

use super::super::model::harmonics::Circle;
use super::super::model::{Levels, Optics};
use super::{Averaging, Curve, Image, LIMIT_PIXELS, Profiles, Target, fitted, shift, smoothed_offsets};
use crate::geom::{Contour, Point2, Vector2};

/// Waves longer than 2 pi times this many standard deviations of the blur are followed; what noise puts into them is taken out
/// afterwards, as for every boundary, by as much as the stack shows of it.
const STIFFNESS_BLURS: f64 = 0.3;
/// Implicit steps; the last ones move nothing by a thousandth of a pixel.
const N_STEPS: usize = 8;
/// Of several falls the steepest counts, less the farther it lies: by a Gaussian of this many standard deviations of the blur.
const ATTRACTION_BLURS: f64 = 1.0;
/// Halvings of the error of where the fall is steepest: below a hundredth of a percent of the blur.
const N_ITERATIONS: usize = 24;
/// The filter reaches this many of its standard deviations.
const FILTER_REACH: f64 = 3.0;
/// A step goes no farther than this part of the curve's radius: points never meet in the middle.
const FARTHEST_STEP: f64 = 0.35;
/// The filter is no wider than this part of the radius: else it would see the opposite side.
const WIDEST_FILTER: f64 = 0.3;
/// The fall is steepest no farther from the inner edge than this part of the blur, which is where the iteration contracts.
const MOST_SHIFT: f64 = 0.5;
/// A step of the iteration goes this part of the way: it does not swing.
const DAMPING: f64 = 0.5;
/// Waves up to the number of points over this are carried: the grid of points shows shorter ones poorly.
const POINTS_PER_WAVE: usize = 4;
/// A contour may start from another whose area differs by no more than this factor.
const LIKE_AREA: f64 = 1.5;

/// How the grey value falls across a vessel's wall: at its inner edge, then at its outer one.
#[derive(Debug, Clone, Copy)]
pub(in crate::sections) struct Fall {
    inner: f64,
    outer: f64,
    wall_mm: f64,
}

impl Fall {
    pub(in crate::sections) fn new(levels: &Levels, optics: Optics) -> Self {
        let (inner, outer) = (levels.lumen - levels.wall, levels.wall - levels.tissue);
        Self { inner, outer, wall_mm: optics.wall_mm }
    }

    /// How far outside the inner edge the fall is steepest under a Gaussian blur, mm.
    ///
    /// The slope's derivative, with d the distance from the inner edge and s the blur, vanishes where
    /// d = (outer / inner) (wall - d) exp((d^2 - (wall - d)^2) / 2 s^2): solved by iteration, which contracts for any wall
    /// thicker than the blur; a thinner one cannot be told from its edge, and the first step's part is taken.
    fn steepest_mm(self, blur_mm: f64) -> f64 {
        let ratio = self.outer / self.inner;
        if !ratio.is_finite() || self.wall_mm <= blur_mm {
            return 0.0;
        }
        let next = |d: f64| {
            let behind = self.wall_mm - d;
            let weight = ((d * d - behind * behind) / (2.0 * blur_mm * blur_mm)).exp();
            (ratio * behind * weight).clamp(-MOST_SHIFT * blur_mm, MOST_SHIFT * blur_mm)
        };
        (0..N_ITERATIONS).fold(0.0, |d, _| d + DAMPING * (next(d) - d))
    }
}

/// The active contour from `first`, warm-started from one of the plane `below` where one fits.
pub(in crate::sections) fn snake(
    first: &Contour,
    below: &[Contour],
    image: &Image<'_>,
    target: Target,
    fall: Fall,
) -> Curve {
    let (reach_mm, blur_mm) = (LIMIT_PIXELS * image.pixel_mm(), target.blur_mm);
    let start = below.iter().find_map(|b| brought(b, first, reach_mm));
    let mut curve = fitted(start.as_ref().unwrap_or(first), image, target.level);
    curve.moved_mm.fill(0.0);
    let circle = Circle::new(curve.points.len());
    let stiffness_mm = STIFFNESS_BLURS * blur_mm;
    for _ in 0..N_STEPS {
        let pulled = pulled(&mut curve, image, blur_mm, fall);
        curve.points = relaxed(&pulled, &circle, stiffness_mm);
    }
    curve
}

/// The other contour at the place and size of this one, unless it then leaves its reach.
fn brought(other: &Contour, to: &Contour, reach_mm: f64) -> Option<Contour> {
    let (a, b) = (other.signed_area_mm2(), to.signed_area_mm2());
    let ratio = b / a;
    // Contours of opposite direction have a negative ratio.
    if !(ratio > 1.0 / LIKE_AREA && ratio < LIKE_AREA && to.contains(other.centroid())) {
        return None;
    }
    let (from, centre) = (other.centroid(), to.centroid());
    let points: Vec<Point2> = other.points.iter().map(|p| centre + (p - from) * ratio.sqrt()).collect();
    let dense = to.resampled(points.len());
    let is_near = |p: &Point2| dense.points.iter().any(|q| (p - q).norm() < reach_mm);
    points.iter().all(is_near).then(|| Contour::new(points))
}

/// The points after one step of the external force alone.
fn pulled(curve: &mut Curve, image: &Image<'_>, blur_mm: f64, fall: Fall) -> Vec<Point2> {
    let limit = (LIMIT_PIXELS * image.pixel_mm()).min(FARTHEST_STEP * curve.radius_mm);
    let filter_mm = blur_mm.min(WIDEST_FILTER * curve.radius_mm);
    let beyond_mm = fall.steepest_mm(blur_mm.hypot(filter_mm));
    let reach_mm = limit + beyond_mm.abs() + image.pixel_mm() + FILTER_REACH * filter_mm;
    let profiles = curve.profiles(image, Averaging::AlongContour, reach_mm);
    let slope = derivative_filter(filter_mm / profiles.step_mm);
    let attraction = Attraction { at_mm: beyond_mm, width_mm: ATTRACTION_BLURS * blur_mm };
    let found: Vec<Option<f64>> = (0..curve.points.len())
        .map(|i| {
            let limits = [-limit, limit].map(|l| l - curve.moved_mm[i] + beyond_mm);
            profiles.steepest_mm(i, &slope, limits, attraction).map(|d| d - beyond_mm)
        })
        .collect();
    let offsets = smoothed_offsets(curve, &found);
    shift(curve, &offsets);
    curve.points.clone()
}

/// The implicit step of the internal force: each wave by its stiffness.
fn relaxed(points: &[Point2], circle: &Circle, stiffness_mm: f64) -> Vec<Point2> {
    let length_mm = Contour::new(points.to_vec()).perimeter_mm().max(f64::MIN_POSITIVE);
    let coordinate = |of: fn(&Point2) -> f64| {
        let values: Vec<f64> = points.iter().map(of).collect();
        let mut waves = circle.waves(&values, points.len() / POINTS_PER_WAVE);
        for (m, wave) in waves.iter_mut().enumerate().skip(2) {
            let bend = (std::f64::consts::TAU * m as f64 / length_mm * stiffness_mm).powi(4);
            *wave = wave.map(|w| w / (1.0 + bend));
        }
        circle.values(&waves)
    };
    let (x, y) = (coordinate(|p| p.x), coordinate(|p| p.y));
    x.into_iter().zip(y).map(|(x, y)| Point2::from(Vector2::new(x, y))).collect()
}

/// How much a fall counts by its place.
#[derive(Debug, Clone, Copy)]
struct Attraction {
    at_mm: f64,
    width_mm: f64,
}

impl Attraction {
    fn of(self, at_mm: f64) -> f64 {
        (-0.5 * ((at_mm - self.at_mm) / self.width_mm).powi(2)).exp()
    }
}

/// Weights whose sum with values is their fall, smoothed by a Gaussian of so many samples.
fn derivative_filter(sigma: f64) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few samples")]
    let half = (FILTER_REACH * sigma).ceil().clamp(1.0, 256.0) as usize;
    let weight = |m: usize| {
        let d = m as f64 - half as f64;
        -d * (-0.5 * (d / sigma).powi(2)).exp()
    };
    (0..=2 * half).map(weight).collect()
}

impl Profiles {
    /// Where profile i falls most steeply within the limits, mm outward; `None` where it does not fall there.
    fn steepest_mm(
        &self,
        i: usize,
        filter: &[f64],
        limits_mm: [f64; 2],
        attraction: Attraction,
    ) -> Option<f64> {
        let (profile, half) = (self.of(i), filter.len() / 2);
        let fall = |m: usize| filter.iter().zip(&profile[m - half..]).map(|(w, v)| w * v).sum::<f64>();
        let place = |m: usize| (m as f64 - self.half as f64) * self.step_mm;
        let falls: Vec<f64> = (half..self.n_samples.checked_sub(half)?).map(fall).collect();
        let inner = 1..falls.len().checked_sub(1)?;
        let peaks = inner.filter(|&j| falls[j] > 0.0 && falls[j] >= falls[j - 1] && falls[j] > falls[j + 1]);
        let at = |j: usize| {
            let (a, b, c) = (falls[j - 1], falls[j], falls[j + 1]);
            place(j + half) + 0.5 * (a - c) / (a - 2.0 * b + c) * self.step_mm
        };
        let within = |j: &usize| (limits_mm[0]..=limits_mm[1]).contains(&at(*j));
        let worth = |j: usize| falls[j] * attraction.of(at(j));
        peaks.filter(within).max_by(|&a, &b| worth(a).total_cmp(&worth(b))).map(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thin_wall_moves_the_steepest_fall_as_told() {
        let fall = Fall { inner: 240.0, outer: 120.0, wall_mm: 1.0 };
        for blur in [0.25, 0.35, 0.5] {
            let gauss = |d: f64| (-0.5 * (d / blur).powi(2)).exp();
            let slope = |d: f64| fall.inner * gauss(d) + fall.outer * gauss(d - fall.wall_mm);
            let at = |i: &i32| f64::from(*i) * 1e-4;
            let best = (-2000..4000).max_by(|a, b| slope(at(a)).total_cmp(&slope(at(b)))).unwrap();
            let told = fall.steepest_mm(blur);
            assert!((told - at(&best)).abs() < 2e-4, "blur {blur}: {told} of {}", at(&best));
        }
        assert!(Fall { outer: 0.0, ..fall }.steepest_mm(0.4).abs() < 1e-12);
    }

    #[test]
    fn an_ellipse_has_no_inner_force_and_short_waves_go() {
        let points = |wave: f64| -> Vec<Point2> {
            let point = |p: &Point2| Point2::new(1.0 + 3.0 * p.x, 2.0 * p.y);
            let circle = Contour::circle(Point2::origin(), 1.0, 120).points;
            let bump = |i: usize| 1.0 + wave * (20.0 * std::f64::consts::TAU * i as f64 / 120.0).cos();
            circle.iter().enumerate().map(|(i, p)| point(&(p * bump(i)))).collect()
        };
        let (circle, smooth) = (Circle::new(120), points(0.0));
        for (a, b) in relaxed(&smooth, &circle, 0.4).iter().zip(&smooth) {
            assert!((a - b).norm() < 1e-12);
        }
        for (a, b) in relaxed(&points(0.05), &circle, 0.4).iter().zip(&smooth) {
            assert!((a - b).norm() < 0.005, "{}", (a - b).norm());
        }
    }

    #[test]
    fn a_contour_is_brought_only_where_it_fits() {
        let to = Contour::circle(Point2::new(0.4, 0.0), 2.2, 128);
        let near = brought(&Contour::circle(Point2::origin(), 2.0, 100), &to, 0.6).unwrap();
        assert!((near.centroid() - to.centroid()).norm() < 1e-9);
        assert!((near.signed_area_mm2() / to.signed_area_mm2() - 1.0).abs() < 1e-9);
        for radius in [1.0, 4.0] {
            assert!(brought(&Contour::circle(Point2::origin(), radius, 100), &to, 0.6).is_none());
        }
        assert!(brought(&Contour::circle(Point2::origin(), 2.0, 100).reversed(), &to, 0.6).is_none());
    }
}
