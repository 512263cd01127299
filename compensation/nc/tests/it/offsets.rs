//! Work offsets and shifts on LinuxCNC, with values of its interpreter (`rs274 -g`).
//!
//! The note on the error at a zero that was probed without correction is compared with closed forms.

use volcomp_model::Machine;
use volcomp_nc::{Dialect, SetUp, Strategy, Verification};

use crate::identity::{TRAVELS, begins, compensated_in, verified_in, written};

const LINEAR: &str = "name = \"m\"\nstructure = \"w b X Y Z t\"\n[axes.X]\ntravel = [-5000, 5000]\n[axes.Y]\ntravel = [-5000, 5000]\n[axes.Z]\ntravel = [-5000, 5000]\n";
const START: &str =
    "[work_offset.G54]\nX = 0\n[work_offset.G55]\nX = 0\n[start]\nX = 0\nY = 0\nZ = 0\n";

fn verified(errors: &str, program: &str) -> (String, Verification) {
    let machine = format!("{LINEAR}{errors}");
    let texts = [&machine, START, program];
    let (text, _, found) =
        verified_in(Dialect::Rs274, texts, Strategy::Plain).expect("compensated and verified");
    (text, found)
}

/// Axis positions (mm) of a machine without errors at the end of each motion.
fn places(program: &str) -> Vec<[f64; 2]> {
    let (_, found) = verified("", program);
    let ends = found.path.iter().filter(|place| place.begins);
    ends.map(|place| [place.tip_mm[0], place.tip_mm[1]]).collect()
}

fn refused(program: &str) -> String {
    let setup = SetUp::parse(START, "setup.toml").expect("a good set-up");
    let refused = compensated_in(&setup, "", program.as_bytes());
    refused.expect_err(program).to_string()
}

fn are_near(found: &[[f64; 2]], expected: &[[f64; 2]]) {
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, expected) in found.iter().zip(expected) {
        let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
        assert!(off < 2e-4, "{found:?}, expected {expected:?}");
    }
}

/// G10 L20 sets a position in an offset with another rotation than the active one: the applied correction is rotated as well.
#[test]
fn a_rotated_offset_is_set_with_its_own_correction() {
    let errors = "[errors]\nEXX = { poly = [-1000] }\n";
    let program = "G10 L2 P2 X0 Y0 Z0 R90\nG0 X10 Y20 Z0\nG10 L20 P2 X5 Y6\nG55\nG1 X7 Y6 F100\n";
    let (out, found) = verified(errors, program);
    // 1 mm along machine X is 1 mm against Y of the rotated offset.
    assert!(out.contains("G0 X11.000 Y20"), "{out}");
    assert!(out.contains("G10 L20 P2 X5 Y5"), "{out}");
    assert!(out.ends_with("G1 X7 Y5.000 F100\n"), "{out}");
    assert!(found.after.max_um < 0.1, "{:?}", found.after);
}

/// The active offset changes under a shift while the tool rests: incremental motions continue from there, and positions include both.
#[test]
fn the_active_offset_may_change_under_a_shift() {
    let program = "G90 G54\nG52 X5\nG10 L2 P1 X30\nG91 G0 X1\nG90 G0 X10\nG92 X3\nG10 L2 P1 X-20 Y7\nG91 G0 X1\nG90 G0 X2 Y1\nM2\n";
    // rs274: -34 + 5 + 30; 10 + 5 + 30; then a shift of 12: 54 + 12 - 20; 2 + 12 - 20.
    are_near(&places(program), &[[1.0, 0.0], [45.0, 0.0], [46.0, 0.0], [-6.0, 8.0]]);
}

