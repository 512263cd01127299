//! Measurement files become a model.

use serde_json::{Value, json};
use volcomp_test_support::until;

use super::{
    Rig, activate, examples, measured_control, measured_rig_in, model, post, settled, upload,
};
use crate::{
    documents::validate,
    program::{Answer, PATIENCE, Program},
};

/// A file that cannot be read is named once, with its reason, and the error that is missing because of it; taken off the list it is
/// gone, and what was made of it, too.
#[test]
fn a_file_that_is_not_used_is_told_with_the_error_that_it_would_have_given() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let query = format!("kind=measurement&name=EYZ-Bericht.xlsx&candidate={id}");
    let sent = upload(&program, &query, b"PK rubbish");
    assert_eq!(sent.status, 200, "{}", sent.body);
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    let left_over = made["draft"]["left_over"][0].as_str().expect("told");
    assert_eq!(left_over.matches("Bericht").count(), 1, "{left_over}");
    assert!(
        left_over.ends_with("; it would have given EYZ"),
        "{left_over}"
    );
    // The unit of the level asks for more, which is answered as well.
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    answers(&program, &id, &all_answers(&more));
    let ready = settled(&program);
    let first = ready["result"]["warnings"][0].as_str().expect("told");
    assert!(
        first.starts_with(
            "EYZ is taken as 0, because its file was not used: files/EYZ-Bericht.xlsx: "
        ),
        "{ready}"
    );
    let off = |name: &str| {
        let body = json!({ "candidate": id, "name": name });
        post(&program, "take-off", &body).status
    };
    assert_eq!(off("../files/exx.csv"), 404);
    assert_eq!(off("EYZ-Bericht.xlsx"), 200);
    let now = settled(&program);
    assert_eq!(now["step"], "uploading", "{now}");
    assert!(now["draft"].is_null() && now["result"].is_null(), "{now}");
    assert_eq!(now["files"].as_array().expect("a list").len(), 5);
    let folder = rig.dir.path().join("audit/models/uploads").join(&id);
    assert!(!folder.join("files/EYZ-Bericht.xlsx").exists());
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    assert_eq!(made["draft"]["left_over"], json!([]), "{made}");
    for name in ["ebx.csv", "eyx.csv", "exy.csv", "ezx-level.csv"] {
        assert_eq!(off(name), 200);
        settled(&program);
    }
    assert_eq!(off("exx.csv"), 409, "the last one is discarded");
}

/// The example's measurement files to a model: looked through, asked, calibrated, in force. Meanwhile the cycle goes on.
#[test]
fn measurements_become_a_model_and_the_cycle_goes_on() {
    let rig = measured_rig();
    let program = rig.start();
    program.watch();
    let id = send_measurements(&program);
    // Not yet looked through.
    assert_eq!(answers(&program, &id, &[]).status, 409);
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let made = settled(&program);
    validate("gateway-model-candidate.json", &made);
    assert_eq!(made["step"], "asking", "{made}");
    // A wrong answer and a missing one are told by key.
    let asked = &made["draft"]["questions"];
    let first_point = asked
        .as_array()
        .expect("a list")
        .iter()
        .find(|of| of["key"] == "point");
    let of = first_point.expect("asked")["of"].as_str().expect("a text");
    answers(
        &program,
        &id,
        &[json!({ "of": of, "key": "point", "value": "1, 2" })],
    );
    let wrong = settled(&program);
    assert!(
        wrong["error"]
            .as_str()
            .expect("told")
            .contains("three numbers"),
        "{wrong}"
    );
    // What was refused is kept, to be mended.
    assert_eq!(wrong["draft"]["answers"][0]["value"], "1, 2", "{wrong}");
    answers(&program, &id, &[]);
    let open = settled(&program);
    assert!(
        open["error"]
            .as_str()
            .expect("told")
            .contains("open questions: leave none empty"),
        "{open}"
    );
    assert!(!open["error"].to_string().contains("toml"), "{open}");
    // The unit of the level says that it stood on a bridge, which is asked about then.
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    assert!(
        more["draft"]["questions"].to_string().contains("bridge_mm"),
        "{more}"
    );
    assert!(more["error"].is_string(), "{more}");
    assert_eq!(answers(&program, &id, &all_answers(&more)).status, 200);
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    validate("gateway-model-candidate.json", &made);
    the_cycle_goes_on(&program, &id, &all_answers(&more));
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    check_numbers(&made["result"]);
    let asked = activate(&program, &made, None);
    let taken = if asked.status == 409 {
        activate(&program, &made, Some(&asked.json()["model"]))
    } else {
        asked
    };
    assert_eq!(taken.status, 200, "{}", taken.body);
    let now = model(&program);
    assert_eq!(now["hash"], made["result"]["hash"]);
    assert_eq!(now["history"][0]["file"], "5 measurement files", "{now}");
}

