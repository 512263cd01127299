//! Corrections stay within the limit, and within the travel if the programmed positions do.

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::{Machine, Temperatures, vocabulary::CorrectionLimit};
use volcomp_nc::{BoundViolation, Corrector, Dialect, Job, MeanOf, NcError, SetUp, average};

use volcomp_test_support::rows;

use crate::identity::result_of;

const TRAVELS: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0, 600]\n[axes.Y]\ntravel = [-300, 300]\n[axes.Z]\ntravel = [-400, 0]\n[errors]\n";

fn machine(errors: &str) -> Machine {
    Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a good machine")
}

fn limited(
    errors: &str,
    program: &str,
    dialect: Dialect,
    limit_um: f64,
) -> Result<String, NcError> {
    let setup = SetUp::parse("[start]\nX = 100\nY = 0\nZ = 0\n", "setup.toml").expect("a set-up");
    let (machine, program) = (machine(errors), program.as_bytes());
    let (out, _) = result_of((&machine, 0.001), &setup, program, |job| Job {
        dialect,
        limit: CorrectionLimit::new(limit_um).expect("a limit"),
        ..job
    })?;
    Ok(String::from_utf8(out).expect("text"))
}

fn message(errors: &str, program: &str) -> String {
    let refused = limited(errors, program, Dialect::Rs274, 250.0);
    refused.expect_err("it is refused").to_string()
}

/// Corrections above the limit, as from wrong units, are refused in every kind of motion and every language.
#[test]
fn a_correction_beyond_the_limit_is_refused() {
    let rs274 = [
        "G0 X200",
        "G1 F100 X200",
        "G1 F100 X100\nX200\nX200 Y10",
        "G0 X200 Y0 Z-10\nG2 F100 X210 Y10 I10",
        "G0 Z-5\nG81 X200 Y1 Z-20 R-2 F50",
        "G91\nG0 X100",
        "G20\nG0 X7.5",
        "O100 sub\nG0 X200\nO100 endsub\nO100 call\nM2",
        "#1 = 200\nG0 X#1",
        "G16\nG0 X200 Y0",
    ];
    for program in rs274 {
        // 20 µm/mm instead of 0.02; a constant of 10 m; positions instead of deviations, with which Newton's method oscillates.
        for errors in [
            "EXX = { poly = [0.0, 20] }\n",
            "EXX = { poly = [1e7, 0.02] }\n",
            "EXX = { table = [[0, 0], [300, 299994], [600, 599988]] }\n",
            "EXX = { table = [[0, 0], [300, 300006], [600, 600012]] }\n",
        ] {
            let program = format!("G21 G90 G0 X0 Y0\n{program}\n");
            let message = message(errors, &program);
            assert!(
                message.contains("the correction of X is -") && message.contains("at most 250 µm"),
                "{program}: {message}"
            );
        }
    }
    for (dialect, program) in [
        (Dialect::Siemens, "G90 G0 X0 Y0\nG1 F100 X200\nM30\n"),
        (Dialect::Heidenhain, "0 BEGIN PGM A MM\n1 L X+200 Y+0 R0 FMAX\n2 END PGM A MM\n"),
    ] {
        let found = limited("EXX = { poly = [0.0, 20] }\n", program, dialect, 250.0);
        assert!(
            matches!(
                found,
                Err(NcError::OutOfBounds { violation: BoundViolation::BeyondLimit { .. }, .. })
            ),
            "{dialect:?}: {found:?}"
        );
    }
    // −2·130/1.002 µm, as the word is rounded.
    let message = message("EXX = { poly = [0.0, 2] }\n", "G90 G0 X100\nX120\nX130\n");
    assert_eq!(
        message,
        "line 3: the correction of X is -259.0 µm, expected at most 250 µm: check the units in the machine file"
    );
}

#[test]
fn the_limit_has_a_ceiling() {
    let errors = "EXX = { poly = [0.0, 5] }\n";
    let program = "G90 G0 X200\n";
    let written = limited(errors, program, Dialect::Rs274, 1000.0).expect("within 1 mm");
    assert_eq!(written, "G90 G0 X199.005\n");
    assert!(limited(errors, program, Dialect::Rs274, 990.0).is_err());
    for refused in [0.0, -1.0, 2000.1, f64::NAN, f64::INFINITY] {
        assert!(CorrectionLimit::new(refused).is_err(), "{refused}");
    }
    assert!(CorrectionLimit::new(2000.0).is_ok());
}

