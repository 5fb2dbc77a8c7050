//! The numbers that a JPEG-LS scan is coded with, and what follows from them (ITU-T T.87 A.2.1, C.2.4.1.1).

use super::super::Fault;
use super::super::markers::Fields;

/// Thresholds of gradients for 8 bits, and samples after which contexts forget, where a stream names no others.
const BASIC_THRESHOLDS: [i32; 3] = [3, 7, 21];
const BASIC_RESET: i32 = 64;

/// Parameters that a stream names itself; 0 where it leaves them to the standard.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Preset {
    pub(super) max_value: i32,
    pub(super) thresholds: [i32; 3],
    pub(super) reset: i32,
}

impl Preset {
    pub(super) fn read(mut fields: Fields<'_>) -> Result<Self, Fault> {
        let mut next = || fields.word().map(i32::from);
        Ok(Self { max_value: next()?, thresholds: [next()?, next()?, next()?], reset: next()? })
    }
}

/// All that coding a scan depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Parameters {
    /// Bits of a sample as the frame header says.
    pub(super) precision_bits: u32,
    /// Largest sample.
    pub(super) max_value: i32,
    /// Most that a sample may be off.
    pub(super) near: i32,
    /// Gradients at which contexts change, ascending.
    pub(super) thresholds: [i32; 3],
    /// Samples after which a context's memory is halved.
    pub(super) reset: i32,
    /// Number of different errors.
    pub(super) range: i32,
    /// Bits of an error that is too long for a Golomb code.
    pub(super) error_bits: u32,
    /// Longest code.
    pub(super) limit: u32,
}

impl Parameters {
    /// The parameters of samples of 2 to 16 bits.
    pub(super) fn try_new(precision_bits: u32, near: i32, preset: &Preset) -> Result<Self, Fault> {
        let largest = (1 << precision_bits) - 1;
        let max_value = if preset.max_value == 0 { largest } else { preset.max_value };
        if max_value > largest || near > (max_value / 2).min(255) {
            return Err(Fault::Damaged("the JPEG-LS parameters do not fit the bits of its samples"));
        }
        let thresholds = thresholds(max_value, near, preset.thresholds);
        let [t1, t2, t3] = thresholds;
        let reset = if preset.reset == 0 { BASIC_RESET } else { preset.reset };
        let is_ascending = near < t1 && t1 <= t2 && t2 <= t3 && t3 <= max_value;
        if !is_ascending || !(3..=max_value.max(255)).contains(&reset) {
            return Err(Fault::Damaged("the JPEG-LS thresholds are out of order"));
        }
        let range = (max_value + 2 * near) / (2 * near + 1) + 1;
        let value_bits = bits_of(max_value + 1).max(2);
        Ok(Self {
            precision_bits,
            max_value,
            near,
            thresholds,
            reset,
            range,
            error_bits: bits_of(range),
            limit: 2 * (value_bits + value_bits.max(8)),
        })
    }

    /// Distance between neighbouring values that are coded.
    pub(super) const fn step(&self) -> i32 {
        2 * self.near + 1
    }

    /// The sample at an error of so many steps from its prediction.
    pub(super) fn reconstruct(&self, prediction: i32, error: i32) -> i32 {
        let value = prediction + error * self.step();
        let turn = self.range * self.step();
        let value = if value < -self.near {
            value + turn
        } else if value > self.max_value + self.near {
            value - turn
        } else {
            value
        };
        value.clamp(0, self.max_value)
    }
}

/// Bits that tell n values apart, n above 1.
const fn bits_of(n: i32) -> u32 {
    (n - 1).unsigned_abs().ilog2() + 1
}

/// The thresholds named, or those that the standard derives from the largest value and the allowed error.
fn thresholds(max_value: i32, near: i32, named: [i32; 3]) -> [i32; 3] {
    let mut lowest = near + 1;
    std::array::from_fn(|i| {
        let usual = usual_threshold(i, max_value, near);
        let fallback = if usual > max_value || usual < lowest { lowest } else { usual };
        lowest = if named[i] == 0 { fallback } else { named[i] };
        lowest
    })
}

fn usual_threshold(i: usize, max_value: i32, near: i32) -> i32 {
    const LEAST: [i32; 3] = [2, 3, 4];
    const PER_NEAR: [i32; 3] = [3, 5, 7];
    let (basic, least, widened) = (BASIC_THRESHOLDS[i], LEAST[i], PER_NEAR[i] * near);
    if max_value >= 128 {
        let factor = (max_value.min(4095) + 128) / 256;
        factor * (basic - least) + least + widened
    } else {
        let factor = 256 / (max_value + 1);
        least.max(basic / factor + widened)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_those_of_the_standard() {
        let of = |bits, near| Parameters::try_new(bits, near, &Preset::default()).unwrap().thresholds;
        // ITU-T T.87 table C.3 for 8 bits; formulas of C.2.4.1.1.1 for the others.
        assert_eq!(of(8, 0), [3, 7, 21]);
        assert_eq!(of(12, 0), [18, 67, 276]);
        assert_eq!(of(16, 0), [18, 67, 276]);
        assert_eq!(of(8, 2), [9, 17, 35]);
        assert_eq!(of(4, 0), [2, 3, 4]);
        assert_eq!(of(2, 0), [2, 3, 3]);
    }

    #[test]
    fn derived_numbers_are_those_of_the_standard() {
        let of = |bits, near| Parameters::try_new(bits, near, &Preset::default()).unwrap();
        assert_eq!((of(8, 0).range, of(8, 0).error_bits, of(8, 0).limit), (256, 8, 32));
        assert_eq!((of(12, 0).range, of(12, 0).error_bits, of(12, 0).limit), (4096, 12, 48));
        assert_eq!((of(8, 3).range, of(8, 3).error_bits), (38, 6));
    }

    #[test]
    fn parameters_that_contradict_each_other_are_refused() {
        let odd = |preset: Preset, near| Parameters::try_new(8, near, &preset).is_err();
        assert!(odd(Preset { max_value: 256, ..Preset::default() }, 0));
        assert!(odd(Preset { thresholds: [9, 5, 21], ..Preset::default() }, 0));
        assert!(odd(Preset { thresholds: [3, 7, 256], ..Preset::default() }, 0));
        assert!(odd(Preset { reset: 2, ..Preset::default() }, 0));
        assert!(odd(Preset::default(), 128));
    }
}