/// The history counts the files that were used: what could not be read or was left out is no part of the model.
#[test]
fn the_history_counts_the_files_that_were_used() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let query = format!("kind=measurement&name=report.xlsx&candidate={id}");
    assert_eq!(upload(&program, &query, b"PK rubbish").status, 200);
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    let mut all = all_answers(&more);
    let place = |name: &str| {
        let measurements = more["draft"]["measurements"].as_array().expect("a list");
        let mut files = measurements.iter().map(|of| of["files"].to_string());
        files.position(|files| files.contains(name)).expect("there")
    };
    for name in ["ezx-level.csv", "ebx.csv"] {
        let of = place(name).to_string();
        all.push(json!({ "of": of, "key": "leave_out", "value": "true" }));
    }
    answers(&program, &id, &all);
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    assert_eq!(
        made["result"]["used"].as_array().expect("a list").len(),
        3,
        "{made}"
    );
    let asked = activate(&program, &made, None);
    let confirm = (asked.status == 409).then(|| asked.json()["model"].clone());
    if confirm.is_some() {
        let taken = activate(&program, &made, confirm.as_ref());
        assert_eq!(taken.status, 200, "{}", taken.body);
    }
    let now = model(&program);
    assert_eq!(now["history"][0]["file"], "3 measurement files", "{now}");
}

