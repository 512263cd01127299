//! Tests of readers with arbitrary and damaged bytes and with the stored fuzz inputs, and round trips of written files.

use std::fmt::Write as _;
use std::path::Path;

use proptest::prelude::*;
use volcomp_document::Document;
use volcomp_metrology::circular::{
    CircularPlane, circular_deviations, circular_signatures, parse_trace,
};
use volcomp_metrology::{
    DeviationUnit, Environment, FileFormat, Mapping, Measurement, Metadata, MetrologyError,
    MotionKind, Quantity, Reading, ReferenceLine, RenishawKind, StartEnd, TiltReading,
    angular_method_um, evaluate, outlier_hints, parse_camonitor, parse_csv, parse_keysight_report,
    parse_pos, parse_ren, parse_renishaw, parse_rtx, parse_table_with, readings_at_dwells,
    squareness, write_csv, write_renishaw,
};
use volcomp_vocabulary::{AxisName, Component, Direction, ErrorName, Urad};

use crate::samples::BIDIRECTIONAL_RTL;

const TABLE: &str =
    "target,run,direction,deviation\n-10,1,+,1.25\n5,1,+,2.5\n5,1,-,0.5\n-10,1,-,3\n";

/// Reads the bytes in each format. A measurement that is accepted must be valid and survive a round trip in its format.
fn exercise(bytes: &[u8]) {
    let read = [
        parse_renishaw(bytes, "x", RenishawKind::Linear),
        parse_renishaw(bytes, "x", RenishawKind::Angular),
        parse_renishaw(bytes, "x", RenishawKind::Straightness),
        parse_pos(bytes, "x"),
        parse_ren(bytes, "x"),
        parse_keysight_report(bytes, "x"),
        parse_csv(bytes, "x"),
    ];
    let _ = parse_rtx(bytes, "x");
    let _ = parse_camonitor(bytes, "x");
    for m in read.into_iter().flatten() {
        assert!(!m.readings.is_empty());
        assert!(m.readings.iter().all(|r| r.target.is_finite() && r.deviation.is_finite()));
        let again = parse_csv(write_csv(&m).as_bytes(), "x").unwrap();
        assert_eq!(again.readings, m.readings);
        let _ = evaluate(&m);
        let _ = write_renishaw(&m);
    }
}

#[derive(Debug, Clone)]
enum Damage {
    Replace(usize, u8),
    Remove(usize, usize),
    Insert(usize, Vec<u8>),
    Repeat(usize, usize),
}

fn damage() -> impl Strategy<Value = Damage> {
    let tokens = prop::sample::select(vec![
        "nan",
        "-inf",
        "1e999",
        "::",
        "\r\n",
        "\n",
        " ",
        "-",
        ",",
        "\"",
        "999999999999",
        "EOF::",
        "Flags: 0 1 2 0",
    ]);
    let text = prop_oneof![
        tokens.prop_map(|t| t.as_bytes().to_vec()),
        prop::collection::vec(any::<u8>(), 1..4)
    ];
    prop_oneof![
        (any::<usize>(), any::<u8>()).prop_map(|(at, byte)| Damage::Replace(at, byte)),
        (any::<usize>(), 1..40_usize).prop_map(|(at, n)| Damage::Remove(at, n)),
        (any::<usize>(), text).prop_map(|(at, text)| Damage::Insert(at, text)),
        (any::<usize>(), 1..60_usize).prop_map(|(at, n)| Damage::Repeat(at, n)),
    ]
}

fn damaged(text: &str, damages: &[Damage]) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    for damage in damages {
        let length = bytes.len().max(1);
        match damage {
            Damage::Replace(at, byte) => {
                if let Some(b) = bytes.get_mut(at % length) {
                    *b = *byte;
                }
            }
            Damage::Remove(at, n) => {
                let (from, to) =
                    ((at % length).min(bytes.len()), (at % length + n).min(bytes.len()));
                bytes.drain(from..to);
            }
            Damage::Insert(at, text) => {
                let at = (at % length).min(bytes.len());
                bytes.splice(at..at, text.iter().copied());
            }
            Damage::Repeat(at, n) => {
                let (from, to) =
                    ((at % length).min(bytes.len()), (at % length + n).min(bytes.len()));
                let piece = bytes[from..to].to_vec();
                bytes.splice(to..to, piece);
            }
        }
    }
    bytes
}

fn text() -> impl Strategy<Value = Option<String>> {
    prop::option::of("[A-Za-z0-9üµ床][A-Za-z0-9 üµ床:.-]{0,12}[A-Za-z0-9床]")
}

prop_compose! {
    fn metadata(kind: &'static str)(
        owner in text(), version in text(), machine in text(), serial in text(), date in text(),
        by in text(), axis in text(), location in text(), title in text(),
    ) -> Metadata {
        let format = Some(kind.to_owned());
        Metadata { format, owner, version, machine, serial, date, by, axis, location, title }
    }
}

fn start_end() -> impl Strategy<Value = Option<StartEnd>> {
    let value = || (0..40_000_000_i64).prop_map(|k| k as f64 / 1e6);
    let range = (value(), value(), prop::option::of(0..9_i64));
    prop::option::of(range.prop_map(|(start, end, unit_code)| StartEnd { start, end, unit_code }))
}

