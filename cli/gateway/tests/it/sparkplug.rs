//! The edge node of Sparkplug B, against a broker and a host application that are not ours.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{ChildStdin, Command, Stdio},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, channel},
    },
    thread,
    time::{Duration, Instant, SystemTime},
};

use serde_json::{Value, json};
use volcomp_gateway::{
    config::Deadbands,
    interop::{
        quantities::Shape,
        sparkplug::node::{Names, Node},
    },
};
use volcomp_test_support::{Running, free_port, peers};
use volcomp_vocabulary::AxisName;

use crate::{
    controlled::{configuration, control},
    interop::status,
    program::{Program, append, path},
};

const PATIENCE: Duration = Duration::from_secs(60);
const MOSQUITTO: &str = "/usr/sbin/mosquitto";
/// The topics behind the kind of a message.
const NODE: &str = "mill-gateway";

/// A broker that ends with the test.
struct Broker {
    running: Running,
    port: u16,
    file: PathBuf,
}

impl Broker {
    /// A broker with these lines in its configuration; `None` where there is none on this computer.
    fn start(dir: &Path, more: &str) -> Option<Self> {
        if !Path::new(MOSQUITTO).exists() {
            peers::not_run("mosquitto");
            return None;
        }
        let port = free_port();
        let file = dir.join("mosquitto.conf");
        let text = format!("user root\npersistence false\nlistener {port} 127.0.0.1\n{more}\n");
        std::fs::write(&file, text).expect("writable");
        let running = Self::run(&file, port);
        Some(Self {
            running,
            port,
            file,
        })
    }

    fn run(file: &Path, port: u16) -> Running {
        let log = std::fs::File::create(file.with_extension("log")).expect("writable");
        let running = Running::start(
            Command::new(MOSQUITTO)
                .arg("-c")
                .arg(file)
                .stdout(Stdio::null())
                .stderr(log),
        );
        let end = Instant::now() + PATIENCE;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            let told = || std::fs::read_to_string(file.with_extension("log"));
            assert!(Instant::now() < end, "no broker: {:?}", told());
            thread::sleep(Duration::from_millis(20));
        }
        running
    }

    fn again(&mut self) {
        self.running = Self::run(&self.file, self.port);
    }
}

/// The host application: every message that it has heard and nobody has looked at.
struct Host {
    _running: Running,
    commands: ChildStdin,
    told: Receiver<Value>,
}

impl Host {
    fn start(port: u16, more: &[&str]) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/sparkplug.py");
        let mut running = Running::start(
            Command::new(peers::python()?)
                .arg(script)
                .arg(port.to_string())
                .args(more)
                .stdin(Stdio::piped())
                .stdout(Stdio::piped()),
        );
        let commands = running.stdin.take().expect("piped");
        let lines = BufReader::new(running.stdout.take().expect("piped")).lines();
        let (tell, told) = channel();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let message = serde_json::from_str(&line).expect("JSON");
                if tell.send(message).is_err() {
                    return;
                }
            }
        });
        let host = Self {
            _running: running,
            commands,
            told,
        };
        host.next("ready", |_| true);
        Some(host)
    }

    /// The next message on a topic that fits; those before it are given up.
    fn next(&self, topic: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let rest = end.saturating_duration_since(Instant::now());
            let message = self.told.recv_timeout(rest);
            let message = message.unwrap_or_else(|e| panic!("{topic}: {e}"));
            if message["topic"] == topic && fits(&message) {
                return message;
            }
        }
    }

    fn says(&mut self, command: &str) {
        writeln!(self.commands, "{command}").expect("it reads");
    }
}

fn topic(kind: &str) -> String {
    let device = if kind.starts_with('D') { "/small" } else { "" };
    format!("spBv1.0/shop/{kind}/{NODE}{device}")
}

fn with_table(config: &Path, port: u16, more: &str) {
    let table = format!(
        "\n[sparkplug]\nurl = \"mqtt://127.0.0.1:{port}\"\ngroup = \"shop\"\nnode = \"{NODE}\"\ninterval_ms = 100\n{more}\n"
    );
    append(config, &table);
}

fn value<'a>(message: &'a Value, name: &str) -> &'a Value {
    let metric = &message["metrics"][name];
    assert!(metric.is_object(), "{name} in {message}");
    &metric["value"]
}

