//! Rows of holes (L in G91) equal single holes.

use std::fmt::Write as _;

use volcomp_nc::Dialect;
use volcomp_test_support::rows;

use crate::{
    flow::text,
    random_programs::{Draw, judged, worn},
};

const SETUP: &str = "[start]\nX = 0.0\nY = 0.0\nZ = 0.0\n";

/// A row in incremental X and Y, or in polar coordinates, has the positions and deviations of its holes one by one in G90.
#[test]
fn holes_of_a_row_equal_single_holes() {
    for seed in 0..96 {
        let draw = &mut Draw::new(5000 + seed);
        let number = |draw: &mut Draw, most: f64| draw.thousandths(-most, most);
        let [x, y] = [number(draw, 100.0), number(draw, 100.0) + 150.0];
        let count = 1 + draw.below(5);
        let back = ["G98", "G99"][draw.below(2)];
        let deep = -draw.thousandths(1.0, 9.0);
        let mut row = format!("G90 G0 X{x} Y{y} Z20\n");
        let mut alone = row.clone();
        let is_polar = draw.below(2) == 0;
        let [dx, dy] = [number(draw, 20.0), number(draw, 20.0)];
        let [by, turn] = [number(draw, 10.0), number(draw, 15.0)];
        let way =
            if is_polar { format!("@{by:.3} ^{turn:.3}") } else { format!("X{dx:.3} Y{dy:.3}") };
        writeln!(row, "{back} G91 G81 {way} R-12.5 Z{deep:.3} L{count} F100").expect("a string");
        let (mut at, bottom) = ([x, y], 7.5 + deep);
        for place in 0..count {
            at = if is_polar {
                let angle = at[1].atan2(at[0]) + turn.to_radians();
                let radius = at[0].hypot(at[1]) + by;
                [radius * angle.cos(), radius * angle.sin()]
            } else {
                [at[0] + dx, at[1] + dy]
            };
            let words = match place {
                0 => format!("{back} G81 R7.5 Z{bottom:.3} F100 "),
                _ => String::new(),
            };
            writeln!(alone, "{words}X{:.6} Y{:.6}", at[0], at[1]).expect("a string");
        }
        let behind = "G80 G90\nG0 X10 Y20 Z30\nM2\n";
        (row, alone) = (row + behind, alone + behind);
        let machine = worn([6.0, -6.0][draw.below(2)]);
        let taken =
            |program: &str| judged(&machine, SETUP, Dialect::Rs274, program).expect("taken");
        let ((result, _, found), (_, _, expected)) = (taken(&row), taken(&alone));
        assert_eq!(found.path.len(), expected.path.len(), "{row}{alone}");
        for (found, expected) in found.path.iter().zip(&expected.path) {
            for axis in 0..3 {
                let off_mm = (found.tip_mm[axis] - expected.tip_mm[axis]).abs();
                assert!(off_mm < 2e-6, "{found:?} {expected:?} {row}");
                let off_um = (found.after_um[axis] - expected.after_um[axis]).abs();
                assert!(off_um < 0.15, "{found:?} {expected:?} {row} {result}");
            }
        }
    }
}

#[test]
fn a_row_is_unrolled_if_its_corrections_differ() {
    let program = "G0 X0 Y0 Z10\nG91 G81 X100 R-5 Z-5 L3 F100 (a row)\nG80\nM2\n";
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        text(scale, program),
        "G0 X0 Y0 Z10\n(G91 G81 X100 R-5 Z-5 L3 F100 a row)\nG91 G81 X99.990 R-5 Z-5 F100 (a row)\nX99.990\nX99.990\nG80\nM2\n"
    );
    // The axes have the correction already, so the row stays.
    let constant = "[errors]\nEXX = { poly = [10.0] }\n";
    assert_eq!(text(constant, program), program.replace("X0", "X-0.010"));
    // The first hole applies the correction, so only its increment differs.
    let step = "[errors]\nEXX = { table = [[0, 0], [100, -10], [1000, -10]], interpolation = \"linear\" }\n";
    assert_eq!(
        text(step, program),
        "G0 X0 Y0 Z10\n(G91 G81 X100 R-5 Z-5 L3 F100 a row)\nG91 G81 X100.010 R-5 Z-5 F100 (a row)\nX100.000\nX100.000\nG80\nM2\n"
    );
    // The holes have different heights.
    let bent = "[errors]\nEZX = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        text(bent, program),
        "G0 X0 Y0 Z10\n(G91 G81 X100 R-5 Z-5 L3 F100 a row)\nG91 G81 X100 R-5.010 Z-5 F100 (a row)\nX100.000 R-5.020\nX100.000 R-5.030\nG80\nM2\n"
    );
}

