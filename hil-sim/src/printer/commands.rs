//! Commands, one after the other, with the firmware's answers.

use super::{After, HeatWait, HeaterName, Life, Printer, Wait, filament};
use crate::{
    dialect::Family,
    gcode::{self, Command},
    planner::Cornering,
    whole,
};

/// A heater is at its target within this, °C.
const WINDOW_C: f64 = 1.0;
/// Homing takes this long per axis besides the way, s.
const HOMING_BUMP_S: f64 = 2.5;

/// How far a command has come.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// `ok` is due.
    Done,
    /// It has given its own `ok`.
    Answered,
    /// It is not done yet.
    Wait(Wait),
}

impl Printer {
    /// Begins the command in `line`.
    pub(super) fn execute(&mut self, line: &[u8]) -> Outcome {
        let command = gcode::parse(line);
        if self.life == Life::Halted
            && let Some(outcome) = self.refuse_when_halted(&command)
        {
            return outcome;
        }
        if self.profile.dialect.family == Family::Klipper
            && let Some(outcome) = self.refuse_what_is_no_number(&command)
        {
            return outcome;
        }
        let outcome = match command.letter {
            letter @ (b'G' | b'M') if !self.profile.dialect.knows(letter, command.code) => {
                self.unknown(&command)
            }
            b'G' => self.execute_g(&command),
            b'M' => self.execute_m(&command),
            b'T' if command.code == 0 => Outcome::Done,
            b'T' => self.tell(&format!("echo:T{} Invalid extruder", command.code)),
            _ => self.execute_words(&command),
        };
        match outcome {
            // Most moves find room at once.
            Outcome::Wait(wait) => self.go_on(wait),
            done => done,
        }
    }

    fn tell(&mut self, text: &str) -> Outcome {
        self.say(text);
        Outcome::Done
    }

    pub(super) fn unknown(&mut self, command: &Command<'_>) -> Outcome {
        self.summary.unknown_commands += 1;
        if let Some(reply) = self.profile.dialect.unknown(command.text) {
            self.say_bytes(&reply);
        }
        Outcome::Done
    }

    fn tell_temperatures(&mut self) -> Outcome {
        let text = self.temperatures();
        if self.profile.dialect.ok_when_taken {
            return self.tell(text.trim_start());
        }
        self.say(&format!("ok{text}"));
        Outcome::Answered
    }

    fn tell_position(&mut self) -> Outcome {
        let text = self.position_text();
        self.say(&text);
        if text.starts_with("ok ") { Outcome::Answered } else { Outcome::Done }
    }

    /// Commands that are words, `KEY=VALUE` behind them.
    fn execute_words(&mut self, command: &Command<'_>) -> Outcome {
        let text = command.text;
        let name = &text[..text.iter().position(|&b| b == b' ').unwrap_or(text.len())];
        if !self.profile.dialect.words.iter().any(|word| word.as_bytes() == name) {
            return self.unknown(command);
        }
        match name {
            b"SET_VELOCITY_LIMIT" => self.set_velocity_limit(text),
            b"FIRMWARE_RESTART" | b"RESTART" => self.restart_firmware(),
            b"GET_POSITION" => self.tell_all_positions(),
            b"STATUS" => self.say("// Klipper state: Ready"),
            b"SET_IDLE_TIMEOUT" => self.set_idle_timeout(text),
            b"TURN_OFF_HEATERS" => self.heaters_off(),
            _ => {}
        }
        Outcome::Done
    }

    fn execute_g(&mut self, command: &Command<'_>) -> Outcome {
        match command.code {
            0 | 1 => return self.linear_move(command),
            2 | 3 => return self.arc_move(command, command.code == 2),
            4 => {
                let ms = command.value(b'P').map(|ms| ms / 1000.0);
                let seconds = command.value(b'S').or(ms).unwrap_or(0.0).max(0.0);
                return Outcome::Wait(Wait::Drain(After::Dwell(seconds)));
            }
            21 => {}
            28 => return Outcome::Wait(Wait::Drain(After::Home(axes_to_home(command)))),
            90 | 91 => self.motion.set_relative(command.code == 91, self.profile.dialect.extruder_mode),
            92 => self.set_place(command),
            _ => return self.unknown(command),
        }
        Outcome::Done
    }

