//! The key `control` of the set-up file: programs of each control, with results worked out by hand.

use std::fmt::Write as _;

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::Machine;
use volcomp_nc::{Dialect, Note, SetUp, Strategy};
use volcomp_test_support::{cases, rows};

use crate::identity::{
    TRAVELS, begins, compensated_in, has, notes_of, of_control, text_in, verified_in, written,
};

/// X is corrected by 1 µm per mm of Y.
const ERRORS: &str = "[errors]\nEC0Y = 1000.0\n";

/// The result of a program with these set-up lines, or its error message.
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

/// Coordinates without a point are read and written in least increments; zero is the same in both notations.
#[test]
fn words_without_a_point_are_least_increments() {
    for control in COUNTING {
        for [program, expected] in rows(
            r"
G21 G90\nG0 X50000 Y25000 Z0\nG1 Z-500 F200\nX60000\nY30000\n | G21 G90\nG0 X50025 Y25000 Z0\nG1 Z-500 F200\nX60025\nY30000 X60030\n
// Numbers with a point have one meaning on all controls.
G0 X50. Y25. Z0\nG1 Z-.5 F200\nX60.\nY30.\n | G0 X50.025 Y25. Z0\nG1 Z-.5 F200\nX60.025\nY30. X60.030\n
// Inches: the increment is 0.0001 inch.
G20\nG0 X10000 Y50000 Z0\nX20000\n | G20\nG0 X10050 Y50000 Z0\nX20050\n
// Depth, plane R, and the angle of a rotation.
G0 X0 Y0 Z50000\nG99 G81 X10000 Y100000 Z-5000 R2000 F100\nG80\n | G0 X0 Y0 Z50000\nG99 G81 X10100 Y100000 Z-5000 R2000 F100\nG80\n
G54\nG68 X0 Y0 R90000\nG0 X10000 Y0\n | G54\nG68 X0 Y0 R90000\nG0 X10000 Y-10\n
// The numbers of a dwell, a feed and a smoothing level are not coordinates.
G0 X50. Y25. Z0\nG4 P1000\nG5.1 Q1 R5\nG1 X60. F200\n | G0 X50.025 Y25. Z0\nG4 P1000\nG5.1 Q1 R5\nG1 X60.025 F200\n
",
        ) {
            assert_eq!(result(control, program).as_deref(), Ok(expected), "{control}{program}");
        }
    }
    // On other controls X60 is 60 mm.
    for control in ["", "control = \"linuxcnc\"\n", "control = \"grbl\"\n"] {
        let found = result(control, "G0 X50. Y25. Z0\nX60\n");
        assert_eq!(found.as_deref(), Ok("G0 X50.025 Y25. Z0\nX60.025\n"), "{control}");
    }
}

