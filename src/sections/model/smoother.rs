//! Noisy values along a vessel made smooth, as far as their noise asks for it and no further.
//!
//! Model: each channel (a coordinate of the centre, a wave of the radius) is a curve over z whose third derivative is
//! random, so that its likeliest course between exact values would be a quintic spline: a vessel's bends themselves
//! change gently. What is measured is the curve plus noise of known variance. How strong the third derivative is, is learned from the values themselves: one
//! strength per family of channels, times one factor per plane that all channels share, because where a vessel
//! changes abruptly (a split, an end of a plaque) it does so in all of them. The factors have an inverse gamma law,
//! which makes the third derivatives Student-t distributed: gentle bends are straightened, abrupt ones are kept.
//!
//! Method: for given strengths and factors the curve is the solution of a system with seven diagonals, whose determinant
//! gives the likelihood of the values; the strengths are the likeliest of a series. The factors follow from the third
//! derivatives and their uncertainty (MacKay, Neural Computation 4, 1992), for which the inverse's entries
//! within these diagonals are needed (Takahashi, Fagan, Chin 1973). Cost: O(planes x channels) a trial.

/// Rounds of strengths and factors.
const N_ROUNDS: usize = 5;
/// Strengths are tried down from that of the raw values by this factor, so often.
const STRENGTH_STEP: f64 = 0.4;
const N_STRENGTHS: i32 = 18;
/// Degrees of freedom of the third derivatives' law: few let single planes stand out.
const FREEDOM: f64 = 4.0;
/// Fewer planes than this tell nothing about how smooth a vessel is.
pub(super) const LEAST_PLANES: usize = 6;

/// One quantity over all planes.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    /// What was measured.
    pub(super) values: Vec<f64>,
    /// Variance of its noise.
    pub(super) noise: Vec<f64>,
    /// Channels of one family bend alike.
    pub(super) family: usize,
}

/// Diagonals below the main one.
const BAND: usize = 3;

/// A third derivative as weights of neighbouring values.
type Weights = [f64; BAND + 1];

/// Symmetric matrix of seven diagonals: the main one and those below, `[i][d]` in row i + d, column i.
struct Banded(Vec<[f64; BAND + 1]>);

/// A channel's values as the system takes them.
struct Measured<'a> {
    values: &'a [f64],
    /// One over the variance of each value's noise.
    precision: Vec<f64>,
    /// Values times precision.
    right: Vec<f64>,
}

impl<'a> Measured<'a> {
    fn of(channel: &'a Channel) -> Self {
        let precision: Vec<f64> = channel.noise.iter().map(|v| 1.0 / v).collect();
        let right = channel.values.iter().zip(&precision).map(|(v, p)| v * p).collect();
        Self { values: &channel.values, precision, right }
    }
}

/// How little the third derivatives are held back, plane by plane.
struct Freedom<'a> {
    factors: &'a [f64],
    logarithms: Vec<f64>,
}

impl<'a> Freedom<'a> {
    fn of(factors: &'a [f64]) -> Self {
        Self { factors, logarithms: factors.iter().map(|f| f.ln()).collect() }
    }
}

/// The channels' smooth course, in place, with the variances that are left in `noise`.
pub(super) fn smooth(z_mm: &[f64], channels: &mut [Channel]) {
    if z_mm.len() < LEAST_PLANES {
        return;
    }
    let weights = third_derivatives(z_mm);
    let raw = raw_strengths(channels, &weights);
    let mut factors = vec![1.0; weights.len()];
    let mut solved = Vec::new();
    for _ in 0..N_ROUNDS {
        let freedom = Freedom::of(&factors);
        let strengths: Vec<f64> =
            raw.iter().enumerate().map(|(f, &raw)| likeliest(channels, f, raw, &weights, &freedom)).collect();
        solved =
            channels.iter().map(|c| solve(c, &weights, strengths[c.family], &freedom)).collect::<Vec<_>>();
        factors = told_factors(&solved, channels, &strengths, &factors);
    }
    for (channel, solved) in channels.iter_mut().zip(solved) {
        channel.values = solved.values;
        channel.noise = solved.variances;
    }
}

fn third_derivatives(z_mm: &[f64]) -> Vec<Weights> {
    // Divided differences, times 3!.
    let weight =
        |z: &[f64], i: usize| 6.0 / (0..=BAND).filter(|&j| j != i).map(|j| z[i] - z[j]).product::<f64>();
    z_mm.windows(BAND + 1).map(|z| std::array::from_fn(|i| weight(z, i))).collect()
}

