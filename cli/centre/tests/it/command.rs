//! The command line, without a server: what it prints, and its exit status.

use std::{
    io::{BufRead, BufReader},
    net::TcpListener,
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_centre::{
    rollout::{Phase, Rollout, Rules, Step},
    store::Store,
};

pub(crate) struct Called {
    pub(crate) status: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

pub(crate) fn call(folder: &Path, arguments: &str) -> Called {
    let output = Command::new(env!("CARGO_BIN_EXE_volcomp-centre"))
        .current_dir(folder)
        .args(["--by", "anna"])
        .args(arguments.split_whitespace())
        .output()
        .unwrap();
    Called {
        status: output.status.code().unwrap(),
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
    }
}

/// What a call prints that does what it is asked.
pub(crate) fn done(folder: &Path, arguments: &str) -> String {
    let called = call(folder, arguments);
    assert_eq!(called.status, 0, "{arguments}: {}", called.err);
    called.out
}

/// A configuration of a centre, whose server nobody asks.
fn configured(folder: &Path) {
    let text = "[nats]\nurl = \"nats://127.0.0.1:4222\"\n";
    std::fs::write(folder.join("centre.toml"), text).unwrap();
}

/// Has a call refused as a wrong one, with these words.
fn wrong(folder: &Path, arguments: &str, told: &str) {
    let called = call(folder, arguments);
    assert_eq!(
        called.status, 2,
        "{arguments}: {}{}",
        called.out, called.err
    );
    assert!(called.err.contains(told), "{arguments}: {}", called.err);
}

#[test]
fn from_nothing_to_a_roll_out() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let done = |arguments: &str| done(folder, arguments);
    let wrong = |arguments: &str, told: &str| wrong(folder, arguments, told);
    wrong("check", "centre.toml");
    configured(folder);
    wrong("check", "main.key");
    let public = done("key new main");
    assert!(done("key list").starts_with(public.trim_end()));
    wrong("key new main", "main.key: there already, kept");
    wrong("key new ../main", "expected letters");
    done("key nkey centre.nkey");
    wrong("key nkey centre.nkey", "centre.nkey: there already, kept");
    let gantry = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gantry.toml");
    let gantry = gantry.display();
    let add = format!("--site berlin --serial 4711 --like {gantry}");
    done(&format!(
        "machine add mill-1 {add} --new-nkey mill-1.nkey --canary"
    ));
    done(&format!("machine add mill-2 {add}"));
    wrong(&format!("machine add Mill {add}"), "lower-case");
    let listed = done("machine list");
    assert!(
        listed.contains("mill-1") && listed.contains("never heard"),
        "{listed}"
    );
    let checked = done("check");
    assert!(checked.contains("note: mill-2 has no nkey"), "{checked}");
    let server = done("nats-config");
    assert!(
        server.contains("volcomp.berlin.mill-1.condition"),
        "{server}"
    );
    assert!(!server.contains("mill-2"), "{server}");
    // What a seed is worth to others: nothing that is printed holds one.
    let seed = std::fs::read_to_string(folder.join("mill-1.nkey")).unwrap();
    assert!(!server.contains(seed.trim()));
    models_and_roll_outs(folder, &gantry.to_string());
}

fn models_and_roll_outs(folder: &Path, gantry: &str) {
    let done = |arguments: &str| done(folder, arguments);
    let wrong = |arguments: &str, told: &str| wrong(folder, arguments, told);
    let added = done(&format!("model add {gantry} --measured 2026-11-20"));
    let model = added
        .lines()
        .last()
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .to_owned();
    let short = &model[..8];
    wrong(
        &format!("model add {gantry} --measured yesterday"),
        "expected a day",
    );
    wrong(
        &format!("model add {gantry} --measured 2026-02-31"),
        "expected a day",
    );
    assert!(done("model list").contains("2026-11-20"));
    // The day of a model that is there is put right.
    let again = done(&format!("model add {gantry} --measured 2026-11-21"));
    assert!(
        again.contains("it was there already; measured on 2026-11-21"),
        "{again}"
    );
    assert!(done(&format!("model add {gantry}")).contains("(it was there already)"));
    let listed = done("model list");
    assert!(
        listed.contains("2026-11-21") && !listed.contains("2026-11-20"),
        "{listed}"
    );
    assert!(done("audit").contains("model.measured"));
    wrong(
        "rollout start --model 00 --machine mill-1",
        "expected the beginning of one checksum",
    );
    wrong(
        &format!("rollout start --model {short} --machine mill-9"),
        "found no machine",
    );
    // A model is measured on one machine: that all get it is said in so many words.
    wrong(
        &format!("rollout start --model {short} --all"),
        "found 2 machines with the structure and the axes",
    );
    let started = done(&format!("rollout start --model {short} --all --same-model"));
    assert!(started.contains("roll-out 1"), "{started}");
    assert!(started.contains("note: they get one model"), "{started}");
    wrong(
        &format!("rollout start --model {short} --machine mill-1"),
        "roll-out 1",
    );
    wrong("rollout keep 1 mill-1", "roll-out 1 goes on or is done");
    wrong("rollout keep 7 mill-1", "found no roll-out 7");
    wrong(
        "model back mill-1",
        "found no model that it has had in force before",
    );
    wrong("model back mill-7", "mill-7: found no model");
    let status = done("rollout status 1");
    assert!(
        status.contains("mill-1") && status.contains("waits for its wave"),
        "{status}"
    );
    done("rollout pause 1");
    wrong("rollout stop 2", "found no roll-out 2");
    let log = done("audit");
    assert!(
        log.contains("rollout.start") && log.contains("anna"),
        "{log}"
    );
    done("machine remove mill-2");
    wrong("machine remove mill-2", "found no machine");
    // A secret that others can read is none.
    let open = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(folder.join("keys/main.key"), open).unwrap();
    wrong("check", "expected 600");
}

/// A roll-out that has stopped, or is over, sends no confirmed change: before, the call said that it was taken up, and nothing
/// came of it.
#[test]
fn a_confirmation_that_would_come_to_nothing_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    configured(folder);
    done(folder, "key new main");
    done(folder, "key nkey centre.nkey");
    let store = Store::open(&folder.join("centre.db")).unwrap();
    let begin = |machine: &str, phase: Phase| {
        let machines = [(machine.parse().unwrap(), true)];
        let started = store.start_rollout(|id| {
            let mut rollout = Rollout::new(id, "ab", &machines, Rules::default(), "anna", 0.0);
            rollout.targets[0].step = Step::NeedsConfirmation {
                version: 1,
                hash: "abcd".into(),
                worst_um: "80.0".into(),
                worst_urad: String::new(),
            };
            rollout.phase = phase;
            rollout
        });
        started.unwrap().id
    };
    let why = "its residual has risen".to_owned();
    let stopped = begin("mill-1", Phase::Stopped { why });
    let ended = begin("mill-2", Phase::Aborted { by: "bert".into() });
    let running = begin("mill-3", Phase::Running);
    let refused = |id: u64, machine: &str, hash: &str, words: &str| {
        let called = call(folder, &format!("rollout confirm {id} {machine} {hash}"));
        assert_eq!(called.status, 1, "{}{}", called.out, called.err);
        assert!(called.err.contains(words), "{}", called.err);
    };
    refused(stopped, "mill-1", "abcd", "`rollout resume 1`");
    refused(ended, "mill-2", "abcd", "is over, and nothing more is sent");
    refused(
        running,
        "mill-1",
        "abcd",
        "mill-1 has no turn in roll-out 3",
    );
    refused(
        running,
        "mill-3",
        "abce",
        "found the hash abce, expected abcd",
    );
    assert!(
        done(folder, &format!("rollout confirm {running} mill-3 abcd")).contains("takes it up")
    );
    done(folder, &format!("rollout stop {running}"));
    refused(
        running,
        "mill-3",
        "abcd",
        "is over, and nothing more is sent",
    );
}

