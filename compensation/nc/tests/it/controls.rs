//! What the key `control` of the set-up file changes: each control with programs whose result is worked out by hand.

use std::fmt::Write as _;

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_nc::{Dialect, SetUp, Strategy};

use crate::identity::{compensated_in, verified_in};

/// X needs 1 µm for each millimetre of Y.
const ERRORS: &str = "[errors]\nEC0Y = 1000.0\n";
const LINEAR: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [-1000, 1000]\n[axes.Y]\ntravel = [-1000, 1000]\n[axes.Z]\ntravel = [-1000, 1000]\n";

/// The result of a program, or why there is none, with these lines of a set-up file.
fn result(setup: &str, program: &str) -> Result<String, String> {
    let setup = SetUp::parse(setup, "setup.toml").map_err(|error| error.to_string())?;
    let result = compensated_in(&setup, ERRORS, program.as_bytes());
    let (out, _) = result.map_err(|error| error.to_string())?;
    Ok(String::from_utf8(out).expect("text"))
}

const FANUC: &str = "control = \"fanuc\"\n";
const HAAS: &str = "control = \"haas\"\n";
const MAZAK: &str = "control = \"mazak\"\n";
const COUNTING: [&str; 3] = [FANUC, HAAS, MAZAK];

/// Coordinates without a point are least increments, and come out as such; zero is none of either manner.
#[test]
fn words_without_a_point_are_least_increments() {
    for control in COUNTING {
        for (program, expected) in [
            (
                "G21 G90\nG0 X50000 Y25000 Z0\nG1 Z-500 F200\nX60000\nY30000\n",
                "G21 G90\nG0 X50025 Y25000 Z0\nG1 Z-500 F200\nX60025\nY30000 X60030\n",
            ),
            // With points nothing is another number than elsewhere.
            (
                "G0 X50. Y25. Z0\nG1 Z-.5 F200\nX60.\nY30.\n",
                "G0 X50.025 Y25. Z0\nG1 Z-.5 F200\nX60.025\nY30. X60.030\n",
            ),
            // Inches: a ten-thousandth.
            (
                "G20\nG0 X10000 Y50000 Z0\nX20000\n",
                "G20\nG0 X10050 Y50000 Z0\nX20050\n",
            ),
            // The depth, the plane R and the angle of a rotation.
            (
                "G0 X0 Y0 Z50000\nG99 G81 X10000 Y100000 Z-5000 R2000 F100\nG80\n",
                "G0 X0 Y0 Z50000\nG99 G81 X10100 Y100000 Z-5000 R2000 F100\nG80\n",
            ),
            (
                "G54\nG68 X0 Y0 R90000\nG0 X10000 Y0\n",
                "G54\nG68 X0 Y0 R90000\nG0 X10000 Y-10\n",
            ),
            // A dwell, a feed and the level of smoothing are no coordinates.
            (
                "G0 X50. Y25. Z0\nG4 P1000\nG5.1 Q1 R5\nG1 X60. F200\n",
                "G0 X50.025 Y25. Z0\nG4 P1000\nG5.1 Q1 R5\nG1 X60.025 F200\n",
            ),
        ] {
            assert_eq!(
                result(control, program).as_deref(),
                Ok(expected),
                "{control}{program}"
            );
        }
    }
    // For other controls X60 is 60 mm.
    for control in ["", "control = \"linuxcnc\"\n", "control = \"grbl\"\n"] {
        let found = result(control, "G0 X50. Y25. Z0\nX60\n");
        assert_eq!(
            found.as_deref(),
            Ok("G0 X50.025 Y25. Z0\nX60.025\n"),
            "{control}"
        );
    }
}

