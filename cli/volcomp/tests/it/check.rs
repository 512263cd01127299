//! `volcomp check`, and the provenance of errors in the machine file.
//!
//! `calibrate` writes the provenance; `check` prints it and compares it with the named files.

use std::{fs, path::Path};

use serde_json::json;

use crate::{Folder, close, contains, float, json, list, notes, refused, root, text, volcomp};

const GANTRY: &str = "examples/gantry.toml";

#[test]
fn a_machine_is_told_as_it_is_understood() {
    insta::assert_snapshot!("check", text(&["check", GANTRY]));
    insta::assert_snapshot!("check_trunnion", text(&["check", "examples/trunnion.toml"]));
    for machine in ["gantry", "five-axis", "mill", "trunnion"] {
        let shown = text(&["check", &format!("examples/{machine}.toml")]);
        for line in shown.lines() {
            assert!(line.chars().count() <= 80, "{machine}: {line}");
        }
    }
}

/// Ranges of errors equal the file's polynomials, and errors at the corners equal `volcomp error`.
#[test]
fn sizes_and_corners_are_those_of_the_file() {
    let answer = json(&["check", GANTRY]);
    let size = |name: &str| {
        let errors = list(&answer["errors"]);
        let found = errors.iter().find(|e| e["name"] == name).cloned();
        found.unwrap_or_else(|| panic!("{name} is not there"))
    };
    let exx = size("EXX");
    let expected = 0.0073 * 8000.0 - 2.1e-7 * 8000.0 * 8000.0;
    close(&exx["largest"], expected, 1e-9);
    assert_eq!(exx["at"], json!({ "X": 8000.0 }));
    // EZZ: the forward and backward curves are 0 and 2.5 µm at Z = 0, and 30 and 32.5 µm at the top.
    assert_eq!(size("EZZ")["largest"], json!(32.5));
    // EZY is a grid over Y and Z, whose maximum is at a node.
    let ezy = size("EZY");
    assert_eq!(ezy["smallest"], json!(-24.0));
    assert_eq!(ezy["at"], json!({ "Y": 2000.0, "Z": 2500.0 }));
    assert_eq!(size("EC0Y")["largest"], json!(12.0));
    let not_stated = list(&answer["not_stated"]);
    assert!(not_stated.contains(&json!("EB0Z")) && !not_stated.contains(&json!("EA0Z")));
    let corners = list(&answer["corners"]);
    assert_eq!(corners.len(), 8);
    for corner in corners {
        let at = &corner["at"];
        let call = format!("X={},Y={},Z={}", at["X"], at["Y"], at["Z"]);
        let error = json(&["error", "-m", GANTRY, "--at", &call]);
        assert_eq!(corner["position_um"], error["position_um"], "{call}");
    }
    assert_eq!(corners[1]["at"], json!({ "X": 8000.0, "Y": 0.0, "Z": 0.0 }));
}

/// The described motion follows the structure: axes left of `b` move the workpiece.
#[test]
fn positive_motions_are_told_for_table_and_spindle() {
    let motion = |machine: &str, axis: &str| {
        let answer = json(&["check", &format!("examples/{machine}.toml")]);
        let axes = list(&answer["axes"]).clone();
        let found = axes.into_iter().find(|a| a["name"] == axis).expect("there");
        found["motion"].as_str().expect("words").to_owned()
    };
    assert!(motion("gantry", "X").contains("the table moves to −X"));
    assert!(!motion("gantry", "Y").contains("table"));
    assert!(motion("trunnion", "C").contains("the table turns right-handed about −Z"));
    assert!(motion("five-axis", "B").ends_with("the tool turns right-handed about +Y"));
}

