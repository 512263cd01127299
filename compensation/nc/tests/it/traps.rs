//! Programs in which small corrections could do great harm; the behaviour of controls is worked out by hand or by LinuxCNC's interpreter.

use volcomp_nc::{Dialect, NcError, Note, Strategy, Summary};
use volcomp_test_support::{cases, rows};

use crate::identity::{begins, compensated, notes_of, text_in, verified_in};

const LINEAR: &str = "name = \"m\"\nstructure = \"w b X Y Z t\"\n[axes.X]\ntravel = [-5000, 5000]\n[axes.Y]\ntravel = [-5000, 5000]\n[axes.Z]\ntravel = [-5000, 5000]\n[errors]\n";
const START: &str = "[work_offset.G54]\nX = 0\n[start]\nX = 0\nY = 0\nZ = 0\n";

/// The result, and the maximum deviation of the tool with it, µm.
fn verified(errors: &str, program: &str) -> Result<(String, Summary, f64), NcError> {
    let machine = format!("{LINEAR}{errors}");
    let texts = [&machine, START, program];
    let (text, summary, found) = verified_in(Dialect::Rs274, texts, Strategy::Plain)?;
    assert!(found.after.max_um < found.before.max_um + 3.0, "{program}{text}{found:?}");
    Ok((text, summary, found.after.max_um))
}

fn run(errors: &str, program: &str) -> Result<(String, Summary), NcError> {
    let (text, summary, _) = verified(errors, program)?;
    Ok((text, summary))
}

fn result(errors: &str, program: &str) -> String {
    run(errors, program).expect("compensated").0
}

fn is_only_note(summary: &Summary, line: &str, text: &str) {
    let notes = notes_of(summary);
    assert!(
        matches!(&notes[..], [note] if note.starts_with(line) && note.contains(text)),
        "{notes:?}"
    );
}

/// Arcs from a few steps to almost straight, by centre and by R, with backlash and curved errors: the deviation stays below 5.5 µm.
#[test]
fn random_arcs_are_within_the_tolerance() {
    let errors = "EXX = { mean = { poly = [3, 0.05] }, reversal = 4 }\nEYX = { poly = [0, 0, 0.0001] }\nEYY = { mean = { poly = [-2, -0.08] }, reversal = 2 }\nEZX = { poly = [1, 0.02] }\n";
    let mut seed = 2_026_u64;
    let mut random = |low: f64, high: f64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((seed >> 11) as f64 / (1_u64 << 53) as f64)
    };
    for case in 0..3000 {
        let radius = 10_f64.powf(random(-2.0, 3.5));
        let turns = match if radius > 300.0 { 1 } else { case % 4 } {
            0 => random(0.01, 6.2),
            // The chord is a few hundredths of a mm.
            1 => (random(0.005, 0.5) / radius).min(6.0),
            2 => std::f64::consts::PI + random(-0.01, 0.01),
            _ => std::f64::consts::TAU - random(0.003, 0.2),
        };
        let clockwise = random(0.0, 1.0) < 0.5;
        let sense = if clockwise { -1.0 } else { 1.0 };
        let (x, y, begins) =
            (random(-300.0, 300.0), random(-300.0, 300.0), random(0.0, std::f64::consts::TAU));
        let round = |value: f64| (value * 1e4).round() / 1e4;
        let (x, y) = (round(x), round(y));
        let (i, j) = (round(-radius * begins.cos()), round(-radius * begins.sin()));
        let radius = i.hypot(j);
        let ends = (-j).atan2(-i) + sense * turns;
        let (to_x, to_y) = (round(x + i + radius * ends.cos()), round(y + j + radius * ends.sin()));
        let code = if clockwise { 2 } else { 3 };
        let circle = if case % 3 == 0 && turns < 6.0 && (turns - std::f64::consts::PI).abs() > 0.02
        {
            let sign = if turns > std::f64::consts::PI { -1.0 } else { 1.0 };
            format!("R{:.5}", sign * radius)
        } else {
            format!("I{i:.4} J{j:.4}")
        };
        if (to_x, to_y) == (x, y) {
            continue;
        }
        let program = format!("G0 X{x:.4} Y{y:.4} Z0\nG{code} X{to_x:.4} Y{to_y:.4} {circle}\n");
        let (out, _, off_um) = verified(errors, &program).expect("compensated");
        // Tolerance, rounding of the centre, and backlash within the arc.
        assert!(off_um < 5.5, "{program}{out}{off_um} µm");
    }
}

