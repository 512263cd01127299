//! The whole fleet: the centre's own program and command line, a real server, and gateways on simulated machines.

use std::time::Duration;

use serde_json::Value;
use volcomp_vocabulary::PerChannel;

use crate::{
    fleet_bench::{compensating, corrects_y, goes_on, wait},
    fleet_whole_bench::{LONG, Place, Whole, machine_text},
    hung_disk::preloaded,
    manual::{no_step, says},
    program::{Client, MACHINE},
};

/// The command line of the centre rolls a model out, which reaches the axes on a ramp. A large change waits for
/// confirmation by the operator. The machine is disabled and enabled, and the page shows the reported state.
#[test]
fn a_model_goes_from_the_centre_to_the_axes() {
    let Some(whole) = Whole::start(&[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    corrects_y(&program, -20.0);
    let received = whole.machine_is("it reports", "mill-1", |one| {
        one["live"]["condition"]["state"] == "compensating"
    });
    // The centre has the axes in the gateway's order.
    let state = program.state();
    assert_eq!(received["axes"], state["machine"]["axes"], "{received}");
    assert_eq!(received["structure"], state["machine"]["structure"], "{received}");

    let model = machine_text("small", 25.0);
    let rollout = whole.roll_out(&model, &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -25.0);
    let one = whole.machine_is("its answer is stored", "mill-1", |one| {
        one["version"]["outcome"]["outcome"] == "activated"
    });
    assert_eq!(one["version"]["version"], 1);
    let one = whole.machine_is("it reports its model", "mill-1", |one| {
        one["live"]["version"] == 1 && one["live"]["condition"]["correction_um"]["Y"] == -25.0
    });
    // The centre and the gateway identify the model by the same checksum.
    let models = whole.document("model list --json");
    assert_eq!(models[0]["checksum"], one["live"]["model"], "{models}");

    let rollout = whole.roll_out(&machine_text("small", 100.0), &["mill-1"]);
    let ask = format!("rollout status {rollout} --json");
    let asks = whole.wait("a confirmation is requested", &ask, |document| {
        document[0]["turns"][0]["step"] == "needs-confirmation"
    });
    let turn = &asks[0]["turns"][0];
    assert_eq!(turn["worst_um"], "75.0");
    let hash = turn["hash"].as_str().expect("a hash");
    let status = whole.done(&format!("rollout status {rollout}"));
    assert!(status.contains(hash) && status.contains("75.0 µm"), "{status}");
    whole.wait("an alarm reports it", "alarms --json", |alarms| {
        alarms.to_string().contains("needs-confirmation")
    });
    corrects_y(&program, -25.0);
    whole.done(&format!("rollout confirm {rollout} mill-1 {hash}"));
    whole.is_in(rollout, "done");
    corrects_y(&program, -100.0);

    whole.done("machine disable mill-1");
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    wait(&program, "it is ramped out", |_| program.gateway().shifts() == PerChannel::ZERO);
    whole.machine_is("the centre hears it", "mill-1", |one| {
        one["enable"] == false && one["live"]["condition"]["state"] == "disarmed"
    });
    whole.done("machine enable mill-1");
    program.wait_for("compensating");
    corrects_y(&program, -100.0);
    page_shows(&whole, &program);
    no_step(&program.stop());
    let log = whole.done("audit");
    assert!(log.contains("rollout.start") && log.contains("anna"), "{log}");
}

/// The page shows the reports of a gateway: its condition, its full state, its audit records, and its versions.
fn page_shows(whole: &Whole, program: &Client) {
    let cookie = whole.log_in();
    whole.machine_is("it runs what it shall", "mill-1", |one| {
        one["live"]["version"] == one["version"]["version"]
            && one["live"]["condition"]["state"] == "compensating"
    });
    let mut page = Value::Null;
    volcomp_test_support::until("the page shows it", LONG, || {
        page = whole.page(&cookie, "/api/machines/mill-1");
        page["telemetry"]["state"]["fleet"]["version"] == program.state()["fleet"]["version"]
            && page["silent"] == false
    });
    let own = program.state();
    let telemetry = &page["telemetry"]["state"];
    assert_eq!(telemetry["machine"], own["machine"], "{page}");
    let named = |record: &Value, what: &str| record["record"]["body"].to_string().contains(what);
    let records = page["records"].as_array().expect("a list");
    for what in ["reload", "disabled by the centre", "compensating"] {
        let found = records.iter().any(|record| named(record, what));
        assert!(found, "no record of {what}: {records:?}");
    }
    volcomp_test_support::until("the overview shows it", LONG, || {
        whole.page(&cookie, "/api/overview")["machines"][0]["state"] == "compensating"
    });
    let history = whole.page(&cookie, "/api/machines/mill-1/history?resolution=raw&hours=1");
    let points = history["points"].as_array().expect("a list");
    let corrected = |um: f64| points.iter().any(|point| point["correction_um"]["Y"] == um);
    assert!(corrected(-25.0) && corrected(-100.0), "{history}");
}

/// A fault of the guard raises an alarm with its reason. A gateway that has ended raises an alarm for its silence.
#[test]
fn faults_and_silence_raise_alarms() {
    let Some(whole) = Whole::start(&[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let faulted = program.gateway().fault();
    let reason = faulted["reasons"][0].as_str().expect("a reason");
    let has = |alarms: &Value, kind: &str, words: &str| {
        let mut alarms = alarms.as_array().expect("a list").iter();
        alarms.any(|alarm| {
            alarm["machine"] == "mill-1"
                && alarm["kind"] == kind
                && alarm["text"].as_str().is_some_and(|text| text.contains(words))
        })
    };
    whole.wait("the fault is reported", "alarms --json", |alarms| has(alarms, "faulted", reason));
    let cookie = whole.log_in();
    assert!(has(&whole.page(&cookie, "/api/alarms"), "faulted", reason));
    program.stop();
    whole.wait("the silence is reported", "alarms --json", |alarms| {
        has(alarms, "silent", "No condition is received")
    });
    let said = whole.done("alarms");
    assert!(said.contains("mill-1: silent"), "{said}");
}

#[test]
fn the_wrong_machine_is_refused_with_the_reason() {
    // The file orders its axes differently from the gateway's X, Y, Z.
    let swapped = |eyx_um| {
        let text = machine_text("other", eyx_um);
        let x = "[axes.X]\ntravel = [0.0, 800.0]\n";
        let y = "[axes.Y]\ntravel = [0.0, 400.0]\n";
        text.replace(&format!("{x}{y}"), &format!("{y}{x}")).replace("w X' b Y Z t", "w Y b X Z t")
    };
    let with_c = |eyx_um| {
        let text = machine_text("turns", eyx_um);
        text.replace("w X' b Y Z t", "w C' X' b Y Z t")
            .replace("[errors]\n", "[axes.C]\ntravel = [0.0, 360.0]\n[errors]\n")
    };
    let (order, names) = (swapped(20.0), with_c(20.0));
    let machines = [
        ("serial", "4712", MACHINE),
        ("order", "4711", order.as_str()),
        ("names", "4711", names.as_str()),
    ];
    let Some(whole) = Whole::start(&machines) else {
        return;
    };
    for (name, model, words) in [
        (
            "serial",
            machine_text("small", 25.0),
            r#"meant for the serial number "4712", this machine has "4711""#,
        ),
        ("order", swapped(25.0), "meant for the axes [Y, X, Z], this machine has [X, Y, Z]"),
        ("names", with_c(25.0), "meant for the axes [C, X, Y, Z], this machine has [X, Y, Z]"),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let config = whole.member(dir.path(), (name, "4711"));
        let program = compensating(&config);
        corrects_y(&program, -20.0);
        let rollout = whole.roll_out(&model, &[name]);
        let stopped = whole.is_in(rollout, "stopped");
        let why = stopped["phase"]["why"].as_str().expect("a text");
        assert!(why.contains(name) && why.contains(words), "{why}");
        // The status, the alarms and the machine's audit log state the reason.
        let status = whole.done(&format!("rollout status {rollout}"));
        assert!(status.contains(words), "{status}");
        whole.wait("an alarm reports it", "alarms --json", |alarms| {
            let mut alarms = alarms.as_array().expect("a list").iter();
            alarms.any(|alarm| {
                alarm["kind"] == "refused"
                    && alarm["machine"] == name
                    && alarm["text"].as_str().is_some_and(|text| text.contains(words))
            })
        });
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        let words = words.replace('"', "\\\"");
        assert!(audit.contains(&words), "{words} in {audit}");
        corrects_y(&program, -20.0);
        assert_eq!(program.gateway().shifts()[1], -0.020);
    }
    // A model that does not match the registered machine is not sent.
    let short = whole.add_model(&machine_text("small", 30.0));
    for (name, words) in [("order", "the structure"), ("names", "the structure")] {
        let refused = whole.call(&format!("rollout start --model {short} --machine {name}"));
        assert_eq!(refused.status, Some(2), "{}", refused.err);
        assert!(refused.err.contains(words) && refused.err.contains(name), "{}", refused.err);
    }
}

/// The disk of the centre's database hangs during a roll-out. Machines continue to correct, and the page reports the
/// disk. Afterwards the roll-out resumes, and no message is lost.
#[test]
fn a_hanging_disk_of_the_centre_delays_no_machine() {
    let at = tempfile::tempdir().expect("writable");
    let Some(library) = preloaded(at.path()) else {
        return;
    };
    let hangs = at.path().join("hangs");
    let mut place = Place::default();
    place.environment = vec![("LD_PRELOAD", library), ("HANGS", hangs.clone())];
    let Some(whole) = Whole::start_at(place, &[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let rollout = whole.roll_out(&machine_text("small", 22.0), &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -22.0);
    let cookie = whole.log_in();
    let short = whole.add_model(&machine_text("small", 25.0));
    std::fs::write(&hangs, "").expect("writable");
    let waits = |overview: &Value| {
        let mut alarms = overview["centre"].as_array().expect("a list").iter();
        alarms.any(|alarm| {
            alarm["text"].as_str().is_some_and(|text| text.contains("has not completed a change"))
        })
    };
    volcomp_test_support::until("its page reports it", LONG, || {
        waits(&whole.page(&cookie, "/api/overview"))
    });
    let before = program.state();
    let count = |state: &Value| state["cycle"]["count"].as_u64().expect("a count");
    wait(&program, "it is corrected on", |state| {
        goes_on(state, -22.0);
        count(state) > count(&before) + 1000
    });
    assert_eq!(program.state()["fleet"]["waiting"], Value::Null);
    std::fs::remove_file(&hangs).expect("ours");
    whole.done(&format!("rollout start --model {short} --machine mill-1"));
    whole.is_in(rollout + 1, "done");
    corrects_y(&program, -25.0);
    volcomp_test_support::until("its page reports the end", LONG, || {
        !waits(&whole.page(&cookie, "/api/overview"))
    });
    let one = whole.machine("mill-1");
    assert_eq!(one["live"]["lost"], 0, "{one}");
    no_step(&program.stop());
}

/// The centre is killed between the first and the second machine of a roll-out. After its restart each machine gets its
/// version once.
#[test]
fn a_killed_centre_resumes_its_roll_out() {
    let names = ["mill-1", "mill-2"];
    let Some(mut whole) = Whole::start(&names.map(|name| (name, "4711", MACHINE))) else {
        return;
    };
    let folders = names.map(|_| tempfile::tempdir().expect("writable"));
    let mut programs = Vec::new();
    for (name, dir) in names.iter().zip(&folders) {
        let config = whole.member(dir.path(), (name, "4711"));
        programs.push(compensating(&config));
    }
    for name in names {
        whole.machine_is("it reports", name, |one| {
            one["live"]["condition"]["state"] == "compensating"
        });
    }
    let short = whole.add_model(&machine_text("small", 25.0));
    // The soak time is long enough for a kill in between, even on a slow computer.
    whole.done(&format!(
        "rollout start --model {short} --machine mill-1 --machine mill-2 --soak-s 15"
    ));
    wait(&programs[0], "the first has it", |state| state["fleet"]["version"] == 1);
    whole.kill();
    let status = whole.document("rollout status 1 --json");
    assert_eq!(status[0]["phase"]["is"], "running", "{status}");
    assert_eq!(programs[1].state()["fleet"]["version"], 0);
    // Machines continue, and their messages wait at the server.
    std::thread::sleep(Duration::from_secs(3));
    corrects_y(&programs[0], -25.0);
    corrects_y(&programs[1], -20.0);
    whole.run();
    whole.is_in(1, "done");
    for (name, program) in names.iter().zip(&programs) {
        corrects_y(program, -25.0);
        let one = whole.machine_is("its answer is stored", name, |one| {
            one["version"]["outcome"]["outcome"] == "activated"
        });
        assert_eq!(one["version"]["version"], 1, "once: {one}");
        assert_eq!(one["live"]["lost"], 0, "{one}");
        assert_eq!(whole.machine(name)["live"]["version"], 1);
    }
    // Each machine has activated the version once.
    for dir in &folders {
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        assert_eq!(audit.matches("\"what\":\"reload\"").count(), 1, "{audit}");
    }
}
