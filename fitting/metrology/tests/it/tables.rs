//! Tests of plain tables with a row for each reading, and of tables with a column for each run.

use std::fmt::Write;

use volcomp_metrology::{
    DeviationUnit, Measurement, MetrologyError, Reading, ReadingUnit, parse_csv, write_csv,
};
use volcomp_vocabulary::Direction;

fn csv(text: &str) -> Result<Measurement, MetrologyError> {
    parse_csv(text.as_bytes(), "x.csv")
}

const BIDIRECTIONAL: &str = "target,run,direction,deviation
-10.5,1,+,1.25
0,1,+,2.50
10,1,+,-3.75
10,1,-,-2.25
0,1,-,3.00
-10.5,1,-,4.25
";

#[test]
fn a_table_is_read_without_changes() {
    let m = csv(BIDIRECTIONAL).unwrap();
    assert_eq!((m.unit, m.readings.len(), m.notes.len()), (None, 6, 0));
    assert_eq!(m.targets(), [-10.5, 0.0, 10.0]);
    assert_eq!(m.mean_at(-10.5, Direction::Negative), Some(4.25));
    let spaced = BIDIRECTIONAL.replace(',', " , ").replace('\n', "\r\n\r\n");
    assert_eq!(
        csv(&format!("\u{feff}{}", spaced.replace("target", "Target"))).unwrap().readings,
        m.readings
    );
}

#[test]
fn two_columns_are_one_forward_run() {
    let m = csv("target,deviation\n0,1\n\"10\",2e-1\n").unwrap();
    assert_eq!(m.mean_curve(), [(0.0, 1.0), (10.0, 0.2)]);
    assert_eq!((m.runs(Direction::Positive), m.has(Direction::Negative)), (vec![1], false));
}

/// Tables of spreadsheets (semicolons or tabs, decimal commas, other order of columns) give the same readings as plain
/// tables.
#[test]
fn spreadsheet_exports_are_read_like_plain_tables() {
    let expected = csv(BIDIRECTIONAL).unwrap();
    let semicolons = BIDIRECTIONAL.replace(',', ";").replace('.', ",");
    let tabs = BIDIRECTIONAL.replace(',', "\t");
    let marked = format!("sep=;\r\n{}", semicolons.replace('\n', "\r\n"));
    for text in [&semicolons, &tabs, &marked] {
        let m = csv(text).unwrap();
        assert_eq!((m.readings, m.notes), (expected.readings.clone(), vec![]));
    }
    let other_order = "Deviation;Target;degC\n1,25;-10,5;20,1\n2,5;0;20,2\n";
    let m = csv(other_order).unwrap();
    assert_eq!(m.mean_curve(), [(-10.5, 1.25), (0.0, 2.5)]);
    assert_eq!(m.notes, ["columns that are not read: degC"]);
}

#[test]
fn units_in_the_header_are_read() {
    for (text, unit) in [
        ("target mm;deviation um\n0;1.5\n10;2.5\n", DeviationUnit::Um),
        ("target_mm,deviation_um\n0,1.5\n10,2.5\n", DeviationUnit::Um),
        ("target_mm,deviation (microns)\n0,1.5\n10,2.5\n", DeviationUnit::Um),
        ("target [mm],deviation [µm]\n0,1.5\n10,2.5\n", DeviationUnit::Um),
        ("target,deviation mm\n0,0.0015\n10,0.0025\n", DeviationUnit::Um),
        (
            "target in,deviation inch\n0,0.00005905511811\n0.393700787402,0.0000984251968504\n",
            DeviationUnit::Um,
        ),
        ("target deg,deviation (mrad)\n0,0.0015\n10,0.0025\n", DeviationUnit::Urad),
    ] {
        let m = csv(text).unwrap();
        assert_eq!((m.unit, m.notes.len()), (Some(unit), 0), "{text}");
        for ((target, found), (expected_at, expected)) in
            m.mean_curve().into_iter().zip([(0.0, 1.5), (10.0, 2.5)])
        {
            assert!((target - expected_at).abs() < 1e-9, "{text}: {target}");
            assert!((found - expected).abs() < 1e-9, "{text}: {found}");
        }
    }
    let refused = |text: &str| csv(text).unwrap_err().to_string();
    insta::assert_snapshot!(refused("target feet,deviation\n0,1\n"), @"x.csv:1: header: found targets in `feet`, expected mm, inch or deg: `target`, `target mm`, `target inch` or `target deg`");
    insta::assert_snapshot!(refused("target,deviation inch\n0,0\n10,0.0004\n"), @"x.csv:1: header: found deviations in inches and targets without a unit, expected `target inch`, `target mm` or `target deg`");
    insta::assert_snapshot!(refused("target,deviation thou\n0,1\n"), @"x.csv:1: header: found deviations in `thou`, expected one of µm, mm, nm, inch, µrad, mrad, rad, arcsec, deg: `deviation µm`");
    insta::assert_snapshot!(refused("target_mm,run,direction,deviation_mils\n0,1,+,1\n"), @"x.csv:1: header: found deviations in `mils`, expected one of µm, mm, nm, inch, µrad, mrad, rad, arcsec, deg: `deviation µm`");
    insta::assert_snapshot!(refused("target,target mm,deviation\n0,0,1\n"), @"x.csv:1: header: column `target` appears twice");
}

