//! The first hour: from no configuration to a gateway that corrects.
//!
//! The commands are `init`, `token`, `arm`, `disarm`, `acknowledge`, `service` and `completions`. The shipped
//! configurations are run with the simulated control, by the commands in their comments.

use std::{
    fs,
    io::BufRead,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_devices::controllers;
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::http::Tokens;
use volcomp_test_support::{Running, book, free_address, rows, until};

use crate::{
    manual::controlled_configuration,
    program::{MACHINE, PATIENCE, Program, change, path},
};

/// Exit status, standard output and standard error of a call in a folder.
fn call(dir: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(arguments)
        .current_dir(dir)
        .stdin(Stdio::null())
        .output()
        .expect("the program");
    let [out, error] = [output.stdout, output.stderr]
        .map(|text| String::from_utf8(text).expect("the program prints text"));
    (output.status.code(), out, error)
}

/// Standard output of a call that succeeds.
fn done(dir: &Path, arguments: &[&str]) -> String {
    let (status, out, error) = call(dir, arguments);
    assert_eq!(status, Some(0), "{arguments:?}: {error}");
    out
}

fn mode(file: &Path) -> u32 {
    fs::metadata(file).expect("there").permissions().mode() & 0o777
}

/// The commands of a section of the chapter on the gateway.
fn commands(section: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(book::chapter("gateway.md")).expect("the page");
    let begin = text.find(section).expect("the section");
    let block = text[begin..].split("```").nth(1).expect("a block");
    let lines = block.lines().filter_map(|line| line.strip_prefix("$ "));
    let words = lines.map(|line| line.split_whitespace().map(str::to_owned).collect());
    words.collect()
}

/// Repeats a call until it succeeds, because just after the start the gateway still watches the control.
fn until_done(dir: &Path, arguments: &[&str]) -> String {
    let end = Instant::now() + PATIENCE;
    loop {
        let (status, out, error) = call(dir, arguments);
        if status == Some(0) {
            return out;
        }
        assert!(Instant::now() < end, "{arguments:?}: {error}");
        assert_eq!(status, Some(1), "{error}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Runs the commands of the chapter in order, on free ports. Only the two commands that build the programs are omitted.
#[test]
fn the_commands_of_the_page_lead_to_a_correction() {
    let commands = commands("## From nothing to a correction");
    assert!(commands.len() <= 8, "{commands:?}");
    let (dir, _examples) = copied_examples();
    let dir = dir.path();
    let control = free_address();
    let begun = Instant::now();
    let (mut simulated, mut gateway) = (None, None);
    for command in &commands {
        let words: Vec<String> =
            command.iter().map(|word| word.replace("127.0.0.1:8193", &control)).collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match words[..] {
            ["cargo", "install", "--locked", "--path", folder] => {
                let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
                assert!(root.join(folder).join("Cargo.toml").is_file(), "{folder}");
            }
            ["focas-sim", ref arguments @ ..] => {
                let mut command = Command::new(simulator());
                command.args(arguments).args(["--listen", &control]);
                command.current_dir(dir).stdin(Stdio::null());
                simulated = Some(Running::start_and_hear(&mut command));
            }
            ["volcomp-gateway", ref arguments @ ..] if arguments[0] == "--config" => {
                let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
                command.current_dir(dir);
                gateway = Some(Program::spawn(command, dir, arguments));
            }
            ["volcomp-gateway", ref arguments @ ..] if arguments[0] == "arm" => {
                let gateway: &Program = gateway.as_ref().expect("started before");
                let listen = gateway.address.to_string();
                let out = until_done(dir, &[arguments, &["--listen", &listen]].concat());
                assert!(out.starts_with("state "), "{out}");
            }
            ["volcomp-gateway", ref arguments @ ..] => drop(done(dir, arguments)),
            _ => panic!("{words:?}"),
        }
    }
    assert!(simulated.is_some());
    let gateway = gateway.expect("one command starts it");
    gateway.wait_for("compensating");
    eprintln!("init to compensating: {:.1?}", begun.elapsed());
    let listen = gateway.address.to_string();
    until("it reports its state", PATIENCE, || {
        let status = done(dir, &["status", "--listen", &listen]);
        status.contains("state             compensating")
    });
    let out = done(dir, &["disarm", "--listen", &listen]);
    assert!(out.contains("ramping-out") || out.contains("disarmed"), "{out}");
    gateway.wait_for("disarmed");
    let secret = fs::read_to_string(dir.join("tokens")).expect("a token file");
    let secret = secret.split_whitespace().last().expect("a token");
    assert!(!gateway.log().contains(secret), "the log has the token");
}

/// A machine with a thermal term, for controls to which only thermal terms are applied.
fn thermal_machine(dir: &Path) {
    let thermal = "[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"bed\"\num_per_m_k = 2.5\n";
    fs::write(dir.join("m.toml"), format!("{MACHINE}{thermal}")).expect("writable");
}

/// Every bus of the build, with the example URL of its driver. The file passes `check`, and a comment precedes every
/// key.
#[test]
fn every_bus_gets_a_configuration_that_passes() {
    let dir = tempfile::tempdir().expect("writable");
    let dir = dir.path();
    thermal_machine(dir);
    let urls = controllers();
    assert!(urls.len() >= 5, "{urls:?}");
    for (index, (url, _)) in urls.into_iter().enumerate() {
        let file = format!("{index}.toml");
        let init = ["init", &file, "--machine", "m.toml", "--control", url];
        let (status, _, message) = call(dir, &init);
        if status != Some(0) {
            // Digital lines carry one position.
            assert!(message.contains("name one axis"), "{url}: {message}");
            done(dir, &[&init[..], &["--axes", "Z"]].concat());
        }
        done(dir, &["check", &file]);
        let text = fs::read_to_string(dir.join(&file)).expect("written");
        assert!(text.contains(url) && text.contains("\nlimit_um = 20.0\n"), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        for pair in lines.windows(2) {
            let is_key = !pair[1].starts_with(['#', '[']) && pair[1].contains(" = ");
            assert!(!is_key || pair[0].starts_with("# "), "{pair:?}");
        }
    }
    assert_eq!(mode(&dir.join("volcomp.key")), 0o600);
    fs::write(dir.join("volcomp.key"), "no key").expect("ours");
    let init = ["init", "key.toml", "--machine", "m.toml", "--control", "linuxcnc://127.0.0.1"];
    let (_, _, message) = call(dir, &init);
    let expected = "volcomp.key: found another text, expected 32 hexadecimal digits";
    assert!(message.contains(expected), "{message}");
    assert_eq!(message.matches("expected").count(), 1, "{message}");
    for (name, url, names) in [
        ("modbus", "modbus://192.0.2.20?profile=PTA8C04", "bed,column"),
        ("can", "can://can0", "bed"),
        ("opc", "opc.tcp://192.0.2.20", "bed"),
    ] {
        let control = "focas://192.0.2.10";
        let init = ["init", name, "--machine", "m.toml", "--control", control];
        let init = [&init[..], &["--sensors", url, names]].concat();
        let (status, _, message) = call(dir, &init);
        assert_eq!(status, Some(0), "{url}: {message}");
        let found = done(dir, &["check", name]);
        assert!(found.contains(url), "{found}");
    }
    let init = ["init", "misspelt", "--machine", "m.toml", "--control", "focas://192.0.2.10"];
    let sensors = ["--sensors", "modbus://192.0.2.20?profile=PTA8C04", "bett"];
    let out = done(dir, &[&init[..], &sensors].concat());
    assert!(out.contains("note: sensor bett is used by no thermal term of the machine"), "{out}");
}

#[test]
fn five_axes_get_rotary_limits_and_what_is_not_corrected_is_read() {
    let (dir, _examples) = copied_examples();
    let dir = dir.path();
    let machine = "examples/table-tilting.toml";
    let init = ["--machine", machine, "--control", "focas://192.0.2.10"];
    done(dir, &[&["init", "a.toml"], &init[..]].concat());
    let text = done(dir, &["check", "a.toml"]);
    assert!(text.contains("limit_urad"), "{text}");
    done(dir, &[&["init", "b.toml"], &init[..], &["--axes", "X,Y,Z"]].concat());
    let text = done(dir, &["check", "b.toml"]);
    assert!(text.contains("reads = "), "{text}");
    // A configuration in another folder names the machine file by its absolute path.
    fs::create_dir(dir.join("other")).expect("writable");
    done(dir, &[&["init", "other/c.toml"], &init[..]].concat());
    done(dir, &["check", "other/c.toml"]);
}

#[test]
fn what_init_refuses_leaves_no_file() {
    let dir = tempfile::tempdir().expect("writable");
    let dir = dir.path();
    thermal_machine(dir);
    fs::write(dir.join("old.toml"), "mine").expect("writable");
    for [arguments, expected] in rows(
        r"
old.toml --machine m.toml --control focas://192.0.2.10 | overwrites nothing
new.toml --machine m.toml | no terminal
new.toml --control focas://192.0.2.10 | no terminal
new.toml --machine none.toml --control focas://192.0.2.10 | none.toml
new.toml --machine m.toml --control s7://192.0.2.10 | found the scheme `s7`; expected focas://HOST
new.toml --machine m.toml --control focas://192.0.2.10 --axes X,B | axis B
new.toml --machine m.toml --control focas://192.0.2.10 --axes X,Q | invalid value 'Q'
new.toml --machine m.toml --control linuxcnc://127.0.0.1 --axes X,B | axis B
new.toml --machine m.toml --control gpio://?position=a:0-14&correction=b:0-7 | name one axis
new.toml --machine m.toml --control focas://192.0.2.10 --sensors focas://192.0.2.11 bed | no temperatures
none/new.toml --machine m.toml --control focas://192.0.2.10 | none/new.toml
",
    ) {
        let arguments: Vec<&str> = arguments.split(' ').collect();
        let (status, _, message) = call(dir, &[&["init"], &arguments[..]].concat());
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(matches!(status, Some(1 | 2)), "{message}");
        let message = message.trim_end();
        assert!(message.starts_with("error: "), "{message}");
        let mut left: Vec<_> = fs::read_dir(dir).expect("there").flatten().collect();
        left.retain(|entry| !["m.toml", "old.toml"].map(Into::into).contains(&entry.file_name()));
        assert!(left.is_empty(), "{left:?}");
    }
    assert_eq!(fs::read_to_string(dir.join("old.toml")).expect("kept"), "mine");
}

#[test]
fn tokens_are_added_to_a_private_file() {
    let dir = tempfile::tempdir().expect("writable");
    let dir = dir.path();
    let file = dir.join("tokens");
    let add = |name: &str, role: &str| {
        call(dir, &["token", "add", name, "--role", role, "--token-file", "tokens"])
    };
    let (status, first, message) = add("anna", "operate");
    assert_eq!(status, Some(0), "{message}");
    assert_eq!(mode(&file), 0o600);
    // The file has a comment, and its last line has no line end.
    let text = fs::read_to_string(&file).expect("readable");
    fs::write(&file, format!("# who may\n{}", text.trim_end())).expect("ours");
    let (status, second, message) = add("bert", "engineer");
    assert_eq!(status, Some(0), "{message}");
    assert_ne!(first, second);
    let text = fs::read_to_string(&file).expect("readable");
    let expected = format!("# who may\nanna operate {first}bert engineer {second}");
    assert_eq!(text, expected);
    let tokens = Tokens::load(Some(&file)).expect("the gateway reads it");
    assert_eq!(tokens.holders().count(), 2);
    for (name, role, expected) in [
        ("anna", "view", "the name anna has a token"),
        ("a b", "view", "without blanks"),
        ("#x", "view", "without blanks"),
        ("carl", "admin", "possible values: view, operate, engineer"),
    ] {
        let (status, _, message) = add(name, role);
        assert_eq!(status, Some(2), "{message}");
        assert!(message.contains(expected), "{message}");
        assert!(!message.contains(first.trim()), "{message}");
    }
    assert_eq!(fs::read_to_string(&file).expect("readable"), text);
    fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).expect("ours");
    let (status, _, message) = add("carl", "view");
    assert_eq!(status, Some(2));
    assert!(message.contains("expected 600"), "{message}");
}

/// After a change of the model `arm` prints the question of the dashboard, and arms only with the hash.
#[test]
fn arm_asks_before_a_changed_model() {
    let dir = tempfile::tempdir().expect("writable");
    let dir = dir.path();
    let world = World::new(&['X', 'Y', 'Z']);
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
    let config = controlled_configuration(dir, &control, "");
    let start = || Program::start(dir, &["--config", path(&config)]);
    let mut program = start();
    let to = program.address.to_string();
    // The first line of the token file is a comment.
    let with_token = |verb| [verb, "--token-file", "tokens", "--listen"];
    until_done(dir, &[&with_token("arm")[..], &[&to]].concat());
    program.wait_for("compensating");
    let (status, _, message) = call(dir, &["arm", "--listen", &to]);
    assert_eq!(status, Some(1), "without a token: {message}");
    let expected = "a valid token is needed: state it with --token-file FILE\n";
    assert!(message.ends_with(expected), "{message}");
    let (status, _, message) = call(dir, &[&with_token("acknowledge")[..], &[&to]].concat());
    assert_eq!(status, Some(1), "nothing to acknowledge: {message}");
    assert!(message.contains("acknowledge is refused: "), "{message}");
    // Disarming works although the token file is unreadable.
    done(dir, &["disarm", "--token-file", "none", "--listen", &to]);
    program.wait_for("disarmed");
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    change(&dir.join("machine.toml"), "EYX = 20.0", "EYX = 60.0");

    let program = start();
    program.watch();
    let to = program.address.to_string();
    let arm = [&with_token("arm")[..], &[&to]].concat();
    let (status, out, message) = call(dir, &arm);
    assert_eq!((status, &*out), (Some(1), ""), "{message}");
    assert!(message.contains("changes by 40.0 µm"), "{message}");
    let (_, hash) = message.split_once("--confirm ").expect("the answer");
    let wrong = call(dir, &[&arm[..], &["--confirm", "sha256:00"]].concat());
    assert_eq!(wrong.0, Some(1));
    assert_eq!(program.state()["armed"], false);
    until_done(dir, &[&arm[..], &["--confirm", hash.trim()]].concat());
    program.wait_for("compensating");
}

#[test]
fn a_gateway_that_does_not_run_is_named() {
    let dir = tempfile::tempdir().expect("writable");
    let address = free_address();
    for verb in ["arm", "disarm", "acknowledge"] {
        let (status, _, message) = call(dir.path(), &[verb, "--listen", &address]);
        assert_eq!(status, Some(1), "{message}");
        assert!(message.contains(&address), "{message}");
        let (status, _, message) = call(dir.path(), &[verb, "--config", "none.toml"]);
        assert_eq!(status, Some(2), "{message}");
        assert!(message.contains("--listen ADDRESS"), "{message}");
    }
}

#[test]
fn the_service_is_installed_on_request_alone() {
    let dir = tempfile::tempdir().expect("writable");
    let root = dir.path().join("root");
    let install = |more: &[&str]| {
        let install = ["service", "install", "--root", path(&root)];
        done(dir.path(), &[&install[..], more].concat())
    };
    let dry = install(&[]);
    assert!(dry.contains("Nothing is changed"), "{dry}");
    assert!(!root.exists());
    install(&["--yes"]);
    install(&["mill-1", "--yes"]);
    let debian = Path::new(env!("CARGO_MANIFEST_DIR")).join("debian");
    for unit in ["volcomp-gateway.service", "volcomp-gateway@.service"] {
        let packaged = fs::read_to_string(debian.join(unit)).expect("there");
        let installed = fs::read_to_string(root.join("etc/systemd/system").join(unit));
        let installed = installed.expect("installed");
        assert_eq!(installed.replace("/usr/local/bin/", "/usr/bin/"), packaged);
        assert!(installed.contains("ExecStart=/usr/local/bin/volcomp-gateway "));
    }
    let program = root.join("usr/local/bin/volcomp-gateway");
    assert_eq!(mode(&program), 0o755);
    let version = Command::new(&program).arg("--version").output();
    assert!(version.expect("it runs").status.success());
    for folder in ["etc/volcomp", "etc/volcomp/mill-1"] {
        let tokens = root.join(folder).join("tokens");
        assert_eq!(mode(&tokens), 0o600);
        Tokens::load(Some(&tokens)).expect("valid");
        fs::write(tokens, "# mine\n").expect("ours");
    }
    let again = install(&["mill-1", "--yes"]);
    assert!(again.contains("replace ") && again.contains("keep "), "{again}");
    let tokens = fs::read_to_string(root.join("etc/volcomp/mill-1/tokens"));
    assert_eq!(tokens.expect("kept"), "# mine\n");
    let (status, _, message) = call(dir.path(), &["service", "install", "a/b"]);
    assert_eq!(status, Some(2));
    assert!(message.contains("expected letters"), "{message}");
}

#[test]
fn completions_know_the_commands() {
    let dir = tempfile::tempdir().expect("writable");
    for shell in ["bash", "zsh", "fish"] {
        let script = done(dir.path(), &["completions", shell]);
        for word in ["acknowledge", "rehearse", "token-file"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
}

/// The simulated control and its latest report line.
struct Control {
    _running: Running,
    address: String,
    report: Arc<Mutex<Option<Value>>>,
}

impl Control {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let (running, line, output) = Running::start_and_hear(
            Command::new(simulator())
                .args(arguments)
                .args(["--listen", "127.0.0.1:0", "--json", "--report-s", "0.1"])
                .current_dir(folder)
                .stdin(Stdio::null()),
        );
        let address = line.strip_prefix("listening on ");
        let address = address.unwrap_or_else(|| panic!("it says {line:?}"));
        let report = Arc::default();
        let control =
            Self { _running: running, address: address.to_owned(), report: Arc::clone(&report) };
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                let found = serde_json::from_str(&line).ok();
                *report.lock().expect("no panic") = found;
            }
        });
        control
    }

    fn report(&self) -> Option<Value> {
        self.report.lock().expect("no panic").clone()
    }

    /// Tool error without and with the correction, µm.
    fn misses_um(&self) -> Option<[f64; 2]> {
        let report = self.report()?;
        let length = |name: &str| {
            let vector = report[name]["position_um"].as_array()?;
            let squares = vector.iter().map(|x| x.as_f64().map(|x| x * x));
            squares.sum::<Option<f64>>().map(f64::sqrt)
        };
        Some([length("error")?, length("residual")?])
    }
}

/// Path of the simulator in the folder of the tested gateway. The simulator is built if it is missing.
pub(crate) fn simulator() -> PathBuf {
    let gateway = Path::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    let folder = gateway.parent().expect("a folder");
    let simulator = folder.join("focas-sim");
    if !simulator.is_file() {
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            Some("debug") | None => "dev",
            Some(name) => name,
        };
        let built = Command::new(env!("CARGO"))
            .args(["build", "--locked", "-p", "focas-sim", "--profile", profile])
            .env("CARGO_TARGET_DIR", folder.parent().expect("a folder"))
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status();
        assert!(built.is_ok_and(|status| status.success()));
    }
    simulator
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Arguments of the first command `cargo run --bin PROGRAM -- …` in the comments of a configuration.
fn arguments<'a>(text: &'a str, program: &str) -> Vec<&'a str> {
    let begins = format!("#     cargo run --bin {program} -- ");
    let command = text.lines().find_map(|line| line.strip_prefix(&begins));
    let command = command.unwrap_or_else(|| panic!("no line begins with {begins}"));
    command.split_whitespace().collect()
}

