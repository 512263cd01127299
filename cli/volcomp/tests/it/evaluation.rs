//! Evaluations by standards: positioning, circles, diagonals, straightness, squareness.

use std::{fmt::Write as _, fs};

use serde_json::{Value, json};

use crate::{
    Folder, close, contains, float, json, list, refuse_each, refused, refuses, root, text, volcomp,
};

const POSITIONING: &str = "fitting/metrology/tests/data/iso230-2-axis.csv";
const CIRCLE: &str = "examples/circle.csv";

fn quantity(document: &Value, symbol: &str) -> Value {
    let rows = list(&document["quantities"]);
    let row = rows.iter().find(|row| row["symbol"] == symbol);
    row.cloned().unwrap_or(Value::Null)
}

#[test]
fn standards_and_editions_beside_one_another() {
    let all =
        json("iso230 fitting/metrology/tests/data/iso230-2-axis.csv --standard all --edition 2006");
    assert_eq!(all["edition"], 2006);
    let standards: Vec<&str> =
        list(&all["quantities"]).iter().filter_map(|row| row["standard"].as_str()).collect();
    for standard in ["ISO 230-2:2006", "VDI/DGQ 3441", "ASME B5.54"] {
        assert!(standards.contains(&standard), "{standard}");
    }
    assert_eq!(quantity(&all, "B")["name"], "reversal value");
    // U_max and Pa of VDI/DGQ 3441 equal the published B and M.
    close(&quantity(&all, "U_max")["value"], 43.46, 0.011);
    close(&quantity(&all, "Pa")["value"], 48.09, 0.011);
    let newest = json(&["iso230", POSITIONING]);
    assert_eq!(quantity(&newest, "B")["name"], "reversal error");
    assert_eq!(quantity(&newest, "P"), Value::Null);
    assert_eq!((&newest["decision"], &newest["pass"]), (&Value::Null, &Value::Null));
    let old = text(&["iso230", POSITIONING, "--edition", "1997"]);
    assert!(old.starts_with("ISO 230-2:1997") && old.contains("B reversal value"), "{old}");
}

/// B = 43.46 µm, A = 204.75 µm and U(B) = √(2/5) · E_VE/√3 are compared with limits, with and without uncertainty.
#[test]
fn limits_are_judged_with_and_without_uncertainty() {
    let judged = |options: &[&str]| json(&[&["iso230", POSITIONING], options].concat());
    let good = judged(&["--tolerance", "A=204.8,b=43.5"]);
    assert_eq!((&good["pass"], &good["decision"]["rule"]), (&json!(true), &json!("simple")));
    let bad = judged(&["--tolerance", "A=204.8,B=43.4"]);
    assert_eq!((&bad["pass"], &bad["decision"]["verdict"]), (&json!(false), &json!("fail")));
    assert_eq!(quantity(&bad, "A")["verdict"], "pass");
    let open = judged(&["--tolerance", "B=43.5", "--environment-um", "2"]);
    assert_eq!(open["decision"]["verdict"], "undecided");
    assert_eq!((&open["pass"], &open["decision"]["rule"]), (&json!(false), &json!("ISO 14253-1")));
    close(
        &quantity(&open, "B")["uncertainty"],
        (2.0_f64 / 5.0).sqrt() * 2.0 / 3.0_f64.sqrt(),
        1e-9,
    );
    let left_out = open["uncertainty"]["left_out"].to_string();
    assert!(left_out.contains("U_DEVICE") && !left_out.contains("U_EVE"), "{left_out}");
    let said = text(&["iso230", POSITIONING, "--tolerance", "A=204.8,B=43.4"]);
    assert!(said.contains("FAIL: fail B; pass A. Decided by the values alone"), "{said}");
}

