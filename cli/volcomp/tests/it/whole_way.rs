//! From a truth through laser files to a corrected machine.

use std::{fmt::Write as _, fs};

use serde_json::Value;

use crate::{Folder, contains, float, json, list, refused, refuses, root, text, volcomp};

const SHOP: &str = "cli/volcomp/demo/shop.toml";

#[test]
fn the_demo_reaches_its_goals() {
    let answer = json(&["demo"]);
    let lines = list(&answer["lines"]);
    for line in lines {
        // The floor does not include the noise of accumulated tilts, so lines measured by tilts have a larger limit.
        let from_tilts =
            ["EYX", "EZX", "EXY", "EZY"].contains(&line["error"].as_str().expect("a name"));
        let most = if from_tilts { 2.2 } else { 1.5 };
        assert!(float(&line["times_floor"]) <= most, "{line}");
        // The floor includes the noise of the mean and the output step of 1 µm.
        assert!(float(&line["floor_um"]) > 0.9, "{line}");
    }
    let mean = &answer["mean_percent"];
    assert!(float(&mean["positioning"]) <= -94.0, "{mean}");
    assert!(float(&mean["straightness"]) <= -90.0, "{mean}");
    assert!(float(&mean["diagonals"]) <= -95.0, "{mean}");
    let irregular = &answer["irregular_curve"];
    let third = float(&irregular["polynomial_um"]) / 3.0;
    assert!(float(&irregular["mls_um"]) <= third, "{irregular}");
    for squareness in list(&answer["squareness"]) {
        assert!(float(&squareness["after_urad"]).abs() < 2.0, "{squareness}");
    }
}

/// Before correction every row of the demo has the published value, and after correction it is below the published one.
#[test]
fn the_published_gantry_is_passed_in_every_row() {
    let folder = Folder::new();
    let kept = folder.path().display().to_string();
    let answer = json(&["demo", "-o", &kept]);
    let published = &answer["published"];
    let lines = list(&published["lines"]);
    assert_eq!(lines.len(), 9);
    for line in lines {
        let (before, printed) = (float(&line["before_um"]), float(&line["paper_before_um"]));
        assert!((before - printed).abs() < 0.5, "{line}");
        if !line["paper_after_um"].is_null() {
            assert!(float(&line["after_um"]) < float(&line["paper_after_um"]), "{line}");
        }
    }
    let printed = |line: &&Value| !line["paper_after_um"].is_null();
    assert_eq!(lines.iter().filter(printed).count(), 8);
    let residuals = list(&published["residuals"]);
    assert_eq!(residuals.len(), 15, "five methods on X, Y and Z");
    let mut rows = 0;
    for row in residuals.iter().filter(|row| !row["paper_min_um"].is_null()) {
        rows += 1;
        let size = |min: &str, max: &str| float(&row[max]) - float(&row[min]);
        assert!(size("min_um", "max_um") < size("paper_min_um", "paper_max_um"), "{row}");
    }
    assert_eq!(rows, 4);
    let of = |error: &str, method: &str| {
        let row = |row: &&Value| row["error"] == error && row["method"] == method;
        let row = residuals.iter().find(row).expect("a row");
        float(&row["max_um"]).max(-float(&row["min_um"]))
    };
    for error in ["EXX", "EYY", "EZZ"] {
        for order in 6..=8 {
            let polynomial = of(error, &format!("polynomial of order {order}"));
            assert!(of(error, "moving least squares") < polynomial, "{error} {order}");
        }
    }
    // The pitch at two heights of Y is almost linear, so the tilts are compared with their own best-fit line.
    let pitch = json(&format!("fit {kept}/eay.rta --method poly --order 1"));
    let left = &pitch["residual_urad"];
    let span = json(&["iso230", &format!("{kept}/eay.rta")]);
    let left = float(&left["max"]) - float(&left["min"]);
    assert!(left < 0.1 * float(&span["M_urad"]), "{left} {span}");
    let text = text(&["demo"]);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    insta::assert_snapshot!(text);
}