/// What there is nothing of, what was there before, and one of something.
#[test]
fn what_is_empty_or_there_already_is_told_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let done = |arguments: &str| done(folder, arguments);
    configured(folder);
    std::fs::write(folder.join("mill.toml"), crate::support::model_text(7)).unwrap();
    done("key new main");
    done("tls-init localhost");
    wrong(folder, "tls-init localhost", "key.pem: there already, kept");
    assert_eq!(done("rollout status"), "there is no roll-out yet\n");
    done("machine add mill-1 --site berlin --serial 1 --like mill.toml");
    let drift = done("model drift mill-1");
    let told = "mill-1 has had no model yet: there is nothing to compare\n";
    assert_eq!(drift, told);
    let model = done("model add mill.toml");
    let model = &model.lines().last().unwrap()[..8];
    let started = done(&format!("rollout start --model {model} --all"));
    assert!(started.contains("to 1 machine is started"), "{started}");
    // Times as dates, and one document for programs.
    let year = &volcomp_centre::clock::date(volcomp_centre::clock::now_s())[..5];
    let log = done("audit");
    assert!(log.contains(&format!("  {year}")), "{log}");
    let records: serde_json::Value = serde_json::from_str(&done("audit --json")).unwrap();
    assert_eq!(records[0]["action"], "rollout.start", "{records}");
}

