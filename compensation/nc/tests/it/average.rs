//! Mean correction in the work offset, compared with closed-form means.

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Average, Corrector, Dialect, Job, MeanOf, NcError, Note, Part, Reading, SetUp, Virtual,
    average, verify_average,
};
use volcomp_test_support::rows;

use crate::identity::{TRAVELS, begins, has};

const SETUP: &str = "[work_offset.G54]\nX = 100\nY = 50\nZ = -20.5\n[work_offset.G55]\nX = 300\n[start]\nX = 0\nY = 0\nZ = 0\n";

fn run(errors: &str, setup: &str, program: &str) -> Result<(String, Vec<Average>), NcError> {
    run_of(errors, setup, program, MeanOf::Places)
}

fn run_of(
    errors: &str,
    setup: &str,
    program: &str,
    of: MeanOf<'_>,
) -> Result<(String, Vec<Average>), NcError> {
    let machine =
        Machine::parse(&format!("{TRAVELS}[errors]\n{errors}"), "m.toml").expect("a machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.001)?;
    let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
    let mut out = Vec::new();
    let found = average(program.as_bytes(), &mut out, Job::new(&corrector, &setup), of)?;
    Ok((String::from_utf8(out).expect("text"), found))
}

fn message(errors: &str, setup: &str, program: &str) -> String {
    run(errors, setup, program).expect_err("it is refused").to_string()
}

#[test]
fn a_constant_error_is_removed_completely() {
    let (out, found) = run(
        "EXX = { poly = [10.0] }\nEZZ = { poly = [-4.0] }\n",
        SETUP,
        "%\n(part)\nG90 G54 G0 X0 Y0 Z10\nG1 F100 Z-5\nX20\nG0 Z10\n%\n",
    )
    .expect("averaged");
    assert_eq!(
        out,
        "%\n(part)\nG21 G90\nG10 L2 P1 X99.990 Y50.000 Z-20.496\nG90 G54 G0 X0 Y0 Z10\nG1 F100 Z-5\nX20\nG0 Z10\n%\n"
    );
    assert_eq!((found.len(), found[0].places), (1, 2));
    assert!((found[0].before_um[0] - 116.0_f64.sqrt()).abs() < 1e-6, "{found:?}");
    assert!(found[0].left_um[0] < 1e-6, "{found:?}");
}

/// Scale error of 100 µm/m at X 100 and X 300: the mean is removed and ±10 µm remain (times 0.9999, since the correction has the scale
/// error too). Each work offset has its own mean.
#[test]
fn a_scale_error_leaves_its_spread() {
    let (out, found) = run(
        "EXX = { poly = [0.0, 0.1] }\n",
        SETUP,
        "G90 G54\nG81 X0 Y0 Z-5 R2\nX200\nG80\nG55 G1 F100 X0\nG53 G0 X0\n",
    )
    .expect("averaged");
    assert!(
        out.starts_with(
            "G21 G90\nG10 L2 P1 X99.980 Y50.000 Z-20.500\nG10 L2 P2 X299.970 Y0.000 Z0.000\nG90 G54\n"
        ),
        "{out}"
    );
    let [first, second] = &found[..] else { panic!("{found:?}") };
    assert!(
        (first.mean_mm[0] + 0.019_998).abs() < 1e-8 && (first.left_um[0] - 9.999).abs() < 1e-5,
        "{found:?}"
    );
    assert!(
        (first.left_um[1] - 9.999).abs() < 1e-5 && (first.before_um[0] - 29.997).abs() < 1e-5,
        "{found:?}"
    );
    assert_eq!((second.system.as_str(), second.places), ("G55", 1));
    assert!(second.left_um[0] < 1e-6, "{found:?}");
}

#[test]
fn inch_and_crlf() {
    let (out, _) = run(
        "EXX = { poly = [25.4] }\n",
        &format!("units = \"inch\"\n{SETUP}"),
        "(part)\r\nG90 G54 G1 F100 X1 Y1\r\n",
    )
    .expect("averaged");
    // 100 - 0.0254 mm, 50 mm, -20.5 mm.
    assert_eq!(
        out,
        "(part)\r\nG20 G90\r\nG10 L2 P1 X3.9360 Y1.9685 Z-0.8071\r\nG90 G54 G1 F100 X1 Y1\r\n"
    );
}

#[test]
fn programs_without_a_mean_correction_are_refused() {
    let errors = "EXX = { poly = [1.0] }\n";
    let program = "G90 G54 G1 F100 X1 Y1 Z1\n";
    assert!(
        message(errors, "", program).contains("the set-up file does not state the work offset G54")
    );
    let unknown = message(errors, "[work_offset.G54]\nX = 1\n", "G54 G90 G1 X1\n");
    begins(&unknown, "line 1: the positions of X, Y and Z are unknown");
    let sets = message(errors, SETUP, "G10 L2 P1 X3\nG90 G1 X1\n");
    begins(&sets, "line 2: the program has set its work offset itself");
    let wrong = message(errors, SETUP, "G1 X\n");
    assert!(wrong.starts_with("line 1: column 4"), "{wrong}");
}

/// Readings along X, along a slanted direction, and none along Y; worked out by hand.
#[test]
fn the_mean_of_measured_errors() {
    let at = |direction: [f64; 3], um: f64| Reading { direction, error_mm: 1e-3 * um };
    let program = "G90 G54 G0 X0 Y0 Z10\nG1 F100 Z-5\n";
    // X: 10 and 14, mean 12; Z: -6. Residuals: 2, 2 and 0.
    let readings =
        [at([1.0, 0.0, 0.0], 10.0), at([1.0, 0.0, 0.0], 14.0), at([0.0, 0.0, -1.0], 6.0)];
    let taken = |errors: &str, readings: &[Reading]| {
        run_of(errors, SETUP, program, MeanOf::Readings(readings)).expect("averaged")
    };
    let (out, found) = taken("EXX = { poly = [50.0] }\n", &readings);
    begins(&out, "G21 G90\nG10 L2 P1 X99.988 Y50.000 Z-20.494\n");
    let near =
        |found: [f64; 2], expected: [f64; 2]| (0..2).all(|i| (found[i] - expected[i]).abs() < 1e-9);
    let rms = |of: [f64; 3]| (of.iter().map(|x| x * x).sum::<f64>() / 3.0).sqrt();
    assert!(near(found[0].left_um, [2.0, rms([2.0, 2.0, 0.0])]), "{found:?}");
    assert!(near(found[0].before_um, [14.0, rms([10.0, 14.0, 6.0])]), "{found:?}");
    // Along a diagonal of X and Y each axis corrects half.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let (out, _) = taken("", &[at([half, half, 0.0], 20.0 * half)]);
    has(&out, "G10 L2 P1 X99.990 Y49.990 Z-20.500\n");
}

/// An error of 10 µm along X and 4 µm along Y of the workpiece is corrected by axes with other directions. Each word is worked out by
/// hand; the error in the note on the zero equals the sum of the words.
#[test]
fn measured_errors_become_axis_offsets() {
    let readings = [([1.0, 0.0, 0.0], 0.010), ([0.0, 1.0, 0.0], 0.004)]
        .map(|(direction, mm)| Reading { direction, error_mm: mm });
    for [correct, x, y, words, left_um, x_tenths, y_tenths] in rows(
        r#"
 | [1, 0, 0] | [0, 1, 0] | X-0.010 Y-0.004 | 0.0 | 100 | 40
 | [-1, 0, 0] | [0, 1, 0] | X0.010 Y-0.004 | 0.0 | -100 | 40
// -(10, 4) = -7·(1, 0) - 5·(0.6, 0.8).
 | [1, 0, 0] | [0.6, 0.8, 0] | X-0.007 Y-0.005 | 0.0 | 70 | 50
// X alone corrects 10·0.6 + 4·0.8 = 9.2; 4.48 and -3.36 remain.
correct = ["X"] | [0.6, 0.8, 0] | [0, 1, 0] | X-0.009 Y0.000 | 4.48 | 92 | 0
correct = ["Y"] | [-1, 0, 0] | [0, 1, 0] | X0.000 Y-0.004 | 10.0 | 0 | 40
"#,
    ) {
        let axis = |direction: &str| format!("travel = [-500, 500]\ndirection = {direction}\n");
        let machine = format!(
            "structure = \"w b X Y Z t\"\n{correct}\n[axes.X]\n{}[axes.Y]\n{}[axes.Z]\n{}",
            axis(x),
            axis(y),
            axis("[0, 0, 1]")
        );
        let machine = Machine::parse(&machine, "m.toml").expect("a machine");
        let corrector = Corrector::new(&machine, &Temperatures::new(), 0.001).expect("compiles");
        let setup = "[work_offset.G54]\nX = 0\nY = 0\nZ = 0\n";
        let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
        let mut out = Vec::new();
        let found = average(
            b"G90 G54 G0 X0 Y0 Z0\nG1 X10 F100\n",
            &mut out,
            Job::new(&corrector, &setup),
            MeanOf::Readings(&readings),
        )
        .expect("averaged");
        let out = String::from_utf8(out).expect("text");
        begins(&out, &format!("G21 G90\nG10 L2 P1 {words} Z0.000\n"));
        let left_um: f64 = left_um.parse().expect("a number");
        assert!((found[0].left_um[0] - left_um).abs() < 1e-9, "{found:?}");
        let [x, y] = [x_tenths, y_tenths].map(|um| um.parse().expect("a number"));
        let zero = Note::OffAtZero("G54".to_owned(), [x, y, 0]);
        assert_eq!(found[0].off_at_zero, Some(zero));
    }
}

/// With constant errors of 10 and 4 µm a part cut from a probed zero has no position error, since the probed zero contains the errors.
#[test]
fn a_probed_zero_contains_the_measured_error() {
    let machine =
        |errors: &str| Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a machine");
    let (model, truth) = (machine(""), machine("[errors]\nEXX = 10.0\nEYY = 4.0\n"));
    let temperatures = Temperatures::new();
    let corrector = Corrector::new(&model, &temperatures, 0.001).expect("compiles");
    let setup = SetUp::parse(SETUP, "setup.toml").expect("a set-up");
    let readings = [([1.0, 0.0, 0.0], 0.010), ([0.0, 1.0, 0.0], 0.004)]
        .map(|(direction, mm)| Reading { direction, error_mm: mm });
    let program = b"G90 G54 G0 X0 Y0 Z0\nG81 X5 Y5 Z-5 R2 F100\nG80\n";
    let mut out = Vec::new();
    let of = MeanOf::Readings(&readings);
    let averages = average(program, &mut out, Job::new(&corrector, &setup), of).expect("averaged");
    let part = "[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [2, 2]\n";
    let part = Part::parse(part, "part.toml").expect("a part");
    let of = Virtual {
        truth: &truth,
        temperatures: &temperatures,
        setup: &setup,
        most_blocks: 1000,
        dialect: Dialect::Rs274,
        part: Some((&part, &corrector)),
        resolution: None,
    };
    let found = verify_average(&mut &program[..], &mut &out[..], &averages, of).expect("verified");
    assert!(found.before.max_um > 10.0 && found.after.max_um < 1e-6, "{found:?}");
    for found in found.features[0].found.clone().expect("found") {
        assert!(found.position_um.is_some_and(|um| um < 1e-6), "{found:?}");
    }
}

/// The note is added for the first cut from the zero of the set-up file only; a zero set by the program was not probed.
#[test]
fn a_zero_set_by_the_program_was_not_probed() {
    let reading = [Reading { direction: [1.0, 0.0, 0.0], error_mm: 0.010 }];
    let own = "G90 G54 G0 X0 Y0\nG53 G0 Z0\nG92 Z0\nG1 X1 F100\n";
    let both = format!("{own}G92.1\nG0 Z0\nG1 X2\n");
    let zero = Note::OffAtZero("G54".to_owned(), [100, 0, 0]);
    for of in [MeanOf::Places, MeanOf::Readings(&reading)] {
        let (_, found) = run_of("EXX = 10.0", SETUP, own, of).expect(own);
        assert_eq!(found[0].off_at_zero, None, "{of:?}");
        let (_, found) = run_of("EXX = 10.0", SETUP, &both, of).expect(&both);
        assert_eq!(found[0].off_at_zero.as_ref(), Some(&zero), "{of:?}");
    }
}

/// A pitch of 100 µrad with a tool of 300 mm is 30 µm in the mean correction. The program number stays in the first line.
#[test]
fn the_tool_length_counts_and_the_program_number_stays_first() {
    let machine = format!(
        "{TRAVELS}[tool]\ngauge = [0.0, 0.0, 0.0]\nlength = 0.0\n[errors]\nEBZ = {{ poly = [100.0] }}\n"
    );
    let machine = Machine::parse(&machine, "m.toml").expect("a machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.001).expect("compiles");
    let setup =
        SetUp::parse(&format!("{SETUP}[tool.1]\nZ = 300\n"), "setup.toml").expect("a set-up");
    let program = "%\nO0007\nG90 G54 G43 H1 G0 X0 Y0 Z0\nG1 F100 X10\n%\n";
    let mut out = Vec::new();
    let found = average(program.as_bytes(), &mut out, Job::new(&corrector, &setup), MeanOf::Places)
        .expect("averaged");
    assert!((found[0].mean_mm[0].abs() - 0.030).abs() < 1e-4, "{found:?}");
    assert!(String::from_utf8_lossy(&out).starts_with("%\nO0007\nG21 G90\nG10 L2 P1"));
}

/// Incremental motions from another offset or from the start position do not contain the mean correction, so they are
/// refused.
#[test]
fn incremental_motions_from_other_offsets_are_refused() {
    let scale = "EXX = { poly = [0.0, 0.1] }\n";
    for (program, line) in [
        ("G91 G54 G1 X100 F100\n", 1),
        ("G90 G54 G0 X0 Y0 Z0\nG55\nG91 G1 X100 F100\n", 3),
        ("G90 G54 G0 X0 Y0 Z0\nG53 G0 X0\nG91 G1 X100 F100\n", 3),
    ] {
        let text = message(scale, SETUP, program);
        begins(&text, &format!("line {line}: the mean correction of "));
        assert!(text.contains(" does not reach X here"), "{text}");
    }
    let good = "G90 G54 G0 X0 Y0 Z0\nG91 G1 X100 F100\n";
    assert_eq!(run(scale, SETUP, good).expect("averaged").1[0].places, 1);
}

/// Positions that do not depend on the work offset lack the mean correction and are refused: an axis that is never
/// named, another work offset, and a zero that G92 sets at such a position.
#[test]
fn positions_without_the_mean_correction_are_refused() {
    let errors = "EXX = { poly = [10.0, 0.1] }\nEYY = { poly = [4.0] }\n";
    for (program, line, axis) in [
        ("G90 G54\nG92 X0 Y0 Z0\nG1 X10 Y0 F100\n", 3, 'X'),
        ("G90 G54\nG0 X0\nG1 X10 F100\n", 3, 'Y'),
        ("G90 G54 G0 X0 Y0\nG1 X0 F100\nG1 X100\nG55 G1 Y5\n", 4, 'X'),
        ("G90 G55 G0 X0 Y0\nG54\nG92 Y0\nG1 X0 Y0 F100\n", 4, 'Y'),
        ("G90 G54 G0 X0 Y0\nG53 G0 Y0\nG1 X10 F100\n", 3, 'Y'),
        // With the mean correction this motion would be twice as long.
        ("G90 G54 G0 X0 Y0\nG1 X[#5221] F100\n", 2, 'X'),
    ] {
        let text = message(errors, SETUP, program);
        begins(&text, &format!("line {line}: the mean correction of "));
        has(&text, &format!(" does not reach {axis} here"));
    }
    // Z needs no mean correction, and a shift from a named position contains the mean.
    for good in [
        "G90 G54 G0 X0 Y0\nG1 X10 F100\n",
        "G90 G54 G0 X0 Y0\nG92 X5 Y5 Z5\nG1 X10 Y0 F100\n",
        "G90 G54 G52 X5\nG0 X0 Y0\nG1 X10 F100\n",
    ] {
        let (_, found) = run(errors, SETUP, good).expect(good);
        assert!(found[0].left_um[0] < 1e-6, "{found:?}");
    }
    let reads = message(
        errors,
        SETUP,
        "G90 G54 G0 X0 Y0\no1 if [#5221 EQ 100]\nG1 X1 F100\no1 endif\nG1 X2 F100\n",
    );
    has(&reads, "the program reads its work offsets (such as #5221)");
}

/// In inches the new offset has the decimals of its words, 79.99984 and not 79.99984000000001.
#[test]
fn offsets_are_printed_without_meaningless_digits() {
    let program = "G90 G54 G0 X0 Y0 Z1\nG1 F10 Z-0.5\nX2\nM2\n";
    let mut differ = 0;
    for place in 0..40 {
        let x = 79.999 + 0.37 * f64::from(place);
        let setup = format!(
            "units = \"inch\"\n[work_offset.G54]\nX = {x:.3}\nY = 50\nZ = -20.5\n[start]\nX = 0\nY = 0\nZ = 0\n"
        );
        let (out, found) = run("EXX = { poly = [10.0] }\n", &setup, program).expect("averaged");
        let (_, behind) = out.split_once("G10 L2 P1 X").expect("an offset");
        let word = behind.split(' ').next().expect("X");
        let inches: f64 = word.parse().expect("a number");
        // A step of 0.0001 inch is 254 times 0.00001 mm.
        let steps: i64 = format!("{:.0}", inches * 1e4).parse().expect("whole");
        let [whole, rest] = [254 * steps / 100_000, 254 * steps % 100_000];
        let expected = format!("{whole}.{rest:05}");
        let expected = expected.trim_end_matches('0').trim_end_matches('.');
        assert_eq!(found[0].offset_mm[0].to_string(), expected);
        differ += usize::from((25.4 * inches).to_string() != expected);
    }
    assert!(differ > 0, "the product has no such digits anywhere");
}

/// X reaches 50 from 100 and then stays, so its direction of approach stays the same: the mean correction is -2 µm.
/// From an unknown position the mean correction is 0.
#[test]
fn the_mean_has_the_direction_of_approach() {
    let errors = "EXX = { mean = { poly = [0.0] }, reversal = -4 }\n";
    let offset = "[work_offset.G54]\nX = 0\n";
    for (start, mean) in [("[start]\nX = 100\nY = 0\nZ = 0\n", -0.002), ("", 0.0)] {
        let program = "G54 G0 X50 Y0 Z0\nG1 Y10 F100\n";
        let (_, found) = run(errors, &format!("{offset}{start}"), program).expect("averaged");
        assert!((found[0].mean_mm[0] - mean).abs() < 1e-9, "{start}{found:?}");
    }
}

/// Y lags by 12 µm and rests while X moves by 100 mm, where Y is 20 µm too far: by hand the corrections are 6 and -14 µm, mean -4 µm. The
/// correction of Y changes by more than its play, but its drive does not move.
#[test]
fn a_resting_axis_keeps_its_side_of_approach() {
    let errors =
        "EYX = { poly = [0.0, 0.2] }\nEYY = { mean = { poly = [0.0] }, reversal = -12.0 }\n";
    let setup = "[work_offset.G54]\nX = 0\nY = 0\nZ = 0\n[start]\nX = 0\nY = 0\nZ = 0\n";
    let program = "G90 G54 G1 F100 X0 Y10 Z0\nX100\n";
    let (out, found) = run(errors, setup, program).expect("averaged");
    assert!(out.contains("G10 L2 P1 X0.000 Y-0.004 Z0.000"), "{out}");
    assert!((found[0].left_um[0] - 10.0).abs() < 0.01, "{found:?}");
}

/// Where Z comes from above it is 10 µm too far on one machine, and lags so on the other. A hole is cut on the way down, the line after it
/// at the height that Z has reached from the bottom: by hand the corrections cancel. Holes alone are all cut from above.
#[test]
fn a_hole_is_cut_from_above_and_left_from_below() {
    let setup = "[work_offset.G54]\nX = 0\nY = 0\nZ = 0\n[start]\nX = 0\nY = 0\nZ = 60\n";
    for (reversal, of_holes) in [("20.0", "Z0.010"), ("-20.0", "Z-0.010")] {
        let errors = format!("EZZ = {{ mean = {{ poly = [0.0] }}, reversal = {reversal} }}\n");
        for (program, offset) in [
            ("G90 G54 G81 X0 Y0 Z-10 R2 F100\nG80\nG1 X20\n", "Z0.000"),
            ("G90 G54 G0 Z80\nG81 X0 Y0 Z-10 R2 F100\nX10\nG80\n", of_holes),
        ] {
            let (out, found) = run(&errors, setup, program).expect("averaged");
            assert!(out.contains(&format!("Y0.000 {offset}\n")), "{out}");
            assert_eq!(found[0].places, 2, "{found:?}");
        }
    }
}
