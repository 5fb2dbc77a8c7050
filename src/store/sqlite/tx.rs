//! A transaction of SQLite, as the code of all stores sees it.

use super::open::{STEPS, told};
use crate::store::sql::{Error, Param, Row, Sql, Value};
use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{Connection, Rows, ToSql, params_from_iter};
use std::path::Path;

/// A transaction that is open.
#[derive(Debug)]
pub(super) struct Tx<'a> {
    connection: &'a Connection,
    path: &'a Path,
}

impl<'a> Tx<'a> {
    pub(super) const fn of(connection: &'a Connection, path: &'a Path) -> Self {
        Self { connection, path }
    }

    fn told(&self, error: &rusqlite::Error) -> Error {
        Error::Store(told(self.path, error))
    }
}

impl Sql for Tx<'_> {
    fn rows(&self, sql: &'static str, params: &[Param<'_>]) -> Result<Vec<Row>, Error> {
        let found = self.connection.prepare_cached(sql).and_then(|mut select| {
            let n_columns = select.column_count();
            collected(select.query(params_from_iter(params))?, n_columns)
        });
        found.map_err(|e| self.told(&e))
    }

    fn run(&self, sql: &'static str, params: &[Param<'_>]) -> Result<u64, Error> {
        let done = self
            .connection
            .prepare_cached(sql)
            .and_then(|mut statement| statement.execute(params_from_iter(params)));
        done.map(|n_changed| n_changed as u64).map_err(|e| self.told(&e))
    }

    fn check_made(&self) -> Result<(), Error> {
        let schemas = schema(self.connection).and_then(|found| Ok((found, schema(&as_made()?)?)));
        let (found, expected) = schemas.map_err(|e| self.told(&e))?;
        let differs =
            found.iter().find(|it| !expected.contains(it)).or(expected.iter().find(|it| !found.contains(it)));
        differs.map_or(Ok(()), |(name, _)| Err(Error::Row(format!("{name} is not as it was made"))))
    }
}

impl ToSql for Param<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match *self {
            Self::Null => ValueRef::Null,
            Self::Int(number) => ValueRef::Integer(number),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
            Self::Bytes(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

fn collected(mut found: Rows<'_>, n_columns: usize) -> rusqlite::Result<Vec<Row>> {
    let mut rows = Vec::new();
    while let Some(row) = found.next()? {
        rows.push(Row((0..n_columns).map(|column| value(row.get_ref(column)?)).collect::<Result<_, _>>()?));
    }
    Ok(rows)
}

fn value(found: ValueRef<'_>) -> rusqlite::Result<Value> {
    Ok(match found {
        ValueRef::Null => Value::Null,
        ValueRef::Integer(number) => Value::Int(number),
        ValueRef::Text(_) => Value::Text(found.as_str()?.to_owned()),
        ValueRef::Blob(bytes) => Value::Bytes(bytes.to_owned()),
        // No column of ours holds any: what is not expected is told where it is read.
        ValueRef::Real(number) => Value::Text(number.to_string()),
    })
}

fn as_made() -> rusqlite::Result<Connection> {
    let db = Connection::open_in_memory()?;
    for step in STEPS {
        db.execute_batch(step)?;
    }
    Ok(db)
}

/// Names and definitions, but for SQLite's own.
fn schema(db: &Connection) -> rusqlite::Result<Vec<(String, String)>> {
    let sql = "SELECT type || ' ' || name, sql FROM sqlite_schema WHERE name NOT LIKE 'sqlite_%' ORDER BY 1";
    db.prepare(sql)?.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
}
