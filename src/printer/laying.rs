//! Which commands may lay material, for whoever has to know before the first of them is sent.
//!
//! A command is taken for harmless where it is known to move, heat, set or ask only; everything else may lay something: a move
//! with filament, a change of tools or filament, a macro of the firmware, a word that nobody knows. Too early does no harm, too
//! late does.

use crate::gcode::reader;

/// Moves along a line or an arc, or a curve: they lay something where filament goes along.
const MOVES: [u32; 5] = [0, 1, 2, 3, 5];
/// Waits, modes, homing, probing, zeros.
const G_CODES: [u32; 14] = [4, 10, 17, 18, 19, 20, 21, 28, 29, 80, 90, 91, 92, 30];
/// Ranges of M codes that drive no filament in any of the firmwares: power, heaters, fans, questions, limits, factors, sounds,
/// waiting, messages, labels, motors. Printing from a card, macros and changes of filament are not among them.
const M_CODES: [(u32, u32); 20] = [
    (17, 18),
    (42, 42),
    (73, 78),
    (80, 80),
    (82, 85),
    (92, 92),
    (104, 107),
    (109, 109),
    (111, 120),
    (140, 141),
    (150, 155),
    (190, 191),
    (200, 221),
    (280, 282),
    (300, 305),
    (400, 400),
    (412, 421),
    (486, 504),
    (566, 593),
    (900, 919),
];
/// Beginnings of words of Klipper that set or label something.
const WORDS: [&str; 3] = ["SET_", "EXCLUDE_OBJECT", "BED_MESH_"];

/// Whether a command of a job may lay material.
///
/// ```
/// use lumenfab::printer::laying::may_lay;
///
/// assert!(["G28", "M109 S210", "G1 X10 Y0.4 F3000", "SET_VELOCITY_LIMIT ACCEL=1"].iter().all(|c| !may_lay(c)));
/// assert!(["G1 X10 E0.2", "G11", "T1", "M600", "START_PRINT", "start"].iter().all(|c| may_lay(c)));
/// ```
#[must_use]
pub fn may_lay(command: &str) -> bool {
    let Ok(line) = reader::parse(command) else { return true };
    if let Some(named) = &line.named {
        return !WORDS.iter().any(|word| named.starts_with(word));
    }
    let Some(command) = &line.command else { return false };
    match command.letter {
        'G' if MOVES.contains(&command.code) => command.has('E'),
        'G' => !G_CODES.contains(&command.code),
        'M' => !M_CODES.iter().any(|&(first, last)| (first..=last).contains(&command.code)),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;

    #[test]
    fn nothing_is_laid_before_the_first_filament_of_a_start_script() {
        for name in profile::builtin_names() {
            let start = profile::builtin(name).unwrap().start_gcode();
            let first = start.iter().position(|line| may_lay(line)).unwrap_or(start.len());
            let harmless = &start[..first];
            assert!(
                harmless.iter().all(|line| !line.contains(" E") || line.starts_with("G92")),
                "{name}: {harmless:?}"
            );
            assert!(
                harmless
                    .iter()
                    .any(|line| line.contains("M109") || line.contains("M104") || line.contains("M116")),
                "{name}: the gate closes before the heaters are on: {:?}",
                start.get(first)
            );
        }
    }

    #[test]
    fn what_nobody_knows_may_lay_something() {
        for command in
            ["M1234", "M23 X.G", "M24", "M98 P\"x\"", "M701", "M702", "G12", "G1234", "T0", "PURGE_LINE", "?"]
        {
            assert!(may_lay(command), "{command}");
        }
        for command in ["", "G92 E0", "M83", "M115", "M486 S1", "G4 P100", "M73 P0", "g28", "M117 E1 up"] {
            assert!(!may_lay(command), "{command}");
        }
    }
}
