#![doc = include_str!("../README.md")]
#![expect(clippy::missing_errors_doc, reason = "the variants of `Error` say it")]

pub mod clock;
pub mod command;
pub mod config;
pub mod demo;
pub mod discover;
pub mod engine;
mod error;
pub mod http;
pub mod ingest;
pub mod instance;
pub mod issue;
pub mod keys;
pub mod map;
pub mod models;
pub mod records;
pub mod rollout;
pub mod store;
pub mod users;
pub mod versions;

pub use error::Error;

/// Replaces control characters by spaces. Names and reasons come from the machines, and must neither act on a terminal
/// nor begin a line.
pub(crate) fn one_line(text: &str) -> String {
    text.replace(char::is_control, " ")
}

/// Formats a table: each column as wide as its widest cell, the last one unpadded.
pub(crate) fn columns(rows: &[Vec<String>]) -> String {
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..count).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = (row.iter().zip(&widths))
            .map(|(cell, width)| format!("{:<width$}", one_line(cell)))
            .collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    text
}
