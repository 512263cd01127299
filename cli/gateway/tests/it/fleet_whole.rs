//! The whole fleet: the centre's program, command line and web interface, a real `nats-server`, and gateways.
//!
//! The server runs on the configuration that `nats-config` prints. The machines of the gateways are simulated.

use std::{
    io::Write,
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use clap::Parser;
use serde_json::{Value, json};
use volcomp_centre::command::Arguments;
use volcomp_fleet::server::program;
use volcomp_test_support::{Running, until};
use volcomp_vocabulary::PerChannel;

use crate::{
    audit::preloaded,
    fleet_bench::{Member, compensating, corrects_y, goes_on, wait},
    manual::{no_step, says, served_configuration},
    program::{Client, MACHINE, answer, exchange},
};

/// The command line of the centre rolls a model out, which reaches the axes on a ramp. A large change waits for
/// confirmation by the operator. The machine is disabled and enabled, and the page shows the reported state.
#[test]
fn a_model_goes_from_the_centre_to_the_axes() {
    let Some(whole) = Whole::start(&[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    corrects_y(&program, -20.0);
    let received = whole.machine_is("it reports", "mill-1", |one| {
        one["live"]["condition"]["state"] == "compensating"
    });
    // The centre has the axes in the gateway's order.
    let state = program.state();
    assert_eq!(received["axes"], state["machine"]["axes"], "{received}");
    assert_eq!(received["structure"], state["machine"]["structure"], "{received}");

    let model = machine_text("small", 25.0);
    let rollout = whole.roll_out(&model, &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -25.0);
    let one = whole.machine_is("its answer is stored", "mill-1", |one| {
        one["version"]["outcome"]["outcome"] == "activated"
    });
    assert_eq!(one["version"]["version"], 1);
    let one = whole.machine_is("it reports its model", "mill-1", |one| {
        one["live"]["version"] == 1 && one["live"]["condition"]["correction_um"]["Y"] == -25.0
    });
    // The centre and the gateway identify the model by the same checksum.
    let models = whole.document("model list --json");
    assert_eq!(models[0]["checksum"], one["live"]["model"], "{models}");

    let rollout = whole.roll_out(&machine_text("small", 100.0), &["mill-1"]);
    let ask = format!("rollout status {rollout} --json");
    let asks = whole.wait("a confirmation is requested", &ask, |document| {
        document[0]["turns"][0]["step"] == "needs-confirmation"
    });
    let turn = &asks[0]["turns"][0];
    assert_eq!(turn["worst_um"], "75.0");
    let hash = turn["hash"].as_str().expect("a hash");
    let status = whole.done(&format!("rollout status {rollout}"));
    assert!(status.contains(hash) && status.contains("75.0 µm"), "{status}");
    whole.wait("an alarm reports it", "alarms --json", |alarms| {
        alarms.to_string().contains("needs-confirmation")
    });
    corrects_y(&program, -25.0);
    whole.done(&format!("rollout confirm {rollout} mill-1 {hash}"));
    whole.is_in(rollout, "done");
    corrects_y(&program, -100.0);

    whole.done("machine disable mill-1");
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    wait(&program, "it is ramped out", |_| program.gateway().shifts() == PerChannel::ZERO);
    whole.machine_is("the centre hears it", "mill-1", |one| {
        one["enable"] == false && one["live"]["condition"]["state"] == "disarmed"
    });
    whole.done("machine enable mill-1");
    program.wait_for("compensating");
    corrects_y(&program, -100.0);
    page_shows(&whole, &program);
    no_step(&program.stop());
    let log = whole.done("audit");
    assert!(log.contains("rollout.start") && log.contains("anna"), "{log}");
}

/// The page shows the reports of a gateway: its condition, its full state, its audit records, and its versions.
fn page_shows(whole: &Whole, program: &Client) {
    let cookie = whole.log_in();
    whole.machine_is("it runs what it shall", "mill-1", |one| {
        one["live"]["version"] == one["version"]["version"]
            && one["live"]["condition"]["state"] == "compensating"
    });
    let mut page = Value::Null;
    volcomp_test_support::until("the page shows it", LONG, || {
        page = whole.page(&cookie, "/api/machines/mill-1");
        page["telemetry"]["state"]["fleet"]["version"] == program.state()["fleet"]["version"]
            && page["silent"] == false
    });
    let own = program.state();
    let telemetry = &page["telemetry"]["state"];
    assert_eq!(telemetry["machine"], own["machine"], "{page}");
    let named = |record: &Value, what: &str| record["record"]["body"].to_string().contains(what);
    let records = page["records"].as_array().expect("a list");
    for what in ["reload", "disabled by the centre", "compensating"] {
        let found = records.iter().any(|record| named(record, what));
        assert!(found, "no record of {what}: {records:?}");
    }
    volcomp_test_support::until("the overview shows it", LONG, || {
        whole.page(&cookie, "/api/overview")["machines"][0]["state"] == "compensating"
    });
    let history = whole.page(&cookie, "/api/machines/mill-1/history?resolution=raw&hours=1");
    let points = history["points"].as_array().expect("a list");
    let corrected = |um: f64| points.iter().any(|point| point["correction_um"]["Y"] == um);
    assert!(corrected(-25.0) && corrected(-100.0), "{history}");
}

/// A fault of the guard raises an alarm with its reason. A gateway that has ended raises an alarm for its silence.
#[test]
fn faults_and_silence_raise_alarms() {
    let Some(whole) = Whole::start(&[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let faulted = program.gateway().fault();
    let reason = faulted["reasons"][0].as_str().expect("a reason");
    let has = |alarms: &Value, kind: &str, words: &str| {
        let mut alarms = alarms.as_array().expect("a list").iter();
        alarms.any(|alarm| {
            alarm["machine"] == "mill-1"
                && alarm["kind"] == kind
                && alarm["text"].as_str().is_some_and(|text| text.contains(words))
        })
    };
    whole.wait("the fault is reported", "alarms --json", |alarms| has(alarms, "faulted", reason));
    let cookie = whole.log_in();
    assert!(has(&whole.page(&cookie, "/api/alarms"), "faulted", reason));
    program.stop();
    whole.wait("the silence is reported", "alarms --json", |alarms| {
        has(alarms, "silent", "No condition is received")
    });
    let said = whole.done("alarms");
    assert!(said.contains("mill-1: silent"), "{said}");
}

#[test]
fn the_wrong_machine_is_refused_with_the_reason() {
    // The file orders its axes differently from the gateway's X, Y, Z.
    let swapped = |eyx_um| {
        let text = machine_text("other", eyx_um);
        let x = "[axes.X]\ntravel = [0.0, 800.0]\n";
        let y = "[axes.Y]\ntravel = [0.0, 400.0]\n";
        text.replace(&format!("{x}{y}"), &format!("{y}{x}")).replace("w X' b Y Z t", "w Y b X Z t")
    };
    let with_c = |eyx_um| {
        let text = machine_text("turns", eyx_um);
        text.replace("w X' b Y Z t", "w C' X' b Y Z t")
            .replace("[errors]\n", "[axes.C]\ntravel = [0.0, 360.0]\n[errors]\n")
    };
    let (order, names) = (swapped(20.0), with_c(20.0));
    let machines = [
        ("serial", "4712", MACHINE),
        ("order", "4711", order.as_str()),
        ("names", "4711", names.as_str()),
    ];
    let Some(whole) = Whole::start(&machines) else {
        return;
    };
    for (name, model, words) in [
        (
            "serial",
            machine_text("small", 25.0),
            r#"meant for the serial number "4712", this machine has "4711""#,
        ),
        ("order", swapped(25.0), "meant for the axes [Y, X, Z], this machine has [X, Y, Z]"),
        ("names", with_c(25.0), "meant for the axes [C, X, Y, Z], this machine has [X, Y, Z]"),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let config = whole.member(dir.path(), (name, "4711"));
        let program = compensating(&config);
        corrects_y(&program, -20.0);
        let rollout = whole.roll_out(&model, &[name]);
        let stopped = whole.is_in(rollout, "stopped");
        let why = stopped["phase"]["why"].as_str().expect("a text");
        assert!(why.contains(name) && why.contains(words), "{why}");
        // The status, the alarms and the machine's audit log state the reason.
        let status = whole.done(&format!("rollout status {rollout}"));
        assert!(status.contains(words), "{status}");
        whole.wait("an alarm reports it", "alarms --json", |alarms| {
            let mut alarms = alarms.as_array().expect("a list").iter();
            alarms.any(|alarm| {
                alarm["kind"] == "refused"
                    && alarm["machine"] == name
                    && alarm["text"].as_str().is_some_and(|text| text.contains(words))
            })
        });
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        let words = words.replace('"', "\\\"");
        assert!(audit.contains(&words), "{words} in {audit}");
        corrects_y(&program, -20.0);
        assert_eq!(program.gateway().shifts()[1], -0.020);
    }
    // A model that does not match the registered machine is not sent.
    let short = whole.add_model(&machine_text("small", 30.0));
    for (name, words) in [("order", "the structure"), ("names", "the structure")] {
        let refused = whole.call(&format!("rollout start --model {short} --machine {name}"));
        assert_eq!(refused.status, Some(2), "{}", refused.err);
        assert!(refused.err.contains(words) && refused.err.contains(name), "{}", refused.err);
    }
}

/// The disk of the centre's database hangs during a roll-out. Machines continue to correct, and the page reports the
/// disk. Afterwards the roll-out resumes, and no message is lost.
#[test]
fn a_hanging_disk_of_the_centre_delays_no_machine() {
    let at = tempfile::tempdir().expect("writable");
    let Some(library) = preloaded(at.path()) else {
        return;
    };
    let hangs = at.path().join("hangs");
    let environment = vec![("LD_PRELOAD", library), ("HANGS", hangs.clone())];
    let place = Place { environment, ..Place::default() };
    let Some(whole) = Whole::start_at(place, &[("mill-1", "4711", MACHINE)]) else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let rollout = whole.roll_out(&machine_text("small", 22.0), &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -22.0);
    let cookie = whole.log_in();
    let short = whole.add_model(&machine_text("small", 25.0));
    std::fs::write(&hangs, "").expect("writable");
    let waits = |overview: &Value| {
        let mut alarms = overview["centre"].as_array().expect("a list").iter();
        alarms.any(|alarm| {
            alarm["text"].as_str().is_some_and(|text| text.contains("has not completed a change"))
        })
    };
    volcomp_test_support::until("its page reports it", LONG, || {
        waits(&whole.page(&cookie, "/api/overview"))
    });
    let before = program.state();
    let count = |state: &Value| state["cycle"]["count"].as_u64().expect("a count");
    wait(&program, "it is corrected on", |state| {
        goes_on(state, -22.0);
        count(state) > count(&before) + 1000
    });
    assert_eq!(program.state()["fleet"]["waiting"], Value::Null);
    std::fs::remove_file(&hangs).expect("ours");
    whole.done(&format!("rollout start --model {short} --machine mill-1"));
    whole.is_in(rollout + 1, "done");
    corrects_y(&program, -25.0);
    volcomp_test_support::until("its page reports the end", LONG, || {
        !waits(&whole.page(&cookie, "/api/overview"))
    });
    let one = whole.machine("mill-1");
    assert_eq!(one["live"]["lost"], 0, "{one}");
    no_step(&program.stop());
}

/// The centre is killed between the first and the second machine of a roll-out. After its restart each machine gets its
/// version once.
#[test]
fn a_killed_centre_resumes_its_roll_out() {
    let names = ["mill-1", "mill-2"];
    let Some(mut whole) = Whole::start(&names.map(|name| (name, "4711", MACHINE))) else {
        return;
    };
    let folders = names.map(|_| tempfile::tempdir().expect("writable"));
    let mut programs = Vec::new();
    for (name, dir) in names.iter().zip(&folders) {
        let config = whole.member(dir.path(), (name, "4711"));
        programs.push(compensating(&config));
    }
    for name in names {
        whole.machine_is("it reports", name, |one| {
            one["live"]["condition"]["state"] == "compensating"
        });
    }
    let short = whole.add_model(&machine_text("small", 25.0));
    // The soak time is long enough for a kill in between, even on a slow computer.
    whole.done(&format!(
        "rollout start --model {short} --machine mill-1 --machine mill-2 --soak-s 15"
    ));
    wait(&programs[0], "the first has it", |state| state["fleet"]["version"] == 1);
    whole.kill();
    let status = whole.document("rollout status 1 --json");
    assert_eq!(status[0]["phase"]["is"], "running", "{status}");
    assert_eq!(programs[1].state()["fleet"]["version"], 0);
    // Machines continue, and their messages wait at the server.
    std::thread::sleep(Duration::from_secs(3));
    corrects_y(&programs[0], -25.0);
    corrects_y(&programs[1], -20.0);
    whole.run();
    whole.is_in(1, "done");
    for (name, program) in names.iter().zip(&programs) {
        corrects_y(program, -25.0);
        let one = whole.machine_is("its answer is stored", name, |one| {
            one["version"]["outcome"]["outcome"] == "activated"
        });
        assert_eq!(one["version"]["version"], 1, "once: {one}");
        assert_eq!(one["live"]["lost"], 0, "{one}");
        assert_eq!(whole.machine(name)["live"]["version"], 1);
    }
    // Each machine has activated the version once.
    for dir in &folders {
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        assert_eq!(audit.matches("\"what\":\"reload\"").count(), 1, "{audit}");
    }
}

/// Timeout of all waits; long enough for a slow computer.
pub(crate) const LONG: Duration = Duration::from_secs(90);
/// Environment variable with the centre's arguments; if set, this test program acts as the centre.
const CALL: &str = "VOLCOMP_TEST_CENTRE_CALL";
/// Line before the output of the centre.
const MARK: &str = "-- the centre --";
const PASSWORD: &str = "an unknown horse";

/// Acts as `volcomp-centre`. Cargo builds only the programs of this package, so the test program takes the place of
/// that program.
#[test]
#[ignore = "the other tests start this one as the program of the centre"]
fn the_centre() {
    let Ok(call) = std::env::var(CALL) else {
        return;
    };
    println!("\n{MARK}");
    let arguments = ["volcomp-centre"].into_iter().chain(call.lines());
    let status = match Arguments::parse_from(arguments).act() {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {error}");
            error.status()
        }
    };
    std::process::exit(i32::from(status));
}

/// Where the centre, its server and its page run: on this computer, or in another network namespace.
#[derive(Clone, Default)]
pub(crate) struct Place {
    /// Command prefix for starting programs; may be empty.
    through: Vec<String>,
    /// Addresses of server and page; `None`: free addresses of this computer.
    addresses: Option<[String; 2]>,
    /// Lines appended to the server's configuration.
    server: &'static str,
    /// Environment variables of the running centre.
    pub(crate) environment: Vec<(&'static str, PathBuf)>,
}

impl Place {
    /// A place in another network namespace, entered by this command.
    pub(crate) fn elsewhere(
        through: &[&str],
        [server, page]: [&str; 2],
        configured: &'static str,
    ) -> Self {
        Self {
            through: through.iter().map(|&word| word.to_owned()).collect(),
            addresses: Some([server.to_owned(), page.to_owned()]),
            server: configured,
            ..Self::default()
        }
    }

    fn command(&self, program: &Path) -> Command {
        let Some((first, more)) = self.through.split_first() else {
            return Command::new(program);
        };
        let mut command = Command::new(first);
        command.args(more).arg(program);
        command
    }

    /// Sends bytes to an address at this place. Returns all bytes received until the peer closes the connection.
    fn exchange(&self, address: SocketAddr, bytes: &[u8]) -> String {
        if self.through.is_empty() {
            return exchange(address, bytes);
        }
        // A shell connects from inside the namespace, because this program cannot.
        let (ip, port) = (address.ip(), address.port());
        let script = format!("exec 3<>/dev/tcp/{ip}/{port} && cat >&3 && cat <&3");
        let mut child = (self.command(Path::new("bash")).args(["-c", &script]))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let mut stdin = child.stdin.take().expect("piped");
        // The peer may close during the write.
        let _ = stdin.write_all(bytes);
        drop(stdin);
        let output = child.wait_with_output().expect("it ends");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    fn listens(&self, address: SocketAddr) -> bool {
        let script = format!("exec 3<>/dev/tcp/{}/{}", address.ip(), address.port());
        if self.through.is_empty() {
            return TcpStream::connect(address).is_ok();
        }
        let tried =
            (self.command(Path::new("bash")).args(["-c", &script])).stderr(Stdio::null()).status();
        tried.is_ok_and(|status| status.success())
    }
}

fn centre(place: &Place, folder: &Path, arguments: &[&str]) -> Command {
    let mut command = place.command(&std::env::current_exe().expect("this program"));
    command
        .current_dir(folder)
        .args(["--exact", "fleet_whole::the_centre"])
        .args(["--ignored", "--nocapture", "--test-threads=1"])
        .env(CALL, arguments.join("\n"));
    command
}

pub(crate) struct Called {
    pub(crate) status: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// A registered machine: name, serial number, machine file.
pub(crate) type Registered<'a> = (&'a str, &'a str, &'a str);

/// The folder of a centre, its server, and its program if running.
pub(crate) struct Whole {
    folder: tempfile::TempDir,
    place: Place,
    url: String,
    page: SocketAddr,
    /// Public part of the signing key, base64.
    key: String,
    _server: Running,
    centre: Option<Running>,
}

impl Whole {
    /// A running server and centre with these machines. `None` if no server is installed, which is a failure under CI.
    pub(crate) fn start(machines: &[Registered<'_>]) -> Option<Self> {
        Self::start_at(Place::default(), machines)
    }

    /// Like [`start`](Self::start), at another place.
    pub(crate) fn start_at(place: Place, machines: &[Registered<'_>]) -> Option<Self> {
        let Some(server) = program() else {
            volcomp_test_support::peers::not_run("nats-server");
            return None;
        };
        let folder = tempfile::tempdir().expect("writable");
        let at = folder.path();
        let free = || [(); 2].map(|()| volcomp_test_support::free_address());
        let [listen, page] = place.addresses.clone().unwrap_or_else(free);
        let url = format!("nats://{listen}");
        // The permitted residual is raised: on a busy computer a late cycle leaves a residual that must not stop a
        // roll-out here.
        let text = format!(
            "[nats]\nurl = \"{url}\"\n[server]\nlisten = \"{listen}\"\n[page]\nlisten = \"{page}\"\n[rollout]\nsoak_s = 2\nresidual_um = 1000\n"
        );
        std::fs::write(at.join("centre.toml"), text).expect("writable");
        let done = |arguments: &str| call(&place, at, arguments, "").done();
        let key = done("key new main");
        let key = key.trim().strip_prefix("main ").expect("its name").to_owned();
        done("key nkey centre.nkey");
        for (name, serial, model) in machines {
            std::fs::write(at.join("machine.toml"), model).expect("writable");
            done(&format!(
                "machine add {name} --site berlin --serial {serial} --like machine.toml --new-nkey {name}.nkey --condition-s 1 --telemetry-s 1"
            ));
        }
        let conf = at.join("nats.conf");
        std::fs::write(&conf, done("nats-config") + place.server).expect("writable");
        let log = std::fs::File::create(at.join("nats.log")).expect("writable");
        let server = Running::start(
            (place.command(&server)).arg("-c").arg(&conf).stdout(Stdio::null()).stderr(log),
        );
        let address: SocketAddr = listen.parse().expect("an address");
        until("the server listens", LONG, || place.listens(address));
        call(&place, at, "user add anna --role admin", PASSWORD).done();
        let mut whole = Self {
            place,
            url,
            page: page.parse().expect("an address"),
            key,
            _server: server,
            centre: None,
            folder,
        };
        whole.run();
        Some(whole)
    }

    pub(crate) fn run(&mut self) {
        let log = std::fs::File::options()
            .create(true)
            .append(true)
            .open(self.folder.path().join("centre.log"))
            .expect("writable");
        let mut command = centre(&self.place, self.folder.path(), &["run"]);
        command.envs(self.place.environment.iter().map(|(key, value)| (key, value)));
        self.centre = Some(Running::start(command.stdout(Stdio::null()).stderr(log)));
        until("its page answers", LONG, || self.place.listens(self.page));
    }

    /// Kills the centre's program, as in a power failure.
    pub(crate) fn kill(&mut self) {
        self.centre = None;
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("centre.log")).unwrap_or_default()
    }

    pub(crate) fn call(&self, arguments: &str) -> Called {
        call(&self.place, self.folder.path(), arguments, "")
    }

    pub(crate) fn done(&self, arguments: &str) -> String {
        self.call(arguments).done()
    }

    pub(crate) fn document(&self, arguments: &str) -> Value {
        let text = self.done(arguments);
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{arguments}: {e}: {text}"))
    }

    /// Waits until the document printed by this call satisfies the condition.
    pub(crate) fn wait(&self, what: &str, arguments: &str, is: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + LONG;
        loop {
            let document = self.document(arguments);
            if is(&document) {
                return document;
            }
            let log = || self.log();
            assert!(Instant::now() < end, "{what}: {document:#}\n{}", log());
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Adds a model, and starts its roll-out. Returns the number of the roll-out.
    pub(crate) fn roll_out(&self, model: &str, machines: &[&str]) -> u64 {
        let short = self.add_model(model);
        let mut call = format!("rollout start --model {short}");
        for machine in machines {
            call.push_str(" --machine ");
            call.push_str(machine);
        }
        let said = self.done(&call);
        let number = said.split(' ').nth(1).and_then(|number| number.parse().ok());
        number.unwrap_or_else(|| panic!("it says {said}"))
    }

    /// Adds a model. Returns the first digits of its checksum.
    pub(crate) fn add_model(&self, model: &str) -> String {
        std::fs::write(self.folder.path().join("model.toml"), model).expect("writable");
        let said = self.done("model add model.toml");
        let last = said.lines().last().expect("a line");
        last.split(' ').next().expect("a checksum")[..12].to_owned()
    }

    pub(crate) fn is_in(&self, rollout: u64, phase: &str) -> Value {
        let ask = format!("rollout status {rollout} --json");
        let found = self.wait(&format!("roll-out {rollout}: {phase}"), &ask, |document| {
            document[0]["phase"]["is"] == phase
        });
        found[0].clone()
    }

    pub(crate) fn machine(&self, name: &str) -> Value {
        of(&self.document("machine list --json"), name)
    }

    /// Waits until the entry in `machine list` satisfies the condition.
    pub(crate) fn machine_is(&self, what: &str, name: &str, is: impl Fn(&Value) -> bool) -> Value {
        let all = self.wait(what, "machine list --json", |all| is(&of(all, name)));
        of(&all, name)
    }

    /// The configuration of the gateway of a machine, in a separate folder.
    pub(crate) fn member(&self, dir: &Path, of: (&str, &str)) -> PathBuf {
        let config = served_configuration(dir, "auto_arm = true");
        let seed = self.folder.path().join(format!("{}.nkey", of.0));
        let seed = std::fs::read_to_string(seed).expect("machine add has written it");
        let member = Member {
            url: &self.url,
            machine: of.0,
            serial: of.1,
            seed: seed.trim(),
            key: &self.key,
        };
        member.join(dir, &config);
        config
    }

    /// Sends a request to the page. Returns the whole response.
    fn ask(&self, method: &str, path: &str, more: &str, body: &str) -> String {
        self.place.exchange(
            self.page,
            format!(
                "{method} {path} HTTP/1.1\r\nHost: {}\r\n{more}Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
                self.page,
                body.len()
            )
            .as_bytes(),
        )
    }

    pub(crate) fn log_in(&self) -> String {
        let body = json!({ "name": "anna", "password": PASSWORD }).to_string();
        let text = self.ask("POST", "/api/login", "X-Volcomp: 1\r\n", &body);
        assert_eq!(answer(&text).status, 200, "{text}");
        let mut lines = text.lines();
        let cookie = lines.find_map(|line| line.strip_prefix("set-cookie: "));
        let cookie = cookie.and_then(|line| line.split(';').next());
        cookie.unwrap_or_else(|| panic!("no cookie: {text}")).to_owned()
    }

    pub(crate) fn page(&self, cookie: &str, path: &str) -> Value {
        let answer = answer(&self.ask("GET", path, &format!("Cookie: {cookie}\r\n"), ""));
        assert_eq!(answer.status, 200, "{path}: {}", answer.body);
        answer.json()
    }
}

fn of(all: &Value, name: &str) -> Value {
    let mut all = all.as_array().expect("a list").iter();
    let found = all.find(|one| one["machine"] == name);
    found.cloned().unwrap_or_else(|| panic!("no {name}"))
}

fn call(place: &Place, folder: &Path, arguments: &str, input: &str) -> Called {
    let arguments: Vec<&str> =
        ["--by", "anna"].into_iter().chain(arguments.split_whitespace()).collect();
    let mut child = centre(place, folder, &arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("this program");
    let mut stdin = child.stdin.take().expect("piped");
    // A program that does not read its input may already have ended.
    let _ = writeln!(stdin, "{input}");
    drop(stdin);
    let output = child.wait_with_output().expect("it ends");
    let out = String::from_utf8_lossy(&output.stdout).into_owned();
    let (_, out) = out.split_once(&format!("{MARK}\n")).unwrap_or(("", ""));
    Called {
        status: output.status.code(),
        out: out.to_owned(),
        err: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

impl Called {
    fn done(self) -> String {
        assert_eq!(self.status, Some(0), "{}{}", self.out, self.err);
        self.out
    }
}

/// The machine file of the gateways with a straightness EYX of `eyx_um`, µm.
pub(crate) fn machine_text(name: &str, eyx_um: f64) -> String {
    MACHINE
        .replace("EYX = 20.0", &format!("EYX = {eyx_um:.1}"))
        .replace("name = \"small\"", &format!("name = \"{name}\""))
}
