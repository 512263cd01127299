//! Work offsets and shifts as LinuxCNC keeps them: what is expected here is what its interpreter (`rs274 -g`) makes of the programs.

use volcomp_nc::{Dialect, SetUp, Strategy, Verification};

use crate::identity::{begins, compensated_in, verified_in};

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

/// Where the axes of a machine without errors are at the end of each motion, mm.
fn places(program: &str) -> Vec<[f64; 2]> {
    let (_, found) = verified("", program);
    let ends = found.path.iter().filter(|place| place.begins);
    ends.map(|place| [place.tip_mm[0], place.tip_mm[1]])
        .collect()
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

/// The value that G10 L20 sets is a place in the coordinates of its own offset, which may be turned otherwise than those in force: the correction
/// that the axes carry is turned, too.
#[test]
fn a_turned_offset_is_set_with_its_own_correction() {
    let errors = "[errors]\nEXX = { poly = [-1000] }\n";
    let program = "G10 L2 P2 X0 Y0 Z0 R90\nG0 X10 Y20 Z0\nG10 L20 P2 X5 Y6\nG55\nG1 X7 Y6 F100\n";
    let (out, found) = verified(errors, program);
    // 1 mm along X of the machine is 1 mm against Y of the turned offset.
    assert!(out.contains("G0 X11.000 Y20"), "{out}");
    assert!(out.contains("G10 L20 P2 X5 Y5"), "{out}");
    assert!(out.ends_with("G1 X7 Y5.000 F100\n"), "{out}");
    assert!(found.after.max_um < 0.1, "{:?}", found.after);
}

/// The tool stays where it is while the offset in force changes under a shift: ways go on from there, places count with both.
#[test]
fn an_offset_in_force_changes_under_a_shift() {
    let program = "G90 G54\nG52 X5\nG10 L2 P1 X30\nG91 G0 X1\nG90 G0 X10\nG92 X3\nG10 L2 P1 X-20 Y7\nG91 G0 X1\nG90 G0 X2 Y1\nM2\n";
    // rs274: -34 + 5 + 30; 10 + 5 + 30; then a shift of 12: 54 + 12 - 20; 2 + 12 - 20.
    are_near(
        &places(program),
        &[[1.0, 0.0], [45.0, 0.0], [46.0, 0.0], [-6.0, 8.0]],
    );
}

/// Turned about its zero, the offset in force loses the shift in LinuxCNC's books: G91 X1 would go on from Y12.5 instead of Y15.
#[test]
fn an_offset_in_force_does_not_turn_under_a_shift() {
    for shift in ["G92 X5", "G52 Y-2"] {
        let turned = format!("G90 G54\n{shift}\nG10 L2 P1 X30 R30\nG91 G0 X1\nM2\n");
        let message = refused(&turned);
        begins(&message, "line 3: G10 L2 with R, which turns");
        // Neither where the shift is off, nor where another one is turned, nor where it stays as it was turned.
        for (from, to) in [
            (shift, "G92.2"),
            ("P1", "P2"),
            ("R30", "R0"),
            (shift, "G92 Z5"),
        ] {
            let other = turned.replace(from, to);
            assert_eq!(places(&other).len(), 1, "{other}");
        }
    }
    // rs274 -g: X-19.9808 Y15 with G92 X5 after the turn, turned by 30 deg about X30.
    let before = "G90 G54\nG10 L2 P1 R30\nG92 X5\nG10 L2 P1 X30\nG91 G0 X1\nM2\n";
    let (sin, cos) = 30_f64.to_radians().sin_cos();
    let [x, y] = [-19.9808 - 5.0, 15.0];
    are_near(
        &places(before),
        &[[cos * x - sin * y + 30.0, sin * x + cos * y]],
    );
}

/// G92.3 brings back what G92.2 has switched off, with the axes that were shifted since; what an earlier program has left is not known.
#[test]
fn a_shift_comes_back() {
    let program = "G92 X10\nG0 X0\nG92.2\nG0 X1\nG92.3\nG0 X2\nG92.2\nG92 Y5\nG0 X3 Y3\nG92.2\nG10 L2 P1 X30\nG0 X4 Y4\nG92.3\nG0 X5 Y5\nG92.1\nG92.3\nG0 X6 Y6\nM2\n";
    let expected = [
        [-10.0, 0.0],
        [1.0, 0.0],
        [-8.0, 0.0],
        [3.0, -2.0],
        [34.0, 4.0],
        [35.0, 0.0],
        [36.0, 6.0],
    ];
    are_near(&places(program), &expected);
    let message = refused("G0 X1\nG92.3\nG0 X2\n");
    begins(&message, "line 2: G92.3 before any G92, G52 or G92.1");
}

/// The corrected place at which an axis is set has more decimals than words have: none of what they lose stays in the offset, however often
/// it is set.
#[test]
fn a_zero_that_is_set_loses_nothing() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.01] }\nEYY = { poly = [0.0, 0.01] }\n";
    for set in ["G92 X0 Y0", "G10 L20 P1 X0 Y0"] {
        // A third of 100 mm, and so on from there: 0.33 µm were lost each time, or all of what is less than half a step.
        let step = format!("G0 X[100/3] Y[2/3]\n{set}\n");
        let program = format!("G90 G54\n{}G0 X10 Y10\nM2\n", step.repeat(9));
        let (text, found) = verified(errors, &program);
        assert!(
            found.after.max_um < 0.5 * 2_f64.sqrt() + 0.01,
            "{text}{found:?}"
        );
        // In inches steps are 2.54 µm.
        let inches = program.replace(set, &format!("G20 {set}\nG21"));
        let (text, found) = verified(errors, &inches);
        assert!(
            found.after.max_um < 0.5 * 2_f64.sqrt() + 0.01,
            "{text}{found:?}"
        );
    }
    // Where the place has no more decimals, the word has none either.
    let (text, _) = verified(errors, "G0 X100\nG92 X0\nM2\n");
    assert_eq!(text, "G0 X99.999\nG92 X-0.001\nM2\n");
}
