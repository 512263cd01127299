//! Every error in a shop file, or in a shop built in code, is reported.

use proptest::prelude::*;
use volcomp_model::Machine;
use volcomp_shop::{
    Bar, Instrument, InstrumentError, Poses, Setting, Shop, ShopError, ShopObservation,
};
use volcomp_test_support::corpus::replay;
use volcomp_vocabulary::{Um, Urad};

const TRUTH: &str =
    "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n";

fn shop(text: &str) -> Result<Shop, ShopError> {
    Shop::parse(text, "shop.toml", |name| Ok(Machine::parse(TRUTH, name)?))
}

const SHOP: &str = "machine = \"truth.toml\"\nseed = 1\nformat = \"csv\"\n[instrument]\nnoise_um = 1.0\ntargets = 5\nruns = 2\n\
    [[measurement]]\nerrors = [\"EXX\", \"EAX\"]\nat = { Y = 10 }\npoint = [0, 1, 2]\nrides = \"other\"\ncurve = { mls = { order = 2 } }\n\
    [[measurement]]\nerror = \"EYX\"\nmethod = \"angular\"\nbridge_mm = 25\nsign = -1\n\
    [[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = 2.0\n";

proptest! {
    #[test]
    fn damaged_shops_do_not_panic(
        place in 0..SHOP.len(), cut in 0..20_usize, put in "[\\[\\]{}=,.'\"# \n0-9a-zA-Z-]{0,6}",
    ) {
        let end = (place + cut).min(SHOP.len());
        let damaged = format!("{}{put}{}", &SHOP[..place], &SHOP[end..]);
        match shop(&damaged) {
            // A damaged number can request 100 000 readings of each line.
            Ok(shop) if shop.lines.iter().all(|l| l.instrument.targets * (l.instrument.runs as usize) < 5000) => {
                let files = shop.files(|_, _| {}).expect("a shop that was read can measure");
                prop_assert_eq!(files.len(), shop.lines.len() + 2);
            }
            Ok(_) => {}
            Err(error) => prop_assert!(error.to_string().starts_with("shop.toml"), "{}", error),
        }
    }

    #[test]
    fn odd_shops_built_in_code_do_not_panic(
        noise in any::<f64>(), step in any::<f64>(), alignment in any::<f64>(), targets in 0..40_usize,
        runs in 0..4_u32, at in prop::collection::vec(any::<f64>(), 0..5), sign in any::<f64>(),
        angle in any::<f64>(),
    ) {
        let mut shop = shop(SHOP).expect("a valid shop");
        for line in &mut shop.lines {
            line.instrument.length.noise = Um(noise);
            line.instrument.angle.resolution = Urad(step);
            line.instrument.alignment = Urad(alignment);
            (line.instrument.targets, line.instrument.runs) = (targets, runs);
            line.setup.at.clone_from(&at);
            line.setup.sign = sign;
        }
        shop.squareness[0].1 = Urad(angle);
        let _ = shop.files(|_, _| {});
    }
}

#[test]
fn what_is_wrong_with_an_instrument_built_in_code_is_named() {
    let mut wrong = shop(SHOP).expect("a valid shop");
    wrong.lines[0].instrument.targets = 1;
    let error = wrong.files(|_, _| {}).expect_err("one target");
    let ShopError::Instrument { source, .. } = &error else {
        panic!("{error}");
    };
    assert!(matches!(source, InstrumentError::Targets { found: 1, .. }));
    assert_eq!(error.to_string(), "the line of EXX: found 1 targets, expected 2 to 100000");
}