    fn execute_m(&mut self, command: &Command<'_>) -> Outcome {
        match command.code {
            // RepRapFirmware stops; it does not ask.
            0 | 1 if self.profile.dialect.family == Family::RepRapFirmware => {
                return Outcome::Wait(Wait::Drain(After::Nothing));
            }
            0 | 1 => return self.pause(command),
            // Handled elsewhere, or of no effect here: motors on, print timer, progress, debug flags, message, time-outs.
            17
            | 31
            | 73
            | 75..=77
            | 108
            | 111
            | 117
            | 300
            | 301
            | 304
            | 408
            | 486
            | 501
            | 502
            | 876
            | 999 => {}
            18 | 84 if !self.sets_idle(command) => return Outcome::Wait(Wait::Drain(After::MotorsOff)),
            18 | 84 => {}
            // RepRapFirmware takes M85 and does nothing.
            85 if self.profile.dialect.family == Family::RepRapFirmware => {}
            85 | 86 => {
                self.sets_idle(command);
            }
            82 | 83 => self.motion.relative_e = command.code == 83,
            92 => super::limits::set_axes(command, &mut self.motion.steps_per_mm),
            104 => self.set_heater(HeaterName::Hotend, command),
            105 => {
                return self.tell_temperatures();
            }
            106 => self.fan = whole::to_u8(command.value(b'S').unwrap_or(255.0)),
            107 => self.fan = 0,
            109 => return self.heat(HeaterName::Hotend, command),
            110 => self.set_line_number(command),
            112 => {
                self.kill_by_order();
                return Outcome::Answered;
            }
            113 => self.keepalive_s = command.value(b'S').unwrap_or(self.keepalive_s).clamp(0.0, 60.0),
            114 => return self.tell_position(),
            115 => return self.tell_firmware(),
            118 => self.say_bytes(command.argument),
            119 => self.tell_endstops(),
            140 => self.set_heater(HeaterName::Bed, command),
            155 => {
                self.report_interval_s = command.value(b'S').unwrap_or(0.0).clamp(0.0, 60.0);
                self.next_report_s = self.now_s + self.report_interval_s;
            }
            190 => return self.heat(HeaterName::Bed, command),
            201..=207 | 566 => self.set_limits(command),
            211 => self.motion.soft_endstops = command.value(b'S').is_none_or(|s| s != 0.0),
            220 => self.motion.feedrate_percent = percent(command, self.motion.feedrate_percent),
            221 => self.motion.flow_percent = percent(command, self.motion.flow_percent),
            302 => self.set_cold_extrusion(command),
            400 => return Outcome::Wait(Wait::Drain(After::Nothing)),
            410 => self.quick_stop(),
            500 => return self.tell("Error:EEPROM disabled"),
            503 => self.tell_settings(),
            564 => {
                let allows = command.value(b'H').map(|h| h == 0.0);
                self.motion.moves_unhomed = allows.unwrap_or(self.motion.moves_unhomed);
            }
            600 => return self.begin_change(),
            _ => return self.unknown(command),
        }
        Outcome::Done
    }

    fn set_line_number(&mut self, command: &Command<'_>) {
        self.judge.numbering_begins_anew();
        // Smoothieware looks at the number of a numbered line alone, and Repetier at the first in a line.
        let line = self.queue.front().map_or(&b""[..], |queued| queued.text.as_slice());
        let counts = match self.profile.dialect.family {
            Family::Smoothie => false,
            Family::Repetier => !line.starts_with(b"N"),
            _ => true,
        };
        if let Some(number) = command.value(b'N').filter(|_| counts) {
            self.receiver.last_line = whole::to_i64(number);
        }
    }

    fn set_cold_extrusion(&mut self, command: &Command<'_>) {
        if let Some(least_c) = command.value(b'S') {
            self.motion.min_extrusion_c = least_c;
        }
        match command.value(b'P') {
            Some(allowed) if allowed != 0.0 => self.motion.min_extrusion_c = f64::NEG_INFINITY,
            Some(_) => self.motion.min_extrusion_c = self.profile.min_extrusion_c,
            None => {}
        }
    }

    pub(super) fn set_target(&mut self, heater: HeaterName, target_c: f64) {
        self.note_unattended();
        let heater = &mut self.heaters[heater as usize];
        heater.set_target(self.now_s, target_c);
        let detail = format!("{} {:.1}", heater.model.id, heater.target_c);
        self.next_check_s = self.next_check_s.max(self.now_s);
        self.state("target", detail);
    }

    fn set_heater(&mut self, heater: HeaterName, command: &Command<'_>) {
        if let Some(target_c) = command.value(b'S') {
            self.set_target(heater, target_c);
        }
    }

