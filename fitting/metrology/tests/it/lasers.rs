//! Tests of laser files: Renishaw measurements, captures and exports, API `.pos`, and reports of 5529/5530 lasers.

use volcomp_metrology::{
    DeviationUnit, FileFormat, Measurement, MetrologyError, Quantity, RenishawKind, StartEnd,
    evaluate, material_compensation, parse_keysight_report, parse_pos, parse_ren, parse_renishaw,
    parse_rtx, write_renishaw,
};
use volcomp_vocabulary::Direction::{self, Negative, Positive};

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

#[test]
fn straightness_files_are_read_as_micrometres_with_a_note() {
    let text = rtl_with("File type  : rtl", "File type  : rts");
    let read = |text: &str| parse_renishaw(text.as_bytes(), "x.rts", RenishawKind::Straightness);
    let m = read(&text).unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    assert_eq!(m.quantity, Some(Quantity::Straightness));
    assert_eq!(m.format, Some(FileFormat::RenishawStraightness));
    assert_eq!(m.mean_at(0.0, Negative), Some(3.6));
    assert!(m.notes.join("\n").contains("no real file has proven"), "{:?}", m.notes);
    assert_eq!(read(&write_renishaw(&m)).unwrap(), m);
    // A linear file read as straightness, and a straightness file read as linear.
    assert!(matches!(read(BIDIRECTIONAL_RTL), Err(MetrologyError::Kind(_))));
    let as_linear = parse_renishaw(text.as_bytes(), "x.rtl", RenishawKind::Linear);
    assert!(matches!(as_linear, Err(MetrologyError::Kind(_))));
}

/// If the material temperature differs from 20 °C by more than 1 K, a note states the expansion: 22.4 °C − 20 °C = 2.4
/// K at 8 µm/(m·K) is 19.2 µm/m.
#[test]
fn material_far_from_20_degrees_is_flagged_with_its_expansion() {
    let notes = |from: &str, to: &str| {
        let text = rtl_with(from, to);
        let m = parse_renishaw(text.as_bytes(), "x.rtl", RenishawKind::Linear).unwrap();
        (m.notes.join("\n"), material_compensation(&m.environment))
    };
    let warm = "Mat temp 1 : 22.100000 22.400000 0";
    let given = "Mat temp 1 : 20.203292 20.321342 0";
    let (said, compensation) = notes(given, warm);
    insta::assert_snapshot!(said, @"material temperature 1 was 22.10 to 22.40 °C, farther than 1 K from 20 °C: with 8 µm/(m·K) the material is 19.2 µm/m from its length at 20 °C; whether the readings were compensated for it the file does not say");
    assert_eq!(compensation, "8 µm/(m·K) and one material temperature stated");
    // Within 1 K there is no note. A temperature of −10 °C means that no sensor is connected.
    assert_eq!(
        notes(given, "Mat temp 1 : 19.000000 21.000000 0").0,
        "material temperature 1 was 19.00 to 21.00 °C, changing by 2.00 K during the test: with 8 µm/(m·K) the material is 8.0 µm/m from its length at 20 °C; whether the readings were compensated for it the file does not say"
    );
    assert_eq!(notes(given, "Mat temp 1 : 20.900000 20.950000 0").0, "");
    let (absent, compensation) = notes(given, "Mat temp 1 : -10.000000 -10.000000 0");
    assert_eq!(absent, "");
    assert_eq!(compensation, "8 µm/(m·K) stated, but no material temperature");
    let (kelvin, _) = notes(given, "Mat temp 1 : 293.150000 293.250000 0");
    assert!(kelvin.contains("check its unit"), "{kelvin}");
}

pub(crate) fn rtx(count: &str, samples: &[f64], end: &[u8]) -> Vec<u8> {
    let head = format!(
        "HEADER::\r\nFile Type: rtx\r\nOwner: CARTO-Dynamic\r\nVersion no: 4.13.9237.28405\r\nVelocity: 0\r\nSample rate: 50000\r\n{count}Actual sample rate: 50000.5\r\nFlags: 0 1 2 0 2\r\nMachine: \r\nSerial No: 17\r\nAxis: X\r\nDate: 10/02/2025 12:58:22\r\nData:\r\n"
    );
    let data = samples.iter().flat_map(|sample| sample.to_le_bytes());
    head.into_bytes().into_iter().chain(data).chain(end.iter().copied()).collect()
}