/// On an axis that points opposite to its letter, a positive deviation is a negative error, and `check` states this.
/// Example: a tool that turns 10 µrad too far about −Z has an error of −10 µrad about Z.
#[test]
fn signs_of_errors_on_reversed_and_slanted_axes_are_told() {
    let folder = Folder::new();
    let path = folder.file("machine.toml");
    let machine = |direction: &str| {
        let text = format!(
            "structure = \"w X' b C t\"\n[axes]\nX.travel = [0, 100]\nC.travel = [0, 360]\n{direction}\n\
             [errors]\nECC = -10.0\n"
        );
        fs::write(&path, text).expect("written");
    };
    machine("C.direction = [0, 0, -1]");
    let signs = &json(&["check", &path])["axes"][1]["signs"];
    let signs = signs.as_str().expect("a warning");
    assert!(signs.contains("C counts against Z") && signs.ends_with("ECC is negative"), "{signs}");
    let error = json(&["error", "-m", &path, "--at", "C=0"]);
    assert!((float(&error["rotation_urad"][2]) + 10.0).abs() < 1e-6, "{error}");
    assert!(text(&["check", &path]).contains("C counts against Z"));
    machine("X.direction = [1, 1, 0]");
    let axes = &json(&["check", &path])["axes"];
    assert!(axes[0]["signs"].as_str().is_some_and(|s| s.contains("X lies aslant")), "{axes}");
    assert_eq!(axes[1].get("signs"), None);
    let said = volcomp(&["check", &path]).stderr;
    assert!(String::from_utf8_lossy(&said).contains("no `point` is stated for C"));
    assert!(text(&["check", &path]).starts_with("machine without a name: w X' b C t"));
}

#[test]
fn an_error_stated_as_zero_is_told_apart_from_one_not_stated() {
    let folder = Folder::new();
    let machine = "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [5, 100]\n\
        [errors]\nEXX = { poly = [0.0] }\nEC0Y = 0.0\n[assembly]\nY = [1, 0, 0, 0, 0, 2]\n";
    let path = folder.write("machine.toml", machine);
    let answer = json(&["check", &path]);
    assert_eq!(answer["zero"], json!(["EXX", "EC0Y"]));
    assert_eq!(answer["errors"], json!([]));
    assert_eq!(answer["home"]["outside_travel"], json!(["Y"]));
    assert_eq!(answer["assembly"][0]["rotation_urad"], json!([0.0, 0.0, 2.0]));
    assert_eq!(answer["corners"].as_array().map(Vec::len), Some(4));
    let shown = text(&["check", &path]);
    for words in ["stated as zero: EXX EC0Y", "Home lies outside the travel of Y", "assembly of Y"]
    {
        contains(&shown, words);
    }
}

/// The evaluator reads the compiled bytes. Its error equals that of the exact model to first order.
#[test]
fn a_compiled_machine_is_read_back() {
    let folder = Folder::new();
    let path = folder.path().join("m.blob");
    let name = path.display().to_string();
    let answer = json(&["compile", GANTRY, "-o", &name]);
    let bytes = fs::read(&path).expect("written");
    assert_eq!(answer["bytes"], json!(bytes.len()));
    let machine = volcomp_model::CompiledMachine::from_blob(&bytes).expect("a machine");
    let mut state = volcomp_kinematics::State::default();
    state.q[0] = 1000.0;
    let found = machine.evaluate(&state).into_six();
    assert!((found[0] * 1e3 - (7.3 - 0.21)).abs() < 0.01, "{found:?}");
    // The hash covers the bytes after the header.
    let hash = answer["sha256"].as_str().expect("digits");
    assert_eq!(hash.len(), 64);
    let again = json(&["compile", GANTRY, "-o", &name]);
    assert_eq!(again["sha256"], hash);
    let other = json(&format!("compile {GANTRY} -o {name} --temperature scale_x=25"));
    assert_ne!(other["sha256"], hash);
    assert!(refused(&["compile", GANTRY, "-o", &name, "--tolerance-nm", "0"]).contains("above 0"));
    assert!(refused(&["compile", GANTRY, "-o", "nowhere/m.blob"]).contains("cannot be written"));
    assert!(refused(&["compile", GANTRY, "-o", "/dev/full"]).contains("ordinary file"));
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);
    assert_eq!(volcomp(&["compile", GANTRY]).status.code(), Some(2));
}

