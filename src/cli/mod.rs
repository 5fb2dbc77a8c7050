//! The command line: a face of [`crate::app`].
//!
//! Results go to stdout (text, or one JSON document with `--json`), everything else to stderr. What is done lives in
//! [`crate::app`]; here flags become parameters, events become lines and bars, errors become one line and an exit code.

mod args;
mod commands;
mod face;
mod keys;
mod queue;
mod serve;
mod signals;
mod tui;

use args::{Cli, usage_line};
use clap::Parser;
use clap::error::ErrorKind;
use face::Face;
use std::ffi::OsString;
use std::panic;
use std::process::ExitCode;

/// The command that [`crate::printer::sim`] starts; taken out before anything else looks at the arguments, because they are
/// another program's.
const SIMULATOR: &str = "hil-sim";

/// Runs the command and returns its exit code: 0 done; 1 the work failed; 2 wrong usage or configuration; 3 done, but the
/// report's gate failed; 130 interrupted.
#[must_use]
pub fn main() -> ExitCode {
    let args: Vec<OsString> = std::env::args_os().collect();
    if args.get(1).is_some_and(|a| a == SIMULATOR) {
        return hil_sim::cli::main_from(args.into_iter().skip(1));
    }
    panic::set_hook(Box::new(say_panic));
    // The hook has said what happened; here it only becomes an exit code, with every guard of a temporary file run.
    panic::catch_unwind(|| run(args)).unwrap_or(ExitCode::FAILURE)
}

/// What a command of the appliance has to say.
struct Answer {
    document: serde_json::Value,
    text: String,
}

/// Why one came to nothing.
struct Failure {
    text: String,
    code: String,
    exit_code: u8,
}

impl From<crate::appliance::Error> for Failure {
    fn from(error: crate::appliance::Error) -> Self {
        Self { text: error.to_string(), code: error.code().to_owned(), exit_code: error.exit_code() }
    }
}

impl From<crate::client::Error> for Failure {
    fn from(error: crate::client::Error) -> Self {
        Self { text: error.to_string(), code: error.code().to_owned(), exit_code: 1 }
    }
}

fn run(args: Vec<OsString>) -> ExitCode {
    start_log(&args);
    let json = args.iter().any(|a| a == "--json");
    match Cli::try_parse_from(args) {
        Ok(cli) => ExitCode::from(commands::run(cli)),
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            face::print(&e.render().to_string());
            ExitCode::SUCCESS
        }
        Err(e) => ExitCode::from(Face::new(json).usage_error(&usage_line(&e))),
    }
}

/// Libraries whose words may quote what they read: a patient's name, or a path.
const NEVER_LOGGED: [&str; 7] = [
    "dicom_core",
    "dicom_encoding",
    "dicom_object",
    "dicom_parser",
    "dicom_transfer_syntax_registry",
    "jpeg2k",
    "openjp2",
];

/// Diagnostics of the rooms, for whoever looks for a fault: `LUMENFAB_LOG=debug`; warnings and worse otherwise. What
/// reads patients' files logs nothing, whatever is asked for.
fn start_log(args: &[OsString]) {
    let is = |command: &str| args.get(1).is_some_and(|arg| arg == command);
    let usual = match () {
        // A server's log is all that tells afterwards what it did, and so is that of whoever watches its heaters.
        () if args.iter().any(|arg| arg == "serve" || arg == "safe-off") => "info",
        // It would be written over the screen.
        () if is("tui") => "off",
        () => "warn",
    };
    let filter = tracing_subscriber::EnvFilter::try_from_env("LUMENFAB_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(usual));
    let filter = NEVER_LOGGED.iter().fold(filter, |filter, name| match format!("{name}=off").parse() {
        Ok(directive) => filter.add_directive(directive),
        Err(_) => filter,
    });
    // A log that cannot be written (a full disk) is no reason to fall: saying so on stderr would be one.
    let log = tracing_subscriber::fmt().log_internal_errors(false);
    let log = log.with_env_filter(filter).with_writer(std::io::stderr);
    // A second start in one process (a test) keeps the first log.
    drop(log.try_init());
}

/// A fault of the program: one line that can be reported, no backtrace over the operator's screen. A decoder that gives up on a
/// damaged file is none: that becomes an error of the file.
fn say_panic(info: &panic::PanicHookInfo<'_>) {
    if crate::ct::reader::is_decoding() {
        return;
    }
    keys::restore();
    let payload = info.payload();
    let text = payload.downcast_ref::<&str>().copied().map(str::to_owned);
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_default();
    let place = info.location().map(ToString::to_string).unwrap_or_default();
    face::say(&format!("internal error at {place}: {text}; this is a fault of lumenfab, please report it"));
}
