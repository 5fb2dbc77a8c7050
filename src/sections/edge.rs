//! The levels on both sides of an edge and its blur, from a profile across it.
//!
//! Model: two steps blurred by the same Gaussian, lumen to wall and wall to what lies beyond it, because a
//! vessel's wall is hardly thicker than the blur: neither the lowest value nor the place where the fall
//! flattens is the wall's level. The levels are linear in the model and solved for; place, blur and wall
//! thickness are found by a compass search (Hooke & Jeeves, J. ACM 8, 1961).

use nalgebra::{Matrix3, Vector3};

/// Rounds of the compass search; each halves the steps unless it found something better.
const N_ROUNDS: usize = 48;
/// The model fits where its error stays below this part of the step.
const MOST_MISFIT: f64 = 0.06;
/// Below this part of the step a misfit leaves nothing for a second step to explain.
const CLOSE_MISFIT: f64 = 0.01;
/// A second step leaves at most this part of the misfit without it.
const MOST_MISFIT_LEFT: f64 = 0.7;
/// The second step is smaller than this part of the first: otherwise it is the vessel's edge.
const MOST_SECOND_STEP: f64 = 0.7;
/// Levels beyond the values by more than this part of their range are extrapolations from a poor fit.
const SLACK: f64 = 0.08;
/// The edge lies within this part of the profile's reach around its middle.
const MOST_OFF_CENTRE: f64 = 0.4;
/// Weight of the wish that the wall goes on: a whisper that keeps a missing second step from being singular,
/// or a command that there be none.
const WHISPER: f64 = 1e-4;
const COMMAND: f64 = 1e6;

/// Values across an edge, evenly spaced, lumen first and bright, the contour in the middle.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    pub(crate) values: Vec<f64>,
    pub(crate) step_mm: f64,
}

/// An edge that was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    /// Level of the lumen; dark lumens have their sign changed.
    pub(crate) lumen: f64,
    /// Level of the wall.
    pub(crate) wall: f64,
    /// Level of what lies beyond the wall.
    pub(crate) tissue: f64,
    /// Thickness of the wall, mm; anything where nothing else lies beyond it.
    pub(crate) wall_mm: f64,
    /// Standard deviation of the blur, mm.
    pub(crate) blur_mm: f64,
}

impl Edge {
    pub(crate) fn half_level(&self) -> f64 {
        0.5 * (self.lumen + self.wall)
    }

    /// The blurred value at the boundary: half-way to the wall, and what reaches it from beyond a thin one.
    pub(crate) fn value_at_boundary(&self) -> f64 {
        self.half_level() + (self.tissue - self.wall) * normal_cdf(-self.wall_mm / self.blur_mm)
    }
}

/// Place of the edge, its blur, and distance to the second step. mm.
#[derive(Debug, Clone, Copy)]
struct Shape {
    at: f64,
    blur: f64,
    wall: f64,
}

#[derive(Debug, Clone, Copy)]
struct Fit {
    shape: Shape,
    /// Lumen, wall, beyond.
    levels: Vector3<f64>,
    misfit: f64,
}

impl Fit {
    fn edge(&self) -> Edge {
        Edge {
            lumen: self.levels[0],
            wall: self.levels[1],
            tissue: self.levels[2],
            wall_mm: self.shape.wall,
            blur_mm: self.shape.blur,
        }
    }

    fn is_close(&self) -> bool {
        self.misfit < CLOSE_MISFIT * (self.levels[0] - self.levels[1])
    }
}

impl Profile {
    /// The edge nearest to the middle; `None` where there is none, or none of this kind.
    pub(crate) fn edge(&self) -> Option<Edge> {
        let single = self.single_step();
        let fit = single.filter(Fit::is_close).or_else(|| {
            let with_wall =
                [0.25, 0.45, 0.7].into_iter().filter_map(|w| self.searched(self.start(w), WHISPER));
            let double = with_wall.min_by(|a, b| a.misfit.total_cmp(&b.misfit));
            // A second step must earn its place, or it follows any slope of the surroundings.
            let earned = double.filter(|d| single.is_none_or(|s| d.misfit < MOST_MISFIT_LEFT * s.misfit));
            earned.or(single)
        })?;
        let edge = fit.edge();
        (fit.misfit < MOST_MISFIT * (edge.lumen - edge.wall)).then_some(edge)
    }

