//! `lumenfab tui`: the screen of the lab.

use super::args::queue::TuiArgs;
use super::{Answer, Failure};
use crate::appliance::{self, place};
use crate::tui::{self, Options, Theme};
use serde_json::json;

/// Shows the screen until it is left.
pub(super) fn run(args: &TuiArgs, is_json: bool) -> Result<Answer, Failure> {
    if is_json {
        let text =
            "--json: `lumenfab tui` is a screen; for programs there is `lumenfab queue --json`".to_owned();
        return Err(Failure { text, code: "tui.json".to_owned(), exit_code: 2 });
    }
    let dir = match &args.state.state {
        Some(dir) => {
            std::path::absolute(dir).map_err(|source| appliance::Error::Io { path: dir.clone(), source })?
        }
        None => place::default_dir(|name| std::env::var_os(name))?,
    };
    let program = std::env::current_exe().map_err(appliance::Error::Runtime)?;
    // Whoever sets it to anything does not want colours (no-color.org).
    let has_no_colour = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let usual = if has_no_colour { Theme::Plain } else { Theme::default() };
    tui::run(Options { dir, program, theme: args.theme.unwrap_or(usual) })?;
    Ok(Answer { document: json!({ "ended": "left" }), text: String::new() })
}

impl From<tui::Error> for Failure {
    fn from(error: tui::Error) -> Self {
        Self { text: error.to_string(), code: error.code().to_owned(), exit_code: error.exit_code() }
    }
}
