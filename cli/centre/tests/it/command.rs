//! Tests of the commands and the configuration without a server: output and exit status.

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
    config::Config,
    rollout::{Phase, Rollout, Rules, Step},
    store::{Retention, Store},
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

pub(crate) fn done(folder: &Path, arguments: &str) -> String {
    let called = call(folder, arguments);
    assert_eq!(called.status, 0, "{arguments}: {}", called.err);
    called.out
}

/// Writes a configuration whose server is never contacted.
fn configured(folder: &Path) {
    let text = "[nats]\nurl = \"nats://127.0.0.1:4300\"\n";
    std::fs::write(folder.join("centre.toml"), text).unwrap();
}

fn wrong(folder: &Path, arguments: &str, reported: &str) {
    let called = call(folder, arguments);
    assert_eq!(called.status, 2, "{arguments}: {}{}", called.out, called.err);
    assert!(called.err.contains(reported), "{arguments}: {}", called.err);
}

#[test]
fn keys_machines_models_and_a_rollout_by_command() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let done = |arguments: &str| done(folder, arguments);
    let wrong = |arguments: &str, reported: &str| wrong(folder, arguments, reported);
    wrong("check", "centre.toml");
    configured(folder);
    wrong("check", "main.key");
    let public = done("key new main");
    assert!(done("key list").starts_with(public.trim_end()));
    wrong("key new main", "main.key: exists and is not replaced");
    wrong("key new ../main", "expected letters");
    done("key nkey centre.nkey");
    wrong("key nkey centre.nkey", "centre.nkey: exists and is not replaced");
    let gantry = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/gantry.toml");
    let gantry = gantry.display();
    let add = format!("--site berlin --serial 4711 --like {gantry}");
    done(&format!("machine add mill-1 {add} --new-nkey mill-1.nkey --canary"));
    done(&format!("machine add mill-2 {add}"));
    wrong(&format!("machine add Mill {add}"), "lower-case");
    let listed = done("machine list");
    assert!(listed.contains("mill-1") && listed.contains("never connected"), "{listed}");
    let checked = done("check");
    assert!(checked.contains("note: mill-2 has no nkey"), "{checked}");
    let server = done("nats-config");
    for part in ["listen: \"127.0.0.1:4300\"", "volcomp.berlin.mill-1.condition"] {
        assert!(server.contains(part), "{part}: {server}");
    }
    assert!(!server.contains("mill-2"), "{server}");
    // The output must not contain a seed.
    let seed = std::fs::read_to_string(folder.join("mill-1.nkey")).unwrap();
    assert!(!server.contains(seed.trim()));
    models_and_roll_outs(folder, &gantry.to_string());
}

fn models_and_roll_outs(folder: &Path, gantry: &str) {
    let done = |arguments: &str| done(folder, arguments);
    let wrong = |arguments: &str, reported: &str| wrong(folder, arguments, reported);
    let added = done(&format!("model add {gantry} --measured 2026-11-20"));
    let model = added.lines().last().unwrap().split(' ').next().unwrap().to_owned();
    let short = &model[..8];
    wrong(&format!("model add {gantry} --measured yesterday"), "expected a day");
    wrong(&format!("model add {gantry} --measured 2026-02-31"), "expected a day");
    assert!(done("model list").contains("2026-11-20"));
    let again = done(&format!("model add {gantry} --measured 2026-11-21"));
    assert!(again.contains("already stored; measured on 2026-11-21"), "{again}");
    assert!(done(&format!("model add {gantry}")).contains("(already stored)"));
    let listed = done("model list");
    assert!(listed.contains("2026-11-21") && !listed.contains("2026-11-20"), "{listed}");
    assert!(done("audit").contains("model.measured"));
    wrong("rollout start --model 00 --machine mill-1", "expected the beginning of one checksum");
    wrong(&format!("rollout start --model {short} --machine mill-9"), "found no machine");
    // A model is measured on one machine, so rolling it out to several needs an explicit confirmation.
    wrong(
        &format!("rollout start --model {short} --all"),
        "found 2 machines with the structure and the axes",
    );
    let started = done(&format!("rollout start --model {short} --all --same-model"));
    assert!(started.contains("roll-out 1"), "{started}");
    assert!(started.contains("note: all receive the same model"), "{started}");
    wrong(&format!("rollout start --model {short} --machine mill-1"), "roll-out 1");
    wrong("rollout keep 1 mill-1", "roll-out 1 is running or done");
    wrong("rollout keep 7 mill-1", "found no roll-out 7");
    wrong("model back mill-1", "found no model that was active before");
    wrong("model back mill-7", "mill-7: found no model");
    let status = done("rollout status 1");
    assert!(status.contains("mill-1") && status.contains("waits for its wave"), "{status}");
    done("rollout pause 1");
    wrong("rollout stop 2", "found no roll-out 2");
    let log = done("audit");
    assert!(log.contains("rollout.start") && log.contains("anna"), "{log}");
    done("machine remove mill-2");
    wrong("machine remove mill-2", "found no machine");
    // A secret file that other users can read is rejected.
    let open = std::fs::Permissions::from_mode(0o644);
    std::fs::set_permissions(folder.join("keys/main.key"), open).unwrap();
    wrong("check", "expected 600");
}

