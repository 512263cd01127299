//! The MTConnect adapter: lines, clients, and the device description for an agent.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::{ChildStdin, Command, Stdio},
    time::{Duration, Instant, SystemTime},
};

use proptest::prelude::*;
use serde_json::{Value, json};
use volcomp_gateway::interop::{
    quantities::{Shape, quantities},
    shdr::{self, Items, SentState, escaped},
};
use volcomp_test_support::{Running, free_port, peers};
use volcomp_vocabulary::AxisName;

use crate::{
    interop::status,
    manual::{Served, machine, served_configuration},
    program::append,
};

const PATIENCE: Duration = Duration::from_secs(60);

fn shape() -> Shape {
    Shape {
        machine: "m".to_owned(),
        axes: vec![AxisName::X, AxisName::C],
        sensors: vec!["bed plate".to_owned(), "bed|plate".to_owned()],
        controllers: 1,
    }
}

fn noon() -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_secs(20_778 * 86_400 + 12 * 3600)
}

#[test]
fn every_item_is_sent_once_then_its_changes() {
    let items = Items::of(&shape());
    let mut reported = SentState::nothing(&items);
    let first = reported.changes(&items, &status(&json!({})), noon());
    for line in [
        // The timestamp accounts for the age of a value: positions 8 ms, confirmed correction 12 ms, other values 20
        // ms.
        "2026-11-21T11:59:59.980Z|avail|AVAILABLE",
        "2026-11-21T11:59:59.980Z|state|COMPENSATING",
        "2026-11-21T11:59:59.992Z|x_position|400.25",
        "2026-11-21T11:59:59.992Z|c_position|-90",
        "2026-11-21T11:59:59.988Z|x_correction|-0.0125",
        // 100 µrad in degrees.
        "2026-11-21T11:59:59.988Z|c_correction|0.00572958",
        "2026-11-21T11:59:59.992Z|tool_error|0.005",
        "2026-11-21T11:59:59.980Z|temperature_bed_plate|21.5",
        "2026-11-21T11:59:59.980Z|temperature_bed_plate_2|22",
        "2026-11-21T11:59:59.980Z|path_0_holds_correction|TRUE",
        "2026-11-21T11:59:59.980Z|faults|3",
        "2026-11-21T11:59:59.980Z|guard|NORMAL||||",
        "2026-11-21T11:59:59.980Z|temperature_bed_plate_2_condition|NORMAL||||",
    ] {
        assert!(first.lines().any(|reported| reported == line), "{line} in {first}");
    }
    // Availability is one more item, and the reasons are reported as conditions.
    let count = 1 + quantities(&shape()).len() - 1 + items.conditions.len();
    assert_eq!(first.lines().count(), count, "{first}");
    let mut next = |changes: Value| reported.changes(&items, &status(&changes), noon());
    assert_eq!(next(json!({})), "");
    assert_eq!(next(json!({ "age_ms": 90.0 })), "", "an age below a second");
    assert_eq!(
        next(json!({ "temperatures": [
            { "name": "bed plate", "degc": 21.5, "quality": "uncertain", "reason": "stuck at one value" },
            { "name": "bed|plate", "degc": null, "quality": "bad", "reason": "out|of range" },
        ] })),
        "2026-11-21T11:59:59.980Z|temperature_bed_plate_2|UNAVAILABLE\n\
         2026-11-21T11:59:59.980Z|temperature_bed_plate_condition|WARNING|stuck_at_one_value|||stuck at one value\n\
         2026-11-21T11:59:59.980Z|temperature_bed_plate_2_condition|FAULT|out_of_range|||\"out\\|of range\"\n"
    );
}

/// Every item has its own key, even if a sensor is named like the alarms of another sensor.
#[test]
fn every_item_has_its_own_key() {
    for sensors in [["bed", "bed_condition"], ["bed condition", "bed"], ["bed", "bed"]] {
        let sensors = sensors.map(str::to_owned).to_vec();
        let items = Items::of(&Shape { sensors, ..shape() });
        let values = items.quantities.iter().map(|quantity| quantity.key.clone());
        let mut keys: Vec<String> =
            values.chain(items.conditions.iter().map(|(key, _)| key.clone())).collect();
        keys.sort();
        let count = keys.len();
        keys.dedup();
        assert_eq!(keys.len(), count, "{keys:?}");
    }
}

