//! Answers to the questions of a draft, as typed by the user.

use std::path::Path;

use volcomp_calibrate::{Answer, AnswerError, CalibrationFile, Draft, Subject, calibrate, draft};
use volcomp_model::Machine;

/// A folder with the machine of the example and the files that `fill` writes, and the draft for this folder.
fn drafted_in(fill: impl FnOnce(&Path, &Path)) -> (tempfile::TempDir, Draft) {
    let dir = tempfile::tempdir().expect("writable");
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration");
    let machine = dir.path().join("machine.toml");
    std::fs::copy(examples.join("machine.toml"), &machine).expect("there");
    fill(&examples, dir.path());
    let machine = Machine::read(machine).expect("right");
    let base = dir.path().to_owned();
    let named = |path: &Path| {
        let inside = path.strip_prefix(&base).expect("in it");
        inside.display().to_string()
    };
    let found = draft(&base, &machine, "machine.toml", named).expect("readable");
    (dir, found)
}

fn drafted(names: &[&str]) -> (tempfile::TempDir, Draft) {
    drafted_in(|examples, folder| {
        for name in names {
            std::fs::copy(examples.join(name), folder.join(name)).expect("there");
        }
    })
}

fn drafted_of(files: &[(&str, &str)]) -> (tempfile::TempDir, Draft) {
    drafted_in(|_, folder| {
        for (name, text) in files {
            std::fs::write(folder.join(name), text).expect("writable");
        }
    })
}

fn open_keys(draft: &Draft) -> Vec<String> {
    draft.questions.iter().map(|of| of.key.clone()).collect()
}

fn answer(of: Subject, key: &str, value: &str) -> Answer {
    Answer { of, key: key.to_owned(), value: value.to_owned() }
}

fn place(draft: &Draft, file: &str) -> usize {
    let mut all = draft.proposed.iter();
    all.position(|of| of.files.iter().any(|name| name == file)).expect(file)
}

/// If every question is answered, the file is valid, and its calibration has the slope of the example's machine.
#[test]
fn an_answered_draft_is_a_calibration_file() {
    let (dir, found) = drafted(&["exx.csv"]);
    let first = Subject::Measurement(0);
    let mut answers: Vec<Answer> = Vec::new();
    for question in &found.questions {
        let value = match question.key.as_str() {
            "at.Y" => "200",
            "at.Z" => "−300",
            "point" => "[0, 0, -350]",
            "rides" => "carriage",
            "sign" => "+1",
            "unit" => "um",
            other => panic!("{other}"),
        };
        answers.push(answer(first.clone(), &question.key, value));
    }
    assert!(!answers.is_empty());
    // The file with one open answer is rejected with the question.
    let open = found.answered(&answers[1..]).expect("right");
    assert_eq!(open.questions.len(), 1);
    let file = dir.path().join("calibration.toml");
    std::fs::write(&file, &open.text).expect("writable");
    let refused = CalibrationFile::read(&file).expect_err("open").to_string();
    assert!(refused.contains("open question"), "{refused}");
    let done = found.answered(&answers).expect("right");
    assert!(done.questions.is_empty(), "{}", done.text);
    std::fs::write(&file, &done.text).expect("writable");
    let read = CalibrationFile::read(&file).expect("complete");
    let calibration = calibrate(&read, |_, _| {}).expect("it fits");
    let curve = &calibration.curves[0];
    // Readings minus curve equal the residuals of the output.
    let residuals: Vec<f64> = curve.points.iter().map(|[_, u, f]| u - f).collect();
    let volcomp_calibrate::Quality::Length(quality) = curve.quality else {
        panic!("a length");
    };
    let largest = residuals.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    assert!((largest - quality.residual_max.0).abs() < 1e-9, "{largest}");
    let ends = [curve.sampled[0], curve.sampled[curve.sampled.len() - 1]];
    let machine_value = |x: f64| {
        let error = calibration.machine.error(curve.error).expect("set");
        error.value(0, &[x, 0.0, 0.0], curve.direction)
    };
    for [x, value] in ends {
        assert!((machine_value(x) - value).abs() < 1e-9, "{x}");
    }
}

