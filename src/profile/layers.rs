//! TOML files laid over each other, with the place every key came from.
//!
//! A profile takes the keys that it lacks from the one it inherits. The tables are merged key by key (arrays
//! are replaced, never joined), and for each key the file and line are kept, so that a wrong value is
//! reported where it was written and not where it was inherited.

use super::Error;
use std::collections::BTreeMap;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// Where a key was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Origin {
    pub(super) file: String,
    pub(super) line: usize,
}

/// Keys by their dotted path, each with its value and origin.
#[derive(Debug, Clone, Default)]
pub(super) struct Layers {
    pub(super) keys: BTreeMap<String, (Value, Origin)>,
}

impl Layers {
    /// Reads one file.
    pub(super) fn parse(text: &str, file: &str) -> Result<Self, Error> {
        let spanned = DeTable::parse(text).map_err(|e| syntax(&e, text, file))?;
        let table: Table = text.parse().map_err(|e| syntax(&e, text, file))?;
        let mut layers = Self::default();
        layers.insert_table("", &table, spanned.get_ref(), &|offset| Origin {
            file: file.to_owned(),
            line: line_of(text, offset),
        });
        Ok(layers)
    }

    fn insert_table(
        &mut self,
        prefix: &str,
        table: &Table,
        spans: &DeTable<'_>,
        origin: &dyn Fn(usize) -> Origin,
    ) {
        for (key, span) in spans {
            let Some(value) = table.get(key.get_ref().as_ref()) else { continue };
            let path = if prefix.is_empty() {
                key.get_ref().to_string()
            } else {
                format!("{prefix}.{}", key.get_ref())
            };
            match (value, span.get_ref()) {
                (Value::Table(inner), DeValue::Table(inner_spans)) => {
                    self.insert_table(&path, inner, inner_spans, origin);
                }
                _ => {
                    self.keys.insert(path, (value.clone(), origin(key.span().start)));
                }
            }
        }
    }

    /// Takes the keys of `base` that are missing here.
    pub(super) fn inherit(&mut self, base: Self) {
        for (path, entry) in base.keys {
            self.keys.entry(path).or_insert(entry);
        }
    }

    /// The merged table, nested again.
    pub(super) fn table(&self) -> Table {
        let mut root = Table::new();
        for (path, (value, _)) in &self.keys {
            let mut parts = path.split('.').peekable();
            let mut table = &mut root;
            while let Some(part) = parts.next() {
                if parts.peek().is_none() {
                    table.insert(part.to_owned(), value.clone());
                    break;
                }
                let next = table.entry(part).or_insert_with(|| Value::Table(Table::new()));
                let Value::Table(next) = next else { break };
                table = next;
            }
        }
        root
    }
}

fn syntax(error: &toml::de::Error, text: &str, file: &str) -> Error {
    Error::Syntax {
        file: file.to_owned(),
        line: error.span().map_or(1, |span| line_of(text, span.start)),
        message: error.message().lines().collect::<Vec<_>>().join("; "),
    }
}

/// The line, from 1, in which the byte at `offset` stands.
fn line_of(text: &str, offset: usize) -> usize {
    text.bytes().take(offset).filter(|&b| b == b'\n').count() + 1
}
