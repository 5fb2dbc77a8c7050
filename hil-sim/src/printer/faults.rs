//! Faults at work.

use super::{HeaterName, Printer, life::Cause};
use crate::{
    dialect::Numbering,
    event::Event,
    spec::{Direction, FaultSpec, Kind},
    wire,
};

/// Length of a delay for which none is given, s.
const DELAY_S: f64 = 1.0;

impl Printer {
    /// A line leaves the host: what the wire makes of it goes on its way.
    pub(super) fn send_line_to_printer(&mut self, mut line: Vec<u8>) {
        self.lines_from_host += 1;
        let mut delay_s = 0.0;
        let at = crate::spec::Progress { lines: self.lines_from_host, ..self.progress() };
        for index in 0..self.faults.len() {
            let fault = &mut self.faults[index];
            let kind = fault.spec.kind;
            let ours =
                kind.is_of_one_line() && fault.spec.direction == Direction::Rx || kind == Kind::WrongResend;
            if !ours || !fault.strikes(at, true) {
                continue;
            }
            let mut detail = wire::damage(kind, &mut line, &mut fault.rng);
            if kind == Kind::Delay {
                delay_s += fault.spec.for_s.unwrap_or(DELAY_S);
                detail = format!("{delay_s} s");
            }
            if kind == Kind::WrongResend {
                const ERRORS: [i64; 6] = [-3, -2, -1, 1, 2, 3];
                self.resend_error = Some(ERRORS[fault.rng.below(ERRORS.len())]);
            }
            self.note_fault(kind, format!("rx line {}: {detail}", self.lines_from_host));
        }
        self.summary.bytes_received += line.len() as u64;
        self.incoming.launch(self.now_s, line, delay_s);
    }

    /// What the wire makes of a reply: how late it is, or none if it is lost.
    pub(super) fn strike_reply(&mut self, line: &mut Vec<u8>) -> Option<f64> {
        let at = self.progress();
        let mut delay_s = 0.0;
        let is_ok = line.starts_with(b"ok");
        for index in 0..self.faults.len() {
            let fault = &mut self.faults[index];
            let kind = fault.spec.kind;
            let ours = kind.is_of_one_line() && fault.spec.direction == Direction::Tx
                || kind == Kind::LostOk && is_ok;
            if !ours || !fault.strikes(at, true) {
                continue;
            }
            if kind == Kind::LostOk {
                self.note_fault(kind, String::from_utf8_lossy(line).trim_end().to_owned());
                return None;
            }
            let mut detail = wire::damage(kind, line, &mut fault.rng);
            if kind == Kind::Delay {
                delay_s += fault.spec.for_s.unwrap_or(DELAY_S);
                detail = format!("{delay_s} s");
            }
            self.note_fault(kind, format!("tx: {detail}"));
        }
        Some(delay_s)
    }

    /// A line was accepted: asks for the next one as if there had been an error.
    pub(super) fn strike_spurious_resend(&mut self) {
        if self.profile.dialect.numbering == Numbering::Ignored {
            // It has no words for that.
            return;
        }
        let at = self.progress();
        for index in 0..self.faults.len() {
            if self.faults[index].spec.kind == Kind::SpuriousResend && self.faults[index].strikes(at, true) {
                self.note_fault(Kind::SpuriousResend, format!("{}", self.receiver.last_line + 1));
                self.request_resend();
            }
        }
    }

    /// Lets the faults of the machine strike; `is_line`: at a line received.
    pub(super) fn strike_machine(&mut self, is_line: bool) {
        for index in 0..self.faults.len() {
            let at = self.progress();
            let fault = &mut self.faults[index];
            if !fault.spec.kind.is_of_the_wire() && fault.strikes(at, is_line) {
                let spec = fault.spec.clone();
                self.strike(&spec);
            }
        }
    }

    fn strike(&mut self, spec: &FaultSpec) {
        self.note_fault(spec.kind, spec.for_s.map_or_else(String::new, |for_s| format!("for {for_s} s")));
        let until_s = spec.for_s.map_or(f64::INFINITY, |for_s| self.now_s + for_s);
        match spec.kind {
            Kind::Disconnect => {
                self.unplugged_until_s = until_s.max(self.unplugged_until_s);
                self.incoming.clear(self.now_s);
                self.outgoing.clear(self.now_s);
            }
            Kind::Reset | Kind::PowerCut if spec.for_s.is_some() => self.board_is_down(until_s),
            Kind::Reset | Kind::PowerCut => self.board_resets(),
            Kind::Kill => {
                "Shutdown by an external event".clone_into(&mut self.halt_reason);
                self.kill(Cause::Button);
            }
            Kind::Runaway => self.heaters[HeaterName::Hotend as usize].break_element(self.now_s),
            Kind::SensorOpen => {
                self.heaters[HeaterName::Hotend as usize].sensor_open = true;
                self.next_check_s = self.next_check_s.max(self.now_s);
            }
            // Silences that overlap last as long as the longer.
            Kind::Silent => self.silent_until_s = until_s.max(self.silent_until_s),
            _ => {
                self.apply_lasting(spec, true);
                self.lasting.push((until_s, spec.clone()));
                self.add_up_nozzle();
            }
        }
    }

    /// Begins or ends a fault of what is deposited.
    fn apply_lasting(&mut self, spec: &FaultSpec, begins: bool) {
        match spec.kind {
            Kind::LayerShift => {
                self.deposit.shift_mm[spec.axis] += if begins { spec.mm } else { -spec.mm };
            }
            Kind::Clog | Kind::Leak => {}
            Kind::FilamentOut if begins => self.filament_ends(),
            Kind::FilamentOut => self.filament_is_back(),
            _ => {}
        }
    }

    /// What clogs and leaks that overlap come to: each lets its share of what is left through, leaks add up.
    fn add_up_nozzle(&mut self) {
        let of = |kind: Kind| {
            self.lasting
                .iter()
                .filter(move |(_, spec)| spec.kind == kind)
                .map(|(_, spec)| spec.percent / 100.0)
        };
        self.deposit.yield_share = of(Kind::Clog).map(|share| 1.0 - share).product();
        self.deposit.leak_share = of(Kind::Leak).sum();
    }

    /// Ends what has lasted long enough.
    pub(super) fn end_lasting(&mut self) {
        let (over, on): (Vec<_>, Vec<_>) =
            self.lasting.drain(..).partition(|(until_s, _)| *until_s <= self.now_s);
        self.lasting = on;
        for (_, spec) in over {
            self.apply_lasting(&spec, false);
            self.state("fault-over", spec.kind.name().to_owned());
        }
        self.add_up_nozzle();
        if self.boots_s <= self.now_s {
            self.boots_s = f64::INFINITY;
            self.board_resets();
        }
    }

    /// When a fault begins or ends by the clock.
    pub(super) fn fault_s(&self) -> Option<f64> {
        let due = self.faults.iter().filter_map(crate::spec::Armed::due_s);
        let over = self.lasting.iter().map(|lasting| lasting.0);
        let outages = [self.silent_until_s, self.unplugged_until_s].into_iter().filter(|&t| t > self.now_s);
        due.chain(over)
            .chain(outages)
            .chain(Some(self.boots_s))
            .filter(|t| t.is_finite())
            .min_by(f64::total_cmp)
    }

    fn note_fault(&mut self, kind: Kind, detail: String) {
        *self.summary.faults.entry(kind.name()).or_default() += 1;
        self.events.push(Event::Fault { t_s: self.now_s, kind: kind.name(), detail });
    }
}