/// docs/src/fleet.md: "**A stolen nkey:** run `machine remove`, or issue a new one (`machine add … --new-nkey`)". The machine stays disabled,
/// and unstated fields keep their values.
#[test]
fn a_machine_that_is_added_again_keeps_what_is_not_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let done = |arguments: &str| done(folder, arguments);
    configured(folder);
    done("key new main");
    let gantry = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/gantry.toml");
    let add = format!("machine add mill-1 --site berlin --serial 4711 --like {gantry}");
    done(&format!(
        "{add} --new-nkey one.nkey --due-days 365 --condition-s 10 --canary --note old --address 10.0.0.7"
    ));
    let noted = done("machine disable mill-1");
    assert!(noted.contains("it is noted"), "{noted}");
    let machine = || -> serde_json::Value {
        serde_json::from_str::<Vec<serde_json::Value>>(&done("machine list --json")).unwrap()[0]
            .take()
    };
    let before = machine();
    done(&format!("{add} --new-nkey two.nkey --note new"));
    let after = machine();
    assert_eq!(after["enable"], false, "a person had disabled it");
    assert_ne!(after["nkey"], before["nkey"]);
    assert_eq!(after["note"], "new");
    for key in ["due_days", "condition_s", "canary", "address", "serial"] {
        assert_eq!(after[key], before[key], "{key}");
    }
}

/// What the page refuses, the command line does, and a seed in place of the public nkey is not said again.
#[test]
fn a_machine_that_makes_no_sense_is_not_registered() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    configured(folder);
    done(folder, "key nkey centre.nkey");
    let gantry = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/gantry.toml");
    let add = format!("--site berlin --serial 4711 --like {gantry}");
    let seed = std::fs::read_to_string(folder.join("centre.nkey")).unwrap();
    let seed = seed.trim();
    let called = call(folder, &format!("machine add mill-3 {add} --nkey {seed}"));
    assert_eq!(called.status, 2, "{}", called.err);
    assert!(
        called.err.contains("nkey: found 58 characters"),
        "{}",
        called.err
    );
    assert!(!called.err.contains(seed), "{}", called.err);
    wrong(
        folder,
        &format!("machine add mill-3 {add} --condition-s 0"),
        "condition_s: found 0, expected 1 to 86400 s",
    );
}

