//! Rows of balls: results equal closed forms, and invalid rows are rejected.

use std::fmt::Write as _;

use volcomp_test_support::cases;

use crate::lab::{Lab, value};

const MACHINE: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.Z.travel = [0.0, 300.0]
";
const ROW: &str = "ball,distance_mm,uncertainty_um\nA,0,0\nB,100,0\nC,200,0\nD,300,0\nE,400,0\n";
const UNKNOWN: &str =
    "folds = 0\nunknown = [{ error = \"EXX\", legendre = 1 }, { error = \"EYX\", legendre = 2 }]\n";
const OBSERVATION: &str =
    "[[observation]]\nkind = \"ball-row\"\nfile = \"read.csv\"\nrow = \"row.csv\"\n";

fn lab() -> Lab {
    let lab = Lab::new(MACHINE);
    lab.write("row.csv", ROW);
    lab
}

/// A scale that is 20 µm/m too long and a straightness of 4 µm in the middle are identified within 0.001 µm, from
/// indicators on a bar tilted by 150 µrad in the plane and by 80 µrad out of the plane.
#[test]
fn positioning_and_straightness_are_found_on_a_bar_that_lies_askew() {
    let lab = lab();
    let mut text = String::from("X,Y,Z,ball,along_um,side1_um,side2_um\n");
    for (k, ball) in ["A", "B", "C", "D", "E"].into_iter().enumerate() {
        let s = 100.0 * k as f64;
        // Tip minus ball, µm with s in mm. Along the row: positioning; to side 1: straightness and −tilt; to side 2:
        // −tilt. The bar tilted by 170 µrad is shorter along X by its cosine, 0.006 µm at its end.
        let along = 0.02 * s + 0.5e-3 * (0.15_f64.powi(2) + 0.08_f64.powi(2)) * s;
        let side1 = 4.0 * (1.0 - ((s - 200.0) / 200.0).powi(2)) - 0.15 * s;
        let side2 = -0.08 * s;
        let _ = writeln!(text, "{:?},30,20,{ball},{along:?},{side1:?},{side2:?}", 50.0 + s);
    }
    lab.write("read.csv", &text);
    let found = lab.identify(&format!("{UNKNOWN}{OBSERVATION}")).expect("found");
    assert!(found.residual.max_um < 1e-3, "{:?}", found.residual);
    // Legendre coefficients over the range, which is 0.1 % wider at both ends: 20 µm/m, and 4(1 − t²) = const − (8/3)
    // P2.
    let wider = 1.002;
    assert!((value(&found, "EXX legendre 1").0 - 4.0 * wider).abs() < 1e-3);
    assert!((value(&found, "EYX legendre 2").0 + 8.0 / 3.0 * wider * wider).abs() < 1e-3);
    // The slope of a straightness is indistinguishable from the tilt of the bar.
    assert!((value(&found, "read.csv:tilt.side1").0 - 150.0).abs() < 0.01);
    assert!((value(&found, "read.csv:tilt.side2").0 - 80.0).abs() < 0.01);
    assert!(
        crate::lab::words(&found).lines().any(|w| w.starts_with("left at zero by convention") && w.ends_with(", EYX legendre 1")),
        "{:?}",
        found.warnings
    );
}

/// Squareness error of the test below, µrad.
const URAD: f64 = 40.0;

/// Two rows across the table at ±45°, read by a touch probe: squareness lengthens one row and shortens the other. The
/// ball at distance √2·a is displaced by a·ε along X, which is a·ε/√2 along the row.
#[test]
fn squareness_from_rows_along_both_diagonals() {
    let lab = lab();
    for (file, sign) in [("rising.csv", 1.0), ("falling.csv", -1.0)] {
        let mut text = String::from("X,Y,ball\n");
        for (k, ball) in ["A", "B", "C", "D"].into_iter().enumerate() {
            let part = 100.0 * k as f64 * 0.5_f64.sqrt();
            let (x, y) = (100.0 + part, 200.0 + sign * (part - 100.0));
            // The tip of a command (x, y) is at (x − ε y, y): Y is rotated by ε about Z.
            let _ = writeln!(text, "{:?},{y:?},{ball}", x + URAD * 1e-6 * y);
        }
        lab.write(file, &text);
    }
    let observation = |file: &str| OBSERVATION.replace("read.csv", file);
    let text = format!(
        "folds = 0\nunknown = [\"EC0Y\"]\n{}{}",
        observation("rising.csv"),
        observation("falling.csv")
    );
    let found = lab.identify(&text).expect("found");
    let (squareness, uncertainty) = value(&found, "EC0Y");
    assert!((squareness - URAD).abs() < 1e-2, "{squareness}");
    // A slope of ε/2 along each of two rows, each with four balls read at 1 µm.
    let squares: f64 = [-150.0, -50.0, 50.0, 150.0_f64].iter().map(|s| s * s).sum();
    let expected = 1e3 * 2.0 / (2.0 * squares).sqrt();
    assert!((uncertainty / expected - 1.0).abs() < 1e-3, "{uncertainty} {expected}");
}

