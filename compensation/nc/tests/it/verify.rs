//! A program and its result on a virtual machine, compared with closed-form deviations.

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{Dialect, Job, NcError, SetUp, Verification, Virtual, verify};

use crate::identity::{TRAVELS, result_of, verified_by};

fn verified(model: &str, truth: &str, program: &str) -> Result<Verification, NcError> {
    let machine = |errors: &str| {
        Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a good machine")
    };
    let (model, truth, setup) = (machine(model), machine(truth), SetUp::default());
    let bytes = program.as_bytes();
    let (out, summary) =
        result_of((&model, 0.0005), &setup, bytes, |job| Job { keep_shares: true, ..job })?;
    let out = String::from_utf8(out).expect("text");
    let texts = [program, out.as_str()];
    verified_by(&truth, &setup, Dialect::Rs274, texts, &summary.shares)
}

/// The model contains 80 of the true 100 µm/m: at 100 mm, 2 of 10 µm remain.
#[test]
fn unmodelled_errors_remain() {
    let program =
        "G90 G0 X0 Y0 Z0\nG1 F100 X100\nG53 G0 X0\nO1 repeat [2]\nG91 G1 X-50\nO1 endrepeat\nM2\n";
    let errors = |scale: f64| format!("[errors]\nEXX = {{ poly = [0.0, {scale}] }}\n");
    let found = verified(&errors(0.08), &errors(0.1), program).expect("verified");
    assert!((found.before.max_um - 10.0).abs() < 0.01, "{found:?}");
    assert_eq!((found.before.line, found.before.tip_mm[0]), (2, 100.0));
    assert!((found.after.max_um - 2.0).abs() < 0.51, "{found:?}");
    // One segment from 0 to 100, two from 0 to -50 and on to -100, eight positions each, plus the end of the rapid motion.
    assert_eq!((found.motions, found.places), (4, 25));
    let eighths: f64 = (1..=8).map(|i| f64::from(i * i) / 64.0).sum();
    let halves: f64 = (1..=16).map(|i| f64::from(i * i) / 256.0).sum();
    let rms = 10.0 * ((eighths + halves) / 25.0).sqrt();
    assert!((found.before.rms_um - rms).abs() < 0.01, "{found:?}");
}

/// Split lines and arcs stay within the tolerance plus the rounding of their words: from above 30 to below 1.3 µm.
#[test]
fn modelled_errors_are_removed() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEYX = { poly = [0.0, 0.0, 0.0004] }\nEXY = { table = [[-1000, 0], [0, 30], [1000, 0]], interpolation = \"linear\" }\nEC0Y = 60.0\n";
    let program = "G90 G0 X-300 Y-200 Z0\nG1 F100 X300 Y250\nG2 X100 Y50 R220\nG3 I-40 J30\nG81 X10 Y20 Z-5 R1\nX30 L2\n";
    let found = verified(errors, errors, program).expect("verified");
    assert!(found.before.max_um > 30.0, "{found:?}");
    assert!(found.after.max_um < 0.5 + 0.8, "{found:?}");
    // Without motions there is no deviation.
    let empty = verified(errors, errors, "G90\n").expect("verified");
    assert!(empty.path.is_empty());
}

/// A line or an arc has eight positions per started 100 mm, a line of less than 16 mm one per started 2 mm. The last
/// position is the end.
#[test]
fn short_lines_have_few_positions() {
    let truth = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    for (program, places, largest_um) in [
        ("G1 F100 X0.5\n", 1, 0.05),
        ("G1 F100 X2\n", 1, 0.2),
        ("G1 F100 X3 Y4\n", 3, 0.3),
        ("G1 F100 X0\n", 1, 0.0),
        ("G1 F100 X16\n", 8, 1.6),
        ("G1 F100 X99\n", 8, 9.9),
        ("G1 F100 X101\n", 16, 10.1),
        ("G2 F100 X2 I1\n", 8, 0.2),
    ] {
        let found = compared(truth, program, program, &[1.0]);
        assert_eq!(found.places, places, "{program}");
        assert!((found.before.max_um - largest_um).abs() < 1e-6, "{program}: {found:?}");
    }
}