/// Moving least squares with a separate setting for each line reduce positioning errors by 95 % and straightness errors
/// by 91 % or more. A common setting (order 4, one third of the range) left 5.6, 10.0 and 4.8 %.
#[test]
fn the_demo_with_moving_least_squares_alone() {
    let folder = Folder::new();
    let kept = folder.path().display().to_string();
    let answer = json(&["demo", "--curve", "mls", "-o", &kept]);
    let calibrated = fs::read_to_string(folder.path().join("calibrated.toml")).expect("kept");
    let curves = calibrated.lines().filter(|line| line.starts_with('E'));
    for curve in curves.filter(|line| line.contains('{')) {
        contains(curve, "mls");
        assert!(!curve.contains("bspline") && !curve.contains("poly"));
    }
    let mean = &answer["mean_percent"];
    assert!(float(&mean["positioning"]) <= -95.0, "{mean}");
    assert!(float(&mean["straightness"]) <= -91.0, "{mean}");
    assert!(float(&mean["diagonals"]) <= -96.0, "{mean}");
    // The settings in the answer are those of the kept machine file, and they differ between the curves.
    let settings = list(&answer["curves"]);
    assert_eq!(settings.len(), 36, "18 errors, two directions");
    let of =
        |setting: &Value| format!("order = {}, support = {}", setting["order"], setting["support"]);
    for setting in settings {
        assert_eq!(setting["curve"], "mls", "{setting}");
        let error = setting["error"].as_str().expect("a name");
        let mut lines = calibrated.lines();
        let line = lines.find(|line| line.starts_with(error)).expect("a curve");
        assert!(line.contains(&of(setting)), "{setting}: {line}");
    }
    assert!(settings.iter().any(|setting| of(setting) != of(&settings[0])));
    let printed = text(&["demo", "--curve", "mls"]);
    assert!(printed.lines().all(|line| line.len() <= 80), "{printed}");
    contains(&printed, "moving least squares  direction  order  support");
    // The kept calibration file contains the settings, so that calibrating again gives the same machine.
    let again = folder.file("again.toml");
    let calibration = folder.file("calibration.toml");
    json(&["calibrate", &calibration, "-o", &again]);
    assert_eq!(fs::read_to_string(again).expect("written"), calibrated);
}

/// In automatic mode every linear axis of the demo has a residual of at most 2 µm, and a leave-one-out error no larger
/// than that of the default setting.
#[test]
fn the_automatic_mode_meets_2_um_on_the_demo() {
    let folder = Folder::new();
    json(&["simulate", SHOP, "-o", &folder.path().display().to_string()]);
    for file in ["exx.rtl", "eyy.rtl", "ezz.rtl"] {
        let path = folder.path().join(file).display().to_string();
        let fit = ["fit", &path, "--method", "mls"];
        let default = json(&fit);
        let automatic = json(&[&fit[..], &["--auto", "--residual-um", "2", "--scan"]].concat());
        assert_eq!(automatic["meets_required"], true, "{file}");
        for end in ["min", "max"] {
            assert!(float(&automatic["residual_um"][end]).abs() <= 2.0, "{file}");
        }
        let leave_one_out = float(&automatic["leave_one_out_um"]);
        assert!(leave_one_out <= float(&default["leave_one_out_um"]), "{file}");
        // The scan contains the chosen setting.
        let scan = list(&automatic["scan"]);
        let curve = &automatic["curve"]["mls"];
        let is_taken = |trial: &&Value| {
            trial["order"] == curve["order"]
                && (float(&trial["support"]) - float(&curve["support"])).abs() < 1e-9
        };
        let taken: Vec<&Value> = scan.iter().filter(is_taken).collect();
        assert_eq!(taken.len(), 1, "{file}");
        // The scan factorises all orders of a target at once. The curve factorises its own order alone.
        let scanned = float(&taken[0]["leave_one_out_rms"]);
        assert!((scanned - leave_one_out).abs() < 1e-9 * scanned, "{file}");
        let meeting = scan.iter().filter(|trial| float(&trial["max_residual"]) <= 2.0);
        let least =
            meeting.map(|trial| float(&trial["leave_one_out_rms"])).fold(f64::INFINITY, f64::min);
        assert!((least - leave_one_out).abs() < 1e-6, "{file}");
    }
}

