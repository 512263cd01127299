//! The program, started and operated over HTTP.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    ops::Deref,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_test_support::Running;

pub(crate) const OPERATE: &str = "0123456789abcdef0123456789abcdef";
pub(crate) const VIEW: &str = "fedcba9876543210fedcba9876543210";
/// A small machine with known corrections: -0.05 µm/mm on X, -20 µm on Y.
pub(crate) const MACHINE: &str = r#"
name = "small"
structure = "w X' b Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 400.0]
[axes.Z]
travel = [0.0, 250.0]
[errors]
EXX = { poly = [0.0, 0.05] }
EYX = 20.0
"#;

/// Timeout of all waits; long enough for a busy computer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(90);

#[derive(Clone)]
pub(crate) struct Client {
    pub(crate) address: SocketAddr,
    log: PathBuf,
}

/// A running gateway. Dropping this value ends it.
pub(crate) struct Program {
    pub(crate) running: Running,
    client: Client,
}

impl Deref for Program {
    type Target = Client;

    fn deref(&self) -> &Client {
        &self.client
    }
}

pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.body))
    }
}

pub(crate) fn token_file(dir: &Path) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let path = dir.join("tokens");
    std::fs::write(&path, format!("# who may\nanna operate {OPERATE}\nbert view {VIEW}\n"))
        .expect("writable");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).expect("ours");
    path
}

impl Program {
    /// Starts the program with these arguments on a free loopback port.
    pub(crate) fn start(dir: &Path, arguments: &[&str]) -> Self {
        Self::spawn(Command::new(env!("CARGO_BIN_EXE_volcomp-gateway")), dir, arguments)
    }

    /// Starts the program through `command`, such as a shell that sets limits.
    pub(crate) fn spawn(mut command: Command, dir: &Path, arguments: &[&str]) -> Self {
        let log = dir.join("gateway.log");
        let file = std::fs::File::options().create(true).append(true).open(&log).expect("writable");
        let (running, line, _) = Running::start_and_hear(
            command.args(arguments).args(["--listen", "127.0.0.1:0"]).stderr(file),
        );
        let address = line.rsplit('/').next().and_then(|address| address.parse().ok());
        let reported = || std::fs::read_to_string(&log).unwrap_or_default();
        let address = address.unwrap_or_else(|| panic!("it says {line:?}: {}", reported()));
        let client = Client { address, log };
        Self { running, client }
    }

    /// Starts the built-in simulation with tokens through `command`, such as a shell that sets limits.
    pub(crate) fn simulated(command: Command, dir: &Path) -> Self {
        let (tokens, audit) = (token_file(dir), dir.join("audit"));
        let arguments = ["--simulate", "--token-file", path(&tokens), "--audit-dir"];
        Self::spawn(command, dir, &[&arguments[..], &[path(&audit)]].concat())
    }

    pub(crate) fn signal(&self, name: &str) {
        self.running.signal(name);
    }

    pub(crate) fn end(&mut self) -> Option<i32> {
        let ended = self.running.ended(PATIENCE);
        ended.unwrap_or_else(|| panic!("it does not end\n{}", self.log())).code()
    }
}

impl Client {
    /// A client of a dashboard in this process. The client has no log file.
    pub(crate) fn of(address: SocketAddr) -> Self {
        Self { address, log: PathBuf::new() }
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Sends raw bytes. Returns all bytes received until the peer closes the connection.
    pub(crate) fn raw(&self, bytes: &[u8]) -> String {
        exchange(self.address, bytes)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        connect(self.address)
    }

    pub(crate) fn request(
        &self,
        method: &str,
        path: &str,
        token: Option<&str>,
        body: &str,
    ) -> Answer {
        answer(&self.raw(self.request_text(method, path, token, body).as_bytes()))
    }

    pub(crate) fn request_text(
        &self,
        method: &str,
        path: &str,
        token: Option<&str>,
        body: &str,
    ) -> String {
        let authorization =
            token.map_or(String::new(), |token| format!("Authorization: Bearer {token}\r\n"));
        format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\n{authorization}Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.address,
            body.len()
        )
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.request("GET", path, None, "")
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> Answer {
        self.request("POST", path, Some(OPERATE), body)
    }

    /// Arms after [`watch`](Self::watch).
    pub(crate) fn arm(&self) -> Answer {
        self.watch();
        self.post("/api/arm", "")
    }

    /// Arms. Retries while a late cycle on a busy computer forbids arming.
    pub(crate) fn must_arm(&self) -> Answer {
        let end = Instant::now() + PATIENCE;
        loop {
            let answer = self.arm();
            if answer.status == 200 {
                return answer;
            }
            assert!(
                !answer.body.contains("worst_corner_um"),
                "a confirmation is requested: {}",
                answer.body
            );
            assert!(Instant::now() < end, "{}\n{}", answer.body, self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until the control has been observed long enough for arming.
    pub(crate) fn watch(&self) {
        self.wait(|state| !state["reasons"].to_string().contains("watching"))
            .unwrap_or_else(|state| panic!("it watches for ever: {state}"));
    }

    pub(crate) fn state(&self) -> Value {
        self.get("/api/state").json()
    }

    pub(crate) fn wait_for(&self, name: &str) -> Value {
        self.wait(|state| state["state"] == name)
            .unwrap_or_else(|last| panic!("not {name}: {last}\n{}", self.log()))
    }

    pub(crate) fn wait(&self, done: impl Fn(&Value) -> bool) -> Result<Value, Value> {
        let end = Instant::now() + PATIENCE;
        loop {
            let state = self.state();
            if done(&state) {
                return Ok(state);
            }
            if Instant::now() > end {
                return Err(state);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a time");
    stream
}

/// Sends bytes to an address. Returns all bytes received until the peer closes the connection.
pub(crate) fn exchange(address: SocketAddr, bytes: &[u8]) -> String {
    exchange_over(connect(address), bytes)
}

/// Sends bytes over a connection. Returns all bytes received until the peer closes it.
pub(crate) fn exchange_over(mut stream: TcpStream, bytes: &[u8]) -> String {
    // The peer may close during the write.
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

pub(crate) fn answer(text: &str) -> Answer {
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((text, ""));
    let status = head.split_whitespace().nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    Answer { status, head: head.to_ascii_lowercase(), body: body.to_owned() }
}

pub(crate) fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

pub(crate) fn append(file: &Path, table: &str) {
    let text = std::fs::read_to_string(file).expect("readable") + table;
    std::fs::write(file, text).expect("writable");
}

/// Replaces a text in a file. Panics if the file does not contain the text.
pub(crate) fn change(file: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(file).expect("readable");
    assert!(text.contains(from), "{from}");
    std::fs::write(file, text.replace(from, to)).expect("writable");
}
