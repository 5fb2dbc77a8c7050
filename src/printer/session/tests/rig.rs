//! A host and a simulated printer on one made-up clock; the host may die, the cable may be pulled.

use super::super::*;
use crate::printer::journal::{JobId, Log, Machine, encode, header};
use hil_sim::event::Event as SimEvent;
use hil_sim::printer::{Options, Printer};
use std::fmt::Write as _;
use std::io::{self, Cursor};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// More steps than any of these prints takes.
const MAX_STEPS: usize = 3_000_000;

/// A bead, without what depends on when it was laid: from, to, volume.
pub(super) type Laid = ([f64; 3], [f64; 3], f64);

/// Rings, one on the other, with a travel between: start and end scripts around them.
pub(super) fn rings(profile: &Profile, n_layers: u32, n_sides: u32, mm_min: u32) -> String {
    let mut text = profile.start_gcode().join("\n");
    for layer in 0..n_layers {
        let z_mm = 0.2 * f64::from(layer + 1);
        write!(text, "\n;LAYER:{layer}\nG1 Z{z_mm:.3} F600\nG0 X110.000 Y100.000 F9000\nG1 F{mm_min}")
            .unwrap();
        for side in 1..=n_sides {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(n_sides);
            let (x_mm, y_mm) = (10.0_f64.mul_add(angle.cos(), 100.0), 10.0_f64.mul_add(angle.sin(), 100.0));
            let length_mm = 20.0 * (std::f64::consts::PI / f64::from(n_sides)).sin();
            let e_mm = length_mm * 0.4 * 0.2 / (std::f64::consts::PI * 0.875 * 0.875);
            write!(text, "\nG1 X{x_mm:.3} Y{y_mm:.3} E{e_mm:.5}").unwrap();
        }
    }
    text.push('\n');
    text + &profile.end_gcode(0.2 * f64::from(n_layers)).join("\n")
}

/// A job's file, which may be gone.
#[derive(Debug)]
pub(super) struct Text {
    text: Cursor<Vec<u8>>,
    is_gone: Arc<AtomicBool>,
}

impl Text {
    fn check(&self) -> io::Result<()> {
        let is_gone = self.is_gone.load(Ordering::Relaxed);
        if is_gone { Err(io::ErrorKind::NotFound.into()) } else { Ok(()) }
    }
}

impl io::Read for Text {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        self.check()?;
        self.text.read(out)
    }
}

impl BufRead for Text {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.check()?;
        self.text.fill_buf()
    }

    fn consume(&mut self, n_bytes: usize) {
        self.text.consume(n_bytes);
    }
}

impl Seek for Text {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.check()?;
        self.text.seek(to)
    }
}

/// How a print of these tests is set up.
#[derive(Debug, Clone)]
pub(super) struct Setup {
    pub(super) profile: Profile,
    pub(super) job: String,
    pub(super) faults: Vec<String>,
    pub(super) baud: Option<u32>,
    pub(super) seed: u64,
}

impl Setup {
    pub(super) fn new(profile: &str, n_layers: u32, n_sides: u32) -> Self {
        Self::at_speed(profile, n_layers, n_sides, 1800)
    }

    /// Beads at so many mm/min.
    pub(super) fn at_speed(profile: &str, n_layers: u32, n_sides: u32, mm_min: u32) -> Self {
        // The simulator has another version of it, too.
        let builtin = crate::profile::builtin(profile.trim_end_matches("-silent")).unwrap();
        let profile = Profile { name: profile.to_owned(), ..builtin };
        let job = rings(&profile, n_layers, n_sides, mm_min);
        Self { profile, job, faults: Vec::new(), baud: None, seed: 1 }
    }

    pub(super) fn with(mut self, fault: &str) -> Self {
        self.faults.push(fault.to_owned());
        self
    }

    pub(super) fn job(&self) -> Job<Text> {
        let text = Text { text: Cursor::new(self.job.clone().into_bytes()), is_gone: Arc::default() };
        self.job_of(text)
    }

