//! What the operator sees: bars and lines on stderr, results on stdout.

use crate::app::{Error, Event, Stage, StageOutcome};
use crate::ct::Warning;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use serde_json::json;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Writes to stdout; a reader that has gone away is no fault of the work.
pub(super) fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    ignore_closed(out.write_all(text.as_bytes()).and_then(|()| out.flush()));
}

/// Whether lines on stderr are documents, too: set once, before anything is said.
static IS_JSON: AtomicBool = AtomicBool::new(false);

/// Writes one line to stderr: where documents are asked for, as one.
pub(super) fn say(line: &str) {
    if IS_JSON.load(Ordering::Relaxed) {
        say_document(&json!({"event": "message", "text": line}));
    } else {
        say_line(line);
    }
}

fn say_line(line: &str) {
    ignore_closed(writeln!(std::io::stderr().lock(), "{line}"));
}

fn say_document(document: &serde_json::Value) {
    ignore_closed(writeln!(std::io::stderr().lock(), "{document}"));
}

/// Nobody is left to be told that nobody reads.
fn ignore_closed(_written: std::io::Result<()>) {}

/// Between two lines of how far a print is, where nobody sees a bar.
const PROGRESS_EVERY: Duration = Duration::from_secs(60);

/// Shows events and results.
#[derive(Debug)]
pub(super) struct Face {
    json: bool,
    terminal: bool,
    bar: Mutex<Option<ProgressBar>>,
    /// When it was last said how far the print is.
    told: Mutex<Option<Instant>>,
}

impl Face {
    pub(super) fn new(json: bool) -> Self {
        IS_JSON.store(json, Ordering::Relaxed);
        Self {
            json,
            terminal: std::io::stderr().is_terminal(),
            bar: Mutex::new(None),
            told: Mutex::new(None),
        }
    }

    /// Shows an event on stderr.
    pub(super) fn event(&self, event: Event) {
        match event {
            Event::Started(stage) => self.start_bar(stage),
            Event::Progress { stage, done, total } => {
                self.with_bar(|bar| {
                    bar.set_length(total);
                    bar.set_position(done);
                });
                if stage == Stage::Print && !self.terminal {
                    self.tell_progress(done, total);
                }
            }
            Event::Note { text, .. } => self.with_bar(|bar| bar.set_message(text)),
            Event::Told { stage, code, text } => {
                self.event_line(stage, code, &text, &text);
                self.with_bar(|bar| bar.set_message(text));
            }
            Event::Warned { stage, warning: Warning { code, text } } => {
                self.event_line(stage, &code, &text, &format!("warning: {text} ({code})"));
            }
            Event::Ended(outcome) => {
                self.end_bar();
                self.ended(&outcome);
            }
        }
    }

    /// Something that nobody should miss: a line on stderr, a document of its own where documents are asked for.
    fn event_line(&self, stage: Stage, code: &str, text: &str, line: &str) {
        self.suspended(|| {
            if self.json {
                say_document(&json!({"event": code, "stage": stage, "text": text}));
            } else {
                say(&format!("{stage:<8} {line}"));
            }
        });
    }

    fn ended(&self, outcome: &StageOutcome) {
        if self.json {
            say_document(&json!({"event": "ended", "outcome": outcome}));
        } else {
            say(&stage_line(outcome));
        }
    }

    /// Once a minute: a service manager keeps each line.
    #[expect(
        clippy::disallowed_methods,
        reason = "this is an edge: how often is a matter of the clock on the wall"
    )]
    fn tell_progress(&self, done: u64, total: u64) {
        let (now, mut told) = (Instant::now(), self.told.lock().unwrap_or_else(PoisonError::into_inner));
        let last = *told.get_or_insert(now);
        if now - last < PROGRESS_EVERY {
            return;
        }
        *told = Some(now);
        if self.json {
            let event = "printer.progress";
            say_document(
                &json!({"event": event, "stage": Stage::Print, "n_lines_done": done, "n_lines": total}),
            );
        } else {
            say(&format!("{:<8} {} % of its lines", Stage::Print, 100 * done / total.max(1)));
        }
    }

    /// A result: a document, or its text.
    pub(super) fn result(&self, document: &impl Serialize, text: &str) {
        self.end_bar();
        if self.json {
            let json =
                serde_json::to_string(document).expect("results hold numbers, names and lists of them");
            print(&format!("{json}\n"));
        } else {
            print(text);
        }
    }

    /// An error: its line on stderr. It may name the operator's own files, so it is no document: those are kept.
    pub(super) fn error(&self, error: &Error) {
        self.end_bar();
        say_line(&format!("error: {}", one_line(&error.to_string())));
    }

    /// A command line that was refused.
    pub(super) fn usage_error(&self, line: &str) -> u8 {
        say_line(&format!("error: {line}"));
        if self.json {
            self.result(&json!({"error": line, "exit_code": 2}), "");
        }
        2
    }

    /// The same of what is no case.
    pub(super) fn failure(&self, text: &str, code: &str, exit_code: u8) -> u8 {
        let line = one_line(text);
        say_line(&format!("error: {line}"));
        if self.json {
            self.result(&json!({"error": line, "code": code, "exit_code": exit_code}), "");
        }
        exit_code
    }

    /// An error as the whole result of a command.
    pub(super) fn failed(&self, error: &Error) -> u8 {
        self.error(error);
        if self.json {
            self.result(&error_document(error), "");
        }
        error.exit_code()
    }

    /// One line on stderr, above the bar where there is one. It may name files, so it is no document.
    pub(super) fn line(&self, line: &str) {
        self.suspended(|| say_line(line));
    }

    fn suspended(&self, say: impl FnOnce()) {
        match &*self.bar() {
            Some(bar) => bar.suspend(say),
            None => say(),
        }
    }

    fn bar(&self) -> std::sync::MutexGuard<'_, Option<ProgressBar>> {
        // A thread that panicked while it held the bar left it drawable.
        self.bar.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn start_bar(&self, stage: Stage) {
        if !self.terminal {
            return;
        }
        let template = match stage {
            Stage::Print => "{prefix:8} {bar:30} {percent:>3} %  {elapsed}, about {eta} left  {msg}",
            _ => "{prefix:8} {bar:30} {percent:>3} %  {elapsed}  {msg}",
        };
        let style = ProgressStyle::with_template(template);
        let style = style.expect("the template is well formed").progress_chars("=> ");
        let bar = ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr_with_hz(10));
        *self.bar() = Some(bar.with_style(style).with_prefix(stage.name()));
    }

    fn with_bar(&self, change: impl FnOnce(&ProgressBar)) {
        if let Some(bar) = &*self.bar() {
            change(bar);
        }
    }

    fn end_bar(&self) {
        if let Some(bar) = self.bar().take() {
            bar.finish_and_clear();
        }
    }
}

/// An error as a document: it may be kept or sent on, so the paths of a CT are left out; the line on stderr has them.
pub(super) fn error_document(error: &Error) -> serde_json::Value {
    let text = one_line(&error.text_without_sources());
    json!({"error": text, "code": error.code(), "exit_code": error.exit_code()})
}

/// How a stage ended, as a line.
fn stage_line(outcome: &StageOutcome) -> String {
    if outcome.done {
        format!("{:<8} {:>7.2} s  {}", outcome.stage, outcome.elapsed_s, outcome.summary)
    } else {
        let summary = if outcome.summary.is_empty() { "as it was" } else { &outcome.summary };
        format!("{:<8} {:>9}  {summary} (nothing it is made from has changed)", outcome.stage, "kept")
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
