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
