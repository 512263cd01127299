//! The note on the error at a zero that was probed without correction, compared with closed forms.

use volcomp_model::Machine;
use volcomp_nc::Dialect;

use crate::identity::{TRAVELS, written};

/// 10 µm along X, 20 µm along Y and 30 µm along Z.
const CONSTANT: &str = "[errors]\nEXX = 10.0\nEYY = 20.0\nEZZ = 30.0\n";
const OFF: &str = "G54 the machine is off by X 10.0 Y 20.0 Z 30.0 µm";
const START: &str = "[work_offset.G54]\nX = 200\nY = 150\nZ = -100\n[start]\nX = 0\nY = 0\nZ = 0\n";
const TABLE: &str = "structure = \"w C' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.C]\ntravel = [-360, 360]\ndirection = [0, 0, -1]\n[tool]\ngauge = [0, 0, 0]\nlength = 100\n[errors]\nEYY = 10.0\n";

fn note(dialect: Dialect, machine: &str, setup: &str, program: &str) -> Option<String> {
    let machine = Machine::parse(machine, "m.toml").expect("a machine");
    let (_, notes) = written(dialect, &machine, setup, program).expect(program);
    let zero = |note: &&String| note.contains(": at the zero of ");
    let mut found = notes.iter().filter(zero);
    let first = found.next()?;
    assert_eq!(found.next(), None, "one zero");
    let (what, _) = first.split_once(": where that zero").expect("what to do");
    Some(what.replace("at the zero of ", ""))
}

#[test]
fn the_first_cut_is_noted() {
    let machine = format!("{TRAVELS}{CONSTANT}");
    let heidenhain = "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S1000\n2 CYCL DEF 200 DRILLING ~\n  Q200=+2 ~\n  Q201=-20 ~\n  Q203=+0 ~\n  Q204=+50\n3 L X+0 Y+0 Z+50 R0 FMAX M3\n4 L X+10 Y+10 R0 FMAX M99\n5 END PGM A MM\n";
    for (dialect, program, line) in [
        (Dialect::Rs274, "G90 G54\nG0 X0 Y0 Z10\nG1 Z-1 F100\n", 3),
        (
            Dialect::Rs274,
            "G90 G54\nG0 X0 Y0 Z10\nG91 G98 G81 X10 Y0 Z-12 R-8 L3 F100\nG80 G90\nG1 X0 F100\n",
            3,
        ),
        (Dialect::Heidenhain, heidenhain, 9),
        (
            Dialect::Siemens,
            "G54 G90 G17 G71\nG0 X0 Y0 Z50\nMCALL CYCLE81(50,0,2,-20)\nX10 Y10\nMCALL\nM30\n",
            4,
        ),
        (
            Dialect::Siemens,
            "G54 G90 G17 G71\nG0 X0 Y0 Z50\nCYCLE81(50,0,2,-20)\nG1 X5 F100\nM30\n",
            3,
        ),
    ] {
        let found = note(dialect, &machine, START, program);
        assert_eq!(found, Some(format!("{line}: {OFF}")), "{program}");
    }
}

/// The note names only corrected axes, since only their correction is added to a work offset.
#[test]
fn uncorrected_axes_are_omitted() {
    for (correct, expected) in [
        ("", "X 10.0 Y 20.0 Z 30.0"),
        ("correct = [\"X\", \"Y\"]", "X 10.0 Y 20.0 Z 0.0"),
        ("correct = [\"Z\"]", "X 0.0 Y 0.0 Z 30.0"),
    ] {
        let machine = format!("{correct}\n{TRAVELS}{CONSTANT}");
        let program = "G90 G54 G0 X0 Y0 Z0\nG1 X10 F100\n";
        let found = note(Dialect::Rs274, &machine, START, program);
        assert_eq!(found, Some(format!("2: G54 the machine is off by {expected} µm")));
    }
    let machine = format!("correct = [\"X\"]\n{TRAVELS}[errors]\nEZZ = 30.0\n");
    let program = "G90 G54 G0 X0 Y0 Z0\nG1 X10 F100\n";
    assert_eq!(note(Dialect::Rs274, &machine, START, program), None);
}

/// 10 µm along Y of the bed are 10 µm along X of a table turned by 90°. With tool centre point control the work offset is in table
/// coordinates.
#[test]
fn a_centre_point_offset_is_an_offset_of_the_table() {
    let setup = |on: &str, c: &str| {
        format!(
            "{on}[work_offset.G54]\nX = 100\nY = 0\nZ = 0\nC = {c}\n[start]\nX = 0\nY = 100\nZ = 0\nC = 0\n"
        )
    };
    let plain = "G90 G54 G1 X0 Y0 Z0 C0 F100\nG1 X10\n";
    let on = "tool_centre_point = true\n";
    for (dialect, setup, program, line, expected) in [
        (Dialect::Rs274, setup(on, "90"), plain, 1, "X 10.0 Y 0.0"),
        (Dialect::Rs274, setup(on, "-90"), plain, 1, "X -10.0 Y 0.0"),
        (Dialect::Rs274, setup(on, "0"), plain, 1, "X 0.0 Y 10.0"),
        (Dialect::Rs274, setup("", "90"), plain, 1, "X 0.0 Y 10.0"),
        (
            Dialect::Siemens,
            setup("", "90"),
            "G54\nTRAORI\nG1 X0 Y0 Z0 C0 F100\n",
            3,
            "X 10.0 Y 0.0",
        ),
        (
            Dialect::Heidenhain,
            setup("", "90"),
            "0 BEGIN PGM A MM\n1 M128\n2 L X+0 Y+0 Z+0 C+0 F100\n3 END PGM A MM\n",
            3,
            "X 10.0 Y 0.0",
        ),
    ] {
        let found = note(dialect, TABLE, &setup, program);
        let expected = format!("{line}: G54 the machine is off by {expected} Z 0.0 µm");
        assert_eq!(found, Some(expected), "{setup}{program}");
    }
}

#[test]
fn own_zeros_of_the_program_are_not_noted() {
    let machine = format!("{TRAVELS}{CONSTANT}");
    let cuts = "G1 X10 Y0 Z0 F100\nG81 X5 Y0 Z-2 R1\nG80\n";
    for (begins, line) in [
        ("G92 X0 Y0 Z0\n", None),
        ("G92 Z0\n", None),
        ("G10 L2 P1 X200 Y150 Z-100\n", None),
        ("G10 L20 P1 X0\n", None),
        ("G0 X0 Y0 Z0\nG53 G0 X0\nG92 X0\n", None),
        // The zero of a second shift is at the same position.
        ("G92 X0 Y0 Z0\nG0 X5 Y5 Z5\nG92 X0 Y0 Z0\n", None),
        // Positions relative to the stated offset, another offset, and an ended shift.
        ("G0 X0 Y0 Z0\nG92 X5 Y5 Z5\n", Some(4)),
        ("G52 X5 Y5 Z5\n", Some(3)),
        ("G10 L2 P2 X5\n", Some(3)),
        ("G92 X0 Y0 Z0\nG1 X1 F100\nG92.1\n", Some(5)),
        // After a zero set by the program the stated one is active again.
        ("G10 L2 P2 X5\nG55 G1 X0 Y0 Z0 F100\nG54\n", Some(5)),
    ] {
        let program = format!("G90 G54\n{begins}{cuts}");
        let found = note(Dialect::Rs274, &machine, START, &program);
        assert_eq!(found, line.map(|line| format!("{line}: {OFF}")), "{program}");
    }
}