/// Too many readings are rejected: all are in memory at once, so a number that one line permits is too large for many lines.
#[test]
fn more_readings_than_fit_are_refused() {
    let lines =
        "targets = 100000\nruns = 10\n[[measurement]]\nerrors = [\"EXX\", \"EYY\", \"EYX\"]\n";
    let text = format!("machine = \"truth.toml\"\n[instrument]\n{lines}");
    let error = shop(&text).and_then(|shop| shop.files(|_, _| {}));
    assert_eq!(
        error.expect_err("six million readings").to_string(),
        "the shop makes 6000000 readings, expected at most 5000000: fewer targets, runs or poses"
    );
    let mut many = shop(SHOP).expect("a valid shop");
    let line = many.lines[0].clone();
    many.lines[0].instrument.runs = 100_000;
    many.lines = vec![many.lines[0].clone(); 6];
    assert!(matches!(many.files(|_, _| {}), Err(ShopError::Readings { .. })));
    many.lines = vec![line];
    assert!(many.files(|_, _| {}).is_ok());
    many.observations = vec![ShopObservation {
        name: "observed".to_owned(),
        instrument: Instrument::default(),
        at: Vec::new(),
        tools: Vec::new(),
        setting: Setting::Sphere {
            poses: Poses::Drawn(100_000),
            centres: vec![[0.0; 3]; 51],
            reads: volcomp_shop::Reads::Offset,
        },
    }];
    assert!(matches!(many.files(|_, _| {}), Err(ShopError::Readings { .. })));
}

#[test]
fn what_is_wrong_with_an_observation_built_in_code_is_named() {
    let bar = |marks: usize| Bar {
        origin: [0.0; 3],
        direction: [1.0, 0.0, 0.0],
        distances: (0..marks).map(|mark| mark as f64).collect(),
        calibration: Um(0.0),
    };
    let points =
        |poses| Setting::Points { poses: Poses::Drawn(poses), frame: [0.0; 6], target: None };
    let diagonals = |names: &[&str]| Setting::Diagonals {
        names: names.iter().map(|name| (*name).to_owned()).collect(),
    };
    for (setting, expected) in [
        (points(0), "found 0 poses, expected 1 to 100000"),
        (points(usize::MAX), "poses, expected 1 to 100000"),
        (Setting::StepGauge(bar(1)), "found 1 distances, expected 2 to 10000"),
        (diagonals(&[]), "found 0 diagonals, expected 1 to 4"),
        (diagonals(&["../x"]), "found the diagonal \"../x\", expected one of PPP, NPP, PNP, PPN"),
    ] {
        let mut wrong = shop(SHOP).expect("a valid shop");
        wrong.observations.push(ShopObservation {
            name: "observed".to_owned(),
            instrument: Instrument::default(),
            at: Vec::new(),
            tools: Vec::new(),
            setting,
        });
        let error = wrong.files(|_, _| {}).expect_err("it cannot be made");
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// A measurement without an error, or with an error twice, is rejected as in the calibration file that would be written.
#[test]
fn a_measurement_names_each_error_once_and_at_least_one() {
    for (errors, expected) in [
        ("[]", "shop.toml:2: measurement[0]: found no error in `errors`, expected at least one"),
        ("[\"EXX\", \"EYX\", \"EXX\"]", "EXX appears twice"),
    ] {
        let text = format!("machine = \"truth.toml\"\n[[measurement]]\nerrors = {errors}\n");
        let error = shop(&text).expect_err(errors).to_string();
        assert!(error.contains(expected), "{error}");
    }
    // Two lines of one error need two tables.
    let line = "[[measurement]]\nerror = \"EXX\"\n";
    shop(&format!("machine = \"truth.toml\"\n{line}{line}")).expect("a valid shop");
}

/// The machine in `tests/fuzz/fuzz_targets/shop.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
errors.EXX = { poly = [0.0, 0.01] }
";

#[test]
fn shop_files() {
    replay("shop", |_, bytes| {
        let text = String::from_utf8_lossy(bytes);
        let machine = |_: &str| Ok(Machine::parse(MACHINE, "truth.toml")?);
        let shop = Shop::parse(&text, "shop.toml", machine)?;
        let _ = shop.files(|_, _| {});
        Ok::<_, ShopError>(())
    });
}