#[test]
fn a_silent_controller_is_a_fault_of_its_communication() {
    let items = Items::of(&shape());
    let mut reported = SentState::nothing(&items);
    let mut condition = |answered_ms: Value| {
        let mut status = status(&json!({}));
        status.controllers[0].answered_ms = answered_ms.as_f64();
        let text = reported.changes(&items, &status, noon());
        let line = text.lines().find(|line| line.contains("|path_0_condition|"));
        line.map(|line| line.split('|').nth(2).expect("a level").to_owned())
    };
    for (answered_ms, level) in [
        (json!(4.0), Some("NORMAL")),
        (json!(1999.0), None),
        (json!(2001.0), Some("FAULT")),
        (json!(4.0), Some("NORMAL")),
        (Value::Null, Some("FAULT")),
    ] {
        assert_eq!(condition(answered_ms.clone()).as_deref(), level, "{answered_ms}");
    }
}

#[test]
fn what_is_not_known_is_not_available() {
    let items = Items::of(&shape());
    let mut reported = SentState::nothing(&items);
    let mut next = |changes: Value| reported.changes(&items, &status(&changes), noon());
    next(json!({}));
    // Stale positions are unavailable as values, and the guard reports a warning.
    let stale = next(json!({ "state": "holding", "reasons": ["positions stale"] }));
    for key in ["x_position", "c_position", "x_wanted", "tool_error", "tool_residual"] {
        assert!(stale.contains(&format!("|{key}|UNAVAILABLE\n")), "{key} in {stale}");
    }
    assert!(stale.contains("|guard|WARNING|positions_stale|||positions stale\n"), "{stale}");
    assert!(!stale.contains("x_correction"), "{stale}");
    let back = next(json!({}));
    assert!(back.contains("|x_position|400.25\n"), "{back}");
    assert!(back.contains("|guard|NORMAL||||\n"), "{back}");
    let unconfirmed = next(json!({ "correction_known": false }));
    assert!(unconfirmed.contains("|x_correction|UNAVAILABLE\n"), "{unconfirmed}");
    let silent = next(json!({
        "state": "unknown", "reasons": ["no cycle for 1234 ms"], "correction_known": false, "positions_mm": {},
        "positions_deg": {}, "correction_um": {}, "correction_urad": {}, "error_um": null,
    }));
    for line in
        ["avail", "guard", "path_0_condition", "x_position", "faults", "armed", "tool_error"]
    {
        assert!(silent.contains(&format!("|{line}|UNAVAILABLE")), "{line} in {silent}");
    }
    assert!(silent.contains("|state|UNKNOWN\n"), "{silent}");
    let longer = next(json!({
        "state": "unknown", "reasons": ["no cycle for 1334 ms"], "correction_known": false, "positions_mm": {},
        "positions_deg": {}, "correction_um": {}, "correction_urad": {}, "error_um": null,
    }));
    assert_eq!(longer, "", "the time of the silence is no news");
}