/// `rollout confirm` is rejected for a stopped or finished roll-out, because it would send no change.
#[test]
fn a_confirmation_without_effect_is_rejected() {
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
                differences: Vec::new(),
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
    refused(ended, "mill-2", "abcd", "is over and sends nothing");
    refused(running, "mill-1", "abcd", "mill-1 is not a machine of roll-out 3");
    refused(running, "mill-3", "abce", "found the hash abce, expected abcd");
    assert!(done(folder, &format!("rollout confirm {running} mill-3 abcd")).contains("applies it"));
    done(folder, &format!("rollout stop {running}"));
    refused(running, "mill-3", "abcd", "is over and sends nothing");
}

#[test]
fn empty_lists_and_existing_files_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let done = |arguments: &str| done(folder, arguments);
    configured(folder);
    std::fs::write(folder.join("mill.toml"), crate::support::model_text(7)).unwrap();
    done("key new main");
    done("tls-init localhost");
    wrong(folder, "tls-init localhost", "key.pem: exists and is not replaced");
    assert_eq!(done("rollout status"), "there is no roll-out yet\n");
    done("machine add mill-1 --site berlin --serial 1 --like mill.toml");
    let drift = done("model drift mill-1");
    let reported = "mill-1 has had no model yet\n";
    assert_eq!(drift, reported);
    let model = done("model add mill.toml");
    let model = &model.lines().last().unwrap()[..8];
    let started = done(&format!("rollout start --model {model} --all"));
    assert!(started.contains("to 1 machine is started"), "{started}");
    // The text output has dates; the JSON is one document.
    let year = &volcomp_centre::clock::date(volcomp_centre::clock::now_s())[..5];
    let log = done("audit");
    assert!(log.contains(&format!("  {year}")), "{log}");
    let records: serde_json::Value = serde_json::from_str(&done("audit --json")).unwrap();
    assert_eq!(records[0]["action"], "rollout.start", "{records}");
}

/// docs/src/fleet.md, "A stolen nkey": `machine add … --new-nkey` issues a new nkey. The machine stays disabled, and
/// fields without an option keep their values.
#[test]
fn adding_a_machine_again_keeps_unstated_fields() {
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
    assert!(noted.contains("recorded: mill-1 must not be corrected"), "{noted}");
    let machine = || -> serde_json::Value {
        serde_json::from_str::<Vec<serde_json::Value>>(&done("machine list --json")).unwrap()[0]
            .take()
    };
    let before = machine();
    done(&format!("{add} --new-nkey two.nkey --note new"));
    let after = machine();
    assert_eq!(after["enable"], false, "the user had disabled it");
    assert_ne!(after["nkey"], before["nkey"]);
    assert_eq!(after["note"], "new");
    for key in ["due_days", "condition_s", "canary", "address", "serial"] {
        assert_eq!(after[key], before[key], "{key}");
    }
}

