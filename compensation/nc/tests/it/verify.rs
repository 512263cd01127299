//! A program and its result on a virtual machine, against deviations that are known on paper.

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Corrector, Job, NcError, SetUp, Verification, Virtual, compensate, picture, verify,
};

use crate::identity::TRAVELS;

fn verified(model: &str, truth: &str, program: &str) -> Result<Verification, NcError> {
    let machine = |errors: &str| {
        Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a good machine")
    };
    let (none, setup) = (Temperatures::new(), SetUp::default());
    let corrector = Corrector::new(&machine(model), &none, 0.0005)?;
    let mut out = Vec::new();
    let job = Job {
        keep_shares: true,
        ..Job::new(&corrector, &setup)
    };
    let summary = compensate(&mut program.as_bytes(), &mut out, job, |_| Ok(()))?;
    let of = Virtual {
        truth: &machine(truth),
        temperatures: &none,
        setup: &setup,
        most_blocks: 10_000,
        dialect: volcomp_nc::Dialect::Rs274,
        part: None,
    };
    verify(&mut program.as_bytes(), &mut &out[..], &summary.shares, of)
}

/// The model knows 80 of 100 µm/m: of 10 µm at 100 mm 2 are left.
#[test]
fn what_the_model_does_not_know_is_left() {
    let program =
        "G90 G0 X0 Y0 Z0\nG1 F100 X100\nG53 G0 X0\nO1 repeat [2]\nG91 G1 X-50\nO1 endrepeat\nM2\n";
    let errors = |scale: f64| format!("[errors]\nEXX = {{ poly = [0.0, {scale}] }}\n");
    let found = verified(&errors(0.08), &errors(0.1), program).expect("verified");
    assert!((found.before.max_um - 10.0).abs() < 0.01, "{found:?}");
    assert_eq!((found.before.line, found.before.tip_mm[0]), (2, 100.0));
    assert!((found.after.max_um - 2.0).abs() < 0.51, "{found:?}");
    // One way from 0 to 100, two from 0 to -50 and on to -100, at eight places each, and the rapid motion's end.
    assert_eq!((found.motions, found.places), (4, 25));
    let eighths: f64 = (1..=8).map(|i| f64::from(i * i) / 64.0).sum();
    let halves: f64 = (1..=16).map(|i| f64::from(i * i) / 256.0).sum();
    let rms = 10.0 * ((eighths + halves) / 25.0).sqrt();
    assert!((found.before.rms_um - rms).abs() < 0.01, "{found:?}");
}

/// Long lines and arcs that are written in parts stay within the tolerance and the rounding of their words.
#[test]
fn what_the_model_knows_is_gone() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEYX = { poly = [0.0, 0.0, 0.0004] }\nEXY = { table = [[-1000, 0], [0, 30], [1000, 0]], interpolation = \"linear\" }\nEC0Y = 60.0\n";
    let program = "G90 G0 X-300 Y-200 Z0\nG1 F100 X300 Y250\nG2 X100 Y50 R220\nG3 I-40 J30\nG81 X10 Y20 Z-5 R1\nX30 L2\n";
    let found = verified(errors, errors, program).expect("verified");
    assert!(found.before.max_um > 30.0, "{found:?}");
    assert!(found.after.max_um < 0.5 + 0.8, "{found:?}");
    let svg = picture(&found);
    assert!(svg.contains("without compensation: at most"), "{svg}");
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    // Nothing moves: still a picture.
    let empty = verified(errors, errors, "G90\n").expect("verified");
    assert!(picture(&empty).ends_with("</svg>\n"));
}

#[test]
fn a_result_of_another_program_is_told() {
    let (none, setup) = (Temperatures::new(), SetUp::default());
    let truth = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    let of = Virtual {
        truth: &truth,
        temperatures: &none,
        setup: &setup,
        most_blocks: 10_000,
        dialect: volcomp_nc::Dialect::Rs274,
        part: None,
    };
    let mut original = "G0 X1\nG0 X2\n".as_bytes();
    let error = verify(&mut original, &mut "G0 X1\n".as_bytes(), &[1.0, 1.0], of);
    let message = error.expect_err("one motion is missing").to_string();
    assert!(
        message.starts_with("line 2: the result does not make"),
        "{message}"
    );
}