/// A wave that a curve of few terms follows, and a zigzag of 0.3 µm, ten times what the runs scatter, that only a table can: page Model warns of
/// the curve that was chosen, beside its numbers.
#[test]
fn a_curve_that_does_not_follow_its_readings_is_told_with_the_model() {
    let mut text = String::from("target,run,direction,deviation_um\n");
    for run in 1..=4 {
        for step in 0..=20 {
            let sign = |odd: i32| if odd % 2 == 0 { 1.0 } else { -1.0 };
            let wave = 50.0 * (std::f64::consts::TAU * f64::from(step) / 20.0).sin();
            let scatter = 0.02 * sign(run / 2 + step / 3) * sign(run);
            let read = wave + 0.3 * sign(step) + scatter;
            text += &[
                (step * 30).to_string(),
                run.to_string(),
                "+".to_owned(),
                read.to_string(),
            ]
            .join(",");
            text.push('\n');
        }
    }
    let rig = measured_rig();
    let program = rig.start();
    let sent = upload(&program, "kind=measurement&name=exx.csv", text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    let id = sent.json()["id"].as_str().expect("named").to_owned();
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let asked = settled(&program);
    assert_eq!(
        answers(&program, &id, &all_answers(&asked)).status,
        200,
        "{asked}"
    );
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    let told = made["result"]["warnings"].to_string();
    assert!(told.contains("EXX: the curve chosen"), "{told}");
}

/// Cycles go on while calibrations are under way, whose threads leave the processor to whoever wants it.
fn the_cycle_goes_on(program: &Program, id: &str, all: &[Value]) {
    let cycles = || {
        let count = program.state()["cycle"]["count"].as_u64();
        count.expect("counted")
    };
    let begun = cycles();
    // Beside the one that looks after the models, which is always there.
    let is_under_way = || nice_threads(program) > 1;
    let mut seen = false;
    until(
        "a calibration is under way, and cycles go on",
        PATIENCE,
        || {
            // One that is under way refuses the next.
            answers(program, id, all);
            seen |= is_under_way();
            seen && cycles() > begun + 150
        },
    );
}

/// How many threads of a gateway that work at models have stepped back.
fn nice_threads(program: &Program) -> usize {
    // Its place behind the name in `proc(5)`.
    const NICENESS: usize = 16;
    let tasks = format!("/proc/{}/task", program.running.id());
    let tasks = std::fs::read_dir(tasks).expect("it runs").flatten();
    let nicer = tasks.filter(|task| {
        // It may have ended.
        let text = std::fs::read_to_string(task.path().join("stat")).unwrap_or_default();
        let Some((name, values)) = text.rsplit_once(") ") else {
            return false;
        };
        let niceness = values.split(' ').nth(NICENESS);
        let niceness = niceness.and_then(|value| value.parse::<i32>().ok());
        name.ends_with("(volcomp-models") && niceness >= Some(15)
    });
    nicer.count()
}

pub(super) fn measured_rig() -> Rig {
    let dir = tempfile::tempdir().expect("writable");
    let control = measured_control();
    let config = measured_rig_in(dir.path(), &control);
    Rig {
        dir,
        control,
        config,
    }
}

pub(super) fn send_measurements(program: &Program) -> String {
    let mut id = String::new();
    for name in ["ebx.csv", "exx.csv", "eyx.csv", "exy.csv", "ezx-level.csv"] {
        let bytes = std::fs::read(examples().join(name)).expect("there");
        let at = if id.is_empty() {
            String::new()
        } else {
            format!("&candidate={id}")
        };
        let sent = upload(
            program,
            &format!("kind=measurement&name={name}{at}"),
            &bytes,
        );
        assert_eq!(sent.status, 200, "{}", sent.body);
        sent.json()["id"]
            .as_str()
            .expect("named")
            .clone_into(&mut id);
    }
    id
}

pub(super) fn answers(program: &Program, id: &str, all: &[Value]) -> Answer {
    post(
        program,
        "answers",
        &json!({ "candidate": id, "answers": all }),
    )
}

/// What the calibration file of the example says, as answers.
pub(super) fn all_answers(made: &Value) -> Vec<Value> {
    let questions = made["draft"]["questions"].as_array().expect("a list");
    let answer = |question: &Value| {
        let key = question["key"].as_str().expect("a text");
        let about = question["about"].as_str().expect("a text");
        let value = match key {
            "at.X" => "300",
            "at.Y" => "200",
            "at.Z" => "-300",
            "point" if about.contains("exx") => "0, 0, -350",
            "point" => "0, 0, -420",
            "rides" if about.contains("exx") => "carriage",
            "rides" => "other",
            "sign" if about.contains("ebx") || about.contains("ezx") => "-1",
            "sign" => "1",
            "bridge_mm" => "150",
            "reading" => "slope",
            "reference_angle_urad" => "2",
            "error" if about.contains("ebx") => "EBX",
            "error" if about.contains("exx") => "EXX",
            "error" if about.contains("eyx") => "EYX",
            "error" if about.contains("exy") => "EXY",
            "error" => "EZX",
            "unit" if about.contains("ebx") || about.contains("ezx") => "urad",
            "unit" => "um",
            other => panic!("{other} of {about}"),
        };
        json!({ "of": question["of"], "key": key, "value": value })
    };
    questions.iter().map(answer).collect()
}

/// The numbers of a result belong together: residuals are readings minus curve, a band lies around it.
fn check_numbers(result: &Value) {
    let list = |of: &Value| of.as_array().expect("a list").clone();
    let number = |of: &Value| of.as_f64().expect("a number");
    let fits = list(&result["fits"]);
    assert!(!fits.is_empty());
    for fit in &fits {
        let residuals = list(&fit["residuals"]);
        assert_eq!(residuals.len(), list(&fit["readings"]).len());
        let squares: f64 = residuals.iter().map(|of| number(&of[1]).powi(2)).sum();
        #[expect(clippy::cast_precision_loss, reason = "some tens")]
        let rms = (squares / residuals.len() as f64).sqrt();
        let told = number(&fit["residual_rms"]);
        assert!((rms - told).abs() < 1e-6, "{}: {rms}, {told}", fit["error"]);
        for (reading, residual) in list(&fit["readings"]).iter().zip(&residuals) {
            // Between the two curve points around it.
            let at = number(&reading[0]);
            let there = number(&reading[1]) - number(&residual[1]);
            let curve = list(&fit["fit"]);
            let near = |of: &&Value| (number(&of[0]) - at).abs();
            let near = curve
                .iter()
                .min_by(|a, b| near(a).total_cmp(&near(b)))
                .expect("a curve");
            let span = curve
                .iter()
                .map(|of| number(&of[1]).abs())
                .fold(1.0, f64::max);
            assert!(
                (number(&near[1]) - there).abs() < 0.25 * span,
                "{}",
                fit["error"]
            );
        }
        if let Some(band) = fit["band"].as_array() {
            for (of, curve) in band.iter().zip(list(&fit["fit"])) {
                assert!(number(&of[1]) <= number(&curve[1]) && number(&curve[1]) <= number(&of[2]));
            }
        }
    }
    assert_eq!(list(&result["diagonals"]).len(), 4);
}
