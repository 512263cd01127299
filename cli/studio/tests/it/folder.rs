//! From a folder to a machine file, without HTTP.

use std::fs;

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_model::{Machine, Temperatures, diagonals};
use volcomp_studio::{Folder, TableRequest, TypedAnswer, Verdict};
use volcomp_test_support::root;

use crate::{SLOPE, copy, defaults, small};

fn given(of: &str, key: &str, value: &str) -> TypedAnswer {
    TypedAnswer { of: of.to_owned(), key: key.to_owned(), value: value.to_owned() }
}

fn request(limit_um: f64) -> TableRequest {
    TableRequest {
        format: "csv".to_owned(),
        step_mm: 100.0,
        step_deg: 15.0,
        at: [("Y".parse().expect("an axis"), 100.0)].into(),
        limit_um,
    }
}

#[test]
fn one_file_with_defaults_yields_a_machine_file() {
    let (dir, folder) = small();
    let state = folder.state().expect("readable");
    assert_eq!(state.files.len(), 1);
    assert_eq!(state.files[0].error.as_deref(), Some("EXX"));
    let open = state.draft.expect("drafted").open;
    assert!(open > 0, "where the other axes were is not in the file");
    let refused = folder.fit("", None).expect_err("open").to_string();
    assert!(refused.starts_with(&format!("{open} open questions")), "{refused}");
    folder.answer(&defaults(&folder)).expect("answers");
    let fitted = folder.fit("EXX=100,V=100", None).expect("fitted");
    assert_eq!((fitted.curves, fitted.verdict), (1, Verdict::Pass));
    let of_v = &fitted.checks[1];
    assert!(of_v.starts_with("V of the measured errors alone: "), "{of_v}");
    assert_eq!(folder.fit("EXX=1", None).expect("fitted").verdict, Verdict::Fail);
    assert_eq!(folder.fit("", None).expect("fitted").verdict, Verdict::None);
    let machine = Machine::read(dir.path().join("result/machine.toml")).expect("valid");
    assert_eq!(machine.checksum(), fitted.machine);
    let curve = machine.error("EXX".parse().expect("a name")).expect("fitted");
    let at = |x: f64| curve.value(0, &[x, 0.0, 0.0], None);
    assert!((at(400.0) - at(0.0) - 8.0).abs() < 0.2, "{}", at(400.0));
    let report = fs::read_to_string(dir.path().join("result/report.html")).expect("written");
    let path = dir.path().canonicalize().expect("there");
    assert!(report.contains("exx.csv") && !report.contains(&path.display().to_string()));
    // All state is in the folder, so opening the folder again restores it.
    let again = Folder::open(dir.path()).expect("there");
    let state = again.state().expect("readable");
    assert_eq!(state.draft.expect("drafted").open, 0);
    assert_eq!(state.results, ["result/machine.toml", "result/report.html"]);
    assert!(!state.is_stale);
    // Once an input has changed or is missing, the result is neither sent nor exported. File dates have no influence.
    let exx = dir.path().join("exx.csv");
    let text = fs::read_to_string(&exx).expect("there");
    let date = fs::metadata(&exx).and_then(|of| of.modified()).expect("a date");
    fs::write(&exx, text.replace("8.1", "8.2")).expect("writable");
    let file = fs::File::open(&exx).expect("there");
    file.set_modified(date).expect("settable");
    let is_stale = || folder.state().expect("readable").is_stale;
    assert!(is_stale());
    let refused = folder.tables(&request(250.0)).expect_err("stale").to_string();
    assert!(refused.contains("has changed since the fit"), "{refused}");
    fs::write(&exx, text).expect("writable");
    assert!(!is_stale());
    fs::remove_file(&exx).expect("there");
    assert!(is_stale());
}

#[test]
fn a_hand_edited_calibration_file_is_not_overwritten() {
    let (dir, folder) = small();
    folder.answer(&defaults(&folder)).expect("answers");
    let path = dir.path().join("calibration.toml");
    let text = fs::read_to_string(&path).expect("written");
    let changed = format!("{text}\n[uncertainty]\nlaser_um_per_m = 1.0\n");
    fs::write(&path, &changed).expect("writable");
    assert!(folder.state().expect("readable").by_hand);
    folder.fit("", None).expect("fitted");
    let refused = folder.answer(&[]).expect_err("changed").to_string();
    assert!(refused.contains("changed since"), "{refused}");
    assert_eq!(fs::read_to_string(&path).expect("there"), changed);
}