#[test]
fn invalid_answers_are_refused_by_key() {
    let (_dir, found) = drafted(&["exx.csv", "eyx.csv", "exy.csv", "ebx.csv"]);
    let of = Subject::Measurement(place(&found, "exx.csv"));
    for (key, value, expected) in [
        ("point", "1, 2", "three numbers"),
        ("point", "1, 2, NaN", "three numbers"),
        ("at.Y", "1,5", "a number"),
        ("at.Y", "inf", "a number"),
        ("rides", "both", "carriage or other"),
        ("error", "EQQ", "the name of an error"),
        ("file", "../../etc/passwd", "one of exx.csv"),
        ("leave_out", "perhaps", "true or false"),
        ("error", "default", "the name of an error"),
    ] {
        let wrong = found.answered(&[answer(of.clone(), key, value)]);
        let message = wrong.expect_err(value).to_string();
        assert!(message.contains(expected) && message.contains(key), "{message}");
    }
    // Answers without a question, and for a missing measurement.
    let key = found.answered(&[answer(of.clone(), "machine", "x")]);
    assert!(matches!(key, Err(AnswerError::Key { .. })), "{key:?}");
    let missing = found.answered(&[answer(Subject::Measurement(99), "sign", "1")]);
    assert!(matches!(missing, Err(AnswerError::Subject { .. })), "{missing:?}");
}

/// An answer cannot end its value: text that looks like another table adds none.
#[test]
fn an_answer_cannot_inject_other_keys() {
    let (_dir, found) = drafted(&["exx.log"]);
    let evil = "x\" }\n[[squareness]]\nerror = \"EC0Y";
    let of = Subject::Measurement(0);
    let done = found.answered(&[answer(of, "channels.target", evil)]);
    let text = done.expect("a text").text;
    assert!(!text.contains("\n[[squareness]]"), "{text}");
}

/// A measurement that is left out is listed as unused, and the squareness that depends on it is left out as well.
#[test]
fn measurements_left_out_are_listed() {
    let (_dir, found) = drafted(&["eyx.csv", "exy.csv"]);
    assert!(found.text.contains("[[squareness]]"), "{}", found.text);
    let of = Subject::Measurement(place(&found, "exy.csv"));
    let done = found.answered(&[answer(of, "leave_out", "true")]).expect("right");
    assert!(!done.text.contains("[[squareness]]"), "{}", done.text);
    assert!(done.text.contains("not used: exy.csv: left out"), "{}", done.text);
    let square: volcomp_vocabulary::ErrorName = "EC0Y".parse().expect("an error");
    let square = Subject::Squareness(square);
    let done = found.answered(&[answer(square.clone(), "leave_out", "true")]).expect("right");
    assert!(!done.text.contains("[[squareness]]"), "{}", done.text);
    let done = found.answered(&[answer(square, "reference_angle_urad", "2.5")]).expect("right");
    assert!(done.text.contains("reference_angle_urad = 2.5"), "{}", done.text);
}

/// Angular readings of a straightness come from a level on a bridge, so the length of the bridge becomes a question.
#[test]
fn a_unit_of_angle_opens_the_question_for_the_bridge() {
    let (_dir, found) = drafted(&["ezx-level.csv"]);
    let of = Subject::Measurement(0);
    assert!(!open_keys(&found).contains(&"bridge_mm".to_owned()));
    let answers = [answer(of.clone(), "bridge_mm", "150"), answer(of.clone(), "unit", "urad")];
    let done = found.answered(&answers).expect("right");
    assert!(
        done.text.contains("method = \"angular\"\nbridge_mm = 150.0\nreading = \"?\""),
        "{}",
        done.text
    );
    let plain = found.answered(&[answer(of.clone(), "unit", "um")]).expect("right");
    assert!(!plain.text.contains("angular"), "{}", plain.text);
    let none = found.answered(&[answer(of, "unit", "inch")]);
    assert!(none.expect_err("no unit").to_string().contains("one of mm"));
}

const ARCH: &str =
    "target_mm,run,direction,deviation_um\n0,1,+,0\n150,1,+,6\n300,1,+,8\n450,1,+,6\n600,1,+,0\n";

/// For every error except positioning, a question asks whether the table or the tool moved, also if the user answers
/// the error.
#[test]
fn an_answered_error_opens_the_question_for_its_sign() {
    let (_dir, named) = drafted_of(&[("ezx.csv", ARCH)]);
    assert!(open_keys(&named).contains(&"sign".to_owned()));
    let (_dir, found) = drafted_of(&[("scan-1.csv", ARCH)]);
    for error in ["EZX", "EYX", "EBX"] {
        let done =
            found.answered(&[answer(Subject::Measurement(0), "error", error)]).expect("right");
        assert!(open_keys(&done).contains(&"sign".to_owned()), "{error}: {:?}", open_keys(&done));
    }
}