#[test]
fn a_test_far_from_twenty_degrees_says_so_and_how_it_was_compensated() {
    let folder = Folder::new();
    let demo = folder.file("demo");
    json(&["demo", "-o", &demo]);
    let cold = json(&["iso230", &format!("{demo}/exx.rtl")]);
    assert_eq!(cold["material_compensation"], "not stated: no expansion coefficient");
    assert!(cold["notes"].to_string().contains("asks for 33 at least"), "{}", cold["notes"]);
    let laser = fs::read_to_string(format!("{demo}/exx.rtl")).expect("read");
    let no_sensor = "Mat temp 1 : -10.000000 -10.000000 0\r\n";
    contains(&laser, no_sensor);
    let sensor = "Mat temp 1 : 26.0 26.2 0\r\nExp coeff  : 11.0 11.0 0\r\n";
    let laser = laser.replacen(no_sensor, sensor, 1);
    let warm = folder.write("warm.rtl", &laser);
    let options = format!("iso230 {warm} --temperature-range-k 1 --expansion-range 2");
    let warm = json(&options);
    assert!(warm["notes"].to_string().contains("farther than 1 K from 20 °C"), "{}", warm["notes"]);
    let said = warm["material_compensation"].as_str().expect("a text");
    contains(said, "11 µm/(m·K)");
    // Over L = 8 m: α L R/√3 for the range R = 1 K of the temperature, and ΔT L R(α)/√3 for the range R(α) = 2 µm/(m·K)
    // of the expansion coefficient, with the temperatures of the file.
    let contribution = |k: usize| warm["uncertainty"]["contributions"][k]["u_um"].clone();
    close(&contribution(2), 11.0 * 8.0 / 3.0_f64.sqrt(), 1e-9);
    close(&contribution(3), 6.2 * 8.0 * 2.0 / 3.0_f64.sqrt(), 1e-9);
}

#[test]
fn one_bad_file_does_not_hide_the_others() {
    let folder = Folder::new();
    let broken = folder.write("broken,\"one\".csv", "target,deviation\n1,nan\n");
    let table = folder.file("all.csv");
    let output = volcomp(&format!("--json iso230 {POSITIONING} {broken} {POSITIONING} -o {table}"));
    assert_eq!(output.status.code(), Some(2));
    let document: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let files = list(&document["files"]);
    assert_eq!(files.len(), 3);
    close(&files[2]["B_um"], 43.46, 0.011);
    assert!(files[1]["error"].to_string().contains("found `nan`"));
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    contains(&said, "1 of 3 files are refused");
    let mut rows = csv::Reader::from_path(&table).expect("a table");
    let heads: Vec<String> = rows.headers().expect("heads").iter().map(str::to_owned).collect();
    let rows: Vec<csv::StringRecord> = rows.records().map(|row| row.expect("a row")).collect();
    assert_eq!(rows.len(), 3);
    let cell = |row: usize, head: &str| {
        let place = heads.iter().position(|h| h == head).expect("a head");
        rows[row][place].to_owned()
    };
    assert!((cell(0, "B").parse::<f64>().expect("a number") - 43.46).abs() < 0.011);
    assert_eq!((cell(1, "B"), cell(1, "file")), (String::new(), broken));
    assert!(cell(1, "error").contains("found `nan`") && cell(2, "error").is_empty());
    refuses(&["iso230", POSITIONING, "-o", POSITIONING], "expected another one to write");
}

/// In a cube with sides a = b = 300 mm and a squareness error of 20 µrad, each diagonal D changes by ∓ a b EC0Y / D.
/// The evaluation finds EC0Y.
#[test]
fn diagonals_are_named_by_file_or_option_and_hint_at_squareness() {
    let folder = Folder::new();
    let length = 300.0 * 3.0_f64.sqrt();
    let growth = 300.0 * 300.0 * 20e-3 / length;
    let mut paths = Vec::new();
    for (name, sign) in [("ppp", -1.0), ("npp", 1.0), ("pnp", 1.0), ("ppn", -1.0)] {
        let mut rows = "target,run,direction,deviation um\n".to_owned();
        for (direction, shift) in [("+", 0.5), ("-", -0.5)] {
            for k in 0..6 {
                let share = f64::from(k) / 5.0;
                let deviation = sign * growth * share + shift;
                writeln!(rows, "{},1,{direction},{deviation}", length * share).expect("a string");
            }
        }
        paths.push(folder.write(&format!("body-{name}.csv"), &rows));
    }
    let files: Vec<&str> = paths.iter().map(String::as_str).collect();
    let call = |options: &[&str]| json(&[&["iso230", "--part", "6"], &files[..], options].concat());
    let found = call(&["--box-mm", "300,300,300"]);
    crate::every_command::validate("iso230-diagonals", &found);
    assert_eq!(found["squareness"][0]["error"], "EC0Y");
    close(&found["squareness"][0]["urad"], 20.0, 1e-6);
    close(&found["squareness"][1]["urad"], 0.0, 1e-6);
    close(&found["diagonals"][1]["growth_um"], growth, 1e-6);
    close(&quantity(&found, "B_d")["value"], 1.0, 1e-9);
    close(&quantity(&found, "E_d")["value"], growth + 1.0, 1e-6);
    close(&quantity(&found, "spread")["value"], 2.0 * growth, 1e-6);
    // Diagonals named in the call override those of the files.
    let turned = call(&["--diagonals", "NPP,PPP,PPN,PNP", "--box-mm", "300,300,300"]);
    close(&turned["squareness"][0]["urad"], -20.0, 1e-6);
    refuses(&["iso230", "--part", "6", POSITIONING], "no name of a diagonal");
}

