//! Faults as text, `KIND[:key=value,...]`, and when they strike.
//!
//! A fault strikes at an opportunity of its kind (a line for the faults of the wire; a line, a moment or a layer for the
//! others) once all its conditions hold: `line` lines received, layer `layer` begun (counted from 0), simulated time
//! `at-s` reached. `rate` makes each later opportunity a draw; `count` bounds how often it strikes (default: once, or
//! without bound where `rate`, or `for-s` on a wire fault, says how often). `for-s` is how long a lasting fault lasts, the length
//! of a `delay`, and for the other wire faults the time after which they end. All times are simulated.

use crate::{Error, rng::Rng};
use std::str::FromStr;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One bit of one byte of a line is flipped.
    BitError,
    /// One byte of a line is lost.
    LostByte,
    /// One byte of a line comes twice.
    DoubledByte,
    /// The rest of a line, its end included, is lost.
    HalfLine,
    /// An `ok` is not sent.
    LostOk,
    /// A request to send again that nobody needs.
    SpuriousResend,
    /// A line is damaged and the request to send it again names another.
    WrongResend,
    /// A line is late.
    Delay,
    /// Random bytes come before a line.
    Garbage,
    /// The port vanishes.
    Disconnect,
    /// The firmware starts anew, after a while if one is given.
    Reset,
    /// No power for a while: everything stops, heaters cool, then the firmware starts anew.
    PowerCut,
    /// The firmware stops for good.
    Kill,
    /// The hotend's heater fails.
    Runaway,
    /// The hotend's sensor fails.
    SensorOpen,
    /// The firmware neither reads nor answers.
    Silent,
    /// An axis loses steps.
    LayerShift,
    /// The nozzle lets less through.
    Clog,
    /// The nozzle drips on travel moves.
    Leak,
    /// No filament is left.
    FilamentOut,
}

/// Keys that only some kinds have.
const DIR: &str = "dir";
const MM: &str = "mm";
const AXIS: &str = "axis";
const PERCENT: &str = "percent";
/// Keys that all kinds have.
const COMMON: [&str; 6] = ["rate", "line", "layer", "at-s", "for-s", "count"];

/// Every kind with its name and its own keys.
const KINDS: [(Kind, &str, &[&str]); 20] = [
    (Kind::BitError, "bit-error", &[DIR]),
    (Kind::LostByte, "lost-byte", &[DIR]),
    (Kind::DoubledByte, "doubled-byte", &[DIR]),
    (Kind::HalfLine, "half-line", &[DIR]),
    (Kind::LostOk, "lost-ok", &[DIR]),
    (Kind::SpuriousResend, "spurious-resend", &[DIR]),
    (Kind::WrongResend, "wrong-resend", &[DIR]),
    (Kind::Delay, "delay", &[DIR]),
    (Kind::Garbage, "garbage", &[DIR]),
    (Kind::Disconnect, "disconnect", &[]),
    (Kind::Reset, "reset", &[]),
    (Kind::PowerCut, "power-cut", &[]),
    (Kind::Kill, "kill", &[]),
    (Kind::Runaway, "runaway", &[]),
    (Kind::SensorOpen, "sensor-open", &[]),
    (Kind::Silent, "silent", &[]),
    (Kind::LayerShift, "layer-shift", &[MM, AXIS]),
    (Kind::Clog, "clog", &[PERCENT]),
    (Kind::Leak, "leak", &[PERCENT]),
    (Kind::FilamentOut, "filament-out", &[]),
];

impl Kind {
    /// Its name in a SPEC.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|row| row.0 == self).map_or("", |row| row.1)
    }

    /// Whether it strikes lines, not the machine.
    #[must_use]
    pub const fn is_of_the_wire(self) -> bool {
        self.is_of_one_line() || matches!(self, Self::LostOk | Self::SpuriousResend | Self::WrongResend)
    }

    /// Whether it changes the bytes or the time of a single line, either way.
    #[must_use]
    pub const fn is_of_one_line(self) -> bool {
        matches!(
            self,
            Self::BitError
                | Self::LostByte
                | Self::DoubledByte
                | Self::HalfLine
                | Self::Delay
                | Self::Garbage
        )
    }
}