/// The file name states X and the user answers Y: the position of X becomes a question.
#[test]
fn an_error_of_another_axis_opens_the_question_for_that_position() {
    let (_dir, found) = drafted_of(&[("x.csv", ARCH)]);
    let of = Subject::Measurement(0);
    let done = found.answered(&[answer(of.clone(), "error", "EYY")]);
    let open = open_keys(&done.expect("right"));
    assert!(open.contains(&"at.X".to_owned()), "{open:?}");
    assert!(!open.contains(&"at.Y".to_owned()), "{open:?}");
    let both = [answer(of.clone(), "at.X", "120"), answer(of, "error", "EYY")];
    let done = found.answered(&both).expect("right");
    assert!(done.text.contains("at = { X = 120.0, Z = \"?\" }"), "{}", done.text);
}

/// Two tests of one error on one line, before and after a compensation, are a conflict: the user must choose one, and they are never averaged.
#[test]
fn two_files_answered_for_the_same_line_are_a_conflict() {
    let after = "target_mm,run,direction,deviation_um\n0,1,+,0\n150,1,+,0.6\n300,1,+,0.8\n450,1,+,0.6\n600,1,+,0.1\n";
    let (dir, found) = drafted_of(&[("scan-before.csv", ARCH), ("scan-after.csv", after)]);
    let mut answers = Vec::new();
    for place in [0, 1] {
        for (key, value) in [
            ("error", "EXX"),
            ("at.Y", "0"),
            ("at.Z", "0"),
            ("point", "0, 0, 0"),
            ("rides", "carriage"),
        ] {
            answers.push(answer(Subject::Measurement(place), key, value));
        }
    }
    let done = found.answered(&answers).expect("right");
    let said = "scan-after.csv and scan-before.csv both measure EXX at the same place: keep one";
    assert_eq!(done.conflicts, [said]);
    assert!(done.text.contains(said), "{}", done.text);
    let file = dir.path().join("calibration.toml");
    std::fs::write(&file, &done.text).expect("writable");
    let refused = CalibrationFile::read(&file).expect_err("two tests");
    let refused = refused.to_string();
    for name in ["scan-before.csv", "scan-after.csv", "EXX"] {
        assert!(refused.contains(name), "{refused}");
    }
    // Tests on another line, a single test, and the two directions of one test are not conflicts.
    let read = |text: &str| {
        std::fs::write(&file, text).expect("writable");
        CalibrationFile::read(&file).map(|file| file.measurements.len())
    };
    let elsewhere = done.text.replacen("Y = 0.0", "Y = 200.0", 1);
    assert_eq!(read(&elsewhere).expect("two lines"), 2);
    answers.push(answer(Subject::Measurement(0), "leave_out", "true"));
    let one = found.answered(&answers).expect("right");
    assert_eq!(one.conflicts, [""; 0]);
    assert_eq!(read(&one.text).expect("one line"), 1);
    let back = ARCH.replace('+', "-");
    std::fs::write(dir.path().join("scan-after.csv"), back).expect("writable");
    assert_eq!(read(&done.text).expect("two directions"), 2);
}

/// Questions that follow from an error can be answered together with the error, because the web page shows all questions at once.
#[test]
fn follow_up_questions_can_be_answered_with_the_error() {
    let (_dir, found) = drafted_of(&[("scan-1.csv", ARCH), ("exx.csv", ARCH)]);
    let open = open_keys(&found);
    let scan = Subject::Measurement(place(&found, "scan-1.csv"));
    for (error, key, value) in [("EXX", "at.X", "0"), ("EBX", "point", "0, 0, 0")] {
        assert!(open.contains(&key.to_owned()), "{open:?}");
        let of = scan.clone();
        let with = [answer(of.clone(), key, value), answer(of, "error", error)];
        let done = found.answered(&with);
        let done = done.unwrap_or_else(|refusal| panic!("{error} {key}: {refusal}"));
        let said =
            format!("scan-1.csv: {key} is no question for {error}: the answer {value} is not used");
        assert!(done.notes.contains(&said), "{:?}", done.notes);
    }
    // An answer for the sign is accepted, although the answered error EXX has no question for it.
    let with = [answer(scan.clone(), "error", "EXX"), answer(scan, "sign", "-1")];
    assert!(found.answered(&with).is_ok());
    // For EXX, which the file name states, `holds_location` is not a question: the answer is rejected or gives a note.
    let named = Subject::Measurement(place(&found, "exx.csv"));
    let answered = found.answered(&[answer(named, "holds_location", "true")]);
    assert!(answered.is_err() || answered.is_ok_and(|of| !of.notes.is_empty()));
}

