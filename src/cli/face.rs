//! What the operator sees: bars and lines on stderr, results on stdout.

use crate::app::{Error, Event, Stage, StageOutcome};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;

/// Writes to stdout; a reader that has gone away is no fault of the work.
pub(super) fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    ignore_closed(out.write_all(text.as_bytes()).and_then(|()| out.flush()));
}

/// Writes one line to stderr.
pub(super) fn say(line: &str) {
    ignore_closed(writeln!(std::io::stderr().lock(), "{line}"));
}

/// Nobody is left to be told that nobody reads.
fn ignore_closed(_written: std::io::Result<()>) {}

/// Shows events and results.
#[derive(Debug)]
pub(super) struct Face {
    json: bool,
    terminal: bool,
    bar: Mutex<Option<ProgressBar>>,
}

impl Face {
    pub(super) fn new(json: bool) -> Self {
        Self { json, terminal: std::io::stderr().is_terminal(), bar: Mutex::new(None) }
    }

    /// Shows an event on stderr.
    pub(super) fn event(&self, event: Event) {
        match event {
            Event::Started(stage) => self.start_bar(stage),
            Event::Progress { done, total, .. } => self.with_bar(|bar| {
                bar.set_length(total);
                bar.set_position(done);
            }),
            Event::Note { text, .. } => self.with_bar(|bar| bar.set_message(text)),
            Event::Told { stage, code, text } => self.told(stage, code, &text),
            Event::Warned { stage, warning } => {
                self.line(&format!("{stage:<8} warning: {} ({})", warning.text, warning.code));
            }
            Event::Ended(outcome) => {
                self.end_bar();
                self.line(&stage_line(&outcome));
            }
        }
    }

    /// Something that nobody should miss: a line on stderr, a document of its own where documents are asked for.
    fn told(&self, stage: Stage, code: &str, text: &str) {
        let document = || serde_json::json!({"event": code, "stage": stage, "text": text}).to_string();
        self.line(&if self.json { document() } else { format!("{stage:<8} {text}") });
        self.with_bar(|bar| bar.set_message(text.to_owned()));
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

    /// An error: its line on stderr.
    pub(super) fn error(&self, error: &Error) {
        self.end_bar();
        self.line(&format!("error: {}", one_line(&error.to_string())));
    }

    /// A command line that was refused.
    pub(super) fn usage_error(&self, line: &str) -> u8 {
        self.line(&format!("error: {line}"));
        if self.json {
            self.result(&serde_json::json!({"error": line, "exit_code": 2}), "");
        }
        2
    }

    /// An error as the whole result of a command.
    pub(super) fn failed(&self, error: &Error) -> u8 {
        self.error(error);
        if self.json {
            self.result(&error_document(error), "");
        }
        error.exit_code()
    }

    /// One line on stderr, above the bar where there is one.
    pub(super) fn line(&self, line: &str) {
        match &*self.bar() {
            Some(bar) => bar.suspend(|| say(line)),
            None => say(line),
        }
    }

    fn bar(&self) -> std::sync::MutexGuard<'_, Option<ProgressBar>> {
        // A thread that panicked while it held the bar left it drawable.
        self.bar.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn start_bar(&self, stage: Stage) {
        if !self.terminal {
            return;
        }
        let style = ProgressStyle::with_template("{prefix:8} {bar:30} {percent:>3} %  {elapsed}  {msg}");
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
    serde_json::json!({"error": text, "code": error.code(), "exit_code": error.exit_code()})
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