/// The command line rejects the same records as the web interface. A seed given instead of a public nkey is not
/// printed.
#[test]
fn invalid_machines_are_rejected_without_showing_a_seed() {
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
    assert!(called.err.contains("nkey: found 58 characters"), "{}", called.err);
    assert!(!called.err.contains(seed), "{}", called.err);
    wrong(
        folder,
        &format!("machine add mill-3 {add} --condition-s 0"),
        "condition_s: found 0, expected 1 to 86400 s",
    );
}

#[test]
fn an_unreachable_server_and_a_used_port_are_reported_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Nothing listens there, so connections are refused.
    let server = volcomp_test_support::free_address();
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
    let reported = format!("the NATS server cannot be reached: found none at nats://{server}");
    let first = lines.find(|line| line.as_ref().unwrap().contains(&reported));
    std::thread::sleep(Duration::from_secs(3));
    // With two centres the soak time of a roll-out would elapse twice as fast.
    wrong(folder, "run", "centre.db: another centre runs with this database");
    running.kill().unwrap();
    running.wait().unwrap();
    let others: Vec<String> = lines.map(Result::unwrap).collect();
    assert!(first.is_some(), "{others:?}");
    let again = |line: &String| line.contains("cannot be reached") || line.contains("IO error");
    assert!(!others.iter().any(again), "{others:?}");

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let page = taken.local_addr().unwrap();
    let config = format!("{nats}[page]\nlisten = \"{page}\"\n");
    std::fs::write(folder.join("centre.toml"), config).unwrap();
    let called = call(folder, "run");
    assert_eq!(called.status, 1, "{}", called.err);
    let reported = format!("the web interface cannot listen on {page}: another program uses it");
    assert!(called.err.contains(&reported), "{}", called.err);
}

#[test]
fn model_diff_prints_the_changed_lines() {
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
    assert_eq!(diff.lines().count(), 4, "{diff}");
    assert!(diff.ends_with("\n- EC0Y = 7.0\n+ EC0Y = 9.0\n"), "{diff}");
}

/// A downloaded model equals the added file; an existing file is not replaced.
#[test]
fn model_show_and_model_download() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    configured(path);
    let text = format!("# as measured\n{}", crate::support::model_text(20));
    std::fs::write(path.join("m.toml"), &text).unwrap();
    let added = done(path, "model add m.toml --measured 2026-11-25");
    let sha256 = added.lines().last().unwrap().split(' ').next().unwrap();
    let shown = done(path, &format!("model show {}", &sha256[..6]));
    for part in [sha256, "w X' b Y Z t", "X Y Z", "2026-11-25", "m.toml", "anna"] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let said = done(path, &format!("model download {sha256} -o out.toml"));
    assert!(said.contains(sha256), "{said}");
    assert_eq!(std::fs::read_to_string(path.join("out.toml")).unwrap(), text);
    wrong(path, &format!("model download {sha256} -o m.toml"), "m.toml: exists");
    assert_eq!(std::fs::read_to_string(path.join("m.toml")).unwrap(), text);
}

#[test]
fn the_book_quotes_the_checksum_of_the_example_model() {
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

fn read(text: &str) -> Result<Config, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("centre.toml");
    std::fs::write(&file, text).unwrap();
    let strip = |text: String| text.replace(&format!("{}/", folder.path().display()), "");
    Config::read(&file).map_err(|e| strip(e.to_string()))
}

fn book_example() -> String {
    let book = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/fleet.md");
    let book = std::fs::read_to_string(book).unwrap();
    let blocks = book.split("```toml\n").skip(1);
    let mut blocks = blocks.map(|block| block.split("```").next().unwrap());
    let block = blocks.find(|block| block.starts_with("# centre file"));
    block.unwrap().to_owned()
}

