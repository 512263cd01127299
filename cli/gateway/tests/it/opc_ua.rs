//! The OPC UA server, read by a client based on another library.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::{ChildStdin, ChildStdout, Command, Stdio},
    time::{Duration, SystemTime},
};

use serde_json::{Value, json};
use volcomp_gateway::{config::Config, interop::quantities::quantities, plan::Plan};
use volcomp_test_support::{Running, free_port, peers, until};

use crate::{
    check::check,
    manual::{Gateway, Served, served_configuration},
    program::append,
};

const PATIENCE: Duration = Duration::from_secs(90);
/// Maximum number of simultaneous clients.
const MOST: usize = 16;

/// A configuration in a folder, and the address of its server.
fn configuration(dir: &Path) -> (PathBuf, String) {
    let config = served_configuration(dir, "auto_arm = true");
    let address = format!("127.0.0.1:{}", free_port());
    append(&config, &format!("\n[opc_ua]\nlisten = \"{address}\"\n"));
    (config, address)
}

struct Client {
    running: Running,
    orders: Option<ChildStdin>,
    said: BufReader<ChildStdout>,
    /// Addresses and security modes that the server offers.
    endpoints: Value,
}

impl Client {
    fn start(address: &str) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/opc_ua.py");
        let mut command = Command::new(peers::python()?);
        command.arg(script).arg(format!("opc.tcp://{address}"));
        command.stdin(Stdio::piped());
        let (mut running, line, said) = Running::start_and_hear(&mut command);
        let orders = running.stdin.take();
        Some(Self { running, orders, said, endpoints: serde_json::from_str(&line).expect("JSON") })
    }

    fn order(&mut self, order: &str) -> Value {
        writeln!(self.orders.as_mut().expect("open"), "{order}").expect("it reads");
        let mut line = String::new();
        self.said.read_line(&mut line).expect("it speaks");
        serde_json::from_str(&line).unwrap_or_else(|e| panic!("{order}: {e}: {line}"))
    }

    fn end(mut self) {
        drop(self.orders.take());
        let status = self.running.ended(PATIENCE);
        assert!(status.is_some_and(|status| status.success()));
    }
}

fn variables(client: &mut Client) -> BTreeMap<String, Value> {
    let all = client.order("all");
    let all = all.as_array().expect("a list").iter();
    all.map(|own| (own["id"].as_str().expect("text").to_owned(), own.clone())).collect()
}

#[test]
fn a_client_reads_what_the_dashboard_shows() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, address) = configuration(dir.path());
    let program = Served::start(&config);
    let Some(mut client) = Client::start(&address) else {
        return;
    };
    assert_eq!(client.endpoints, json!([[format!("opc.tcp://{address}/"), "None_"]]));
    let corrects = |found: &BTreeMap<String, Value>| {
        let reported = |key: &str| (found[key]["value"].clone(), found[key]["status"].clone());
        let good = |value: Value| (value, json!("Good"));
        // The machine file gives -20 µm on Y.
        reported("state") == good(json!("compensating"))
            && reported("y_correction") == good(json!(-20.0))
            && reported("x_position").1 == "Good"
            && reported("tool_residual").1 == "Good"
    };
    let mut found = variables(&mut client);
    until("it corrects", PATIENCE, || {
        found = variables(&mut client);
        corrects(&found)
    });
    // The nodes are exactly the quantities of the list, with their names.
    let plan = Plan::new(Config::read(&config).expect("right")).expect("right");
    let list = quantities(&plan.shape());
    let mut keys: Vec<&str> = list.iter().map(|own| own.key.as_str()).collect();
    keys.sort_unstable();
    assert_eq!(found.keys().collect::<Vec<_>>(), keys);
    for own in &list {
        let reported = &found[&own.key];
        let place = own.folder().join("/");
        assert_eq!(reported["path"], format!("{place}/{}", own.name()), "{reported}");
        let help = reported["help"].as_str().expect("text");
        assert!(help.starts_with(own.help), "{reported}");
        assert_eq!(reported["access"], json!([["CurrentRead"], ["CurrentRead"]]), "{reported}");
    }
    let state = program.state();
    assert_eq!(found["machine"]["value"], "small");
    assert_eq!(found["machine_file"]["value"], state["machine"]["hash"]);
    assert_eq!(found["y_correction"]["type"], "Double");
    assert!(found["y_correction"]["help"].as_str().is_some_and(|help| help.ends_with(", µm")));
    assert_eq!(found["armed"]["value"], true);
    assert_eq!(found["faults"]["type"], "UInt64");
    for key in ["state", "x_position", "y_correction", "tool_residual"] {
        assert_eq!(found[key]["status"], "Good", "{key}");
        let source = found[key]["source"].as_f64().expect("a time");
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let age = now.expect("after 1970").as_secs_f64() - source;
        assert!(0.0 < age && age < PATIENCE.as_secs_f64(), "{key}: {age} s");
    }
    // The axes move, so the value changes.
    let values = client.order("watch x_position");
    assert_eq!(values.as_array().map(Vec::len), Some(2), "{values}");
    // The control is disconnected.
    program.gateway().disconnect();
    let old = client.order("wait x_position UncertainLastUsableValue");
    assert!(old["value"].is_number(), "{old}");
    let old = client.order("wait y_correction Uncertain");
    assert_eq!(old["status"], "UncertainLastUsableValue");
    let known = client.order("wait correction_known Good");
    assert_eq!(known["value"], false);
    client.end();
}