#[test]
fn a_result_of_another_program_is_refused() {
    let truth = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    let (setup, texts) = (SetUp::default(), ["G0 X1\nG0 X2\n", "G0 X1\n"]);
    let error = verified_by(&truth, &setup, Dialect::Rs274, texts, &[1.0, 1.0]);
    let message = error.expect_err("one motion is missing").to_string();
    let expected = "line 2: the result has other motions";
    assert!(message.starts_with(expected), "{message}");
}

/// Compares a program with a hand-written result on a machine with these errors.
fn compared(truth: &str, program: &str, result: &str, shares: &[f64]) -> Verification {
    let truth = Machine::parse(&format!("{TRAVELS}{truth}"), "m.toml").expect("a good machine");
    let found = verified_by(&truth, &SetUp::default(), Dialect::Rs274, [program, result], shares);
    found.expect("verified")
}

/// A scale error is a deviation along a line of its axis and across a line of another axis: 10 µm at X 100. On a circle about the common
/// zero of two equal scales it is purely across; a rotation about that zero is purely along.
#[test]
fn deviations_along_the_path_are_not_across() {
    let ways = |truth: &str, program: &str| {
        let shares = vec![1.0; program.lines().count()];
        compared(truth, program, program, &shares).before
    };
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    let along = ways(scale, "G1 F100 X100\n");
    let eighths: f64 = (1..=8).map(|i| f64::from(i * i) / 64.0).sum();
    assert!((along.max_um - 10.0).abs() < 1e-6, "{along:?}");
    assert!((along.rms_um - 10.0 * (eighths / 8.0).sqrt()).abs() < 1e-6, "{along:?}");
    assert!(along.across_max_um < 1e-6 && along.across_rms_um < 1e-6, "{along:?}");
    let straightness = "[errors]\nEYX = { poly = [0.0, 0.1] }\n";
    let across = ways(straightness, "G1 F100 X100\n");
    assert!((across.across_max_um - 10.0).abs() < 1e-5, "{across:?}");
    assert!((across.across_rms_um - across.rms_um).abs() < 1e-6, "{across:?}");
    // On a diagonal both shares are equal.
    let diagonal = ways(scale, "G1 F100 X100 Y100\n");
    let half = 10.0 / 2_f64.sqrt();
    assert!((diagonal.across_max_um - half).abs() < 1e-5, "{diagonal:?}");
    // A circle of 50 mm from the end of the rapid motion: 5 µm all around with both errors.
    let circle = "G1 F100 X50\nG3 I-50\n";
    let both = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEYY = { poly = [0.0, 0.1] }\n";
    let radial = ways(both, circle);
    assert!((radial.across_max_um - 5.0).abs() < 1e-3, "{radial:?}");
    // The circle of 314 mm has four segments, thus 32 positions; the 8 positions of the line have no deviation across.
    let of_circle = 5.0 * (32.0_f64 / 40.0).sqrt();
    assert!((radial.across_rms_um - of_circle).abs() < 1e-3, "{radial:?}");
    let turned = "[errors]\nEYX = { poly = [0.0, 0.1] }\nEXY = { poly = [0.0, -0.1] }\n";
    let tangential = ways(turned, "G0 X50\nG3 F100 I-50\nG3 I-50\n");
    // The end of the rapid motion has no direction, so its 5 µm count.
    assert!((tangential.max_um - 5.0).abs() < 1e-3, "{tangential:?}");
    let of_end = 5.0 / 65_f64.sqrt();
    assert!((tangential.across_rms_um - of_end).abs() < 1e-3, "{tangential:?}");
}

