//! Tests of tables and logs that need a mapping of columns.

use std::fmt::Write as _;
use std::path::Path;

use volcomp_document::Document;
use volcomp_metrology::{
    Content, DeviationUnit, Mapping, Measurement, MetrologyError, parse_camonitor,
    parse_table_with, read_content, read_file, readings_at_dwells,
};
use volcomp_test_support::cases;
use volcomp_vocabulary::Direction::{Negative, Positive};

fn mapping(toml: &str) -> Mapping {
    let document = Document::new("m.toml", toml);
    document.decode(|root| Mapping::decode(&root)).unwrap().expect("a mapping")
}

fn mapping_error(toml: &str) -> String {
    let document = Document::new("m.toml", toml);
    document.decode(|root| Mapping::decode(&root)).unwrap_err().to_string()
}

fn table(toml: &str, text: &str) -> Result<Measurement, MetrologyError> {
    let Mapping::Columns(columns) = mapping(toml) else {
        panic!("no columns");
    };
    parse_table_with(text.as_bytes(), "x.csv", &columns)
}

fn shown(m: &Measurement) -> Vec<(f64, u32, &'static str, f64)> {
    let row = |r: &volcomp_metrology::Reading| {
        let sign = if r.direction == Positive { "+" } else { "-" };
        (r.target, r.run, sign, r.deviation)
    };
    m.readings.iter().map(row).collect()
}

#[test]
fn the_unit_in_the_head_of_a_named_column_is_used() {
    let read = |heads: [&str; 2], unit: &str| {
        let [target, reading] = heads;
        let columns =
            format!("[columns]\ntarget = \"{target}\"\ndeviation = \"{reading}\"\n{unit}");
        table(&columns, &format!("{target},{reading}\n0,0.1\n10,0.2\n"))
    };
    for (heads, unit, held, first) in [
        (["Soll mm", "Abweichung mm"], "", Some(DeviationUnit::Um), 100.0),
        (["Soll mm", "Abweichung [mm]"], "unit = \"mm\"", Some(DeviationUnit::Um), 100.0),
        (["Soll deg", "Abweichung arcsec"], "", Some(DeviationUnit::Urad), 0.484_813_7),
        (["Soll", "mm"], "", Some(DeviationUnit::Um), 100.0),
        (["Soll", "[mm]"], "", Some(DeviationUnit::Um), 100.0),
        (["Soll", "Abw (mm) Mittel"], "", Some(DeviationUnit::Um), 100.0),
        (["Soll", "偏差（mm）"], "", Some(DeviationUnit::Um), 100.0),
        (["Soll", "Abw (Lauf 1) mm"], "", Some(DeviationUnit::Um), 100.0),
        // With an unknown unit, the deviations are read as µm and a note is added.
        (["Soll", "Abw [1/1000 mm]"], "", None, 0.1),
        (["Soll", "Millimeter"], "", None, 0.1),
        (["Soll", "Abweichung"], "", None, 0.1),
    ] {
        let m = read(heads, unit).expect("read");
        assert_eq!(m.unit, held, "{heads:?}");
        let is_noted = m.notes.iter().any(|note| note.contains("taken as µm"));
        assert_eq!(is_noted, held.is_none(), "{heads:?}: {:?}", m.notes);
        assert!((m.readings[0].deviation - first).abs() < 1e-6, "{heads:?}");
    }
    for (heads, unit, said) in [
        (["Soll mm", "Abweichung mm"], "unit = \"um\"", "expected µm, as `unit`"),
        (["Soll deg", "Abweichung um"], "target_unit = \"mm\"", "expected mm, as `target_unit`"),
        (["Soll in", "Abweichung um"], "", "expected mm or deg"),
        (["Soll mm", "Abweichung ft"], "", "expected mm, µm"),
    ] {
        let message = read(heads, unit).expect_err("refused").to_string();
        assert!(message.contains(said), "{heads:?}: {message}");
    }
}