/// An arc with a sag of 0.2 nm is not flipped by the rounding of its ends.
#[test]
fn shallow_arcs_keep_their_side() {
    let constant = "EYY = { poly = [-0.45] }\n";
    for program in [
        "G0 X10 Y0 Z0\nG3 X10.4 Y0 I0.2 J100\n",
        "G0 X10 Y0 Z0\nG3 X11 Y0 I0.5 J1000\n",
        "G0 X10 Y0 Z0\nG2 X10.001 Y0 I0.0005 J-20\n",
    ] {
        assert_eq!(result(constant, program), program);
    }
    // The correction bends by more than the arc and in the opposite direction: the arc keeps its side.
    let bent = "EYX = { table = [[-10, 0], [0, 4], [10, 0]], interpolation = \"linear\" }\n";
    let out = result(bent, "G0 X-1 Y0 Z0\nG3 X1 Y0 R20000\nG2 X-1 R20000\n");
    assert!(!out.contains("R-") && !out.contains("J-"), "{out}");
}

/// An arc that starts just before a quadrant, where an axis reverses: no part is rounded to zero length.
#[test]
fn no_part_of_an_arc_is_shorter_than_a_reversal() {
    let play = "EXX = { mean = { poly = [0, 0] }, reversal = 3 }\n";
    assert_eq!(
        result(play, "G0 X20 Y20 Z0\nG0 X30 Y30\nG3 X10 Y30 I-10 J0.0003\n"),
        "G0 X19.999 Y20 Z0\nG0 X29.999 Y30\nG1 X30.002\nG3 X20.002 Y40.000 I-10.000 J0.0000\nX10.002 Y30.000 I0.000 J-10.0000\n"
    );
}

/// Closed form: an arc that ends 1.5° after a quadrant, or starts 1.5° before one, moves Y back there by 34 µm.
#[test]
fn arcs_that_end_just_after_a_quadrant_take_up_the_play() {
    let play = "EYY = { mean = { poly = [0, 0] }, reversal = -8 }\n";
    let ends = "G0 X100 Y-100 Z0\nG0 X100 Y0\nG3 X2.618 Y-99.966 I-100 J0\nG1 Y0\n";
    let (out, _, left_um) = verified(play, ends).expect("compensated");
    assert!(out.contains(" Y-100.004 "), "{out}");
    assert!(out.contains("\nG1 Y-99.996\nG3 X2.618 Y-99.962 "), "{out}");
    assert!(left_um < 1.0, "{left_um}: {out}");
    let starts = "G0 X0 Y-200 Z0\nG0 X-2.618 Y-99.966\nG3 X-100 Y0 I2.618 J99.966\n";
    let (out, _, left_um) = verified(play, starts).expect("compensated");
    assert!(out.contains("\nG1 Y-99.970\nG3 "), "{out}");
    assert!(out.contains(" Y-100.004 "), "{out}");
    assert!(out.contains("\nG1 Y-99.996\nG3 "), "{out}");
    assert!(left_um < 1.0, "{left_um}: {out}");
}

/// If half the chord is rounded to more than R, a centre is written instead.
#[test]
fn half_circles_by_radius_get_a_centre() {
    let scale = "EXX = { poly = [0, -0.09] }\nEYY = { poly = [0, -0.09] }\n";
    assert_eq!(
        result(scale, "G0 X0 Y0 Z0\nG3 X100 Y0 R50 (half)\nG2 X0 R50\n"),
        "G0 X0 Y0 Z0\nG3 X100.009 Y0 I50.005 J0.000 (half)\nG2 X0 I-50.005 J0.000\n"
    );
    assert_eq!(
        result(scale, "G0 X100 Y0 Z0\nG3 X0 Y100 R100\n"),
        "G0 X100.009 Y0 Z0\nG3 X0 Y100.009 R100.009\n"
    );
}