/// The second readings have twice the slope: EXX changes by 8 µm at the end of the travel. The second machine file
/// states a squareness: EC0Y changes by 5 µrad.
#[test]
fn earlier_models_are_compared_with_the_newest() {
    let (dir, folder) = small();
    folder.answer(&defaults(&folder)).expect("answers");
    let first = folder.fit("V=100", None).expect("fitted");
    let readings: String = SLOPE
        .lines()
        .map(|line| match line.rsplit_once(',') {
            Some((head, um)) => match um.parse::<f64>() {
                Ok(um) => format!("{head},{}\n", 2.0 * um),
                Err(_) => format!("{line}\n"),
            },
            None => String::new(),
        })
        .collect();
    fs::write(dir.path().join("exx.csv"), readings).expect("writable");
    let text = fs::read_to_string(dir.path().join("machine.toml")).expect("there");
    folder.set_machine("machine.toml", &format!("{text}\n[errors]\nEC0Y = 5.0\n")).expect("valid");
    let second = folder.fit("V=100", None).expect("fitted");
    let models = folder.state().expect("readable").models;
    let earlier = folder.drift(&models[0].name).expect("compared");
    assert_eq!(earlier.position_um, first.position_um);
    let names: Vec<_> = earlier.changes.iter().map(|of| (of.error.as_str(), of.unit)).collect();
    assert_eq!(names, [("EXX", "µm"), ("EC0Y", "µrad")]);
    let largest: Vec<f64> = earlier.changes.iter().map(|of| of.largest).collect();
    assert!((largest[0] - 8.05).abs() < 0.1 && (largest[1] - 5.0).abs() < 1e-9, "{largest:?}");
    let newest = folder.drift("result/machine.toml").expect("evaluated");
    assert_eq!((newest.position_um, newest.changes), (second.position_um, Vec::new()));
    let refused = folder.drift("machine.toml").expect_err("no model").to_string();
    assert!(refused.contains("earlier models"), "{refused}");
}

/// A pipe in place of a file is rejected, since reading a pipe would block.
#[test]
fn a_pipe_in_place_of_a_studio_file_is_rejected() {
    let dir = tempfile::tempdir().expect("writable");
    let pipe = dir.path().join("machine.toml");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.expect("there").success());
    let refused = Folder::open(dir.path()).expect_err("a pipe").to_string();
    assert!(refused.contains("machine.toml"), "{refused}");
    assert!(refused.contains("expected a file"), "{refused}");
}

