//! The provenance of errors in the machine file, as `calibrate` writes it and `check` prints and compares it.

use std::{fs, path::Path};

use crate::{Folder, contains, json, list, refused, root, text, volcomp};

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
