//! Work offsets and shifts on LinuxCNC; expected values are those of its interpreter (`rs274 -g`).

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
