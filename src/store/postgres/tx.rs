//! A transaction of PostgreSQL, as the code of all stores sees it.

use super::made;
use super::open::{Clock, told};
use crate::store::sql::{Error, Param, Row, Sql, Value};
use crate::store::{self};
use jiff::Timestamp;
use postgres::types::private::BytesMut;
use postgres::types::{IsNull, ToSql, Type, to_sql_checked};
use postgres::{Config, Statement, Transaction};
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::Path;

/// A transaction that is open; taken back unless it is committed.
pub(super) struct Tx<'a> {
    inner: RefCell<Inner<'a>>,
    place: &'a Path,
    clock: Clock,
    config: &'a Config,
}

struct Inner<'a> {
    transaction: Transaction<'a>,
    statements: &'a mut HashMap<&'static str, Statement>,
}

impl<'a> Tx<'a> {
    pub(super) const fn of(
        transaction: Transaction<'a>,
        statements: &'a mut HashMap<&'static str, Statement>,
        place: &'a Path,
        clock: Clock,
        config: &'a Config,
    ) -> Self {
        Self { inner: RefCell::new(Inner { transaction, statements }), place, clock, config }
    }

    /// Keeps what was done.
    pub(super) fn commit(self) -> Result<(), store::Error> {
        self.inner.into_inner().transaction.commit().map_err(|e| told(self.place, &e))
    }

    fn told(&self, error: &postgres::Error) -> Error {
        Error::Store(told(self.place, error))
    }
}

impl Inner<'_> {
    /// The statement, made ready once for each connection.
    fn ready(&mut self, sql: &'static str) -> Result<Statement, postgres::Error> {
        if let Some(known) = self.statements.get(sql) {
            return Ok(known.clone());
        }
        let statement = self.transaction.prepare(&sql.replace('?', "$"))?;
        self.statements.insert(sql, statement.clone());
        Ok(statement)
    }

    fn rows(&mut self, sql: &'static str, params: &[Param<'_>]) -> Result<Vec<Row>, postgres::Error> {
        let statement = self.ready(sql)?;
        let params: Vec<&(dyn ToSql + Sync)> = params.iter().map(|p| p as &(dyn ToSql + Sync)).collect();
        self.transaction.query(&statement, &params)?.iter().map(row).collect()
    }

    fn run(&mut self, sql: &'static str, params: &[Param<'_>]) -> Result<u64, postgres::Error> {
        let statement = self.ready(sql)?;
        let params: Vec<&(dyn ToSql + Sync)> = params.iter().map(|p| p as &(dyn ToSql + Sync)).collect();
        self.transaction.execute(&statement, &params)
    }
}

impl Sql for Tx<'_> {
    fn rows(&self, sql: &'static str, params: &[Param<'_>]) -> Result<Vec<Row>, Error> {
        self.inner.borrow_mut().rows(sql, params).map_err(|e| self.told(&e))
    }

    fn run(&self, sql: &'static str, params: &[Param<'_>]) -> Result<u64, Error> {
        self.inner.borrow_mut().run(sql, params).map_err(|e| self.told(&e))
    }

    fn now(&self, callers: Timestamp) -> Result<Timestamp, Error> {
        if self.clock != Clock::Server {
            return Ok(callers);
        }
        let sql = "SELECT (extract(epoch FROM clock_timestamp()) * 1000)::bigint";
        let ms = self.row(sql, &[])?.ok_or_else(|| Error::Row("found no time".into()))?.int(0)?;
        Timestamp::from_millisecond(ms).map_err(|e| Error::Row(e.to_string()))
    }

    fn check_made(&self) -> Result<(), Error> {
        let (found, expected) = made::found_and_expected(self.config).map_err(|e| self.told(&e))?;
        let differs =
            found.iter().find(|it| !expected.contains(it)).or(expected.iter().find(|it| !found.contains(it)));
        differs.map_or(Ok(()), |(name, _)| Err(Error::Row(format!("{name} is not as it was made"))))
    }
}

impl ToSql for Param<'_> {
    fn to_sql(
        &self,
        ty: &Type,
        out: &mut BytesMut,
    ) -> Result<IsNull, Box<dyn std::error::Error + Sync + Send>> {
        match *self {
            Self::Null => Ok(IsNull::Yes),
            Self::Int(number) => number.to_sql(ty, out),
            Self::Text(text) => text.to_sql(ty, out),
            Self::Bytes(bytes) => bytes.to_sql(ty, out),
        }
    }

    fn accepts(ty: &Type) -> bool {
        [Type::INT8, Type::TEXT, Type::BYTEA].contains(ty)
    }

    to_sql_checked!();
}

fn row(found: &postgres::Row) -> Result<Row, postgres::Error> {
    let value = |(idx, column): (usize, &postgres::Column)| {
        Ok(match *column.type_() {
            Type::INT8 => found.try_get::<_, Option<i64>>(idx)?.map_or(Value::Null, Value::Int),
            Type::BYTEA => found.try_get::<_, Option<Vec<u8>>>(idx)?.map_or(Value::Null, Value::Bytes),
            _ => found.try_get::<_, Option<String>>(idx)?.map_or(Value::Null, Value::Text),
        })
    };
    found.columns().iter().enumerate().map(value).collect::<Result<_, _>>().map(Row)
}
