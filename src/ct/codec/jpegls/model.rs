//! What a JPEG-LS coder knows at a sample: its context, prediction, and the statistics of each context (ITU-T T.87 A.3
//! to A.7). Suffixes `a` to `d` are the neighbours: left, above, above left, above right.

use super::super::Fault;
use super::parameters::Parameters;

/// Contexts of gradients, their signs merged.
const N_CONTEXTS: usize = 365;
/// A correction of the prediction stays within these.
const CORRECTIONS: std::ops::RangeInclusive<i32> = -128..=127;
/// Logarithms of the run lengths that one bit stands for.
pub(super) const RUN_BITS: [u32; 32] =
    [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// Samples around the one to be coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbours {
    pub(super) a: i32,
    pub(super) b: i32,
    pub(super) c: i32,
    pub(super) d: i32,
}

/// A gradient context: where its statistics stand, and whether errors change sign in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context {
    index: usize,
    pub(super) sign: i32,
}

impl Neighbours {
    /// The context, or none where all gradients are flat: there a run begins.
    pub(super) fn context(&self, parameters: &Parameters) -> Option<Context> {
        let gradients = [self.d - self.b, self.b - self.c, self.c - self.a];
        let [q1, q2, q3] = gradients.map(|g| level(g, parameters));
        let signed = 81 * q1 + 9 * q2 + q3;
        // The first level that is not zero outweighs all behind it.
        (signed != 0).then_some(Context { index: signed.unsigned_abs() as usize, sign: signed.signum() })
    }

    /// The middle one of left, above, and the plane through the three.
    pub(super) fn median(&self) -> i32 {
        let (low, high) = (self.a.min(self.b), self.a.max(self.b));
        if self.c >= high {
            low
        } else if self.c <= low {
            high
        } else {
            self.a + self.b - self.c
        }
    }
}

/// One of nine levels of a gradient, -4 to 4.
fn level(gradient: i32, parameters: &Parameters) -> i32 {
    let size = gradient.abs();
    let [t1, t2, t3] = parameters.thresholds;
    let level = i32::from(size > parameters.near)
        + i32::from(size >= t1)
        + i32::from(size >= t2)
        + i32::from(size >= t3);
    level * gradient.signum()
}

/// What a context has learnt: sum of error sizes, of errors, correction, count.
#[derive(Debug, Clone, Copy)]
struct Statistics {
    size_sum: i64,
    sum: i32,
    correction: i32,
    n: i32,
}

/// What an interrupted run has learnt: sum of codes, count, count of negative errors.
#[derive(Debug, Clone, Copy)]
struct RunStatistics {
    size_sum: i64,
    n: i32,
    n_negative: i32,
}

/// Statistics of all contexts.
#[derive(Debug)]
pub(super) struct Model<'a> {
    pub(super) parameters: &'a Parameters,
    contexts: [Statistics; N_CONTEXTS],
    /// Where the sample left of the interruption differs from that above, and where not.
    interruptions: [RunStatistics; 2],
    /// Place in [`RUN_BITS`].
    pub(super) run_index: usize,
}

impl<'a> Model<'a> {
    pub(super) fn new(parameters: &'a Parameters) -> Self {
        let size_sum = i64::from(((parameters.range + 32) / 64).max(2));
        Self {
            parameters,
            contexts: [Statistics { size_sum, sum: 0, correction: 0, n: 1 }; N_CONTEXTS],
            interruptions: [RunStatistics { size_sum, n: 1, n_negative: 0 }; 2],
            run_index: 0,
        }
    }

    /// The prediction at a sample, corrected.
    pub(super) fn predict(&self, neighbours: &Neighbours, context: Context) -> i32 {
        let correction = context.sign * self.contexts[context.index].correction;
        (neighbours.median() + correction).clamp(0, self.parameters.max_value)
    }

    /// Low bits of a Golomb code in a context, and whether signs are coded the other way round.
    pub(super) fn code(&self, context: Context) -> (u32, bool) {
        let s = &self.contexts[context.index];
        let k = low_bits(s.n, s.size_sum);
        (k, k == 0 && self.parameters.near == 0 && 2 * s.sum <= -s.n)
    }

    /// Learns from an error, its sign as the context has it.
    pub(super) fn learn(&mut self, context: Context, error: i32) {
        let s = &mut self.contexts[context.index];
        s.sum += error * self.parameters.step();
        s.size_sum += i64::from(error.abs());
        if s.n == self.parameters.reset {
            s.size_sum >>= 1;
            s.sum >>= 1;
            s.n >>= 1;
        }
        s.n += 1;
        if s.sum <= -s.n {
            s.correction = (s.correction - 1).max(*CORRECTIONS.start());
            s.sum = (s.sum + s.n).max(1 - s.n);
        } else if s.sum > 0 {
            s.correction = (s.correction + 1).min(*CORRECTIONS.end());
            s.sum = (s.sum - s.n).min(0);
        }
    }

    /// Low bits of a Golomb code of an interruption, and whether negative errors are the odd codes.
    pub(super) fn interruption_code(&self, is_level: bool) -> (u32, bool) {
        let s = &self.interruptions[usize::from(is_level)];
        let size_sum = s.size_sum + if is_level { i64::from(s.n >> 1) } else { 0 };
        let k = low_bits(s.n, size_sum);
        (k, k != 0 || 2 * s.n_negative >= s.n)
    }

    /// Learns from the error of an interruption and the code that it had.
    pub(super) fn learn_interruption(&mut self, is_level: bool, error: i32, code: i32) {
        let s = &mut self.interruptions[usize::from(is_level)];
        s.n_negative += i32::from(error < 0);
        s.size_sum += i64::from((code + 1 - i32::from(is_level)) >> 1);
        if s.n == self.parameters.reset {
            s.size_sum >>= 1;
            s.n >>= 1;
            s.n_negative >>= 1;
        }
        s.n += 1;
    }

    /// An error within the range of those that can be coded.
    pub(super) fn checked(&self, error: i32) -> Result<i32, Fault> {
        if error.abs() > self.parameters.range {
            return Err(Fault::Damaged("an error of the JPEG-LS pixels is out of range"));
        }
        Ok(error)
    }
}

/// Least k for which n 2^k reaches the sum: 17 at most, as errors stay within the range.
fn low_bits(n: i32, size_sum: i64) -> u32 {
    let n = i64::from(n);
    (0..).find(|k| n << k >= size_sum).unwrap_or(0)
}
