//! The page in a headless Chromium, driven by Playwright, with three and with a thousand machines.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use volcomp_centre::{
    clock::now_s,
    models::NewModel,
    records::{Live, Machine, Origin},
    rollout::{Phase, Rollout, Rules, Step},
    users::Role,
};
use volcomp_fleet::Condition;
use volcomp_test_support::peers;

use crate::support::{PASSWORD, Page};

pub(crate) fn run(script: &str, arguments: &[&str]) {
    if !Path::new("/usr/bin/chromium").exists() {
        peers::not_run("Chromium");
        return;
    }
    let Some(python) = peers::python() else {
        return;
    };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut browser = Command::new(python)
        .arg(here.join("tests/it").join(script))
        .args(arguments)
        .arg(here.join("../../target"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("Python");
    let mut said = String::new();
    for line in BufReader::new(browser.stdout.take().expect("piped")).lines() {
        said = line.expect("text");
    }
    let output = browser.wait_with_output().expect("ours");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said == "done", "{said}: {message}");
}

const MODEL: &str = "name = \"mill <script>document.title='hit'</script>\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 600.0]\n[axes.Z]\ntravel = [-500.0, 0.0]\n[errors]\nEXX = { poly = [0.0, 0.03] }\nEC0Y = 15.0\n";

/// A machine and its state, with texts that would run as scripts if the page inserted them unescaped.
fn reported(page: &Page, number: usize, silent: bool) -> (Machine, Live) {
    let name = format!("mill-{number}");
    let hostile = "<img src=x onerror=\"document.title='hit'\">".to_owned();
    let machine: Machine = serde_json::from_value(serde_json::json!({
        "machine": name, "site": format!("hall-{}", number % 7), "serial": "4711",
        "structure": "w X' b Y Z t", "axes": ["X", "Y", "Z"], "enable": true, "note": hostile, "control": hostile,
        "due_days": 30,
        // No other machine becomes silent on a slow computer.
        "condition_s": if silent { 1 } else { 86_400 },
    }))
    .expect("a machine");
    page.store.put_machine(&machine, "test").expect("stored");
    let states = ["compensating", "compensating", "holding", "disarmed", "faulted"];
    let condition: Condition = serde_json::from_value(serde_json::json!({
        "state": states[number % 5], "reasons": if number % 5 == 4 { vec![hostile] } else { Vec::new() }, "armed": true,
        "correction_um": { "X": 12.5 + number as f64 / 10.0, "Y": -3.25, "Z": 0.5 }, "residual_um": 1.5,
        "temperatures_degc": { "bed": 20.5, "<b>spindle</b>": 27.25, "scale": null },
        "cycle_p99_us": 2010.0, "overruns": 0, "faults": 0,
    }))
    .expect("a condition");
    let live = Live {
        machine: machine.identity.machine.clone(),
        heard_s: now_s() - if silent { 36_000.0 } else { 0.0 },
        instance: "a".to_owned(),
        version: 0,
        model: String::new(),
        condition: Some(condition),
        lost: 0,
        made: None,
    };
    (machine, live)
}

/// A page with `count` machines. The last one is silent; all others send until the flag is set.
fn shop(count: usize) -> (Page, Arc<AtomicBool>, std::thread::JoinHandle<()>) {
    let page = Page::start();
    let new =
        NewModel::of_text(MODEL.to_owned(), "test", Origin::File { name: String::new() }, "test")
            .expect("a model");
    page.store.add_model(&new.model, &new.text).expect("stored");
    let lives: Vec<Live> =
        (0..count).map(|number| reported(&page, number, number + 1 == count).1).collect();
    page.store.put_live(&lives).expect("stored");
    // Later overviews contain the state of every machine.
    page.overview(&page.session(Role::Viewer));
    let ends = Arc::new(AtomicBool::new(false));
    let (store, ending) = (Arc::clone(&page.store), Arc::clone(&ends));
    let talks = std::thread::spawn(move || {
        while !ending.load(Ordering::Relaxed) {
            let mut lives = lives.clone();
            lives.pop();
            for live in &mut lives {
                live.heard_s = now_s();
            }
            store.put_live(&lives).expect("stored");
            std::thread::sleep(Duration::from_millis(500));
        }
    });
    (page, ends, talks)
}

fn in_the_browser(count: usize) {
    let (page, ends, talks) = shop(count);
    let url = format!("http://{}/", page.address);
    run("browser.py", &[&url, PASSWORD, &count.to_string()]);
    ends.store(true, Ordering::Relaxed);
    talks.join().expect("it ended");
}

#[test]
fn the_page_of_a_stopped_rollout_shows_machine_states_and_options() {
    let (page, ends, talks) = shop(4);
    let model = page.store.models().expect("read").remove(0);
    let machines: Vec<_> = (0..4)
        .map(|number| (format!("mill-{number}").parse().expect("a name"), number == 0))
        .collect();
    let started = page.store.start_rollout(|number| {
        let rules = Rules::default();
        let mut rollout = Rollout::new(number, &model.sha256, &machines, rules, "anna", now_s());
        rollout.targets[0].step = Step::Done { version: 1 };
        let why = "its residual has risen from 1.0 µm to 9.0 µm".to_owned();
        rollout.targets[1].step =
            Step::Out { version: Some(1), why: why.clone(), against: true, excused: false };
        let why = format!("{}: {why}", rollout.targets[1].machine);
        rollout.phase = Phase::Stopped { why };
        rollout
    });
    started.expect("stored");
    let url = format!("http://{}/", page.address);
    run("browser_stopped.py", &[&url, PASSWORD]);
    ends.store(true, Ordering::Relaxed);
    talks.join().expect("it ended");
}

#[test]
fn the_page_shows_three_machines() {
    in_the_browser(3);
}

#[test]
fn the_page_shows_a_thousand_machines() {
    in_the_browser(1000);
}
