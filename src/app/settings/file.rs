//! The document: parameters as they are written down, and what they come to.

use super::values::{
    Fault, LAYER_MM, SEED_EXPECTED, Seed, Seeds, SeriesKey, SettingError, WALL_MM, WINDOW_EXPECTED,
    Z_EXPECTED, ascending, checked_series,
};
use super::{
    Body, DEFAULT_LAYER_MM, DEFAULT_PROFILE, DEFAULT_WALL_MM, FORMAT, SIMULATED_PORT, SegmentSettings,
    Settings, Source,
};
use crate::phantom;
use crate::ready::Label;
use crate::sections::Boundary;
use crate::segment::{Corrections, OnLeak, Polarity};
use crate::solid::Correspondence;
use crate::topology::Decisions;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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
    /// What is done where the region leaves the vessel.
    pub on_leak: Option<OnLeak>,
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
            // Beside a vessel that is found by itself, which always ends there, it would say something else.
            on_leak: (!segment.on_leak.is_default()).then_some(segment.on_leak),
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
            on_leak: self.on_leak.or(below.on_leak),
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
            ("on_leak", self.on_leak.is_some_and(|o| !o.is_default())),
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
        if auto_seed && self.on_leak == Some(OnLeak::Refuse) {
            let expected = "cut, or nothing: a vessel that is found by itself ends where it leaks".into();
            let fault = Fault { found: "refuse beside auto".into(), expected };
            return Err(SettingError { name: "on_leak".into(), fault });
        }
        if self.label.is_some() && !matches!(source, Source::Ready { .. }) {
            let expected = "the segmentation whose structure it names".into();
            let fault = Fault { found: "one without a segmentation".into(), expected };
            return Err(SettingError { name: "label".into(), fault });
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
            on_leak: self.on_leak.unwrap_or_default(),
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