/// The gantry of the examples is fitted from laser files that were simulated from `truth.toml`. The studio does not
/// read `truth.toml`. On each body diagonal the deviations of the fitted and the true machine differ by less than 10 %
/// of the true range.
#[test]
fn the_gantry_files_reproduce_their_machine() {
    let example = root().join("examples/from-files/gantry");
    let dir = tempfile::tempdir().expect("writable");
    copy(&example.join("lasers"), &dir.path().join("lasers"));
    fs::copy(example.join("machine.toml"), dir.path().join("machine.toml")).expect("writable");
    let folder = Folder::open(dir.path()).expect("there");
    // The set-up is in the example's calibration file. A key that is missing there has its default.
    let text = fs::read_to_string(example.join("calibration.toml")).expect("there");
    let stated: toml::Table = text.parse().expect("TOML");
    let rows = |key: &str| stated[key].as_array().expect("a list").clone();
    let all: Vec<toml::Value> = [rows("measurement"), rows("squareness")].concat();
    let answers = || {
        let draft = folder.state().expect("readable").draft.expect("drafted");
        let questions = draft.questions.into_iter();
        questions
            .map(|asked| {
                let is_it = |row: &&toml::Value| {
                    let text = |key: &str| row.get(key).and_then(toml::Value::as_str);
                    text("file") == Some(&asked.of)
                        || text("file").is_none() && text("error") == Some(&asked.of)
                };
                let row = all.iter().find(is_it);
                let row = row.unwrap_or_else(|| panic!("{}: not stated", asked.of));
                let value = match asked.key.split_once('.') {
                    Some((table, key)) => row.get(table).and_then(|of| of.get(key)),
                    None => row.get(&asked.key),
                };
                let value = match value {
                    Some(toml::Value::String(text)) => text.clone(),
                    Some(other) => other.to_string(),
                    None => {
                        let default = asked.default.clone();
                        default.unwrap_or_else(|| panic!("{}: {}", asked.of, asked.key))
                    }
                };
                given(&asked.of, &asked.key, &value)
            })
            .collect::<Vec<_>>()
    };
    // The answer for an error or a unit may open further questions.
    for _ in 0..2 {
        folder.answer(&answers()).expect("answers");
    }
    let fitted = folder.fit("", None).expect("fitted");
    assert!(fitted.curves >= 18, "{}", fitted.curves);
    let machine = Machine::read(dir.path().join("result/machine.toml")).expect("valid");
    let truth = Machine::read(example.join("truth.toml")).expect("valid");
    let none = Temperatures::new();
    let along =
        |of: &Machine| diagonals(of, &of.source(&none), 20, &[], |pose| *pose).expect("X, Y and Z");
    for (found, true_one) in along(&machine).iter().zip(along(&truth)) {
        let left = found.deviation_um.iter().zip(&true_one.deviation_um);
        let left = left.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(
            left < 0.1 * true_one.range_um,
            "{}: {left} µm of {}",
            found.name,
            true_one.range_um
        );
    }
}

#[test]
fn a_user_calibration_file_is_never_replaced() {
    let example = root().join("examples/from-files/gantry");
    let dir = tempfile::tempdir().expect("writable");
    copy(&example, dir.path());
    let before = fs::read_to_string(dir.path().join("calibration.toml")).expect("there");
    let folder = Folder::open(dir.path()).expect("there");
    let state = folder.state().expect("readable");
    assert!(state.by_hand && state.draft.is_none());
    folder.fit("", None).expect("fitted");
    let refused = folder.answer(&[]).expect_err("not replaced").to_string();
    assert!(refused.starts_with("calibration.toml: "), "{refused}");
    let after = fs::read_to_string(dir.path().join("calibration.toml")).expect("there");
    assert_eq!(before, after);
    let file = CalibrationFile::read(&example.join("calibration.toml")).expect("valid");
    let machine = Machine::read(dir.path().join("result/machine.toml")).expect("valid");
    let library = calibrate(&file, |_, _| {}).expect("fitted");
    assert_eq!(machine.checksum(), library.machine.checksum());
}

#[test]
fn without_measurements_the_machine_file_is_the_result() {
    let (dir, folder) = small();
    fs::remove_file(dir.path().join("exx.csv")).expect("there");
    let text = fs::read_to_string(dir.path().join("machine.toml")).expect("there");
    let text = format!("{text}\n[errors]\nEC0Y = 12.0\n");
    folder.set_machine("machine.toml", &text).expect("valid");
    let fitted = folder.fit("EC0Y=20", None).expect("stated");
    assert_eq!((fitted.curves, fitted.verdict), (0, Verdict::Pass));
    let machine = Machine::read(dir.path().join("result/machine.toml")).expect("valid");
    assert!(machine.locations().values().eq([&12.0]));
}

