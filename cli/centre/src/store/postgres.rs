//! PostgreSQL: a database that several centres of a company may share with other programs.

use std::{collections::HashMap, error::Error};

use bytes::BytesMut;
use postgres::{
    Client, NoTls, Statement,
    types::{IsNull, ToSql, Type, to_sql_checked},
};

use super::{
    StoreError,
    database::{Database, Row, Value},
};

/// A connection to a server.
pub(crate) struct Postgres {
    client: Client,
    place: String,
    ready: HashMap<String, Statement>,
    in_transaction: bool,
}

/// What a transaction locks first, so that one program writes at a time, as with SQLite: numbers are drawn from what is there.
const BEGIN: &str = "BEGIN; SELECT pg_advisory_xact_lock(7240114893225402369)";

impl Postgres {
    /// Connects: `host=… user=… dbname=…`.
    pub(crate) fn open(place: &str) -> Result<Self, StoreError> {
        Ok(Self {
            client: Client::connect(place, NoTls)?,
            place: place.to_owned(),
            ready: HashMap::new(),
            in_transaction: false,
        })
    }

    /// A connection that was lost is made anew, but not within a transaction, which is lost with it.
    fn connected(&mut self) -> Result<(), StoreError> {
        if self.client.is_closed() && !self.in_transaction {
            *self = Self::open(&self.place)?;
        }
        Ok(())
    }

    fn ready(&mut self, sql: &str) -> Result<Statement, StoreError> {
        if let Some(statement) = self.ready.get(sql) {
            return Ok(statement.clone());
        }
        let statement = self.client.prepare(&translated(sql))?;
        self.ready.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }
}

/// `?1` is `$1` here. No text of ours has a question mark in it.
fn translated(sql: &str) -> String {
    sql.replace('?', "$")
}

impl ToSql for Value {
    fn to_sql(
        &self,
        ty: &Type,
        out: &mut BytesMut,
    ) -> Result<IsNull, Box<dyn Error + Sync + Send>> {
        match self {
            Self::Null => Ok(IsNull::Yes),
            // Both are eight bytes: the wrong one would be stored as another number.
            Self::Int(value) if *ty == Type::FLOAT8 => (*value as f64).to_sql(ty, out),
            Self::Real(_) if *ty != Type::FLOAT8 => {
                Err("a number where a whole number stands".into())
            }
            Self::Int(_) if *ty != Type::INT8 => Err("a whole number where a text stands".into()),
            Self::Text(_) if *ty == Type::INT8 || *ty == Type::FLOAT8 => {
                Err("a text where a number stands".into())
            }
            Self::Int(value) => value.to_sql(ty, out),
            Self::Real(value) => value.to_sql(ty, out),
            // A text of PostgreSQL cannot hold a zero byte.
            Self::Text(value) if value.contains('\0') => {
                value.replace('\0', "\u{fffd}").to_sql(ty, out)
            }
            Self::Text(value) => value.to_sql(ty, out),
        }
    }

    fn accepts(ty: &Type) -> bool {
        matches!(*ty, Type::INT8 | Type::FLOAT8 | Type::TEXT | Type::VARCHAR)
    }

    to_sql_checked!();
}

impl Database for Postgres {
    fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError> {
        match sql {
            "BEGIN" => {
                self.connected()?;
                self.client.batch_execute(BEGIN)?;
                self.in_transaction = true;
                return Ok(0);
            }
            "COMMIT" | "ROLLBACK" => {
                self.in_transaction = false;
                self.client.batch_execute(sql)?;
                return Ok(0);
            }
            _ => {}
        }
        let statement = self.ready(sql)?;
        let parameters: Vec<&(dyn ToSql + Sync)> = parameters
            .iter()
            .map(|one| one as &(dyn ToSql + Sync))
            .collect();
        Ok(self.client.execute(&statement, &parameters)?)
    }

    fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError> {
        self.connected()?;
        let statement = self.ready(sql)?;
        let parameters: Vec<&(dyn ToSql + Sync)> = parameters
            .iter()
            .map(|one| one as &(dyn ToSql + Sync))
            .collect();
        let rows = self.client.query(&statement, &parameters)?;
        rows.iter().map(row).collect()
    }
}

fn row(found: &postgres::Row) -> Result<Row, StoreError> {
    let value = |column: usize| -> Result<Value, StoreError> {
        Ok(match *found.columns()[column].type_() {
            Type::INT8 => found.try_get::<_, Option<i64>>(column)?.into(),
            Type::INT4 => {
                let value: Option<i32> = found.try_get(column)?;
                value.map(i64::from).into()
            }
            Type::FLOAT8 => found.try_get::<_, Option<f64>>(column)?.into(),
            _ => found.try_get::<_, Option<String>>(column)?.into(),
        })
    };
    let values: Result<Vec<Value>, StoreError> = (0..found.columns().len()).map(value).collect();
    Ok(Row(values?))
}