#[test]
fn captures_are_samples_in_little_endian() {
    // The bytes of this sample contain 0x0A and `EOF::`.
    let tricky = f64::from_le_bytes(*b"\nEOF::\r\n");
    let samples = [0.0, -1.25, tricky, 1e-9];
    for count in ["Sample no: 4\r\n", ""] {
        let capture = parse_rtx(&rtx(count, &samples, b"EOF::\r\n"), "x.rtx").unwrap();
        assert_eq!(capture.samples, samples);
        assert_eq!(capture.sample_rate_hz, Some(50_000.5));
        assert_eq!(capture.metadata.serial.as_deref(), Some("17"));
        assert_eq!(capture.metadata.machine, None);
        assert!((capture.duration_s().unwrap() - 3.0 / 50_000.5).abs() < 1e-15);
    }
    let wrong = |bytes: &[u8]| parse_rtx(bytes, "x.rtx").unwrap_err();
    let cut = rtx("Sample no: 4\r\n", &samples[..3], b"");
    assert!(matches!(wrong(&cut), MetrologyError::Truncated(_)));
    let fewer = rtx("Sample no: 5\r\n", &samples, b"EOF::\r\n");
    assert!(matches!(wrong(&fewer), MetrologyError::Truncated(_)));
    let odd = rtx("", &samples, b"xyzEOF::\r\n");
    assert!(matches!(wrong(&odd), MetrologyError::Truncated(_)));
    let nan = rtx("", &[1.0, f64::NAN], b"EOF::\r\n");
    insta::assert_snapshot!(wrong(&nan), @"x.rtx:13: Data: found NaN as sample 2, expected finite numbers");
    assert!(matches!(wrong(b"target,deviation\n"), MetrologyError::Kind(_)));
    assert!(matches!(wrong(&rtx("", &[], b"EOF::\r\n")), MetrologyError::Empty { .. }));
}

pub(crate) const POS: &str = "Report of the test\r\nAxis: X\r\n\r\n\
Position   \tBidirectional Avg Error\r\n-50.000\t0.0010\r\n0.000\t0.0000\r\n50.000\t-0.0025\r\n\r\n\
Position   \tForward Directional Avg Error\r\n-50.000\t0.0015\r\n0.000\t0.0000\r\n50.000\t-0.0030\r\n\r\n\
Position   \tBackward Directional Avg Error\r\n50.000\t-0.0020\r\n0.000\t0.0000\r\n-50.000\t0.0005\r\n";

/// Deviations in API files are in mm: 0.0015 is 1.5 µm. The tables are matched by target, in any order.
#[test]
fn api_files_hold_means_in_millimetres() {
    let m = parse_pos(POS.as_bytes(), "x.pos").unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    assert_eq!(m.targets(), [-50.0, 0.0, 50.0]);
    assert_eq!(m.mean_at(-50.0, Positive), Some(1.5));
    assert_eq!(m.mean_at(-50.0, Negative), Some(0.5));
    assert_eq!(m.mean_at(50.0, Negative), Some(-2.0));
    assert_eq!(m.metadata.axis.as_deref(), Some("X"));
    // Means alone determine B, but neither A nor R.
    let evaluated = evaluate(&m).unwrap();
    assert_eq!((evaluated.a, evaluated.r), (None, None));
    assert!((evaluated.b.unwrap() - 1.0).abs() < 1e-9);
    let (both, _) = POS.split_once("Position   \tForward").unwrap();
    let only = parse_pos(both.as_bytes(), "x.pos").unwrap();
    assert!(!only.has(Negative));
    assert!(only.notes.join(" ").contains("only the mean of both directions"));
    for (from, to, expected) in [
        ("-0.0025", "-0.0125", "mean of both directions: found -0.0125"),
        ("50.000\t-0.0020", "51.000\t-0.0020", "the same positions in every table"),
        ("-50.000\t0.0005\r\n", "", "the file may be cut off"),
        ("-50.000\t0.0005\r\n", "-50.000\t", "two numbers"),
        ("0.000\t0.0000\r\n-50", "50.000\t0.0000\r\n-50", "50.000` again"),
        ("Backward", "Forward", "each table once"),
    ] {
        assert!(POS.contains(from), "{from}");
        let text = POS.replacen(from, to, 1);
        let message = parse_pos(text.as_bytes(), "x.pos").unwrap_err().to_string();
        assert!(message.contains(expected), "{from}: {message}");
    }
}