#[test]
fn the_error_answer_determines_the_open_questions() {
    let (dir, folder) = small();
    fs::remove_file(dir.path().join("exx.csv")).expect("there");
    folder.receive("scan.csv", SLOPE.as_bytes()).expect("taken");
    let asks = |key: &str| {
        let draft = folder.state().expect("readable").draft.expect("drafted");
        draft.questions.iter().any(|of| of.key == key)
    };
    assert!(asks("error"));
    let mut answers = vec![given("scan.csv", "error", "EXX")];
    folder.answer(&answers).expect("taken");
    assert!(asks("error") && asks("at.Y") && !asks("at.X"));
    answers = [answers, defaults(&folder)].concat();
    folder.answer(&answers).expect("taken");
    folder.fit("", None).expect("fitted");
    // With another error, the answers to questions of the previous error are ignored, and the questions of the new
    // error are open.
    answers[0] = given("scan.csv", "error", "EYX");
    folder.answer(&answers).expect("taken");
    assert!(asks("sign"));
    answers[0] = given("scan.csv", "error", "EYQ");
    let refused = folder.answer(&answers).expect_err("no error").to_string();
    assert!(refused.contains("scan.csv: error: found \"EYQ\""), "{refused}");
    // Removing a file removes its answers.
    fs::remove_file(dir.path().join("scan.csv")).expect("there");
    assert_eq!(folder.state().expect("readable").files, []);
}

#[test]
fn answers_that_make_a_squareness_possible_add_its_question() {
    let (dir, folder) = small();
    fs::remove_file(dir.path().join("exx.csv")).expect("there");
    let other = SLOPE.replace("8.1", "8.2");
    folder.receive("one.csv", SLOPE.as_bytes()).expect("taken");
    folder.receive("two.csv", other.as_bytes()).expect("taken");
    let mut answers = vec![given("one.csv", "error", "EYX"), given("two.csv", "error", "EXY")];
    folder.answer(&answers).expect("taken");
    answers = [answers, defaults(&folder)].concat();
    answers.push(given("EC0Y", "reference_angle_urad", "5"));
    folder.answer(&answers).expect("taken");
    let draft = folder.state().expect("readable").draft.expect("drafted");
    assert!(draft.text.contains("reference_angle_urad = 5.0"), "{}", draft.text);
}

#[test]
fn an_unused_file_is_named_with_its_error() {
    let (_dir, folder) = small();
    folder.receive("EYY-report.xlsx", b"PK rubbish").expect("taken");
    let state = folder.state().expect("readable");
    let reason = state.files.iter().find(|of| of.name == "EYY-report.xlsx");
    assert!(reason.expect("listed").not_used.is_some());
    folder.answer(&defaults(&folder)).expect("answers");
    let warnings = folder.fit("", None).expect("fitted").warnings;
    let first = "EYY is taken as 0, because its file was not used: EYY-report.xlsx: ";
    assert!(warnings[0].starts_with(first), "{warnings:?}");
    let out = [given("exx.csv", "leave_out", "true")];
    folder.answer(&out).expect("taken");
    let refused = folder.fit("", None).expect_err("nothing is left").to_string();
    assert!(refused.contains("exx.csv are left out"), "{refused}");
}

#[test]
fn dropped_files_do_not_replace_measurements() {
    let (dir, folder) = small();
    folder.receive("exx.csv", SLOPE.as_bytes()).expect("the same");
    for (name, bytes, why) in [
        ("exx.csv", "target_mm,deviation_um\n0,1\n", "with different content"),
        ("answers.json", "[]", "a reserved name of the studio"),
        ("gateway.toml", "cycle_ms = 4.0", "gateway.toml"),
        ("setup.toml", "nonsense = 1", "setup.toml"),
        ("..", "", "expected a file name"),
    ] {
        let refused = folder.receive(name, bytes.as_bytes()).expect_err(name);
        assert!(refused.to_string().contains(why), "{name}: {refused}");
    }
    let large = vec![b'0'; volcomp_studio::MAX_FILE_BYTES + 1];
    assert!(folder.receive("large.csv", &large).is_err());
    folder.receive("../../escaped.csv", b"target_mm,deviation_um\n0,1\n").expect("its name");
    assert!(dir.path().join("escaped.csv").exists());
    for place in 0..volcomp_studio::MAX_FILES - 2 {
        fs::write(dir.path().join(format!("{place}.csv")), "").expect("writable");
    }
    let refused = folder.receive("more.csv", b"0").expect_err("one too many");
    assert!(refused.to_string().contains("the maximum of 200 files"), "{refused}");
    fs::write(dir.path().join("more.csv"), "").expect("writable");
    let refused = folder.state().expect_err("too many").to_string();
    assert!(refused.contains("found more than 200 files"), "{refused}");
}