prop_compose! {
    fn environment()(
        air_temperature in start_end(), air_pressure in start_end(), air_humidity in start_end(),
        material_temperature in [start_end(), start_end(), start_end()],
        expansion_coefficient in start_end(), environment_factor in start_end(), date_time in text(),
    ) -> Environment {
        Environment {
            air_temperature, air_pressure, air_humidity, material_temperature,
            expansion_coefficient, environment_factor, date_time,
        }
    }
}

/// Measurements of complete runs in the order of travel. Targets are multiples of 1e-6 mm; deviations are multiples of
/// 1e-6 µm or µrad and not 0.
fn measurement(unit: DeviationUnit, kind: &'static str) -> impl Strategy<Value = Measurement> {
    let targets = prop::collection::btree_set(-9_000_000_000..9_000_000_000_i64, 2..13);
    let deviations = prop::collection::vec(1..900_000_000_i64, 12 * 8);
    let directions = prop::sample::select(vec![
        vec![Direction::Positive],
        vec![Direction::Negative],
        vec![Direction::Positive, Direction::Negative],
    ]);
    (targets, deviations, directions, 1..5_u32, metadata(kind), environment()).prop_map(
        move |(targets, deviations, directions, runs, metadata, environment)| {
            let mut deviation = deviations.into_iter().map(|k| (k - 450_000_001) as f64 / 1e6);
            let mut readings = Vec::new();
            for run in 1..=runs {
                for &direction in &directions {
                    let mut in_order: Vec<f64> = targets.iter().map(|k| *k as f64 / 1e6).collect();
                    if direction == Direction::Negative {
                        in_order.reverse();
                    }
                    readings.extend(in_order.into_iter().map(|target| {
                        let deviation = deviation.next().unwrap();
                        Reading { target, run, direction, deviation }
                    }));
                }
            }
            let (name, unit, notes) = ("x".to_owned(), Some(unit), Vec::new());
            let (format, quantity) = match kind {
                "rtl" => (FileFormat::RenishawLinear, Quantity::Positioning),
                "rts" => (FileFormat::RenishawStraightness, Quantity::Straightness),
                _ => (FileFormat::RenishawAngular, Quantity::Angle),
            };
            Measurement {
                name,
                format: Some(format),
                quantity: Some(quantity),
                unit,
                stated: None,
                target_unit: None,
                readings,
                metadata,
                environment,
                notes,
            }
        },
    )
}

/// Reads a written text again, and drops the notes of the reader.
fn read_again(text: &str, kind: RenishawKind) -> Measurement {
    let mut read = parse_renishaw(text.as_bytes(), "x", kind).unwrap();
    read.notes.clear();
    read
}

/// Implausible readings: arbitrary numbers and runs, few different targets.
fn odd_readings() -> impl Strategy<Value = Vec<Reading>> {
    let target = prop_oneof![any::<f64>(), (0..4).prop_map(f64::from), Just(f64::NAN)];
    let direction = prop::sample::select(Direction::BOTH.to_vec());
    let reading = (target, any::<u32>(), direction, any::<f64>());
    let reading = reading.prop_map(|(target, run, direction, deviation)| Reading {
        target,
        run: run % 5,
        direction,
        deviation,
    });
    prop::collection::vec(reading, 0..30)
}

