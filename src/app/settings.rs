//! The parameters of a case: what an operator may ask for, with defaults and ranges.
//!
//! [`CaseFile`] is the document: every key may be absent. Flags of the command line and an input case file are such
//! documents too, laid one [over](CaseFile::over) the other. [`Settings`] is what it comes to once the defaults are
//! filled in and every value was checked. Keys are the flags' names with underscores, units included.

use crate::mesh;
use crate::phantom;
use crate::ready::Label;
use crate::sections::Boundary;
use crate::segment::{Corrections, Polarity};
use crate::solid::Correspondence;
use crate::topology::Decisions;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::PathBuf;

/// The number of the format that `case.toml` is written in.
const FORMAT: u32 = 1;
/// `--wall-mm` where nothing is said.
pub const DEFAULT_WALL_MM: f64 = 1.0;
/// `--layer-mm` where nothing is said.
pub const DEFAULT_LAYER_MM: f64 = 0.2;
/// `--profile` where nothing is said.
pub const DEFAULT_PROFILE: &str = "marlin";
/// `--port` where nothing is said: the simulated printer.
pub const SIMULATED_PORT: &str = "sim";

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

const SEED_EXPECTED: &str = "X,Y,Z: three numbers in mm (LPS) separated by commas; or auto";
const WINDOW_EXPECTED: &str = "LO,HI: two numbers in HU separated by a comma, LO less than HI";
const Z_EXPECTED: &str = "A,B: two heights in mm separated by a comma, A less than B";

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
fn ascending([lo, hi]: [f64; 2], expected: &str) -> Result<[f64; 2], Fault> {
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

const SERIES_EXPECTED: &str = "a number from 1, as `lumenfab inspect` lists them, or a SeriesInstanceUID";

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

fn checked_series(number: usize) -> Result<usize, Fault> {
    if number > 0 {
        return Ok(number);
    }
    Err(Fault { found: number.to_string(), expected: SERIES_EXPECTED.to_owned() })
}

/// Where the contours come from.
#[derive(Debug, Clone, PartialEq)]
pub enum Source {
    /// A CT; where it lies is kept apart from the case ([`super::source`]).
    Ct,
    /// A synthetic CT, made anew when it is needed.
    Phantom(phantom::Params),
    /// A segmentation made elsewhere; where it lies is kept apart, as for a CT.
    Ready {
        /// Whether there is a CT as well, to compare with.
        has_ct: bool,
        /// Which structure; `None`: the only one.
        label: Option<Label>,
    },
    /// A ready `sections.json`: there is no image.
    Sections,
}

/// How the lumen is found in the CT.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentSettings {
    /// Number of the series in the folder, from 1; `None`: the only one.
    pub series: Option<usize>,
    /// Whether a stack with missing planes is used.
    pub allow_gaps: bool,
    /// Points inside the lumen, LPS, mm; none for a phantom, which knows its own, or where the vessel is found.
    pub seed_mm: Vec<[f64; 3]>,
    /// Whether the vessel is found by itself.
    pub auto_seed: bool,
    /// Intensities of the lumen; `None`: found from the seed's neighbourhood.
    pub window_hu: Option<[f64; 2]>,
    /// Whether the lumen is brighter or darker than its wall.
    pub polarity: Polarity,
    /// Which grey value the boundary is.
    pub boundary: Boundary,
    /// Heights along the stack's normal that are used; `None`: all.
    pub z_mm: Option<[f64; 2]>,
    /// What the operator has corrected.
    pub corrections: Corrections,
}

/// What is printed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Body {
    /// A hollow vessel with a wall of this thickness, mm.
    WallMm(f64),
    /// The lumen as a solid body.
    Cast,
}

/// Every parameter of a case, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Where the contours come from.
    pub source: Source,
    /// How the lumen is found.
    pub segment: SegmentSettings,
    /// What is printed.
    pub body: Body,
    /// Which points of neighbouring sections correspond.
    pub correspondence: Correspondence,
    /// What the operator has decided about the topology.
    pub decisions: Decisions,
    /// Layer height, mm.
    pub layer_mm: f64,
    /// The printer's profile: a name, or the path of a profile file.
    pub profile: String,
    /// The printer's port: a path, or `sim`.
    pub port: String,
}

