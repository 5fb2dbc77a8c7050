//! Newtypes where a swap would hurt, and the only conversions between units.
//!
//! Lengths are plain `f64` millimetres, speeds mm/s, times seconds; anything else is named in the
//! identifier (`feedrate_mm_min`, `area_mm2`).

use serde::{Deserialize, Serialize};

/// A temperature in degrees Celsius.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Celsius(pub f64);

/// An intensity in Hounsfield units (or the scanner's arbitrary units, where the modality is not CT).
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Hu(pub f64);

/// The number of a G-code line as sent with `N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LineNumber(pub u64);

/// The index of a layer, 0 on the bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LayerIndex(pub u32);

/// A number of things in words: "1 layer", "2 layers".
#[must_use]
pub fn counted(n: usize, thing: &str) -> String {
    if n == 1 { format!("1 {thing}") } else { format!("{n} {thing}s") }
}

/// A length as it is told: with four digits, which are more than a caliper shows.
#[must_use]
pub fn told_mm(mm: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, reason = "the logarithm of a finite number is small")]
    let factor = 10_f64.powi(3 - mm.abs().max(1e-9).log10().floor() as i32);
    (mm * factor).round() / factor
}

/// A size as it is told: "20 x 20 x 0.02 mm".
#[must_use]
pub fn told_size_mm(size_mm: [f64; 3]) -> String {
    let [x, y, z] = size_mm.map(told_mm);
    format!("{x} x {y} x {z} mm")
}

/// Steps of the grid in which places on the bed are written.
const STEPS_PER_MM: f64 = 1e3;

/// A place on the bed in the steps of 1 um in which it is written.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "rounded to the grid on purpose; far below 2^63")]
pub fn micrometres(mm: f64) -> i64 {
    (mm * STEPS_PER_MM).round() as i64
}

/// A place on the bed as it is written.
#[must_use]
pub fn on_grid_mm(mm: f64) -> f64 {
    (mm * STEPS_PER_MM).round() / STEPS_PER_MM
}

/// Millimetres per second to the millimetres per minute that G-code's `F` word wants.
#[must_use]
pub fn mm_min_from_mm_s(speed_mm_s: f64) -> f64 {
    speed_mm_s * 60.0
}

/// The millimetres per minute of G-code's `F` word to millimetres per second.
#[must_use]
pub fn mm_s_from_mm_min(feedrate_mm_min: f64) -> f64 {
    feedrate_mm_min / 60.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_numbers_of_things_are_told_as_one_says_them() {
        let told = [20.0, 0.019_999_999_552_965_164, 137.934_56, 0.787_401_6].map(told_mm);
        assert_eq!(told, [20.0, 0.02, 137.9, 0.7874]);
        assert_eq!(told_size_mm([400.0, 50.0, 0.0]), "400 x 50 x 0 mm");
        assert_eq!([0, 1, 2].map(|n| counted(n, "layer")), ["0 layers", "1 layer", "2 layers"]);
    }
}