/// Which way a line goes, seen from the printer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From the host.
    Rx,
    /// To the host.
    Tx,
}

/// A fault as asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultSpec {
    /// What goes wrong.
    pub kind: Kind,
    /// Probability at each opportunity.
    pub rate: Option<f64>,
    /// Lines received before it can strike.
    pub line: Option<u64>,
    /// Layer that must have begun, counted from 0.
    pub layer: Option<usize>,
    /// Simulated time before which it does not strike, s.
    pub at_s: Option<f64>,
    /// How long, s.
    pub for_s: Option<f64>,
    /// How often at most.
    pub count: Option<u64>,
    /// Length of a layer shift.
    pub mm: f64,
    /// Axis of a layer shift: 0 X, 1 Y, 2 Z.
    pub axis: usize,
    /// How much less a clogged nozzle gives; how much of the last bead's cross-section a leaking one drips.
    pub percent: f64,
    /// Which way.
    pub direction: Direction,
}

impl FaultSpec {
    /// A fault of `kind` that strikes once, at its first opportunity.
    #[must_use]
    pub const fn new(kind: Kind) -> Self {
        let sent = matches!(kind, Kind::LostOk | Kind::SpuriousResend | Kind::WrongResend);
        Self {
            kind,
            rate: None,
            line: None,
            layer: None,
            at_s: None,
            for_s: None,
            count: None,
            mm: 1.0,
            axis: 0,
            percent: if matches!(kind, Kind::Leak) { 20.0 } else { 50.0 },
            direction: if sent { Direction::Tx } else { Direction::Rx },
        }
    }

    /// The fault of the kind called `name`.
    ///
    /// # Errors
    /// What is wrong, with the kinds there are.
    pub fn of_kind(name: &str) -> Result<Self, String> {
        KINDS.iter().find(|row| row.1 == name).map(|row| Self::new(row.0)).ok_or_else(|| {
            let known = KINDS.iter().map(|row| row.1).collect::<Vec<_>>().join(", ");
            format!("unknown kind `{name}`; the kinds are {known}")
        })
    }

    /// Sets one key from its text.
    ///
    /// # Errors
    /// What is wrong with the key or its value, and what is expected.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), String> {
        let own = KINDS.iter().find(|row| row.0 == self.kind).map_or(&[][..], |row| row.2);
        if !COMMON.contains(&key) && !own.contains(&key) {
            let known = COMMON.iter().chain(own).copied().collect::<Vec<_>>().join(", ");
            return Err(format!("{} has no key `{key}`; its keys are {known}", self.kind.name()));
        }
        match key {
            "rate" => self.rate = Some(number(key, value, 0.0, 1.0)?),
            "line" => self.line = Some(whole(key, value)?),
            "layer" => self.layer = Some(whole(key, value)?),
            "at-s" => self.at_s = Some(number(key, value, 0.0, f64::MAX)?),
            "for-s" => self.for_s = Some(number(key, value, 0.0, f64::MAX)?),
            "count" => self.count = Some(whole(key, value)?),
            MM => self.mm = number(key, value, -1000.0, 1000.0)?,
            PERCENT => self.percent = number(key, value, 0.0, 100.0)?,
            AXIS => self.axis = axis(value)?,
            _ => self.direction = self.direction_named(value)?,
        }
        Ok(())
    }

    fn direction_named(&self, value: &str) -> Result<Direction, String> {
        match value {
            "rx" if self.direction == Direction::Rx || self.kind.is_of_one_line() => Ok(Direction::Rx),
            "rx" => Err(format!("{} concerns what the printer sends: dir=tx", self.kind.name())),
            "tx" => Ok(Direction::Tx),
            _ => Err(format!("dir is `{value}`; rx or tx is expected")),
        }
    }

    /// How often it strikes at most.
    fn limit(&self) -> u64 {
        let window = self.for_s.is_some() && self.kind.is_of_the_wire() && self.kind != Kind::Delay;
        self.count.unwrap_or(if self.rate.is_some() || window { u64::MAX } else { 1 })
    }

    /// How long it is open after its conditions first held, s.
    fn window_s(&self) -> f64 {
        let window = self.kind.is_of_the_wire() && self.kind != Kind::Delay;
        if window { self.for_s.unwrap_or(f64::INFINITY) } else { f64::INFINITY }
    }
}