    fn job_of(&self, text: Text) -> Job<Text> {
        Job::try_new(text, "rings.gcode", &self.profile.firmware).unwrap()
    }

    fn printer(&self) -> Printer {
        let profile = hil_sim::profile::Profile::by_name(&self.profile.name).unwrap();
        let faults = self.faults.iter().map(|spec| spec.parse().unwrap()).collect();
        Printer::new(Options { profile, baud: self.baud, faults, seed: self.seed, record_commands: false })
    }
}

#[derive(Debug)]
pub(super) struct Rig {
    pub(super) setup: Setup,
    pub(super) session: Session<Text>,
    pub(super) printer: Printer,
    /// The journal's bytes, and when each record was written.
    pub(super) journal: Vec<u8>,
    pub(super) records: Vec<(f64, Record)>,
    pub(super) laid: Vec<Laid>,
    pub(super) events: Vec<PrintEvent>,
    /// Names of faults and states that the printer has told, with the time.
    pub(super) states: Vec<(f64, String)>,
    /// How long the journal's disk takes, s.
    pub(super) disk_s: f64,
    /// Which wait of the session for the disk ends when, s.
    flush: Option<(u64, f64)>,
    /// When the print was given up, s.
    pub(super) gave_up_s: Option<f64>,
    is_connected: bool,
    /// Somebody presses the printer's button as soon as he is told that it waits for him.
    pub(super) is_attended: bool,
    /// The printer neither hears nor says anything any more.
    pub(super) is_deaf: bool,
    /// The rates do not agree: what either says is noise to the other.
    pub(super) is_garbled: bool,
    /// There is no printer: what is sent comes back.
    pub(super) is_echo: bool,
    /// The job's file is gone.
    pub(super) is_job_gone: Arc<AtomicBool>,
    /// The cable is out.
    pub(super) is_unplugged: bool,
    /// All that was written.
    pub(super) sent: Vec<u8>,
    /// This share of the next write gets out, then the host is dead.
    pub(super) dies_at: Option<f64>,
    pub(super) is_dead: bool,
}

impl Rig {
    pub(super) fn new(setup: Setup) -> Self {
        let mut printer = setup.printer();
        printer.host_arrived();
        let is_job_gone = Arc::<AtomicBool>::default();
        let text =
            Text { text: Cursor::new(setup.job.clone().into_bytes()), is_gone: Arc::clone(&is_job_gone) };
        let mut session = Session::new(setup.job_of(text), &setup.profile, Start::Fresh, Instant::default());
        session.keep_journal();
        let mut rig = Self {
            journal: header(),
            session,
            printer,
            records: Vec::new(),
            laid: Vec::new(),
            events: Vec::new(),
            states: Vec::new(),
            disk_s: 0.0,
            flush: None,
            gave_up_s: None,
            is_connected: true,
            is_attended: false,
            is_deaf: false,
            is_garbled: false,
            is_echo: false,
            is_job_gone,
            is_unplugged: false,
            sent: Vec::new(),
            dies_at: None,
            is_dead: false,
            setup,
        };
        let n_lines = rig.session.n_lines();
        rig.write(Record::Job(JobId { hash: String::new(), n_lines }));
        let profile = rig.setup.profile.name.clone();
        rig.write(Record::Machine(Machine {
            profile,
            profile_hash: String::new(),
            port: "sim".into(),
            device: None,
        }));
        rig
    }

    fn write(&mut self, record: Record) {
        self.journal.extend(encode(&record));
        self.records.push((self.printer.now_s(), record));
    }

    pub(super) fn now(&self) -> Instant {
        Instant::after(Duration::from_secs_f64(self.printer.now_s()))
    }