/// The position of a line has an effect only with a tilt: the draft asks for it if a tilt is measured, may be measured, can be computed from two lines
/// of one error, or is in the machine file.
#[test]
fn levers_are_asked_where_there_are_any() {
    let asks = |draft: &Draft| open_keys(draft).iter().any(|key| key == "point" || key == "rides");
    let (_dir, found) = drafted(&["exx.csv", "eyx.csv", "exy.csv"]);
    assert!(!asks(&found), "{:?}", open_keys(&found));
    assert!(!found.text.contains("rides ="), "{}", found.text);
    let (_dir, tilt) = drafted(&["exx.csv", "ebx.csv"]);
    assert!(asks(&tilt));
    // A file with an open error may measure a tilt until its error is answered.
    let (_dir, open) = drafted_of(&[("scan-1.csv", ARCH), ("exx.csv", ARCH)]);
    assert!(asks(&open));
    let scan = Subject::Measurement(place(&open, "scan-1.csv"));
    let exx = Subject::Measurement(place(&open, "exx.csv"));
    for (error, asked) in [("EBX", true), ("EXX", true), ("EYX", false)] {
        let answers = [answer(scan.clone(), "error", error)];
        assert_eq!(asks(&open.answered(&answers).expect("right")), asked, "{error}");
    }
    let both = [answer(exx, "rides", "carriage"), answer(scan, "error", "EYX")];
    let notes = open.answered(&both).expect("right").notes.join("\n");
    assert!(notes.contains("exx.csv: rides is no question for EXX"), "{notes}");
    let with_tilt = |_: &Path, folder: &Path| {
        std::fs::write(folder.join("exx.csv"), ARCH).expect("writable");
        let machine = folder.join("machine.toml");
        let text = std::fs::read_to_string(&machine).expect("there");
        let key = "EBX = 10.0\n";
        let text = match text.split_once("[errors]\n") {
            Some((head, rest)) => format!("{head}[errors]\n{key}{rest}"),
            None => format!("{text}\n[errors]\n{key}"),
        };
        std::fs::write(machine, text).expect("writable");
    };
    assert!(asks(&drafted_in(with_tilt).1));
}

/// Keys that are answered with their default are not written, and the calibration is the same as with the defaults stated.
#[test]
fn defaults_are_answers() {
    let (dir, found) = drafted(&["exx.csv", "eyx.csv", "ebx.csv"]);
    let keys: Vec<String> = open_keys(&found);
    let mut answers = Vec::new();
    for key in ["at.Y", "at.Z", "point", "rides", "sign"] {
        assert!(keys.contains(&key.to_owned()), "{keys:?}");
        answers.extend(found.for_all(None, key, "default"));
    }
    for (error, unit) in [("EXX", "um"), ("EYX", "um"), ("EBX", "urad")] {
        answers.extend(found.for_all(Some(error), "unit", unit));
    }
    let done = found.answered(&answers).expect("right");
    assert!(done.questions.is_empty(), "{}", done.text);
    for key in ["at =", "point =", "rides =", "sign ="] {
        let mut lines = done.text.lines();
        assert_eq!(lines.find(|line| line.starts_with(key)), None);
    }
    let file = dir.path().join("calibration.toml");
    let curves = |text: &str| {
        std::fs::write(&file, text).expect("writable");
        let read = CalibrationFile::read(&file).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let found = calibrate(&read, |_, _| {}).expect("it fits");
        found.curves.into_iter().map(|curve| curve.sampled).collect::<Vec<_>>()
    };
    let by_default = curves(&done.text);
    let stated = done.text.replace("[[measurement]]\n", "[[measurement]]\nsign = 1\n");
    let stated = stated.replace("error = \"EXX\"\n", "error = \"EXX\"\nrides = \"carriage\"\n");
    assert_eq!(by_default, curves(&stated));
    let (_dir, log) = drafted_of(&[("x.csv", "target,deviation\n0,1\n10,2\n")]);
    let unit = log.for_all(None, "unit", "default");
    assert!(!unit.is_empty());
    let refused = log.answered(&unit).expect_err("no default").to_string();
    assert!(refused.contains("one of mm, um"), "{refused}");
}
