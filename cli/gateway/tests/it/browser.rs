//! The dashboard in a headless Chromium, by Playwright.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
};

use volcomp_test_support::peers;

use crate::program::{OPERATE, Program};

#[test]
fn a_person_sees_and_operates_it() {
    if !Path::new("/usr/bin/chromium").exists() {
        peers::not_run("Chromium");
        return;
    }
    let Some(python) = peers::python() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let mut program = Program::simulated(dir.path());
    let screenshot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/gateway.png");
    let mut browser = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/browser.py"))
        .arg(format!("http://{}/", program.address))
        .arg(OPERATE)
        .arg(&screenshot)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("Python");
    let mut lines = BufReader::new(browser.stdout.take().expect("piped")).lines();
    let said = lines.next().and_then(Result::ok);
    if said.as_deref() == Some("ready") {
        program.signal("TERM");
        assert_eq!(program.end(), Some(0));
        writeln!(browser.stdin.take().expect("piped"), "gone").expect("it listens");
    }
    let output = browser.wait_with_output().expect("ours");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}\n{}", program.log());
    assert!(screenshot.exists());
}
