//! What the printer says, and how it gets onto the wire.

use super::{Life, Printer};
use crate::whole;

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

    /// ` T:19.38 /0.00 B:19.38 /0.00 @:0 B@:0`
    pub(super) fn temperatures(&self) -> String {
        let [hotend, bed] = &self.heaters;
        let t = self.now_s;
        format!(
            " T:{:.2} /{:.2} B:{:.2} /{:.2} @:{} B@:{}",
            hotend.reading_c(t),
            hotend.target_c,
            bed.reading_c(t),
            bed.target_c,
            hotend.power(t),
            bed.power(t)
        )
    }

    /// `X:50.00 Y:50.00 Z:5.00 E:0.00 Count X:4000 Y:4000 Z:2000`
    pub(super) fn position_text(&self) -> String {
        let [x, y, z, e] = self.motion.position;
        let driven = self.driven();
        let steps = |axis: usize| whole::to_i64(driven[axis] * self.motion.steps_per_mm[axis]);
        format!("X:{x:.2} Y:{y:.2} Z:{z:.2} E:{e:.2} Count X:{} Y:{} Z:{}", steps(0), steps(1), steps(2))
    }
}
