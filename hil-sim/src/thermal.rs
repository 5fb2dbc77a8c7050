//! Heaters: first order, ideal controller, the firmware's own protection.
//!
//! `dT/dt = (T_end - T) / tau`, where `T_end` is the full-power temperature while heating and the room's while cooling.
//! Below its target a heater runs at full power; on reaching it, the temperature stays (the power that this needs is
//! what reports show); above it, the power is off. All of it in closed form: the temperature is exact at any time,
//! however rarely it is asked for. Protection as in Marlin: a heater that does not warm by 2 °C within its watch time
//! (`Heating failed`), falls below its target by the hysteresis for the protection time (`Thermal Runaway`), or reads
//! impossibly cold (`MINTEMP triggered`). Temperatures °C, times s.
//!
//! The sensor's noise, where a machine has any, is a bounded, deterministic function of the time, so that a reading does not
//! depend on how often it is taken.
//!
//! Not done: the fan's cooling, the bed's warmth in the room.

use crate::{profile::HeaterData, rng::Rng, whole};

/// How many degrees it must have warmed within the watch time.
const WATCH_INCREASE_C: f64 = 2.0;
/// What an open sensor reads.
const OPEN_SENSOR_C: f64 = -14.0;

/// What the protection of a heater is looking at.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Guard {
    /// No target.
    Off,
    /// Warming: by `by_s` it must read `at_least_c`.
    Watching { by_s: f64, at_least_c: f64 },
    /// At its target; `since_s`: has been too cold since.
    Holding { since_s: Option<f64> },
}

/// A heater and what it heats.
#[derive(Debug, Clone)]
pub struct Heater {
    /// Its figures.
    pub model: HeaterData,
    ambient_c: f64,
    /// What it shall have; 0 is off.
    pub target_c: f64,
    /// Temperature at `since_s`.
    base_c: f64,
    since_s: f64,
    guard: Guard,
    /// Its element no longer heats.
    pub dead: bool,
    /// Its sensor is open.
    pub sensor_open: bool,
    given_up: bool,
    /// By how much a reading may be off, °C.
    noise_c: f64,
}

impl Heater {
    /// One at room temperature, off.
    #[must_use]
    pub const fn new(model: HeaterData, ambient_c: f64) -> Self {
        Self {
            model,
            ambient_c,
            target_c: 0.0,
            base_c: ambient_c,
            since_s: 0.0,
            guard: Guard::Off,
            dead: false,
            sensor_open: false,
            given_up: false,
            noise_c: 0.0,
        }
    }

    /// The same with a sensor whose readings may be off by `noise_c`, °C.
    #[must_use]
    pub const fn with_noise(mut self, noise_c: f64) -> Self {
        self.noise_c = noise_c;
        self
    }

    /// True temperature at `t_s`, not before the last change.
    #[must_use]
    pub fn temperature_c(&self, t_s: f64) -> f64 {
        let elapsed = (t_s - self.since_s).max(0.0);
        let toward = |end: f64| (self.base_c - end).mul_add((-elapsed / self.model.tau_s).exp(), end);
        if self.dead || self.target_c <= self.base_c {
            let cooled = toward(self.ambient_c);
            if self.dead { cooled } else { cooled.max(self.target_c.min(self.base_c)) }
        } else {
            toward(self.model.full_power_c).min(self.target_c)
        }
    }

    /// What the sensor says at `t_s`.
    #[must_use]
    pub fn reading_c(&self, t_s: f64) -> f64 {
        if self.sensor_open {
            OPEN_SENSOR_C
        } else if self.noise_c > 0.0 {
            let part = 2.0f64.mul_add(Rng::new(t_s.to_bits(), 0).unit(), -1.0);
            self.noise_c.mul_add(part, self.temperature_c(t_s))
        } else {
            self.temperature_c(t_s)
        }
    }

    /// Power at `t_s` as the firmware reports it, 0 to 127.
    #[must_use]
    pub fn power(&self, t_s: f64) -> u8 {
        let reading = self.reading_c(t_s);
        if self.target_c <= 0.0 || reading > self.target_c + 0.01 {
            0
        } else if reading < self.target_c - 0.01 {
            127
        } else {
            let share = (self.target_c - self.ambient_c) / (self.model.full_power_c - self.ambient_c);
            whole::to_u8(share.clamp(0.0, 1.0) * 127.0)
        }
    }

    /// Changes what is going on at `t_s` without a jump in temperature.
    fn rebase(&mut self, t_s: f64) {
        self.base_c = self.temperature_c(t_s);
        self.since_s = t_s;
    }

    /// Sets the target, bounded by the highest; 0 is off.
    pub fn set_target(&mut self, t_s: f64, target_c: f64) {
        self.rebase(t_s);
        self.target_c = if self.given_up { 0.0 } else { target_c.clamp(0.0, self.model.max_target_c) };
        self.guard = if self.target_c <= 0.0 {
            Guard::Off
        } else if self.reading_c(t_s) + WATCH_INCREASE_C + 1.0 < self.target_c {
            self.watch(t_s)
        } else {
            Guard::Holding { since_s: None }
        };
    }

    fn watch(&self, t_s: f64) -> Guard {
        let at_least_c = self.reading_c(t_s) + WATCH_INCREASE_C;
        Guard::Watching { by_s: t_s + self.model.watch_s, at_least_c }
    }

    /// Lets its element fail at `t_s`.
    pub fn break_element(&mut self, t_s: f64) {
        self.rebase(t_s);
        self.dead = true;
    }

