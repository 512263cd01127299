//! Thermal terms from a real spindle test.

use std::fmt::Write as _;

use serde_json::Value;

use crate::{
    Draw, Folder, cases, contains, float, json, list, notes, one_line, refused, refuses, root,
    text, volcomp,
};

const SPINDLE: &str = "fitting/fit/tests/data/spindle-2min.csv";

/// Few terms predict with less than 1.2 times the RMS error of a regression on all sixteen sensors with many time constants.
#[test]
fn few_terms_are_enough_for_a_spindle() {
    let answer = json(&["fit-thermal", SPINDLE]);
    let channels = list(&answer["displacements"]);
    assert_eq!(channels.len(), 5);
    for channel in channels {
        let rms = |which: &str| float(&channel[which]["rms"]);
        assert!(rms("fit") < 1.2 * rms("dense"), "{channel}");
        assert!(channel["fit"]["worst_segment"]["rms"].as_f64() >= channel["fit"]["rms"].as_f64());
        let count = |which: &str| channel["fit"][which].as_array().map_or(0, Vec::len);
        assert!((1..=6).contains(&count("sensors")) && (1..=3).contains(&count("lags_s")));
        let numbers = list(&channel["numbers"]);
        assert!(numbers.len() <= 18);
        for number in numbers {
            let uncertainty = float(&number["uncertainty"]);
            assert!(uncertainty > 0.0, "{number}");
        }
    }
}

fn section<'t>(printed: &'t str, name: &str, next: &str) -> &'t str {
    let (_, from) = printed.split_once(&format!("\n\n{name}\n")).expect(name);
    from.split_once(&format!("\n\n{next}\n")).map_or(from, |(own, _)| own)
}

/// Each displacement has the error named in the call, or a placeholder that a machine file rejects. All fits are
/// recommended. Example: the RMS error of the third displacement is 9.4 µm, against 9.0 µm by regression without time
/// constants and 35.5 µm without terms.
#[test]
fn displacements_are_the_errors_that_the_call_names() {
    let named = format!("fit-thermal {SPINDLE} --error ch1_um=EZZ,ch3_um=EXZ --error ch4_um=EYZ");
    let answer = json(&named);
    let printed = text(&named);
    let channels = list(&answer["displacements"]);
    let names = ["ch1_um", "ch2_um", "ch3_um", "ch4_um", "ch5_um", "-"];
    for (place, (channel, error)) in
        channels.iter().zip([Some("EZZ"), None, Some("EXZ"), Some("EYZ"), None]).enumerate()
    {
        assert_eq!(channel["error"].as_str(), error);
        let rms = |which: &str| float(&channel[which]["rms"]);
        assert!(rms("fit") < 1.1 * rms("baseline"), "{channel}");
        let without = float(&channel["without_terms_rms"]);
        assert!(rms("fit") < 0.5 * without, "{channel}");
        assert_eq!(channel["recommended"], true, "{channel}");
        let own = section(&printed, names[place], names[place + 1]);
        contains(own, "[[thermal.drift]]");
        let toml = channel["toml"].as_str().expect("text");
        let stated = format!("error = \"{}\"\n", error.unwrap_or("???"));
        assert_eq!(toml.matches("error = ").count(), toml.matches(&stated).count());
    }
    let gap = channels[1]["toml"].as_str().expect("text");
    assert!(gap.starts_with("# Put the error that ch2_um is in place of ???."), "{gap}");
    let folder = Folder::new();
    let axes = volcomp_test_support::machines::gantry([[0.0, 1.0]; 3]);
    let path = folder.write("m.toml", format!("{axes}[thermal]\nreference = 20.0\n{gap}"));
    refuses(&["check", &path], "???");
    let table = "
ch9_um=EZZ => found no displacement ch9_um to fit, expected one of ch1_um
ch1_um=EAZ => found EAZ for ch1_um, which is in µm: expected a linear
ch1_um=EZZ,ch1_um=EXZ => a second error for the same displacement
ch1_um=EZ => --error: 
ch1_um=EX0C => found a location error, expected an error motion, such as EXC
EX0C => found a location error
";
    for (error, expected) in cases(table) {
        let message = refused(&["fit-thermal", SPINDLE, "--error", error]);
        let message = one_line(&message);
        contains(&message, expected);
    }
}

