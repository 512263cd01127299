use volcomp_metrology::{DeviationUnit, Measurement, MetrologyError, parse_csv, write_csv};
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