#[test]
fn the_book_shows_every_key_with_its_default() {
    let shown = read(&book_example()).unwrap();
    let bare = read("[nats]\nurl = \"nats://127.0.0.1:4222\"\n").unwrap();
    assert_eq!(shown.keep, Retention::default());
    assert_eq!(shown.keep, bare.keep);
    assert_eq!(shown.rollout, Rules::default());
    assert_eq!(shown.rollout, bare.rollout);
    assert_eq!(shown.nats.stream_retention(), bare.nats.stream_retention());
    assert_eq!(shown.nats.url, bare.nats.url);
    assert_eq!(shown.keys.sign_with, bare.keys.sign_with);
    assert!(shown.store.file.ends_with("centre.db"));
    assert_eq!(shown.store.file.file_name(), bare.store.file.file_name());
    // The book lists every key that the program accepts.
    for table in ["nats", "store", "keep", "keys", "rollout", "server"] {
        let text = format!("[nats]\nurl = \"nats://a:1\"\n[{table}]\n")
            .replace("[nats]\nurl = \"nats://a:1\"\n[nats]\n", "[nats]\nurl = \"nats://a:1\"\n");
        let reported = read(&format!("{text}zzzzzzzz = 1\n")).unwrap_err();
        let expected = reported.split("expected").nth(1).unwrap();
        let block = book_example();
        let section = block.split(&format!("[{table}]")).nth(1).unwrap();
        let section = section.split("\n[").next().unwrap();
        for key in expected.split(|c: char| !c.is_ascii_lowercase() && c != '_') {
            if key.len() > 1 && key != "one" && key != "of" && key != "or" && key != "and" {
                assert!(section.contains(key), "{table}.{key}: {reported}");
            }
        }
    }
}

#[test]
fn the_nats_server_listens_on_the_port_of_the_url() {
    for (url, server, listen) in [
        ("nats://127.0.0.1:4300", "", "127.0.0.1:4300"),
        ("tls://a:4300,tls://b:4301", "", "127.0.0.1:4300"),
        ("nats://127.0.0.1", "", "127.0.0.1:4222"),
        // A stated address is kept: behind a proxy the port differs.
        ("tls://a:443", "listen = \"0.0.0.0:4222\"", "0.0.0.0:4222"),
    ] {
        let config = read(&format!("[nats]\nurl = {url:?}\n[server]\n{server}\n"));
        assert_eq!(config.unwrap().server_listen(), listen, "{url}");
    }
}

#[test]
fn configuration_errors_name_line_and_key() {
    let nats = "[nats]\nurl = \"nats://a:1\"\n";
    for (text, reported) in [
        ("", "centre.toml"),
        (
            "[nats]\nreplicas = 2\nurl = \"nats://a:1\"\n",
            "centre.toml:2: nats.replicas: found 2, expected 1, 3 or 5",
        ),
        (
            "[nats]\nurl = \"nats://a:1,http://b\"\n",
            "centre.toml:2: nats.url: found \"http://b\", expected nats://HOST:PORT or tls://HOST:PORT",
        ),
        (
            "[rollout]\nwaves = [50, 20]\n[nats]\nurl = \"nats://a:1\"\n",
            "centre.toml:2: rollout.waves: found [50, 20], expected percentages from 1, ascending to 100",
        ),
        ("[rollout]\nwaves = [50]\n[nats]\nurl = \"nats://a:1\"\n", "ascending to 100"),
        (
            "[server]\nkey = \"a\"\n[nats]\nurl = \"nats://a:1\"\n",
            "certificate and key, expected both or neither",
        ),
        (
            "[store]\npostgres = \"host=a\"\n[nats]\nurl = \"nats://a:1\"\n",
            "centre.toml:2: store.postgres: PostgreSQL is not supported any more, expected `file`, a SQLite file",
        ),
        ("[server]\ncluster = \"a\"\n[nats]\nurl = \"nats://a:1\"\n", "cluster_listen"),
    ] {
        let found = read(text).unwrap_err();
        assert!(found.contains(reported), "{text}: {found}");
    }
    assert!(read(nats).is_ok());
}