#[test]
fn columns_are_found_by_name_or_number_in_any_dialect() {
    let m = table(
        "[columns]\ntarget = \"Soll\"\ndeviation = 3\nseparator = \";\"\ndecimal_comma = true\nunit = \"mm\"\nheader_rows = 2",
        "Achse X;;\nIst;soll;Abweichung\n0,0;-10,5;0,0015\n;10;0,002\n",
    )
    .unwrap();
    assert_eq!(shown(&m), [(-10.5, 1, "+", 1.5), (10.0, 1, "+", 2.0)]);
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    let by_rows = "directions of approach follow the order of the rows";
    assert_eq!(m.notes, [by_rows, "columns that are not read: Ist"]);
    // One column for each run and direction.
    let wide = table(
        "[columns]\ntarget = 1\ndeviation = 2\nunit = \"um\"",
        "Target (mm),Run 1 Fwd,Run 1 Rev,Run 2 Fwd\n0,0.0,-1.8,0.1\n100,1.2,-0.6,1.3\n",
    )
    .unwrap();
    let not_read = "columns that are not read: Run 1 Rev, Run 2 Fwd";
    assert_eq!(wide.notes, [by_rows, not_read]);
    let blank = table(
        "[columns]\ntarget = 1\nmeasured = 2\nunit = \"mm\"\nseparator = \"blank\"\nheader_rows = 0",
        "  0.0   0.001\n 10.0  10.003\n 10.0  10.001\n  0.0  -0.002\n",
    )
    .unwrap();
    let rounded: Vec<f64> =
        blank.readings.iter().map(|r| (r.deviation * 1e6).round() / 1e6).collect();
    assert_eq!(rounded, [1.0, 3.0, 1.0, -2.0]);
    let ways: Vec<&str> = shown(&blank).iter().map(|row| row.2).collect();
    assert_eq!(ways, ["+", "+", "-", "-"]);
}

/// The numbers of header rows count blank lines, like line numbers in an editor.
#[test]
fn header_rows_are_lines_of_the_file() {
    for (separator, cell) in [(",", ","), ("blank", " "), ("tab", "\t")] {
        for end in ["\n", "\r\n"] {
            let toml = format!(
                "[columns]\ntarget = \"t\"\ndeviation = \"d\"\nseparator = \"{separator}\"\nheader_rows = 3"
            );
            let rows = format!("{end}t{cell}d{end}{end}0{cell}1{end}{end}10{cell}2{end}");
            let m = table(&toml, &rows).unwrap();
            assert_eq!(shown(&m), [(0.0, 1, "+", 1.0), (10.0, 1, "+", 2.0)]);
            // Messages state the same line numbers.
            let wrong = rows.replace("10", "1x");
            let message = table(&toml, &wrong).unwrap_err().to_string();
            assert!(message.starts_with("x.csv:6: target"), "{message}");
        }
    }
    // A header below the stated rows is not found, which is an error.
    let toml = "[columns]\ntarget = \"t\"\ndeviation = \"d\"";
    assert!(table(toml, "\nt,d\n0,1\n").is_err());
    let numbered = "[columns]\ntarget = 1\ndeviation = 2\nheader_rows = 2";
    assert_eq!(table(numbered, "\nt,d\n0,1\n").unwrap().readings.len(), 1);
}

/// Reads a table with a column of directions, but no column of runs, and returns the run of each row. A pass is a
/// direction and its targets.
fn runs_of(passes: &[(&str, &[u32])]) -> Result<Vec<u32>, MetrologyError> {
    let toml = "[columns]\ntarget = \"t\"\ndeviation = \"d\"\ndirection = \"way\"";
    let rows = passes.iter().flat_map(|(way, targets)| {
        let row = move |target: &u32| format!("{target},{way},0.5\n");
        targets.iter().map(row)
    });
    let read = table(toml, &format!("t,way,d\n{}", rows.collect::<String>()))?;
    Ok(read.readings.iter().map(|reading| reading.run).collect())
}

