//! A question to the operator, with fields to fill in; what it is about, and what is asked of the server once all is filled in.

use super::message::Request;
use crate::http::wire::{Anew, BedClear, Order, Ordered, Said, Turn};
use crate::queue::{JobId, Name, Reason, State};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Longest text of a field, letters.
const LONGEST: usize = 500;

/// What a field takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Takes {
    /// Any text, or none.
    Text,
    /// Some text.
    Needed,
    /// One of these words, written out, so that it is not given by accident.
    OneOf(&'static [&'static str]),
    /// A whole number.
    Number(i32, i32),
    /// A whole number, or nothing.
    NumberOrNone(i32, i32),
}

/// A line to be filled in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) label: &'static str,
    pub(super) takes: Takes,
    pub(super) value: String,
}

impl Field {
    pub(super) fn new(label: &'static str, takes: Takes) -> Self {
        Self { label, takes, value: String::new() }
    }

    /// What is wrong with it.
    fn problem(&self) -> Option<String> {
        let (label, value) = (self.label, self.value.trim());
        match self.takes {
            Takes::Text => None,
            Takes::Needed if value.is_empty() => Some(format!("{label} is missing")),
            Takes::Needed => None,
            Takes::OneOf(words) if words.contains(&value) => None,
            Takes::OneOf(words) => Some(format!("type the word {}", words.join(" or "))),
            Takes::NumberOrNone(..) if value.is_empty() => None,
            Takes::Number(least, most) | Takes::NumberOrNone(least, most) => match value.parse::<i32>() {
                Ok(number) if (least..=most).contains(&number) => None,
                _ => Some(format!("{label}: a whole number from {least} to {most}")),
            },
        }
    }
}

/// What it is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum About {
    /// Whether a bed is clear of a job.
    ClearBed(Name, Option<JobId>),
    /// Whether it may not be.
    DoubtBed(Name),
    /// Heaters of a printer.
    Heat(Name),
    /// Filament of a printer.
    Extrude(Name),
    /// A job's change, seen in this state.
    Job(JobId, State, Ask),
}

/// What is asked about a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ask {
    Cancel,
    Retry,
    SignOff,
    Copies(u16),
    Priority(i8),
}

/// A question.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Form {
    pub(super) about: About,
    pub(super) title: String,
    pub(super) says: Vec<String>,
    pub(super) fields: Vec<Field>,
    pub(super) focus: usize,
    pub(super) problem: Option<String>,
}

/// What becomes of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// It stays.
    Open,
    /// It is left.
    Left,
    /// This is asked.
    Asks(Request),
}

impl Form {
    pub(super) fn new(about: About, title: String, says: Vec<String>, fields: Vec<Field>) -> Self {
        Self { about, title, says, fields, focus: 0, problem: None }
    }

    pub(super) fn press(&mut self, key: KeyEvent) -> Outcome {
        self.problem = None;
        let has_ctrl = key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT);
        match key.code {
            KeyCode::Esc => return Outcome::Left,
            KeyCode::Char('c') if has_ctrl => return Outcome::Left,
            KeyCode::Char('u') if has_ctrl => self.fields[self.focus].value.clear(),
            KeyCode::Char(c) if !has_ctrl => self.write(c),
            KeyCode::Backspace => drop(self.fields[self.focus].value.pop()),
            KeyCode::Tab | KeyCode::Down => self.focus = (self.focus + 1) % self.fields.len(),
            KeyCode::BackTab | KeyCode::Up => {
                self.focus = (self.focus + self.fields.len() - 1) % self.fields.len();
            }
            KeyCode::Enter => return self.enter(),
            _ => {}
        }
        Outcome::Open
    }

    fn write(&mut self, c: char) {
        let value = &mut self.fields[self.focus].value;
        if value.chars().count() < LONGEST && !c.is_control() {
            value.push(c);
        }
    }

    /// To the next field, and from the last one onwards.
    fn enter(&mut self) -> Outcome {
        if self.focus + 1 < self.fields.len() {
            self.focus += 1;
            return Outcome::Open;
        }
        let wrong = self.fields.iter().enumerate().find_map(|(n, field)| Some((n, field.problem()?)));
        if let Some((n, problem)) = wrong {
            (self.focus, self.problem) = (n, Some(problem));
            return Outcome::Open;
        }
        match self.request() {
            Ok(request) => Outcome::Asks(request),
            Err(problem) => {
                self.problem = Some(problem);
                Outcome::Open
            }
        }
    }

    fn value(&self, label: &str) -> &str {
        self.fields.iter().find(|field| field.label == label).map_or("", |field| field.value.trim())
    }

    fn request(&self) -> Result<Request, String> {
        let why = Reason::try_new(self.value(REASON)).map_err(|e| e.to_string())?;
        let name = match self.value(NAME) {
            "" => None,
            name => Some(Name::try_new(name).map_err(|e| e.to_string())?),
        };
        Ok(match &self.about {
            About::ClearBed(printer, on_bed) => {
                Request::ClearBed(printer.clone(), BedClear { on_bed: *on_bed, name, why })
            }
            About::Heat(printer) => {
                let of = |gcode: &str, label| match self.value(label) {
                    "" => None,
                    c => Some(format!("{gcode} S{c}")),
                };
                let lines: Vec<_> = [of("M104", NOZZLE), of("M140", BED)].into_iter().flatten().collect();
                if lines.is_empty() {
                    return Err("give a temperature for one of them".to_owned());
                }
                order(printer, lines)
            }
            About::Extrude(printer) => {
                let (c, mm) = (self.value(NOZZLE), self.value(LENGTH));
                let lines =
                    [format!("M109 S{c}"), "M83".to_owned(), format!("G1 E{mm} F150"), "M82".to_owned()];
                order(printer, lines.to_vec())
            }
            About::DoubtBed(printer) => Request::DoubtBed(printer.clone(), Said { name, why }),
            About::Job(job, saw, ask) => {
                let (turn, back) = self.turn(*ask);
                Request::Change(*job, Anew { turn, saw: Some(*saw), name, why }, back)
            }
        })
    }

    /// The change, and the one that takes it back. Fields were looked at before.
    fn turn(&self, ask: Ask) -> (Turn, Option<Turn>) {
        match ask {
            Ask::Cancel => (Turn::Cancel, None),
            Ask::Retry => (Turn::Retry, None),
            Ask::SignOff if self.value(DECISION) == "accept" => (Turn::Accept, None),
            Ask::SignOff => (Turn::Reject, None),
            Ask::Copies(before) => {
                let copies = self.value(COPIES).parse().unwrap_or(before);
                (Turn::Copies(copies), Some(Turn::Copies(before)))
            }
            Ask::Priority(before) => {
                let priority = self.value(PRIORITY).parse().unwrap_or(before);
                (Turn::Priority(priority), Some(Turn::Priority(before)))
            }
        }
    }
}

/// Lines of G-code for a printer.
pub(super) fn order(printer: &Name, lines: Vec<String>) -> Request {
    let ordered = Ordered { order: Order::Commands(lines), name: None, why: Reason::default() };
    Request::Order(printer.clone(), ordered)
}

/// Labels of fields.
pub(super) const NOZZLE: &str = "nozzle, °C";
pub(super) const BED: &str = "bed, °C";
pub(super) const LENGTH: &str = "filament, mm";
pub(super) const REASON: &str = "why";
pub(super) const NAME: &str = "your name";
pub(super) const DECISION: &str = "accept or reject";
pub(super) const COPIES: &str = "copies";
pub(super) const PRIORITY: &str = "priority";