#[test]
fn straightness_and_squareness_of_the_examples() {
    let [exy, eyx] = ["examples/straight-exy.csv", "examples/straight-eyx.csv"];
    let found = json(&["straightness", exy, "--reference", "end-points"]);
    let profile = list(&found["profile"]);
    close(&profile[0][1], 0.0, 1e-9);
    close(&profile[10][1], 0.0, 1e-9);
    // The file has a bow of 4 µm, noise of 0.2 µm and a slope of −9 µrad.
    close(&quantity(&found, "minimum-zone")["value"], 4.0, 0.3);
    close(&found["slopes_urad"][0], -9.0, 0.4);
    close(&found["reversal_um"], 0.4, 0.4);
    let square = json(&format!("squareness {exy} {eyx} --error EC0Y --reference-angle-urad 1.5"));
    // Sum of the reference angle, 1.5 µrad, and the slopes, 9 and 6 µrad.
    close(&square["squareness_urad"], 16.5, 0.6);
    let other = json(&format!("squareness {exy} {eyx} --error EC0Y --reference minimum-zone"));
    assert_eq!(other["uncertainty_urad"], Value::Null);
    assert_eq!(other["uncertainty"], Value::Null);
    // Stated contributions: a square with 1 µrad, a straight edge with 0.5 µm on lines of 600 and 800 mm, a temperature
    // range of 3 µrad.
    let stated = json(&format!(
        "squareness {exy} {eyx} --error EC0Y --square-urad 1 --straight-edge-um 0.5 --temperature-urad 3"
    ));
    let scatter = float(&square["uncertainty_urad"]);
    close(
        &stated["uncertainty_urad"],
        (scatter * scatter + 1.0 + 2.0 * ((0.5_f64 / 0.6).powi(2) + (0.5_f64 / 0.8).powi(2)) + 3.0)
            .sqrt(),
        1e-9,
    );
    assert_eq!(stated["uncertainty"]["left_out"], json!([]));
    let open = square["notes"].to_string();
    contains(
        &open,
        "left out of the measurement uncertainty, not stated: square, straight edge, temperature",
    );
    contains(&open, "the squareness holds where the lines were measured");
    // A single run, here the first in each direction, does not show the alignment of the reference.
    let folder = Folder::new();
    let of_one_run = [exy, eyx].map(|file| {
        let text = fs::read_to_string(root().join(file)).expect("an example");
        let rows = text.lines().filter(|row| row.starts_with("target") || row.contains(",1,"));
        let name = file.rsplit('/').next().expect("a name");
        folder.write(name, rows.collect::<Vec<_>>().join("\n") + "\n")
    });
    assert!(!open.contains("one run of"), "{open}");
    // Without its reading at 180 mm the second run still shows the alignment.
    let text = fs::read_to_string(root().join(exy)).expect("an example");
    let rows = text.lines().filter(|row| !row.starts_with("180,2,+,"));
    let gap = folder.write("gap.csv", rows.collect::<Vec<_>>().join("\n") + "\n");
    let square = json(&["squareness", &gap, eyx, "--error", "EC0Y"]);
    let notes = square["notes"].to_string();
    contains(&notes, "run 2 + holds 10 of 11 targets");
    assert!(!notes.contains("one run of"), "{notes}");
    let [exy, eyx] = &of_one_run;
    let square = json(&["squareness", exy, eyx, "--error", "EC0Y"]);
    contains(&square["notes"].to_string(), "one run of EXY and EYX: U has");
    // The bridge is 250 mm long. The straightness has waves of 12 and 5 µm.
    let tilts = json(&["straightness", "examples/tilts.csv", "--bridge-mm", "250"]);
    assert_eq!(tilts["method"], "angular-method");
    let wave = |q: f64| {
        let turn = std::f64::consts::TAU * q;
        12.0 * (turn / 8000.0).sin() + 5.0 * (turn / 2500.0).cos()
    };
    let points: Vec<(f64, f64)> =
        (0..=32).map(|k| f64::from(k) * 250.0).map(|q| (q, wave(q))).collect();
    let truth = volcomp_metrology::straightness_of_profile(&points).expect("a profile");
    close(&quantity(&tilts, "least-squares")["value"], truth.about[0].error_um, 1.5);
}