#[test]
fn a_corrected_coordinate_does_not_leave_the_travel() {
    let errors = "EXX = { poly = [-10.0] }\nEZZ = { poly = [-5.0] }\nEYY = { poly = [20.0] }\n";
    for [program, expected] in rows(
        r"
G90 G0 X600\n | line 1: the correction moves X from 600 mm to 600.01 mm in machine coordinates, outside its travel of 0 mm to 600 mm
G90 G0 X599.995 Y0\nG1 F100 Y-300\n | line 1: the correction moves X from 599.995 mm to 600.005 mm
G90 G0 X10\nG1 F100 Y-299.99\n | line 2: the correction moves Y from -299.99 mm to -300.01 mm
// The arc reaches the end of X half-way.
G90 G0 X590 Y-10\nG3 F100 X590 Y10 J10\n | line 2: the correction moves X from 600 mm to 600.01 mm
// The plane R of the hole is the end of Z.
G90 G0 Z-5\nG98 G81 X10 Y0 Z-20 R0 F50\n | line 2: the correction moves Z from 0 mm to 0.005 mm
",
    ) {
        let message = message(errors, program);
        assert!(message.starts_with(expected), "{program}: {message}");
    }
    for program in [
        // A correction below the rounding changes nothing.
        "G90 G0 X0\nG0 Y300\n",
        "G90 G0 X599.98 Y-200\n",
        // A program that leaves the travel already gets a note.
        "G90 G0 X601\n",
        "G90 G0 X580 Y-10\nG3 F100 X580 Y10 J10\n",
    ] {
        limited(errors, program, Dialect::Rs274, 250.0).expect(program);
    }
}

#[test]
fn the_mean_keeps_the_bounds() {
    let setup = "[work_offset.G54]\nX = 100\nY = 0\nZ = -20\n[start]\nX = 0\nY = 0\nZ = 0\n";
    let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
    for [errors, program, expected] in rows(
        r"
EXX = { poly = [300.0] }\n | G54 G90 G0 X0 Y0\nG1 F100 X20\n | line 2: the correction of X is -300.0 µm
EXX = { poly = [-10.0] }\n | G54 G90 G0 X0 Y0\nG1 F100 X20\nX500\n | line 3: the correction moves X from 600 mm to 600.01 mm
",
    ) {
        let corrector =
            Corrector::new(&machine(errors), &Temperatures::new(), 0.001).expect("compiles");
        let job = Job::new(&corrector, &setup);
        let found = average(program.as_bytes(), &mut Vec::new(), job, MeanOf::Places);
        let message = found.expect_err("it is refused").to_string();
        assert!(message.starts_with(expected), "{message}");
    }
}

/// An independent reader finds every written word within limit and travel.
#[test]
fn corrections_beyond_the_bounds_are_not_written() {
    let mut random = ChaCha8Rng::seed_from_u64(35);
    let (mut written, mut refused) = (0, 0);
    for _ in 0..300 {
        let slope: f64 = random.random_range(-1.5..1.5);
        let constant: f64 = random.random_range(-100.0..100.0);
        let errors =
            format!("EXX = {{ poly = [{constant}, {slope}] }}\nEYY = {{ poly = [{constant}] }}\n");
        let places: Vec<[f64; 2]> = (0..6)
            .map(|_| {
                let x = *[0.0, 600.0, 300.0, 599.9, 0.05, 150.0]
                    .get(random.random_range(0..6))
                    .unwrap_or(&1.0);
                [x, random.random_range(-300.0_f64..300.0).round()]
            })
            .collect();
        let lines = places.iter().map(|[x, y]| format!("G1 F100 X{x} Y{y}\n"));
        let program = format!("G90 G0 X150 Y0\n{}", lines.collect::<String>());
        let Ok(out) = limited(&errors, &program, Dialect::Rs274, 250.0) else {
            refused += 1;
            continue;
        };
        written += 1;
        let words = |text: &str, letter: char| -> Vec<f64> {
            let words = text.split_whitespace().filter_map(|word| word.strip_prefix(letter));
            words.filter_map(|number| number.parse().ok()).collect()
        };
        for (letter, [low, high]) in [('X', [0.0, 600.0]), ('Y', [-300.0, 300.0])] {
            for at in words(&out, letter) {
                assert!((low..=high).contains(&at), "{errors}{program}{out}");
            }
        }
        // Linear errors, so that no line is split.
        let pairs = words(&program, 'X').into_iter().zip(words(&out, 'X'));
        for (before, after) in pairs {
            assert!((before - after).abs() <= 0.2505, "{errors}{program}{out}");
        }
    }
    assert!(written > 20 && refused > 20, "{written} written, {refused} refused");
}