    /// The firmware has given it up at `t_s`: off, and it takes no target any more.
    pub fn fail(&mut self, t_s: f64) {
        self.set_target(t_s, 0.0);
        self.given_up = true;
    }

    /// Looks at it, as the firmware does at least every second; the fault it finds.
    pub fn check(&mut self, t_s: f64) -> Option<&'static str> {
        let reading = self.reading_c(t_s);
        if self.given_up {
            return None;
        }
        if self.sensor_open {
            return Some("MINTEMP triggered");
        }
        match self.guard {
            Guard::Off => None,
            Guard::Watching { .. } if reading >= self.target_c - self.model.hysteresis_c => {
                self.guard = Guard::Holding { since_s: None };
                None
            }
            Guard::Watching { by_s, .. } if t_s < by_s => None,
            Guard::Watching { at_least_c, .. } if reading < at_least_c => Some("Heating failed"),
            Guard::Watching { .. } => {
                self.guard = self.watch(t_s);
                None
            }
            Guard::Holding { since_s } => self.check_holding(t_s, reading, since_s),
        }
    }

    fn check_holding(&mut self, t_s: f64, reading: f64, since_s: Option<f64>) -> Option<&'static str> {
        let cold = reading < self.target_c - self.model.hysteresis_c;
        let since_s = if cold { since_s.or(Some(t_s)) } else { None };
        self.guard = Guard::Holding { since_s };
        since_s.filter(|since| t_s - since >= self.model.protection_s).map(|_| "Thermal Runaway")
    }

    /// Whether there is anything for the protection to look at.
    #[must_use]
    pub fn is_guarded(&self) -> bool {
        self.target_c > 0.0 || self.sensor_open && !self.given_up
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::Profile;

    fn hotend() -> Heater {
        let profile = Profile::by_name("reference").unwrap();
        Heater::new(profile.heaters[0], profile.ambient_c)
    }

    #[test]
    fn heats_along_the_exponential_and_holds() {
        let mut heater = hotend();
        heater.set_target(10.0, 200.0);
        let expected = 420.0 + (21.0 - 420.0) * (-60.0_f64 / 150.0).exp();
        assert!((heater.temperature_c(70.0) - expected).abs() < 1e-9);
        let reaches = -150.0 * ((420.0 - 200.0) / (420.0 - 21.0_f64)).ln();
        assert!(heater.temperature_c(10.0 + reaches - 0.01) < 200.0);
        assert!((heater.temperature_c(10.0 + reaches + 0.01) - 200.0).abs() < 1e-12);
        assert_eq!(heater.power(500.0), 57);
    }

    #[test]
    fn cools_along_the_exponential_to_the_room() {
        let mut heater = hotend();
        heater.set_target(0.0, 200.0);
        heater.set_target(300.0, 0.0);
        let expected = 21.0 + 179.0 * (-1.0_f64).exp();
        assert!((heater.temperature_c(450.0) - expected).abs() < 1e-9);
        assert!((heater.temperature_c(1e6) - 21.0).abs() < 1e-9);
    }

    #[test]
    fn lower_target_is_approached_from_above() {
        let mut heater = hotend();
        heater.set_target(0.0, 200.0);
        heater.set_target(300.0, 150.0);
        assert!(heater.temperature_c(310.0) > 150.0);
        assert!((heater.temperature_c(1000.0) - 150.0).abs() < 1e-12);
    }

    /// The time of the first fault, looking every second.
    fn first_fault(heater: &mut Heater, from_s: u32) -> Option<(u32, &'static str)> {
        (from_s..from_s + 2000).find_map(|t| heater.check(f64::from(t)).map(|fault| (t, fault)))
    }

    #[test]
    fn healthy_heater_raises_no_fault() {
        let mut heater = hotend();
        heater.set_target(0.0, 250.0);
        assert_eq!(first_fault(&mut heater, 0), None);
    }

    #[test]
    fn dead_heater_fails_while_heating() {
        let mut heater = hotend();
        heater.break_element(0.0);
        heater.set_target(0.0, 200.0);
        assert_eq!(first_fault(&mut heater, 0), Some((40, "Heating failed")));
    }

    #[test]
    fn heater_that_dies_while_holding_is_a_runaway() {
        let mut heater = hotend();
        heater.set_target(0.0, 200.0);
        assert_eq!((0..500).find_map(|t| heater.check(f64::from(t))), None);
        heater.break_element(500.0);
        let (t, fault) = first_fault(&mut heater, 500).unwrap();
        // 4 °C are lost after 3.4 s, then 40 s.
        assert_eq!((t, fault), (544, "Thermal Runaway"));
    }

    #[test]
    fn noise_is_bounded_and_raises_no_fault() {
        let mut heater = hotend().with_noise(0.5);
        heater.set_target(0.0, 200.0);
        assert_eq!(first_fault(&mut heater, 0), None);
        let readings: Vec<f64> = (500..600).map(|t| heater.reading_c(f64::from(t))).collect();
        assert!(readings.iter().all(|reading| (reading - 200.0).abs() <= 0.5));
        assert!(readings.iter().any(|reading| (reading - 200.0).abs() > 0.3));
        assert_eq!(heater.reading_c(512.0), readings[12]);
    }

    #[test]
    fn open_sensor_is_seen_at_once() {
        let mut heater = hotend();
        heater.sensor_open = true;
        assert_eq!(heater.check(1.0), Some("MINTEMP triggered"));
    }
}