impl FaultSpec {
    /// Reads a SPEC.
    ///
    /// # Errors
    /// What is wrong and what is expected; the SPEC itself is not named.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (kind, keys) = text.split_once(':').unwrap_or((text, ""));
        let mut spec = Self::of_kind(kind.trim())?;
        let mut seen = Vec::new();
        for pair in keys.split(',').filter(|pair| !pair.trim().is_empty()) {
            let (key, value) = pair
                .split_once('=')
                .ok_or_else(|| format!("`{pair}` has no value; key=value is expected"))?;
            if seen.contains(&key.trim()) {
                return Err(format!("{} is given twice", key.trim()));
            }
            seen.push(key.trim());
            spec.set(key.trim(), value.trim())?;
        }
        Ok(spec)
    }
}

impl FromStr for FaultSpec {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::parse(text).map_err(|problem| Error::Fault { spec: text.to_owned(), problem })
    }
}

fn number(key: &str, value: &str, low: f64, high: f64) -> Result<f64, String> {
    let range = if high < f64::MAX { format!("{low} to {high}") } else { format!("at least {low}") };
    value
        .parse()
        .ok()
        .filter(|x: &f64| x.is_finite() && (low..=high).contains(x))
        .ok_or_else(|| format!("{key} is `{value}`; a number, {range}, is expected"))
}

fn whole<T: FromStr>(key: &str, value: &str) -> Result<T, String> {
    value.parse().ok().ok_or_else(|| format!("{key} is `{value}`; a whole number is expected"))
}

fn axis(value: &str) -> Result<usize, String> {
    match value {
        "x" | "X" => Ok(0),
        "y" | "Y" => Ok(1),
        "z" | "Z" => Ok(2),
        _ => Err(format!("axis is `{value}`; x, y or z is expected")),
    }
}

/// Where the printer is, for the conditions of a fault.
#[derive(Debug, Clone, Copy, Default)]
pub struct Progress {
    /// Simulated time, s.
    pub now_s: f64,
    /// Lines received.
    pub lines: u64,
    /// Layer that is being printed, counted from 0; none before the first.
    pub layer: Option<usize>,
}

/// A fault with its history.
#[derive(Debug, Clone)]
pub struct Armed {
    /// What was asked for.
    pub spec: FaultSpec,
    /// Its own random stream.
    pub rng: Rng,
    struck: u64,
    since_s: Option<f64>,
}

impl Armed {
    /// The `index`th fault of a run.
    #[must_use]
    pub const fn new(spec: FaultSpec, seed: u64, index: u64) -> Self {
        Self { spec, rng: Rng::new(seed, index + 1), struck: 0, since_s: None }
    }

    /// Whether it strikes at this opportunity. `is_line`: a line, at which `rate` draws.
    pub fn strikes(&mut self, at: Progress, is_line: bool) -> bool {
        let spec = &self.spec;
        let holds = self.struck < spec.limit()
            && spec.line.is_none_or(|line| at.lines >= line)
            && spec.at_s.is_none_or(|t| at.now_s >= t)
            && spec.layer.is_none_or(|layer| at.layer.is_some_and(|now| now >= layer));
        if !holds {
            return false;
        }
        let since = *self.since_s.get_or_insert(at.now_s);
        if at.now_s - since > spec.window_s() {
            return false;
        }
        let unconditional = spec.line.is_none() && spec.at_s.is_none() && spec.layer.is_none();
        let strikes = match spec.rate {
            Some(rate) => is_line && self.rng.unit() < rate,
            None => is_line || !unconditional,
        };
        self.struck += u64::from(strikes);
        strikes
    }