/// Among numbers with decimal commas, `1.234` could mean 1234. It is rejected with its line.
#[test]
fn a_point_among_decimal_commas_is_refused() {
    let error = csv("target;deviation\n0;1,5\n1.234;2,5\n").unwrap_err();
    insta::assert_snapshot!(error, @"x.csv:3: target: found `1.234`, expected a number with a decimal comma as in line 2");
    assert!(matches!(error, MetrologyError::Table(_)));
}

#[test]
fn written_tables_read_back_exactly() {
    let text = "target,run,direction,deviation\n0.1,1,+,0.30000000000000004\n-7.25,3,-,-123456.789012345\n";
    let m = csv(text).unwrap();
    assert_eq!(write_csv(&m), text);
}

#[test]
fn written_tables_state_their_units() {
    let mut m = csv("target,run,direction,deviation\n0,1,+,1.5\n").unwrap();
    for (axis, unit, head) in [
        ("X", DeviationUnit::Um, "target_mm,run,direction,deviation_um"),
        ("C", DeviationUnit::Urad, "target_deg,run,direction,deviation_urad"),
        ("", DeviationUnit::Urad, "target,run,direction,deviation_urad"),
    ] {
        m.metadata.axis = Some(axis.to_owned());
        m.unit = Some(unit);
        let text = write_csv(&m);
        assert_eq!(text, format!("{head}\n0,1,+,1.5\n"));
        let again = csv(&text).unwrap();
        assert_eq!((again.unit, &again.readings), (Some(unit), &m.readings));
        assert_eq!(again.notes, Vec::<String>::new());
    }
}