#[test]
fn laser_files_make_a_machine_file() {
    let folder = Folder::new();
    let lasers = folder.path().join("lasers");
    let answer = json(&["simulate", SHOP, "-o", &lasers.display().to_string()]);
    let files = list(&answer["files"]);
    assert_eq!(files.len(), 22, "{files:?}");
    for name in ["eyy-2.rtl", "eay.rta", "machine.toml", "calibration.toml"] {
        assert!(lasers.join(name).is_file(), "{name}");
    }
    let calibration = lasers.join("calibration.toml").display().to_string();
    let machine = folder.file("found.toml");
    let told = text(&["calibrate", &calibration, "-o", &machine]);
    let told = told.replace(&folder.path().display().to_string(), "[folder]");
    insta::assert_snapshot!(told);
    let answer = json(&["calibrate", &calibration, "-o", &machine]);
    // The only warning covers the straightness files.
    let [told] = &list(&answer["warnings"])[..] else {
        panic!("{}", answer["warnings"]);
    };
    let told = told.as_str().expect("a text");
    assert!(
        told.contains("no real file has proven") && told.matches(".rts").count() == 3,
        "{told}"
    );
    assert_eq!(answer["file"], machine);
    let curves = list(&answer["curves"]);
    assert_eq!(curves.len(), 36, "18 errors in two directions");
    // Reversal values of the truth: 3, −2 and 2.5 µm.
    for (error, reversal) in [("EXX", 3.0), ("EYY", -2.0), ("EZZ", 2.5)] {
        let curve = curves.iter().find(|c| c["error"] == error).expect("fitted");
        let found = float(&curve["reversal"]);
        assert!((found - reversal).abs() < 2.0, "{error}: {found}");
    }
    json(&["error", "-m", &machine, "--at", "X=100,Y=100,Z=100"]);
}

#[test]
fn broken_shops_are_refused() {
    let folder = Folder::new();
    let shop = folder.path().join("shop.toml");
    let truth = root().join("cli/volcomp/demo/truth.toml");
    fs::copy(truth, folder.path().join("truth.toml")).expect("copied");
    let out = folder.file("out");
    let line = "[[measurement]]\nerror = \"EXX\"\n";
    for (text, expected) in [
        (String::new(), "key `machine` is missing"),
        ("machine = \"none.toml\"".into(), "none.toml: cannot be read"),
        (
            format!("machine = \"truth.toml\"\n[instrument]\nnoise_um = -1\n{line}"),
            "shop.toml:3: instrument.noise_um: found -1, expected 0 or more",
        ),
        (
            format!("machine = \"truth.toml\"\n[instrument]\nnoise = 1\n{line}"),
            "shop.toml:3: instrument.noise: unknown key",
        ),
        (
            format!("machine = \"truth.toml\"\n{line}targets = 100000\nruns = 100000\n"),
            "expected at most 1000000 readings",
        ),
        (
            format!("machine = \"truth.toml\"\n{line}targets = 1\n"),
            "measurement[0].targets: found 1, expected at least 2",
        ),
        (
            format!("machine = \"truth.toml\"\n{line}file = \"../exx\"\n"),
            "measurement[0].file: found \"../exx\", expected a name without a folder",
        ),
        (
            format!("machine = \"truth.toml\"\n{line}file = \"a\"\n{line}file = \"a\"\n"),
            "the file a is written already",
        ),
        (
            "machine = \"truth.toml\"\n[[measurement]]\nerror = \"EAX\"\nmethod = \"angular\"\nbridge_mm = 50\n".into(),
            "expected EYX, EZX, EXY",
        ),
        (
            "machine = \"truth.toml\"\n[[measurement]]\nerrors = [\"EXX\", \"EXQ\"]\n".into(),
            "measurement[0].errors[1]: `EXQ` is no error name",
        ),
        (
            "machine = \"truth.toml\"\nseed = -1".into(),
            "shop.toml:2: seed: found -1",
        ),
    ] {
        fs::write(&shop, &text).expect("written");
        let message = refused(&["simulate", &shop.display().to_string(), "-o", &out]);
        assert!(message.contains(expected), "{text}\n{message}");
    }
    fs::write(&shop, format!("machine = \"truth.toml\"\n{line}")).expect("written");
    let file = truth_path(&folder);
    refuses(&["simulate", &shop.display().to_string(), "-o", &file], "cannot be made a folder");
    let output = volcomp(&["simulate", &shop.display().to_string(), "-o", &out]);
    assert_eq!(output.status.code(), Some(0));
}

