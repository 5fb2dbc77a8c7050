//! What the printer says, and how it gets onto the wire.

use super::{Life, Printer};
use crate::{
    dialect::{Family, PositionForm, Refusal},
    receive, whole,
};

impl Printer {
    /// Says one line, as the faults of the wire let it.
    pub(super) fn say(&mut self, text: &str) {
        self.say_bytes(text.as_bytes());
    }

    pub(super) fn say_all(&mut self, lines: &[&str]) {
        for line in lines {
            self.say(line);
        }
    }

    pub(super) fn say_bytes(&mut self, text: &[u8]) {
        if matches!(self.life, Life::Off | Life::Down) || self.is_silent() || !self.is_plugged() {
            return;
        }
        let mut line = Vec::with_capacity(text.len() + 1);
        line.extend_from_slice(text);
        line.push(b'\n');
        if !self.faults.is_empty() {
            let Some(delay_s) = self.strike_reply(&mut line) else { return };
            self.outgoing.send(self.now_s, &line, delay_s);
        } else {
            self.outgoing.send(self.now_s, &line, 0.0);
        }
    }

    /// Why a line is refused, in the firmware's words.
    pub(super) fn say_refusal(&mut self, text: &[u8], reason: &str) {
        let last = self.receiver.last_line;
        match self.profile.dialect.refusal {
            Refusal::LastLine => self.say(&format!("Error:{reason}{last}")),
            Refusal::Expected if reason == receive::WRONG_NUMBER => {
                self.say(&format!("Error:expected line {} got {}", last + 1, receive::number_of(text)));
            }
            Refusal::Expected => self.say("Error:Wrong checksum"),
            Refusal::Silent => {}
        }
    }

    /// `ok` for the command at the head of the queue.
    pub(super) fn say_ok(&mut self) {
        if self.queue.front().is_some_and(|queued| queued.is_answered) {
            return;
        }
        if !self.profile.dialect.advanced_ok {
            return self.say("ok");
        }
        let mut reply = String::with_capacity(24);
        reply.push_str("ok");
        if let Some([b'N', rest @ ..]) = self.queue.front().map(|queued| queued.text.as_slice()) {
            reply.push_str(" N");
            reply.extend(
                rest.iter().take_while(|b| b.is_ascii_digit() || **b == b'-').map(|&b| char::from(b)),
            );
        }
        let slots = self.profile.command_slots.saturating_sub(self.queue.len());
        reply.push_str(&format!(" P{} B{slots}", self.planner.free()));
        self.say(&reply);
    }

    /// ` T:19.38 /0.00 B:19.38 /0.00 @:0 B@:0`, or as the dialect has it.
    pub(super) fn temperatures(&self) -> String {
        let [hotend, bed] = &self.heaters;
        let t = self.now_s;
        let [now, bed_now] = [hotend.reading_c(t), bed.reading_c(t)];
        let [target, bed_target] = [hotend.target_c, bed.target_c];
        let [power, bed_power] = [hotend.power(t), bed.power(t)];
        match self.profile.dialect.family {
            Family::Repetier => {
                format!(" T:{now:.2} /{target:.0} B:{bed_now:.2} /{bed_target:.0} B@:{bed_power} @:{power}")
            }
            Family::Marlin => {
                format!(" T:{now:.2} /{target:.2} B:{bed_now:.2} /{bed_target:.2} @:{power} B@:{bed_power}")
            }
            Family::Klipper => format!(" B:{bed_now:.1} /{bed_target:.1} T0:{now:.1} /{target:.1}"),
            Family::RepRapFirmware => {
                format!(" T:{now:.1} /{target:.1} T0:{now:.1} /{target:.1} B:{bed_now:.1} /{bed_target:.1}")
            }
            Family::Smoothie => {
                format!(" T:{now:.1} /{target:.1} @{power} B:{bed_now:.1} /{bed_target:.1} @{bed_power}")
            }
        }
    }

    /// Where it is, as the firmware tells it; see [`PositionForm`].
    pub(super) fn position_text(&self) -> String {
        let [x, y, z, e] = self.motion.position;
        let plain = format!("X:{x:.2} Y:{y:.2} Z:{z:.2} E:{e:.2}");
        let now = self.driven();
        let steps = |at: f64, axis: usize| whole::to_i64(at * self.motion.steps_per_mm[axis]);
        match self.profile.dialect.position {
            PositionForm::MarlinSteps => {
                let [x, y, z] = [0, 1, 2].map(|axis| steps(now[axis], axis));
                format!("{plain} Count X:{x} Y:{y} Z:{z}")
            }
            PositionForm::MarlinPlaces => {
                let [x, y, z, e] = now;
                format!("{plain} Count X: {x:.2} Y:{y:.2} Z:{z:.2} E:{e:.2}")
            }
            PositionForm::Klipper => format!("X:{x:.3} Y:{y:.3} Z:{z:.3} E:{e:.3}"),
            PositionForm::RepRapFirmware => {
                let [mx, my, mz, _] = self.motion.native();
                let [cx, cy, cz] = [0, 1, 2].map(|axis| steps(self.motion.driven[axis], axis));
                format!(
                    "X:{x:.3} Y:{y:.3} Z:{z:.3} E:{e:.3} E0:{e:.1} Count {cx} {cy} {cz} Machine {mx:.3} {my:.3} {mz:.3} \
                     Bed comp 0.000"
                )
            }
            PositionForm::Repetier => format!("X:{x:.2} Y:{y:.2} Z:{z:.3} E:{e:.4}"),
            PositionForm::Smoothie => format!("ok C: X:{x:.4} Y:{y:.4} Z:{z:.4} E:{e:.4}"),
        }
    }

    /// Klipper's `GET_POSITION`: the motors' steps now, then what is commanded, in several frames.
    pub(super) fn tell_all_positions(&mut self) {
        let now = self.driven();
        let [sx, sy, sz] = [0, 1, 2].map(|axis| whole::to_i64(now[axis] * self.motion.steps_per_mm[axis]));
        let [nx, ny, nz, ne] = now;
        let [tx, ty, tz, te] = self.motion.native();
        let [x, y, z, e] = self.motion.position;
        self.say(&format!("// mcu: stepper_x:{sx} stepper_y:{sy} stepper_z:{sz}"));
        self.say(&format!("// stepper: stepper_x:{nx:.6} stepper_y:{ny:.6} stepper_z:{nz:.6}"));
        self.say(&format!("// kinematic: X:{nx:.6} Y:{ny:.6} Z:{nz:.6}"));
        self.say(&format!("// toolhead: X:{tx:.6} Y:{ty:.6} Z:{tz:.6} E:{ne:.6}"));
        self.say(&format!("// gcode: X:{x:.6} Y:{y:.6} Z:{z:.6} E:{e:.6}"));
        let offset = [tx - x, ty - y, tz - z];
        self.say(&format!(
            "// gcode base: X:{:.6} Y:{:.6} Z:{:.6} E:{:.6}",
            offset[0],
            offset[1],
            offset[2],
            te - e
        ));
        self.say("// gcode homing: X:0.000000 Y:0.000000 Z:0.000000");
    }
}
