//! What the printer says, and how it gets onto the wire.

use super::{Life, Printer};
use crate::{
    dialect::{Family, Refusal},
    receive, whole,
};

impl Printer {
    /// Says one line, as the faults of the wire let it.
    pub(super) fn say(&mut self, text: &str) {
        self.say_bytes(text.as_bytes());
    }

    pub(super) fn say_bytes(&mut self, text: &[u8]) {
        if self.life == Life::Off || self.is_silent() || !self.is_plugged() {
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

    /// What is said of a heater that has run out of control.
    pub(super) fn fault_text(&self, fault: &str, heater: &str) -> String {
        match self.profile.dialect.family {
            Family::Marlin => format!("Error:{fault}, system stopped! Heater_ID: {heater}"),
            Family::Klipper => format!("!! Heater {heater} not heating at expected rate"),
            Family::RepRapFirmware => format!("Error: Heater fault on heater {heater}: {fault}"),
            Family::Repetier => format!("fatal:Heater {heater} error - {fault}"),
            Family::Smoothie => format!("ERROR: {fault} on {heater}, HALT asserted"),
        }
    }

    /// `ok` for the command at the head of the queue.
    pub(super) fn say_ok(&mut self) {
        if !self.profile.dialect.advanced_ok {
            return self.say("ok");
        }
        let mut reply = String::with_capacity(24);
        reply.push_str("ok");
        if let Some([b'N', rest @ ..]) = self.queue.front().map(Vec::as_slice) {
            reply.push_str(" N");
            reply.extend(
                rest.iter().take_while(|b| b.is_ascii_digit() || **b == b'-').map(|&b| char::from(b)),
            );
        }
        let slots = self.profile.command_slots - self.queue.len();
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
            Family::Marlin | Family::Repetier => {
                format!(" T:{now:.2} /{target:.2} B:{bed_now:.2} /{bed_target:.2} @:{power} B@:{bed_power}")
            }
            Family::Klipper => format!(" B:{bed_now:.1} /{bed_target:.1} T0:{now:.1} /{target:.1}"),
            Family::RepRapFirmware => {
                format!(" T0:{now:.1} /{target:.1} B:{bed_now:.1} /{bed_target:.1}")
            }
            Family::Smoothie => {
                format!(" T:{now:.1} /{target:.1} @{power} B:{bed_now:.1} /{bed_target:.1} @{bed_power}")
            }
        }
    }

    /// `X:50.00 Y:50.00 Z:5.00 E:0.00 Count X:4000 Y:4000 Z:2000`
    pub(super) fn position_text(&self) -> String {
        let [x, y, z, e] = self.motion.position;
        let driven = self.driven();
        let steps = |axis: usize| whole::to_i64(driven[axis] * self.motion.steps_per_mm[axis]);
        format!("X:{x:.2} Y:{y:.2} Z:{z:.2} E:{e:.2} Count X:{} Y:{} Z:{}", steps(0), steps(1), steps(2))
    }
}