fn truth_path(folder: &tempfile::TempDir) -> String {
    folder.path().join("truth.toml").display().to_string()
}

#[test]
fn inspect_says_what_a_file_holds() {
    let folder = Folder::new();
    let lasers = folder.path().display().to_string();
    json(&["simulate", SHOP, "-o", &lasers]);
    let file = folder.file("eay.rta");
    let answer = json(&["inspect", &file]);
    assert_eq!(answer["unit"], "urad");
    assert_eq!(answer["readings"], 210);
    assert_eq!(answer["runs_backward"], 5);
    insta::assert_snapshot!(text(&["inspect", &file]).replace(&lasers, "FOLDER"));
    let machine = folder.file("machine.toml");
    assert!(refused(&["inspect", &machine]).contains("machine.toml"));
}

/// A map of 10^9 nodes is interrupted: status 130 and no unfinished file.
#[test]
fn an_interrupt_leaves_nothing_half_written() {
    let folder = Folder::new();
    let map = folder.path().join("map.csv");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .args(["map", "-m", "examples/gantry.toml", "--grid", "1000x1000x1000", "-o"])
        .arg(&map)
        .current_dir(root())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("started");
    // The unfinished file exists once work has begun.
    let begun = std::time::Instant::now();
    while fs::read_dir(folder.path()).expect("a folder").count() == 0 {
        assert!(begun.elapsed().as_secs() < 60, "no work began");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let interrupt = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill is there");
    assert!(interrupt.success());
    assert_eq!(child.wait().expect("ended").code(), Some(130));
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
}

/// If the other targets in the support have almost no weight, there is no leave-one-out error, and the table shows `x`.
#[test]
fn settings_without_a_leave_one_out_error_are_told() {
    let folder = Folder::new();
    let mut table = "target,deviation\n".to_owned();
    // Targets in clusters: for the last target, other targets are just inside the edge of some supports.
    for x in [0, 12, 24, 150, 186, 198, 312, 324, 336, 450, 498, 612] {
        let reading = (0.02 * f64::from(x)).sin() + 0.3 * f64::from(x * 7 % 5);
        let _ = writeln!(table, "{x},{reading}");
    }
    let path = &folder.write("uneven.csv", table);
    let call = format!("fit {path} --method mls --scan --order 1 --support 1");
    let answer = json(&call);
    let scan = list(&answer["scan"]);
    let without = scan.iter().filter(|trial| trial["leave_one_out_rms"].is_null());
    let without = without.count();
    assert!(without > 0, "{scan:?}");
    assert!(scan.iter().all(|trial| trial["max_residual"].is_number()));
    let printed = text(&call);
    let (_, left_out) = printed.split_once("Leave-one-out error").expect("a table");
    let (left_out, said) = left_out.split_once("* the curve above").expect("a line below");
    assert_eq!(left_out.split_whitespace().filter(|cell| *cell == "x").count(), without);
    contains(said, "x no leave-one-out error");
}