pub(crate) fn copied_examples() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("writable");
    let examples = dir.path().join("examples");
    std::fs::create_dir(&examples).expect("writable");
    for entry in std::fs::read_dir(root().join("examples")).expect("there") {
        let file = entry.expect("readable").path();
        if file.is_file() {
            let copy = examples.join(file.file_name().expect("a name"));
            std::fs::copy(&file, copy).expect("writable");
        }
    }
    (dir, examples)
}

/// Runs both programs by the commands in the comments of the configuration, on free ports. The residual must be below a
/// fifth of the error.
fn rehearse(configuration: &str) {
    let (dir, examples) = copied_examples();
    let file = examples.join(configuration);
    let text = std::fs::read_to_string(&file).expect("readable");
    let control = Control::start(dir.path(), &arguments(&text, "focas-sim"));
    change(&file, "127.0.0.1:8193", &control.address);
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command.current_dir(dir.path());
    let gateway = Program::spawn(command, dir.path(), &arguments(&text, "volcomp-gateway"));
    gateway.wait_for("compensating");
    let seen = Mutex::new(Vec::new());
    let reached = gateway.wait(|_| {
        let Some(misses) = control.misses_um() else {
            return false;
        };
        seen.lock().expect("no panic").push(misses);
        // The comparison needs a position with a large error.
        misses[0] > 20.0 && misses[1] < 0.2 * misses[0]
    });
    assert!(reached.is_ok(), "µm without and with correction: {seen:?}\n{}", gateway.log());
}

#[test]
fn three_axes_as_shipped() {
    rehearse("gateway.toml");
}

#[test]
fn five_axes_as_shipped() {
    rehearse("gateway-five-axis.toml");
}