    /// M109, M190: `S` waits only while heating, `R` also while cooling.
    fn heat(&mut self, heater: HeaterName, command: &Command<'_>) -> Outcome {
        let both_ways = command.value(b'R');
        let Some(target_c) = command.value(b'S').or(both_ways) else { return Outcome::Done };
        self.set_target(heater, target_c);
        let hot = self.heaters[heater as usize].reading_c(self.now_s) >= target_c - WINDOW_C;
        if hot && both_ways.is_none() || target_c <= 0.0 {
            return Outcome::Done;
        }
        Outcome::Wait(Wait::Heat(HeatWait { heater, next_tick_s: self.now_s + 1.0, reached_s: None }))
    }

    fn pause(&mut self, command: &Command<'_>) -> Outcome {
        let default: &[u8] = if command.code == 0 { b"M0 Stop" } else { b"M1 Stop" };
        if command.argument.is_empty() {
            self.prompt = default.to_vec();
        } else {
            self.prompt = command.argument.to_vec();
            self.say_bytes(&[b"echo:", command.argument].concat());
        }
        let ms = command.value(b'P').map(|ms| ms / 1000.0);
        let seconds = command.value(b'S').or(ms).filter(|&s| s > 0.0).unwrap_or(f64::INFINITY);
        Outcome::Wait(Wait::Drain(After::User(seconds)))
    }

    /// Asks the host to ask the user.
    pub(super) fn tell_prompt(&mut self, text: &[u8], button: &str) {
        self.say_bytes(&[b"//action:prompt_begin ", text].concat());
        self.say(&format!("//action:prompt_button {button}"));
        self.say("//action:prompt_show");
    }

    /// Looks whether what a command waits for has come.
    pub(super) fn go_on(&mut self, wait: Wait) -> Outcome {
        match wait {
            Wait::Moves if self.plan_pending() => Outcome::Done,
            Wait::Moves => Outcome::Wait(Wait::Moves),
            Wait::Drain(after) => self.drained(after),
            Wait::Until { t_s, then } if t_s <= self.now_s => self.drained(then),
            Wait::User { until_s } if until_s <= self.now_s => Outcome::Done,
            Wait::User { until_s } => {
                self.cool_while_changing();
                Outcome::Wait(Wait::User { until_s })
            }
            Wait::Heat(heat) => self.heated(heat),
            other => Outcome::Wait(other),
        }
    }

    fn drained(&mut self, after: After) -> Outcome {
        self.planner.release(self.now_s);
        if self.planner.depth() > 0 {
            return Outcome::Wait(Wait::Drain(after));
        }
        self.ran_dry = false;
        self.judge.pause();
        let until = |t_s: f64, then| Outcome::Wait(Wait::Until { t_s, then });
        match after {
            After::Nothing => return Outcome::Done,
            After::Dwell(seconds) => return until(self.now_s + seconds, After::Nothing),
            After::Home(axes) => {
                self.judge_homing(axes);
                return until(self.now_s + self.homing_s(axes), After::AtHome(axes));
            }
            After::AtHome(axes) => self.arrive_home(axes),
            After::MotorsOff => self.motors_off("by order"),
            After::Unload => return until(self.now_s + filament::UNLOAD_S, After::Unloaded),
            After::Unloaded => return Outcome::Wait(self.wait_for_filament()),
            After::User(seconds) => {
                if self.profile.dialect.prompts {
                    let prompt = std::mem::take(&mut self.prompt);
                    self.tell_prompt(&prompt, "Continue");
                }
                self.state("paused-for-user", String::new());
                return Outcome::Wait(Wait::User { until_s: self.now_s + seconds });
            }
        }
        Outcome::Done
    }

    fn homing_s(&self, axes: [bool; 3]) -> f64 {
        let motion = &self.motion;
        let way = |axis: usize| {
            if motion.homed[axis] { motion.native()[axis] } else { self.profile.bed_mm[axis] / 2.0 }
        };
        (0..3)
            .filter(|&axis| axes[axis])
            .map(|axis| HOMING_BUMP_S + way(axis).max(0.0) / self.profile.homing_mm_s[axis])
            .sum()
    }

    fn arrive_home(&mut self, axes: [bool; 3]) {
        self.motion.arrive_home(axes);
        for axis in (0..3).filter(|&axis| axes[axis]) {
            self.deposit.shift_mm[axis] = 0.0;
        }
        self.state("homed", self.position_text());
        if matches!(self.profile.dialect.family, Family::Marlin | Family::Repetier) {
            let position = self.position_text();
            self.say(&position);
        }
    }