/// Mean square of each family's third derivatives, noise included.
fn raw_strengths(channels: &[Channel], weights: &[Weights]) -> Vec<f64> {
    let n = channels.iter().map(|c| c.family + 1).max().unwrap_or(0);
    let mut sums = vec![[0.0; 2]; n];
    for channel in channels {
        let bend = |(i, w): (usize, &Weights)| (0..=BAND).map(|d| w[d] * channel.values[i + d]).sum::<f64>();
        let squares: f64 = weights.iter().enumerate().map(bend).map(|b| b * b).sum();
        let sum = &mut sums[channel.family];
        *sum = [sum[0] + squares, sum[1] + weights.len() as f64];
    }
    sums.iter().map(|[square, n]| (square / n).max(f64::MIN_POSITIVE)).collect()
}

/// The strength under which a family's values are likeliest.
fn likeliest(
    channels: &[Channel],
    family: usize,
    raw: f64,
    weights: &[Weights],
    freedom: &Freedom<'_>,
) -> f64 {
    let own: Vec<Measured<'_>> = channels.iter().filter(|c| c.family == family).map(Measured::of).collect();
    let cost = |strength: f64| {
        own.iter().map(|c| solve_without_spread(c, weights, strength, freedom).2).sum::<f64>()
    };
    let tried = (0..N_STRENGTHS).map(|i| 2.0 * raw * STRENGTH_STEP.powi(i)).map(|s| (s, cost(s)));
    tried.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(raw, |best| best.0)
}

struct Solved {
    values: Vec<f64>,
    variances: Vec<f64>,
    /// Squares of the third derivatives, and the variances of their errors.
    bends: Vec<[f64; 2]>,
}

/// The factors that explain the third derivatives, each counted by how much of it the values tell (MacKay 1992): a
/// channel that is all noise has no say.
fn told_factors(solved: &[Solved], channels: &[Channel], strengths: &[f64], before: &[f64]) -> Vec<f64> {
    let factor = |i: usize| {
        let told = |(s, c): (&Solved, &Channel)| {
            let ([square, spread], strength) = (s.bends[i], strengths[c.family]);
            [square / strength, (1.0 - spread / (strength * before[i])).clamp(0.0, 1.0)]
        };
        let sum = solved.iter().zip(channels).map(told).fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        (FREEDOM + sum[0]) / (FREEDOM + sum[1])
    };
    (0..before.len()).map(factor).collect()
}

/// Factored system, solution, and twice the negative logarithm of the values' likelihood (less a constant).
fn solve_without_spread(
    measured: &Measured<'_>,
    weights: &[Weights],
    strength: f64,
    freedom: &Freedom<'_>,
) -> (Banded, Vec<f64>, f64) {
    let Measured { values, precision, right } = measured;
    let mut a = Banded(precision.iter().map(|&p| [p, 0.0, 0.0, 0.0]).collect());
    for (i, (w, factor)) in weights.iter().zip(freedom.factors).enumerate() {
        let scale = 1.0 / (strength * factor);
        for (d, column) in a.0[i..=i + BAND].iter_mut().enumerate() {
            for e in d..=BAND {
                column[e - d] += scale * w[d] * w[e];
            }
        }
    }
    a.factor();
    let solution = a.solved(right.clone());
    let misfit: f64 = values.iter().zip(&solution).zip(right).map(|((v, x), r)| (v - x) * r).sum();
    let pivots = a.0.iter().map(|column| column[0].ln());
    let determinants: f64 = pivots.chain(freedom.logarithms.iter().copied()).sum();
    (a, solution, misfit + determinants + weights.len() as f64 * strength.ln())
}

fn solve(channel: &Channel, weights: &[Weights], strength: f64, freedom: &Freedom<'_>) -> Solved {
    let (mut a, values, _) = solve_without_spread(&Measured::of(channel), weights, strength, freedom);
    a.invert();
    let square = |(i, w): (usize, &Weights)| {
        let bend: f64 = (0..=BAND).map(|d| w[d] * values[i + d]).sum();
        let pairs = (0..=BAND).flat_map(|d| (0..=BAND).map(move |e| (d, e)));
        let spread: f64 = pairs.map(|(d, e)| w[d] * w[e] * a.0[i + d.min(e)][d.abs_diff(e)]).sum();
        [bend * bend, spread.max(0.0)]
    };
    let bends = weights.iter().enumerate().map(square).collect();
    Solved { values, bends, variances: a.0.iter().map(|column| column[0]).collect() }
}

impl Banded {
    /// Into L D L': D on the main diagonal, the unit lower triangle below it.
    fn factor(&mut self) {
        for i in 0..self.0.len() {
            let column = self.0[i];
            let pivot = column[0];
            for (d, other) in (1..=BAND).zip(i + 1..self.0.len()) {
                for e in d..=BAND {
                    self.0[other][e - d] -= column[d] * column[e] / pivot;
                }
                self.0[i][d] = column[d] / pivot;
            }
        }
    }

