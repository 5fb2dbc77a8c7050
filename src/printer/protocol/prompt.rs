//! The printer's questions to the operator: `//action:prompt_begin`, `prompt_button` and so on, put together.

use serde::Serialize;

/// More buttons are noise.
const MAX_BUTTONS: usize = 16;

/// A question of the printer's.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Prompt {
    /// What it says.
    pub text: String,
    /// What can be answered.
    pub buttons: Vec<Button>,
}

/// An answer that the printer offers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Button {
    /// What it says.
    pub label: String,
    /// What it wants to be sent, where it says so (Klipper).
    #[serde(skip)]
    pub gcode: Option<String>,
}

impl std::fmt::Display for Prompt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)?;
        self.buttons.iter().enumerate().try_for_each(|(i, button)| write!(f, "  [{i}] {}", button.label))
    }
}

/// Puts questions together, word by word.
#[derive(Debug, Default)]
pub(super) struct Prompts {
    building: Prompt,
    shown: Option<Prompt>,
}

impl Prompts {
    /// Takes what stands behind `action:`. Where a question is now to be shown, that; where the one that was shown is over, nothing;
    /// `None` for all other words.
    pub(super) fn take(&mut self, action: &str) -> Option<Option<Prompt>> {
        let (word, rest) = action.split_once(' ').unwrap_or((action, ""));
        let rest = rest.trim();
        match word {
            "prompt_begin" => self.building = Prompt { text: rest.to_owned(), buttons: Vec::new() },
            "prompt_text" => self.building.text = format!("{} {rest}", self.building.text).trim().to_owned(),
            "prompt_button" | "prompt_choice" | "prompt_footer_button" => self.add(rest),
            "prompt_show" => {
                self.shown = Some(self.building.clone());
                return Some(self.shown.clone());
            }
            "prompt_end" => return self.shown.take().map(|_| None),
            _ => {}
        }
        None
    }

    fn add(&mut self, text: &str) {
        let mut parts = text.split('|');
        let label = parts.next().unwrap_or_default().to_owned();
        let gcode = parts.next().filter(|gcode| !gcode.is_empty()).map(str::to_owned);
        if self.building.buttons.len() < MAX_BUTTONS {
            self.building.buttons.push(Button { label, gcode });
        }
    }

    /// Whether there is a question with such a button.
    pub(super) fn has(&self, button_idx: usize) -> bool {
        self.shown.as_ref().is_some_and(|prompt| button_idx < prompt.buttons.len())
    }

    /// The button that was chosen; the question is over.
    pub(super) fn answered(&mut self, button_idx: usize) -> Option<Button> {
        let button = self.shown.as_ref()?.buttons.get(button_idx)?.clone();
        self.shown = None;
        Some(button)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_is_put_together_shown_and_answered_once() {
        let mut prompts = Prompts::default();
        for action in
            ["prompt_begin Nozzle Parked", "prompt_button Continue", "prompt_button Purge|PURGE L=5|red"]
        {
            assert_eq!(prompts.take(action), None);
        }
        let shown = prompts.take("prompt_show").unwrap().unwrap();
        assert_eq!(shown.to_string(), "Nozzle Parked  [0] Continue  [1] Purge");
        assert_eq!(prompts.answered(2), None);
        assert_eq!(prompts.answered(1).unwrap().gcode.as_deref(), Some("PURGE L=5"));
        assert_eq!(prompts.answered(0), None, "it is over");
        assert_eq!(prompts.take("prompt_end"), None);
        assert_eq!(prompts.take("paused filament"), None);
    }
}
