//! Thermal terms from a real spindle test.

use crate::{json, root, volcomp};

const SPINDLE: &str = "fitting/fit/tests/data/spindle-2min.csv";

#[test]
fn lags_beat_plain_ridge_on_every_channel_of_a_spindle() {
    let answer = json(&["fit-thermal", SPINDLE]);
    let channels = answer["displacements"].as_array().expect("a list");
    assert_eq!(channels.len(), 5);
    for channel in channels {
        let rms = |which: &str| channel[which]["rms_um"].as_f64().expect("a number");
        assert!(rms("fit") < rms("baseline"), "{channel}");
        assert!(
            channel["fit"]["worst_segment"]["rms_um"].as_f64() >= channel["fit"]["rms_um"].as_f64()
        );
    }
}

/// What it prints is taken by a machine file, and is what the fit says there.
#[test]
fn the_terms_go_into_a_machine_file() {
    let answer = json(&[
        "fit-thermal",
        SPINDLE,
        "--displacement",
        "ch1_um",
        "--error",
        "EZZ",
        "--reference",
        "26",
    ]);
    let channel = &answer["displacements"][0];
    let terms = channel["toml"].as_str().expect("text");
    let constant = channel["constant_um"].as_f64().expect("a number");
    let axes = volcomp_test_support::machines::gantry([[0.0, 1.0]; 3]);
    let machine = format!("{axes}[errors]\nEZZ = {constant}\n[thermal]\nreference = 26.0\n{terms}");
    let path = root().join("target/tmp/fit-thermal.toml");
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("writable");
    std::fs::write(&path, machine).expect("writable");
    let sensors: Vec<String> = (1..=16)
        .map(|i| format!("t{i}={}", if i == 6 { 27.5 } else { 26.0 }))
        .collect();
    let found = json(&[
        "error",
        "-m",
        path.to_str().expect("UTF-8"),
        "--at",
        "Z=0",
        "--temperature",
        &sensors.join(","),
    ]);
    let per_k: f64 = channel["drift"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|term| term["sensors"]["t6"].as_f64().expect("a number"))
        .sum();
    let difference = found["position_um"][2].as_f64().expect("a number") - (constant + 1.5 * per_k);
    assert!(difference.abs() < 1e-3, "{difference}");
}

#[test]
fn wrong_files_and_calls_end_with_status_2() {
    let file = |text: &str| {
        let path = root().join("target/tmp/fit-thermal-wrong.csv");
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("writable");
        std::fs::write(&path, text).expect("writable");
        path
    };
    for (text, expected) in [
        ("time_s,t1_degc\n0,20\n", "no displacement"),
        ("time_s,ch1_um\n0,20\n", "no temperature"),
        ("t1_degc,ch1_um\n0,20\n", "no column time_s"),
        (
            "time_s,t1_degc,ch1_um\n0,20,1\n1,x,2\n",
            ":3: t1_degc: found `x`",
        ),
        (
            "time_s,t1_degc,ch1_um\n5,20,1\n1,20,2\n",
            ":3: time_s: the time goes back",
        ),
        (
            "time_s,t1_degc,ch1_um\n0,20,1\n1,20,2\n",
            "needs at least 200",
        ),
    ] {
        let path = file(text);
        let output = volcomp(&["fit-thermal", path.to_str().expect("UTF-8")]);
        assert_eq!(output.status.code(), Some(2), "{text}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.contains(expected), "{message}");
    }
    for call in [
        ["--train", "2"],
        ["--error", "EZ"],
        ["--displacement", "ch9_um"],
        ["--lags", "-1"],
    ] {
        let output = volcomp(&["fit-thermal", SPINDLE, call[0], call[1]]);
        assert_eq!(output.status.code(), Some(2), "{call:?}");
    }
}