/// Without a column of runs, a run with a missing target does not take a reading of the next run.
#[test]
fn runs_that_lack_targets_are_counted_by_passes() {
    let there_and_back: [(&str, &[u32]); 6] = [
        ("+", &[0, 1, 2]),
        ("-", &[2, 1, 0]),
        ("+", &[0, 2]),
        ("-", &[2, 1, 0]),
        ("+", &[0, 1, 2]),
        ("-", &[1, 0]),
    ];
    let expected = [1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3];
    assert_eq!(runs_of(&there_and_back).unwrap(), expected);
    // The backward pass of the second run is missing.
    let passes = [&there_and_back[..3], &there_and_back[4..]].concat();
    let expected = [1, 1, 1, 1, 1, 1, 2, 2, 3, 3, 3, 3, 3];
    assert_eq!(runs_of(&passes).unwrap(), expected);
    // All passes have one direction; the second run begins late.
    let one_way: [(&str, &[u32]); 3] = [("+", &[0, 1, 2]), ("+", &[1, 2]), ("+", &[0, 1, 2])];
    assert_eq!(runs_of(&one_way).unwrap(), [1, 1, 1, 2, 2, 3, 3, 3]);
    // Complete runs are recognised in any order of rows.
    let by_targets: [(&str, &[u32]); 1] = [("+", &[0, 0, 1, 1, 2, 2])];
    assert_eq!(runs_of(&by_targets).unwrap(), [1, 2, 1, 2, 1, 2]);
    let lacking: [(&str, &[u32]); 1] = [("+", &[0, 0, 1, 2, 2])];
    insta::assert_snapshot!(runs_of(&lacking).unwrap_err(), @"x.csv:2: rows: found targets with different numbers of readings, not in the order of travel, expected a column of runs (`run`), which says what run lacks a reading");
}

#[test]
fn runs_and_directions_come_from_columns_if_present() {
    let toml =
        "[columns]\ntarget = \"t\"\ndeviation = \"d\"\ndirection = \"way\"\nseparator = \"tab\"";
    let m =
        table(toml, "t\tway\td\n0\tfwd\t1\n10\tfwd\t2\n10\trev\t3\n0\trev\t4\n0\tF\t5\n").unwrap();
    assert_eq!(
        shown(&m),
        [
            (0.0, 1, "+", 1.0),
            (10.0, 1, "+", 2.0),
            (10.0, 1, "-", 3.0),
            (0.0, 1, "-", 4.0),
            (0.0, 2, "+", 5.0)
        ]
    );
    assert_eq!(m.unit, None);
    let numbered =
        table("[columns]\ntarget = \"t\"\ndeviation = \"d\"\nrun = \"n\"", "t,d,n\n0,1,7\n5,2,7\n")
            .unwrap();
    assert_eq!(numbered.runs(Positive), [7]);
    for (toml, text, expected) in [
        (toml, "t\tway\td\n0\tleft\t1\n", "x.csv:2: direction: found `left`"),
        (toml, "t\tway\tdev\n0\t+\t1\n", "expected one column `d` (the reading)"),
        (toml, "t\tt\tway\td\n0\t0\t+\t1\n", "`t` 2 times"),
        (toml, "t\tway\td\n0\t+\t1,5\n", "deviation: found `1,5`"),
        (toml, "t\tway\td\n0\t+\n", "at least 3"),
        (toml, "t\tway\td\n", "at least one reading"),
        ("[columns]\ntarget = 1\ndeviation = 1", "t,d\n1,2\n", "column 1 as target and as reading"),
    ] {
        let message = table(toml, text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text:?}: {message}");
    }
}

#[test]
fn invalid_mappings_are_refused() {
    for [toml, expected] in &cases(
        r#"
[columns]\ntarget = 1 | expected `deviation`
[columns]\ntarget = 1\ndeviation = 2\nmeasured = 3 | expected one of them
[columns]\ntarget = 1\nmeasured = 3 | expected the unit
[columns]\ntarget = "t"\ndeviation = 2\nheader_rows = 0 | expected their numbers
[columns]\ntarget = 1\ndeviation = 2\ndecimal_comma = true | decimal commas
[columns]\ntarget = 0\ndeviation = 2 | 0
[columns]\ntarget = 1\nmeasured = 2\nunit = "um"\ntarget_unit = "deg" | measured positions in µm, expected `target_unit = "mm"`
[columns]\ntarget = 1\nmeasured = 2\nunit = "arcsec"\ntarget_unit = "mm" | expected `target_unit = "deg"`
[columns]\ntarget = 1\ndeviation = 2\ncolour = 3 | unknown key
[columns]\ntarget = 1\ndeviation = 2\n[channels]\n | found `columns` and `channels`
[channels]\ntarget = "a"\nreading = "a"\nreading_is = "position"\nunit = "mm" | expected two
[channels]\ntarget = "a"\nreading = "b"\nunit = "mm" | reading_is
"#,
    ) {
        let message = mapping_error(toml);
        assert!(message.contains(expected), "{toml:?}: {message}");
    }
}