/// A distance calibrated within 2 µm and measured 3 µm ± 1 µm off gives the weighted mean of both values.
#[test]
fn a_calibrated_distance_is_one_more_observation() {
    let lab = lab();
    lab.write("row.csv", "ball,distance_mm,uncertainty_um\nA,0,0\nB,100,2\n");
    lab.write("read.csv", "X,ball,along_um,side1_um\n0,A,0,0\n100,B,3,0\n");
    let text = format!(
        "folds = 0\nunknown = [{{ error = \"EYX\", legendre = 1 }}]\n{OBSERVATION}origin = [0, 0, 0]\ndirection = [1, 0, 0]\n"
    );
    let found = lab.identify(&text).expect("found");
    let (distance, uncertainty) = value(&found, "row.csv:ball B");
    assert!((distance - (100.0 - 2.4e-3)).abs() < 1e-9, "{distance}");
    assert!((uncertainty - 0.8_f64.sqrt() * 1e-3).abs() < 1e-9, "{uncertainty}");
}

#[test]
fn invalid_ball_rows_are_refused() {
    const READ: &str = "X,ball,along_um\n0,A,0\n100,B,1\n200,C,2\n300,D,2\n400,E,1\n";
    let refused = |row: &str, table: &str, extra: &str| {
        let lab = lab();
        lab.write("row.csv", row);
        lab.write("read.csv", table);
        let text = format!("folds = 0\nunknown = [\"EXX\"]\n{OBSERVATION}{extra}\n");
        let found = lab.identify(&text).map(|_| ());
        found.map_err(|error| error.to_string())
    };
    let named = |message: Result<(), String>, expected: &str| {
        let message = message.expect_err(expected);
        assert!(message.contains(expected), "{message}\n{expected}");
    };
    refused(ROW, READ, "").expect("right");
    refused(ROW, READ, "origin = [0, 0, 0]").expect("right");
    for [row, expected] in &cases(
        r"
ball,distance_mm\nA,0\n | row.csv:1: header: found 1 balls, expected at least two
ball,distance_mm\nA,0\nA,3\n | ball `A` is listed twice
ball,distance_mm\nA,0\nB,0\n | found 0 mm, the position of ball `A`
ball,distance_mm\nA,nan\nB,2\n | expected a finite number
",
    ) {
        named(refused(row, READ, ""), expected);
    }
    for [table, expected] in &cases(
        r"
X,along_um\n0,1\n | expected a column `ball`
X,ball,along_um\n0,F,1\n | read.csv:2: ball: found `F`, expected a ball of row.csv: A, B, C, D, E
X,ball,along_um\n0,A,\n100,B,1\n | found no reading, expected at least one of
X,ball,along_um\n0,A,0\n10,A,1\n | readings at a single position of the row
X,ball,along_um\n0,A,0\n100,B,1\n150,C,2\n300,D,2\n400,E,1\n | read.csv:4: row: found a ball
X,Y,ball,side1_um\n0,0,A,0\n60,80,B,1\n120,160,C,2\n180,240,D,2\n240,320,E,1\n | expected `side1 = [x, y, z]`
",
    ) {
        named(refused(ROW, table, ""), expected);
    }
    for [extra, expected] in &cases(
        r"
direction = [-1, 0, 0] | from its nominal position on a straight bar
direction = [0, 0, 0] | found a zero direction
direction = [1, 0, 0]\nside1 = [2, 0, 0] | found the direction of the row itself
side1 = [2, 0, 0] | expected a direction across it
judge = true | found `judge = true` without a known origin
origin = [5, 0, 0] | origin: found an origin 5.0 mm from the position that the ball readings give, 5.0 mm of it along the row
origin = [0, 0, -4]\ndirection = [1, 0, 0] | found an origin 4.0 mm from the position that the ball readings give, 0.0 mm of it along the row
point = [1, 2, 3] | unknown key
",
    ) {
        named(refused(ROW, READ, extra), expected);
    }
    let lab = lab();
    lab.write("read.csv", READ);
    let message =
        lab.refused(&format!("{UNKNOWN}{}", OBSERVATION.replace("row = \"row.csv\"\n", "")));
    assert!(message.contains("key `row` is missing"), "{message}");
}