/// With the wrong unit in its header, a file is 1000 times too large or too small, and a note asks for the unit.
/// Deviations in µrad get a note as an angular error motion.
#[test]
fn a_wrong_unit_and_an_angle_are_told() {
    let folder = Folder::new();
    let rows = |unit: &str, head: &str| {
        let mut rows = format!("{head},run,direction,deviation {unit}\n");
        for (run, direction) in [(1, "+"), (1, "-"), (2, "+"), (2, "-")] {
            for k in 0..=5 {
                let at = f64::from(k) * 100.0;
                writeln!(rows, "{at},{run},{direction},{}", 4.0 * (at / 90.0).sin())
                    .expect("a string");
            }
        }
        rows
    };
    let right = folder.write("right.csv", rows("um", "target"));
    let wrong = folder.write("wrong.csv", rows("mm", "target"));
    let tiny = folder.write("tiny.csv", rows("nm", "target"));
    let angle = folder.write("angle.csv", rows("urad", "target"));
    let turned = folder.write("turned.csv", rows("um", "target deg"));
    let said = |call: &[&str]| json(call)["notes"].to_string();
    for command in ["iso230", "straightness"] {
        assert!(!said(&[command, &right]).contains("another unit"));
        for file in [&wrong, &tiny] {
            let notes = said(&[command, file]);
            assert!(notes.contains("are they in another unit?"), "{command} {file}: {notes}");
        }
    }
    let second = folder.write("second.csv", rows("um", "target"));
    let notes = said(&["squareness", &wrong, &second, "--error", "EC0Y"]);
    contains(&notes, "a squareness of");
    let notes = said(&["iso230", &angle]);
    contains(&notes, "an angular error motion here, not of positioning");
    assert!(!said(&["iso230", &angle, "--axis", "C"]).contains("angular error motion"));
    refuses(&["straightness", &turned], "found `target deg`, expected `target` or `target mm`");
}

/// A value of `--axis` other than the file's axis, X, is rejected. A material temperature far from 20 °C gets a note
/// for lengths only.
#[test]
fn the_axis_of_a_file_is_not_another_one() {
    let folder = Folder::new();
    let demo = folder.file("demo");
    json(&["demo", "-o", &demo]);
    let laser = format!("{demo}/exx.rtl");
    refuses(&["iso230", &laser, "--axis", "Z"], "found axis X, expected axis Z (--axis)");
    json(&["iso230", &laser, "--axis", "X"]);
    let angles = fs::read_to_string(format!("{demo}/eay.rta")).expect("read");
    let no_sensor = "Mat temp 1 : -10.000000 -10.000000 0\r\n";
    contains(&angles, no_sensor);
    let warm = angles.replacen(no_sensor, "Mat temp 1 : 26.0 26.2 0\r\n", 1);
    let warm = folder.write("warm.rta", &warm);
    let shown = text(&["inspect", &warm]);
    contains(&shown, "26.0 to 26.2 °C");
    let warm = json(&["iso230", &warm]);
    assert!(!warm["notes"].to_string().contains("20 °C"), "{}", warm["notes"]);
    assert_eq!(warm["material_compensation"], Value::Null);
}