proptest! {
    /// For any measurement, public functions return a result or an error.
    #[test]
    fn odd_measurements_built_in_code_do_not_panic(readings in odd_readings(), at in any::<f64>()) {
        let m = Measurement { readings, ..Measurement::default() };
        let _ = (evaluate(&m), outlier_hints(&m), write_csv(&m), write_renishaw(&m));
        let _ = (m.targets(), m.mean_curve(), m.mean_at(at, Direction::Positive));
        let points = m.mean_curve_in(Direction::Positive);
        let line = ReferenceLine::least_squares(&points).or_else(|_| ReferenceLine::end_points(&points));
        let _ = line.map(|line| line.removed_from(&points));
        for component in Component::ALL {
            for axis in AxisName::ALL {
                let error = ErrorName::motion(component, axis);
                let _ = angular_method_um(error, TiltReading::RightHand, &points, at);
                let square = ErrorName::location(component, axis);
                let _ = squareness(square, Urad(at), [(error, Urad(at)); 2]);
                let _ = MotionKind::of(error);
            }
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        exercise(&bytes);
    }

    #[test]
    fn damaged_laser_files_never_panic(damages in prop::collection::vec(damage(), 1..5)) {
        exercise(&damaged(BIDIRECTIONAL_RTL, &damages));
    }

    #[test]
    fn damaged_tables_never_panic(damages in prop::collection::vec(damage(), 1..4)) {
        exercise(&damaged(TABLE, &damages));
    }

    #[test]
    fn damaged_reports_never_panic(damages in prop::collection::vec(damage(), 1..4), which in 0..3_usize) {
        use crate::lasers::{POS, REN, REPORT};
        exercise(&damaged([POS, REN, REPORT][which], &damages));
    }

    #[test]
    fn damaged_logs_never_panic(damages in prop::collection::vec(damage(), 1..4)) {
        exercise(&damaged(&crate::mapped::log(), &damages));
    }

    #[test]
    fn linear_files_read_back_as_written(m in measurement(DeviationUnit::Um, "rtl")) {
        let text = write_renishaw(&m);
        prop_assert!(text.lines().count() == text.matches("\r\n").count());
        prop_assert_eq!(read_again(&text, RenishawKind::Linear), m);
    }

    #[test]
    fn straightness_files_read_back_as_written(m in measurement(DeviationUnit::Um, "rts")) {
        prop_assert_eq!(read_again(&write_renishaw(&m), RenishawKind::Straightness), m);
    }

    #[test]
    fn angular_files_read_back_to_a_millionth(m in measurement(DeviationUnit::Urad, "rta")) {
        let mut again = read_again(&write_renishaw(&m), RenishawKind::Angular);
        for (found, expected) in again.readings.iter_mut().zip(&m.readings) {
            prop_assert!((found.deviation - expected.deviation).abs() < 6e-7);
            found.deviation = expected.deviation;
        }
        prop_assert_eq!(again, m);
    }

    #[test]
    fn tables_read_back_as_written(m in measurement(DeviationUnit::Um, "rtl")) {
        let again = parse_csv(write_csv(&m).as_bytes(), "x").unwrap();
        prop_assert_eq!(again.readings, m.readings);
        prop_assert_eq!(again.notes, Vec::<String>::new());
    }
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        3 => -1e3..1e3_f64,
        1 => prop::num::f64::ANY,
        1 => prop::sample::select(vec![0.0, -0.0, f64::NAN, f64::INFINITY, 1e12, -1e300]),
    ]
}

proptest! {
    #[test]
    fn evaluations_of_arbitrary_readings_never_panic(
        rows in prop::collection::vec((any_number(), 0..4_u32, any::<bool>(), any_number()), 0..40),
        numbers in prop::collection::vec(any_number(), 8),
        edges in prop::array::uniform3(any_number()),
        tolerance in "[A-Ea-e_=,0-9.\\-]{0,20}",
    ) {
        use volcomp_metrology::{
            DIAGONAL_NAMES, Diagonal, Edition, UncertaintyInputs, asme_b5_54, axis_kind, decide,
            evaluate_diagonals, parse_tolerances, positioning_uncertainty, shortfalls,
            straightness_of, vdi_3441,
        };
        let direction = |up| if up { Direction::Positive } else { Direction::Negative };
        let readings = rows.iter().map(|&(target, run, up, deviation)| Reading {
            target, run, direction: direction(up), deviation,
        });
        let m = Measurement { readings: readings.collect(), ..Measurement::default() };
        if let Ok(result) = evaluate(&m) {
            let _ = (vdi_3441(&result), asme_b5_54(&result), Edition::Iso2006.quantities(&result));
        }
        for kind in [volcomp_vocabulary::AxisKind::Linear, volcomp_vocabulary::AxisKind::Rotary] {
            let _ = shortfalls(&m, kind, Edition::Iso2014);
        }
        let _ = (axis_kind(&m), straightness_of(&m));
        let diagonals = DIAGONAL_NAMES.map(|name| (Diagonal::named(name).unwrap(), &m));
        let _ = evaluate_diagonals(&diagonals[..4], Some(edges));
        let _ = evaluate_diagonals(&diagonals[..1], None);
        let inputs = UncertaintyInputs {
            device_um_per_m: Some(numbers[0]),
            device_um: Some(numbers[1]),
            misalignment_mm: Some(numbers[2]),
            temperature_range_k: Some(numbers[3]),
            expansion_um_per_m_k: Some(numbers[4]),
            expansion_range_um_per_m_k: Some(numbers[5]),
            from_20_degc_k: Some(numbers[6]),
            environment_um: Some(numbers[7]),
        };
        let _ = positioning_uncertainty(&inputs, edges[0], rows.len());
        let _ = (decide(Some(numbers[0]), numbers[1], Some(numbers[2])), parse_tolerances(&tolerance, &["A", "E"]));
    }

    #[test]
    fn circles_of_arbitrary_points_never_panic(
        rows in prop::collection::vec((-1e4..1e4_f64, -1e4..1e4_f64), 0..60),
        head in prop::sample::select(vec!["angle,deviation", "x,y", "angle rad,radius deviation mm", "x,angle"]),
        radius in prop::option::of(any_number()),
        bytes in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        use volcomp_metrology::circular::{CircularPlane, circular_deviations, circular_signatures, parse_trace};
        let mut text = format!("{head}\n");
        for (a, b) in rows {
            writeln!(text, "{a},{b}").unwrap();
        }
        for bytes in [text.as_bytes(), &bytes] {
            if let Ok(trace) = parse_trace(bytes, "c", CircularPlane::Xy, radius) {
                prop_assert!(trace.points.iter().all(|p| p.deviation_um.is_finite()));
                let _ = circular_deviations(&trace);
                let _ = circular_signatures(&trace);
            }
        }
    }
}

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