    /// All that can be said now. True if anything was.
    fn exchange(&mut self) -> bool {
        let mut moved = self.connect();
        let mut out = Vec::new();
        loop {
            self.record();
            self.session.transmit(&mut out);
            if !self.session.has_records() {
                break;
            }
        }
        if let Some(share) = self.dies_at.filter(|_| !out.is_empty()) {
            out.truncate(whole(share * out.len() as f64));
            self.is_dead = true;
        }
        if !out.is_empty() && self.is_connected {
            self.sent.extend(&out);
            self.deliver(&out);
            moved = true;
        }
        let said = std::mem::take(self.printer.output());
        if !said.is_empty() && self.is_connected && !self.is_deaf {
            let said = if self.is_garbled || self.is_echo { Vec::new() } else { said };
            self.session.handle_bytes(self.now(), &said);
            moved = true;
        }
        let before = self.events.len();
        self.events.extend(std::iter::from_fn(|| self.session.poll_event()));
        let gave_up = |event: &PrintEvent| matches!(event, PrintEvent::Session(Event::Faulted(_)));
        if self.events[before..].iter().any(gave_up) {
            self.gave_up_s.get_or_insert(self.printer.now_s());
        }
        if self.is_attended && self.events[before..].contains(&PrintEvent::Session(Event::Paused)) {
            self.printer.press_button();
        }
        self.observe();
        moved
    }

    /// Writes down what there is, on a disk that takes its time.
    fn record(&mut self) {
        while let Some(record) = self.session.poll_record() {
            self.write(record);
        }
        let now_s = self.printer.now_s();
        let awaited = self.session.awaits_disk();
        self.flush = awaited.map(|number| match self.flush {
            Some((of, at_s)) if of == number => (number, at_s),
            _ => (number, now_s + self.disk_s),
        });
        // Instants are whole nanoseconds.
        if let Some((number, _)) = self.flush.filter(|(_, at_s)| *at_s <= now_s + 1e-6) {
            self.flush = None;
            self.session.handle_flushed(self.now(), number, true);
        }
    }

    fn deliver(&mut self, bytes: &[u8]) {
        let now = self.now();
        if self.is_garbled {
            self.session.handle_bytes(now, b"\xff\x80x\xfe\n");
        } else if self.is_echo {
            self.session.handle_bytes(now, bytes);
        } else if !self.is_deaf {
            self.printer.receive(bytes);
        }
    }

    fn connect(&mut self) -> bool {
        match (self.printer.is_plugged() && !self.is_unplugged, self.is_connected) {
            (false, true) => {
                self.is_connected = false;
                self.session.handle_lost(self.now());
            }
            (true, false) if self.session.wants_port() => self.reconnect(),
            _ => return false,
        }
        true
    }

    /// The port is opened again.
    pub(super) fn reconnect(&mut self) {
        self.is_connected = true;
        self.printer.host_arrived();
        self.session.handle_port(self.now());
    }

    fn observe(&mut self) {
        for event in self.printer.take_events() {
            match event {
                SimEvent::Bead(bead) => self.laid.push((bead.from_mm, bead.to_mm, bead.volume_mm3)),
                SimEvent::Fault { t_s, kind, .. } => self.states.push((t_s, kind.to_owned())),
                SimEvent::State { t_s, state, .. } => self.states.push((t_s, state.to_owned())),
                _ => {}
            }
        }
    }

    /// Everything that happens at this moment, then on to the next one. False when nothing will ever happen.
    pub(super) fn step(&mut self) -> bool {
        while !self.is_dead && self.exchange() {}
        if self.session.is_over() || self.is_dead {
            return false;
        }
        let flushed = self.flush.map(|(_, at_s)| Instant::after(Duration::from_secs_f64(at_s)));
        let due = self.session.poll_timeout().into_iter().chain(flushed).min();
        let next = self.printer.next_event_s().map(|s| Instant::after(Duration::from_secs_f64(s)));
        match (due, next) {
            (None, None) => return false,
            (Some(due), next) if next.is_none_or(|next| due < next) => {
                self.printer.advance_to(due.since(Instant::default()).as_secs_f64());
                self.session.handle_timeout(self.now().max(due));
            }
            _ => {
                self.printer.step();
            }
        }
        true
    }

    /// Until `stop` says so, or nothing more happens. Whether `stop` said so.
    pub(super) fn run_until(&mut self, mut stop: impl FnMut(&Self) -> bool) -> bool {
        for _ in 0..MAX_STEPS {
            if stop(self) {
                return true;
            }
            if !self.step() {
                return stop(self);
            }
        }
        self.hangs()
    }

