//! Wrong calibration files are refused with file, line and key.

use std::fs;

use volcomp_calibrate::{CalibrationFile, Shop, calibrate};
use volcomp_model::Machine;

const GOOD: &str =
    "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"a.csv\"\n";

#[test]
fn every_wrong_key_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("written");
        path
    };
    write(
        "machine.toml",
        "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n",
    );
    write("a.csv", "target,deviation\n0,1\n50,2\n100,4\n");
    let good = write("good.toml", GOOD);
    assert!(calibrate(&CalibrationFile::read(&good).expect("read"), |_, _| {}).is_ok());
    for (added, expected) in [
        ("at = { Z = 1 }", ":5: measurement[0].at.Z: the structure"),
        ("at = { X = 1 }", "X is the measured axis"),
        ("at = { Y = nan }", "expected a finite number"),
        ("poitn = [0, 0, 0]", ":5: measurement[0].poitn: unknown key"),
        ("rides = \"bus\"", "expected one of: carriage, other"),
        ("sign = 2", "expected 1 or -1"),
        ("method = \"magic\"", "expected one of: direct, angular"),
        ("method = \"angular\"", "key `bridge_mm` is missing"),
        ("bridge_mm = 100.0", "expected only with method"),
        ("unit = \"inch\"", "expected one of: um, mm"),
        ("curve = \"best\"", "found \"best\", expected \"auto\""),
        ("curve = { poly = {}, mls = {} }", "found 2 kinds of curve"),
        ("curve = { poly = { ordr = 2 } }", "unknown key"),
        ("curve = { fourier = {} }", "on a rotary axis"),
        ("[[squareness]]\nerror = \"EXX\"", "squareness[0].error"),
        (
            "[[squareness]]\nerror = \"EC0Y\"\nfrom = [\"EXX\", \"EYX\"]",
            "expected [\"EXY\", \"EYX\"]",
        ),
        (
            "[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = 1\nreference_angle_urad = 1",
            "together",
        ),
        (
            "[[measurement]]\nerror = \"EXZ\"\nfile = \"a.csv\"",
            "has no axis Z",
        ),
        (
            "[[measurement]]\nerror = \"EC0Y\"\nfile = \"a.csv\"",
            "squareness has its own table",
        ),
        (
            "[[measurement]]\nerror = \"EXX\"\nfile = \"b.csv\"",
            "b.csv: cannot be read",
        ),
        ("error = \"EYX\"", "duplicate key"),
        (
            "curve = { poly = {} }\n[[measurement]]\nerror = \"EXX\"\nfile = \"a.csv\"\ncurve = { bspline = {} }",
            "another kind of curve for EXX than with",
        ),
    ] {
        let path = write("bad.toml", &format!("{GOOD}{added}\n"));
        let message = CalibrationFile::read(&path).expect_err(added).to_string();
        assert!(message.contains(expected), "{added}: {message}");
    }
    let path = write(
        "bad.toml",
        &format!("{GOOD}[[squareness]]\nerror = \"EC0Y\"\n"),
    );
    let message = calibrate(&CalibrationFile::read(&path).expect("read"), |_, _| {})
        .expect_err("no lines")
        .to_string();
    assert!(message.contains("was not measured"), "{message}");
}

const SHOP: &str = "machine = \"truth.toml\"\nseed = 1\nformat = \"csv\"\n[instrument]\nnoise_um = 1.0\ntargets = 5\nruns = 2\n\
    [[measurement]]\nerrors = [\"EXX\", \"EAX\"]\nat = { Y = 10 }\npoint = [0, 1, 2]\nrides = \"other\"\ncurve = { mls = { order = 2 } }\n\
    [[measurement]]\nerror = \"EYX\"\nmethod = \"angular\"\nbridge_mm = 25\nsign = -1\n\
    [[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = 2.0\n";

proptest::proptest! {
    /// Whatever is cut out of or put into a shop file, it measures or says what is wrong.
    #[test]
    fn damaged_shops_do_not_panic(
        place in 0..SHOP.len(), cut in 0..20_usize, put in "[\\[\\]{}=,.'\"# \n0-9a-zA-Z-]{0,6}",
    ) {
        let end = (place + cut).min(SHOP.len());
        let damaged = format!("{}{put}{}", &SHOP[..place], &SHOP[end..]);
        let truth = "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n";
        let shop = Shop::parse(&damaged, "shop.toml", |_| Ok(Machine::parse(truth, "truth.toml")?));
        match shop {
            // A damaged number can ask for a hundred thousand readings of each line.
            Ok(shop) if shop.lines.iter().all(|l| l.instrument.targets * (l.instrument.runs as usize) < 5000) => {
                let files = shop.files(|_, _| {}).expect("a shop that was read can measure");
                proptest::prop_assert_eq!(files.len(), shop.lines.len() + 2);
            }
            Ok(_) => {}
            Err(error) => proptest::prop_assert!(error.to_string().starts_with("shop.toml"), "{}", error),
        }
    }
}