/// The `source` key: where the contours come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SourceName {
    /// A CT.
    Ct,
    /// A synthetic CT.
    Phantom,
    /// Ready contours.
    Sections,
    /// A segmentation made elsewhere.
    Segmentation,
    /// The same, and the CT it was made on.
    #[serde(rename = "ct-and-segmentation")]
    CtAndSegmentation,
}

/// The `[solid]` table: how the solid is put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolidKeys {
    /// Which points of neighbouring sections correspond.
    pub correspondence: Option<Correspondence>,
}

/// Parameters as they are written down: any may be absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseFile {
    /// The format's number; only in a case directory's copy.
    pub format: Option<u32>,
    /// The case's generated name; only in a case directory's copy.
    pub id: Option<String>,
    /// Where the contours come from; only in a case directory's copy.
    pub source: Option<SourceName>,
    /// The CT's folder; only in an input case file, relative to it.
    pub ct: Option<PathBuf>,
    /// A segmentation made elsewhere; only in an input case file, relative to it.
    pub segmentation: Option<PathBuf>,
    /// Which structure of the segmentation, where it holds several.
    pub label: Option<Label>,
    /// Which series of the CT's folder, where there are several; its UID in an input case file only.
    pub series: Option<SeriesKey>,
    /// Use a stack with missing planes, with a warning.
    pub allow_gaps: Option<bool>,
    /// Points inside the lumen, LPS, mm, or `auto`.
    pub seed_mm: Option<Seeds>,
    /// Intensities of the lumen, HU.
    pub window_hu: Option<[f64; 2]>,
    /// Whether the lumen is brighter or darker than its wall.
    pub polarity: Option<Polarity>,
    /// Which grey value the boundary is.
    pub boundary: Option<Boundary>,
    /// Heights that are used, mm.
    pub z_mm: Option<[f64; 2]>,
    /// Thickness of the wall, mm.
    pub wall_mm: Option<f64>,
    /// Print the lumen as a solid body instead of a wall around it.
    pub cast: Option<bool>,
    /// Layer height, mm.
    pub layer_mm: Option<f64>,
    /// The printer's profile.
    pub profile: Option<String>,
    /// The printer's port.
    pub port: Option<String>,
    /// A synthetic CT instead of a real one.
    pub phantom: Option<phantom::Params>,
    /// What the operator has corrected about the lumen.
    pub segment: Option<Corrections>,
    /// How the solid is put together.
    pub solid: Option<SolidKeys>,
    /// What the operator has decided about the topology.
    pub topology: Option<Decisions>,
}