    /// The edge as one step, however badly that fits: where to look closer.
    pub(super) fn rough_edge(&self) -> Option<Edge> {
        self.single_step().map(|fit| fit.edge())
    }

    fn single_step(&self) -> Option<Fit> {
        self.searched(self.start(0.7), COMMAND)
    }

    fn start(&self, wall_part: f64) -> Shape {
        let reach = self.reach_mm();
        Shape { at: self.steepest_mm(), blur: 0.15 * reach, wall: wall_part * reach }
    }

    /// Where the values fall most, within the middle of the profile.
    fn steepest_mm(&self) -> f64 {
        let at = |m: usize| m as f64 * self.step_mm - self.reach_mm();
        let fall = |m: usize| self.values[m - 1] - self.values[m + 1];
        let middle = MOST_OFF_CENTRE * self.reach_mm();
        let near = (1..self.values.len().saturating_sub(1)).filter(|&m| at(m).abs() <= middle);
        near.max_by(|&a, &b| fall(a).total_cmp(&fall(b))).map_or(0.0, at)
    }

    /// The part of the profile within a distance of its middle; at least eight samples on either side.
    pub(crate) fn within(mut self, reach_mm: f64) -> Self {
        let half = (self.values.len() - 1) / 2;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the profile")]
        let kept = (reach_mm / self.step_mm).clamp(8.0, f64::max(8.0, half as f64)) as usize;
        let cut = half.saturating_sub(kept);
        self.values = self.values[cut..self.values.len() - cut].to_vec();
        self
    }

    /// Whether the levels are those of a vessel in a wall.
    fn is_sound(&self, levels: &Vector3<f64>) -> bool {
        let (lumen, wall, beyond) = (levels[0], levels[1], levels[2]);
        let range = |(a, b): (f64, f64), v: &f64| (a.min(*v), b.max(*v));
        let (least, most) = self.values.iter().fold((f64::MAX, f64::MIN), range);
        let slack = SLACK * (most - least);
        let within = |level: f64| level > least - slack && level < most + slack;
        within(lumen) && within(wall) && (beyond - wall).abs() < MOST_SECOND_STEP * (lumen - wall)
    }

    fn reach_mm(&self) -> f64 {
        0.5 * (self.values.len() - 1) as f64 * self.step_mm
    }

    fn searched(&self, start: Shape, tie: f64) -> Option<Fit> {
        let weights = self.weights();
        let mut best = self.fit(start, tie, &weights)?;
        let mut step = 0.1 * self.reach_mm();
        for _ in 0..N_ROUNDS {
            let s = best.shape;
            let around = [
                Shape { at: s.at + step, ..s },
                Shape { at: s.at - step, ..s },
                Shape { blur: s.blur + step, ..s },
                Shape { blur: s.blur - step, ..s },
                Shape { wall: s.wall + step, ..s },
                Shape { wall: s.wall - step, ..s },
            ];
            let better = around
                .into_iter()
                .filter_map(|s| self.fit(s, tie, &weights))
                .min_by(|a, b| a.misfit.total_cmp(&b.misfit));
            match better.filter(|b| b.misfit < best.misfit) {
                Some(b) => best = b,
                None => step *= 0.5,
            }
            if step < 1e-2 * self.step_mm {
                break;
            }
        }
        Some(best)
    }

    /// How much each sample counts: what lies far from the edge may be anything.
    fn weights(&self) -> Vec<f64> {
        let reach = self.reach_mm();
        let weight = |m: usize| (-2.0 * ((m as f64 * self.step_mm - reach) / reach).powi(2)).exp();
        (0..self.values.len()).map(weight).collect()
    }