/// A full circle ends at its start, also if the start lacks a correction below the tolerance.
#[test]
fn full_circles_stay_closed() {
    let constant = "EXX = { poly = [0.8] }\nEYY = { poly = [0.8] }\n";
    assert_eq!(
        result(constant, "G0 X0 Y0 Z0\nG53 G0 X0 Y0\nG2 I-5\nG3 X0 Y0 J5\nG1 X10\n"),
        "G0 X-0.001 Y-0.001 Z0\nG53 G0 X0 Y0\nG2 I-5\nG3 X0 Y0 J5\nG1 X9.999 Y-0.001\n"
    );
}

#[test]
fn the_parts_of_several_turns_add_up() {
    let bent = "EZZ = { poly = [0, 0, 0.00005] }\n";
    let out = result(bent, "G0 X0 Y0 Z0\nG2 X0 I-5 J0 Z-400 P8\n");
    let turns: f64 = out
        .lines()
        .skip(1)
        .map(|line| {
            let word = |letter| {
                let rest = line.split(letter).nth(1)?;
                rest.split(' ').next()?.parse::<f64>().ok()
            };
            // Without P a part is half a turn or a whole turn.
            let ends_beyond = word('X').is_some_and(|x| x < -5.0);
            let starts_beyond = word('I').is_some_and(|i| i > 0.0);
            let share = if ends_beyond == starts_beyond { 1.0 } else { 0.5 };
            word('P').map_or(0.0, |turns| turns - 1.0) + share
        })
        .sum();
    assert_eq!(turns, 8.0, "{out}");
    assert!(out.contains('P'), "{out}");
}

#[test]
fn stops_follow_the_last_part() {
    let bent = "EXX = { poly = [0.0, 0.1] }\nEYX = { poly = [0.0, 0.0, 0.00002] }\n";
    for stop in ["M0", "M1", "M2", "M30", "M60"] {
        let out = result(bent, &format!("G0 X0 Y0 Z0\nG1 X400 {stop} (wait)\n"));
        let lines: Vec<&str> = out.lines().collect();
        assert!(lines.len() > 2, "{out}");
        assert!(lines[1].ends_with(" (wait)") && !lines[1].contains('M'), "{out}");
        let last = lines.last().expect("there are lines");
        assert!(last.starts_with("X399.960") && last.ends_with(stop), "{out}");
    }
    let out = result(bent, "G0 X0 Y0 Z0\nG3 X400 Y0 R2000M2\n");
    assert_eq!(out.matches('M').count(), 1, "{out}");
    assert!(out.ends_with("M2\n"), "{out}");
    // LinuxCNC stops spindle and coolant before the motion, FANUC and Haas controls after it; an exact stop applies at the end.
    for (control, word, is_last) in [
        ("linuxcnc", "M5", false),
        ("linuxcnc", "M9", false),
        ("fanuc", "M5", true),
        ("haas", "M9", true),
        ("mazak", "M19", true),
        ("fanuc", "G9", true),
        ("fanuc", "M8", false),
    ] {
        let without_point = if control == "linuxcnc" { "" } else { "without_point = \"unit\"\n" };
        let setup = format!("control = \"{control}\"\n{without_point}");
        let program = format!("G0 X0 Y0 Z0\nG1 X400 {word}\n");
        let machine = format!("{LINEAR}{bent}");
        let texts = [&machine, &format!("{setup}{START}"), &program];
        let (out, ..) =
            verified_in(Dialect::Rs274, texts.map(String::as_str), Strategy::Plain).expect("taken");
        let lines: Vec<&str> = out.lines().skip(1).collect();
        let at = lines.iter().position(|line| line.contains(word));
        let expected = if is_last { lines.len() - 1 } else { 0 };
        assert_eq!(at, Some(expected), "{control}: {out}");
        assert_eq!(out.matches(word).count(), 1, "{out}");
    }
    // Codes that are executed before the motion stay in the first part.
    let out = result(bent, "G0 X0 Y0 Z0\nG1 M3 S100 X400 M8\n");
    assert!(
        out.lines().nth(1).is_some_and(|line| line.contains("M3 S100") && line.contains("M8")),
        "{out}"
    );
}

