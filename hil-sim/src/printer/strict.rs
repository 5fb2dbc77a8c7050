//! Klipper's reading of numbers: a parameter is what stands between two capital letters, and all of it must be a number.
//!
//! A command whose parameter is none is refused. Of a move it then has already taken over the axes before that one (in the
//! order X, Y, Z, E) as its place, without going there (`gcode_move.py`, `cmd_G1`).

use super::{Printer, commands::Outcome};
use crate::gcode::{self, Command};
use std::collections::BTreeMap;

/// Codes whose parameters are numbers: moves and `G92`, heaters, fan, factors, accelerations.
const G_NUMBERS: [u32; 5] = [0, 1, 2, 3, 92];
const M_NUMBERS: [u32; 8] = [104, 106, 109, 140, 190, 204, 220, 221];

/// What stands behind each capital letter, the last time that it occurs; the command's own letter first.
fn parameters(text: &[u8]) -> (&[u8], BTreeMap<u8, &[u8]>) {
    let mut starts: Vec<usize> = (0..text.len()).filter(|&at| text[at].is_ascii_uppercase()).collect();
    starts.push(text.len());
    let mut parts = starts.windows(2).map(|ends| (text[ends[0]], text[ends[0] + 1..ends[1]].trim_ascii()));
    let code = parts.next().map_or(&b""[..], |part| part.1);
    (code, parts.collect())
}

fn is_number(text: &[u8]) -> bool {
    gcode::decimal(text).is_some_and(|(_, length)| length == text.len())
}

impl Printer {
    /// The refusal of a command with a parameter that is no number, or of a code that is none.
    pub(super) fn refuse_what_is_no_number(&mut self, command: &Command<'_>) -> Option<Outcome> {
        let codes = match command.letter {
            b'G' => &G_NUMBERS[..],
            b'M' => &M_NUMBERS[..],
            _ => return None,
        };
        let (code, parameters) = parameters(command.text);
        if !code.iter().all(|b| b.is_ascii_digit() || *b == b'.') {
            return Some(self.unknown(command));
        }
        let is_flawed = codes.contains(&command.code) && !parameters.values().all(|text| is_number(text));
        if !is_flawed {
            return None;
        }
        if command.letter == b'G' && command.code <= 1 {
            self.take_place_up_to_flaw(command, &parameters);
        }
        let text = String::from_utf8_lossy(command.text).into_owned();
        self.say(&format!("!! Unable to parse move '{text}'"));
        Some(Outcome::Done)
    }

    fn take_place_up_to_flaw(&mut self, command: &Command<'_>, parameters: &BTreeMap<u8, &[u8]>) {
        let target = self.motion.target(command);
        for (axis, letter) in [b'X', b'Y', b'Z', b'E'].into_iter().enumerate() {
            match parameters.get(&letter) {
                Some(text) if !is_number(text) => return,
                Some(_) => self.motion.position[axis] = target[axis],
                None => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_stand_between_capital_letters() {
        let (code, found) = parameters(b"G1 X10.5 Y9?X?");
        assert_eq!((code, found[&b'X'], found[&b'Y']), (&b"1"[..], &b"?"[..], &b"9?"[..]));
        assert!(is_number(b"-0.80") && !is_number(b"9?") && !is_number(b""));
    }
}
