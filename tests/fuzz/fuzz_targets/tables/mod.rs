//! Invariants of every reader of compensation tables on any text.

use volcomp_tables::axis_table::{AxisNumbers, Format, ReadOptions, TextFile, WriteOptions, curves, read, to_toml, write};
use volcomp_tables::vocabulary::AxisName::{A, C, X, Y, Z};

/// Checks that no step panics: reading any bytes, converting an accepted table to curves, writing it and reading it
/// again.
pub fn keeps(format: Format, bytes: &[u8]) {
    let Ok(text) = core::str::from_utf8(bytes) else {
        return;
    };
    let file = TextFile { name: "X.comp".to_owned(), text: text.to_owned() };
    let axes = AxisNumbers::stated(vec![(X, 1), (Y, 2), (Z, 3), (C, 4), (A, 5)]).unwrap_or_default();
    let options = ReadOptions { axes: axes.clone(), ..ReadOptions::default() };
    let _ = Format::of_files(core::slice::from_ref(&file));
    let Ok(found) = read(format, &[file], &options) else {
        return;
    };
    if let Ok(curves) = curves(&found.content) {
        let _ = to_toml(&curves);
    }
    // The writer may reject a table that was read: one with points that coincide after rounding, or with both encoders.
    let written = write(format, &found.content, &WriteOptions { axes, ..WriteOptions::default() });
    if let Ok(written) = written {
        let _ = read(format, &written.files, &options);
    }
}