    /// Until the session is over; how it ended, all moves then finished.
    pub(super) fn run(&mut self) -> End {
        self.run_until(|_| false);
        while self.printer.has_moves() && self.printer.step() {}
        self.observe();
        self.session.take_end().unwrap_or_else(|| self.hangs())
    }

    fn hangs(&self) -> ! {
        let Setup { profile, faults, baud, seed, .. } = &self.setup;
        let (at_s, printer) = (self.printer.now_s(), self.printer.summary());
        let last = String::from_utf8_lossy(&self.sent[self.sent.len().saturating_sub(200)..]);
        panic!(
            "{} {faults:?} {baud:?} {seed} hangs at {at_s:.1} s: {last:?} {printer:?} {:?}",
            profile.name, self.session
        );
    }

    /// The host dies; a new one resumes by the journal, of which the last `lost_s` are lost.
    pub(super) fn resume(&mut self, lost_s: f64, after_reset: bool) {
        let known = self.known(lost_s);
        self.resume_by(known, after_reset);
    }

    /// A new host resumes by what its journal says.
    pub(super) fn resume_by(&mut self, known: Known, after_reset: bool) {
        self.printer.host_left();
        self.printer.host_arrived();
        self.is_connected = true;
        (self.dies_at, self.is_dead) = (None, false);
        let start = Start::Resume { known: Box::new(known), after_reset };
        self.session = Session::new(self.setup.job(), &self.setup.profile, start, self.now());
        self.session.keep_journal();
        self.flush = None;
    }

    /// What the journal on disk says, without the last `lost_s`.
    pub(super) fn known(&self, lost_s: f64) -> Known {
        let until_s = self.printer.now_s() - lost_s;
        let mut bytes = header();
        for (at_s, record) in &self.records {
            // What begins a session is on the disk before it begins.
            if *at_s <= until_s || !matches!(record, Record::Progress(_) | Record::End(_)) {
                bytes.extend(encode(record));
            }
        }
        Known::from(&Log::parse(&bytes, Path::new("rings.gcode.journal")).unwrap())
    }

    /// What the journal comes to when all of it is on the disk.
    pub(super) fn log(&self) -> Log {
        Log::parse(&self.journal, Path::new("rings.gcode.journal")).unwrap()
    }

    /// Moves that nobody waits for are finished, as time passes without a host.
    pub(super) fn drain(&mut self, for_s: f64) {
        let end_s = self.printer.now_s() + for_s;
        while self.printer.next_event_s().is_some_and(|s| s <= end_s) && self.printer.step() {}
        self.printer.advance_to(end_s);
        self.printer.output().clear();
        self.observe();
    }
}

fn whole(share: f64) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of a write's length"
    )]
    let n = share as usize;
    n
}

impl Rig {
    /// Runs to the end: the print is finished, and each bead is where it was expected, once.
    #[track_caller]
    pub(super) fn ends_as(&mut self, expected: &[Laid], what: &str) {
        let end = self.run();
        assert!(matches!(end, End::Finished), "{what}: {end:?} {:?}", self.events);
        assert!(is_same(&self.laid, expected), "{what}");
    }
}

/// What a print without faults lays down.
pub(super) fn clean(setup: &Setup) -> Vec<Laid> {
    let mut rig = Rig::new(Setup { faults: Vec::new(), baud: None, ..setup.clone() });
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{}: {end:?}", setup.profile.name);
    rig.laid
}

/// Whether two prints have laid the same, each bead once and in order, to a thousandth of a micrometre.
pub(super) fn is_same(a: &[Laid], b: &[Laid]) -> bool {
    let near = |a: &Laid, b: &Laid| {
        let places = a.0.iter().chain(&a.1).zip(b.0.iter().chain(&b.1));
        places.into_iter().all(|(a, b)| (a - b).abs() < 1e-6) && (a.2 - b.2).abs() < 1e-6
    };
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| near(a, b))
}
