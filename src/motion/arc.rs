//! Arcs as the firmware drives them: in chords.

use crate::gcode::reader::Command;
use crate::profile::{Dialect, Firmware};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Marlin's `MIN_ARC_SEGMENT_MM`.
const MARLIN_SHORTEST_MM: f64 = 0.1;
/// RepRapFirmware's shortest and longest chord, and how many a second it makes at least.
const REPRAP_CHORDS_MM: [f64; 2] = [0.1, 1.0];
const REPRAP_CHORDS_PER_S: f64 = 200.0;
/// More chords than this are a mistake.
const MOST_CHORDS: f64 = 10_000.0;

/// An arc in the plane, from the origin. mm, rad.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arc {
    centre: [f64; 2],
    begin: f64,
    /// Signed: counter-clockwise positive.
    turn: f64,
    radius: f64,
    end: [f64; 2],
    n_chords: f64,
}

impl Arc {
    /// The arc that a command asks for, `to` being where it ends; none where it has no centre.
    pub(super) fn of(c: &Command, to: [f64; 2], speed_mm_s: f64, firmware: &Firmware) -> Option<Self> {
        let arc = Self::turning(c, to)?;
        let n_chords = n_chords(arc.turn.abs(), arc.radius, speed_mm_s, firmware).clamp(1.0, MOST_CHORDS);
        Some(Self { n_chords, ..arc })
    }

    /// The same where nobody asks for its chords: it is one.
    pub(super) fn turning(c: &Command, to: [f64; 2]) -> Option<Self> {
        let is_clockwise = c.code == 2;
        let centre = match c.value('R') {
            Some(radius) => centre_by_radius(to, radius, is_clockwise)?,
            None => [c.value('I').unwrap_or(0.0), c.value('J').unwrap_or(0.0)],
        };
        let radius = centre[0].hypot(centre[1]);
        if !(1e-9..1e6).contains(&radius) {
            return None;
        }
        let begin = (-centre[1]).atan2(-centre[0]);
        let end = (to[1] - centre[1]).atan2(to[0] - centre[0]);
        let turn = if is_clockwise { begin - end } else { end - begin }.rem_euclid(TAU);
        let turn = if turn < 1e-9 { TAU } else { turn };
        let turn = if is_clockwise { -turn } else { turn };
        Some(Self { centre, begin, turn, radius, end: to, n_chords: 1.0 })
    }

    /// Least and greatest coordinate along x and along y of all of the arc.
    pub(super) fn extent(&self) -> [[f64; 2]; 2] {
        let mut extent = self.end.map(|end| [end.min(0.0), end.max(0.0)]);
        for quarter in 0..4_u8 {
            let angle = FRAC_PI_2 * f64::from(quarter);
            let from_begin = if self.turn > 0.0 { angle - self.begin } else { self.begin - angle };
            if from_begin.rem_euclid(TAU) <= self.turn.abs() {
                let axis = usize::from(quarter % 2);
                let at = self.centre[axis] + if quarter < 2 { self.radius } else { -self.radius };
                extent[axis] = [extent[axis][0].min(at), extent[axis][1].max(at)];
            }
        }
        extent
    }

    /// The chords, each as its way.
    pub(super) fn chords(self) -> impl Iterator<Item = [f64; 2]> {
        let mut at = [0.0; 2];
        let mut k = 0.0;
        std::iter::from_fn(move || {
            k += 1.0;
            (k <= self.n_chords).then(|| {
                let to = self.point(k);
                let way = [to[0] - at[0], to[1] - at[1]];
                at = to;
                way
            })
        })
    }

    fn point(&self, k: f64) -> [f64; 2] {
        if k >= self.n_chords {
            return self.end;
        }
        let angle = self.begin + self.turn * k / self.n_chords;
        [self.centre[0] + self.radius * angle.cos(), self.centre[1] + self.radius * angle.sin()]
    }

    /// The share of the whole arc that each chord is.
    pub(super) fn share(&self) -> f64 {
        1.0 / self.n_chords
    }
}

/// How many chords a firmware makes of an arc.
fn n_chords(turn: f64, radius: f64, speed_mm_s: f64, firmware: &Firmware) -> f64 {
    let length = turn * radius;
    let chord = firmware.arc_chord_mm(radius);
    match firmware.dialect {
        Dialect::Marlin => {
            let of_circle = (f64::from(firmware.arc_segments_per_circle) * turn / TAU).ceil();
            let wanted = (length / firmware.arc_segment_mm).floor().max(of_circle);
            wanted.min((length / MARLIN_SHORTEST_MM).floor())
        }
        Dialect::RepRapFirmware => {
            let [shortest, longest] = REPRAP_CHORDS_MM;
            let chord = chord.min(speed_mm_s / REPRAP_CHORDS_PER_S).clamp(shortest, longest);
            (length / chord + 0.8).floor()
        }
        _ => (length / chord).floor(),
    }
}

fn centre_by_radius(to: [f64; 2], radius: f64, is_clockwise: bool) -> Option<[f64; 2]> {
    let chord = to[0].hypot(to[1]);
    let height2 = radius * radius - chord * chord / 4.0;
    if chord < 1e-9 || height2 < -1e-6 {
        return None;
    }
    let height = height2.max(0.0).sqrt() / chord;
    let side = if (radius > 0.0) == is_clockwise { -height } else { height };
    Some([to[0] / 2.0 - to[1] * side, to[1] / 2.0 + to[0] * side])
}