/// As on LinuxCNC, a shift of X switched off by G92.2 does not return with a shift of another axis.
#[test]
fn shifts_that_were_switched_off_stay_off() {
    let errors = "EXX = { poly = [0, 0.1] }\nEC0Y = 100\n";
    for shift in ["G92 Y10", "G52 Y10"] {
        let program = |x: &str| format!("G0 X0 Y0 Z0\nG92 X1000\nG92.2\n{shift}\nG1 {x} Y0\n");
        let out = result(errors, &program("X500"));
        let x = if shift == "G92 Y10" { "X499.949" } else { "X499.951" };
        assert!(
            out.lines().last().is_some_and(|line| line.starts_with(&format!("G1 {x}"))),
            "{out}"
        );
    }
}

/// A position parameter of the control contains the correction, but the program expects the nominal position: it is written as a number.
#[test]
fn positions_read_by_the_program_are_written_as_numbers() {
    let errors = "EXX = { poly = [-10, 0.1] }\n";
    for [program, expected] in rows(
        r"
G0 X600 Y0 Z0\nG1 X[#5420-500]\n#2=[#5420-500]\nG1 X#2 Y#5421\nG1 X[#<_x>+500]\n | G0 X599.950 Y0 Z0\nG1 X100\n#2=[#5420-500]\nG1 X-399.950 Y#5421\nG1 X100\n
G0 X600 Y0 Z0\n#2=[#<_x>-500]\nG1 X#2\n | G0 X599.950 Y0 Z0\n#2=100\nG1 X#2\n
",
    ) {
        assert_eq!(result(errors, program), expected);
    }
    let refused = run(errors, "G0 X600 Y0 Z0\no1 while [#<_x> LT 700]\nG91 G1 X10\no1 endwhile\n");
    let message = refused.expect_err("the count of the loop would change").to_string();
    begins(&message, "line 2: the position of an axis is read here");
}

/// As on LinuxCNC, R in G91 counts from the tool before the first hole, and the depth from R.
#[test]
fn incremental_holes_have_their_depth() {
    let errors = "EZX = { poly = [0, 0.1] }\n";
    for [program, expected] in rows(
        r"
G0 X0 Y0 Z10\nG99\nG91\nG81 X100 R-8 Z-5\nX100\nX100 R-1\nX100 Z-7\nG98 X100\nG80\nG90\nG0 Z1\n | G0 X0 Y0 Z10\nG99\nG91\nG81 X100 R-8.010 Z-5\nX100 R-8.020\nX100 R-1.030\nX100 Z-7 R-1.040\nG98 X100 Z-7.010\nG80\nG90\nG0 Z0.950\n
// If one of R and Z changes, the other gets its current correction as well.
G0 X500 Y0 Z10\nG81 X500 R2 Z-5\nX0 R3\nX0 Z-5\nG80\n | G0 X500 Y0 Z9.950\nG81 X500 R1.950 Z-5.050\nX0 R3 Z-5.000\nX0 Z-5\nG80\n
",
    ) {
        assert_eq!(result(errors, program), expected);
    }
}

/// An unrolled call returns nothing to the control, so the value that it returns is written as a number.
#[test]
fn return_values_are_written_as_numbers() {
    let errors = "EXX = { poly = [0, 0.1] }\n";
    let program = "o<f> sub\nG0 X[#1*100]\no<f> endsub [#1*7]\nG0 X0 Y0 Z0\no<f> call [1]\no<f> call [2]\nG0 Y[#<_value>]\n#1=[#<_value>+1]\nG0 Y#1\n";
    let out = result(errors, program);
    assert!(out.ends_with("G0 Y14\n#1=15\nG0 Y#1\n"), "{out}");
    let decides = "o<f> sub\nG0 X[#1*100]\no<f> endsub [#1*7]\no<f> call [1]\no<f> call [2]\no1 if [#<_value> GT 3]\nG0 Y1\no1 endif\n";
    let message = run(errors, decides).expect_err("who decides?").to_string();
    begins(&message, "line 6: #<_value> is read here");
}

/// The entry motion of cutter radius compensation is not split, and no line is added before it, also if G41 or G40 is in a separate line
/// and a Z motion follows.
#[test]
fn entry_moves_stay_whole() {
    // 16 µm of bend over 400 mm: without the code the motion is split.
    let bent = "EXX = { mean = { poly = [0, 0, 0.0001] }, reversal = 10 }\nEYX = { poly = [0, 0, 0.0001] }\n";
    let split = result(bent, "G0 X-400 Y-20 Z0\nG1 X0 Y-10\n");
    assert!(split.lines().count() > 3, "{split}");
    for (on, off) in [
        ("G41.1 D6\nG1 X0 Y-10", "G40\nG1 X400 Y20"),
        ("G41.1 D6\nG1 Z-1\nG1 X0 Y-10", "G40\nG1 Z1\nG1 X400 Y20"),
        ("G41.1 D6 G1 X0 Y-10", "G40 G1 X400 Y20"),
    ] {
        let program = format!("G0 X-400 Y-20 Z0\n{on}\nG1 Y10\n{off}\n");
        let out = result(bent, &program);
        assert_eq!(out.lines().count(), program.lines().count(), "{out}");
    }
    let out = result(bent, "G0 X-400 Y-20 Z0\nG41.1 D6\nG1 X0 Y-10\nG40\nG1 X1\nG1 X400\n");
    assert!(out.lines().count() > 8, "{out}");
}

/// On LinuxCNC the second cycle starts at the current height: R is 1 mm below it, and the hole 5 mm deeper.
#[test]
fn a_row_after_g80_starts_anew() {
    let errors = "EZX = { poly = [0, 0.1] }\n";
    let program = "G0 X0 Y0 Z10\nG99 G81 X500 R2 Z-5\nG80\nG91 G81 X-500 R-1 Z-5\nG80\nM2\n";
    // 50 µm at X500, none at X0: from 1.950 to R at 1, and from there to -4.
    assert_eq!(
        result(errors, program),
        program.replace("R2 Z-5", "R1.950 Z-5.050").replace("R-1", "R-0.950")
    );
}

/// Under G7 LinuxCNC reads X as a diameter but not R: in G19 the tool goes from X10 to R at 5, then to X -20 / 2.
#[test]
fn cycles_along_a_diameter() {
    let errors = "EXX = { poly = [10] }\n";
    assert_eq!(
        result(errors, "G7 G19 G0 X60 Y0 Z0\nG81 Y10 X-20 R5\nG80\nM2\n"),
        "G7 G19 G0 X59.980 Y0 Z0\nG81 Y10 X-20.020 R4.990\nG80\nM2\n"
    );
}

/// Refused motions: a split whose parts would need their own F, a split into thousands of parts, and a cycle with R
/// alone, which drills on some controls.
#[test]
fn motions_that_cannot_be_split_are_refused() {
    let bent = "EYX = { poly = [0, 0, 0.0001] }\n";
    for [program, expected] in rows(
        r"
G0 X0 Y0 Z0\nG93 G1 X1000 F#5399\n | line 2: a motion that is split, with an inverse-time F
G0 X0 Y0 Z0\nG93 G3 X1000 Y0 R2000 F#5399\n | line 2: a motion that is split, with an inverse-time F
G0 X0 Y0 Z10\nG81 X10 Z-5 R2\nR5\nX20\n | line 3: R alone while a cycle is active
",
    ) {
        let message = run(bent, program).expect_err(program).to_string();
        assert!(message.starts_with(expected), "{message}");
    }
    // Sag of a part: 100 µm/mm² × (its length)² / 4, 1 µm at 0.2 mm, thus 5000 parts.
    let error = run("EYX = { poly = [0, 0, 100] }\n", "G0 X0 Y0 Z10\nG1 X1000\n");
    let message = error.expect_err("refused").to_string();
    let expected = "line 2: a motion that needs more than 4096 parts";
    assert!(message.starts_with(expected), "{message}");
}

#[test]
fn a_stored_position_is_corrected_once() {
    let errors = "EXX = { poly = [0, 0.1] }\n";
    let (out, summary) =
        run(errors, "G0 X500 Y0 Z0\nG28.1\nG0 X0\nG28\nG91\nG1 X0 Y10\nG90 X500\n")
            .expect("compensated");
    assert_eq!(out, "G0 X499.950 Y0 Z0\nG28.1\nG0 X0\nG28\nG91\nG1 X0 Y10\nG90 X499.950\n");
    is_only_note(&summary, "4: ", "machine coordinates");
}

#[test]
fn lines_that_get_too_long_are_noted() {
    let text = format!("G0 X0 Y0 Z0\nG1 Y500 ({})\n", "c".repeat(241));
    let (out, summary) = run("EXY = { poly = [0, 0.1] }\n", &text).expect("compensated");
    assert!(out.lines().any(|line| line.len() > 254));
    is_only_note(&summary, "2: ", "254 characters");
}

/// G80 in the block of the next motion is accepted, as in FANUC programs; two other motions in one block are refused.
#[test]
fn g80_with_the_next_motion() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    for (block, expected) in [
        ("G80 G0 X50", "G80 G0 X49.995"),
        ("G0 G80 X50", "G0 G80 X49.995"),
        ("G80 G1 X50 F10", "G80 G1 X49.995 F10"),
    ] {
        let around = |block: &str| format!("G0 X0 Y0 Z10\nG81 X100 Z-5 R2 F10\n{block}\nX60\nM2\n");
        let (out, _) = compensated(scale, around(block).as_bytes()).expect("taken");
        let expected = around(expected).replace("X100 ", "X99.990 ").replace("X60", "X59.994");
        assert_eq!(String::from_utf8_lossy(&out), expected);
    }
    let error = compensated(scale, b"G0 X1\nG81 G80 X1 Z-5 R2\n").expect_err("refused");
    assert!(error.to_string().contains("expected only one of them"), "{error}");
}