impl CaseFile {
    /// Reads the document.
    ///
    /// # Errors
    /// One line that says what is wrong and where.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let file: Self = toml::from_str(text).map_err(|e| {
            let before = &text[..e.span().map_or(0, |s| s.start)];
            format!("line {}: {}", before.matches('\n').count() + 1, e.message().replace('\n', " "))
        })?;
        match file.format {
            Some(format) if format != FORMAT => {
                Err(format!("format is {format}, expected {FORMAT}: written by another version of lumenfab"))
            }
            _ => Ok(file),
        }
    }

    /// Writes the document.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers, strings and lists can be written as TOML")
    }

    /// The document of a case directory: every default filled in. What has none is absent: `window_hu` is then
    /// found from the seed's neighbourhood, `z_mm` means all planes.
    #[must_use]
    pub fn of_case(id: &str, settings: &Settings) -> Self {
        let (source, phantom) = match &settings.source {
            Source::Ct => (SourceName::Ct, None),
            Source::Phantom(phantom) => (SourceName::Phantom, Some(phantom.clone())),
            Source::Sections => (SourceName::Sections, None),
            Source::Ready { has_ct: true, .. } => (SourceName::CtAndSegmentation, None),
            Source::Ready { has_ct: false, .. } => (SourceName::Segmentation, None),
        };
        // A name may say anything; the case knows the structure by its number.
        let label = match &settings.source {
            Source::Ready { label: Some(Label::Number(n)), .. } => Some(Label::Number(*n)),
            _ => None,
        };
        let (wall_mm, cast) = match settings.body {
            Body::WallMm(t) => (Some(t), false),
            Body::Cast => (None, true),
        };
        let segment = &settings.segment;
        Self {
            format: Some(FORMAT),
            id: Some(id.to_owned()),
            source: Some(source),
            ct: None,
            segmentation: None,
            label,
            series: segment.series.map(SeriesKey::Number),
            allow_gaps: Some(segment.allow_gaps),
            seed_mm: segment.seeds(),
            window_hu: segment.window_hu,
            polarity: Some(segment.polarity),
            boundary: Some(segment.boundary),
            z_mm: segment.z_mm,
            wall_mm,
            cast: Some(cast),
            layer_mm: Some(settings.layer_mm),
            profile: Some(settings.profile.clone()),
            port: Some(settings.port.clone()),
            phantom,
            segment: (!segment.corrections.is_empty()).then(|| segment.corrections.clone()),
            solid: Some(SolidKeys { correspondence: Some(settings.correspondence) }),
            topology: (!settings.decisions.is_empty()).then(|| settings.decisions.clone()),
        }
    }

    /// This document's values where it has them, else those of `below`.
    #[must_use]
    pub fn over(self, below: Self) -> Self {
        // Wall and cast are one choice between two: naming one takes back the other.
        let (wall_mm, cast) = match (self.wall_mm, self.cast) {
            (None, None) => (below.wall_mm, below.cast),
            chosen => chosen,
        };
        Self {
            format: self.format.or(below.format),
            id: self.id.or(below.id),
            source: self.source.or(below.source),
            ct: self.ct.or(below.ct),
            segmentation: self.segmentation.or(below.segmentation),
            label: self.label.or(below.label),
            series: self.series.or(below.series),
            allow_gaps: self.allow_gaps.or(below.allow_gaps),
            seed_mm: self.seed_mm.or(below.seed_mm),
            window_hu: self.window_hu.or(below.window_hu),
            polarity: self.polarity.or(below.polarity),
            boundary: self.boundary.or(below.boundary),
            z_mm: self.z_mm.or(below.z_mm),
            wall_mm,
            cast,
            layer_mm: self.layer_mm.or(below.layer_mm),
            profile: self.profile.or(below.profile),
            port: self.port.or(below.port),
            phantom: self.phantom.or(below.phantom),
            segment: self.segment.or(below.segment),
            solid: self.solid.or(below.solid),
            topology: self.topology.or(below.topology),
        }
    }

    fn source(&self) -> Result<Source, SettingError> {
        let ready = |has_ct| {
            self.only_ready()?;
            Ok(Source::Ready { has_ct, label: self.label.clone() })
        };
        match self.named_source().unwrap_or(SourceName::Phantom) {
            SourceName::Segmentation => ready(false),
            SourceName::CtAndSegmentation => ready(true),
            SourceName::Sections => Ok(Source::Sections),
            SourceName::Phantom if self.phantom.is_none() => self.default_phantom(),
            SourceName::Phantom => {
                let phantom = self.phantom.clone().unwrap_or_default();
                let unusable = |e: phantom::Error| Fault {
                    found: e.to_string(),
                    expected: "a phantom within its ranges".into(),
                };
                phantom.check().map_err(unusable).map_err(in_setting("phantom"))?;
                Ok(Source::Phantom(phantom))
            }
            SourceName::Ct if self.phantom.is_some() => {
                let fault = Fault { found: "a CT and a phantom".into(), expected: "one of the two".into() };
                Err(SettingError { name: "phantom".into(), fault })
            }
            SourceName::Ct => Ok(Source::Ct),
        }
    }

    /// Refuses what is said of finding a lumen beside a segmentation in which it has been found.
    fn only_ready(&self) -> Result<(), SettingError> {
        let of_growing = [
            ("phantom", self.phantom.is_some()),
            ("seed_mm", self.seed_mm.as_ref().is_some_and(|seeds| !seeds.0.is_empty())),
            ("window_hu", self.window_hu.is_some()),
            ("polarity", self.polarity.is_some_and(|p| p != Polarity::default())),
            ("boundary", self.boundary.is_some_and(|b| b != Boundary::default())),
            ("segment", self.segment.as_ref().is_some_and(|c| !c.is_empty())),
        ];
        let Some((name, _)) = of_growing.into_iter().find(|(_, is_given)| *is_given) else { return Ok(()) };
        let expected =
            "none: in a ready segmentation the lumen is found already; leave this out, or the segmentation";
        let fault = Fault { found: "one beside a segmentation".into(), expected: expected.into() };
        Err(SettingError { name: name.into(), fault })
    }

    /// The source that is stated, else the one that paths are given of.
    #[must_use]
    pub fn named_source(&self) -> Option<SourceName> {
        let by_paths = match (self.ct.is_some(), self.segmentation.is_some()) {
            (true, true) => Some(SourceName::CtAndSegmentation),
            (true, false) => Some(SourceName::Ct),
            (false, true) => Some(SourceName::Segmentation),
            (false, false) => None,
        };
        self.source.or(by_paths)
    }

    /// The phantom that nobody has asked for: whoever says how a CT is to be read has forgotten to name it.
    fn default_phantom(&self) -> Result<Source, SettingError> {
        let meant_for_a_ct = [
            ("seed_mm", self.seed_mm.is_some()),
            ("segment", self.segment.is_some()),
            ("window_hu", self.window_hu.is_some()),
            ("z_mm", self.z_mm.is_some()),
            ("label", self.label.is_some()),
            ("series", self.series.is_some()),
            ("allow_gaps", self.allow_gaps.is_some()),
        ];
        let Some((given, _)) = meant_for_a_ct.into_iter().find(|(_, is_given)| *is_given) else {
            return Ok(Source::Phantom(phantom::Params::default()));
        };
        let expected = "the CT that it is said of".to_owned();
        Err(SettingError {
            name: "ct".into(),
            fault: Fault { found: format!("none beside {given}"), expected },
        })
    }

    /// The number of the series; a UID has to have been looked up before.
    fn series_number(&self) -> Result<Option<usize>, Fault> {
        match &self.series {
            None => Ok(None),
            Some(SeriesKey::Number(number)) => checked_series(*number).map(Some),
            Some(SeriesKey::Uid(_)) => {
                let expected = "a CT in whose folder it can be looked up".to_owned();
                Err(Fault { found: "a UID".into(), expected })
            }
        }
    }

    fn body(&self) -> Result<Body, SettingError> {
        match (self.wall_mm, self.cast.unwrap_or(false)) {
            (Some(t), true) => {
                let fault = Fault { found: t.to_string(), expected: "none together with cast".into() };
                Err(SettingError { name: "wall_mm".into(), fault })
            }
            (None, true) => Ok(Body::Cast),
            (wall, false) => {
                let checked = WALL_MM.check(wall.unwrap_or(DEFAULT_WALL_MM));
                checked.map(Body::WallMm).map_err(in_setting("wall_mm"))
            }
        }
    }

    fn segment(&self, source: &Source) -> Result<SegmentSettings, SettingError> {
        let seeds = self.seed_mm.clone().unwrap_or(Seeds(Vec::new()));
        let (seed_mm, auto_seed) = (seeds.points_mm(), seeds.is_auto());
        let fault = |found: String| SettingError {
            name: "seed_mm".into(),
            fault: Fault { found, expected: SEED_EXPECTED.to_owned() },
        };
        if auto_seed && !seed_mm.is_empty() {
            return Err(fault("auto and points".into()));
        }
        if let Some(seed) = seed_mm.iter().find(|seed| seed.iter().any(|c| !c.is_finite())) {
            return Err(fault(format!("{},{},{}", seed[0], seed[1], seed[2])));
        }
        if matches!(source, Source::Ct) && seeds.0.is_empty() {
            return Err(fault("none".into()));
        }
        let checked = |name, range: Option<[f64; 2]>, expected| {
            range.map(|r| ascending(r, expected)).transpose().map_err(in_setting(name))
        };
        let corrections = self.segment.clone().unwrap_or_default();
        corrections.check().map_err(in_correction)?;
        Ok(SegmentSettings {
            series: self.series_number().map_err(in_setting("series"))?,
            allow_gaps: self.allow_gaps.unwrap_or(false),
            seed_mm,
            auto_seed,
            corrections,
            window_hu: checked("window_hu", self.window_hu, WINDOW_EXPECTED)?,
            polarity: self.polarity.unwrap_or_default(),
            boundary: self.boundary.unwrap_or_default(),
            z_mm: checked("z_mm", self.z_mm, Z_EXPECTED)?,
        })
    }
}