/// A random program gives the same numbers if it is written with decimal points and in least increments. The result in
/// increments has no decimal point except in zero.
#[test]
fn increments_and_points_give_the_same_numbers() {
    let mut draw = ChaCha8Rng::seed_from_u64(41);
    let mut compared = 0;
    for _ in 0..60 {
        let (mut points, mut increments) = (String::new(), String::new());
        let mut at = [10_000_i64, 100_000, 5_000];
        let mut write = |code: &str, words: &[(char, i64)]| {
            for (text, has_points) in [(&mut points, true), (&mut increments, false)] {
                text.push_str(code);
                for (letter, value) in words {
                    let number = if has_points {
                        format!("{:.3}", *value as f64 / 1000.0)
                    } else {
                        format!("{value}")
                    };
                    let _ = write!(text, " {letter}{number}"); // writing to a String cannot fail
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
                    write("G2 F500", &[('X', at[0]), ('Y', at[1]), ('I', radius), ('J', 0)]);
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
        compared += 1;
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
        assert_eq!(points.split_whitespace().count(), increments.split_whitespace().count());
        assert!(!increments.contains('.'), "{increments}");
    }
    assert!(compared > 40, "{compared} of 60 are not refused");
}

/// A program that mixes coordinates with and without a decimal point is rejected until the set-up file states
/// `without_point`.
#[test]
fn mixed_decimal_points_are_refused_until_stated() {
    let programs = cases(
        r"
G0 X50. Y100. Z10.\nX60 Y25\n | line 2: column 1: X60 has no decimal point
G0 X50. Y100 Z10.\n | line 1: column 9: Y100 has no decimal point
G0 X50000 Y0\nX60.\n | line 2: column 1: X60. has a decimal point
G0 X50. Y1.\nG2 X60. I5 J0 F1\n | line 2: column 9: I5 has no decimal point
G0 Z5.\nG81 X1. Y1. Z-5. R2 F1\n | line 2: column 18: R2 has no decimal point
G0 X50. Y1. A90\n | line 1: column 13: A90 has no decimal point
",
    );
    for control in COUNTING {
        for [program, expected] in &programs {
            let error = result(control, program).expect_err(program);
            assert!(error.starts_with(expected), "{error}");
            has(&error, "without_point in the set-up file");
        }
    }
    for [without_point, program, expected] in &cases(
        r"
increment | G0 X50. Y100. Z10.\nX60 Y25\n | G0 X50.100 Y100. Z10.\nX60 Y25\n
increment | G0 X50. Y100. Z10.\nX60\nY50.\n | G0 X50.100 Y100. Z10.\nX160\nY50. X0.110\n
unit | G0 X50. Y100. Z10.\nX60 Y25\n | G0 X50.100 Y100. Z10.\nX60.025 Y25\n
unit | G0 X50 Y100\n | G0 X50.100 Y100\n
",
    ) {
        for control in COUNTING.into_iter().chain([""]) {
            let setup = format!("{control}without_point = \"{without_point}\"\n");
            assert_eq!(
                result(&setup, program).as_deref(),
                Ok(expected.as_str()),
                "{setup}{program}"
            );
        }
    }
}

#[test]
fn computed_numbers_get_a_point() {
    let program = "G0 X0 Y0 Z0\nG1 X[#5420+20.] Y100. F100\n#1=50\nG1 X#1 Y100.\n";
    let found = result("control = \"fanuc\"\nwithout_point = \"increment\"\n", program);
    let expected = "G0 X0 Y0 Z0\nG1 X20.100 Y100. F100\n#1=50\nG1 X50.100 Y100.\n";
    assert_eq!(found.as_deref(), Ok(expected));
    let found = result("control = \"fanuc\"\n", "G0 X50. Y900.\nX-0.9\n");
    assert_eq!(found.as_deref(), Ok("G0 X50.900 Y900.\nX0.000\n"));
}

#[test]
fn increments_are_verified_as_increments() {
    let machine = format!(
        "{TRAVELS}{ERRORS}EYX = {{ table = [[-1000, 0], [0, 0], [50, 20], [100, 0], [1000, 0]], interpolation = \"linear\" }}\n"
    );
    let program = "G21 G90 G17\nG0 X0 Y0 Z0\nG1 X100000 Y100000 F500\nG2 X0 Y100000 I-50000 J0\nG91\nG1 X1000 Y-50000\nG90 G0 X0 Y0\n";
    for strategy in [Strategy::Plain, Strategy::Floyd] {
        let (text, summary, found) =
            verified_in(Dialect::Rs274, [&machine, FANUC, program], strategy).expect("compensated");
        assert!(summary.counts.added > 4, "{text}");
        assert!(found.before.max_um > 20.0 && found.after.max_um < 2.0, "{text}{found:?}");
        let has_point = |line: &str| line.contains('.') && line != "G0 X0 Y0 Z0";
        assert!(!text.lines().any(has_point), "{text}");
    }
}

#[test]
fn the_control_is_stated_in_the_set_up() {
    for [setup, expected] in &cases(
        r#"
control = "okuma"\n | setup.toml:1: control
control = "linuxcnc"\nwithout_point = "unit"\n | setup.toml:2: without_point
control = "siemens"\nwithout_point = "unit"\n | setup.toml:2: without_point
without_point = "mm"\n | setup.toml:1: without_point
rotary_words = "wrapped"\n | setup.toml:1: rotary_words
"#,
    ) {
        let error = result(setup, "").expect_err(setup);
        assert!(error.starts_with(expected), "{error}");
    }
    let error = result("control = \"heidenhain\"\n", "G0 X0\n").expect_err("another language");
    assert_eq!(
        error,
        "control of the set-up file: found heidenhain, whose programs are in the language heidenhain, but the program is read as rs274"
    );
}

fn around(line: &str) -> String {
    format!("O0001\nG21 G90 G17 G54\nG0 X0 Y100. Z10.\n{line}\nG1 X10. F100.\nX20. F100.\nM30\n")
}

#[test]
fn common_codes_are_copied() {
    let expected = |line: &str| {
        around(line)
            .replace("X0 Y", "X0.100 Y")
            .replace("X10. F", "X10.100 F")
            .replace("X20. F", "X20.100 F")
    };
    for [controls, lines] in &cases(
        "
fanuc | G8 P1, G11, G13.1, G23, G25, G26, G40.1, G50, G50.1, G62, G63
fanuc | G67, G04 X2., G4 U1.5, G4 X2, M70, M73, M430, G10 L12 P1 R5., G10 L13 P1 R0.02
haas | G50, G100, G103 P1, G103, G187 P1 E0.005, G187 P3, M70, G10 L12 P1 R5.
mazak | G8 P1, G23, G50, G62, G67, G61.1, G5 P2, G04 X2.
fanuc haas mazak | G64 ;, G64 (a;b) ; (c), G05.1 Q1, G5 P10000, M29 S500, G61, G64, G9, M428, G80
",
    ) {
        for control in controls.split(' ') {
            let control = format!("control = \"{control}\"\n");
            for line in lines.split(", ") {
                let found = result(&control, &around(line));
                assert_eq!(found, Ok(expected(line)), "{control}");
            }
        }
    }
}

/// Controls, lines, and reasons for refusal.
const REFUSED: &str = r#"
 | G187 P1 E0.005 | G187 is not supported: it is supported with control = "haas" in the set-up file
 | G154 P3 | G154 is not supported: it is supported with control = "haas"
 | G54.1 P2 | G54.1 is not supported: it is supported with control = "fanuc" or "mazak"
fanuc | G103 P1 | G103 is not supported: it is supported with control = "haas"
fanuc | G223 | G223 is unknown: it may move an axis
fanuc | G5.1 Q2 X0 Y0 Z0 | smooth interpolation of the named axes
mazak | G5.1 Q1 X0 | smooth interpolation of the named axes
haas | G5.2 X0 Y0 | smooth interpolation of the named axes
fanuc | G30.1 X0 | G30.1 is not supported: it moves to a reference position
haas | G28.1 | G28.1 is not supported: it moves to a reference position
fanuc | G41.1 D1 | G41.1 is not supported: it turns the tool along the path
fanuc | G43.1 H1 | G43.1 is not supported: it applies the tool length along the tilted tool
fanuc | G7 X0 | G7 is not supported: it makes an axis hypothetical
haas | G112 | G112 is not supported: polar interpolation
haas | G8 | G8 is not supported: it is unknown for this control
fanuc | G59.1 | G59.1 is not supported
 | G31 Z-5. F50. | G31 is not supported: it ends at a signal
fanuc | G44 H1 Z10. | G44 is not supported: it subtracts a length
 | G51.1 X0 | G51.1 is not supported: it scales or mirrors
fanuc | G50 X0 | G50 with the word of an axis
haas | G51 P2. | G51 is not supported: it scales or mirrors
fanuc | G65 P9810 Z5. F1000. | G65 is not supported: it calls a macro
fanuc | G68.2 X0 Y0 Z0 I0 J30. K0 | G68.2 is not supported: a tilted plane
fanuc | G60 X10. | G60 is not supported: it approaches its target from one side
fanuc | G10 L10 P1 R50. | G10 that sets the length of a tool
fanuc | G10 P1 R50. | G10 that sets the length of a tool
 | G10 L12 P1 R5. | G10 with another L
fanuc | G10 L50 | G10 with another L
fanuc | G10 L20 X5. | G10 L20 without a P from 1 to 300
 | G04 X2. | a dwell (G4) with the word of an axis
haas | G04 X2. | a dwell (G4) with the word of an axis
fanuc | G04 X2. Y1. | a dwell (G4) with the word of an axis
fanuc | G54.1 | G54.1 without its own P from 1 to 300
fanuc | G54.1 P301 | G54.1 without its own P from 1 to 300
haas | G154 P100 | G154 without its own P from 1 to 99
haas | G10 L20 P100 X5. | G10 L20 without a P from 1 to 99
fanuc | G54 P0 | G54 without its own P from 1 to 300
fanuc | G54.1 P2 G81 X1. Y1. Z-1. R1. F1. | G54.1 without its own P from 1 to 300
 | G1 X10. Y110. ,R5. F100. | column 15: ,R is not supported: a rounded corner
fanuc | G1 X10. Y110. , C2. F100. | column 15: ,C is not supported: a chamfer
fanuc | G1 X50. F100.;X70. | column 15: found words after a semicolon
haas | G1 X50. F100. (a;b) ; G91 | column 23: found words after a semicolon
haas | M96 P40 Q5 | M96, which is not supported
fanuc | M97 P1000 | M97, which is not supported
 | M73 | M73, which is not supported
"#;

#[test]
fn unsupported_codes_are_refused_with_a_reason() {
    for [control, line, expected] in &cases(REFUSED) {
        let error = result(&of_control(control), &around(line)).expect_err(line);
        begins(&error, &format!("line 4: {expected}"));
    }
}

/// G52 and G92 together are refused on controls where they are two shifts and G92.1 ends one of them. LinuxCNC has a single shift.
#[test]
fn g52_and_g92_together_are_refused() {
    let starts = "[start]\nX = 0\nY = 0\nZ = 0\n";
    for (shifts, line, expected) in [
        ("G92 X5. Y5.\nG52 X50.\n", 5, Some("G52 while a G92 shift")),
        ("G52 X5.\nG92 Y3.\n", 5, Some("G92 while a G52 shift")),
        ("G92 X5. Y5.\nG92.1 X0.\n", 5, Some("G92.1 without Y")),
        ("G92 X5. Y5.\nG92.1 X0. Y0.\nG52 X5.\nG52 X0.\nG92 X5.\n", 0, None),
        ("G92 X5. Y5.\nG92.1\n", 0, None),
        ("G92 X5.\nG92.1 X0.\n", 0, None),
    ] {
        let program = around(shifts);
        let linuxcnc = format!("control = \"linuxcnc\"\n{starts}");
        assert!(result(&linuxcnc, &program).is_ok(), "{program}");
        for control in COUNTING {
            let found = result(&format!("{control}{starts}"), &program);
            match expected {
                Some(expected) => {
                    let error = found.expect_err(shifts);
                    let expected = format!("line {line}: {expected}");
                    assert!(error.starts_with(&expected), "{control}{error}");
                }
                None => assert!(found.is_ok(), "{control}{found:?}"),
            }
        }
    }
}

/// U, V and W are refused where they may mean incremental X, Y and Z, unless the machine has an axis W.
#[test]
fn incremental_u_v_w_are_refused() {
    for line in ["G1 U20. F100.", "G0 W-5.", "G28 U0. W0.", "G92 V5.", "G83 X1. W-2. R1. F1."] {
        for control in COUNTING {
            let error = result(control, &around(line)).expect_err(line);
            assert!(error.starts_with("line 4: "), "{error}");
            has(&error, " without such an axis in the machine file");
        }
        let other = result("", &around(line));
        assert!(other.is_err() || other.is_ok_and(|text| text.contains(line)), "{line}");
    }
    let machine = "structure = \"w X' W' b Y Z t\"\n[axes.X]\ntravel = [-1000, 1000]\n[axes.Y]\ntravel = [-1000, 1000]\n[axes.Z]\ntravel = [-1000, 1000]\n[axes.W]\ntravel = [-1000, 1000]\ndirection = [0, 0, 1]\n";
    let program = around("G0 W-5.");
    let taken = verified_in(Dialect::Rs274, [machine, FANUC, &program], Strategy::Plain);
    assert_eq!(taken.expect("taken").0, program);
}

/// Numbered work offsets of each control: X is corrected by 1 µm per mm of machine Y.
#[test]
fn work_offsets_have_numbers() {
    let setup = |control: &str, number: u32| {
        format!(
            "{control}[work_offset.P{number}]\nX = 100.0\nY = 400.0\n[work_offset.G54]\nX = 0.0\n"
        )
    };
    for (control, line, number) in [
        (FANUC, "G54.1 P300", 300),
        (MAZAK, "G54.1 P3", 3),
        (FANUC, "G54 P3", 3),
        (HAAS, "G154 P99", 99),
        (HAAS, "G110", 1),
        (HAAS, "G114", 5),
        (HAAS, "G129", 20),
    ] {
        let found = result(
            &setup(control, number),
            &format!("G90\nG0 X0 Y100. Z0\n{line}\nX10. Y100.\nG54\nX10. Y100.\n"),
        );
        let expected =
            format!("G90\nG0 X0.100 Y100. Z0\n{line}\nX10.500 Y100.\nG54\nX10.100 Y100.\n");
        assert_eq!(found, Ok(expected), "{control}");
    }
    // An offset that the program sets.
    for (control, code) in [(FANUC, "G54.1 P7"), (HAAS, "G154 P7"), (MAZAK, "G54.1 P7")] {
        let found =
            result(control, &format!("G90\nG10 L20 P7 X0 Y400. Z0\n{code}\nG0 X0 Y100. Z0\n"));
        assert_eq!(
            found,
            Ok(format!("G90\nG10 L20 P7 X0 Y400. Z0\n{code}\nG0 X0.500 Y100. Z0\n")),
            "{control}"
        );
    }
    // An offset that is not stated counts as zero, with a note.
    let (_, summary) = text_in(FANUC, ERRORS, "G54.1 P12\nG0 X0 Y100. Z0\n").expect("taken");
    has(&notes_of(&summary).concat(), ": the set-up file has no work offset P12");
    for (text, expected) in [
        ("[work_offset.P0]\nX = 1\n", "there is no work offset P0"),
        ("[work_offset.P301]\nX = 1\n", "there is no work offset P301"),
    ] {
        let error = result(text, "").expect_err(text);
        assert!(error.contains(expected), "{error}");
    }
}

/// K0 or L0 stores a cycle without a hole: the later holes equal those of a cycle with a first hole.
#[test]
fn cycles_are_stored_by_k0_and_l0() {
    const DEEP: &str = "[errors]\nEC0Y = 1000.0\nEZZ = { poly = [0.0, 1.0] }\n";
    let run = |setup: &str, program: &str| {
        let found = text_in(setup, DEEP, program);
        found.map(|(text, _)| text).map_err(|error| error.to_string())
    };
    for (control, zero) in [(FANUC, "K0"), (HAAS, "L0")] {
        let stored = |line: &str| format!("G90 G0 X0 Y100. Z10.\n{line}\nX30. Y100.\nX40.\nG80\n");
        for (line, deep) in [
            (format!("G99 G81 Z-5. R2. F100. {zero}"), " Z-4.995 R1.998"),
            (format!("G98 G81 X10. Y100. Z-5. R2. F100. {zero}"), " Z-4.995 R1.998"),
        ] {
            let found = run(control, &stored(&line));
            let expected =
                format!("G90 G0 X0.100 Y100. Z9.990\n{line}\nX30.100 Y100.{deep}\nX40.100\nG80\n");
            assert_eq!(found, Ok(expected), "{control}");
        }
        // A named axis becomes unknown, since the control may have moved there or not.
        let found = run(control, &format!("G90 G0 X0 Y100. Z10.\nG99 G81 X10. Y50. Z-5. R2. F100. {zero}\nX30.\nG80\nG0 Y200.\n")).expect("taken");
        assert!(
            found.ends_with("\nG80\nG0 Y200. X30.200\n")
                && !found.contains(&format!("Y50. Z-5. R2. F100. {zero} X")),
            "{found}"
        );
    }
    for [control, word, expected] in rows(
        "
 | L0 | a cycle with L that is not a number of holes
 | K0 | a cycle with K
mazak | L0 | a cycle with L that is not a number of holes
haas | K2 | a cycle with K
fanuc | L2 | a cycle with L, which FANUC controls
fanuc | K1.5 | a cycle with K that is not a number of holes
",
    ) {
        let program = around(&format!("G81 X10. Y100. Z-5. R2. F100. {word}"));
        let error = run(&of_control(control), &program).expect_err(word);
        begins(&error, &format!("line 4: {expected}"));
    }
    // Other controls may keep values that LinuxCNC computes anew.
    for control in [FANUC, HAAS] {
        let program = around("G81 X10. Y100. Z-5. R2. F100.\nG91 X10.");
        let error = run(control, &program).expect_err(control);
        begins(&error, "line 5: a cycle whose depth or plane R");
    }
}

#[test]
fn rows_by_k_are_rows_by_l() {
    let program = |letter: char| {
        format!(
            "G90 G0 X0 Y100. Z10.\nG91 G99 G81 X10. Y5. Z-7. R-8. F100. {letter}3\nG80 G90\nG0 X0 Y0\n"
        )
    };
    let [fanuc, haas] = [result(FANUC, &program('K')), result(HAAS, &program('L'))]
        .map(|found| found.expect("taken"));
    assert_eq!(fanuc.replace("K3", "L3"), haas);
    assert!(fanuc.contains("(G91 G99 G81 X10. Y5. Z-7. R-8. F100. K3)\nG91 G99 G81 X10.005 Y5. Z-7. R-8. F100.\nX10.005"), "{fanuc}");
}

#[test]
fn presets_are_work_offsets() {
    let machine = format!("{TRAVELS}{ERRORS}");
    let program = "0 BEGIN PGM PART MM\n1 CYCL DEF 247 BEZUGSPUNKT SETZEN ~\n    Q339=+3    ;BEZUGSPUNKT-NUMMER\n2 TOOL CALL 5 Z S8000\n3 L X+10 Y+100 Z+0 R0 FMAX M3\n4 END PGM PART MM\n";
    let setup = "control = \"heidenhain\"\n[work_offset.P3]\nY = 400\n[tool.5]\nZ = 0\n";
    let (text, summary, _) =
        verified_in(Dialect::Heidenhain, [&machine, setup, program], Strategy::Plain)
            .expect("taken");
    assert_eq!(text, program.replace("X+10 Y", "X+10.500 Y"));
    assert!(summary.notes.by_line().is_empty(), "{:?}", summary.notes);
    // A shift that has ended does not matter; one after the preset is added to it.
    for ends in ["TRANS DATUM RESET", "CYCL DEF 7.1 X+0\nCYCL DEF 7.2 Z+0"] {
        let begins = "TRANS DATUM AXIS X+60 Z-5\n";
        let behind = "CYCL DEF 247 ~\nQ339=+3\nTRANS DATUM AXIS X-10\nL X+20 Y+100 Z+0 R0 F500\n";
        let program = format!("{begins}{ends}\n{behind}");
        let (text, summary, _) =
            verified_in(Dialect::Heidenhain, [&machine, setup, &program], Strategy::Plain)
                .expect(ends);
        assert_eq!(text, program.replace("X+20", "X+20.500"));
        // At Y 400, where the preset is, X needs 0.4 mm, whatever shift is added.
        let zero = Note::OffAtZero("P3".to_owned(), [-4000, 0, 0]);
        let mut notes = summary.notes.by_line().into_iter();
        assert!(notes.any(|(_, note)| *note == zero), "{:?}", summary.notes);
    }
    for [line, expected] in &cases(
        r"
1 CYCL DEF 247 BEZUGSPUNKT SETZEN\n | line 2: column 3: CYCL DEF 247 is not supported
1 CYCL DEF 247 ~\nQ340=+1\n | line 3: column 1: CYCL DEF 247 is not supported: expected the number
1 CYCL DEF 247 ~\nQ339=+0\n | line 3: a preset other than 1 to 300
1 CYCL DEF 7.0 DATUM SHIFT\n2 CYCL DEF 7.1 X+60\n3 CYCL DEF 247 ~\nQ339=+3\n | line 5: a preset (cycle 247) while the datum is shifted
1 TRANS DATUM AXIS Z-5\n2 CYCL DEF 247 ~\nQ339=+3\n | line 4: a preset (cycle 247) while the datum is shifted
",
    ) {
        let program = format!("0 BEGIN PGM PART MM\n{line}");
        let error = verified_in(Dialect::Heidenhain, [&machine, setup, &program], Strategy::Plain)
            .expect_err(line)
            .to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

/// Notes that contain this text, with their lines.
fn noted(dialect: Dialect, machine: &str, program: &str, text: &str) -> Vec<String> {
    let machine = Machine::parse(machine, "m.toml").expect("a good machine");
    let (_, notes) = written(dialect, &machine, "", program).expect(program);
    notes.into_iter().filter(|note| note.contains(text)).collect()
}

/// M10 clamps a rotary axis: a word that only corrects the axis gets a note, until M11.
#[test]
fn corrections_of_a_clamped_axis_are_noted() {
    let tilts = "name = \"m\"\nstructure = \"w A' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.A]\ntravel = [-100, 100]\n[errors]\nEAX = { poly = [0.0, 1.0] }\n";
    let program = |codes: [&str; 2]| {
        let [first, second] = codes;
        format!("G0 X0 Y0 Z0 A0\n{first}G1 X200 F100\n{second}G1 X400\nG1 A10\n")
    };
    for (codes, line) in [
        (["", ""], None),
        (["M10\n", ""], Some("3: M10 clamps a rotary axis, and A gets words")),
        (["", "M10\n"], Some("4: M10 clamps a rotary axis, and A gets words")),
        (["M10\nM11\n", ""], None),
    ] {
        let found = noted(Dialect::Rs274, tilts, &program(codes), "M10");
        assert_eq!(found.len(), usize::from(line.is_some()), "{codes:?}: {found:?}");
        assert!(line.is_none_or(|line| found[0].starts_with(line)), "{found:?}");
    }
}

/// With a modal exact stop, the axes stop after each part of a split motion, which a note reports.
#[test]
fn split_motions_with_an_exact_stop_are_noted() {
    let bends = format!("{TRAVELS}[errors]\nEZX = {{ poly = [0.0, 0.0, 0.0005] }}\n");
    for (dialect, code, cuts, noted_line) in [
        (Dialect::Rs274, "G61", "", 3),
        (Dialect::Rs274, "G61.1", "", 3),
        (Dialect::Rs274, "G61", "G64\n", 0),
        (Dialect::Rs274, "G64", "", 0),
        (Dialect::Siemens, "G60", "", 3),
        (Dialect::Siemens, "G60", "G641\n", 0),
        (Dialect::Siemens, "G64", "", 0),
    ] {
        let program = format!("{code}\nG0 X0 Y0 Z0\n{cuts}G1 X400 F100\nG1 X0\n");
        let found = noted(dialect, &bends, &program, "exact stop");
        assert_eq!(found.len(), usize::from(noted_line > 0), "{program}{found:?}");
        assert!(found.iter().all(|note| note.starts_with("3: ")), "{found:?}");
    }
}
