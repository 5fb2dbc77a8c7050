//! Options and faults from a TOML file.
//!
//! ```toml
//! profile = "reference"
//! speed = "max"            # or "realtime", or a factor
//! baud = 250000
//! seed = 7
//! once = true
//! faults = ["bit-error:rate=0.01", "lost-ok:line=100"]
//!
//! [[fault]]                # the same, key by key
//! kind = "layer-shift"
//! layer = 300
//! axis = "y"
//! mm = 0.4
//! ```
//!
//! Further keys: `reset-on-open`, `sensor-noise-c`. What the command line says goes before; its faults are added.

use crate::{Error, profile::Profile, spec::FaultSpec};
use serde::Deserialize;
use std::{ops::RangeInclusive, path::Path, str::FromStr};

/// Speeds of the wire that make sense, bits per second.
pub const BAUD: RangeInclusive<u32> = 300..=10_000_000;

/// Noise of a sensor that makes sense, °C.
pub const NOISE_C: RangeInclusive<f64> = 0.0..=5.0;

/// How fast simulated time passes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// So many simulated seconds a second.
    Times(f64),
    /// As fast as possible; an idle printer's clock stands still.
    Max,
}

impl FromStr for Speed {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "realtime" => Ok(Self::Times(1.0)),
            "max" => Ok(Self::Max),
            _ => text
                .parse()
                .ok()
                .filter(|factor: &f64| factor.is_finite() && *factor > 0.0)
                .map(Self::Times)
                .ok_or_else(|| format!("`{text}`: realtime, max or a factor above 0 is expected")),
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum SpeedText {
    Word(String),
    Factor(f64),
    Whole(i64),
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct File {
    profile: Option<String>,
    speed: Option<SpeedText>,
    baud: Option<u32>,
    seed: Option<u64>,
    once: Option<bool>,
    reset_on_open: Option<bool>,
    sensor_noise_c: Option<f64>,
    #[serde(default)]
    faults: Vec<String>,
    #[serde(default)]
    fault: Vec<toml::Table>,
}

/// What a scenario file says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scenario {
    /// Machine.
    pub profile: Option<String>,
    /// Speed.
    pub speed: Option<Speed>,
    /// Baud rate.
    pub baud: Option<u32>,
    /// Seed of the faults.
    pub seed: Option<u64>,
    /// Whether to end when the user leaves.
    pub once: Option<bool>,
    /// By how much a temperature reading may be off, °C.
    pub sensor_noise_c: Option<f64>,
    /// Whether opening the port resets the board.
    pub reset_on_open: Option<bool>,
    /// Faults.
    pub faults: Vec<FaultSpec>,
}

impl Scenario {
    /// Reads the text of the file at `path` (the path is for messages only).
    ///
    /// # Errors
    /// [`Error::Scenario`], which names the file, the line and column or the key, what was found and what is expected.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let fail = |problem: String| Error::Scenario { path: path.to_owned(), problem };
        let file: File =
            toml::from_str(text).map_err(|error| fail(error.to_string().trim_end().to_owned()))?;
        let scenario = Self {
            speed: file.speed.map(speed).transpose().map_err(fail)?,
            faults: faults(&file.faults, &file.fault).map_err(fail)?,
            profile: file.profile,
            baud: file.baud,
            seed: file.seed,
            once: file.once,
            reset_on_open: file.reset_on_open,
            sensor_noise_c: file.sensor_noise_c,
        };
        scenario.check().map_err(fail)?;
        Ok(scenario)
    }

    fn check(&self) -> Result<(), String> {
        if let Some(name) = &self.profile {
            Profile::by_name(name).map_err(|error| format!("profile: {error}"))?;
        }
        if let Some(noise) = self.sensor_noise_c.filter(|noise| !NOISE_C.contains(noise)) {
            let (low, high) = (NOISE_C.start(), NOISE_C.end());
            return Err(format!("sensor-noise-c is {noise}; {low} to {high} is expected"));
        }
        match self.baud {
            Some(baud) if !BAUD.contains(&baud) => {
                Err(format!("baud is {baud}; {} to {} is expected", BAUD.start(), BAUD.end()))
            }
            _ => Ok(()),
        }
    }
}