/// A percent sign also ends a program with O-words, and added lines have the line ends of the program.
#[test]
fn percent_signs_and_ends_of_lines() {
    let bent = "EXX = { poly = [0.0, 0.1] }\nEYX = { poly = [0.0, 0.0, 0.00002] }\n";
    let out = result(bent, "%\no1 repeat [2]\nG91 G1 X10\no1 endrepeat\n%\no2 while [\n");
    assert!(out.ends_with("\n%\no2 while [\n"), "{out}");
    let out = result(bent, "G0 X0 Y0 Z0\r\nG1 X400");
    assert!(out.matches('\n').count() > 1, "{out:?}");
    assert_eq!(out.matches('\n').count(), out.matches("\r\n").count());
}

#[test]
fn implausible_coordinates_are_refused() {
    for (word, line) in [("Y2e100", 1), ("X1e9", 1)] {
        // RS-274 has no exponents.
        let (letter, exponent) = word.split_once('e').expect("an exponent");
        let zeros = "0".repeat(exponent.parse().expect("a number"));
        let program = format!("G0 X0 {letter}{zeros}1 Z0\n");
        let message = run("", &program.replace("X0 X", "X")).expect_err("too large").to_string();
        assert!(
            message.starts_with(&format!("line {line}: "))
                && message.contains("expected at most 1e9"),
            "{message}"
        );
    }
}

