//! Replays the kept inputs of the fuzz targets; a file named `valid-…` must be read, one named `broken-…` refused.

use std::path::Path;

use volcomp_metrology::{
    Measurement, MetrologyError, RenishawKind, evaluate, parse_csv, parse_renishaw, write_csv,
    write_renishaw,
};

fn replay(target: &str, read: impl Fn(&[u8], &str) -> Result<Measurement, MetrologyError>) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fuzz/corpus")
        .join(target);
    let files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert!(files.len() >= 5, "{} files for {target}", files.len());
    for path in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let found = read(&std::fs::read(&path).unwrap(), &name);
        assert!(
            !(name.starts_with("valid-") && found.is_err()),
            "{name}: {found:?}"
        );
        assert!(
            !(name.starts_with("broken-") && found.is_ok()),
            "{name}: {found:?}"
        );
        if let Ok(measurement) = found {
            let _ = evaluate(&measurement);
            assert!(!write_renishaw(&measurement).is_empty());
            let again = parse_csv(write_csv(&measurement).as_bytes(), &name).unwrap();
            assert_eq!(again.readings, measurement.readings);
        }
    }
}

#[test]
fn laser_files() {
    replay("renishaw", |bytes, name| {
        let kind = if name.ends_with("rta") {
            RenishawKind::Angular
        } else {
            RenishawKind::Linear
        };
        parse_renishaw(bytes, name, kind)
    });
}

#[test]
fn tables() {
    replay("csv", parse_csv);
}