/// A centre without a server says so once, with its address; a second one says whose place is taken.
#[test]
fn what_is_in_the_way_of_running_is_told_once_with_its_address() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Of two ports that are taken nobody answers on the first: it is closed again.
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let server = free.local_addr().unwrap();
    drop(free);
    let nats = format!("[nats]\nurl = \"nats://{server}\"\n");
    std::fs::write(folder.join("centre.toml"), &nats).unwrap();
    std::fs::write(folder.join("mill.toml"), crate::support::model_text(7)).unwrap();
    for arguments in [
        "key new main",
        "key nkey centre.nkey",
        "machine add mill-1 --site berlin --serial 1 --like mill.toml",
    ] {
        done(folder, arguments);
    }
    let mut running = Command::new(env!("CARGO_BIN_EXE_volcomp-centre"))
        .current_dir(folder)
        .arg("run")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(running.stderr.take().unwrap()).lines();
    let told = format!("the server is not reached: found nothing at nats://{server}");
    let first = lines.find(|line| line.as_ref().unwrap().contains(&told));
    std::thread::sleep(Duration::from_secs(3));
    running.kill().unwrap();
    running.wait().unwrap();
    let others: Vec<String> = lines.map(Result::unwrap).collect();
    assert!(first.is_some(), "{others:?}");
    let again = |line: &String| line.contains("not reached") || line.contains("IO error");
    assert!(!others.iter().any(again), "{others:?}");

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let page = taken.local_addr().unwrap();
    let config = format!("{nats}[page]\nlisten = \"{page}\"\n");
    std::fs::write(folder.join("centre.toml"), config).unwrap();
    let called = call(folder, "run");
    assert_eq!(called.status, 1, "{}", called.err);
    let told = format!("the page cannot be served on {page}: another program has it");
    assert!(called.err.contains(&told), "{}", called.err);
}

#[test]
fn two_models_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    configured(folder);
    let add = |squareness: u32| {
        let file = format!("{squareness}.toml");
        std::fs::write(folder.join(&file), crate::support::model_text(squareness)).unwrap();
        let said = done(folder, &format!("model add {file}"));
        said.lines().last().unwrap()[..12].to_owned()
    };
    let (one, other) = (add(7), add(9));
    let diff = done(folder, &format!("model diff {one} {other}"));
    // Before it stands the checksum of each.
    assert_eq!(diff.lines().count(), 4, "{diff}");
    assert!(diff.ends_with("\n- EC0Y = 7.0\n+ EC0Y = 9.0\n"), "{diff}");
}

/// A model leaves the centre byte by byte as it came, and no file is replaced by it.
#[test]
fn a_model_is_shown_and_downloaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    configured(path);
    let text = format!("# as measured\n{}", crate::support::model_text(20));
    std::fs::write(path.join("m.toml"), &text).unwrap();
    let added = done(path, "model add m.toml --measured 2026-11-25");
    let sha256 = added.lines().last().unwrap().split(' ').next().unwrap();
    let shown = done(path, &format!("model show {}", &sha256[..6]));
    for part in [
        sha256,
        "w X' b Y Z t",
        "X Y Z",
        "2026-11-25",
        "m.toml",
        "anna",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let said = done(path, &format!("model download {sha256} -o out.toml"));
    assert!(said.contains(sha256), "{said}");
    assert_eq!(
        std::fs::read_to_string(path.join("out.toml")).unwrap(),
        text
    );
    wrong(
        path,
        &format!("model download {sha256} -o m.toml"),
        "m.toml: is there already",
    );
    assert_eq!(std::fs::read_to_string(path.join("m.toml")).unwrap(), text);
}

/// The first hour of the book names the model of the example by the beginning of its checksum.
#[test]
fn the_first_hour_names_the_model_of_the_example() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let root = volcomp_test_support::root();
    configured(path);
    let file = root.join("examples/calibration/calibration.toml");
    let file = CalibrationFile::read(&file).unwrap();
    let machine = calibrate(&file, |_, _| {}).unwrap().machine;
    std::fs::write(path.join("mill-600.toml"), machine.to_toml()).unwrap();
    let added = done(path, "model add mill-600.toml");
    let sha256 = added.lines().last().unwrap();
    let book = std::fs::read_to_string(root.join("docs/src/fleet.md")).unwrap();
    for named in [
        format!("{}... mill-600", &sha256[..12]),
        format!("rollout start --model {} --machine mill-1", &sha256[..4]),
    ] {
        assert!(book.contains(&named), "{named}");
    }
}