#[test]
fn incomplete_or_suspicious_tables_are_noted() {
    let notes = |text: &str| csv(text).unwrap().notes.join("\n");
    let unfinished = BIDIRECTIONAL.trim_end();
    insta::assert_snapshot!(notes(unfinished), @"the last line does not end in a line break: the file may be cut off");
    let lacking = BIDIRECTIONAL.replace("10,1,-,-2.25\n", "") + "0,2,+,1\n";
    insta::assert_snapshot!(notes(&lacking), @r"
    run 2 + holds 1 of 3 targets
    run 1 - holds 2 of 3 targets
    2 runs forward, 1 backward
    not all runs hold all targets: for curves the runs are aligned at common targets, by their offsets and for straightness also by their slopes; ISO 230-2 uses the readings as they are
    ");
    let zeros = BIDIRECTIONAL.replace("-2.25", "0").replace("3.00", "0").replace("4.25", "0");
    insta::assert_snapshot!(notes(&zeros), @"every backward reading is exactly 0: if the test was unidirectional, leave those rows out");
}

/// A truncated table is rejected or noted. The exception is a table that ends after a complete row of its first run,
/// which cannot be recognised as truncated.
#[test]
fn a_table_cut_anywhere_is_refused_or_noted() {
    for cut in 0..BIDIRECTIONAL.len() {
        let text = &BIDIRECTIONAL[..cut];
        let lines = text.lines().count();
        let in_the_first_run = text.ends_with('\n') && (2..=4).contains(&lines);
        match csv(text) {
            Ok(m) => assert!(in_the_first_run || !m.notes.is_empty(), "{text:?}"),
            Err(_) => assert!(!in_the_first_run),
        }
    }
    let inside_the_last_number = BIDIRECTIONAL.len() - 2;
    let error = csv(&BIDIRECTIONAL[..inside_the_last_number]).unwrap_err();
    assert!(matches!(error, MetrologyError::Truncated(_)));
}

#[test]
fn targets_are_in_the_unit_of_their_axis() {
    for (head, fits_x, fits_c) in [
        ("target", true, true),
        ("target_mm", true, false),
        ("Target [deg]", false, true),
        ("target °", false, true),
    ] {
        let text = format!("{head},deviation\n0,1\n10,2\n");
        let measurement = parse_csv(text.as_bytes(), "m.csv").unwrap();
        for (axis, fits) in [("X", fits_x), ("C", fits_c)] {
            let checked = measurement.check_targets(axis.parse().unwrap());
            assert_eq!(checked.is_ok(), fits, "{head} {axis}");
        }
    }
    let measurement = parse_csv(b"target deg,deviation\n0,1\n", "m.csv").unwrap();
    assert_eq!(
        measurement.check_targets("X".parse().unwrap()).unwrap_err().to_string(),
        "m.csv: the head of the targets: found `target deg`, expected `target` or `target mm` for axis X"
    );
}

fn wide_csv(text: &str) -> Result<Measurement, MetrologyError> {
    parse_csv(text.as_bytes(), "x.csv")
}

fn refused(text: &str) -> String {
    wide_csv(text).expect_err("refused").to_string()
}

/// Readings sorted by direction, then run, then target.
fn sorted(text: &str) -> Vec<Reading> {
    let mut readings = wide_csv(text).unwrap_or_else(|error| panic!("{error}\n{text}")).readings;
    readings.sort_by(|a, b| {
        let key = |r: &Reading| (r.direction == Direction::Negative, r.run);
        key(a).cmp(&key(b)).then(a.target.total_cmp(&b.target))
    });
    readings
}

/// Deviations of four passes at three targets, µm, with a row for each reading.
const LONG: &str = "target mm,run,direction,deviation um
0,1,+,0.5\n100,1,+,-2.5\n200,1,+,3.25
0,1,-,4.5\n100,1,-,1.5\n200,1,-,7.25
0,2,+,0.25\n100,2,+,-2.25\n200,2,+,3
0,2,-,4.75\n100,2,-,1.25\n200,2,-,7.5
";

/// The same readings with a row for each target.
const WIDE: &str = "Target (mm),Run 1 fwd (µm),Run 1 bwd (µm),Run 2 fwd (µm),Run 2 bwd (µm)
0,0.5,4.5,0.25,4.75\n100,-2.5,1.5,-2.25,1.25\n200,3.25,7.25,3,7.5
";

fn same(wide: &str) {
    for (found, expected) in sorted(wide).iter().zip(sorted(LONG)) {
        assert_eq!((found.run, found.direction), (expected.run, expected.direction), "{wide}");
        assert!((found.target - expected.target).abs() < 1e-9, "{wide}");
        let difference = found.deviation - expected.deviation;
        assert!(difference.abs() < 1e-6, "{wide}: {difference}");
    }
    assert_eq!(sorted(wide).len(), 12);
}

#[test]
fn deviations_in_columns() {
    same(WIDE);
    for [one, other] in [
        ["Forward 1", "Reverse 1"],
        ["F1", "R1"],
        ["F1", "B1"],
        ["Run 1 +", "Run 1 -"],
        ["1 ↑", "1 ↓"],
        ["Run 1 - fwd", "Run 1 - bwd"],
        ["1. run forward", "1. run backward"],
        ["Run 1(+)", "Run 1(-)"],
        ["Pass 1 Fwd", "Pass 1 Back"],
        ["Run-1-forward", "run_1_backward"],
        ["Fwd deviation 1", "Bwd deviation 1"],
    ] {
        let two = |head: &str| head.replace('1', "2");
        let heads = [one.to_owned(), other.to_owned(), two(one), two(other)];
        let heads = heads.map(|head| format!("{head} µm")).join(",");
        let (_, rows) = WIDE.split_once('\n').unwrap();
        same(&format!("Target (mm),{heads}\n{rows}"));
    }
    // Runs without numbers are counted; columns that are not read are noted.
    let text = "target mm;fwd µm;bwd µm;fwd µm;bwd µm;mean fwd\n0;0,5;4,5;0,25;4,75;1\n100;-2,5;1,5;-2,25;1,25;1\n200;3,25;7,25;3;7,5;1\n";
    same(text);
    assert_eq!(wide_csv(text).unwrap().notes, ["columns that are not read: mean fwd"]);
}

/// Measured positions (target + deviation) in mm, inches or degrees are converted to deviations.
#[test]
fn measured_positions_in_columns() {
    let written = |heads: &str, mm_per_unit: f64| {
        let mut text = format!("{heads}\n");
        for (index, target) in [0.0, 100.0, 200.0].into_iter().enumerate() {
            let deviations =
                [0, 3, 6, 9].map(|pass| wide_csv(LONG).unwrap().readings[pass + index].deviation);
            let cells = deviations.map(|um| format!("{:.12}", (target + um * 1e-3) / mm_per_unit));
            writeln!(text, "{:.12},{}", target / mm_per_unit, cells.join(",")).expect("a string");
        }
        text
    };
    let runs = "Run 1 fwd,Run 1 bwd,Run 2 fwd,Run 2 bwd";
    let mm = written(&format!("Target (mm),{runs}"), 1.0);
    same(&mm);
    let read = wide_csv(&mm).unwrap();
    assert_eq!(
        (read.stated, read.unit.map(DeviationUnit::key)),
        (Some(ReadingUnit::Mm), Some("um"))
    );
    assert_eq!(
        read.notes,
        [
            "the columns of the runs are read as measured positions in mm, from which the targets are subtracted"
        ]
    );
    same(&written(&format!("target inch,{runs}"), 25.4));
    let stated = runs.replace("wd", "wd measured mm");
    let stated = written(&format!("target,{stated}"), 1.0);
    same(&stated);
    assert_eq!(wide_csv(&stated).unwrap().notes, Vec::<String>::new());
    // 90.001° at target 90°: the deviation of 0.001° is 17.4533 µrad.
    let read = wide_csv("target deg,fwd\n0,0\n90,90.001\n").unwrap();
    assert_eq!(read.unit.map(DeviationUnit::key), Some("urad"));
    assert!((read.readings[1].deviation - 1e3_f64.to_radians()).abs() < 1e-9);
    // Deviations in mm, inches and arcsec are small relative to the targets.
    for (text, expected) in [
        ("target mm,fwd mm\n0,0\n100,0.002\n", 2.0),
        ("target inch,fwd inch\n0,0\n4,0.0001\n", 2.54),
        ("target deg,fwd arcsec\n0,0\n90,2\n", 2e6_f64.to_radians() / 3600.0),
    ] {
        let found = wide_csv(text).unwrap().readings[1].deviation;
        assert!((found - expected).abs() < 1e-9, "{text}: {found}");
    }
}

#[test]
fn a_missing_reading_is_left_out() {
    let lacking = WIDE.replace("100,-2.5,1.5", "100,,1.5");
    let read = wide_csv(&lacking).unwrap();
    assert_eq!(read.readings.len(), 11);
    assert!(read.notes.join("\n").contains("run 1 + holds 2 of 3 targets"), "{:?}", read.notes);
}

#[test]
fn directions_in_words() {
    for [up, down] in
        [["forward", "backward"], ["Fwd", "Bwd"], ["f", "r"], ["FW", "rev"], ["up", "down"]]
    {
        let text = LONG.replace(",+,", &format!(",{up},")).replace(",-,", &format!(",{down},"));
        assert_eq!(wide_csv(&text).unwrap().readings, wide_csv(LONG).unwrap().readings);
    }
    assert_eq!(
        refused(&LONG.replace(",+,", ",left,")),
        "x.csv:2: direction: found `left`, expected `+` or `-`, `forward` or `backward`"
    );
}

#[test]
fn what_is_no_wide_table() {
    for (text, message) in [
        (
            "target mm,Run 1,Run 2\n0,1,2\n",
            "x.csv:1: header: found `Run 1`, expected the direction of each run in its head: `Run 1 fwd`, `Run 1 bwd`",
        ),
        (
            "target mm,Run 1 fwd,Run 1 forward\n0,1,2\n",
            "x.csv:1: header: found run 1 + again in `Run 1 forward`, expected each run + once",
        ),
        (
            "target mm,Run 1 fwd mm,Run 1 bwd µm\n0,1,2\n",
            "x.csv:1: header: found `Run 1 bwd µm`, expected the same unit and kind of values in the heads of all runs",
        ),
        (
            "target mm,fwd mm\n0,50\n100,20\n",
            "x.csv:1: header: found values that are neither near the targets nor small, expected measured positions or deviations: write `measured` or `deviation` into the heads of the runs",
        ),
        (
            "target,fwd\n0,0.001\n100,100.002\n",
            "x.csv:1: header: found measured positions without a unit, expected it in the head of the targets: `target mm`, `target deg`",
        ),
        (
            "target deg,fwd measured mm\n0,0.001\n100,100.002\n",
            "x.csv:1: header: found measured positions in mm, expected the kind of unit of the targets, which are subtracted",
        ),
        (
            "target mm,fwd\n0,a\n",
            "x.csv:2: reading: found `a`, expected a finite decimal number such as -12.5, at most 1e12",
        ),
        (
            "target mm,fwd\n0,1\n0,2\n",
            "x.csv:3: reading: found target 0 in run 1 + again (first in line 2), expected each target once in a run",
        ),
        (
            "Soll,Ist\n0,1\n",
            "x.csv:1: header: found `Soll,Ist`, expected the header `target,run,direction,deviation` or `target,deviation`, or a column for each run as `target mm,Run 1 fwd,Run 1 bwd`; state other heads with `columns = { target = …, deviation = … }` in the calibration file or as `[columns]` in a file of this name with `.toml` appended",
        ),
    ] {
        assert_eq!(refused(text), message);
    }
}

/// Measured positions with another zero, with the opposite sign, with an additional turn or with an outlier are not
/// read as deviations in µm.
#[test]
fn positions_that_are_shifted_are_refused() {
    let message = "x.csv:1: header: found values that are neither near the targets nor small, expected measured positions or deviations: write `measured` or `deviation` into the heads of the runs";
    for rows in [
        "-200,0.002\n-100,100.001\n0,199.998\n100,300.003\n200,400.001\n",
        "-200,200.002\n-100,100.001\n0,-0.002\n100,-99.999\n200,-200.003\n",
        "0,0.004\n90,90.002\n180,179.999\n270,270.001\n360,0.003\n",
        "0,0.004\n100,100.002\n200,799.999\n300,300.001\n400,400.003\n",
    ] {
        assert_eq!(refused(&format!("target mm,fwd\n{rows}")), message);
        assert!(wide_csv(&format!("target mm,fwd deviation\n{rows}")).is_ok(), "{rows}");
    }
    // Large deviations in µm are accepted.
    for rows in ["0,0\n10,40\n20,-35\n30,20\n40,5\n", "0,0\n100,40\n200,80\n300,120\n400,160\n"] {
        let read = wide_csv(&format!("target mm,fwd\n{rows}")).unwrap();
        assert_eq!((read.unit, read.readings[1].deviation), (None, 40.0));
    }
    // Two of three readings happen to be as far apart as their targets.
    let read = wide_csv("target mm,fwd\n0,3\n10,13.5\n20,5\n").unwrap();
    assert_eq!((read.unit, read.readings[1].deviation), (None, 13.5));
}

/// A table with deviations in inches and targets without a unit is rejected, with a row or a column for each run.
#[test]
fn inches_need_the_unit_of_the_targets() {
    let message = "x.csv:1: header: found deviations in inches and targets without a unit, expected `target inch`, `target mm` or `target deg`";
    for head in ["deviation inch", "fwd inch", "fwd deviation inch", "fwd measured inch"] {
        assert_eq!(refused(&format!("target,{head}\n0,0\n4,0.0001\n")), message);
        assert!(wide_csv(&format!("target inch,{head}\n0,0\n4,0.0001\n")).is_ok(), "{head}");
    }
}

/// Characters that may be units are not ignored: arc seconds would be read as µrad, thousandths as mm.
#[test]
fn unknown_signs_are_refused() {
    for head in ["Run 1 fwd [″]", "\"Run 1 fwd (\"\")\"", "fwd mm/1000", "fwd ×10 µm", "fwd %"]
    {
        let message = refused(&format!("target deg,{head}\n0,0\n90,2\n"));
        assert!(message.starts_with("x.csv:1: header: found "), "{message}");
    }
    assert_eq!(wide_csv("target deg,#1: fwd (arcsec)\n0,0\n90,2\n").unwrap().notes, [""; 0]);
}

/// A hyphen means the backward direction only if another column has a plus sign; a hyphen between words has no meaning.
#[test]
fn a_hyphen_is_a_direction_beside_a_plus_alone() {
    for heads in ["Run - 1,Run - 2", "Run 1 - µm,Run 2 - µm"] {
        let message = refused(&format!("target mm,{heads}\n0,0,1\n100,2,1\n"));
        assert!(
            message.ends_with(
                "expected the direction of each run in its head: `Run 1 fwd`, `Run 1 bwd`"
            ),
            "{message}"
        );
    }
    let read = wide_csv("target mm,+,-\n0,0,1\n100,2,1\n").unwrap();
    assert_eq!(read.readings[1].direction, Direction::Negative);
}

/// The column of the reversal values B is not read as a backward run.
#[test]
fn reversal_values_are_no_run() {
    for heads in ["fwd,bwd", "Run 1 fwd,Run 1 bwd"] {
        let read = wide_csv(&format!("target mm,{heads},B\n0,1,3,-2\n100,1,3,-2\n")).unwrap();
        assert_eq!(read.readings.len(), 4);
        assert_eq!(read.notes, ["columns that are not read: B"]);
    }
    // Beside F1 and B1, too, and beside R1 f: there R means run.
    for heads in ["F1,B1", "R1 f,R1 r"] {
        let read = wide_csv(&format!("target mm,{heads},B\n0,1,3,-2\n100,1,3,-2\n")).unwrap();
        assert_eq!(read.readings.len(), 4, "{heads}");
        assert_eq!(read.notes, ["columns that are not read: B"]);
    }
}

/// The repeatability R of ISO 230-2 for a direction, and the number of a position, are not readings.
#[test]
fn repeatabilities_and_position_numbers_are_no_runs() {
    for [fwd, bwd] in [["R fwd", "R bwd"], ["R+ (µm)", "R- (µm)"], ["R ↑", "R ↓"]] {
        let message =
            refused(&format!("target mm,Mean fwd,Mean bwd,{fwd},{bwd}\n0,1,3,2,2\n100,1,3,2,2\n"));
        assert!(message.contains("or a column for each run"), "{message}");
        let read =
            wide_csv(&format!("target mm,+,-,{fwd},{bwd}\n0,1,3,2,2\n100,1,3,2,2\n")).unwrap();
        assert_eq!(read.readings.len(), 4);
        assert_eq!(read.notes, [format!("columns that are not read: {fwd}, {bwd}")]);
    }
    // A second word for one direction is no second run.
    assert_eq!(
        refused("target mm,Rev,forward,reverse\n0,1,1,3\n100,1,1,3\n"),
        "x.csv:1: header: found `reverse`, expected a number in the heads of the runs, or the same head for all in a direction"
    );
    let read = wide_csv("Pos.,target mm,fwd,bwd\n1,0,1,3\n2,100,1,3\n").unwrap();
    assert_eq!(read.readings.len(), 4);
    assert_eq!(wide_csv("target mm,pos,neg\n0,1,3\n100,1,3\n").unwrap().readings.len(), 4);
}

/// Runs numbered from 0 are rejected, because the first run would be lost.
#[test]
fn run_zero_is_refused() {
    assert_eq!(
        refused("target mm,Run 0 fwd,Run 1 fwd\n0,1,3\n100,1,3\n"),
        "x.csv:1: header: found `Run 0 fwd`, expected runs numbered from 1"
    );
}
