use volcomp_metrology::{
    DeviationUnit, Measurement, MetrologyError, RenishawKind, StartEnd, parse_renishaw,
    write_renishaw,
};
use volcomp_vocabulary::Direction;

use crate::samples::{BIDIRECTIONAL_RTL, rtl_with};

fn rtl(text: &str) -> Result<Measurement, MetrologyError> {
    parse_renishaw(text.as_bytes(), "x.rtl", RenishawKind::Linear)
}

fn readings(m: &Measurement) -> Vec<(f64, u32, char, f64)> {
    let sign = |d| if d == Direction::Positive { '+' } else { '-' };
    m.readings.iter().map(|r| (r.target, r.run, sign(r.direction), r.deviation)).collect()
}

#[test]
fn readings_follow_target_numbers_and_directions_the_order_of_travel() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    assert_eq!(
        readings(&m),
        [
            (-100.0, 1, '+', 1.0),
            (0.0, 1, '+', 2.5),
            (250.5, 1, '+', -3.0),
            (250.5, 1, '-', -2.0),
            (0.0, 1, '-', 3.5),
            (-100.0, 1, '-', 4.0),
            (-100.0, 2, '+', 1.2),
            (0.0, 2, '+', 2.7),
            (250.5, 2, '+', -2.8),
            (250.5, 2, '-', -1.8),
            (0.0, 2, '-', 3.7),
            (-100.0, 2, '-', 4.2),
        ]
    );
    assert_eq!(m.notes, [""; 0]);
    assert_eq!(m.targets(), [-100.0, 0.0, 250.5]);
    assert_eq!(m.runs(Direction::Negative), [1, 2]);
    assert!((m.mean_at(-100.0, Direction::Negative).unwrap() - 4.1).abs() < 1e-12);
    let (target, mean) = m.mean_curve()[1];
    assert!(target == 0.0 && (mean - 3.1).abs() < 1e-12, "{mean}");
}

#[test]
fn header_texts_and_environment_are_kept() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(m.metadata.format.as_deref(), Some("rtl"));
    assert_eq!(m.metadata.machine.as_deref(), Some("Gantry 8000"));
    assert_eq!(m.metadata.location.as_deref(), Some("Hall: 2"));
    assert_eq!(m.metadata.by, None);
    let pressure = StartEnd { start: 99.039005, end: 99.049346, unit_code: Some(1) };
    assert_eq!(m.environment.air_pressure, Some(pressure));
    let material = StartEnd { start: 20.203292, end: 20.321342, unit_code: Some(0) };
    assert_eq!(m.environment.material_temperature, [Some(material), None, None]);
    assert_eq!(m.environment.environment_factor.unwrap().start, 0.31641096);
}

#[test]
fn written_files_read_back_as_they_were() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(rtl(&write_renishaw(&m)).unwrap(), m);
}

#[test]
fn angular_files_are_milliradian_and_held_in_microradian() {
    let text = rtl_with("File type  : rtl", "File type  : RTA");
    let m = parse_renishaw(text.as_bytes(), "x.rta", RenishawKind::Angular).unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Urad));
    assert_eq!(m.readings[1].deviation, 2500.0);
    let written = write_renishaw(&m);
    assert!(written.contains("File type  : rta") && written.contains("2.500000000\r\n"));
    let again = parse_renishaw(written.as_bytes(), "x.rta", RenishawKind::Angular).unwrap();
    assert_eq!(again.readings, m.readings);
}

#[test]
fn case_wrapping_and_unknown_sections_are_accepted() {
    let text = BIDIRECTIONAL_RTL
        .replace("\r\n", "\n")
        .replace("Target-count: 3", "TARGET-COUNT :3")
        .replace("-100.000000  0.000000  250.500000", "-100.0\n0\n\n+250.5")
        .replace("Targets :", "targets:")
        .replace("Flags: 0 0 2 0", "Flags: 0 0 2 0 2\nSomething: new")
        .replace("Run-count: 4", "Run-Count : 4\nOverrun: nan")
        .replace("EQUIPMENT::", "PROBE 2::\nfree text: inf\nEQUIPMENT::");
    let expected = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(rtl(&text).unwrap(), expected);
    assert_eq!(rtl(&format!("\u{feff}{text}")).unwrap(), expected);
}

/// The sample file with other rows, each with run, target column and deviation.
fn with_rows(run_count: u32, flags: &str, rows: &[(u32, &str, f64)]) -> String {
    let (start, rest) = BIDIRECTIONAL_RTL.split_once("Run Target Data:\r\n").unwrap();
    let end = &rest[rest.find("EQUIPMENT").unwrap()..];
    let rows: Vec<String> = rows.iter().map(|(run, t, x)| format!("{run} {t} {x}\r\n")).collect();
    let rows = rows.concat();
    let start = start
        .replace("Run-count: 4", &format!("Run-count: {run_count}"))
        .replace("Flags: 0 0 2 0", &format!("Flags: {flags}"));
    format!("{start}Run Target Data:\r\n{rows}{end}")
}

