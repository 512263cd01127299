//! Commands that use the network: `volcomp probe` on a simulated control, and `volcomp studio` with its page.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Command, Stdio},
    sync::Arc,
};

use serde_json::json;
use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{Folder, contains, json, refused, refuses, root, text, volcomp};

pub(crate) fn simulator() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'C']);
    world.motion = Arc::new(|_| vec![1234.567, -0.001, 45.0]);
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("a free port")
}

#[test]
fn a_control_says_where_it_is() {
    let simulator = simulator();
    let url = format!("focas://{}", simulator.address());
    let answer = json(&["probe", &url]);
    assert_eq!(answer["device"], url);
    assert_eq!(answer["positions_mm"], json!({ "X": 1234.567, "Y": -0.001 }));
    assert_eq!(answer["positions_deg"], json!({ "C": 45.0 }));
    assert_eq!(answer["alarm"], false);
    assert_eq!(answer["series"], "D4G3 28.0");
    let shown = text(&["probe", &url]).replace(&url, "URL");
    let shown: Vec<&str> = shown.lines().filter(|line| !line.starts_with("round trip")).collect();
    insta::assert_snapshot!(shown.join("\n"));
}

#[test]
fn a_device_that_is_not_there_is_a_failed_work() {
    let output = volcomp(&["probe", "focas://127.0.0.1:1", "--within", "0.5"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    contains(&message, "focas://127.0.0.1:1: no connection");
    for (url, expected) in [
        ("focas://h?x=1", "found the key `x`"),
        ("modbus://h", "no profile is named"),
        ("modbus://h?profile=nothing", "there is no profile `nothing`"),
        ("gpio://?position=a:0", "correction is missing"),
        ("http://h", "found the scheme `http`"),
    ] {
        assert!(refused(&["probe", url]).contains(expected), "{url}");
    }
    assert!(refused(&["probe", "can://can77", "--within=-1"]).contains("--within"));
}

/// The document has three lists on every computer, whatever its devices. `--list` excludes probing a device.
#[test]
fn devices_are_listed() {
    let answer = json(&["probe", "--list"]);
    for key in ["serial_ports", "can_interfaces", "gpio_chips"] {
        assert!(answer[key].is_array(), "{key}: {answer}");
    }
    assert!(!text(&["probe", "--list"]).is_empty());
    refused(&["probe", "--list", "can://can0"]);
    refused(&["probe"]);
}

/// A profile given by a path is read from that file. An error in the file is an invalid call.
#[test]
fn a_profile_may_be_a_file() {
    let url = "modbus://127.0.0.1:1?profile=examples/temperature-module.toml";
    let output = volcomp(&["probe", url, "--within", "0.2"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    contains(&message, "the module does not answer");
    refuses(
        &["probe", "modbus://h?profile=nowhere/module.toml"],
        "nowhere/module.toml: cannot be read",
    );
}

#[test]
fn it_prints_where_it_listens_and_serves_the_page_there() {
    let folder = Folder::new();
    let example = root().join("examples/calibration/machine.toml");
    fs::copy(example, folder.path().join("machine.toml")).expect("copied");
    let mut program = Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .arg("studio")
        .arg(folder.path())
        .arg("--no-browser")
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut lines = BufReader::new(program.stdout.take().expect("piped")).lines();
    let mut line = || lines.next().expect("a line").expect("UTF-8");
    let first = line();
    let address = first.strip_prefix("listening on ").expect("its address");
    let second = line();
    let path = second.strip_prefix(&format!("open http://{address}"));
    let path = path.expect("the same address");
    let mut stream = TcpStream::connect(address).expect("it listens");
    let request =
        format!("GET {path}api/state HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("it reads");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("it answers");
    program.kill().expect("it runs");
    program.wait().expect("ended");
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("\"structure\""), "{answer}");
}

#[test]
fn a_folder_that_is_not_there_and_an_address_of_others_are_refused() {
    refuses(&["studio", "no-such-folder", "--no-browser"], "no-such-folder");
    refuses(
        "studio examples --no-browser --listen 0.0.0.0:0",
        "expected an address of this computer",
    );
}