/// What comes after a birth: every number follows the one before, and what changes is told, until it moved and is armed.
fn follows(host: &Host, born: &Value, device: &Value) {
    let told = |metric: &Value| {
        (
            metric["value"].clone(),
            metric["properties"]["Quality"].clone(),
        )
    };
    let mut z = told(&device["metrics"]["Axes/Z/Position"]);
    let (mut last, mut moves) = (1, 0);
    let mut is_armed = value(born, "Gateway/Armed") == true;
    while !(is_armed && moves > 3) {
        let message = host.told.recv_timeout(PATIENCE).expect("it goes on");
        let seq = message["seq"].as_u64().expect("a number");
        assert_eq!(seq, (last + 1) % 256, "{message}");
        last = seq;
        let metrics = message["metrics"].as_object().expect("metrics");
        assert!(!metrics.is_empty());
        assert!(!metrics.contains_key("Gateway/Machine"), "{message}");
        // Z stands: it is told once it is known, and not again as it was.
        if let Some(metric) = metrics.get("Axes/Z/Position") {
            let now = told(metric);
            assert_ne!(now, z, "it does not change: {message}");
            z = now;
        }
        is_armed |= metrics
            .get("Gateway/Armed")
            .is_some_and(|armed| armed["value"] == true);
        moves += u32::from(metrics.contains_key("Axes/X/Position"));
    }
}

#[test]
fn a_host_hears_birth_data_and_what_is_not_known() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(broker) = Broker::start(dir.path(), "allow_anonymous true") else {
        return;
    };
    let Some(mut host) = Host::start(broker.port, &[]) else {
        return;
    };
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    with_table(&config, broker.port, "");
    let program = Program::start(dir.path(), &["--config", path(&config)]);

    let born = host.next(&topic("NBIRTH"), |_| true);
    assert_eq!(
        (&born["seq"], &born["qos"], &born["retain"]),
        (&json!(0), &json!(0), &json!(false))
    );
    let life = value(&born, "bdSeq").clone();
    assert!(life.as_u64().is_some_and(|life| life < 256), "{life}");
    assert_eq!(value(&born, "Node Control/Rebirth"), false);
    assert_eq!(value(&born, "Gateway/Machine"), "small");
    assert_eq!(
        born["metrics"]["Gateway/Age"]["properties"]["engUnit"],
        "ms"
    );
    let device = host.next(&topic("DBIRTH"), |_| true);
    assert_eq!(device["seq"], 1);
    for name in [
        "Axes/X/Position",
        "Axes/Y/Correction",
        "Axes/Z/Wanted",
        "Tool/Error",
    ] {
        assert!(device["metrics"][name].is_object(), "{name} in {device}");
    }
    follows(&host, &born, &device);
    // Births of the same life, until the correction has come in: the machine file has -20 µm on Y.
    let end = Instant::now() + PATIENCE;
    loop {
        host.says(&format!("rebirth {}", topic("NCMD")));
        let again = host.next(&topic("NBIRTH"), |_| true);
        assert_eq!((&again["seq"], value(&again, "bdSeq")), (&json!(0), &life));
        let device = host.next(&topic("DBIRTH"), |_| true);
        assert_eq!(device["seq"], 1);
        let metric = &device["metrics"]["Axes/Y/Correction"];
        assert_eq!(metric["properties"]["engUnit"], "µm");
        if (&metric["value"], &metric["properties"]["Quality"]) == (&json!(-20.0), &json!(192)) {
            break;
        }
        assert!(Instant::now() < end, "{device}");
    }

    // Nothing else that comes over this way does anything.
    for command in [
        format!("garbage {}", topic("NCMD")),
        format!("write {} Gateway/Armed", topic("NCMD")),
        format!("write {} Node Control/Disarm", topic("NCMD")),
        format!("write {} Axes/Y/Correction", topic("DCMD")),
        format!("rebirth {}", topic("DCMD")),
    ] {
        host.says(&command);
    }
    // It has heard all of them when it answers this one.
    host.says(&format!("rebirth {}", topic("NCMD")));
    let again = host.next(&topic("NBIRTH"), |_| true);
    assert_eq!(
        (value(&again, "Gateway/Armed"), value(&again, "bdSeq")),
        (&json!(true), &life)
    );

    // Without its control.
    drop(control);
    // In one message or in two, as the moments fall.
    let mut known = [true; 2];
    while known != [false; 2] {
        let message = host.next(&topic("DDATA"), |message| message["seq"].is_u64());
        for (known, name) in known
            .iter_mut()
            .zip(["Axes/X/Position", "Axes/Y/Correction"])
        {
            if let Some(metric) = message["metrics"].get(name) {
                *known = metric["properties"]["Quality"] == 192;
                assert!(*known || metric["null"] == true || metric["properties"]["Quality"] == 500);
            }
        }
    }
    drop(program);
}