fn in_setting(name: &'static str) -> impl FnOnce(Fault) -> SettingError {
    move |fault| SettingError { name: name.into(), fault }
}

fn in_correction(fault: crate::segment::corrections::Fault) -> SettingError {
    let (found, expected) = (fault.found, fault.expected);
    SettingError { name: fault.key.into(), fault: Fault { found, expected } }
}

impl SegmentSettings {
    /// The seeds as they are written.
    fn seeds(&self) -> Option<Seeds> {
        if self.auto_seed {
            return Some(Seeds(vec![Seed::Auto]));
        }
        let points = self.seed_mm.iter().copied().map(Seed::Point).collect();
        (!self.seed_mm.is_empty()).then_some(Seeds(points))
    }
}

impl TryFrom<CaseFile> for Settings {
    type Error = SettingError;

    fn try_from(file: CaseFile) -> Result<Self, SettingError> {
        let source = file.source()?;
        let named = |name, value: Option<String>, default: &str| match value {
            Some(text) if text.trim().is_empty() => Err(in_setting(name)(Fault {
                found: format!("{text:?}"),
                expected: "a name or a path".into(),
            })),
            other => Ok(other.unwrap_or_else(|| default.to_owned())),
        };
        Ok(Self {
            segment: file.segment(&source)?,
            source,
            body: file.body()?,
            correspondence: file.solid.unwrap_or_default().correspondence.unwrap_or_default(),
            decisions: file.topology.clone().unwrap_or_default(),
            layer_mm: LAYER_MM
                .check(file.layer_mm.unwrap_or(DEFAULT_LAYER_MM))
                .map_err(in_setting("layer_mm"))?,
            profile: named("profile", file.profile, DEFAULT_PROFILE)?,
            port: named("port", file.port, SIMULATED_PORT)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Result<Settings, String> {
        Settings::try_from(CaseFile::from_toml(text)?).map_err(|e| e.to_string())
    }

    #[test]
    fn an_empty_file_is_the_phantom_with_all_defaults() {
        let s = settings("").unwrap();
        assert_eq!(s.source, Source::Phantom(phantom::Params::default()));
        assert_eq!(s.body, Body::WallMm(1.0));
        assert_eq!((s.layer_mm, s.profile.as_str(), s.port.as_str()), (0.2, "marlin", "sim"));
    }

    #[test]
    fn a_case_directorys_copy_reads_back_and_holds_no_source_path() {
        let text =
            "ct = \"/data/jane-doe\"\nseed_mm = [[-221.4, 22.5, 165]]\nwindow_hu = [250, 650]\ncast = true";
        let s = settings(text).unwrap();
        let copy = CaseFile::of_case("some-id", &s).to_toml();
        assert!(!copy.contains("jane"), "{copy}");
        assert_eq!(settings(&copy).unwrap(), s);
        let phantom = settings("wall_mm = 2\n[phantom]\nkind = \"stenosis\"\n").unwrap();
        assert_eq!(settings(&CaseFile::of_case("i", &phantom).to_toml()).unwrap(), phantom);
    }

    #[test]
    fn decisions_about_the_topology_are_kept_as_they_were_written() {
        let text = "[solid]\ncorrespondence = \"published\"\n[[topology.link]]\nplane = 12\nlower = 0\nupper = [31.5, -4.0]\njoin = false\n\
                    [[topology.drop]]\nplane = 3\ncontour = 2\n";
        let s = settings(text).unwrap();
        assert_eq!(s.correspondence, Correspondence::Published);
        assert_eq!((s.decisions.link.len(), s.decisions.drop.len()), (1, 1));
        assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
        let wrong = settings("[[topology.drop]]\nplane = 3\ncontour = \"all\"\n").unwrap_err();
        assert!(wrong.starts_with("line 3: expected the number of a contour, or a point"), "{wrong}");
        let unknown = settings("[[topology.link]]\nplan = 3\n").unwrap_err();
        assert!(unknown.contains("unknown field `plan`"), "{unknown}");
    }

    #[test]
    fn each_bad_value_is_named_with_what_was_found_and_expected() {
        for (text, message) in [
            ("wall_mm = 0", "wall_mm: found 0, expected a number from 0.1 to 20 mm"),
            ("wall_mm = nan", "wall_mm: found NaN, expected a number from 0.1 to 20 mm"),
            ("layer_mm = -0.2", "layer_mm: found -0.2, expected a number from 0.02 to 1 mm"),
            ("wall_mm = 1\ncast = true", "wall_mm: found 1, expected none together with cast"),
            (
                "ct = \"d\"\nseed_mm = [[1, 2, 3]]\nwindow_hu = [300, 200]",
                "window_hu: found 300,200, expected LO,HI: two numbers in HU separated by a comma, LO less than HI",
            ),
            (
                "ct = \"d\"\nseed_mm = [[1, 2, 3]]\nz_mm = [5, 5]",
                "z_mm: found 5,5, expected A,B: two heights in mm separated by a comma, A less than B",
            ),
            (
                "ct = \"d\"",
                "seed_mm: found none, expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
            ),
            (
                "ct = \"d\"\nseed_mm = [[1, inf, 2]]",
                "seed_mm: found 1,inf,2, expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
            ),
            ("profile = \"\"", "profile: found \"\", expected a name or a path"),
            (
                "[phantom]\nnoise_hu = -1",
                "phantom: found phantom parameter noise_hu is -1: choose a value from 0 to 500, expected a phantom within its ranges",
            ),
            ("window_hu = [200, 300]", "ct: found none beside window_hu, expected the CT that it is said of"),
            ("ct = \"d\"\n[phantom]", "phantom: found a CT and a phantom, expected one of the two"),
            ("format = 9", "format is 9, expected 1: written by another version of lumenfab"),
        ] {
            assert_eq!(settings(text).unwrap_err(), message, "{text}");
        }
        let unknown = settings("\nwall = 1").unwrap_err();
        assert!(unknown.starts_with("line 2: unknown field `wall`"), "{unknown}");
    }

    #[test]
    fn texts_of_flags_are_checked_the_same_way() {
        assert_eq!(parse_seed_mm("-221.4, 22.5,165").unwrap(), Seed::Point([-221.4, 22.5, 165.0]));
        for bad in ["1,2", "1,2,3,4", "1,2,x", "1,2,nan", ""] {
            assert!(parse_seed_mm(bad).is_err(), "{bad}");
        }
        assert!(parse_window_hu("650,250").is_err() && parse_z_mm("nan,2").is_err());
        assert!(
            WALL_MM.parse("1.5").is_ok() && WALL_MM.parse("1.5mm").is_err() && WALL_MM.parse("inf").is_err()
        );
    }

    #[test]
    fn a_series_is_named_by_its_number_or_its_uid() {
        assert_eq!(parse_series(" 2 ").unwrap(), SeriesKey::Number(2));
        assert_eq!(parse_series("1.2.840.1").unwrap(), SeriesKey::Uid("1.2.840.1".into()));
        for bad in ["0", "-1", "1..2", "1.2.x", "1.2.", "two", ""] {
            assert!(parse_series(bad).is_err(), "{bad}");
        }
        // Neither a fault nor a log repeats what may be a patient's.
        assert!(!parse_series("1.2.840.7x").unwrap_err().to_string().contains("840"));
        assert!(!format!("{:?}", parse_series("1.2.840.7")).contains("840"));
        let unresolved = settings("ct = \"d\"\nseed_mm = [[1, 2, 3]]\nseries = \"1.2.840.7\"").unwrap_err();
        assert_eq!(unresolved, "series: found a UID, expected a CT in whose folder it can be looked up");
        let s = settings("ct = \"d\"\nseed_mm = [[1, 2, 3]]\nseries = 2").unwrap();
        assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
    }

    #[test]
    fn seeds_are_points_or_the_word_auto() {
        let auto = settings("ct = \"d\"\nseed_mm = \"auto\"\n").unwrap();
        assert!(auto.segment.auto_seed && auto.segment.seed_mm.is_empty());
        let copy = CaseFile::of_case("i", &auto).to_toml();
        assert!(copy.contains("seed_mm = \"auto\""), "{copy}");
        assert_eq!(settings(&copy).unwrap(), auto);
        assert_eq!(parse_seed_mm(" auto").unwrap(), Seed::Auto);
        let wrong = settings("ct = \"d\"\nseed_mm = \"best\"\n").unwrap_err();
        assert!(wrong.starts_with("line 2: expected [[X, Y, Z], ...]"), "{wrong}");
        let both = Seeds(vec![Seed::Auto, Seed::Point([1.0, 2.0, 3.0])]);
        let file = CaseFile { ct: Some("d".into()), seed_mm: Some(both), ..CaseFile::default() };
        let refused = Settings::try_from(file).unwrap_err().to_string();
        assert!(refused.starts_with("seed_mm: found auto and points, expected X,Y,Z"), "{refused}");
    }

    #[test]
    fn corrections_are_kept_as_they_were_written_and_checked() {
        let text = "ct = \"d\"\nseed_mm = [[1, 2, 3]]\n[[segment.block]]\nz_mm = [1, 2]\n[[segment.window]]\nz_mm = [3, 4]\n\
                    window_hu = [100, 300]\n[[segment.contour]]\nz_mm = 5\npoints_mm = [[0, 0], [4, 0], [4, 4]]\n";
        let s = settings(text).unwrap();
        assert_eq!((s.segment.corrections.block.len(), s.segment.corrections.contour.len()), (1, 1));
        assert_eq!(settings(&CaseFile::of_case("i", &s).to_toml()).unwrap(), s);
        let wrong = settings(&text.replace("[1, 2]\n[[segment.w", "[2, 1]\n[[segment.w")).unwrap_err();
        assert_eq!(
            wrong,
            "segment.block[1].z_mm: found 2,1, expected two finite heights in mm, the first not above the second"
        );
    }

    #[test]
    fn nothing_about_growing_is_taken_beside_a_ready_segmentation() {
        let ready = "segmentation = \"labels.nrrd\"\n";
        for (key, line) in [
            ("phantom", "[phantom]\nkind = \"tube\"\n"),
            ("seed_mm", "seed_mm = [[1, 2, 3]]\n"),
            ("seed_mm", "seed_mm = \"auto\"\n"),
            ("window_hu", "window_hu = [100, 300]\n"),
            ("polarity", "polarity = \"dark\"\n"),
            ("boundary", "boundary = \"snake\"\n"),
            ("segment", "[[segment.block]]\nz_mm = [1, 2]\n"),
        ] {
            for with_ct in ["", "ct = \"d\"\n"] {
                let refused = settings(&format!("{with_ct}{ready}{line}")).unwrap_err();
                assert_eq!(
                    refused,
                    format!(
                        "{key}: found one beside a segmentation, expected none: in a ready segmentation the lumen is found already; leave this out, or the segmentation"
                    )
                );
            }
        }
        let kept = settings(&format!("{ready}z_mm = [1, 9]\n")).unwrap();
        assert_eq!(settings(&CaseFile::of_case("i", &kept).to_toml()).unwrap(), kept);
    }

    #[test]
    fn naming_a_wall_takes_back_a_cast_and_the_other_way_round() {
        let cast = CaseFile { cast: Some(true), ..CaseFile::default() };
        let wall = CaseFile { wall_mm: Some(2.0), ..CaseFile::default() };
        assert_eq!(Settings::try_from(wall.clone().over(cast.clone())).unwrap().body, Body::WallMm(2.0));
        assert_eq!(Settings::try_from(cast.over(wall)).unwrap().body, Body::Cast);
    }
}