#[test]
fn tables_and_programs_contain_the_correction() {
    let (dir, folder) = small();
    let none = folder.tables(&request(250.0)).expect_err("no result");
    assert!(none.to_string().starts_with("result/machine.toml: not found"));
    folder.answer(&defaults(&folder)).expect("answers");
    folder.fit("", None).expect("fitted");
    let done = folder.tables(&request(250.0)).expect("written");
    assert!(
        !done.files.is_empty() && done.files.iter().all(|of| of.starts_with("result/tables/csv/"))
    );
    let x = done.left.iter().find(|of| of.axis.to_string() == "X").expect("X");
    assert!((x.without - 8.0).abs() < 0.5 && x.largest < 0.2, "{x:?}");
    assert!(folder.tables(&request(1.0)).is_err(), "8 µm are beyond 1 µm");
    let program = "G21 G90\nG1 X400 Y0 Z0 F1000\nM2\n";
    let done = folder.nc("part.ngc", program.as_bytes(), 1.0).expect("written");
    assert_eq!((done.file.as_str(), done.counts.motions), ("result/nc/part.ngc", 1));
    let text = fs::read_to_string(dir.path().join(&done.file)).expect("written");
    // At X = 400 mm the table moves 8 µm too far, so the corrected command is 399.992 mm.
    assert!(text.contains("X399.992"), "{text}");
    let wrong = folder.nc("part.ngc", b"G1 X1 F1000\nG1 X1.2.3\n", 1.0);
    let wrong = wrong.expect_err("no number").to_string();
    assert!(wrong.starts_with("part.ngc: ") && wrong.contains('2'), "{wrong}");
    // Written programs are not listed as measurements.
    assert_eq!(folder.state().expect("readable").files.len(), 1);
    // A new fit moves the tables and programs of the previous result aside.
    folder.fit("", None).expect("fitted");
    let left = folder.state().expect("readable").results;
    assert_eq!(left, ["result/machine.toml", "result/report.html"]);
    // The programs of the previous result are kept, since the user may have edited them.
    let aside = dir.path().join("result/before-1/nc/part.ngc");
    assert_eq!(fs::read_to_string(aside).expect("kept"), text);
    // The same readings give the same model, so no earlier model is listed.
    assert!(folder.state().expect("readable").models.is_empty());
    let readings = fs::read_to_string(dir.path().join("exx.csv")).expect("there");
    let doubled = [("8", "16"), ("4", "8"), ("2", "4"), ("6", "12")];
    let doubled = doubled.iter().fold(readings, |text, (um, twice)| {
        text.replace(&format!(",+,{um}"), &format!(",+,{twice}"))
    });
    fs::write(dir.path().join("exx.csv"), doubled).expect("writable");
    let fitted = folder.fit("", None).expect("fitted");
    assert_eq!(fitted.before_um, None);
    let models = folder.state().expect("readable").models;
    let names: Vec<&str> = models.iter().map(|model| model.name.as_str()).collect();
    assert_eq!(names, ["result/before-2/machine.toml"]);
    let compared = folder.fit("", Some(names[0])).expect("fitted");
    assert_eq!(compared.position_um, fitted.position_um);
    assert!(compared.before_um < compared.position_um, "{compared:?}");
    let refused = folder.fit("", Some("machine.toml")).expect_err("no earlier model");
    assert!(refused.to_string().contains("earlier models"), "{refused}");
    // The 450 programs of an earlier result do not count as measurement files, of which a folder may hold 200.
    let earlier = dir.path().join("result/before-7/nc");
    fs::create_dir_all(&earlier).expect("writable");
    for number in 0..450 {
        fs::write(earlier.join(format!("{number}.ngc")), "M2\n").expect("writable");
    }
    for number in 0..40 {
        let copy = dir.path().join(format!("copy-{number}.csv"));
        fs::copy(dir.path().join("exx.csv"), copy).expect("writable");
    }
    let state = folder.state().expect("readable");
    assert_eq!(state.files.len(), 41);
    assert!(state.results.iter().all(|name| !name.contains("before-")));
}
