//! A child process that ends with the test that started it.

use std::{
    io::{BufRead, BufReader},
    ops::{Deref, DerefMut},
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

/// A running program, killed when dropped, so that a failing test does not leave it behind.
pub struct Running(Child);

impl Running {
    pub fn start(command: &mut Command) -> Self {
        match command.spawn() {
            Ok(child) => Self(child),
            Err(e) => panic!("{command:?} cannot be started: {e}"),
        }
    }

    /// Starts a program and waits for its first line on standard output. Returns the program, that line without its
    /// end, and the rest of the output.
    pub fn start_and_hear(command: &mut Command) -> (Self, String, BufReader<ChildStdout>) {
        let mut running = Self::start(command.stdout(Stdio::piped()));
        let stdout = running.0.stdout.take().expect("piped just above");
        let (mut output, mut line) = (BufReader::new(stdout), String::new());
        output.read_line(&mut line).expect("a line of text");
        (running, line.trim_end().to_owned(), output)
    }

    /// Starts a program and waits until it prints `ready`.
    pub fn start_ready(command: &mut Command) -> Self {
        let (running, line, _) = Self::start_and_hear(command);
        assert_eq!(line, "ready", "{command:?}");
        running
    }

    /// Sends a signal, named without `SIG`.
    pub fn signal(&self, name: &str) {
        let sent =
            Command::new("kill").args([&format!("-{name}"), &self.0.id().to_string()]).status();
        assert!(sent.is_ok_and(|status| status.success()), "SIG{name}");
    }

    /// Waits until the program exits; `None` if it still runs after `within`.
    pub fn ended(&mut self, within: Duration) -> Option<ExitStatus> {
        let end = Instant::now() + within;
        while Instant::now() < end {
            let status = self.0.try_wait().expect("a child of this process");
            if status.is_some() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        None
    }

    /// Kills the program with SIGKILL, without a chance to clean up.
    pub fn kill(&mut self) {
        // It may have exited already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Deref for Running {
    type Target = Child;

    fn deref(&self) -> &Child {
        &self.0
    }
}

impl DerefMut for Running {
    fn deref_mut(&mut self) -> &mut Child {
        &mut self.0
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}