/// Rotating the active offset about its zero under a shift is refused: LinuxCNC loses the shift, and G91 X1 would continue from
/// Y12.5 instead of Y15.
#[test]
fn the_active_offset_may_not_rotate_under_a_shift() {
    for shift in ["G92 X5", "G52 Y-2"] {
        let turned = format!("G90 G54\n{shift}\nG10 L2 P1 X30 R30\nG91 G0 X1\nM2\n");
        let message = refused(&turned);
        begins(&message, "line 3: G10 L2 with R, which rotates");
        // The shift remains if it is off, if another offset is rotated, or if the rotation does not change.
        for (from, to) in [(shift, "G92.2"), ("P1", "P2"), ("R30", "R0"), (shift, "G92 Z5")] {
            let other = turned.replace(from, to);
            assert_eq!(places(&other).len(), 1, "{other}");
        }
    }
    // rs274 -g: X-19.9808 Y15 with G92 X5 after the rotation, rotated by 30° about X30.
    let before = "G90 G54\nG10 L2 P1 R30\nG92 X5\nG10 L2 P1 X30\nG91 G0 X1\nM2\n";
    let (sin, cos) = 30_f64.to_radians().sin_cos();
    let [x, y] = [-19.9808 - 5.0, 15.0];
    are_near(&places(before), &[[cos * x - sin * y + 30.0, sin * x + cos * y]]);
}

/// G92.3 restores the shift that G92.2 switched off, together with later shifts. A shift from an earlier program is unknown.
#[test]
fn g92_3_restores_the_shift() {
    let program = "G92 X10\nG0 X0\nG92.2\nG0 X1\nG92.3\nG0 X2\nG92.2\nG92 Y5\nG0 X3 Y3\nG92.2\nG10 L2 P1 X30\nG0 X4 Y4\nG92.3\nG0 X5 Y5\nG92.1\nG92.3\nG0 X6 Y6\nM2\n";
    let expected =
        [[-10.0, 0.0], [1.0, 0.0], [-8.0, 0.0], [3.0, -2.0], [34.0, 4.0], [35.0, 0.0], [36.0, 6.0]];
    are_near(&places(program), &expected);
    let message = refused("G0 X1\nG92.3\nG0 X2\n");
    begins(&message, "line 2: G92.3 before any G92, G52 or G92.1");
}

/// G92 and G10 L20 at a corrected position round the new coordinate: the rounding error does not stay in the offset,
/// however often they are repeated.
#[test]
fn setting_a_zero_keeps_the_correction() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.01] }\nEYY = { poly = [0.0, 0.01] }\n";
    for set in ["G92 X0 Y0", "G10 L20 P1 X0 Y0"] {
        // With steps of 100/3 mm, 0.33 µm or all corrections below half a step would be lost each time.
        let step = format!("G0 X[100/3] Y[2/3]\n{set}\n");
        let program = format!("G90 G54\n{}G0 X10 Y10\nM2\n", step.repeat(9));
        let (text, found) = verified(errors, &program);
        assert!(found.after.max_um < 0.5 * 2_f64.sqrt() + 0.01, "{text}{found:?}");
        // In inches a step is 2.54 µm.
        let inches = program.replace(set, &format!("G20 {set}\nG21"));
        let (text, found) = verified(errors, &inches);
        assert!(found.after.max_um < 0.5 * 2_f64.sqrt() + 0.01, "{text}{found:?}");
    }
    // If the position needs no more decimals, the word gets none.
    let (text, _) = verified(errors, "G0 X100\nG92 X0\nM2\n");
    assert_eq!(text, "G0 X99.999\nG92 X-0.001\nM2\n");
}

/// 10 µm along X, 20 µm along Y and 30 µm along Z.
const CONSTANT: &str = "[errors]\nEXX = 10.0\nEYY = 20.0\nEZZ = 30.0\n";
const OFF: &str = "G54 the machine is off by X 10.0 Y 20.0 Z 30.0 µm";
const STATED: &str =
    "[work_offset.G54]\nX = 200\nY = 150\nZ = -100\n[start]\nX = 0\nY = 0\nZ = 0\n";
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
        let found = note(dialect, &machine, STATED, program);
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
        let found = note(Dialect::Rs274, &machine, STATED, program);
        assert_eq!(found, Some(format!("2: G54 the machine is off by {expected} µm")));
    }
    let machine = format!("correct = [\"X\"]\n{TRAVELS}[errors]\nEZZ = 30.0\n");
    let program = "G90 G54 G0 X0 Y0 Z0\nG1 X10 F100\n";
    assert_eq!(note(Dialect::Rs274, &machine, STATED, program), None);
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
        let found = note(Dialect::Rs274, &machine, STATED, &program);
        assert_eq!(found, line.map(|line| format!("{line}: {OFF}")), "{program}");
    }
}
