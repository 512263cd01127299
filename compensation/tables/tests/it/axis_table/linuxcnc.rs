//! LinuxCNC's COMP_FILE: its rules, its documentation, and its formula in C.

use std::{fs, process::Command};

use volcomp_tables::axis_table::{
    AxisTable, Content, Format, TableOptions, WriteOptions, sampled, write,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::{AxisName, Direction};
use volcomp_test_support::peers;

use super::{close, own, refused, tables};

fn trims(table: &AxisTable) -> Vec<[f64; 2]> {
    let backward = table.backward.as_ref().unwrap_or(&table.forward);
    let both = table.forward.iter().zip(backward);
    both.map(|(a, b)| [-a, -b]).collect()
}

#[test]
fn the_two_file_types_have_opposite_signs() {
    let zero = "0.000 0.002 -0.003\n1.000 1.003 0.998\n";
    let one = "0 0.002 -0.003\n1 0.003 -0.004\n";
    // trim = nominal − actual.
    for (format, text, expected) in [
        (Format::Linuxcnc, zero, [-0.002, 0.003, -0.003, 0.002]),
        (Format::LinuxcncType1, one, [0.002, -0.003, 0.003, -0.004]),
    ] {
        let (found, _) = tables(format, "x.comp", text);
        for (found, expected) in trims(&found[0]).as_flattened().iter().zip(expected) {
            close(*found, expected, 1e-12);
        }
    }
}

#[test]
fn numbers_after_a_foreign_line_are_reported() {
    let text = "0 0 0\n1 1.1 1.1\n\n2 2.2 2.2\n# end\n3 3 3\n";
    let (found, warnings) = tables(Format::Linuxcnc, "X.comp", text);
    assert_eq!(found[0].positions.len(), 2);
    assert_eq!(
        warnings,
        [
            "X.comp:3: LinuxCNC stops reading here, because this is not a line of three numbers; 2 lines of numbers after it are ignored"
        ]
    );
    let (_, warnings) = tables(Format::Linuxcnc, "X.comp", "0 0 0\n1 1 1\n\n");
    assert!(warnings.is_empty(), "{warnings:?}");
    // Accepted by sscanf: text after the third number, signs, exponents.
    let text = "  -1e1\t-10.5 -9.5 # first\n+0 .5 -.5junk\n";
    let (found, _) = tables(Format::Linuxcnc, "X.comp", text);
    assert_eq!(found[0].positions, [-10.0, 0.0]);
    assert_eq!(found[0].forward, [-0.5, 0.5]);
    // A comment in the first line is rejected.
    let message = refused(Format::Linuxcnc, "X.comp", "# head\n0 0 0\n1 1 1\n");
    assert!(message.contains("0 lines of three numbers"), "{message}");
}

#[test]
fn limits_of_the_format() {
    let lines = |count: u32| -> String {
        let lines = (0..count).map(|n| format!("{n} {n}.001 {n}\n"));
        lines.collect()
    };
    let (found, _) = tables(Format::Linuxcnc, "X.comp", &lines(256));
    assert_eq!(found[0].positions.len(), 256);
    assert_eq!(
        refused(Format::Linuxcnc, "X.comp", &lines(257)),
        "X.comp:257: found a line 257, expected at most 256"
    );
    assert!(refused(Format::Linuxcnc, "X.comp", "0 0 0\n0 0 0\n").contains("strictly increasing"));
    let message = refused(Format::Linuxcnc, "table.comp", "0 0 0\n1 1 1\n");
    assert!(message.contains("the letter of the axis"), "{message}");
    let positions = (0..257).map(f64::from).collect();
    let content = Content::Axes(vec![own(AxisName::X, positions, vec![0.01; 257])]);
    let message = write(Format::Linuxcnc, &content, &WriteOptions::default()).expect_err("refused");
    let expected = "found 257 positions, expected at most 256";
    assert!(message.to_string().contains(expected), "{message}");
}

/// The code of control.c and usrmotintf.cc that computes what LinuxCNC adds to the motor command.
const PEER: &str = r"
import sys
kind, path = int(sys.argv[1]), sys.argv[2]
rows = []
for line in open(path):
    words = line.split()
    try:
        nominal, forward, reverse = (float(word) for word in words[:3])
    except ValueError:
        break
    if kind == 0:
        forward, reverse = nominal - forward, nominal - reverse
    rows.append((nominal, forward, reverse))
for point in sys.argv[3:]:
    at, which = float(point[1:]), 1 if point[0] == '+' else 2
    if at <= rows[0][0]:
        print(rows[0][which])
    elif at >= rows[-1][0]:
        print(rows[-1][which])
    else:
        for low, high in zip(rows, rows[1:]):
            if low[0] <= at < high[0]:
                share = (at - low[0]) / (high[0] - low[0])
                print(low[which] + share * (high[which] - low[which]))
                break
";

#[test]
fn its_formula_adds_the_correction_of_the_model() {
    let Some(python) = peers::python() else {
        return;
    };
    let machine = Machine::parse(
        "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [-100.0, 725.0]\nY.travel = [0.0, 500.0]\nZ.travel = [-400.0, 0.0]\n\
         [errors]\nEXX = { mean = { poly = [4.0, 0.05, -2.0e-5] }, reversal = 6.0 }\nEBX = { poly = [0.0, 0.04] }\n",
        "m.toml",
    )
    .expect("a machine");
    let options =
        TableOptions { step_mm: 25.0, at: vec![(AxisName::Z, -200.0)], ..TableOptions::default() };
    let steady = Temperatures::new();
    for (format, kind) in [(Format::Linuxcnc, "0"), (Format::LinuxcncType1, "1")] {
        let content = sampled(&machine, &steady, &options, format).expect("tables");
        let written = write(format, &content, &WriteOptions::default()).expect("written");
        let mut files = written.files.iter();
        let file = files.find(|file| file.name == "X.comp").expect("of X");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("X.comp");
        fs::write(&path, &file.text).expect("written");
        let points: Vec<(f64, Direction)> = [-100.0, 0.0, 25.0, 700.0, 725.0]
            .into_iter()
            .flat_map(|at| Direction::BOTH.map(|direction| (at, direction)))
            .collect();
        let mut call = Command::new(&python);
        call.args(["-c", PEER, kind]).arg(&path);
        for (at, direction) in &points {
            let is_positive = *direction == Direction::Positive;
            call.arg(format!("{}{at}", if is_positive { '+' } else { '-' }));
        }
        let output = call.output().expect("python runs");
        assert!(output.status.success(), "{output:?}");
        let said = String::from_utf8(output.stdout).expect("text");
        let trims = said.lines().map(|line| line.parse().expect("a number"));
        let trims: Vec<f64> = trims.collect();
        assert_eq!(trims.len(), points.len());
        for ((at, direction), trim) in points.iter().zip(trims) {
            let mut state =
                machine.state(&[(AxisName::X, *at), (AxisName::Z, -200.0)]).expect("a state");
            let index = machine.index_of(AxisName::X).expect("an axis");
            state.approach[index] = Some(*direction);
            let correction = machine.correction_at(&state, &steady, &machine.correction_options());
            close(trim, correction.delta[index], 1e-6);
        }
    }
}
