//! What a SQLite file holds, carried over to another database: all of it, or nothing.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::{
    Store, StoreError, audit,
    database::{Database, Row, Value},
    schema,
    sqlite::Sqlite,
};

/// A table that was carried over.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Copied {
    /// Its name.
    pub table: String,
    /// How many rows it has.
    pub rows: u64,
    /// The checksum of its rows, whatever their order.
    pub checksum: String,
}

/// The rows of a table, counted and summed up: the sum of their digests, since two databases give them in different orders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sum {
    rows: u64,
    digests: u128,
}

impl Sum {
    fn add(&mut self, row: &Row) {
        let mut digest = Sha256::new();
        for value in &row.0 {
            match value {
                Value::Null => digest.update([0]),
                Value::Int(value) => {
                    digest.update([1]);
                    digest.update(value.to_be_bytes());
                }
                Value::Real(value) => {
                    digest.update([2]);
                    digest.update(value.to_bits().to_be_bytes());
                }
                Value::Text(value) => {
                    // A text of PostgreSQL cannot hold a zero byte; the same sign stands for it there.
                    let value = value.replace('\0', "\u{fffd}");
                    digest.update([3]);
                    digest.update((value.len() as u64).to_be_bytes());
                    digest.update(value);
                }
            }
        }
        let digest = digest.finalize();
        let mut first = [0; 16];
        first.copy_from_slice(&digest[..16]);
        self.digests = self.digests.wrapping_add(u128::from_be_bytes(first));
        self.rows += 1;
    }
}

/// The tables of a SQLite file that hold something of the centre, each with its columns.
fn tables(file: &mut dyn Database) -> Result<Vec<(String, Vec<String>)>, StoreError> {
    let rows = file.rows(
        "SELECT tables.name, columns.name FROM sqlite_master AS tables, pragma_table_info(tables.name) AS columns
         WHERE tables.type = 'table' AND tables.name <> 'schema' AND tables.name NOT LIKE 'sqlite%'
         ORDER BY tables.name, columns.cid",
        &[],
    )?;
    let mut tables: Vec<(String, Vec<String>)> = Vec::new();
    for row in rows {
        let (table, column) = (row.text(0)?, row.text(1)?.to_owned());
        match tables.last_mut() {
            Some((last, columns)) if last == table => columns.push(column),
            _ => tables.push((table.to_owned(), vec![column])),
        }
    }
    Ok(tables)
}

impl Store {
    /// Carries everything that a SQLite file holds over into this store, which must be empty, in one transaction: every row is
    /// read back and compared before it is committed. The file stays as it is.
    ///
    /// # Errors
    /// The file is not there, is of an older program, or another program has it open; this store holds something; what was read back differs; one
    /// of the databases fails. Nothing is changed then.
    pub fn copy_from(&self, path: &Path, by: &str) -> Result<Vec<Copied>, StoreError> {
        schema::check_newest(&mut Sqlite::open_to_read(path)?, path)?;
        Sqlite::check_alone(path)?;
        let mut file = Sqlite::open_to_read(path)?;
        file.execute("BEGIN DEFERRED", &[])?;
        let copied = self.write(|database| {
            let mut copied = Vec::new();
            for (table, columns) in tables(&mut file)? {
                copied.push(copy(&mut file, database, table, &columns)?);
            }
            let rows: u64 = copied.iter().map(|table| table.rows).sum();
            let details = serde_json::json!({ "rows": rows, "tables": copied });
            let from = path.display().to_string();
            audit::append(database, by, "store.copy", &from, details)?;
            Ok(copied)
        });
        // Nothing was changed in it.
        file.execute("ROLLBACK", &[])?;
        copied
    }
}

/// Carries one table over, and reads it back.
fn copy(
    file: &mut dyn Database,
    database: &mut dyn Database,
    table: String,
    columns: &[String],
) -> Result<Copied, StoreError> {
    let row = database.first(&format!("SELECT count(*) FROM {table}"), &[])?;
    let rows = row.map_or(Ok(0), |row| row.count(0))?;
    if rows > 0 {
        return Err(StoreError::NotEmpty { table, rows });
    }
    let places: Vec<String> = (1..=columns.len())
        .map(|place| format!("?{place}"))
        .collect();
    let columns = columns.join(", ");
    let insert = format!(
        "INSERT INTO {table} ({columns}) VALUES ({})",
        places.join(", ")
    );
    let mut sent = Sum::default();
    file.each(&format!("SELECT {columns} FROM {table}"), &mut |row| {
        sent.add(&row);
        database.execute_later(&insert, row.0)
    })?;
    let arrived = sum(database, &table, &columns)?;
    if sent != arrived {
        return Err(StoreError::Differs {
            table,
            rows: sent.rows,
            found: arrived.rows,
        });
    }
    Ok(told(table, sent))
}

fn sum(database: &mut dyn Database, table: &str, columns: &str) -> Result<Sum, StoreError> {
    let mut sum = Sum::default();
    database.each(&format!("SELECT {columns} FROM {table}"), &mut |row| {
        sum.add(&row);
        Ok(())
    })?;
    Ok(sum)
}

fn told(table: String, sum: Sum) -> Copied {
    Copied {
        table,
        rows: sum.rows,
        checksum: format!("{:032x}", sum.digests),
    }
}
