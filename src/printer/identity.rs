//! Which firmware a printer says that it has.

use crate::profile::Dialect;

/// Which firmware an answer to M115 is of. What descends from another names both: the descendant counts.
#[must_use]
pub fn dialect_of(firmware: &str) -> Option<Dialect> {
    let has = |word: &str| firmware.contains(word);
    let name = firmware.split("FIRMWARE_NAME:").nth(1).unwrap_or(firmware).trim_start();
    Some(match () {
        () if name.starts_with("Klipper") => Dialect::Klipper,
        () if name.starts_with("RepRapFirmware") => Dialect::RepRapFirmware,
        () if name.starts_with("Repetier") => Dialect::Repetier,
        () if name.starts_with("Smoothie") => Dialect::Smoothie,
        () if name.starts_with("Prusa") || has("Marlin 1.") || has("Marlin V1") => Dialect::Marlin1,
        () if has("Marlin") => Dialect::Marlin,
        () => return None,
    })
}

/// The built-in profile that speaks a firmware's language.
#[must_use]
pub const fn profile_name(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::Marlin => "marlin",
        Dialect::Marlin1 => "marlin1",
        Dialect::Klipper => "klipper",
        Dialect::RepRapFirmware => "reprapfirmware",
        Dialect::Repetier => "repetier",
        Dialect::Smoothie => "smoothie",
    }
}

/// Whether one profile cannot do for the other's firmware. Marlin's older and newer words are understood by both.
#[must_use]
pub fn is_another(found: Dialect, expected: Dialect) -> bool {
    let is_marlin = |dialect| matches!(dialect, Dialect::Marlin | Dialect::Marlin1);
    found != expected && !(is_marlin(found) && is_marlin(expected))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_firmware_is_known_by_its_answer() {
        for (text, expected) in [
            ("FIRMWARE_NAME:Marlin bugfix-2.1.x SOURCE_CODE_URL:github.com/MarlinFirmware", Dialect::Marlin),
            ("FIRMWARE_NAME:Marlin 1.1.9 SOURCE_CODE_URL:github.com", Dialect::Marlin1),
            ("FIRMWARE_NAME:Prusa-Firmware 3.13.0 based on Marlin", Dialect::Marlin1),
            ("FIRMWARE_VERSION:v0.12.0 FIRMWARE_NAME:Klipper", Dialect::Klipper),
            ("FIRMWARE_NAME: RepRapFirmware for Duet 3", Dialect::RepRapFirmware),
            ("FIRMWARE_NAME:Repetier_1.0.4 FIRMWARE_URL:https", Dialect::Repetier),
            ("FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A", Dialect::Smoothie),
        ] {
            assert_eq!(dialect_of(text), Some(expected), "{text}");
            assert!(
                crate::profile::builtin(profile_name(expected)).is_ok_and(|p| p.firmware.dialect == expected)
            );
        }
        assert_eq!(dialect_of("FIRMWARE_NAME:Grbl 1.1"), None);
    }
}