pub(crate) const REN: &str = "Renishaw plc\r\nCompensation start   -100\r\nCompensation end      100\r\nCompensation spacing  100\r\n\r\nNo.     Axis position        Combined\r\n1       -100.000             2\r\n2       0.000                0\r\n3       100.000              -3\r\n";

#[test]
fn compensation_exports_are_marked_as_no_readings() {
    let m = parse_ren(REN.as_bytes(), "x.REN").unwrap();
    assert_eq!(m.unit, None);
    assert_eq!(m.mean_curve(), [(-100.0, 2.0), (0.0, 0.0), (100.0, -3.0)]);
    assert!(m.notes.join(" ").contains("neither sign nor unit"));
    for (from, to, expected) in [
        ("2       0.000 ", "2       10.000 ", "positions 100 apart"),
        ("3       100.000              -3\r\n", "", ""),
        ("end      100", "end      500", "it may be cut off"),
        ("No.  ", "#  ", "kind of file"),
        ("             2\r\n", "\r\n", "three columns"),
    ] {
        assert!(REN.contains(from), "{from}");
        let found = parse_ren(REN.replacen(from, to, 1).as_bytes(), "x.REN");
        match found {
            Err(error) => assert!(error.to_string().contains(expected), "{from}: {error}"),
            // The distance from start to end need not be a multiple of the spacing.
            Ok(_) => assert_eq!(expected, "", "{from}"),
        }
    }
}

/// A repeated position is rejected with its first line, although the export states no spacing.
#[test]
fn a_repeated_position_of_an_export_is_refused() {
    let twice = REN.replacen("Compensation spacing  100\r\n", "", 1);
    let row = "2       0.000                0\r\n";
    let twice = twice.replacen(row, &format!("{row}{row}"), 1);
    let error = parse_ren(twice.as_bytes(), "x.REN").unwrap_err().to_string();
    assert!(error.contains("0 again (first in line 7)"), "{error}");
}

pub(crate) const REPORT: &str = "Linear Measurement Report\r\nMachine: Mill 7\r\nDate: 2009-05-04\r\nAxis: X\r\n\r\n\
            Forward  Reverse  System  2 Sigma  2 Sigma  Dead\r\n\
 Target      Mean     Mean     Mean   Forward  Reverse  Zone   (microns)\r\n\
 Dead Zone = Reverse - Forward\r\n\
 1  -254.000  +0.147   +1.147   +0.647   0.5   0.6   +1.000\r\n\
 2     0.000  -1.000   +0.500   -0.250   0.4   0.7   +1.500\r\n";

#[test]
fn columns_of_reports_are_checked_against_each_other() {
    let m = parse_keysight_report(REPORT.as_bytes(), "x.txt").unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    assert_eq!(m.mean_at(-254.0, Positive), Some(0.147));
    assert_eq!(m.mean_at(0.0, Negative), Some(0.5));
    assert_eq!(m.metadata.machine.as_deref(), Some("Mill 7"));
    assert_eq!(evaluate(&m).unwrap().r, None);
    assert!(m.notes.join(" ").contains("single runs, how many there were, A and R by ISO 230-2"));
    for (from, to, expected) in [
        ("+1.000\r\n", "-1.000\r\n", "dead zone: found -1"),
        ("+0.647", "+1.647", "system mean: found 1.647"),
        ("   0.6   +1.000", "   +1.000", "are the columns in another order?"),
        ("   0.5   0.6   +1.000", "   +1.000", "7 numbers"),
        ("(microns)", "(microns) mean (mm)", "unit: found mm and µm"),
        ("(microns)", "(in)", "unit: found inches"),
        ("2     0.000", "2  -254.000", "each target once"),
        ("Dead", "Live", "kind of file"),
        ("+1.500\r\n", "+1.500\r\n 3  254", "the file may be cut off"),
        ("+1.500\r\n", "+1.500\r\n3", "the file may be cut off"),
    ] {
        assert!(REPORT.contains(from), "{from}");
        let text = REPORT.replace(from, to);
        let message = parse_keysight_report(text.as_bytes(), "x.txt").unwrap_err().to_string();
        assert!(message.contains(expected), "{from}: {message}");
    }
    let cut = format!("{REPORT} 3  254");
    assert!(matches!(
        parse_keysight_report(cut.as_bytes(), "x.txt"),
        Err(MetrologyError::Truncated(_))
    ));
    let without = REPORT.replace("(microns)", "");
    assert_eq!(parse_keysight_report(without.as_bytes(), "x.txt").unwrap().unit, None);
}

