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
//! What the command line says goes before; its faults are added.

use crate::{Error, spec::FaultSpec};
use serde::Deserialize;
use std::{path::Path, str::FromStr};

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
#[serde(deny_unknown_fields)]
struct File {
    profile: Option<String>,
    speed: Option<SpeedText>,
    baud: Option<u32>,
    seed: Option<u64>,
    once: Option<bool>,
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
    /// Faults.
    pub faults: Vec<FaultSpec>,
}

impl Scenario {
    /// Reads the text of the file at `path` (the path is for messages only).
    ///
    /// # Errors
    /// [`Error::Scenario`] with line and column for what is no TOML or has unknown keys; [`Error::Fault`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let fail = |problem: String| Error::Scenario { path: path.to_owned(), problem };
        let file: File =
            toml::from_str(text).map_err(|error| fail(error.to_string().trim_end().to_owned()))?;
        let speed = match file.speed {
            None => None,
            Some(SpeedText::Word(word)) => Some(word.parse()),
            Some(SpeedText::Factor(factor)) => Some(factor.to_string().parse()),
            Some(SpeedText::Whole(factor)) => Some(factor.to_string().parse()),
        };
        let mut faults =
            file.faults.iter().map(|spec| spec.parse()).collect::<Result<Vec<FaultSpec>, _>>()?;
        for table in &file.fault {
            faults.push(fault_from_table(table)?);
        }
        Ok(Self {
            profile: file.profile,
            speed: speed.transpose().map_err(|problem| fail(format!("speed {problem}")))?,
            baud: file.baud,
            seed: file.seed,
            once: file.once,
            faults,
        })
    }
}

fn fault_from_table(table: &toml::Table) -> Result<FaultSpec, Error> {
    let fail = |problem| Error::Fault { spec: format!("[[fault]] {table}").replace('\n', " "), problem };
    let kind = table.get("kind").and_then(toml::Value::as_str);
    let kind = kind.ok_or_else(|| fail("the key `kind` is missing or not a text".to_owned()))?;
    let mut spec = FaultSpec::of_kind(kind).map_err(fail)?;
    for (key, value) in table.iter().filter(|(key, _)| *key != "kind") {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        spec.set(key, &text).map_err(fail)?;
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
            ("speed = \"fast\"", "realtime, max or a factor"),
            ("speed = -2", "realtime, max or a factor"),
            ("faults = [\"kil\"]", "unknown kind `kil`"),
            ("[[fault]]\nlayer = 3", "`kind` is missing"),
            ("[[fault]]\nkind = \"kill\"\nmm = 3", "kill has no key `mm`"),
            ("seed = ", "s.toml"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