/// While a control does not answer, its values are bad and empty.
#[test]
fn unknown_values_are_bad_and_empty() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, address) = configuration(dir.path());
    let gateway = Gateway::start(&config);
    gateway.disconnect();
    let _program = Served::of(gateway);
    let Some(mut client) = Client::start(&address) else {
        return;
    };
    for key in ["x_position", "x_correction", "x_wanted", "tool_error", "path_0_answered"] {
        let reported = client.order(&format!("wait {key} Bad"));
        assert_eq!(
            (&reported["value"], &reported["type"]),
            (&Value::Null, &json!("Null")),
            "{key}: {reported}"
        );
        assert_eq!(reported["status"], "BadNoCommunication", "{key}");
    }
    assert_eq!(client.order("wait state Good")["value"], "disarmed");
    client.end();
}

#[test]
fn nothing_can_be_written_called_added_or_deleted() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, address) = configuration(dir.path());
    let program = Served::start(&config);
    let Some(mut client) = Client::start(&address) else {
        return;
    };
    program.wait_for("compensating");
    let before = variables(&mut client);
    assert_eq!(client.order("change"), json!([]));
    let after = variables(&mut client);
    assert!(after.keys().eq(before.keys()));
    for key in ["machine", "machine_file", "simulated"] {
        assert_eq!(after[key]["value"], before[key]["value"], "{key}");
    }
    program.wait_for("compensating");
    // The server leaves no files.
    let mut files: Vec<_> = std::fs::read_dir(dir.path())
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    files.sort_unstable();
    assert!(files.iter().all(|name| name != "pki"), "{files:?}");
    client.end();
}

/// Encodes an OPC UA string. The empty text is encoded as null.
fn text(text: &str) -> Vec<u8> {
    let length = i32::try_from(text.len()).expect("short");
    let length = if text.is_empty() { -1 } else { length };
    [&length.to_le_bytes(), text.as_bytes()].concat()
}

/// Sends a message, and returns the body of the response.
fn exchange(stream: &mut TcpStream, kind: [u8; 4], body: &[u8]) -> std::io::Result<Vec<u8>> {
    let size = u32::try_from(8 + body.len()).expect("short");
    stream.write_all(&[&kind[..], &size.to_le_bytes(), body].concat())?;
    let mut header = [0; 8];
    stream.read_exact(&mut header)?;
    let size = u32::from_le_bytes(header[4..].try_into().expect("four"));
    let mut answer = vec![0; size as usize - 8];
    stream.read_exact(&mut answer)?;
    Ok(answer)
}

