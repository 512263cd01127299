//! HEIDENHAIN: files equal the known formats.

use volcomp_tables::axis_table::{
    AxisNumbers, AxisTable, Content, Format, TableOptions, WriteOptions, loss, read, sampled, write,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::{AxisName, Direction};
use volcomp_test_support::cases;

use super::{close, edges, file, inside, of_axes, options, over, own, refused, tables};

const COM: &str = "BEGIN AXIS_X.COM MM\nNR AXISPOS BACKLASH X Y\n0 +0.0000 +0.0010 +0.0000 +0.0030\n1 +50.0000 +0.0050 +0.0040 -0.0020\n[END]\n";

#[test]
fn the_table_of_a_tnc_640() {
    let (found, warnings) = tables(Format::HeidenhainTnc640, "AXIS_X.COM", COM);
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(edges(&found[0]), [(0.0, 0.0), (50.0, 0.004)]);
    let behind = found[0].deviation(50.0, Some(Direction::Negative));
    close(behind, 0.005, 1e-12);
    assert_eq!((found[1].input, found[1].output), (AxisName::X, AxisName::Y));
    assert_eq!(found[1].backward, None);
}

#[test]
fn the_cma_says_which_axis_is_the_input() {
    let cma = "BEGIN CONFIG.CMA MM\nNR ACTIVE X Y\n0 - AXIS_X AXIS_X\n1 * AXIS_Q AXIS_X\n[END]\n";
    let files = [
        file("CONFIG.CMA", &cma.replace(" - ", " = ")),
        file("AXIS_X.COM", &COM.replace("BACKLASH X Y", "BACKLASH Y X")),
    ];
    let found = read(Format::HeidenhainTnc640, &files, &options()).expect("read");
    let found = of_axes(found.content);
    assert!(found.iter().all(|table| table.input == AxisName::Y));
    for (line, expected) in [("* OTHER", "does not name this table"), ("- AXIS_X", "ACTIVE")] {
        let cma = format!("BEGIN C.CMA MM\nNR ACTIVE X\n0 {line}\n[END]\n");
        let files = [file("CONFIG.CMA", &cma), file("AXIS_X.COM", COM)];
        let message = read(Format::HeidenhainTnc640, &files, &options()).expect_err(line);
        assert!(message.to_string().contains(expected), "{message}");
    }
}

fn table(step: f64, count: u32, input: AxisName, slope: f64) -> AxisTable {
    let at = |n: u32| inside(input, step * f64::from(n));
    let positions: Vec<f64> = (0..count).map(at).collect();
    let forward = positions.iter().map(|at| slope * at).collect();
    own(input, positions, forward)
}

#[test]
fn limits_of_the_control() {
    use AxisName::{C, X};
    for (step, most, axis, slope, expected) in [
        (1.0, 256, X, 1e-4, "257 positions, expected at most 256"),
        (15.0, 25, C, 1e-5, "0 to 360 deg"),
    ] {
        let written = |count: u32| {
            let content = Content::Axes(vec![table(step, count, axis, slope)]);
            write(Format::HeidenhainTnc640, &content, &WriteOptions::default())
        };
        written(most).expect("written");
        let message = written(most + 1).expect_err("refused").to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn refusals_name_line_found_and_expected() {
    let format = Format::HeidenhainTnc640;
    let message = |text: &str| refused(format, "AXIS_X.COM", text);
    assert!(message("hello\n").starts_with("AXIS_X.COM:1: found `hello`"));
    for [right, wrong, expected] in &cases(
        "
+50.0000 | +0.0000 | :4: found a position that does not increase
-0.0020 | | :4: found 4 cells, expected 5
-0.0020 | x | :4: found `x`, expected a number
COM MM | COM INCH | found INCH
",
    ) {
        let found = message(&COM.replace(right.as_str(), wrong));
        assert!(found.contains(expected.as_str()), "{found}");
    }
    let no_play = COM.replace("+0.0010", "+0").replace("+0.0050", "+0");
    for (text, expected) in
        [(COM.replace("[END]\n", ""), "no [END]"), (no_play, "BACKLASH is 0 everywhere")]
    {
        let (_, warnings) = tables(format, "AXIS_X.COM", &text);
        assert!(warnings[0].contains(expected), "{warnings:?}");
    }
}

/// Machine with a rotary table C that has a first harmonic of 25 µrad and a reversal value of 4 µrad.
fn turning(modulo: &str, travel: &str) -> Machine {
    Machine::parse(
        &format!(
            "structure = \"w C' A' b X Y Z t\"\ncorrect = [\"X\", \"Y\", \"Z\", \"C\", \"A\"]\n[axes]\nC.travel = {travel}\n{modulo}X.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\nA.travel = [20.0, 90.0]\n[errors]\n\
             ECC = {{ mean = {{ fourier = [3.0, 10.0, 25.0], period = 360.0 }}, reversal = 4.0 }}\n"
        ),
        "m.toml",
    )
    .expect("a machine")
}

#[test]
fn a_turn_from_minus_180_deg_is_written_from_0_to_360() {
    use AxisName::{A, C};
    let format = Format::HeidenhainTnc640;
    // With A at 0, C rotates about the tool axis and corrects nothing.
    let tilted = TableOptions { at: vec![(A, 30.0)], ..TableOptions::default() };
    for (modulo, travel) in [
        ("C.modulo = 360.0\n", "[-180.0, 180.0]"),
        ("", "[-180.0, 180.0]"),
        ("C.modulo = 360.0\n", "[-90.0, 270.0]"),
    ] {
        let machine = turning(modulo, travel);
        let content = sampled(&machine, &Temperatures::new(), &tilted, format).expect("tables");
        let made = write(format, &content, &WriteOptions::default()).expect("written");
        assert_eq!(made.left_out, [], "{format} {:?}", made.notes);
        let message = |note: &String| note.contains("written from 0 to 360 deg");
        assert!(made.notes.iter().any(message), "{format} {travel} {content:?}");
        let back = read(format, &made.files, &options()).expect("read");
        let (back, given) = (of_axes(back.content), of_axes(content));
        let (back, given) = (over(&back, C, C), over(&given, C, C));
        let edges = edges(back);
        assert_eq!((edges.len(), edges[0].0, edges[24].0), (25, 0.0, 360.0));
        // Half a digit of the file, rad.
        let resolution = 0.51e-4_f64.to_radians();
        for (node, at) in given.positions.iter().enumerate() {
            let angle = *at;
            let mean = (3.0 + 10.0 * angle.cos() + 25.0 * angle.sin()) * 1e-6;
            let found = back.deviation(*at, None);
            close(found, mean, 2.0 * resolution);
            close(found, given.mean()[node], 2.0 * resolution);
            for (direction, half) in Direction::BOTH.into_iter().zip([2e-6, -2e-6]) {
                let found = back.deviation(*at, Some(direction));
                close(found, mean + half, resolution);
            }
        }
        // The loss compares the file as read back with the model: half a digit plus the interpolation error.
        let write =
            WriteOptions { axes: AxisNumbers::of_machine(&machine), ..WriteOptions::default() };
        let lost = loss(&machine, &Temperatures::new(), &tilted, format, &write).expect("compared");
        let of_c = lost.axes.iter().find(|found| found.axis == C);
        let of_c = of_c.expect("it is there");
        assert!(of_c.correction > 25.0, "{of_c:?}");
        assert!(of_c.largest < 4.0, "{of_c:?}");
    }
}

#[test]
fn steps_that_miss_0_begin_there() {
    let at = |deg: f64| (2.0 * deg.to_radians().sin(), deg.to_radians());
    let (forward, positions) = (0..=8).map(|n| at(-170.0 + 45.0 * f64::from(n))).unzip();
    let table =
        AxisTable { output: AxisName::X, modulo: true, ..own(AxisName::C, positions, forward) };
    let format = Format::HeidenhainTnc640;
    let content = Content::Axes(vec![table.clone()]);
    let made = write(format, &content, &WriteOptions::default()).expect("written");
    let back = read(format, &made.files, &options()).expect("read");
    let back = of_axes(back.content);
    let wanted: Vec<f64> = (0..=8).map(|n| 45.0 * f64::from(n)).collect();
    let found: Vec<f64> = edges(&back[0]).iter().map(|(at, _)| *at).collect();
    assert_eq!(found, wanted);
    for (at, value) in edges(&back[0]) {
        close(value, table.deviation(at.to_radians(), None), 0.51e-4);
    }
}

#[test]
fn tables_that_are_not_a_closed_turn_are_left_out() {
    let format = Format::HeidenhainTnc640;
    let given = |from: f64, last: f64| AxisTable {
        positions: (0..25).map(|n| (from + 15.0 * f64::from(n)).to_radians()).collect(),
        forward: (0..25).map(|n| if n == 24 { last } else { 1e-5 }).collect(),
        ..table(15.0, 25, AxisName::C, 0.0)
    };
    let x = table(15.0, 25, AxisName::X, 1e-5);
    let short = |mut table: AxisTable| {
        table.positions.pop();
        table.forward.pop();
        table
    };
    for (rotary, why) in [
        (
            given(-180.0, 1e-5 + 2e-6),
            "its two ends, which are one position there, deviate differently: C over C",
        ),
        (short(given(-180.0, 1e-5)), "holds 0 to 360 deg: C over C"),
    ] {
        let content = Content::Axes(vec![rotary.clone(), x.clone()]);
        let made = write(format, &content, &WriteOptions::default()).expect("written");
        assert_eq!(made.left_out, [(AxisName::C, AxisName::C)]);
        assert!(made.notes.iter().any(|note| note.contains(why)), "{:?}", made.notes);
    }
}
