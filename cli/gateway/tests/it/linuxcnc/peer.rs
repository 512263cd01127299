//! A headless LinuxCNC in separate namespaces, for the tests that run if this computer can start it.

use std::{
    fmt::Write as _,
    io::{BufRead as _, BufReader, Write as _},
    os::unix::{
        fs::PermissionsExt as _,
        net::{UnixListener, UnixStream},
        process::CommandExt as _,
    },
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{Mutex, OnceLock, PoisonError},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use tempfile::TempDir;
use volcomp_test_support::{peers, root};

/// Timeout of the start; long enough for a busy computer.
const STARTS_WITHIN: Duration = Duration::from_secs(120);

/// User ID of the real-time part.
const UID: u32 = 65_533;

/// Timeout of a response.
const ANSWERS_WITHIN: Duration = Duration::from_secs(300);

/// Environment variable that identifies the processes of a test.
const HERE: &str = "VOLCOMP_HERE";

pub(crate) struct LinuxCnc {
    pub(crate) dir: PathBuf,
    child: Child,
    asks: UnixStream,
    hears: BufReader<UnixStream>,
}

/// A recorded servo cycle: nominal positions, motor positions and offsets, mm; on five axes also the nominal positions
/// of A and C, deg.
pub(crate) struct Cycle {
    pub(crate) nominal: [f64; 3],
    pub(crate) motor: [f64; 3],
    pub(crate) offset: [f64; 3],
    pub(crate) rotary: [f64; 2],
}

impl LinuxCnc {
    /// Starts the example mill with an edited INI file.
    pub(crate) fn start(dir: &Path, edit: impl Fn(String) -> String) -> Self {
        Self::start_example("mill", dir, edit)
    }

    /// Starts a machine of the examples with an edited INI file.
    pub(crate) fn start_example(name: &str, dir: &Path, edit: impl Fn(String) -> String) -> Self {
        let open = std::fs::Permissions::from_mode(0o1777);
        std::fs::set_permissions(dir, open).expect("ours");
        let examples = root().join("examples/linuxcnc");
        let [hal, tools, file] = ["hal", "tbl", "ini"].map(|end| format!("{name}.{end}"));
        std::fs::copy(examples.join(&hal), dir.join(&hal)).expect("shipped");
        std::fs::write(dir.join(tools), "").expect("writable");
        let ui = root().join("cli/gateway/tests/it/linuxcnc_ui.py");
        let bridge = root().join("drivers/linuxcnc/bridge/volcomp.tcl");
        let ini = std::fs::read_to_string(examples.join(&file)).expect("shipped");
        let ini = ini.replace("DISPLAY = axis", &format!("DISPLAY = {}", ui.display())).replace(
            "../../drivers/linuxcnc/bridge/volcomp.tcl",
            &format!("{}\nHALFILE = record.hal", bridge.display()),
        );
        // LinuxCNC silently drops a command that its servo thread does not process within this time. Without real-time
        // priority the thread may stall for longer than the default of one second.
        let patient = "[EMCMOT]\nCOMM_TIMEOUT = 20\n";
        assert!(ini.contains("[EMCMOT]\n"), "{ini}");
        let ini = edit(ini.replace("[EMCMOT]\n", patient));
        let has_bridge = ini.contains(&*bridge.to_string_lossy());
        let rotary = name == "trunnion";
        std::fs::write(dir.join("record.hal"), record(has_bridge, rotary)).expect("writable");
        let path = dir.join(file);
        std::fs::write(&path, ini).expect("writable");
        let socket = dir.join("ui");
        let listener = UnixListener::bind(&socket).expect("writable");
        listener.set_nonblocking(true).expect("a socket");
        crate::linuxcnc::key_file(dir);
        // The real-time part refuses to run as root, so it runs under an unused user ID, which must be able to read the
        // key. Root can still read the key.
        std::os::unix::fs::chown(dir.join("volcomp.key"), Some(UID), Some(UID)).expect("ours");
        let log = std::fs::File::create(dir.join("linuxcnc.log")).expect("writable");
        // On a busy computer LinuxCNC loses commands to its own servo thread during the start, so the start gets a high
        // priority. Without permission for it the priority is normal.
        let mut command = Command::new("nice");
        command
            .args(["-n", "-15", "linuxcnc", "-r"])
            .arg(&path)
            .current_dir(dir)
            .env_remove("DISPLAY")
            .env("VOLCOMP_UI", &socket)
            .env(HERE, dir)
            .env("RTAPI_FIFO_PATH", dir.join("fifo"))
            // The parts of LinuxCNC share the tool table through a file in the home folder.
            .env("HOME", dir)
            .stdin(Stdio::null())
            .stdout(log.try_clone().expect("a file"))
            .stderr(log)
            .process_group(0);
        command.env("RTAPI_UID", UID.to_string());
        let mut child = command.spawn().expect("linuxcnc");
        let end = Instant::now() + STARTS_WITHIN;
        let asks = loop {
            if let Ok((stream, _)) = listener.accept() {
                break stream;
            }
            let log = || std::fs::read_to_string(dir.join("linuxcnc.log")).unwrap_or_default();
            assert!(child.try_wait().expect("ours").is_none(), "{}", log());
            assert!(Instant::now() < end, "it does not start\n{}", log());
            std::thread::sleep(Duration::from_millis(20));
        };
        asks.set_nonblocking(false).expect("a socket");
        asks.set_read_timeout(Some(ANSWERS_WITHIN)).expect("a socket");
        let hears = BufReader::new(asks.try_clone().expect("a socket"));
        let mut control = Self { dir: dir.to_owned(), child, asks, hears };
        control.ask("realtime", &json!({}));
        control
    }

    /// Sends a command to the user interface, and waits for its completion.
    pub(crate) fn ask(&mut self, what: &str, more: &Value) -> Value {
        let answer = self.try_ask(what, more);
        answer.unwrap_or_else(|error| panic!("{what}: {error}\n{}", self.log()))
    }

    pub(crate) fn try_ask(&mut self, what: &str, more: &Value) -> Result<Value, String> {
        let mut asked = more.clone();
        asked["do"] = what.into();
        writeln!(self.asks, "{asked}").map_err(|e| e.to_string())?;
        let mut line = String::new();
        self.hears.read_line(&mut line).map_err(|e| e.to_string())?;
        let mut reported: Value =
            serde_json::from_str(&line).map_err(|e| format!("{e}: {line:?}"))?;
        match reported["error"].as_str() {
            Some(error) => Err(error.to_owned()),
            None => Ok(reported["ok"].take()),
        }
    }

    pub(crate) fn do_it(&mut self, what: &str) {
        self.ask(what, &json!({}));
    }

    pub(crate) fn mdi(&mut self, text: &str) {
        self.ask("mdi", &json!({ "text": text }));
    }

    pub(crate) fn get(&mut self, pins: &[&str]) -> Vec<f64> {
        let found = self.ask("get", &json!({ "pins": pins }));
        let found = found.as_array().expect("a list").iter();
        found.map(|value| value.as_f64().expect("a number")).collect()
    }

    pub(crate) fn pin(&mut self, pin: &str) -> f64 {
        self.get(&[pin])[0]
    }

    pub(crate) fn touch(&mut self, touches: bool) {
        self.hal(&["sets", "volcomp-probe", if touches { "1" } else { "0" }]);
    }

    pub(crate) fn hal(&mut self, arguments: &[&str]) {
        self.ask("hal", &json!({ "arguments": arguments }));
    }

    pub(crate) fn wait(&mut self, pin: &str, done: impl Fn(f64) -> bool) -> f64 {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            // The program that creates the pin may start later.
            let value = self.try_ask("get", &json!({ "pins": [pin] }));
            if let Some(value) = value.as_ref().ok().and_then(|value| value[0].as_f64())
                && done(value)
            {
                return value;
            }
            assert!(Instant::now() < end, "{pin} is {value:?}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Records every servo cycle during an action.
    pub(crate) fn record(&mut self, act: impl FnOnce(&mut Self)) -> Vec<Cycle> {
        let path = self.dir.join("record.txt");
        self.ask("record", &json!({ "path": path }));
        act(self);
        self.ask("recorded", &json!({}));
        let text = std::fs::read_to_string(path).expect("recorded");
        let cycles = text.lines().filter_map(|line| {
            let values: Vec<f64> = line.split_whitespace().map_while(|v| v.parse().ok()).collect();
            let three = |at: usize| values.get(at..at + 3)?.try_into().ok();
            Some(Cycle {
                nominal: three(0)?,
                motor: three(3)?,
                offset: three(6)?,
                rotary: (values.get(9..11)).map_or([0.0; 2], |pair| [pair[0], pair[1]]),
            })
        });
        cycles.collect()
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.dir.join("linuxcnc.log")).unwrap_or_default()
    }

    /// Process IDs of this LinuxCNC whose command line contains `word`.
    pub(crate) fn processes(&self, word: &str) -> Vec<i32> {
        let mine = format!("{HERE}={}", self.dir.display());
        let has = |file: PathBuf, word: &str| {
            let bytes = std::fs::read(file).unwrap_or_default();
            String::from_utf8_lossy(&bytes).contains(word)
        };
        let entries = std::fs::read_dir("/proc").expect("Linux").flatten();
        let found = entries.filter(|entry| {
            has(entry.path().join("environ"), &mine) && has(entry.path().join("cmdline"), word)
        });
        found.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
    }
}

fn signal(name: &str, pid: i32) {
    let _ = Command::new("kill").arg(format!("-{name}")).arg(pid.to_string()).status();
}

impl Drop for LinuxCnc {
    fn drop(&mut self) {
        // Closing the socket ends the user interface, which ends LinuxCNC.
        let _ = self.asks.shutdown(std::net::Shutdown::Both);
        let end = Instant::now() + Duration::from_secs(30);
        while Instant::now() < end && matches!(self.child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(50));
        }
        // Some programs outlive the start script, and would receive the requests for the next instance.
        let end = Instant::now() + Duration::from_secs(30);
        loop {
            let left = self.processes("");
            if left.is_empty() || Instant::now() > end {
                break;
            }
            for pid in left {
                signal("KILL", pid);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let _ = self.child.wait();
        // Removes the shared memory of this namespace, so that the next instance finds no old state.
        let _ = Command::new("ipcrm").arg("--all").status();
    }
}

/// HAL commands that record every servo cycle. With the bridge, its signals are already connected to the pins.
fn record(has_bridge: bool, rotary: bool) -> String {
    let more = if rotary { "ff" } else { "" };
    let mut text = format!(
        "loadrt sampler cfg=fffffffff{more} depth=60000\naddf sampler.0 servo-thread\nsetp sampler.0.enable 0\n",
    );
    if rotary {
        text += "net volcomp-cmd-a => sampler.0.pin.9\nnet volcomp-cmd-c => sampler.0.pin.10\n";
    }
    for (at, (small, large)) in [("x", "X"), ("y", "Y"), ("z", "Z")].iter().enumerate() {
        let (nominal, offset) = if has_bridge {
            (String::new(), String::new())
        } else {
            (format!(" axis.{small}.pos-cmd"), format!(" axis.{small}.eoffset"))
        };
        let (motor, last) = (at + 3, at + 6);
        let lines = [
            (format!("volcomp-cmd-{small}{nominal}"), at),
            (format!("{large}pos"), motor),
            (format!("volcomp-eoffset-{small}{offset}"), last),
        ];
        for (signal, pin) in lines {
            let _ = writeln!(text, "net {signal} => sampler.0.pin.{pin}");
        }
    }
    if has_bridge {
        text += "sets volcomp-probe 0\n";
    }
    text
}

/// The folder of LinuxCNC's components.
const MODULES: &str = "/usr/lib/linuxcnc/modules";

/// The start script of LinuxCNC.
const LINUXCNC: &str = "/usr/bin/linuxcnc";
/// Line of the start script that names the lock file of a running LinuxCNC.
const RUNS: &str = "LOCKFILE=/tmp/linuxcnc.lock\n";

/// Environment variable that names a folder with LinuxCNC's components, the bridge and the start script.
const WITH_BRIDGE: &str = "VOLCOMP_MODULES";

/// Declares tests that run with an isolated LinuxCNC.
macro_rules! alone {
    ($module:ident: $($name:ident),* $(,)?) => {
        mod on_linuxcnc {
            $(#[test]
            fn $name() {
                let name = concat!(stringify!($module), "::on_linuxcnc::", stringify!($name));
                if crate::linuxcnc::peer::goes_on(name) {
                    super::$name();
                }
            })*
        }
    };
}
pub(crate) use alone;

fn can_start() -> bool {
    for (file, package) in
        [(LINUXCNC, "linuxcnc-uspace"), ("/usr/bin/halcompile", "linuxcnc-uspace-dev")]
    {
        if !Path::new(file).exists() {
            peers::not_run(package);
            return false;
        }
    }
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        eprintln!("not run: only root can place the bridge among the components of LinuxCNC");
    }
    is_root
}

/// The folder for [`WITH_BRIDGE`], built once per run.
static WITH_BRIDGE_BUILT: OnceLock<TempDir> = OnceLock::new();

/// Slots for running LinuxCNC. Each slot runs one at a time, because its servo thread needs processor time.
static PLACES: [Mutex<()>; 2] = [const { Mutex::new(()) }; 2];

fn run(command: &mut Command) {
    let output = command.output().expect("a program of the system");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}: {said}");
}

fn build() -> TempDir {
    let dir = tempfile::tempdir().expect("writable");
    let modules = dir.path().join("modules");
    run(Command::new("cp").args(["-a", MODULES]).arg(&modules));
    let component = root().join("drivers/linuxcnc/bridge/volcomp.comp");
    std::fs::copy(component, modules.join("volcomp.comp")).expect("writable");
    run(Command::new("halcompile").args(["--compile", "volcomp.comp"]).current_dir(&modules));
    let script = std::fs::read_to_string(LINUXCNC).expect("a script");
    assert!(script.contains(RUNS), "another file says that it runs");
    let own = script.replace(RUNS, &format!("LOCKFILE=\"${HERE}/lock\"\n"));
    let file = dir.path().join("linuxcnc");
    std::fs::write(&file, own).expect("writable");
    let runs = std::fs::Permissions::from_mode(0o755);
    std::fs::set_permissions(&file, runs).expect("ours");
    dir
}

/// True if this process runs the test itself.
///
/// Two LinuxCNC on one computer share memory and lock file, and the first to end kills the programs of the other by
/// name. This function therefore starts each test again in separate namespaces, in which it returns true. In the outer
/// process it returns false after the test has passed there, or if LinuxCNC cannot be started, and panics if the test
/// has failed.
pub(crate) fn goes_on(name: &str) -> bool {
    if let Some(folder) = std::env::var_os(WITH_BRIDGE) {
        for (own, of_all) in [("modules", MODULES), ("linuxcnc", LINUXCNC)] {
            let own = Path::new(&folder).join(own);
            run(Command::new("mount").arg("--bind").arg(own).arg(of_all));
        }
        return true;
    }
    if !can_start() {
        return false;
    }
    let free = PLACES.iter().find_map(|place| place.try_lock().ok());
    // A failed test has also released its slot, so ignore poisoning.
    let _place = free.unwrap_or_else(|| PLACES[0].lock().unwrap_or_else(PoisonError::into_inner));
    let folder = WITH_BRIDGE_BUILT.get_or_init(build).path();
    for tried in 1.. {
        let (succeeds, reported) = inside(name, folder);
        if succeeds {
            break;
        }
        let again = tried < TRIES && reported.contains(STANDS);
        assert!(again, "in separate namespaces it fails");
        println!("LinuxCNC itself stood still, see above: the test is started again");
    }
    false
}

/// Maximum number of attempts of a test in which LinuxCNC itself stalls. Any other failure ends the test at its first
/// attempt.
const TRIES: usize = 3;

/// Message of the user interface if LinuxCNC ignores a command and nothing moves, as on a busy computer without a real-time kernel.
const STANDS: &str = "LinuxCNC stands:";

/// Runs the test in separate namespaces. Returns its success and its output.
fn inside(name: &str, folder: &Path) -> (bool, String) {
    let inside = std::env::current_exe().expect("this program");
    let output = Command::new("unshare")
        .args(["--ipc", "--net", "--pid", "--fork", "--kill-child"])
        .args(["--mount-proc", "sh", "-c"])
        .arg("ip link set lo up && exec \"$@\" 2>&1")
        .arg("sh")
        .arg(inside)
        .args(["--exact", &format!("linuxcnc::{name}"), "--nocapture"])
        .env(WITH_BRIDGE, folder)
        .output()
        .expect("unshare of util-linux");
    let reported = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{reported}");
    (output.status.success(), reported)
}
