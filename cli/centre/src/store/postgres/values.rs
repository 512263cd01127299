//! Values as PostgreSQL has them.

use std::error::Error;

use bytes::BytesMut;
use tokio_postgres::types::{IsNull, ToSql, Type, to_sql_checked};

use crate::store::database::{Row, Value};

impl ToSql for Value {
    fn to_sql(
        &self,
        ty: &Type,
        out: &mut BytesMut,
    ) -> Result<IsNull, Box<dyn Error + Sync + Send>> {
        let wrong = |what: &str| Err(format!("found {what}, expected a value of {ty}").into());
        match self {
            Self::Null => Ok(IsNull::Yes),
            // Both are eight bytes: the wrong one would be stored as another number.
            Self::Int(value) if *ty == Type::FLOAT8 => (*value as f64).to_sql(ty, out),
            Self::Int(value) if *ty == Type::INT8 => value.to_sql(ty, out),
            Self::Int(_) => wrong("a whole number"),
            Self::Real(value) if *ty == Type::FLOAT8 => value.to_sql(ty, out),
            Self::Real(_) => wrong("a number"),
            Self::Text(_) if *ty == Type::INT8 || *ty == Type::FLOAT8 => wrong("a text"),
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

/// A row of an answer.
pub(super) fn row(found: &tokio_postgres::Row) -> Result<Row, tokio_postgres::Error> {
    let value = |column: usize| -> Result<Value, tokio_postgres::Error> {
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
    let values: Result<Vec<Value>, _> = (0..found.columns().len()).map(value).collect();
    Ok(Row(values?))
}
