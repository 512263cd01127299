//! Replays the stored fuzz inputs: a file named `valid-…` must parse, a file named `broken-…` must be rejected.

use std::path::Path;

use volcomp_document::Document;
use volcomp_metrology::{
    Mapping, Measurement, MetrologyError, RenishawKind,
    circular::{CircularPlane, circular_deviations, circular_signatures, parse_trace},
    evaluate, parse_camonitor, parse_csv, parse_keysight_report, parse_pos, parse_ren,
    parse_renishaw, parse_rtx, parse_table_with, readings_at_dwells, write_csv, write_renishaw,
};

fn replay(target: &str, read: impl Fn(&[u8], &str) -> Result<Measurement, MetrologyError>) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus").join(target);
    let files: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(files.len() >= 5, "{} files for {target}", files.len());
    for path in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let found = read(&std::fs::read(&path).unwrap(), &name);
        assert!(!(name.starts_with("valid-") && found.is_err()), "{name}: {found:?}");
        assert!(!(name.starts_with("broken-") && found.is_ok()), "{name}: {found:?}");
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
        } else if name.ends_with("rts") {
            RenishawKind::Straightness
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

#[test]
fn reports() {
    replay("reports", |bytes, name| {
        if name.ends_with("pos") {
            parse_pos(bytes, name)
        } else if name.ends_with("ren") {
            parse_ren(bytes, name)
        } else {
            parse_keysight_report(bytes, name)
        }
    });
}

/// In an accepted circle each point has a finite deviation, and the evaluation does not panic.
#[test]
fn circles() {
    replay("circle", |bytes, name| {
        let trace = parse_trace(bytes, name, CircularPlane::Xy, Some(150.0))?;
        assert!(trace.points.iter().all(|p| p.deviation_um.is_finite()));
        let _ = (circular_deviations(&trace), circular_signatures(&trace));
        parse_csv(b"target,deviation\n0,0\n", name)
    });
}

/// In an accepted capture each sample is finite.
#[test]
fn captures() {
    replay("capture", |bytes, name| {
        let capture = parse_rtx(bytes, name)?;
        assert!(capture.samples.iter().all(|sample| sample.is_finite()));
        parse_csv(b"target,deviation\n0,0\n", name)
    });
}

#[test]
fn tables_and_logs_with_their_mapping() {
    replay("mapped", |bytes, name| {
        let text = String::from_utf8_lossy(bytes);
        let (toml, rows) = text.split_once("===\n").unwrap_or(("", &text));
        let document = Document::new(name, toml);
        match document.decode(|root| Mapping::decode(&root))? {
            Some(Mapping::Columns(columns)) => parse_table_with(rows.as_bytes(), name, &columns),
            Some(Mapping::Channels(channels)) => {
                readings_at_dwells(&parse_camonitor(rows.as_bytes(), name)?, &channels)
            }
            None => panic!("{name}: no mapping"),
        }
    });
}