/// A log with standstills at 0, 10 and 20 mm, an overrun to 21 mm, and the same standstills on the way back. The laser
/// reads 2 µm too much forward and 1 µm too little backward, and reports only changes. The motor reports its position
/// one line late.
pub(crate) fn log() -> String {
    let mut text = String::new();
    let mut time = 0.0;
    let places = [0.0, 10.0, 20.0, 21.0, 20.0, 10.0, 0.0];
    let stamp = |time: f64| {
        let (minutes, seconds) = ((time / 60.0).floor(), time % 60.0);
        format!("2026-03-14 10:{minutes:02}:{seconds:09.6}")
    };
    let mut from = -5.0;
    for (index, place) in places.into_iter().enumerate() {
        // Positions during the motion.
        for step in 1..4 {
            let at = from + (place - from) * f64::from(step) / 4.0;
            writeln!(text, "M:X.RBV {} {at:.4}", stamp(time)).unwrap();
            writeln!(text, "LASER:POS {} {at:.5}", stamp(time + 0.01)).unwrap();
            time += 0.1;
        }
        let off = if index < 4 { 0.002 } else { -0.001 };
        // The line of the motor is behind that of the laser, although its time is earlier.
        writeln!(text, "LASER:POS {} {:.5}", stamp(time + 0.3), place + off).unwrap();
        writeln!(text, "M:X.RBV {} {:.4}", stamp(time), place).unwrap();
        writeln!(text, "AIR:T {} 20.{index} LOLO MAJOR", stamp(time)).unwrap();
        if index == 1 {
            writeln!(text, "LASER:POS {} 99 COMM INVALID", stamp(time + 0.4)).unwrap();
            writeln!(text, "M:Y.RBV <undefined> *** Not connected (PV not found)").unwrap();
        }
        time += 3.0;
        from = place;
    }
    writeln!(text, "AIR:T {} 20.5", stamp(time)).unwrap();
    text
}

pub(crate) const CHANNELS: &str = "[channels]\ntarget = \"M:X.RBV\"\nreading = \"LASER:POS\"\nreading_is = \"position\"\nunit = \"mm\"\ntargets = [0, 10, 20]\nsettle_s = 0.2\n";