/// Random programs in points and in increments: both results say the same numbers, and that of increments has no point but for a zero.
#[test]
fn increments_and_points_give_the_same_numbers() {
    let mut draw = ChaCha8Rng::seed_from_u64(41);
    for _ in 0..60 {
        let (mut points, mut increments) = (String::new(), String::new());
        let mut at = [10_000_i64, 100_000, 5_000];
        let mut write = |code: &str, words: &[(char, i64)]| {
            for (text, has_points) in [(&mut points, true), (&mut increments, false)] {
                text.push_str(code);
                for (letter, value) in words {
                    let _ = match has_points {
                        true => write!(text, " {letter}{:.3}", *value as f64 / 1000.0),
                        false => write!(text, " {letter}{value}"),
                    }; // writing to a String cannot fail
                }
                text.push('\n');
            }
        };
        write("G90 G17 G0", &[('X', at[0]), ('Y', at[1]), ('Z', at[2])]);
        for _ in 0..30 {
            let mut way = || draw.random_range(-40_000_i64..40_000) | 1;
            let (by, radius) = ([way(), way(), way()], way().abs() % 9000 + 1000);
            match draw.random_range(0..6) {
                0 => {
                    at[0] += by[0];
                    write("G1 F500", &[('X', at[0])]);
                }
                1 | 2 => {
                    at = std::array::from_fn(|axis| at[axis] + by[axis]);
                    write("G1 F500", &[('X', at[0]), ('Y', at[1]), ('Z', at[2])]);
                }
                3 => {
                    at[0] += 2 * radius;
                    write(
                        "G2 F500",
                        &[('X', at[0]), ('Y', at[1]), ('I', radius), ('J', 0)],
                    );
                }
                4 => {
                    at[0] += radius;
                    at[1] += radius;
                    write("G3 F500", &[('X', at[0]), ('Y', at[1]), ('R', radius)]);
                }
                _ => {
                    at[0] += by[0];
                    let hole = [('X', at[0]), ('Y', at[1]), ('Z', -7001), ('R', at[2] - 1)];
                    write("G98 G81 F500", &hole);
                    write("G80", &[]);
                }
            }
        }
        let [points, increments] = [&points, &increments].map(|program| result(FANUC, program));
        let (Ok(points), Ok(increments)) = (&points, &increments) else {
            assert_eq!(points, increments);
            continue;
        };
        let pairs = points.split_whitespace().zip(increments.split_whitespace());
        for (point, increment) in pairs {
            let value: f64 = increment[1..].parse().expect("a number");
            let is_counted = "XYZIJR".contains(&increment[..1]) && !increment.contains('.');
            let value = if is_counted { value / 1000.0 } else { value };
            let expected: f64 = point[1..].parse().expect("a number");
            assert!(
                point[..1] == increment[..1] && (value - expected).abs() < 1e-9,
                "{points}{increments}"
            );
        }
        assert_eq!(
            points.split_whitespace().count(),
            increments.split_whitespace().count()
        );
        assert!(!increments.contains('.'), "{increments}");
    }
}

/// Coordinates with and without a point in one program are refused until the set-up says what that means.
#[test]
fn both_manners_are_refused_until_it_is_stated() {
    let programs = [
        (
            "G0 X50. Y100. Z10.\nX60 Y25\n",
            "line 2: column 1: X60 has no decimal point",
        ),
        (
            "G0 X50. Y100 Z10.\n",
            "line 1: column 9: Y100 has no decimal point",
        ),
        (
            "G0 X50000 Y0\nX60.\n",
            "line 2: column 1: X60. has a decimal point",
        ),
        (
            "G0 X50. Y1.\nG2 X60. I5 J0 F1\n",
            "line 2: column 9: I5 has no decimal point",
        ),
        (
            "G0 Z5.\nG81 X1. Y1. Z-5. R2 F1\n",
            "line 2: column 18: R2 has no decimal point",
        ),
        (
            "G0 X50. Y1. A90\n",
            "line 1: column 13: A90 has no decimal point",
        ),
    ];
    for control in COUNTING {
        for (program, expected) in programs {
            let error = result(control, program).expect_err(program);
            assert!(error.starts_with(expected), "{error}");
            assert!(
                error.contains("without_point in the set-up file"),
                "{error}"
            );
        }
    }
    for (without_point, program, expected) in [
        (
            "increment",
            "G0 X50. Y100. Z10.\nX60 Y25\n",
            "G0 X50.100 Y100. Z10.\nX60 Y25\n",
        ),
        (
            "increment",
            "G0 X50. Y100. Z10.\nX60\nY50.\n",
            "G0 X50.100 Y100. Z10.\nX160\nY50. X0.110\n",
        ),
        (
            "unit",
            "G0 X50. Y100. Z10.\nX60 Y25\n",
            "G0 X50.100 Y100. Z10.\nX60.025 Y25\n",
        ),
        ("unit", "G0 X50 Y100\n", "G0 X50.100 Y100\n"),
    ] {
        for control in COUNTING.into_iter().chain([""]) {
            let setup = format!("{control}without_point = \"{without_point}\"\n");
            assert_eq!(
                result(&setup, program).as_deref(),
                Ok(expected),
                "{setup}{program}"
            );
        }
    }
}