/// The tool starts slightly off the row: the polar increments are those of the program, not of the first hole.
#[test]
fn a_polar_row_may_start_off_its_circle() {
    let slight = "[errors]\nEXX = { poly = [0.3] }\n";
    let program = "G0 X100.0005 Y0 Z10\nG91 G81 ^30 R-5 Z-5 L3 F100\nG80\nM2\n";
    let result = text(slight, program);
    let mut at = [100.0005, 0.0];
    for line in result.lines().filter(|line| !line.starts_with('(')) {
        for (axis, letter) in ['X', 'Y'].into_iter().enumerate() {
            let word = line.split(' ').find_map(|word| word.strip_prefix(letter));
            if let Some(value) = word.map(|value| value.parse::<f64>().expect("a number")) {
                at[axis] = if line.starts_with("G0 ") { value } else { at[axis] + value };
            }
        }
    }
    let is_kept = result == program;
    assert!(is_kept || at[0].abs() < 1e-3 && (at[1] - 100.0).abs() < 1e-3, "{result}{at:?}");
}

/// Depth and plane R each get the correction at their own height: scale error of Z 50 µm/m, hole 200 mm deep.
#[test]
fn depth_and_plane_r_have_the_correction_at_their_height() {
    let scale = "[errors]\nEZZ = { poly = [0.0, 0.05] }\n";
    for [program, expected] in rows(
        r"
G0 X0 Y0 Z20\nG81 X10 R0 Z-200 F100\nX20\nX30 Z-100\nX40 R-40\nG80\nM2\n | G0 X0 Y0 Z19.999\nG81 X10 R0 Z-199.990 F100\nX20\nX30 Z-99.995\nX40 R-39.998\nG80\nM2\n
// In G91 R counts from the tool, which has a correction of 1 µm, and the depth from R.
G0 X0 Y0 Z20\nG91 G81 X10 R-20 Z-200 L2 F100\nX10 Z-100\nG80\nM2\n | G0 X0 Y0 Z19.999\n(G91 G81 X10 R-20 Z-200 L2 F100)\nG91 G81 X10 R-19.999 Z-199.990 F100\nX10.000\nX10 Z-99.995\nG80\nM2\n
",
    ) {
        assert_eq!(text(scale, program), expected);
    }
    // Only X depends on the depth: the hole is exact half-way down.
    let tilt = "[errors]\nEXZ = { poly = [0.0, 0.05] }\n";
    assert_eq!(
        text(tilt, "G0 X0 Y0 Z20\nG81 X10 R0 Z-200 F100\nG80\nM2\n"),
        "G0 X-0.001 Y0 Z20\nG81 X10.005 R0 Z-200 F100\nG80\nM2\n"
    );
}

/// Each hole of a row at one position gets a line with an axis word, because a line without one is not a hole.
#[test]
fn repeated_holes_at_one_position_have_a_word() {
    let tilt = "[errors]\nEYZ = { poly = [0.0, 0.4] }\n";
    assert_eq!(
        text(tilt, "G0 X0 Y0 Z20\nG91 G99 G81 R-10 Z-10 L3 F100\nG80\nM2\n"),
        "G0 X0 Y-0.008 Z20\n(G91 G99 G81 R-10 Z-10 L3 F100)\nG91 G99 G81 R-10 Z-10 F100 Y0.006\nX0.000\nX0.000\nG80\nM2\n"
    );
}
