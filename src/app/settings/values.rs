//! Values as they are typed or written down, their ranges, and what is wrong with them.

use crate::ready::Label;
use crate::{mesh, phantom};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A value that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("found {found}, expected {expected}")]
pub struct Fault {
    /// What was given.
    pub found: String,
    /// What would be right, with unit and range.
    pub expected: String,
}

/// A parameter that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {fault}")]
pub struct SettingError {
    /// The key in `case.toml`; the flag has hyphens instead of underscores.
    pub name: Cow<'static, str>,
    /// What is wrong with its value.
    pub fault: Fault,
}

/// The numbers that a parameter may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Unit, for messages.
    pub unit: &'static str,
}

/// Thickness of the printed wall: thinner than any nozzle's bead is no wall, thicker than 20 mm no vessel's.
pub const WALL_MM: Limits = Limits { min: 0.1, max: 20.0, unit: "mm" };
/// Layer height; the profile's own limits are narrower.
pub const LAYER_MM: Limits = Limits { min: 0.02, max: 1.0, unit: "mm" };
/// Fill of what is too deep for contours.
pub const INFILL_PERCENT: Limits = Limits { min: 0.0, max: 100.0, unit: "percent" };
/// Standard deviation of a phantom's noise.
pub const NOISE_HU: Limits = Limits::of(phantom::NOISE_HU, "HU");
/// Standard deviation of a phantom's blur.
pub const PSF_SIGMA_MM: Limits = Limits::of(phantom::PSF_SIGMA_MM, "mm");
/// Thickness that a phantom's plane averages over.
pub const SLAB_MM: Limits = Limits::of(phantom::SLAB_MM, "mm");
/// Side of a phantom's pixel.
pub const PIXEL_MM: Limits = Limits::of(phantom::PIXEL_MM, "mm");
/// Distance of a phantom's planes.
pub const PLANE_STEP_MM: Limits = Limits::of(phantom::PLANE_STEP_MM, "mm");
/// Tilt of a phantom's planes.
pub const TILT_DEG: Limits = Limits::of(phantom::TILT_DEG, "degrees");
/// Deflection of a tessellation.
pub const DEFLECTION_MM: Limits = Limits::of(mesh::DEFLECTION_MM, "mm");
/// The same as a fraction of the local radius.
pub const DEFLECTION_RELATIVE: Limits = Limits::of(mesh::DEFLECTION_RELATIVE, "of the local radius");

impl Limits {
    const fn of([min, max]: [f64; 2], unit: &'static str) -> Self {
        Self { min, max, unit }
    }

    /// The number itself where it may be used.
    ///
    /// # Errors
    /// [`Fault`] where it is out of range or no number.
    pub fn check(self, value: f64) -> Result<f64, Fault> {
        if (self.min..=self.max).contains(&value) { Ok(value) } else { Err(self.fault(&value.to_string())) }
    }

    /// The number in a text, where it may be used.
    ///
    /// # Errors
    /// [`Fault`] where the text is no number or the number is out of range.
    pub fn parse(self, text: &str) -> Result<f64, Fault> {
        self.check(text.trim().parse().map_err(|_no_number| self.fault(&format!("{text:?}")))?)
    }

    fn fault(self, found: &str) -> Fault {
        let expected = format!("a number from {} to {} {}", self.min, self.max, self.unit);
        Fault { found: found.to_owned(), expected }
    }
}

/// N numbers separated by commas.
fn parse_numbers<const N: usize>(text: &str, expected: &str) -> Result<[f64; N], Fault> {
    let fault = || Fault { found: format!("{text:?}"), expected: expected.to_owned() };
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let numbers: [f64; N] = numbers.and_then(|n| n.try_into().ok()).ok_or_else(fault)?;
    if numbers.iter().all(|n| n.is_finite()) { Ok(numbers) } else { Err(fault()) }
}

pub(super) const SEED_EXPECTED: &str = "X,Y,Z: three numbers in mm (LPS) separated by commas; or auto";
pub(super) const WINDOW_EXPECTED: &str = "LO,HI: two numbers in HU separated by a comma, LO less than HI";
pub(super) const Z_EXPECTED: &str = "A,B: two heights in mm separated by a comma, A less than B";

/// Where growing begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seed {
    /// In the vessel that is found by itself.
    Auto,
    /// At this point, LPS, mm.
    Point([f64; 3]),
}

/// The `seed_mm` key: points, or the word `auto`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "SeedsText", into = "SeedsText")]
pub struct Seeds(pub Vec<Seed>);