#[test]
fn target_values_in_the_target_column_are_accepted_where_no_number_fits() {
    let up = [(1, "-100", 1.0), (1, "0.0", 2.0), (1, "250.50", 3.0)];
    let m = rtl(&with_rows(1, "0 1 2 0", &up)).unwrap();
    assert_eq!(readings(&m), [(-100.0, 1, '+', 1.0), (0.0, 1, '+', 2.0), (250.5, 1, '+', 3.0)]);
    // The third target is neither a target number nor a target; the message asks for a target number.
    let neither = [(1, "1", 1.0), (1, "2", 2.0), (1, "250", 3.0)];
    assert!(matches!(rtl(&with_rows(1, "0 1 2 0", &neither)), Err(MetrologyError::Number(_))));
}

#[test]
fn the_order_of_targets_gives_the_direction_of_a_first_backward_run() {
    let rows =
        [(1, "3", 1.0), (1, "2", 2.0), (1, "1", 3.0), (2, "1", 4.0), (2, "2", 5.0), (2, "3", 6.0)];
    let m = rtl(&with_rows(2, "0 0 2 0", &rows)).unwrap();
    assert_eq!(m.mean_at(-100.0, Direction::Negative), Some(3.0));
    assert_eq!(m.mean_at(-100.0, Direction::Positive), Some(4.0));
    assert_eq!(m.notes, [""; 0]);
    let noted = rtl(&with_rows(2, "0 1 2 0", &rows)).unwrap();
    assert_eq!(noted.readings, m.readings);
    insta::assert_snapshot!(noted.notes.join("\n"), @"the flags say unidirectional, the order of the targets shows both directions: the order is believed");
}

#[test]
fn reverse_runs_of_zeros_are_left_out_and_named() {
    let descending = ["3", "2", "1"];
    let ascending = ["1", "2", "3"];
    for (flags, reverse) in
        [("0 1 2 0", descending), ("0 1 2 0", ascending), ("0 0 2 0", descending)]
    {
        let mut rows = Vec::new();
        for pair in 0..2 {
            rows.extend(ascending.map(|t| (2 * pair + 1, t, 3.5)));
            rows.extend(reverse.map(|t| (2 * pair + 2, t, 0.0)));
        }
        let m = rtl(&with_rows(4, flags, &rows)).unwrap();
        assert!(!m.has(Direction::Negative), "{flags}");
        assert_eq!(m.runs(Direction::Positive), [1, 2]);
        assert!(m.mean_curve().contains(&(0.0, 3.5)), "{:?}", m.mean_curve());
        insta::allow_duplicates! {
            insta::assert_snapshot!(m.notes.join("\n"), @"reverse runs 2, 4 left out: nothing but zeros, as written for a unidirectional test");
        }
    }
}

#[test]
fn one_zero_run_among_others_is_kept_and_noted() {
    let text = BIDIRECTIONAL_RTL
        .replace("-1.800000", "0")
        .replace("3.700000", "0")
        .replace("4.200000", "0");
    let m = rtl(&text).unwrap();
    assert_eq!(m.readings.len(), 12);
    insta::assert_snapshot!(m.notes.join("\n"), @"run 4 kept, though nothing but zeros");
}

#[test]
fn free_text_in_latin_1_and_gbk_is_read_and_noted() {
    for (bytes, text) in [(&b"M\xFCller"[..], "Müller"), (b"\xBB\xFA\xB4\xB2", "机床")] {
        let (before, after) = BIDIRECTIONAL_RTL.split_once("Gantry 8000").unwrap();
        let file = [before.as_bytes(), bytes, after.as_bytes()].concat();
        let m = parse_renishaw(&file, "x.rtl", RenishawKind::Linear).unwrap();
        assert_eq!(m.metadata.machine.as_deref(), Some(text));
        assert_eq!(m.readings, rtl(BIDIRECTIONAL_RTL).unwrap().readings);
        assert_eq!(m.notes.len(), 1, "{:?}", m.notes);
    }
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let complete = BIDIRECTIONAL_RTL.trim_end().len();
    for cut in 0..complete {
        let found = rtl(&BIDIRECTIONAL_RTL[..cut]);
        assert!(found.is_err(), "cut after {:?}", &BIDIRECTIONAL_RTL[..cut]);
    }
    assert!(rtl(&BIDIRECTIONAL_RTL[..complete]).is_ok());
}

#[test]
fn text_after_the_end_is_noted() {
    assert_eq!(rtl(&format!("{BIDIRECTIONAL_RTL}\u{1a}")).unwrap().notes, [""; 0]);
    let m = rtl(&format!("{BIDIRECTIONAL_RTL}more")).unwrap();
    insta::assert_snapshot!(m.notes.join("\n"), @"text after `EOF::` was not read");
}
