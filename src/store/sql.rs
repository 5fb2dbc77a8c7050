//! What a queue in tables is asked, in the SQL that SQLite and PostgreSQL both understand; each request within one transaction.
//!
//! Both stores decide, write and find in the same way because it is the same code. A store brings its connection as [`Sql`], and sees
//! to it that no other transaction writes at the same time: the history is one chain, so that writers follow each other anyway.

mod check;
mod rows;
mod work;

pub(super) use check::part;
pub(super) use rows::Error;
pub(super) use rows::{claim, head, job, last, spec};
pub(super) use work::{add, adopt, change, claim as take, history, list, place, printers, renew, say, sweep};

use jiff::Timestamp;

/// A transaction.
pub trait Sql {
    /// The rows of a query. Parameters are `?1`, `?2`, ... in the text.
    ///
    /// # Errors
    /// [`Error::Store`].
    fn rows(&self, sql: &'static str, params: &[Param<'_>]) -> Result<Vec<Row>, Error>;

    /// Rows that a statement changed.
    ///
    /// # Errors
    /// [`Error::Store`].
    fn run(&self, sql: &'static str, params: &[Param<'_>]) -> Result<u64, Error>;

    /// The time that counts: the caller's, or that of a database that several machines share.
    ///
    /// # Errors
    /// [`Error::Store`].
    fn now(&self, callers: Timestamp) -> Result<Timestamp, Error> {
        Ok(callers)
    }

    /// That tables, indices and triggers are those that were made.
    ///
    /// # Errors
    /// [`Error::Row`] that names the one which is not.
    fn check_made(&self) -> Result<(), Error>;

    /// The only row of a query, or its first one.
    ///
    /// # Errors
    /// As [`Sql::rows`].
    fn row(&self, sql: &'static str, params: &[Param<'_>]) -> Result<Option<Row>, Error> {
        Ok(self.rows(sql, params)?.into_iter().next())
    }
}

/// What a statement is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Param<'a> {
    /// Nothing.
    Null,
    /// A whole number.
    Int(i64),
    /// A text.
    Text(&'a str),
    /// Bytes.
    Bytes(&'a [u8]),
}

impl From<i64> for Param<'_> {
    fn from(number: i64) -> Self {
        Self::Int(number)
    }
}

impl<'a> From<&'a str> for Param<'a> {
    fn from(text: &'a str) -> Self {
        Self::Text(text)
    }
}

impl<'a> From<&'a String> for Param<'a> {
    fn from(text: &'a String) -> Self {
        Self::Text(text)
    }
}

impl<'a> From<&'a [u8]> for Param<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self::Bytes(bytes)
    }
}

impl<'a, T: Into<Self>> From<Option<T>> for Param<'a> {
    fn from(value: Option<T>) -> Self {
        value.map_or(Param::Null, Into::into)
    }
}

/// What a column holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Value {
    /// Nothing.
    Null,
    /// A whole number.
    Int(i64),
    /// A text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
}

/// A row: its columns, from which each is taken once.
#[derive(Debug, PartialEq, Eq)]
pub struct Row(pub(super) Vec<Value>);

impl Row {
    fn take(&mut self, column: usize) -> Result<Value, Error> {
        let value = self.0.get_mut(column).map(|value| std::mem::replace(value, Value::Null));
        value.ok_or_else(|| Error::Row(format!("found no column {column}")))
    }

    /// A whole number.
    pub(super) fn int(&mut self, column: usize) -> Result<i64, Error> {
        match self.take(column)? {
            Value::Int(number) => Ok(number),
            other => Err(Error::Row(format!("found {other:?}, expected a number"))),
        }
    }

    /// A whole number, or nothing.
    pub(super) fn maybe_int(&mut self, column: usize) -> Result<Option<i64>, Error> {
        match self.take(column)? {
            Value::Null => Ok(None),
            Value::Int(number) => Ok(Some(number)),
            other => Err(Error::Row(format!("found {other:?}, expected a number"))),
        }
    }

    /// A text.
    pub(super) fn text(&mut self, column: usize) -> Result<String, Error> {
        let found = self.maybe_text(column)?;
        found.ok_or_else(|| Error::Row("found nothing, expected a text".into()))
    }

    /// A text, or nothing.
    pub(super) fn maybe_text(&mut self, column: usize) -> Result<Option<String>, Error> {
        match self.take(column)? {
            Value::Null => Ok(None),
            Value::Text(text) => Ok(Some(text)),
            other => Err(Error::Row(format!("found {other:?}, expected a text"))),
        }
    }

    /// Bytes.
    pub(super) fn bytes(&mut self, column: usize) -> Result<Vec<u8>, Error> {
        match self.take(column)? {
            Value::Bytes(bytes) => Ok(bytes),
            other => Err(Error::Row(format!("found {other:?}, expected bytes"))),
        }
    }
}
