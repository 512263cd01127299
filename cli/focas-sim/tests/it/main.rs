//! The program as it is called by scripts.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../../../../docs/options.rs"]
mod options;

use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    time::Duration,
};

use volcomp_focas::{Client, PositionKind};

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(arguments: &[&str]) -> (Running, u16) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_focas-sim"))
        .args(["--listen", "127.0.0.1:0"])
        .args(arguments)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let stdout = child.stdout.take().unwrap();
    BufReader::new(stdout).read_line(&mut line).unwrap();
    let port = line.trim().strip_prefix("listening on 127.0.0.1:").unwrap();
    (Running(child), port.parse().unwrap())
}

#[test]
fn it_listens_and_moves() {
    let (_running, port) = start(&["--axes", "X,Y,C", "--version", "4", "--stroke-mm", "100"]);
    let mut client = Client::open("127.0.0.1", port, Duration::from_secs(5)).unwrap();
    assert_eq!(client.version(), 4);
    assert_eq!(client.axis_names().unwrap(), ['X', 'Y', 'C']);
    let first = client.positions(PositionKind::Machine, 3).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert_ne!(client.positions(PositionKind::Machine, 3).unwrap(), first);
}

#[test]
fn wrong_calls_are_refused() {
    for (arguments, expected) in [
        (&["--listen", "nonsense"][..], "--listen nonsense"),
        (&["--version", "9"], "9 is not in 2..=4"),
        (&["--latency-ms=-1"], "--latency-ms"),
        (&["--period-s", "0"], "--period-s"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_focas-sim"))
            .args(arguments)
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(expected), "{message}");
    }
    let version = Command::new(env!("CARGO_BIN_EXE_focas-sim"))
        .arg("--version")
        .output()
        .unwrap();
    assert!(version.status.success());
}

#[test]
fn every_option_is_in_the_chapter_on_commands() {
    options::compare_options("focas-sim", env!("CARGO_BIN_EXE_focas-sim"));
}