/// The evaluated positions depend on the program only: split and unsplit results have the same deviation before
/// compensation, also with backlash.
#[test]
fn the_deviation_before_is_independent_of_the_result() {
    let truth = "[errors]\nEXX = { mean = { poly = [0.0, 0.05, 0.0002] }, reversal = -3 }\nEYX = { poly = [0.0, 0.1, 0.001] }\n";
    let program = "G1 F100 X300 Y40\nG3 X200 Y60 R80\n";
    let whole = compared(truth, program, program, &[1.0, 1.0]);
    let split = "G1 F100 X30 Y4\nX30\nX250.02 Y33.4\nX300.01 Y40\nG3 X200 Y60 R80\n";
    let shares = [0.1, 0.1, 0.833_333_3, 1.0, 1.0];
    let parts = compared(truth, program, split, &shares);
    assert_eq!(whole.before, parts.before);
    assert_eq!((whole.motions, whole.places), (parts.motions, parts.places));
    assert_eq!(whole.after, whole.before);
    // Four segments on the line, two on the arc.
    assert_eq!(whole.places, 32 + 16);
    assert_ne!(parts.after, parts.before);
}

/// With the result, one motion is 2 µm off instead of 1 µm, one is better and one unchanged: one worsened motion is counted.
#[test]
fn worsened_motions_are_counted() {
    let truth = "[errors]\nEXX = { poly = [0.0, 0.01] }\n";
    let program = "G1 F100 X100\nX200\nX200 Y50\n";
    // 100.001 is 2.0 µm off, as 200.0 was; then 1.0, and 1.0 of 2.0.
    let result = "G1 F100 X100.001\nX199.999\nX200 Y50\n";
    let found = compared(truth, program, result, &[1.0; 3]);
    assert_eq!(found.further.motions, 1, "{found:?}");
    assert_eq!(found.further.line, Some(1), "{found:?}");
    assert!((found.further.by_um - 1.0).abs() < 1e-3, "{found:?}");
    let same = compared(truth, program, program, &[1.0; 3]);
    assert_eq!(same.further, volcomp_nc::Verification::default().further);
}

/// A correction of −11 µm is −12 µm on a control with steps of 4 µm, and one of 0.001° (17.45 µrad) is 30 µrad with steps of 30 µrad: 6 µm
/// at a radius of 200 mm.
#[test]
fn corrections_are_rounded_to_the_resolution_of_the_control() {
    let scale = format!("{TRAVELS}[errors]\nEXX = {{ poly = [0.0, 0.1] }}\n");
    let table = "structure = \"w C' b X Y Z t\"\naxes = { X = { travel = [0, 400] }, Y = { travel = [0, 400] }, Z = { travel = [0, 400] }, C = { travel = [0, 360] } }\ntool = { tip = [0, 0, 0] }\n";
    let linear = ("G1 F100 X100\n", "G1 F100 X99.989\n");
    let rotary = ("G0 X200\nG1 F100 C90\n", "G0 X200\nG1 F100 C90.001\n");
    for (machine, (program, result), resolution, expected_um) in [
        (scale.as_str(), linear, None, 1.001),
        (scale.as_str(), linear, Some(4.0), 2.001),
        (table, rotary, None, 3.4907),
        (table, rotary, Some(30.0), 6.0),
    ] {
        let of = Virtual {
            truth: &Machine::parse(machine, "m.toml").expect("a machine"),
            temperatures: &Temperatures::new(),
            setup: &SetUp::default(),
            most_blocks: 10,
            dialect: Dialect::Rs274,
            part: None,
            resolution,
        };
        let found = verify(&mut program.as_bytes(), &mut result.as_bytes(), &[1.0, 1.0], of);
        let path = found.expect("verified").path;
        let end = path.last().expect("the end");
        let off: f64 = end.after_um.iter().map(|um| um * um).sum::<f64>().sqrt();
        assert!((off - expected_um).abs() < 1e-2, "{program} {resolution:?}: {off}");
    }
}
