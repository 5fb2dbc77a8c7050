//! How long warming up takes: nozzle and bed rise at the rates that the profile states.

use crate::profile::Dialect;

/// Where they begin, °C.
pub(super) const ROOM_C: f64 = 20.0;
/// How long a firmware looks whether a temperature stays, s (Marlin's `TEMP_RESIDENCY_TIME`, Repetier's watch period).
const fn settling_s(dialect: Dialect) -> f64 {
    match dialect {
        Dialect::Marlin | Dialect::Marlin1 => 10.0,
        Dialect::Repetier => 1.0,
        Dialect::Klipper | Dialect::RepRapFirmware | Dialect::Smoothie => 0.0,
    }
}

#[derive(Debug, Clone, Copy)]
struct Heater {
    at_c: f64,
    target_c: f64,
    rate_k_s: f64,
}

/// Nozzle and bed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heaters {
    of: [Heater; 2],
    settling_s: f64,
}

impl Heaters {
    pub(super) fn new(rates_k_s: [f64; 2], dialect: Dialect) -> Self {
        let of = rates_k_s.map(|rate_k_s| Heater { at_c: ROOM_C, target_c: 0.0, rate_k_s });
        Self { of, settling_s: settling_s(dialect) }
    }

    /// An M-code; gives how long it waits, s.
    pub(super) fn command(&mut self, code: u32, target_c: Option<f64>) -> f64 {
        let (heater, waits) = match code {
            104 | 109 => (&mut self.of[0], code == 109),
            140 | 190 => (&mut self.of[1], code == 190),
            _ => return 0.0,
        };
        heater.target_c = target_c.unwrap_or(heater.target_c);
        let missing_k = heater.target_c - heater.at_c;
        if waits && missing_k > 1e-9 { missing_k / heater.rate_k_s + self.settling_s } else { 0.0 }
    }

    /// Time in which nothing moves passes.
    pub(super) fn pass(&mut self, seconds: f64) {
        for heater in &mut self.of {
            let warmer = heater.at_c + heater.rate_k_s * seconds;
            heater.at_c =
                if heater.target_c > heater.at_c { warmer.min(heater.target_c) } else { heater.at_c };
        }
    }
}