    fn solved(&self, mut x: Vec<f64>) -> Vec<f64> {
        let n = x.len();
        for i in 0..n {
            for (d, other) in (1..=BAND).zip(i + 1..n) {
                x[other] -= self.0[i][d] * x[i];
            }
        }
        for i in (0..n).rev() {
            x[i] /= self.0[i][0];
            for (d, other) in (1..=BAND).zip(i + 1..n) {
                x[i] -= self.0[i][d] * x[other];
            }
        }
        x
    }

    /// From the factors to the inverse's entries within the diagonals, from the last row up.
    fn invert(&mut self) {
        let n = self.0.len();
        for i in (0..n).rev() {
            let column = self.0[i];
            let reach = BAND.min(n - 1 - i);
            for d in 1..=reach {
                let entry = |e: usize| column[e] * self.0[i + d.min(e)][d.abs_diff(e)];
                self.0[i][d] = -(1..=reach).map(entry).sum::<f64>();
            }
            let off: f64 = (1..=reach).map(|d| column[d] * self.0[i][d]).sum();
            self.0[i][0] = 1.0 / column[0] - off;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    /// Deterministic standard normal deviates.
    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        };
        (0..n).map(|_| (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()).collect()
    }

    fn smoothed(truth: impl Fn(f64) -> f64, sigma: f64, seed: u64) -> (f64, f64) {
        let z: Vec<f64> = (0..40).map(|k| 3.0 * f64::from(k)).collect();
        let raw: Vec<f64> = z.iter().zip(noise(seed, 40)).map(|(&z, e)| truth(z) + sigma * e).collect();
        let mut channels = [Channel { values: raw.clone(), noise: vec![sigma * sigma; 40], family: 0 }];
        smooth(&z, &mut channels);
        let rms =
            |v: &[f64]| (v.iter().zip(&z).map(|(v, &z)| (v - truth(z)).powi(2)).sum::<f64>() / 40.0).sqrt();
        (rms(&raw), rms(&channels[0].values))
    }

    #[test]
    fn a_gentle_course_loses_half_its_noise_or_more() {
        for seed in 1..9 {
            let (raw, smooth) = smoothed(|z| 50.0 + 2.0 * (z / 27.0).sin(), 0.05, seed);
            assert!(smooth < 0.62 * raw, "{seed}: {smooth} of {raw}");
        }
    }

    #[test]
    fn a_kink_is_kept() {
        // Smeared, it would be off by more than the noise. A single draw may be unlucky; in the mean over draws, the
        // curve is better than what was measured, by more than the mean's own uncertainty.
        let ratios: Vec<f64> = (1..33)
            .map(|seed| smoothed(|z| 0.4 * (z - 60.0).max(0.0), 0.05, seed))
            .map(|(raw, smooth)| smooth / raw)
            .collect();
        let n = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / n;
        let variance = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (n - 1.0);
        assert!(mean + 2.0 * (variance / n).sqrt() < 1.0, "{mean} +- {variance}: {ratios:?}");
    }

    #[test]
    fn without_noise_nothing_changes() {
        let (_, smooth) = smoothed(|z| (z / 9.0).sin(), 1e-6, 1);
        assert!(smooth < 2e-6, "{smooth}");
    }

    #[test]
    fn solution_and_variances_equal_those_of_the_full_matrix() {
        let z = [0.0, 1.0, 2.5, 4.0, 5.0, 7.0];
        let channel = Channel { values: noise(3, 6), noise: vec![0.3, 0.2, 0.5, 0.4, 0.1, 0.2], family: 0 };
        let weights = third_derivatives(&z);
        let factors = [1.0, 0.5, 2.0];
        let solved = solve(&channel, &weights, 0.7, &Freedom::of(&factors));
        let mut full = DMatrix::<f64>::zeros(6, 6);
        for i in 0..6 {
            full[(i, i)] = 1.0 / channel.noise[i];
        }
        for (i, w) in weights.iter().enumerate() {
            for d in 0..=BAND {
                for e in 0..=BAND {
                    full[(i + d, i + e)] += w[d] * w[e] / (0.7 * factors[i]);
                }
            }
        }
        let inverse = full.try_inverse().unwrap();
        for i in 0..6 {
            let value: f64 = (0..6).map(|j| inverse[(i, j)] * channel.values[j] / channel.noise[j]).sum();
            assert!((value - solved.values[i]).abs() < 1e-10);
            assert!((inverse[(i, i)] - solved.variances[i]).abs() < 1e-10);
        }
    }
}