/// An anonymous message without a session, with values nested as deeply as the maximum message size permits, at most
/// closes its own connection.
#[test]
fn nested_values_do_not_end_the_gateway() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, address) = configuration(dir.path());
    let program = Served::start(&config);
    program.wait_for("compensating");
    let numbers = |numbers: &[u32]| -> Vec<u8> {
        numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
    };
    // The type of the request, and its header.
    let request = |of: u16| {
        let identifier = [&[1, 0][..], &of.to_le_bytes()].concat();
        let header =
            [&[0; 2][..], &[0; 8], &numbers(&[1, 0]), &text(""), &numbers(&[10_000]), &[0; 3]]
                .concat();
        [identifier, header].concat()
    };
    for level in [&[0x40][..], &[0x17, 1]] {
        let mut stream = TcpStream::connect(&address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let hello = [numbers(&[0, 65_535, 65_535, 0, 0]), text(&format!("opc.tcp://{address}/"))];
        exchange(&mut stream, *b"HELF", &hello.concat()).expect("acknowledged");
        let none = text("http://opcfoundation.org/UA/SecurityPolicy#None");
        let open = [request(446), numbers(&[0, 0, 1]), text(""), numbers(&[600_000])].concat();
        let open = [numbers(&[0]), none, text(""), text(""), numbers(&[1, 1]), open].concat();
        let opened = exchange(&mut stream, *b"OPNF", &open).expect("opened");
        let channel = &opened[..4];
        // A write of one value.
        let write = [request(673), numbers(&[1]), vec![0, 0x54], numbers(&[13]), text(""), vec![1]]
            .concat();
        let kind: &[u8] = if level.len() == 1 { &[0x19] } else { &[] };
        let nested = level.repeat((32 * 1024 - 200) / level.len());
        let token = [channel, &numbers(&[1, 2, 2])].concat();
        let body = [&token[..], &write, kind, &nested, &[0]].concat();
        // The library may respond or close the connection.
        let _ = exchange(&mut stream, *b"MSGF", &body);
    }
    program.wait_for("compensating");
}

/// True if the peer keeps a connection open on which it sends nothing.
fn is_open(stream: &mut TcpStream) -> bool {
    stream.set_nonblocking(true).expect("a socket");
    let nothing_yet = |e: std::io::Error| e.kind() == std::io::ErrorKind::WouldBlock;
    stream.read(&mut [0]).is_err_and(nothing_yet)
}

/// Hundreds of further clients connect. Clients without a slot are disconnected, silent ones time out, and the existing
/// client still reads. The slots bound the number of open files, and the correction continues.
#[test]
fn a_flood_of_connections_is_bounded() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, address) = configuration(dir.path());
    let program = Served::start(&config);
    let Some(mut client) = Client::start(&address) else {
        return;
    };
    program.wait_for("compensating");
    let target: SocketAddr = address.parse().expect("an address");
    let connect = |_| TcpStream::connect(target).expect("it listens");
    let mut open: Vec<TcpStream> = (0..500).map(connect).collect();
    assert_eq!(client.order("wait machine Good")["value"], "small");
    // Clients without a slot are disconnected immediately. Clients that send no HEL message are disconnected soon
    // after.
    for most in [MOST, 0] {
        until("the others end", PATIENCE, || {
            open.retain_mut(is_open);
            open.len() <= most
        });
    }
    assert_eq!(client.order("wait machine Good")["value"], "small");
    let mut again = Client::start(&address).expect("there is a Python");
    assert_eq!(again.order("wait machine Good")["value"], "small");
    program.wait_for("compensating");
    again.end();
    client.end();
}

#[test]
fn it_listens_beyond_loopback_only_if_configured() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "");
    let text = std::fs::read_to_string(&config).expect("readable");
    let with = |table: &str| {
        std::fs::write(&config, format!("{text}\n[opc_ua]\n{table}\n")).expect("writable");
        check(&config, &[])
    };
    let (_, errors, status) = with("listen = \"0.0.0.0:4840\"");
    assert_eq!(status, 2, "{errors}");
    assert!(
        errors.contains("opc_ua.listen: found `0.0.0.0:4840`, which other computers reach"),
        "{errors}"
    );
    let (reported, errors, status) = with("listen = \"0.0.0.0:4840\"\nanyone_may_read = true");
    assert_eq!(status, 0, "{errors}");
    assert!(reported.contains("listen = \"0.0.0.0:4840\""), "{reported}");
    let (reported, errors, status) = with("");
    assert_eq!(status, 0, "{errors}");
    assert!(reported.contains("listen = \"127.0.0.1:4840\""), "{reported}");
}