/// A number that a program computes is none of increments, and needs a point where it is written out.
#[test]
fn computed_numbers_get_a_point() {
    let program = "G0 X0 Y0 Z0\nG1 X[#5420+20.] Y100. F100\n#1=50\nG1 X#1 Y100.\n";
    let found = result(
        "control = \"fanuc\"\nwithout_point = \"increment\"\n",
        program,
    );
    let expected = "G0 X0 Y0 Z0\nG1 X20.100 Y100. F100\n#1=50\nG1 X50.100 Y100.\n";
    assert_eq!(found.as_deref(), Ok(expected));
    // With no decimals, too, a number is no number of increments.
    let found = result("control = \"fanuc\"\n", "G0 X50. Y900.\nX-0.9\n");
    assert_eq!(found.as_deref(), Ok("G0 X50.900 Y900.\nX0.000\n"));
}

/// The result leads the tool where the program wants it, as the control reads both.
#[test]
fn increments_are_verified_as_increments() {
    let machine = format!(
        "{LINEAR}{ERRORS}EYX = {{ table = [[-1000, 0], [0, 0], [50, 20], [100, 0], [1000, 0]], interpolation = \"linear\" }}\n"
    );
    let program = "G21 G90 G17\nG0 X0 Y0 Z0\nG1 X100000 Y100000 F500\nG2 X0 Y100000 I-50000 J0\nG91\nG1 X1000 Y-50000\nG90 G0 X0 Y0\n";
    for strategy in [Strategy::Plain, Strategy::Floyd] {
        let (text, summary, found) =
            verified_in(Dialect::Rs274, [&machine, FANUC, program], strategy).expect("compensated");
        assert!(summary.counts.added > 4, "{text}");
        assert!(
            found.before.max_um > 20.0 && found.after.max_um < 2.0,
            "{text}{found:?}"
        );
        let has_point = |line: &str| line.contains('.') && line != "G0 X0 Y0 Z0";
        assert!(!text.lines().any(has_point), "{text}");
    }
}

/// What a set-up file may say of its control.
#[test]
fn the_control_is_stated_in_the_set_up() {
    for (setup, expected) in [
        ("control = \"okuma\"\n", "setup.toml:1: control"),
        (
            "control = \"linuxcnc\"\nwithout_point = \"unit\"\n",
            "setup.toml:2: without_point",
        ),
        (
            "control = \"siemens\"\nwithout_point = \"unit\"\n",
            "setup.toml:2: without_point",
        ),
        ("without_point = \"mm\"\n", "setup.toml:1: without_point"),
    ] {
        let error = result(setup, "").expect_err(setup);
        assert!(error.starts_with(expected), "{error}");
    }
    let error = result("control = \"heidenhain\"\n", "G0 X0\n").expect_err("another language");
    assert_eq!(
        error,
        "control of the set-up file: found heidenhain, whose programs are in the language heidenhain, but the program is read as rs274"
    );
}