/// Columns with exponents are compared within their last digit: 2.0E-03 has a resolution of 0.0001.
#[test]
fn columns_with_exponents_are_checked_against_each_other() {
    let head = REPORT.split("1  -254").next().unwrap();
    let read = |row: &str| parse_keysight_report(format!("{head}{row}\r\n").as_bytes(), "x.txt");
    let m = read("0.0E+00 2.0E-03 4.0E-03 3.0E-03 1.0E-03 1.0E-03 2.0E-03").unwrap();
    assert_eq!(m.mean_at(0.0, Negative), Some(4.0e-3));
    // The forward and reverse columns are swapped.
    let message =
        read("0.0E+00 4.0E-03 2.0E-03 3.0E-03 1.0E-03 1.0E-03 2.0E-03").unwrap_err().to_string();
    assert!(message.contains("dead zone: found 0.002, expected -0.002"), "{message}");
    // A zero has no last digit; it must still not agree with every value.
    assert!(read("1.0E+01 4.0E-03 0.0E+00 2.0E-03 1.0E-03 1.0E-03 4.0E-03").is_err());
    // Large numbers are compared within their own last digit: −280 is accepted, although the rounded means differ by
    // −200.
    assert!(read("1.0E+01 1.2E+03 1.0E+03 1.1E+03 1.0E+01 1.0E+01 -2.8E+02").is_ok());
}

#[test]
fn means_of_api_files_with_exponents_are_checked() {
    let text = |both: &str| {
        format!(
            "Position Bidirectional Avg Error\n10.0 {both}\nPosition Forward Avg Error\n10.0 4.0E-03\nPosition Backward Avg Error\n10.0 2.0E-03\n"
        )
    };
    let read = |both: &str| parse_pos(text(both).as_bytes(), "x.pos");
    assert_eq!(read("3.0E-03").unwrap().mean_at(10.0, Positive), Some(4.0));
    for wrong in ["2.0E-03", "4.0E-03", "0.0E+00"] {
        let message = read(wrong).unwrap_err().to_string();
        assert!(message.contains("mean of both directions"), "{message}");
    }
    // The means of the directions are rounded as well: the mean of both has more digits than they have.
    let fine = text("2.0E-05").replace("2.0E-03", "-4.0E-03");
    assert!(parse_pos(fine.as_bytes(), "x.pos").is_ok());
}

/// In each format with blanks or tabs as separators, decimal commas are accepted like decimal points. A file with both
/// is rejected.
#[test]
fn decimal_commas_are_read_where_they_are_not_separators() {
    type Parser = fn(&[u8]) -> Result<volcomp_metrology::Measurement, MetrologyError>;
    let linear: Parser = |bytes| parse_renishaw(bytes, "x", RenishawKind::Linear);
    let files: [(&str, Parser); 4] = [
        (BIDIRECTIONAL_RTL, linear),
        (POS, |bytes| parse_pos(bytes, "x")),
        (REPORT, |bytes| parse_keysight_report(bytes, "x")),
        (&REN.replace("100.000", "100.50").replace("spacing  100", "spacing  100.5"), |bytes| {
            parse_ren(bytes, "x")
        }),
    ];
    for (text, parse) in files {
        // Points between digits are in numbers, and in dates and versions, which are not parsed as numbers.
        let is_digit = |c: Option<&u8>| c.is_some_and(u8::is_ascii_digit);
        let bytes = text.as_bytes();
        let decimal = |at: usize| bytes[at] == b'.' && is_digit(bytes.get(at + 1));
        let comma: Vec<u8> =
            (0..bytes.len()).map(|at| if decimal(at) { b',' } else { bytes[at] }).collect();
        assert_ne!(comma, bytes);
        let (found, expected) = (parse(&comma).unwrap(), parse(bytes).unwrap());
        assert_eq!(found.readings, expected.readings);
        assert_eq!(found.environment, expected.environment);
        // The last comma becomes a point again.
        let mut mixed = comma;
        let last = mixed.iter().rposition(|byte| *byte == b',').unwrap();
        mixed[last] = b'.';
        let message = parse(&mixed).unwrap_err().to_string();
        assert!(message.contains("decimal commas or decimal points in all numbers"), "{message}");
    }
}