    /// The simulated time at which it becomes possible, where that is what it waits for.
    #[must_use]
    pub fn due_s(&self) -> Option<f64> {
        let spec = &self.spec;
        // One that also waits for a line or a layer is looked at when that comes.
        let waits = self.struck < spec.limit() && self.since_s.is_none() && !spec.kind.is_of_the_wire();
        spec.at_s.filter(|_| waits && spec.line.is_none() && spec.layer.is_none())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<FaultSpec, String> {
        text.parse().map_err(|error: Error| error.to_string())
    }

    #[test]
    fn every_kind_is_read_by_its_name() {
        for (kind, name, _) in KINDS {
            assert_eq!(parse(name).unwrap().kind, kind);
            assert_eq!(kind.name(), name);
        }
    }

    #[test]
    fn keys_are_read() {
        let spec = parse("layer-shift:layer=300,axis=y,mm=-0.4").unwrap();
        assert_eq!((spec.layer, spec.axis, spec.mm), (Some(300), 1, -0.4));
        let spec = parse("bit-error:rate=0.01,dir=tx,count=5,for-s=2,at-s=1.5,line=7").unwrap();
        assert_eq!((spec.rate, spec.direction, spec.count), (Some(0.01), Direction::Tx, Some(5)));
        assert_eq!((spec.for_s, spec.at_s, spec.line), (Some(2.0), Some(1.5), Some(7)));
    }

    #[test]
    fn wrong_specs_say_what_is_expected() {
        for (text, part) in [
            ("bit-eror", "unknown kind `bit-eror`; the kinds are bit-error, lost-byte"),
            ("kill:axis=x", "kill has no key `axis`; its keys are rate, line, layer, at-s, for-s, count"),
            ("bit-error:rate=2", "rate is `2`; a number, 0 to 1, is expected"),
            ("bit-error:rate", "`rate` has no value"),
            ("bit-error:line=-1", "a whole number is expected"),
            ("layer-shift:axis=e", "x, y or z is expected"),
            ("lost-ok:dir=rx", "dir=tx"),
            ("clog:percent=NaN", "0 to 100"),
            ("kill:line=3,line=4", "line is given twice"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(part), "{text}: {message}");
        }
    }

    fn at(now_s: f64, lines: u64) -> Progress {
        Progress { now_s, lines, layer: None }
    }

    #[test]
    fn line_condition_strikes_once_from_that_line_on() {
        let mut fault = Armed::new(parse("lost-ok:line=3").unwrap(), 0, 0);
        let struck: Vec<bool> = (1..6).map(|n| fault.strikes(at(0.0, n), true)).collect();
        assert_eq!(struck, [false, false, true, false, false]);
    }

    #[test]
    fn rate_strikes_that_share_of_lines() {
        let mut fault = Armed::new(parse("bit-error:rate=0.1").unwrap(), 3, 0);
        let n = (0..10_000).filter(|&n| fault.strikes(at(0.0, n), true)).count();
        assert!((900..1100).contains(&n), "{n}");
    }

    #[test]
    fn window_of_a_wire_fault_closes() {
        let mut fault = Armed::new(parse("garbage:at-s=1,for-s=2").unwrap(), 0, 0);
        let struck: Vec<bool> =
            [0.0, 1.0, 2.0, 3.0, 3.1].map(|t| fault.strikes(at(t, 1), true)).into_iter().collect();
        assert_eq!(struck, [false, true, true, true, false]);
    }

    #[test]
    fn moment_strikes_without_a_line() {
        let mut fault = Armed::new(parse("kill:at-s=5").unwrap(), 0, 0);
        assert_eq!(fault.due_s(), Some(5.0));
        assert!(!fault.strikes(at(4.9, 0), false));
        assert!(fault.strikes(at(5.0, 0), false));
        assert_eq!(fault.due_s(), None);
        assert!(!fault.strikes(at(6.0, 0), false));
    }
}
