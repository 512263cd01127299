//! Replays the kept inputs of the fuzz targets; a file named `valid-…` must be read, one named `broken-…` refused.

use std::path::{Path, PathBuf};

use volcomp_can::{Frame, SignalTable, canopen::telegram};

fn kept(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus");
    let entries = std::fs::read_dir(folder.join(target)).unwrap();
    let paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    assert!(paths.len() >= 3, "{target}");
    let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    paths
        .iter()
        .map(|path| (name(path), std::fs::read(path).unwrap()))
        .collect()
}

#[test]
fn kept_files() {
    for (name, bytes) in kept("dbc") {
        let read = SignalTable::parse(&String::from_utf8_lossy(&bytes));
        assert!(
            read.is_ok() || !name.starts_with("valid-"),
            "{name}: {read:?}"
        );
        assert!(read.is_err() || !name.starts_with("broken-"), "{name}");
    }
}

/// Identifier, two flags and the data, as the fuzz target takes them apart.
#[test]
fn kept_frames() {
    let table = crate::shipped();
    let mut understood = 0;
    for (name, bytes) in kept("can") {
        let (Some(id), Some(data)) = (bytes.first_chunk::<4>(), bytes.get(6..)) else {
            continue;
        };
        let frame = Frame::new(
            u32::from_le_bytes(*id),
            bytes[4] & 1 == 1,
            bytes[5] & 1 == 1,
            data,
        );
        let Some(frame) = frame else { continue };
        let known = telegram(&frame).is_some() || table.message_of(&frame).is_some();
        understood += u32::from(known);
        assert!(known || name.len() == 40, "{name}");
    }
    assert!(understood >= 3);
}