    /// One look a second, told to the host.
    fn heated(&mut self, mut heat: HeatWait) -> Outcome {
        if self.planner.depth() == 0 {
            self.ran_dry = false;
            self.judge.pause();
        }
        if self.now_s < heat.next_tick_s {
            return Outcome::Wait(Wait::Heat(heat));
        }
        heat.next_tick_s = self.now_s + 1.0;
        let heater = &self.heaters[heat.heater as usize];
        if heater.target_c <= 0.0 {
            // It was given up.
            return Outcome::Done;
        }
        let near = (heater.reading_c(self.now_s) - heater.target_c).abs() <= WINDOW_C;
        heat.reached_s = if near { heat.reached_s.or(Some(self.now_s)) } else { None };
        let left_s = heat.reached_s.map(|since| self.profile.dialect.residency_s - (self.now_s - since));
        if left_s.is_some_and(|left| left <= 0.0) {
            self.state("heated", format!("{:.1}", self.heaters[heat.heater as usize].target_c));
            return Outcome::Done;
        }
        let left = left_s.map_or_else(|| "?".to_owned(), |left| format!("{:.0}", (left - 1.0).max(0.0)));
        let temperatures = self.temperatures();
        match self.profile.dialect.family {
            Family::Marlin => self.say(&format!("{temperatures} W:{left}")),
            _ => self.say(temperatures.trim_start()),
        }
        Outcome::Wait(Wait::Heat(heat))
    }

    fn tell_firmware(&mut self) -> Outcome {
        let dialect = self.profile.dialect;
        let text = dialect.firmware.replace("{machine}", self.profile.name);
        if dialect.answers_after_ok() {
            self.say(&format!("ok {text}"));
            return Outcome::Answered;
        }
        self.say(&text);
        self.say_all(dialect.capabilities);
        Outcome::Done
    }

    fn tell_endstops(&mut self) {
        self.say("Reporting endstop status");
        let at = self.driven();
        for (axis, name) in ["x_min", "y_min", "z_min"].into_iter().enumerate() {
            let hit = self.motion.homed[axis] && at[axis] <= 0.0;
            self.say(&format!("{name}: {}", if hit { "TRIGGERED" } else { "open" }));
        }
        self.say(&format!("filament: {}", if self.filament_out { "open" } else { "TRIGGERED" }));
    }

    fn tell_settings(&mut self) {
        let limits = self.motion.limits;
        let axes = |v: [f64; 4]| format!("X{:.2} Y{:.2} Z{:.2} E{:.2}", v[0], v[1], v[2], v[3]);
        let lines = [
            "echo:; Steps per unit:".to_owned(),
            format!("echo: M92 {}", axes(self.motion.steps_per_mm)),
            "echo:; Max feedrates (units/s):".to_owned(),
            format!("echo: M203 {}", axes(limits.max_speed)),
            "echo:; Max Acceleration (units/s2):".to_owned(),
            format!("echo: M201 {}", axes(limits.max_acceleration)),
            "echo:; Acceleration (units/s2) (P<print-accel> R<retract-accel> T<travel-accel>):".to_owned(),
            format!(
                "echo: M204 P{:.2} R{:.2} T{:.2}",
                limits.print_acceleration, limits.retract_acceleration, limits.travel_acceleration
            ),
            "echo:; Advanced (J<junc_dev>):".to_owned(),
            match limits.cornering {
                Cornering::Deviation(mm) | Cornering::SmoothieDeviation(mm) => format!("echo: M205 J{mm:.3}"),
                Cornering::ClassicJerk { axes: [x, y, z, e], .. }
                | Cornering::InstantChange([x, y, z, e])
                | Cornering::PlanarJerk([x, y, z, e]) => {
                    format!("echo: M205 X{x:.2} Y{y:.2} Z{z:.2} E{e:.2}")
                }
                Cornering::SquareCorner { speed, .. } => format!("echo: square corner velocity {speed:.2}"),
            },
        ];
        for line in lines {
            self.say(&line);
        }
    }
}

fn axes_to_home(command: &Command<'_>) -> [bool; 3] {
    let named = [b'X', b'Y', b'Z'].map(|letter| command.seen(letter));
    if named == [false; 3] { [true; 3] } else { named }
}

fn percent(command: &Command<'_>, before: f64) -> f64 {
    command.value(b'S').map_or(before, |percent| percent.clamp(1.0, 999.0))
}