/// How seeds are written.
#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "expected [[X, Y, Z], ...]: points in mm (LPS), or \"auto\"")]
enum SeedsText {
    Word(AutoWord),
    Points(Vec<[f64; 3]>),
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum AutoWord {
    Auto,
}

impl From<SeedsText> for Seeds {
    fn from(text: SeedsText) -> Self {
        match text {
            SeedsText::Word(AutoWord::Auto) => Self(vec![Seed::Auto]),
            SeedsText::Points(points) => Self(points.into_iter().map(Seed::Point).collect()),
        }
    }
}

impl From<Seeds> for SeedsText {
    fn from(seeds: Seeds) -> Self {
        if seeds.is_auto() { Self::Word(AutoWord::Auto) } else { Self::Points(seeds.points_mm()) }
    }
}

impl Seeds {
    /// Whether the vessel is to be found.
    #[must_use]
    pub fn is_auto(&self) -> bool {
        self.0.contains(&Seed::Auto)
    }

    /// The points, LPS, mm.
    #[must_use]
    pub fn points_mm(&self) -> Vec<[f64; 3]> {
        let point = |seed: &Seed| if let Seed::Point(p) = seed { Some(*p) } else { None };
        self.0.iter().filter_map(point).collect()
    }
}

/// `X,Y,Z` of a seed, mm, or `auto`.
///
/// # Errors
/// [`Fault`] unless these are three finite numbers or that word.
pub fn parse_seed_mm(text: &str) -> Result<Seed, Fault> {
    if text.trim() == "auto" {
        return Ok(Seed::Auto);
    }
    parse_numbers(text, SEED_EXPECTED).map(Seed::Point)
}

/// `LO,HI` of a window, HU.
///
/// # Errors
/// [`Fault`] unless these are two finite numbers, ascending.
pub fn parse_window_hu(text: &str) -> Result<[f64; 2], Fault> {
    ascending(parse_numbers(text, WINDOW_EXPECTED)?, WINDOW_EXPECTED)
}

/// `A,B` of a range of heights, mm.
///
/// # Errors
/// [`Fault`] unless these are two finite numbers, ascending.
pub fn parse_z_mm(text: &str) -> Result<[f64; 2], Fault> {
    ascending(parse_numbers(text, Z_EXPECTED)?, Z_EXPECTED)
}

/// Refuses NaN too: it is not less than anything.
pub(super) fn ascending([lo, hi]: [f64; 2], expected: &str) -> Result<[f64; 2], Fault> {
    if lo < hi && lo.is_finite() && hi.is_finite() {
        return Ok([lo, hi]);
    }
    Err(Fault { found: format!("{lo},{hi}"), expected: expected.to_owned() })
}

/// A structure's number or name.
///
/// # Errors
/// [`Fault`] where there is neither.
pub fn parse_label(text: &str) -> Result<Label, Fault> {
    let text = text.trim();
    if text.is_empty() {
        return Err(Fault { found: "\"\"".into(), expected: "the number or the name of a structure".into() });
    }
    Ok(text.parse().map_or_else(|_no_number| Label::Name(text.to_owned()), Label::Number))
}

pub(super) const SERIES_EXPECTED: &str =
    "a number from 1, as `lumenfab inspect` lists them, or a SeriesInstanceUID";

/// Which series of a folder: as it is written down or typed.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SeriesKey {
    /// Its number, from 1.
    Number(usize),
    /// Its UID: taken from the operator, looked up, and never kept.
    Uid(String),
}

impl std::fmt::Debug for SeriesKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "Number({number})"),
            Self::Uid(_) => f.write_str("Uid(..)"),
        }
    }
}

/// The number or the UID of a series.
///
/// # Errors
/// [`Fault`] unless it is a whole number from 1 or looks like a UID; what was typed is not repeated, for it may be one.
pub fn parse_series(text: &str) -> Result<SeriesKey, Fault> {
    let text = text.trim();
    let is_uid = text.contains('.')
        && text.len() <= 64
        && text.split('.').all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()));
    if is_uid {
        return Ok(SeriesKey::Uid(text.to_owned()));
    }
    let fault = |_| Fault { found: "something else".into(), expected: SERIES_EXPECTED.to_owned() };
    checked_series(text.parse().map_err(fault)?).map(SeriesKey::Number)
}

pub(super) fn checked_series(number: usize) -> Result<usize, Fault> {
    if number > 0 {
        return Ok(number);
    }
    Err(Fault { found: number.to_string(), expected: SERIES_EXPECTED.to_owned() })
}