#[test]
fn a_gateway_that_is_killed_is_told_dead() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(broker) = Broker::start(dir.path(), "allow_anonymous true") else {
        return;
    };
    let Some(host) = Host::start(broker.port, &[]) else {
        return;
    };
    let control = control();
    let config = configuration(dir.path(), &control, "");
    with_table(&config, broker.port, "");
    for signal in ["KILL", "TERM"] {
        let mut program = Program::start(dir.path(), &["--config", path(&config)]);
        let born = host.next(&topic("NBIRTH"), |_| true);
        program.signal(signal);
        let dead = host.next(&topic("NDEATH"), |_| true);
        assert_eq!(value(&dead, "bdSeq"), value(&born, "bdSeq"));
        assert_eq!(dead["seq"], Value::Null);
        assert!(program.running.ended(PATIENCE).is_some());
    }
}

#[test]
fn after_a_restart_of_the_broker_it_is_born_again() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(mut broker) = Broker::start(dir.path(), "allow_anonymous true") else {
        return;
    };
    let Some(host) = Host::start(broker.port, &[]) else {
        return;
    };
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    with_table(&config, broker.port, "");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let born = host.next(&topic("NBIRTH"), |_| true);
    program.wait_for("compensating");
    broker.running.kill();
    // The gateway goes on as if nothing had happened.
    let before = program.state()["cycle"]["count"].as_u64();
    let turned = program.wait(|state| state["cycle"]["count"].as_u64() > before);
    assert_eq!(turned.expect("it turns")["armed"], true);
    broker.again();
    host.next("ready", |_| true);
    // It may have been born before the host was there; then it is asked for.
    let again = host.next_birth();
    assert_ne!(value(&again, "bdSeq"), value(&born, "bdSeq"));
}

impl Host {
    /// A birth after this host has come back.
    fn next_birth(mut self) -> Value {
        self.says(&format!("rebirth {}", topic("NCMD")));
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            if let Ok(message) = self.told.recv_timeout(Duration::from_secs(1))
                && message["topic"] == topic("NBIRTH")
            {
                return message;
            }
            self.says(&format!("rebirth {}", topic("NCMD")));
        }
        panic!("it is never born");
    }
}

/// A wire to the broker that can be cut without either side seeing it.
struct Wire {
    port: u16,
    is_cut: Arc<AtomicBool>,
    streams: Arc<Mutex<Vec<TcpStream>>>,
}

impl Wire {
    fn to(broker: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let wire = Self {
            port: listener.local_addr().expect("bound").port(),
            is_cut: Arc::default(),
            streams: Arc::default(),
        };
        let (is_cut, streams) = (Arc::clone(&wire.is_cut), Arc::clone(&wire.streams));
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(("127.0.0.1", broker)) else {
                    continue;
                };
                let ends = [(&near, &far), (&far, &near)];
                for (from, to) in ends {
                    let copies = (from.try_clone(), to.try_clone());
                    let (Ok(mut from), Ok(mut to)) = copies else {
                        continue;
                    };
                    let is_cut = Arc::clone(&is_cut);
                    thread::spawn(move || {
                        let mut buffer = [0; 4096];
                        while let Ok(count @ 1..) = from.read(&mut buffer) {
                            if !is_cut.load(Ordering::Relaxed)
                                && to.write_all(&buffer[..count]).is_err()
                            {
                                break;
                            }
                        }
                        // An end is passed on only while the wire is whole.
                        if !is_cut.load(Ordering::Relaxed) {
                            let _ = to.shutdown(Shutdown::Both);
                        }
                    });
                }
                streams.lock().expect("nobody panics").extend([near, far]);
            }
        });
        wire
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        for stream in self.streams.lock().expect("nobody panics").iter() {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

#[test]
fn a_cut_wire_is_told_dead_and_mends_by_itself() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(broker) = Broker::start(dir.path(), "allow_anonymous true") else {
        return;
    };
    let Some(host) = Host::start(broker.port, &[]) else {
        return;
    };
    let wire = Wire::to(broker.port);
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    with_table(&config, wire.port, "keep_alive_s = 4");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let born = host.next(&topic("NBIRTH"), |_| true);
    program.wait_for("compensating");
    wire.is_cut.store(true, Ordering::Relaxed);
    let dead = host.next(&topic("NDEATH"), |_| true);
    assert_eq!(value(&dead, "bdSeq"), value(&born, "bdSeq"));
    assert_eq!(program.state()["armed"], true);
    wire.is_cut.store(false, Ordering::Relaxed);
    let again = host.next(&topic("NBIRTH"), |_| true);
    assert_ne!(value(&again, "bdSeq"), value(&born, "bdSeq"));
}