/// Each sensor's temperature in the middle of its tested range, and the terms' sum at these temperatures relative to `reference`.
fn half_way(channel: &Value, reference: f64) -> (String, f64) {
    let seen = list(&channel["seen"]);
    let middle = |sensor: &Value| {
        let of = seen.iter().find(|seen| seen["sensor"] == *sensor);
        let degc = &of.expect("seen")["degc"];
        0.5 * (float(&degc[0]) + float(&degc[1]))
    };
    let given: Vec<String> = seen
        .iter()
        .map(|seen| {
            let name = seen["sensor"].as_str().expect("text");
            format!("{name}={}", middle(&seen["sensor"]))
        })
        .collect();
    let numbers = list(&channel["numbers"]);
    let part = |number: &Value| {
        assert_eq!(number["unit"], "um_per_k");
        let per_k = float(&number["value"]);
        per_k * (middle(&number["sensor"]) - reference)
    };
    (given.join(","), numbers.iter().map(part).sum())
}

/// The printed terms are valid in a machine file and predict the same values there.
#[test]
fn the_terms_go_into_a_machine_file() {
    let answer =
        json(&format!("fit-thermal {SPINDLE} --displacement ch1_um --error EZZ --reference 26"));
    let channel = &answer["displacements"][0];
    let terms = channel["toml"].as_str().expect("text");
    let constant = float(&channel["constant"]);
    let axes = volcomp_test_support::machines::gantry([[0.0, 1.0]; 3]);
    let machine = format!("{axes}[errors]\nEZZ = {constant}\n[thermal]\nreference = 26.0\n{terms}");
    let folder = Folder::new();
    let path = &folder.write("m.toml", machine);
    let call = |temperatures: &str| {
        let at = ["error", "-m", path, "--at", "Z=0", "--temperature"];
        volcomp(&[&["--json"], &at[..], &[temperatures]].concat())
    };
    let (temperatures, expected) = half_way(channel, 26.0);
    let output = call(&temperatures);
    let found: Value = serde_json::from_slice(&output.stdout).expect("a document");
    let difference = float(&found["position_um"][2]) - (constant + expected);
    assert!(difference.abs() < 1e-3, "{difference}");
    let said = |output: &std::process::Output| {
        String::from_utf8_lossy(&output.stderr)
            .replace('\n', " ")
            .contains("outside what the thermal terms")
    };
    assert!(!said(&output));
    // Far outside the tested range the terms have no effect, and a note says so.
    let seen = list(&channel["seen"]);
    let hot: Vec<String> =
        seen.iter().map(|seen| format!("{}=90", seen["sensor"].as_str().expect("text"))).collect();
    let output = call(&hot.join(","));
    assert!(said(&output), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("a document");
    let left = float(&found["position_um"][2]) - constant;
    assert!(left.abs() < 1e-3, "{left}");
}

/// Three tests of an axis at three positions. The displacement is 2 µm/K of the spindle with a time constant of 900 s,
/// plus the expansion of a scale, 11 µm/(m·K) from X = 200 mm.
fn tests_of_an_axis(folder: &std::path::Path) -> Vec<String> {
    let write = |test: u32| {
        let (mut spindle, mut lagged) = (20.0_f64, 20.0_f64);
        let mut text = "time_s,X,spindle_degc,scale_degc,room_degc,dx_um\n".to_owned();
        for row in 0..300_u32 {
            let hours = f64::from(row) / 60.0;
            let heats = (row / 40 + test).is_multiple_of(2);
            // All temperatures start equal, because a lag starts at its first input.
            if row > 0 {
                let before = spindle;
                spindle += 0.1 * (if heats { 35.0 } else { 20.0 } - spindle);
                for second in 0..60 {
                    let now = before + (spindle - before) * (f64::from(second) + 0.5) / 60.0;
                    lagged += (now - lagged) * (1.0 - (-1.0_f64 / 900.0).exp());
                }
            }
            let scale = 20.0 + 3.0 * (0.7 * hours + f64::from(test)).sin();
            let x = 300.0 * f64::from(row % 3);
            // Each test has its own zero. The room temperature has no effect. Small noise repeats after 17 rows.
            let noise = 0.1 * f64::from(row * 7 % 17) / 17.0;
            let moved = 5.0 * f64::from(test)
                + 2.0 * (lagged - 20.0)
                + 0.011 * (scale - 20.0) * (x - 200.0)
                + noise;
            let room = 21.0 + 0.5 * (2.0 * hours).cos();
            let time_s = 60 * row;
            let cells = [f64::from(time_s), x, spindle, scale, room, moved];
            text += &cells.map(|cell| format!("{cell:.3}")).join(",");
            text.push('\n');
        }
        let path = folder.join(format!("test-{test}.csv"));
        std::fs::write(&path, text).expect("written");
        path.display().to_string()
    };
    (0..3).map(write).collect()
}

#[test]
fn several_tests_are_judged_by_tests_left_out() {
    let folder = Folder::new();
    let files = tests_of_an_axis(folder.path());
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    let call = [&["fit-thermal", "--error", "EXX"], &files[..]].concat();
    let answer = json(&call);
    assert_eq!(answer["train"], Value::Null);
    let channel = &answer["displacements"][0];
    let left_out = list(&channel["left_out"]);
    assert_eq!(left_out.len(), 3);
    for (left, file) in left_out.iter().zip(&files) {
        assert_eq!(left["file"], *file);
        assert!(float(&left["rms"]) < 0.5, "{left}");
    }
    let drift = &channel["drift"];
    assert_eq!(drift.as_array().map(Vec::len), Some(1), "{drift}");
    assert_eq!(drift[0]["lag_s"], 900.0);
    let per_k = float(&drift[0]["sensors"]["spindle"]);
    assert!((per_k - 2.0).abs() < 0.05, "{per_k}");
    let expansion = &channel["expansion"][0];
    assert_eq!(expansion["sensor"], "scale");
    for number in list(&channel["numbers"]) {
        let is_drift = number["lag_s"].is_number();
        let unit = if is_drift { "um_per_k" } else { "um_per_m_k" };
        assert_eq!(number["unit"], unit);
    }
    let um_per_m_k = float(&expansion["um_per_m_k"]);
    let fixed_mm = float(&expansion["fixed_mm"]);
    assert!((um_per_m_k - 11.0).abs() < 0.3, "{um_per_m_k}");
    assert!((fixed_mm - 200.0).abs() < 15.0, "{fixed_mm}");
    let printed = text(&call);
    assert!(printed.lines().all(|line| line.chars().count() <= 80 || line.contains(" = {")));
    assert!(printed.contains("[[thermal.expansion]]") && printed.contains("[[thermal.seen]]"));
    let other = folder.path().join("other.csv");
    let first = std::fs::read_to_string(files[0]).expect("read");
    for (from, to, expected) in [
        ("scale_degc", "table_degc", "found no column scale_degc"),
        ("dx_um", "dy_um", "found no column dx_um"),
        (",X,", ",note,", "files in which one axis moves"),
    ] {
        std::fs::write(&other, first.replacen(from, to, 1)).expect("written");
        let message = refused(&["fit-thermal", files[0], other.to_str().expect("UTF-8")]);
        assert!(message.replace('\n', " ").contains(expected), "{message}");
    }
}

#[test]
fn shipped_runs_and_the_machine_file_with_their_terms() {
    let runs = ["monday", "tuesday", "wednesday", "thursday"];
    let runs = runs.map(|day| format!("examples/thermal/{day}.csv"));
    let call: Vec<&str> =
        std::iter::once("fit-thermal").chain(runs.iter().map(String::as_str)).collect();
    let answer = json(&call);
    let channel = &answer["displacements"][0];
    // The noise of the displacement is 0.2 µm, both at the start of the run, which is its zero, and in each row.
    for left in list(&channel["left_out"]) {
        let rms = float(&left["rms"]);
        assert!((0.15..0.4).contains(&rms), "{left}");
    }
    let machine = std::fs::read_to_string(root().join("examples/thermal/mill.toml"));
    let machine: toml::Table = machine.expect("read").parse().expect("TOML");
    let terms = channel["toml"].as_str().expect("text");
    let terms: toml::Table = format!("[thermal]\n{terms}").parse().expect("TOML");
    assert!(terms["thermal"].get("seen").is_some());
    for (key, expected) in terms["thermal"].as_table().expect("a table") {
        assert_eq!(&machine["thermal"][key], expected, "{key}");
    }
}

#[test]
fn wrong_files_and_calls_end_with_status_2() {
    for other in
        [SPINDLE.to_owned(), format!("./{SPINDLE}"), root().join(SPINDLE).display().to_string()]
    {
        let twice = refused(&["fit-thermal", SPINDLE, &other]);
        assert!(twice.contains("appears twice"), "{other}: {twice}");
    }
    let folder = Folder::new();
    let file = |text: &str| {
        let path = folder.path().join("wrong.csv");
        std::fs::write(&path, text).expect("writable");
        path
    };
    for (text, expected) in [
        ("time_s,t1_degc\n0,20\n", "no displacement"),
        ("time_s,ch1_um\n0,20\n", "no temperature"),
        ("t1_degc,ch1_um\n0,20\n", "no column time_s"),
        ("time_s,t1_degc,ch1_um\n0,20,1\n1,x,2\n", ":3: t1_degc: found `x`"),
        ("time_s,t1_degc,ch1_um\n5,20,1\n1,20,2\n", ":3: time_s: the time goes back"),
        (
            "time_s,t1_degc,ch1_um\n0,20,1\n1,20,2\n",
            "found 2 rows, of which the first 1 (--train 0.7) find terms and the others judge",
        ),
    ] {
        let path = file(text);
        let output = volcomp(&["fit-thermal", path.to_str().expect("UTF-8")]);
        assert_eq!(output.status.code(), Some(2), "{text}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        contains(&message, expected);
    }
    for call in [
        ["--train", "2"],
        ["--error", "EZ"],
        ["--displacement", "ch9_um"],
        ["--lags", "-1"],
        ["--most-lags", "0"],
    ] {
        let output = volcomp(&["fit-thermal", SPINDLE, call[0], call[1]]);
        assert_eq!(output.status.code(), Some(2), "{call:?}");
    }
}

/// Four tests of three hours. The spindle temperature oscillates by ±10 K. The displacement is `um_per_k` times this
/// temperature, plus noise.
fn tests_of(folder: &std::path::Path, seed: u64, um_per_k: f64) -> Vec<String> {
    let mut draw = Draw(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 5);
    let test = |number: usize| {
        let (phase, speed, other) = (3.0 * draw.next(), 1.5 + 0.5 * draw.next(), 3.0 * draw.next());
        let mut text = String::from("time_s,spindle_degc,bed_degc,z_um\n");
        for row in 0..180_u32 {
            let hours = f64::from(row) / 60.0;
            let spindle = 25.0 + 10.0 * (speed * hours + phase).sin();
            let bed = 21.0 + 0.8 * (0.7 * hours + other).sin() + draw.noise(0.02);
            let z = um_per_k * spindle + draw.noise(0.2);
            text += &[
                f64::from(60 * row).to_string(),
                spindle.to_string(),
                bed.to_string(),
                z.to_string(),
            ]
            .join(",");
            text.push('\n');
        }
        let path = folder.join(format!("{number}.csv"));
        std::fs::write(&path, text).expect("written");
        path.display().to_string()
    };
    (0..4).map(test).collect()
}

#[test]
fn worthless_terms_are_not_printed() {
    let folder = Folder::new();
    let files = tests_of(folder.path(), 1, 0.0);
    let mut call = vec!["fit-thermal"];
    call.extend(files.iter().map(String::as_str));
    let printed = one_line(&text(&call));
    contains(&printed, "no better than no terms at all");
}

/// A sensor's fault value is rejected with file, line and column.
#[test]
fn faults_of_sensors_are_refused() {
    let folder = Folder::new();
    let files = tests_of(folder.path(), 3, 3.0);
    let good = std::fs::read_to_string(&files[1]).expect("the file");
    for (value, expected) in [("-127", "expected -60 to 200 °C"), ("85", "there and back")] {
        let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
        let mut cells: Vec<&str> = lines[70].split(',').collect();
        cells[2] = value;
        lines[70] = cells.join(",");
        std::fs::write(&files[1], lines.join("\n") + "\n").expect("written");
        let message = refused(&["fit-thermal", &files[0], &files[1]]);
        let message = one_line(&message);
        contains(&message, "1.csv:71");
        contains(&message, "bed_degc");
        contains(&message, expected);
    }
}

#[test]
fn a_temperature_that_never_changes_is_named() {
    let folder = Folder::new();
    let path = folder.file("still.csv");
    let written = |spindle: fn(u32) -> f64| {
        let mut text = String::from("time_s,spindle_degc,bed_degc,z_um\n");
        for row in 0..300_u32 {
            let line = [f64::from(60 * row), spindle(row), 21.0, 3.0 * spindle(row)];
            text += &line.map(|number| number.to_string()).join(",");
            text.push('\n');
        }
        std::fs::write(&path, text).expect("written");
    };
    written(|row| 25.0 + 10.0 * (f64::from(row) / 30.0).sin());
    let ran = volcomp(&["fit-thermal", &path]);
    let said =
        String::from_utf8_lossy(&ran.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    contains(&said, "note: bed_degc: the same value in all rows");
    written(|_| 20.0);
    let message = refused(&["fit-thermal", &path]);
    let message = one_line(&message);
    contains(&message, "no temperature changes (spindle_degc, bed_degc)");
}

fn changed(file: &str, column: usize, change: impl Fn(f64) -> f64) {
    let text = std::fs::read_to_string(file).expect("the file");
    let mut lines = text.lines();
    let mut written = lines.next().expect("a header").to_owned() + "\n";
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let number: f64 = cells[column].parse().expect("a number");
        cells[column] = change(number).to_string();
        written += &(cells.join(",") + "\n");
    }
    std::fs::write(file, written).expect("written");
}

/// One of four good tests is inverted, has a dead sensor or has another unit: a note names the file and the defect.
/// Good tests get no note.
#[test]
fn inverted_files_dead_sensors_and_other_units_are_named() {
    let folder = Folder::new();
    let notes = |change: &dyn Fn(&[String])| {
        let files = tests_of(folder.path(), 3, 3.0);
        change(&files);
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        notes(&[&["fit-thermal"], &files[..]].concat())
    };
    let good = notes(&|_| {});
    for word in ["inverted", "same value", "expected seconds", "expected µm"] {
        assert!(!good.contains(word), "{good}");
    }
    let sign = notes(&|files| changed(&files[1], 3, |z| -z));
    contains(&sign, "1.csv looks inverted: with the opposite sign 0.");
    assert_eq!(sign.matches("inverted").count(), 1, "{sign}");
    let dead = notes(&|files| changed(&files[0], 1, |_| 20.0));
    contains(&dead, "0.csv: the same value in all rows of spindle_degc (20 °C)");
    let minutes = notes(&|files| {
        for file in files {
            changed(file, 0, |time_s| time_s / 60.0);
        }
    });
    contains(&minutes, "the longest file lasts 179 s");
    contains(&minutes, "expected seconds");
    let in_mm = notes(&|files| {
        for file in files {
            changed(file, 3, |z| 1e-3 * z);
        }
    });
    contains(&in_mm, "z_um: moves by");
    contains(&in_mm, "expected µm");
}

#[test]
fn two_files_of_opposite_sign_are_both_named() {
    let folder = Folder::new();
    let files = tests_of_an_axis(folder.path());
    changed(&files[1], 5, |x| -x);
    let call = ["fit-thermal", "--error", "EXX", &files[0], &files[1]];
    let said = notes(&call);
    let expected = format!("{} or {} looks inverted", files[0], files[1]);
    contains(&said, &expected);
    let printed = text(&call);
    let printed = one_line(&printed);
    contains(&printed, "(mean squares differ by ");
}

/// Headers may state units in any usual notation. A note lists ignored columns.
#[test]
fn heads_have_their_units_in_any_usual_way() {
    let folder = Folder::new();
    let files = tests_of_an_axis(folder.path());
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    let call = [&["fit-thermal", "--error", "dx_um=EXX"], &files[..]].concat();
    let before = json(&call);
    for file in &files {
        let text = std::fs::read_to_string(file).expect("read");
        let text = text.replacen(
            "time_s,X,spindle_degc,scale_degc,room_degc,dx_um",
            "time [s],X [mm],spindle °C,scale [°C],room_degc,dx µm",
            1,
        );
        std::fs::write(file, text).expect("written");
    }
    assert_eq!(json(&call), before);
    let named = [&["fit-thermal", "--displacement", "dx [µm]", "--error", "dx µm=EXX"], &files[..]];
    assert_eq!(json(&named.concat()), before);
    assert!(!notes(&call).contains("not read"));
    let spindle = notes(&["fit-thermal", SPINDLE]);
    contains(&spindle, "note: columns that are not read: spindle_rpm");
    let text = std::fs::read_to_string(files[0]).expect("read");
    std::fs::write(files[0], text.replacen("room_degc", "scale_degc", 1)).expect("written");
    refuses(&["fit-thermal", files[0]], "found two columns `scale_degc`");
}

/// Three tests of 8 h, recorded every `every_s` seconds and simulated in steps of 5 s. The spindle follows its heat
/// with a time constant of 200 s. The displacement is 3 µm/K of the spindle with a time constant of 300 s. The second
/// test has a gap of `gap_s` seconds after 3 h.
fn logged_every(folder: &std::path::Path, every_s: u32, gap_s: u32) -> Vec<String> {
    let write = |test: u32| {
        let (mut spindle, mut lagged) = (20.0_f64, 20.0_f64);
        let mut text = "time_s,spindle_degc,dz_um\n".to_owned();
        for time_s in (0..28_800_u32).step_by(5) {
            let is_gap = test == 1 && (10_800..10_800 + gap_s).contains(&time_s);
            if time_s % every_s == 0 && !is_gap {
                let noise = 0.05 * (f64::from(time_s * (test + 1) % 1700) / 1700.0 - 0.5);
                let moved = 3.0 * (lagged - 20.0) + noise;
                writeln!(text, "{time_s},{spindle:.4},{moved:.4}").expect("a string");
            }
            let heat = 20.0 + 4.0 * f64::from((time_s / 2400 * 7 + test * 5) % 6);
            spindle += (heat - spindle) * (1.0 - (-5.0_f64 / 200.0).exp());
            lagged += (spindle - lagged) * (1.0 - (-5.0_f64 / 300.0).exp());
        }
        let path = folder.join(format!("test-{test}.csv"));
        std::fs::write(&path, text).expect("written");
        path.display().to_string()
    };
    (0..3).map(write).collect()
}

#[test]
fn rows_too_far_apart_and_gaps_are_named() {
    let folder = Folder::new();
    let said = |every_s, gap_s| {
        let files = logged_every(folder.path(), every_s, gap_s);
        let call = std::iter::once("fit-thermal").chain(files.iter().map(String::as_str));
        let output = volcomp(&call.collect::<Vec<_>>());
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        words.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let fine = said(30, 0);
    assert!(!fine.contains("apart"), "{fine}");
    let coarse = said(300, 0);
    contains(&coarse, "are 300 s apart, and the shortest time constant");
    contains(&coarse, "Record the temperatures every");
    let gap = said(60, 3600);
    contains(&gap, "a gap in the log from 10740 to 14400 s, where rows are usually 60 s apart");
}