#[test]
fn standstills_in_a_log_become_readings() {
    let log = parse_camonitor(log().as_bytes(), "x.log").unwrap();
    assert_eq!(log.channels.len(), 3);
    assert_eq!(log.date.as_deref(), Some("2026-03-14"));
    let said = log.notes.join("\n");
    for expected in [
        "1 lines hold no number",
        "LASER:POS: 1 values with the alarm INVALID left out",
        "AIR:T: 7 values with the alarm LOLO MAJOR kept",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    let Mapping::Channels(channels) = mapping(CHANNELS) else {
        panic!("no channels");
    };
    let m = readings_at_dwells(&log, &channels).unwrap();
    let rounded: Vec<_> = shown(&m)
        .into_iter()
        .map(|(target, run, way, deviation)| (target, run, way, (deviation * 1e3).round() / 1e3))
        .collect();
    assert_eq!(
        rounded,
        [
            (0.0, 1, "+", 2.0),
            (10.0, 1, "+", 2.0),
            (20.0, 1, "+", 2.0),
            (20.0, 1, "-", -1.0),
            (10.0, 1, "-", -1.0),
            (0.0, 1, "-", -1.0),
        ]
    );
    assert_eq!(m.mean_at(10.0, Negative).map(f64::round), Some(-1.0));
    assert!(
        m.notes.join("\n").contains("1 standstills away from targets skipped"),
        "{:?}",
        m.notes
    );
    // If no targets are stated, the overrun is a target.
    let mut found = channels.clone();
    found.targets.clear();
    assert_eq!(readings_at_dwells(&log, &found).unwrap().targets(), [0.0, 10.0, 20.0, 21.0]);
    let mut wrong = channels.clone();
    wrong.reading = "LASER".into();
    insta::assert_snapshot!(readings_at_dwells(&log, &wrong).unwrap_err(), @"x.log: channel: found no `LASER`, expected one of AIR:T, LASER:POS, M:X.RBV");
    let mut long = channels;
    long.dwell_s = 60.0;
    assert!(
        readings_at_dwells(&log, &long).unwrap_err().to_string().contains("no standstill of 60 s")
    );
}

/// The last 4 µm of an approach are within the standstill limit: before the target in positive motion, beyond it in
/// negative motion. The reversal value of an axis without reversal is still below 0.1 µm, however slow the approach is.
#[test]
fn the_end_of_an_approach_is_not_read_as_reversal() {
    let mut text = String::new();
    let mut time = 0.0_f64;
    let mut say = |time: f64, channel: &str, value: f64| {
        let (minute, second) = ((time / 60.0).floor(), time % 60.0);
        writeln!(text, "{channel} 2026-03-14 10:{minute:02.0}:{second:09.6} {value:.6}").unwrap();
    };
    let mut from = -1.0_f64;
    for (visit, target) in [0.0, 10.0, 20.0, 21.0, 20.0, 10.0, 0.0_f64].into_iter().enumerate() {
        let sign = (target - from).signum();
        // During the motion, and then for 3 s at 10 Hz: the remaining distance decays to 1/e in 0.3 s, and readings
        // scatter by ±0.05 µm.
        say(time, "M:X.RBV", f64::midpoint(from, target));
        for sample in 0..30_u32 {
            let since = f64::from(sample) * 0.1;
            let left = 0.004 * (-since / 0.3).exp();
            let noise = 0.00005 * (f64::from(sample) * 2.4 + visit as f64).sin();
            say(time + 0.1 + since, "M:X.RBV", target - sign * left);
            say(time + 0.11 + since, "LASER:POS", target - sign * left + noise);
        }
        time += 3.2;
        from = target;
    }
    say(time, "M:X.RBV", -5.0);
    let Mapping::Channels(mut channels) = mapping(CHANNELS) else {
        panic!("no channels");
    };
    channels.settle_s = 0.0;
    let log = parse_camonitor(text.as_bytes(), "x.log").unwrap();
    let m = readings_at_dwells(&log, &channels).unwrap();
    assert_eq!(m.readings.len(), 6);
    for target in [0.0, 10.0, 20.0] {
        let [up, down] = [Positive, Negative].map(|way| m.mean_at(target, way).unwrap());
        assert!((up - down).abs() < 0.1, "{target}: {up} and {down} µm");
    }
    // If no targets are stated, the positions at rest are the targets.
    channels.targets.clear();
    let m = readings_at_dwells(&log, &channels).unwrap();
    assert_eq!(m.targets(), [0.0, 10.0, 20.0, 21.0]);
}

/// Creep at a target and an overrun within the reach of the target do not change the readings: the target counts as
/// approached once.
#[test]
fn a_creep_or_a_small_overrun_at_a_target_changes_no_reading() {
    let Mapping::Channels(channels) = mapping(CHANNELS) else {
        panic!("no channels");
    };
    let read = |text: &str| {
        let log = parse_camonitor(text.as_bytes(), "x.log").unwrap();
        readings_at_dwells(&log, &channels).unwrap()
    };
    // Two standstills of 1.2 s replace one of 3 s, with a return after the overrun.
    let moved = |target: f64, steps: &[(f64, f64)]| {
        let mut text = String::new();
        let mut arrived = false;
        for line in log().lines() {
            let words: Vec<&str> = line.split(' ').collect();
            writeln!(text, "{line}").unwrap();
            if !arrived && words[0] == "M:X.RBV" && words[3] == format!("{target:.4}") {
                arrived = true;
                let (minute, second) = words[2][3..].split_once(':').unwrap();
                let second: f64 = second.parse().unwrap();
                for (after, by) in steps {
                    let at = target + by;
                    let later = second + after;
                    writeln!(text, "M:X.RBV {} 10:{minute}:{later:09.6} {at:.4}", words[1])
                        .unwrap();
                    let later = later + 0.1;
                    writeln!(text, "LASER:POS {} 10:{minute}:{later:09.6} {at:.5}", words[1])
                        .unwrap();
                }
            }
        }
        assert!(arrived);
        read(&text)
    };
    let straight = read(&log());
    for target in [0.0, 10.0, 20.0] {
        for steps in [
            &[(1.5, 0.01)][..],
            &[(1.5, -0.01)],
            // An overrun and back, without and with a standstill in between.
            &[(1.3, 0.04), (1.5, 0.0)],
            &[(1.1, 0.04), (2.2, 0.0)],
        ] {
            let crept = moved(target, steps);
            assert_eq!(crept.readings, straight.readings, "{target} {steps:?}");
            assert!(
                crept.notes.join("\n").contains("repeated standstills at one target skipped"),
                "{:?}",
                crept.notes
            );
        }
    }
    // An overrun beyond the reach of the target, without a standstill, is an approach from the other side.
    let left = moved(20.0, &[(1.3, 0.5), (1.5, 0.0)]);
    assert_ne!(left.readings, straight.readings);
}

#[test]
fn a_log_out_of_order_gives_the_same_readings() {
    let text = log();
    let mut lines: Vec<&str> = text.lines().collect();
    let straight = parse_camonitor(text.as_bytes(), "x.log").unwrap();
    for index in (0..lines.len() - 3).step_by(3) {
        lines.swap(index, index + 2);
    }
    let shuffled = parse_camonitor((lines.join("\n") + "\n").as_bytes(), "x.log").unwrap();
    assert_eq!(shuffled.channels, straight.channels);
    assert!(shuffled.notes.join("\n").contains("out of order"));
}

#[test]
fn a_mapping_file_next_to_a_table_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let csv = write("x.csv", "Pos;Err\n0,0;1,5\n");
    assert!(read_file(&csv).is_err());
    write(
        "x.csv.toml",
        "[columns]\ntarget = \"Pos\"\ndeviation = \"Err\"\nseparator = \";\"\ndecimal_comma = true\nunit = \"um\"\n",
    );
    assert_eq!(read_file(&csv).unwrap().readings[0].deviation, 1.5);
    let log = write("x.log", &log());
    assert!(matches!(read_content(&log, None).unwrap(), Content::Log(_)));
    let message = read_file(&log).unwrap_err().to_string();
    assert!(message.contains("x.log.toml") && message.contains("LASER:POS"), "{message}");
    write("x.log.toml", CHANNELS);
    assert_eq!(read_file(&log).unwrap().readings.len(), 6);
    write("x.log.toml", "[columns]\ntarget = 1\ndeviation = 2\n");
    assert!(matches!(read_file(&log), Err(MetrologyError::WrongMapping { .. })));
    let report = write("r.txt", crate::lasers::REPORT);
    assert!(read_file(&report).is_ok());
    let pos = write("r.POS", crate::lasers::POS);
    assert!(read_file(&pos).is_ok());
    let ren = write("r.REN", crate::lasers::REN);
    assert!(read_file(&ren).is_ok());
    let rtx = folder.path().join("r.rtx");
    std::fs::write(&rtx, crate::lasers::rtx("", &[1.0, 2.0], b"EOF::\r\n")).unwrap();
    let message = read_file(&rtx).unwrap_err().to_string();
    assert!(message.contains("a dynamic capture of 2 samples"), "{message}");
    assert!(read_file(&write("r.txt", "hello\n")).is_err());
    assert!(Mapping::beside(Path::new("a/b.csv")).ends_with("b.csv.toml"));
}