#[test]
fn with_tls_and_a_password() {
    let dir = tempfile::tempdir().expect("writable");
    let made = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["tls-init", "localhost", "--output", path(dir.path())])
        .output()
        .expect("built");
    assert!(made.status.success());
    let [certificate, key, users, password] =
        ["certificate.pem", "key.pem", "users", "password"].map(|name| dir.path().join(name));
    let more = format!(
        "allow_anonymous false\npassword_file {}\ncertfile {}\nkeyfile {}\n",
        path(&users),
        path(&certificate),
        path(&key)
    );
    if !Path::new(MOSQUITTO).exists() {
        peers::not_run("mosquitto");
        return;
    }
    let added = Command::new("mosquitto_passwd")
        .args(["-b", "-c", path(&users), "gateway", "right word"])
        .status()
        .expect("it comes with the broker");
    assert!(added.success());
    let Some(broker) = Broker::start(dir.path(), &more) else {
        return;
    };
    let login = ["gateway", "right word", path(&certificate)];
    let Some(host) = Host::start(broker.port, &login) else {
        return;
    };
    let control = control();
    let config = configuration(dir.path(), &control, "");
    with_table(
        &config,
        broker.port,
        "user = \"gateway\"\npassword_file = \"password\"\nca = \"certificate.pem\"",
    );
    crate::program::change(&config, "mqtt://127.0.0.1", "mqtts://localhost");
    let write = |text: &str, mode: u32| {
        std::fs::write(&password, text).expect("writable");
        std::fs::set_permissions(&password, std::fs::Permissions::from_mode(mode)).expect("ours");
    };
    write("right word\n", 0o644);
    let check = || {
        let check = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(["check", path(&config)])
            .output()
            .expect("built");
        let text = String::from_utf8_lossy(&check.stderr).into_owned();
        (
            check.status.code(),
            text + &String::from_utf8_lossy(&check.stdout),
        )
    };
    let (status, text) = check();
    assert!(status == Some(2) && text.contains("mode 644"), "{text}");
    write("wrong word\n", 0o600);
    let (status, text) = check();
    assert!(
        status == Some(0) && text.contains("shop/mill-gateway/small"),
        "{text}"
    );
    {
        let program = Program::start(dir.path(), &["--config", path(&config)]);
        let end = Instant::now() + PATIENCE;
        while !program.log().contains("the broker refuses") {
            assert!(Instant::now() < end, "{}", program.log());
            thread::sleep(Duration::from_millis(20));
        }
        assert!(!program.log().contains("wrong word"), "{}", program.log());
    }
    assert!(host.told.try_iter().next().is_none(), "it was let in");
    write("right word\n", 0o600);
    let _program = Program::start(dir.path(), &["--config", path(&config)]);
    host.next(&topic("NBIRTH"), |_| true);
}

fn node() -> Node {
    let shape = Shape {
        machine: "m".to_owned(),
        axes: vec![AxisName::X, AxisName::C],
        sensors: vec!["bed/plate".to_owned(), "column".to_owned()],
        controllers: 1,
    };
    let names = Names {
        group: "g".to_owned(),
        node: "n".to_owned(),
        device: "d".to_owned(),
    };
    Node::new(names, &shape, Deadbands::default(), 255)
}

/// What a message says of metrics: name and value, as the library of another project decodes it.
fn told(message: &volcomp_gateway::interop::sparkplug::node::Message) -> Vec<(String, String)> {
    use srad_types::payload::{Message as _, Payload};
    let payload = Payload::decode(&message.payload[..]).expect("a payload");
    let metrics = payload.metrics.into_iter();
    metrics
        .map(|metric| (metric.name.expect("a name"), format!("{:?}", metric.value)))
        .collect()
}