#[test]
fn conditions_end_by_their_codes() {
    let items = Items::of(&shape());
    let mut reported = SentState::nothing(&items);
    let mut next = |state: &str, reasons: &[&str]| {
        let text = reported.changes(
            &items,
            &status(&json!({ "state": state, "reasons": reasons })),
            noon(),
        );
        let guard = text.lines().filter_map(|line| line.split_once("Z|guard|"));
        guard.map(|(_, rest)| rest.to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(next("compensating", &[]), ["NORMAL||||"]);
    assert_eq!(
        next("holding", &["emergency stop", "no barrier"]),
        ["WARNING|emergency_stop|||emergency stop", "WARNING|no_barrier|||no barrier"]
    );
    // In the state `faulted` a reason that forbids arming is a fault. Other reasons do not change.
    assert_eq!(
        next("faulted", &["emergency stop", "correction does not stick", "no barrier"]),
        [
            "FAULT|emergency_stop|||emergency stop",
            "FAULT|correction_does_not_stick|||correction does not stick"
        ]
    );
    assert_eq!(
        next("faulted", &["correction does not stick", "no barrier"]),
        ["NORMAL|emergency_stop|||"]
    );
    assert_eq!(next("disarmed", &[]), ["NORMAL||||"]);
    // The same reason with another position is not sent again.
    let jumped = |at: &str| format!("position jumped: X {at} mm");
    assert_eq!(
        next("holding", &[&jumped("4000.000")]),
        ["WARNING|position_jumped|||position jumped"]
    );
    assert!(next("holding", &[&jumped("4000.013")]).is_empty());
}

/// The fields of a line by the rules of the reference agent. Fields are split at `|`. A field that begins with `"`
/// extends to the next `"` before `|` or the end, and in it `\` escapes the next character.
fn taken(line: &str) -> Vec<String> {
    let signs: Vec<char> = line.chars().collect();
    let (mut fields, mut at) = (Vec::new(), 0);
    loop {
        let mut field = String::new();
        if signs.get(at) == Some(&'"') {
            at += 1;
            while at < signs.len() && signs[at] != '"' {
                if signs[at] == '\\' {
                    at += 1;
                }
                field.push(signs[at]);
                at += 1;
            }
            at += 1;
        } else {
            while at < signs.len() && signs[at] != '|' {
                field.push(signs[at]);
                at += 1;
            }
        }
        fields.push(field);
        if at >= signs.len() {
            return fields;
        }
        assert_eq!(signs[at], '|', "{line}");
        at += 1;
    }
}

proptest! {
    /// For any texts the reader gets the same number of fields with the same texts, without control characters.
    #[test]
    fn a_reader_takes_what_was_written(texts in prop::collection::vec(r#"[a-z|"\\\n\r\t |"]{0,8}|.{0,12}"#, 1..6)) {
        let line: Vec<String> = texts.iter().map(|text| escaped(text)).collect();
        let line = line.join("|");
        prop_assert!(!line.chars().any(char::is_control), "{line:?}");
        let expected: Vec<String> = texts
            .iter()
            .map(|text| {
                let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
                plain.trim_matches(' ').to_owned()
            })
            .collect();
        prop_assert_eq!(taken(&line), expected, "{}", line);
    }
}

/// The independent client. It is started with the items that it waits for.
struct Agent {
    running: Running,
    wishes: Option<ChildStdin>,
    said: BufReader<std::process::ChildStdout>,
}

impl Agent {
    fn start(address: &str) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/shdr.py");
        let mut command = Command::new(peers::python()?);
        command.arg(script).arg(address).stdin(Stdio::piped());
        let (mut running, line, said) = Running::start_and_hear(&mut command);
        assert_eq!(line, "ready");
        let wishes = running.stdin.take();
        Some(Self { running, wishes, said })
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.said.read_line(&mut line).expect("it speaks");
        line.trim_end().to_owned()
    }

    fn hears(&mut self, key: &str, fields: &Value) {
        let wishes = self.wishes.as_mut().expect("open");
        writeln!(wishes, "{}", json!([key, fields])).expect("it reads");
        let line = self.line();
        assert!(line.starts_with("ok "), "{key} {fields}: {line}");
    }

    fn keys(mut self) -> Vec<String> {
        drop(self.wishes.take());
        let end: Value = serde_json::from_str(&self.line()).expect("JSON");
        assert!(end["pongs"].as_u64() >= Some(1), "{end}");
        assert!(self.running.ended(PATIENCE).is_some_and(|status| status.success()));
        let keys = end["keys"].as_array().expect("a list").iter();
        keys.map(|key| key.as_str().expect("text").to_owned()).collect()
    }
}

fn client(address: &str) -> TcpStream {
    let address: SocketAddr = address.parse().expect("an address");
    let stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a time");
    stream.set_write_timeout(Some(PATIENCE)).expect("a time");
    stream
}

fn served(dir: &Path, more: &str, device: &str) -> (Served, PathBuf, String) {
    let config = served_configuration(dir, more);
    let address = format!("127.0.0.1:{}", free_port());
    append(&config, &format!("\n[shdr]\nlisten = \"{address}\"\n{device}"));
    (Served::start(&config), config, address)
}

#[test]
fn an_agent_reads_what_the_dashboard_shows() {
    let dir = tempfile::tempdir().expect("writable");
    let device = "device = \"mill & drill\"\n";
    let (gateway, config, address) = served(dir.path(), "auto_arm = true", device);
    let Some(mut agent) = Agent::start(&address) else {
        return;
    };
    agent.hears("avail", &json!(["AVAILABLE"]));
    agent.hears("state", &json!(["COMPENSATING"]));
    agent.hears("machine", &json!(["small"]));
    agent.hears("x_position", &json!(["number"]));
    // The machine file has -20 µm on Y.
    agent.hears("y_correction", &json!(["-0.02"]));
    agent.hears("guard", &json!(["WARNING", "no_barrier", null, null, "no barrier"]));
    gateway.gateway().disconnect();
    agent.hears("x_position", &json!(["UNAVAILABLE"]));
    agent.hears("y_correction", &json!(["UNAVAILABLE"]));
    agent.hears("guard", &json!(["WARNING", "controller_does_not_answer"]));
    let keys = agent.keys();

    // The device description contains exactly the items that are sent.
    let plan = machine(&config).plan().expect("right");
    let device = shdr::device(&plan.shape(), plan.shdr_device());
    let python = peers::python().expect("the agent ran by it");
    let mut read = Command::new(python)
        .args(["-c", READ_DEVICE])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python");
    let mut stdin = read.stdin.take().expect("piped");
    stdin.write_all(device.as_bytes()).expect("it reads");
    drop(stdin);
    let output = read.wait_with_output().expect("ours");
    assert!(output.status.success());
    let read: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(read["name"], "mill & drill");
    assert_eq!(read["ids"], json!(keys));
}

/// A script that prints the device name and the sorted identifiers of its data items. It rejects duplicates.
const READ_DEVICE: &str = r#"
import json, sys, xml.etree.ElementTree as tree
root = tree.parse(sys.stdin.buffer).getroot()
space = "{urn:mtconnect.org:MTConnectDevices:1.5}"
ids = [node.get("id") for node in root.iter() if node.get("id")]
assert len(ids) == len(set(ids)), ids
items = [item for item in root.iter(space + "DataItem")]
assert all(item.get("category") in ("SAMPLE", "EVENT", "CONDITION") for item in items)
assert all(item.get("units") for item in items if item.get("category") == "SAMPLE")
device = root.find(f".//{space}Device")
print(json.dumps({"name": device.get("name"), "ids": sorted(item.get("id") for item in items)}))
"#;

/// Data from clients has no effect. A client that sends an endless line is disconnected, and so is a client that never
/// reads. Another client still receives meanwhile.
#[test]
fn received_data_neither_commands_nor_delays() {
    let dir = tempfile::tempdir().expect("writable");
    let (gateway, _, address) = served(dir.path(), "", "");
    gateway.watch();
    let mut stream = client(&address);
    stream
        .write_all(b"* arm\nPOST /api/arm HTTP/1.1\r\n\r\n|armed|TRUE\n\0\xff\n* PING\n")
        .expect("open");
    let (mut received, mut buffer) = (Vec::new(), [0; 4096]);
    while !String::from_utf8_lossy(&received).contains("* PONG 10000\n") {
        let read = stream.read(&mut buffer).expect("an answer");
        received.extend_from_slice(&buffer[..read]);
        assert!(read > 0, "it was closed");
    }
    assert_eq!(gateway.state()["armed"], false);
    // The gateway may close the connection during the write.
    let _ = stream.write_all(&[b'x'; 5000]);
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(_) => {}
            Err(e) => {
                assert_eq!(e.kind(), std::io::ErrorKind::ConnectionReset);
                break;
            }
        }
    }
    let deaf = client(&address);
    let mut asks = deaf.try_clone().expect("a handle");
    // Sends requests until the gateway accepts no more, and then until it closes the connection.
    let asking = std::thread::spawn(move || {
        let pings = b"* PING\n".repeat(1000);
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            if let Err(e) = asks.write_all(&pings) {
                return e.kind();
            }
        }
        panic!("it is never disconnected");
    });
    let mut hears = client(&address);
    let (mut count, mut buffer) = (0, [0; 4096]);
    while !asking.is_finished() {
        let read = hears.read(&mut buffer).expect("changes are sent");
        assert!(read > 0, "it was closed");
        count += 1;
    }
    let ended = asking.join().expect("it was disconnected");
    assert_ne!(ended, std::io::ErrorKind::WouldBlock, "it was not disconnected");
    assert!(count > 1, "the other received {count} times");
    assert_eq!(gateway.state()["state"], "disarmed");
    drop(deaf);
}