    /// Best levels for a shape, and the weighted rms error with them.
    fn fit(&self, shape: Shape, tie: f64, weights: &[f64]) -> Option<Fit> {
        let reach = self.reach_mm();
        let allowed = shape.blur >= 0.5 * self.step_mm
            && shape.blur <= 0.5 * reach
            && shape.at.abs() <= MOST_OFF_CENTRE * reach
            && shape.wall >= 2.0 * shape.blur
            && shape.wall <= reach;
        if !allowed {
            return None;
        }
        let (mut a, mut b) = ([0.0; 6], Vector3::zeros());
        let (mut square, mut sum) = (0.0, 0.0);
        for (m, (&v, &w)) in self.values.iter().zip(weights).enumerate() {
            let basis = basis(shape, m as f64 * self.step_mm - reach);
            let [x, y, z] = basis.into();
            // The upper triangle, row by row.
            for (a, product) in a.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
                *a += product * w;
            }
            b += basis * (v * w);
            square += v * v * w;
            sum += w;
        }
        let [xx, xy, xz, yy, yz, zz] = a;
        let mut a = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let tie = tie * sum;
        a += Matrix3::new(0.0, 0.0, 0.0, 0.0, tie, -tie, 0.0, -tie, tie);
        let levels = a.cholesky()?.solve(&b);
        let misfit2 = (square - 2.0 * levels.dot(&b) + levels.dot(&(a * levels))) / sum;
        self.is_sound(&levels).then_some(Fit { shape, levels, misfit: misfit2.max(0.0).sqrt() })
    }
}

/// What a unit of lumen, wall and beyond contribute at distance d.
fn basis(shape: Shape, d: f64) -> Vector3<f64> {
    let outside = normal_cdf((d - shape.at) / shape.blur);
    let beyond = normal_cdf((d - shape.at - shape.wall) / shape.blur);
    Vector3::new(1.0 - outside, outside - beyond, beyond)
}

/// The normal distribution's cumulative function, to 1.5e-7 (Abramowitz & Stegun, 7.1.26).
pub(crate) fn normal_cdf(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let tail = 0.5 * series.iter().fold(0.0, |sum, c| (sum + c) * t) * (-z * z).exp();
    if x < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(f: impl Fn(f64) -> f64) -> Profile {
        Profile { values: (-28..=28).map(|m| f(f64::from(m) * 0.05)).collect(), step_mm: 0.05 }
    }

    #[test]
    fn normal_distribution() {
        assert!((normal_cdf(0.0) - 0.5).abs() < 1e-7);
        assert!((normal_cdf(1.0) - 0.841_344_746).abs() < 2e-7);
        assert!((normal_cdf(-2.0) - 0.022_750_132).abs() < 2e-7);
    }

    #[test]
    fn a_thin_wall_is_found_beneath_the_blur() {
        let two_steps =
            |d: f64| 300.0 - 240.0 * normal_cdf((d - 0.07) / 0.35) - 120.0 * normal_cdf((d - 1.07) / 0.35);
        let edge = profile(two_steps).edge().unwrap();
        assert!((edge.lumen - 300.0).abs() < 1.0 && (edge.wall - 60.0).abs() < 6.0, "{edge:?}");
        assert!((edge.blur_mm - 0.35).abs() < 0.01, "{edge:?}");
    }

    #[test]
    fn a_single_step_is_found_too() {
        let edge = profile(|d| 100.0 - 80.0 * normal_cdf(d / 0.3)).edge().unwrap();
        assert!((edge.lumen - 100.0).abs() < 0.5 && (edge.wall - 20.0).abs() < 0.5, "{edge:?}");
    }

    #[test]
    fn no_edge_is_no_edge() {
        assert_eq!(profile(|_| 5.0).edge(), None);
        assert_eq!(profile(|d| d).edge(), None);
    }
}