#[test]
fn only_what_changes_beyond_the_deadband_is_told() {
    let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000);
    let mut node = node();
    let [born, device] = node.birth(&status(&json!({})), now);
    assert_eq!(
        (born.topic.as_str(), device.topic.as_str()),
        ("spBv1.0/g/NBIRTH/n", "spBv1.0/g/DBIRTH/n/d")
    );
    let names: Vec<String> = told(&device).into_iter().map(|(name, _)| name).collect();
    assert!(
        names.contains(&"Temperatures/bed_plate".to_owned()),
        "{names:?}"
    );
    let mut next = |changes: Value| {
        let messages = node.data(&status(&changes), now);
        messages
            .iter()
            .flat_map(told)
            .map(|(name, value)| format!("{name} {value}"))
            .collect::<Vec<_>>()
    };
    assert!(next(json!({})).is_empty());
    assert!(
        next(json!({ "positions_mm": { "X": 400.26 }, "age_ms": 900.0 })).is_empty(),
        "within"
    );
    // Many small steps are told as soon as they are one large one.
    assert_eq!(
        next(json!({ "positions_mm": { "X": 400.27 } })),
        ["Axes/X/Position Some(DoubleValue(400.27))"]
    );
    assert_eq!(
        next(
            json!({ "positions_mm": { "X": 400.27 }, "correction_um": { "X": -11.5 }, "faults": 4 })
        ),
        [
            "Gateway/Faults Some(LongValue(4))",
            "Axes/X/Correction Some(DoubleValue(-11.5))"
        ]
    );
    // The same number of another quality.
    let unconfirmed = json!({
        "positions_mm": { "X": 400.27 }, "correction_um": { "X": -11.5 }, "faults": 4, "correction_known": false,
    });
    assert_eq!(
        next(unconfirmed.clone()),
        [
            "Gateway/CorrectionKnown Some(BooleanValue(false))",
            "Axes/X/Correction Some(DoubleValue(-11.5))",
            "Axes/C/Correction Some(DoubleValue(100.0))"
        ]
    );
    assert!(next(unconfirmed).is_empty());
    let silent = next(json!({
        "state": "unknown", "reasons": ["no cycle for 500 ms"], "correction_known": false, "positions_mm": {},
        "positions_deg": {}, "correction_um": {}, "correction_urad": {},
    }));
    for told in [
        "Gateway/State Some(StringValue(\"unknown\"))",
        "Gateway/Armed None",
        "Axes/X/Position None",
    ] {
        assert!(
            silent.iter().any(|line| line == told),
            "{told} in {silent:?}"
        );
    }
}

#[test]
fn numbers_of_messages_wrap() {
    use srad_types::payload::{Message as _, Payload};
    let now = SystemTime::UNIX_EPOCH;
    let mut node = node();
    node.birth(&status(&json!({})), now);
    let mut last = 1;
    for turn in 0..300 {
        let moved = status(&json!({ "positions_mm": { "X": f64::from(turn) } }));
        for message in node.data(&moved, now) {
            assert_eq!(message.topic, "spBv1.0/g/DDATA/n/d");
            let payload = Payload::decode(&message.payload[..]).expect("a payload");
            assert_eq!(payload.seq, Some((last + 1) % 256));
            last = (last + 1) % 256;
        }
    }
    assert_eq!(last, 301 % 256);
}

/// A command that asks for a birth is one exactly where it says so; nothing else is, whatever it is.
#[test]
fn only_a_request_for_a_birth_is_one() {
    use proptest::prelude::*;
    use srad_types::payload::{Message as _, Metric, Payload, metric};
    let node = node();
    let request = |name: &str, value: metric::Value| {
        let mut metric = Metric::new();
        metric.set_name(name.to_owned()).set_value(value);
        let metrics = vec![metric];
        let payload = Payload {
            timestamp: Some(0),
            metrics,
            seq: None,
            uuid: None,
            body: None,
        };
        payload.encode_to_vec()
    };
    let yes = metric::Value::BooleanValue(true);
    let right = request("Node Control/Rebirth", yes.clone());
    let topic = "spBv1.0/g/NCMD/n";
    assert!(node.asks_for_birth(topic, &right));
    assert!(!node.asks_for_birth("spBv1.0/g/NCMD/other", &right));
    for wrong in [
        request("Node Control/Rebirth", metric::Value::BooleanValue(false)),
        request(
            "Node Control/Rebirth",
            metric::Value::StringValue("true".to_owned()),
        ),
        request("Node Control/Reboot", yes),
        Vec::new(),
    ] {
        assert!(!node.asks_for_birth(topic, &wrong));
    }
    proptest!(|(bytes in prop::collection::vec(any::<u8>(), 0..64), cut in 0..right.len())| {
        prop_assert!(!node.asks_for_birth(topic, &bytes));
        prop_assert!(!node.asks_for_birth(topic, &right[..cut]));
    });
}

/// The will has the number of the birth, the next life another one, also past 255.
#[test]
fn each_life_has_a_number() {
    let now = SystemTime::UNIX_EPOCH;
    let mut node = node();
    for life in ["255", "0", "1"] {
        let number = format!("Some(LongValue({life}))");
        let [born, _] = node.birth(&status(&json!({})), now);
        let dead = node.death(now);
        assert_eq!(dead.topic, "spBv1.0/g/NDEATH/n");
        for message in [&born, &dead] {
            assert_eq!(told(message)[0], ("bdSeq".to_owned(), number.clone()));
        }
        node.next_life();
    }
}