fn speed(found: SpeedText) -> Result<Speed, String> {
    let text = match found {
        SpeedText::Word(word) => word,
        SpeedText::Factor(factor) => factor.to_string(),
        SpeedText::Whole(factor) => factor.to_string(),
    };
    text.parse().map_err(|problem| format!("speed is {problem}"))
}

/// Both forms, each entry named by its place in the file.
fn faults(specs: &[String], tables: &[toml::Table]) -> Result<Vec<FaultSpec>, String> {
    let specs = specs.iter().enumerate().map(|(index, text)| {
        let named = |problem| format!("faults, entry {}, `{text}`: {problem}", index + 1);
        FaultSpec::parse(text).map_err(named)
    });
    let tables = tables.iter().enumerate().map(|(index, table)| {
        fault_from_table(table).map_err(|problem| format!("[[fault]] number {}: {problem}", index + 1))
    });
    specs.chain(tables).collect()
}

fn fault_from_table(table: &toml::Table) -> Result<FaultSpec, String> {
    let kind = table.get("kind").ok_or("the key `kind` is missing")?;
    let name = kind.as_str().ok_or_else(|| format!("kind is `{kind}`; a text is expected"))?;
    let mut spec = FaultSpec::of_kind(name)?;
    for (key, value) in table.iter().filter(|(key, _)| *key != "kind") {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        spec.set(key, &text)?;
    }
    Ok(spec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::Kind;

    fn parse(text: &str) -> Result<Scenario, String> {
        Scenario::parse(Path::new("s.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn both_forms_of_faults_are_read() {
        let scenario = parse(
            "profile = \"reference\"\nspeed = \"max\"\nseed = 7\nfaults = [\"lost-ok:line=100\"]\n\
             [[fault]]\nkind = \"layer-shift\"\nlayer = 300\naxis = \"y\"\nmm = 0.4\n",
        )
        .unwrap();
        assert_eq!(scenario.speed, Some(Speed::Max));
        assert_eq!(scenario.seed, Some(7));
        assert_eq!(scenario.faults[0].line, Some(100));
        let shift = &scenario.faults[1];
        assert_eq!((shift.kind, shift.layer, shift.axis, shift.mm), (Kind::LayerShift, Some(300), 1, 0.4));
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        for (text, part) in [
            ("profil = \"x\"", "unknown field `profil`"),
            ("speed = \"fast\"", "speed is `fast`: realtime, max or a factor"),
            ("speed = -2", "speed is `-2`: realtime, max or a factor"),
            ("profile = \"gutenberg\"", "profile: unknown profile `gutenberg`: choose one of marlin"),
            ("baud = 3", "baud is 3; 300 to 10000000 is expected"),
            ("once = 1", "expected a boolean"),
            ("sensor-noise-c = -1.0", "sensor-noise-c is -1; 0 to 5 is expected"),
            ("seed = -1", "line 1, column 8"),
            ("faults = [\"kil\"]", "faults, entry 1, `kil`: unknown kind `kil`"),
            ("faults = [\"kill\", \"kill:line=x\"]", "entry 2, `kill:line=x`: line is `x`; a whole number"),
            ("[[fault]]\nlayer = 3", "[[fault]] number 1: the key `kind` is missing"),
            ("[[fault]]\nkind = 3", "kind is `3`; a text is expected"),
            ("[[fault]]\nkind = \"kill\"\nmm = 3", "kill has no key `mm`; its keys are rate, line"),
            (
                "[[fault]]\nkind = \"clog\"\npercent = [1]",
                "percent is `[1]`; a number, 0 to 100, is expected",
            ),
            ("seed = ", "line 1, column 8"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.starts_with("scenario s.toml: ") && message.contains(part), "{text}: {message}");
        }
    }
}
