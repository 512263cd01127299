//! Helpers shared by the tests of several crates. A development dependency only; it is not published.
//!
//! All functions panic with a message about the expectation if it is not met.

#![allow(
    clippy::missing_panics_doc,
    reason = "a test fails by panicking, and all of this is for tests"
)]

#[cfg(feature = "barrier")]
pub mod barrier;
#[cfg(feature = "book")]
pub mod book;
pub mod corpus;
pub mod machines;
#[cfg(feature = "man-pages")]
pub mod man_pages;
#[cfg(feature = "man-pages")]
pub mod options;
pub mod peers;
mod ports;
mod running;
#[cfg(feature = "structured-text")]
pub mod structured_text;
#[cfg(feature = "structures")]
pub mod structures;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

pub use ports::{free_address, free_port};
pub use running::Running;

/// The repository's root folder.
pub fn root() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    root.canonicalize().expect("the repository is there")
}

/// Parses a table of test cases, one row per line, with cells between bars. In a cell `\n` and `\r` denote line ends,
/// and surrounding blanks are ignored.
pub fn cases<const CELLS: usize>(table: &str) -> Vec<[String; CELLS]> {
    let cell = |cell: &str| cell.trim().replace("\\n", "\n").replace("\\r", "\r");
    let rows = table.lines().filter(|row| !row.is_empty());
    rows.map(|row| {
        let cells: Vec<String> = row.split('|').map(cell).collect();
        let count = cells.len();
        let cells = cells.try_into().ok();
        cells.unwrap_or_else(|| panic!("{row}: found {count} cells, expected {CELLS}"))
    })
    .collect()
}

/// The rows of a table of test cases, as for [`cases`], with static lifetime. A line that begins with `//` is a comment.
pub fn rows<const CELLS: usize>(table: &str) -> Vec<[&'static str; CELLS]> {
    let rows = table.lines().filter(|row| !row.starts_with("//"));
    let rows = cases(&rows.collect::<Vec<_>>().join("\n"));
    rows.into_iter().map(|row| row.map(|cell| &*cell.leak())).collect()
}

/// Waits until `holds` returns true; panics with `what` after the timeout `within`.
pub fn until(what: &str, within: Duration, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + within;
    while !holds() {
        assert!(Instant::now() < end, "not within {within:?}: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}
