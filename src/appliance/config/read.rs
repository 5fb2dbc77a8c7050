//! Keys of a TOML file with the lines where they stand; what is wrong with each, and which nobody knows.

use crate::nearest::nearest;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// Longest part of a value that is shown, characters.
const MAX_SHOWN: usize = 60;

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// The line, from 1.
    pub line: usize,
    /// What, and what was expected.
    pub text: String,
}

/// All that is wrong with a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Faults {
    /// The file.
    pub file: String,
    /// In the order of their lines.
    pub faults: Vec<Fault>,
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines = self.faults.iter().map(|fault| format!("{}:{}: {}", self.file, fault.line, fault.text));
        f.write_str(&lines.collect::<Vec<_>>().join("; "))
    }
}

impl std::error::Error for Faults {}

/// The keys of a file that are not read yet, by their dotted paths; entries of a list of tables by their number (`printer.0.name`).
#[derive(Debug)]
pub(super) struct Keys {
    left: BTreeMap<String, (usize, Value)>,
    /// Tables in each list of tables.
    lists: BTreeMap<String, usize>,
    known: BTreeSet<String>,
    /// Values of keys that have to differ.
    seen: BTreeSet<(String, String)>,
    faults: Vec<Fault>,
}

impl Keys {
    /// Of a file's text.
    pub(super) fn parse(text: &str, file: &str) -> Result<Self, Faults> {
        let wrong = |e: toml::de::Error| {
            let line = e.span().map_or(1, |span| line_of(text, span.start));
            let fault = Fault { line, text: e.message().lines().collect::<Vec<_>>().join("; ") };
            Faults { file: file.to_owned(), faults: vec![fault] }
        };
        let spans = DeTable::parse(text).map_err(wrong)?;
        let table: Table = text.parse().map_err(wrong)?;
        let mut keys = Self {
            left: BTreeMap::new(),
            lists: BTreeMap::new(),
            known: BTreeSet::new(),
            seen: BTreeSet::new(),
            faults: Vec::new(),
        };
        keys.insert("", &table, spans.get_ref(), text);
        Ok(keys)
    }

    fn insert(&mut self, prefix: &str, table: &Table, spans: &DeTable<'_>, text: &str) {
        for (key, span) in spans {
            let Some(value) = table.get(key.get_ref().as_ref()) else { continue };
            let path = format!("{prefix}{}", key.get_ref());
            match (value, span.get_ref()) {
                (Value::Table(inner), DeValue::Table(spans)) => {
                    self.insert(&format!("{path}."), inner, spans, text);
                }
                (Value::Array(values), DeValue::Array(spans)) if values.iter().any(Value::is_table) => {
                    self.lists.insert(path.clone(), values.len());
                    for (idx, (value, span)) in values.iter().zip(spans.iter()).enumerate() {
                        if let (Value::Table(inner), DeValue::Table(spans)) = (value, span.get_ref()) {
                            self.insert(&format!("{path}.{idx}."), inner, spans, text);
                        }
                    }
                }
                _ => {
                    self.left.insert(path, (line_of(text, key.span().start), value.clone()));
                }
            }
        }
    }

    /// Tables in a list of tables.
    pub(super) fn n_tables(&self, list: &str) -> usize {
        self.lists.get(list).copied().unwrap_or(0)
    }

    /// The line of a key that is not read yet.
    pub(super) fn line_of(&self, key: &str) -> usize {
        self.left.get(key).map_or(1, |(line, _)| *line)
    }

    /// Takes a key; `None` of `read` is a fault.
    pub(super) fn take<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Option<T> {
        self.known.insert(without_numbers(key));
        let (line, value) = self.left.remove(key)?;
        let found = read(&value);
        if found.is_none() {
            self.fault(line, key, &shown(&value), expected);
        }
        found
    }

    /// Whether no other table of a list had this value.
    pub(super) fn is_first(&mut self, key: &str, value: &str) -> bool {
        self.seen.insert((key.to_owned(), value.to_owned()))
    }

    pub(super) fn fault(&mut self, line: usize, key: &str, found: &str, expected: &str) {
        let text = format!("{}: found {found}, expected {expected}", without_numbers(key));
        self.faults.push(Fault { line, text });
    }

    /// Nobody knows what is left.
    pub(super) fn end(mut self, file: &str) -> Result<(), Faults> {
        for (key, (line, _)) in std::mem::take(&mut self.left) {
            let key = without_numbers(&key);
            let hint = nearest(&key, self.known.iter().map(String::as_str))
                .map(|known| format!(" (did you mean {known}?)"));
            let text = format!("{key}: there is no such key{}", hint.unwrap_or_default());
            self.faults.push(Fault { line, text });
        }
        if self.faults.is_empty() {
            return Ok(());
        }
        self.faults.sort();
        Err(Faults { file: file.to_owned(), faults: self.faults })
    }
}

/// `printer.0.name` is shown as `printer.name`: the line says which.
fn without_numbers(key: &str) -> String {
    key.split('.').filter(|part| part.parse::<usize>().is_err()).collect::<Vec<_>>().join(".")
}

fn shown(value: &Value) -> String {
    let text = value.as_str().map_or_else(|| value.to_string(), |text| format!("{text:?}"));
    if text.chars().count() <= MAX_SHOWN {
        text
    } else {
        text.chars().take(MAX_SHOWN - 3).chain("...".chars()).collect()
    }
}

/// The line, from 1, in which the byte at `offset` stands.
fn line_of(text: &str, offset: usize) -> usize {
    text.bytes().take(offset).filter(|&b| b == b'\n').count() + 1
}