#[test]
fn files_and_options_of_another_kind_are_told() {
    let folder = Folder::new();
    let demo = folder.file("demo");
    json(&["demo", "-o", &demo]);
    let linear = fs::read_to_string(format!("{demo}/exx.rtl")).expect("read");
    let straight = linear.replacen("rtl", "rts", 1);
    let straight = folder.write("eyx.rts", &straight);
    let laser = format!("{demo}/exx.rtl");
    let angles = format!("{demo}/eay.rta");
    let circle = root().join(CIRCLE).display().to_string();
    let calls = "
iso230 $straight => `volcomp straightness` evaluates them
straightness $laser => `volcomp iso230` evaluates them
straightness $angles => of the tilts of a bridge state --bridge-mm
straightness $straight --bridge-mm 400 => expected tilts with --bridge-mm
straightness $angles --bridge-mm 123 => expected the bridge length 123 mm
squareness $straight $straight --error EC0Y => the first file as well
squareness $straight $laser --error EXX => expected EC0Y, EA0Z or EB0Z
iso230 $axis --radius-mm 9 => --radius-mm: found --part 2, expected --part 4
iso230 $axis --box-mm 1,2,3 => --box-mm: found --part 2, expected --part 6
iso230 $circle --part 4 --device-um 1 => expected --part 2
iso230 $circle --part 4 --edition 2014 => --edition: found --part 4, expected --part 2
iso230 $axis --part 6 --edition 1997 => --edition: found --part 6, expected --part 2
iso230 $axis --standard vdi --device-um 1 => found --standard vdi, which states none
iso230 $axis --standard asme --tolerance M=0.001 => --tolerance: symbol: found `M`
iso230 $axis --edition 1988 => with 3 s, is not evaluated
iso230 $axis --edition 1997 --device-um 1 => expected 2006 or 2014
iso230 $angles --device-um 1 => expected lengths of a linear axis
iso230 $axis --device-um=-1 => expected a finite number of at least 0
iso230 $axis --tolerance P=10 => --tolerance: symbol: found `P`
iso230 $axis --tolerance A=10um => without its unit
iso230 $axis --part 6 --diagonals PPQ => expected one of PPP
iso230 $axis --part 6 --diagonals PPP,NPP => expected one for each of 1
iso230 $axis --part 4 => expected the columns `angle` and `deviation`
iso230 examples --part 4 => found a directory
iso230 $circle --part 4 --feed 0 => expected mm/min above zero
";
    refuse_each(
        calls,
        &[
            ("$straight", &straight),
            ("$laser", &laser),
            ("$angles", &angles),
            ("$circle", &circle),
            ("$axis", POSITIONING),
        ],
    );
}

/// A file whose title names a straightness is not evaluated as positioning. The rule is that of a draft, which infers
/// errors from titles.
#[test]
fn a_title_that_names_no_positioning_is_not_judged_as_one() {
    let folder = Folder::new();
    let report = |title: &str, unit: &str| {
        format!(
            "Title: {title}\nTarget Mean error forward ({unit}) Mean error reverse ({unit}) System mean 2 sigma forward 2 sigma reverse Dead zone\n\
             1 0.0 0.0 1.0 0.5 0.2 0.2 1.0\n2 100.0 2.0 3.0 2.5 0.2 0.2 1.0\n"
        )
    };
    let straight = folder.write("a.txt", report("EXY straightness", "um"));
    let call = ["iso230", &straight, "--tolerance", "E=70,B=5"];
    let message = refused(&call);
    assert!(
        message.contains("EXY, a straightness; expected positioning")
            && message.contains("volcomp straightness")
            && message.contains("--error EXX"),
        "{message}"
    );
    let stated = json(&[&call[..], &["--error", "EYY"]].concat());
    assert_eq!(stated["pass"], true);
    refuses(&[&call[..], &["--error", "EXY"]].concat(), "expected the positioning of an axis");
    refuses(
        &[&call[..], &["--error", "EYY", "--axis", "X"]].concat(),
        "expected an error of --axis X",
    );
    for (title, unit, is_refused) in [
        ("EXX", "um", false),
        ("EXX and EXY", "um", false),
        ("EBX pitch", "arcsec", false),
        ("EBX pitch", "um", true),
        ("EAC", "arcsec", true),
    ] {
        let file = folder.write("b.txt", report(title, unit));
        let status = volcomp(&["iso230", &file]).status.code();
        assert_eq!(status, Some(if is_refused { 2 } else { 0 }), "{title} in {unit}");
    }
}
