//! Wrong calibration files are refused with file, line and key.

use std::fs;

use volcomp_calibrate::{CalibrationFile, calibrate};

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