#[test]
fn words_that_the_control_reads_differently_are_refused() {
    for [program, expected] in &cases(
        r"
G1 X1 F1\nM70\n | line 2: M70, which is not supported
M198 P1000\n | line 1: M198, which is not supported
G0 X100\nG04 X1.5\nY50\n | line 2: a dwell (G4) with the word of an axis
G1 F100 X[#501+100]\n | line 1: the value of X is only known at the machine
G1 F100 X#5041\n | line 1: the value of X is only known at the machine
",
    ) {
        let error = run("", program).expect_err(program).to_string();
        assert!(error.starts_with(expected), "{error}");
    }
    run("", "#501=25\nG1 F100 X[#501+100] Y#3\nG4 P1\n")
        .expect("what the program sets, and what is its own");
}

/// No block follows a probing motion that would move the probe on to its unreached target.
#[test]
fn no_line_is_added_between_a_probe_and_its_retract() {
    let errors = "EXX = { poly = [0.0, 0.04] }\nEYX = { poly = [0.0, 0.1] }\n";
    let program = "G0 X0 Y0 Z10\nG1 Z5 F100\nG38.2 X100 F100\nG1 X-5\nM2\n";
    let (out, _) = text_in("", &format!("[errors]\n{errors}"), program).expect("taken");
    let behind = out.lines().skip_while(|line| !line.starts_with("G38.2")).nth(1).expect("a line");
    assert!(behind.starts_with("G1 X-5") || behind.starts_with("G1 X-4.99"), "{out}");
}

/// Lines after the first O-word are executed, not streamed: zero bytes and endless lines are refused there as well.
#[test]
fn zero_bytes_and_endless_lines_are_refused_after_an_o_word() {
    let long = "(".to_owned() + &"x".repeat(1 << 20) + ")";
    for (line, expected) in
        [("G1 X1 F1 \0", "line 3: byte 0x00 at column 10"), (long.as_str(), "line 3: longer than")]
    {
        let program = format!("G0 X0\no<a> sub\n{line}\no<a> endsub\nM2\n");
        let error = compensated("", program.as_bytes()).expect_err(expected);
        assert!(error.to_string().starts_with(expected), "{error}");
    }
}

#[test]
fn a_program_ends_by_its_second_percent_sign() {
    for (program, ends) in [
        ("%\nG0 X1\n%\nwhat ever\n", true),
        ("%\no<a> repeat [2]\nG0 X1\no<a> endrepeat\n%\nwhat ever\n", true),
        ("%\no<a> repeat [2]\nG0 X1\no<a> endrepeat\n", false),
        ("%\nG0 X1\n", false),
    ] {
        let (out, summary) = compensated("", program.as_bytes()).expect("taken");
        assert_eq!(out, program.as_bytes());
        assert_eq!(summary.ended, ends, "{program}");
    }
}

/// With cutter radius compensation a control takes 1 µm in the plane as a contour element with a corner. A block of Z or without motion
/// therefore gets no words in the plane, also before G41 or G40 takes effect.
#[test]
fn a_plunge_during_radius_compensation_stays_vertical() {
    let errors = "EB0Z = -100\nEA0Z = 60\n";
    let program = "G0 X-20 Y40 Z5\nG41.1 D20\nG1 Z0\nX0 Y0\nX100 Y0\nZ-20\nX100 Z-40\nX100 Y100\nG91 Z-20\nG90 Z0\nY0\nG40\nZ20\nX50 Y50\n";
    let out = result(errors, program);
    let [before, after] = [program, &out].map(|text| text.lines().collect::<Vec<_>>());
    assert_eq!(before.len(), after.len(), "{out}");
    // Corrections at the ends of motions in the plane, per mm of Z: X -0.1 µm, Y -0.06 µm.
    for (place, line) in after.iter().enumerate() {
        let changes = matches!(place, 7 | 10 | 13);
        assert_eq!(*line != before[place], changes, "line {place}: {line}\n{out}");
    }
    assert!(out.contains("X99.996 Y99.998"), "{out}");
}

/// A contour element is not split: a part could be shorter than the cut at an inside corner, and change a depth reached on the way.
#[test]
fn elements_of_a_contour_are_not_split() {
    let bent = "EXX = { poly = [0, 0, 0.0001] }\nEYX = { poly = [0, 0, 0.0001] }\n";
    let contour =
        "X100 Y-100\nX400 Y-100 Z-20\nG3 X100 Y200 I-300 J0\nG2 X100 Y200 I50 J50\nG1 X0 Y0\n";
    let on = format!("G0 X0 Y-20 Z0\nG41.1 D60 G1 X0 Y0 F100\n{contour}G40 G1 X-100 Y0\n");
    let out = result(bent, &on);
    assert_eq!(out.lines().count(), on.lines().count(), "{out}");
    assert_ne!(out, on);
    let (_, found) = run(bent, &on).expect("compensated");
    let whole = |(line, note): &(usize, &Note)| (**note == Note::ContourWhole).then_some(*line);
    assert_eq!(found.notes.by_line().iter().find_map(whole), Some(4));
    let off = on.replace("G41.1 D60 ", "").replace("G40 ", "");
    let out = result(bent, &off);
    assert!(out.lines().count() > on.lines().count() + 3, "{out}");
}

/// LinuxCNC lifts a tool in plane R to the G98 plane before the next hole, but not a tool above R. Therefore R must not
/// be written below the tool.
#[test]
fn the_plane_r_does_not_go_below_the_tool_before_it_is_lifted() {
    let program = "G0 X0 Y0 Z50\nG99 G81 X100 Z-5 R2\nX600 G98\nX700\n";
    let out = result("EZX = { poly = [0, 0.05] }\n", program);
    // The tool is at 1.995; R would be at 1.970.
    assert!(out.contains("X600 G98 Z-5.030\n"), "{out}");
    let out = result("EZX = { poly = [0, -0.05] }\n", program);
    assert!(out.contains("X600 G98 Z-4.970 R2.030\n"), "{out}");
}

/// Refused: a tool length by G43.1 that ends in another unit, since LinuxCNC keeps its number; and an arc whose ends are on two circles.
#[test]
fn words_that_other_controls_read_differently_are_refused() {
    let message = |program: &str| run("", program).expect_err("refused").to_string();
    let found = message("G21 G43.1 Z20\nG0 Z5\nG20\nG49\nG0 X1\n");
    begins(&found, "line 4: a tool length that ends in another unit");
    assert!(run("", "G21 G43.1 Z20\nG49\nG20\nG43.1 Z1\n").is_ok());
    // `rs274`: with a length of 25.4 mm and G20, G53 G0 Z0 leads to Z-25.4 inch.
    for word in ["G53 G0 Z0", "G28", "G30 Z0", "G10 L20 P1 Z0"] {
        let found = message(&format!("G21 G43.1 Z20\nG0 Z5\nG20\n{word}\n"));
        begins(&found, "line 4: machine coordinates (G53, G28, G30, G10 L20) with a tool length");
        assert!(run("", &format!("G20 G43.1 Z1\nG0 Z5\n{word}\n")).is_ok(), "{word}");
    }
    // `rs274` moves along the rotated axis: with G54 turned by 30° and G28 at 0, from X10 Y20 to X0 Y20 of the program, not to X0 of the machine.
    for word in ["G28 X10", "G30 Z5 Y10"] {
        let found = message(&format!("G90 G10 L2 P1 X0 Y0 R30\nG0 X10 Y20 Z0\n{word}\n"));
        begins(&found, "line 3: G28 or G30 of X or Y alone while the coordinates are rotated");
    }
    assert!(run("", "G90 G10 L2 P1 X0 Y0 R30\nG0 X10 Y20 Z0\nG28 X10 Y20\nG28 Z5\n").is_ok());
    let found = message("G0 X0 Y10\nG2 X60 Y40 I20 J0\n");
    assert!(
        found.contains("a radius of 20.000 mm at its start and of 50.000 mm at its end"),
        "{found}"
    );
    assert!(run("", "G0 X0 Y10\nG2 X40.1 Y10 I20 J0\n").is_ok());
}
