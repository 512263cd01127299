//! Tests of the driver with a simulated control, which uses an independent OPC UA library.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod map;
mod nested;
mod reading;
mod secured;

use std::{
    io::{BufRead as _, BufReader, Write as _},
    process::{ChildStdout, Command, Stdio},
    time::Duration,
};

use volcomp_test_support::{Running, peers, root};

/// Aborts the test on a forbidden allocation.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// Timeout that is long enough for a busy computer.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(40);

pub(crate) struct Peer {
    running: Running,
    output: BufReader<ChildStdout>,
    pub(crate) url: String,
}

impl Peer {
    /// Starts a simulated control on a free port; `None` if the Python for tests is missing.
    pub(crate) fn start(arguments: &[&str]) -> Option<Self> {
        let python = peers::python()?;
        let program = root().join("drivers/sinumerik/tests/peer/sinumerik-sim.py");
        let mut command = Command::new(python);
        command
            .arg(program)
            .args(["--listen", "127.0.0.1:0", "--json"])
            .args(arguments)
            .stdin(Stdio::piped());
        let (running, line, output) = Running::start_and_hear(&mut command);
        let url = line.strip_prefix("listening on ");
        let url = url.unwrap_or_else(|| panic!("found {line:?}")).to_owned();
        Some(Self { running, output, url })
    }

    pub(crate) fn type_in(&mut self, command: &str) {
        let input = self.running.stdin.as_mut().expect("piped");
        writeln!(input, "{command}").expect("it runs");
    }

    pub(crate) fn report(&mut self) -> String {
        self.type_in("report");
        let mut line = String::new();
        self.output.read_line(&mut line).expect("a line");
        line
    }

    pub(crate) fn number(&mut self, key: &str, axis: &str) -> f64 {
        let report = self.report();
        let (_, of_key) = report.split_once(&format!("\"{key}\": ")).expect("the key");
        let (_, number) = of_key.split_once(&format!("\"{axis}\": ")).expect("the axis");
        let end = number.find([',', '}']).expect("an end");
        number[..end].parse().expect("a number")
    }
}