/// Every command that reads a machine notes a rotary travel that seems to be in radians.
#[test]
fn travel_in_radians_is_asked_about() {
    let folder = Folder::new();
    let machine =
        "structure = \"w C' b X t\"\n[axes]\nX.travel = [0, 500]\nC.travel = [0, 6.2832]\n";
    let path = folder.write("machine.toml", machine);
    for call in [
        &["check", &path][..],
        &["error", "-m", &path, "--at", "X=1,C=1"],
        &["sensitivity", "-m", &path],
    ] {
        let said = notes(call);
        let asked = "note: travel of C: 0 to 6.2832 deg, which in radians would be 0 to 360 deg: is it stated in radians?";
        assert!(said.contains(asked), "{call:?}: {said}");
    }
}

fn copied(folder: &Folder) -> String {
    let from = root().join("examples/calibration");
    for entry in fs::read_dir(from).expect("a folder") {
        let path = entry.expect("a file").path();
        fs::copy(&path, folder.path().join(path.file_name().expect("a name"))).expect("copied");
    }
    folder.file("calibration.toml")
}

#[test]
fn the_same_input_gives_the_same_bytes_and_a_changed_file_is_named() {
    let [one, two] = [0, 1].map(|_| Folder::new());
    let calibrate = |folder: &Folder, more: &[&str]| {
        let calibration = copied(folder);
        let output = folder.file("m.toml");
        json(&[&["calibrate", &calibration, "-o", &output], more].concat());
        (fs::read(&output).expect("written"), output)
    };
    let (bytes, machine) = calibrate(&one, &[]);
    assert_eq!(calibrate(&two, &[]).0, bytes);
    let (dated, _) = calibrate(&two, &["--date", "2026-11-26"]);
    let dated = String::from_utf8(dated).expect("UTF-8");
    contains(&dated, "date = \"2026-11-26\"");

    let states = |call: &[&str]| -> Vec<(String, String)> {
        let answer = json(call);
        let files = list(&answer["provenance"]["files"]);
        let word = |of: &serde_json::Value| of.as_str().expect("a word").to_owned();
        (files.iter()).map(|file| (word(&file["file"]), word(&file["state"]))).collect()
    };
    let call = ["check", &machine];
    let found = states(&call);
    assert!(found.len() >= 5 && found.iter().all(|(_, state)| state == "same"), "{found:?}");
    // One file gets an additional byte, and another file is removed.
    let changed = one.path().join("exx.csv");
    let mut more = fs::read(&changed).expect("read");
    more.push(b'\n');
    fs::write(&changed, more).expect("written");
    fs::remove_file(one.path().join("ebx.csv")).expect("removed");
    for (file, state) in states(&call) {
        let expected = match file.as_str() {
            "exx.csv" => "different",
            "ebx.csv" => "not at hand",
            _ => "same",
        };
        assert_eq!(state, expected, "{file}");
    }
    let output = volcomp(&call);
    let notes = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
    contains(&notes, "exx.csv: not the file that EXX was found from");
    assert!(!notes.contains("exy.csv: not"), "{notes}");
    let elsewhere = two.path().display().to_string();
    let found = states(&["check", &machine, "--files", &elsewhere]);
    assert!(found.iter().all(|(_, state)| state == "same"), "{found:?}");
    let shown = text(&["check", &machine, "--files", &elsewhere]);
    contains(&shown, "Where the errors come from");
}

#[test]
fn a_day_is_one_of_the_calendar() {
    let folder = Folder::new();
    let calibration = copied(&folder);
    let output = folder.file("m.toml");
    let call = format!("calibrate {calibration} -o {output} --date 2026-02-30");
    assert!(refused(&call).contains("--date: found `2026-02-30`"));
    assert!(!Path::new(&output).exists());
}
