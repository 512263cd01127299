//! Configurations with one error each, and their messages: `check` and the gateway report the same and exit with status
//! 2.

use std::process::Command;

use volcomp_gateway::check;
use volcomp_test_support::rows;

use crate::{
    manual::machine,
    program::{MACHINE, path, token_file},
};

const FIVE: &str = include_str!("../../../../examples/five-axis.toml");

pub(crate) const RIGHT: &str = r#"
machine = "machine.toml"
cycle_ms = 4.0
[guard]
limit_um = 150.0
slew_um_per_s = 500.0
hold_ms = 50
zero_after_ms = 500
[[controller]]
url = "focas://127.0.0.1:1"
axes = ["X", "Y", "Z"]
heartbeat = { pmc = "R", at = 120 }
[[thermometer]]
url = "modbus://127.0.0.1:1?unit=1&profile=PTA8C04"
names = ["bed", "column"]
[dashboard]
listen = "127.0.0.1:0"
token_file = "tokens"
"#;

const HEARTBEAT: &str = "heartbeat = { pmc = \"R\", at = 120 }";
pub(crate) const FOCAS: &str = "url = \"focas://127.0.0.1:1\"\naxes = [\"X\", \"Y\", \"Z\"]\nheartbeat = { pmc = \"R\", at = 120 }";

/// The published scheme on the lines of a chip, used instead of [`FOCAS`]. Valid with limits below 127 µm.
const LINES: &str = "url = \"gpio://?position=a:0-14&correction=b:0-7\"\naxes = [\"X\"]\nfixed = { Y = 0.0, Z = 0.0 }\nunwatched = true\nunseen = [\"referenced\", \"alarm\", \"emergency_stop\"]\n[controller.digital]\ncorrection_bits = 8";

/// Changes of [`RIGHT`], each with a part of its message. The first column is the text to replace, or `FOCAS`,
/// `HEARTBEAT`, `key` (inserts a key into the controller's table) or `table` (appends a table).
const CHANGES: &str = r#"
"machine.toml" | "nothing.toml" | .toml: machine:
// A heartbeat, or the byte of referenced axes, within the correction words.
at = 120 } | at = 104 } | :12: controller[0].heartbeat: the heartbeat R104 lies within the words of the shifts R100 to R105 (the driver's own place, controller[0].url in line 10)
at = 120 } | at = 120 }\nreferenced = { pmc = "R", at = 101 } | the byte of the referenced axes R101 lies within
// A fixed position for an axis that the control reports, and an impossible position.
key | fixed = { Z = 50.0 } | axis Z is one of the controller's axes
// Heartbeats: of FOCAS, of digital lines, of a CAN table without a counter.
HEARTBEAT |  | unwatched = true
FOCAS | url = "modbus://127.0.0.1:1?profile=ADAM-6050"\naxes = ["X"]\nfixed = { Y = 0.0, Z = 0.0 }\n[controller.digital]\nposition_bits = 8\ncorrection_bits = 6 | unwatched = true
FOCAS | url = "can://can9?dbc=bare.dbc"\naxes = ["X"]\nfixed = { Y = 0.0, Z = 0.0 } | unwatched = true
cycle_ms = 4.0 | cycle_ms = 0.5 | cycle_ms: found 0.5 ms
FOCAS | url = "modbus://127.0.0.1:1?profile=ADAM-6050"\naxes = ["X"]\nunwatched = true\nfixed = { Y = 0.0, Z = 0.0 }\n[controller.digital]\nposition_bits = 8\ncorrection_bits = 6 | cycle_ms: found 4 ms
["X", "Y", "Z"] | ["X", "W"] | axis W
key | fixed = { C = 0.0 } | fixed: axis C
FOCAS | url = "can://can9?dbc=deg.dbc"\naxes = ["X"]\nunwatched = true | CORRECTION.X_CORR: found the unit `deg`
FOCAS | url = "can://can9"\naxes = ["V"] | V_POS
FOCAS | url = "gpio://?position=a:0-14&correction=b:0-7"\naxes = ["X", "Y"]\nunwatched = true | found 2 axes
// Limits against the step of the device, and against one another.
limit_um = 150.0 | limit_um = 0.5 | limit_um of axis X: found 0.5 µm
key | resolution_um = 200.0 | limit_um of axis X: found 30 µm, expected at least one step
// Limits above the range of a word: 8 lines, one byte.
FOCAS | url = "gpio://?position=a:0-14&correction=b:0-7"\naxes = ["X"]\nunwatched = true | limit_um of axis X: found 150 µm, expected at most 127 µm
at = 120 } | at = 120 }\narea = { pmc = "R", first = 100, width = 1, copied = true } | limit_um of axis X: found 150 µm, expected at most 127 µm
// The control uses two bytes per axis.
at = 120 } | at = 120 }\narea = { pmc = "R", first = 100, width = 4 } | area.width: found 4, expected 2
key | unseen = ["alarm"] | unseen: found "alarm", expected only states that this device does not show
key | unseen = ["alarms"] | found "alarms", expected one of: referenced, alarm, emergency_stop
FOCAS | url = "can://can9?dbc=bare.dbc"\naxes = ["X"]\nunwatched = true\nfixed = { Y = 0.0, Z = 0.0 } | this device does not show referenced
// A barrier in the DBC file or in the configuration, but not in both.
FOCAS | url = "can://can9?dbc=barrier.dbc"\naxes = ["X", "Y", "Z"] | there is no table [controller.barrier]
FOCAS | url = "can://can9"\naxes = ["X", "Y", "Z"]\n[controller.barrier]\nmachine = 7\nscan_ms = 2.0 | the DBC file has no words of a barrier
// A longer hold is valid only with thermal terms in the machine file.
key | hold_ms = 1000.0 | hold_ms: found 1000
key | terms = ["curves"] | expected ["thermal"]
key | terms = ["thermal"]\nhold_ms = 5001.0 | hold_ms: found 5001
key | terms = ["thermal"] | carries thermal terms only, and the machine
// The checksum does not distinguish machine 65535 from machine 0.
HEARTBEAT | [controller.barrier]\nmachine = 65535\nscan_ms = 8.0\nframe = { pmc = "R", at = 200 }\nreport = { pmc = "R", at = 240 } | machine: found 65535
// A barrier never accepts words on lines without a latch.
HEARTBEAT | [controller.barrier]\nmachine = 7\nscan_ms = 8.0\nframe = { pmc = "R", at = 200 }\nreport = { pmc = "R", at = 240 }\n[[controller]]\nurl = "gpio://?position=a:0-14&correction=b:0-7"\naxes = ["X"]\nfixed = { Y = 0.0, Z = 0.0 }\nunwatched = true\nunseen = ["referenced", "alarm", "emergency_stop"] | controller[1].digital.latch: missing for gpio://?position=a:0-14&correction=b:0-7
// Two paths, one of which would leave its correction on an axis that the other does not write.
HEARTBEAT | heartbeat = { pmc = "R", at = 120 }\n[[controller]]\nurl = "focas://127.0.0.2:1"\naxes = ["X", "Y"]\nreads = ["Z"]\nunwatched = true | axis Z is not written by focas://127.0.0.2:1, which may take over
// Bytes that only the control writes, and words beyond the end of a memory area.
at = 120 } | at = 120 }\narea = { pmc = "F", first = 100, width = 2 } | area.first: found F100, expected an address in R or D: F holds the signals of the control
pmc = "R", at = 120 | pmc = "F", at = 120 | heartbeat: found F120, expected an address in R or D
// G8.4 is the emergency stop.
pmc = "R", at = 120 | pmc = "G", at = 8 | heartbeat: found G8, expected an address in R or D: G holds the signals to the control, its emergency stop among them
at = 120 } | at = 120 }\narea = { pmc = "R", first = 65535, width = 2 } | area.first: found R65535 for 3 words of 2 bytes each
// Devices: keys of the URL, profiles, files, lines.
focas://127.0.0.1:1 | focas://127.0.0.1:1?path=99 | path
focas://127.0.0.1:1 | tcp://127.0.0.1:1 | controller[0].url: tcp://127.0.0.1:1: found the scheme `tcp`
FOCAS | url = "can://can9?dbc=missing.dbc"\naxes = ["X"] | missing.dbc
FOCAS | url = "gpio://?position=a:0-14"\naxes = ["X"]\nunwatched = true | correction is missing
FOCAS | url = "gpio://?position=a:0-3&correction=b:0-7"\naxes = ["X"]\nunwatched = true | gpio a and b
FOCAS | url = "modbus://127.0.0.1:1?profile=PTA8C04"\naxes = ["X"]\nunwatched = true | no digital lines
[[thermometer]] | [[controller]]\nurl = "focas://127.0.0.1:1"\naxes = ["X"]\nheartbeat = { pmc = "R", at = 120 }\n[[thermometer]] | is configured in two [[controller]]
// Channels that a control does not have, and words that two controllers write.
key | channel = "nope" | channel: found "nope"
key | channel = "" | controller[0].channel
key | channel = "a\u0007" | controller[0].channel
[[thermometer]] | [[controller]]\nurl = "focas://127.0.0.1:1?path=2"\naxes = ["X"]\nunwatched = true\n[[thermometer]] | :14: controller[1].url: the words of the shifts R100 to R101 overlap the words of the shifts R100 to R105 (the driver's own place, controller[0].url in line 10)
[[thermometer]] | [[controller]]\nurl = "focas://127.0.0.1:1?path=2"\naxes = ["X"]\narea = { pmc = "R", first = 200, width = 2 }\nheartbeat = { pmc = "R", at = 120 }\n[[thermometer]] | :17: controller[1].heartbeat: the heartbeat R120 lies within the heartbeat R120 (controller[0].heartbeat in line 12)
// A barrier: its words, and keys that it excludes.
HEARTBEAT | barrier = { machine = 1, scan_ms = 8.0, frame = { pmc = "R", at = 200 }, report = { pmc = "R", at = 217 } } | :12: controller[0].barrier.frame: the words of the frame R200 to R217 overlap the words of the report R217 to R254 (controller[0].barrier.report in line 12)
key | barrier = { machine = 1, scan_ms = 8.0, frame = { pmc = "R", at = 200 }, report = { pmc = "R", at = 240 } } | controller[0].heartbeat: found this key together with barrier
HEARTBEAT | barrier = { machine = 1, scan_ms = 8.0, frame = { pmc = "R", at = 200 } } | key `report` is missing
// Above the maximum time for which writes are remembered.
HEARTBEAT | barrier = { machine = 1, scan_ms = 100.0, frame = { pmc = "R", at = 200 }, report = { pmc = "R", at = 240 } } | cycles until a correction is read back, from [controller.barrier] scan_ms and cycle_ms: found 52, expected 1 to 32
HEARTBEAT | barrier = { machine = 1, scan_ms = 0.0, frame = { pmc = "R", at = 200 }, report = { pmc = "R", at = 240 } } | scan_ms
[[thermometer]] | [[controller]]\nurl = "focas://127.0.0.1:1?path=2"\naxes = ["X"]\nbarrier = { machine = 1, scan_ms = 8.0, frame = { pmc = "R", at = 120 }, report = { pmc = "R", at = 240 } }\n[[thermometer]] | :16: controller[1].barrier.frame: the words of the frame R120 to R133 overlap the heartbeat R120 (controller[0].heartbeat in line 12)
table | [[thermometer]]\nurl = "modbus://127.0.0.1:1?unit=2&profile=PTA8C04"\nnames = ["spindle", "bed"] | found "bed", which is a sensor of another [[thermometer]]
table | [[thermometer]]\nurl = "modbus://127.0.0.1:1?profile=PT21A01"\nnames = ["spindle"] | profile=PT21A01 is configured in two [[thermometer]]
"column"] | ""] | expected a name of visible characters
"column"] | "  "] | expected a name of visible characters
modbus://127.0.0.1:1?unit=1&profile=PTA8C04 | focas://127.0.0.1:1 | no temperatures
&profile=PTA8C04 | &profile=NONE | NONE
&profile=PTA8C04 |  | no profile is named
["bed", "column"] | ["bed", "bed"] | is listed twice
modbus://127.0.0.1:1?unit=1&profile=PTA8C04 | can://can9?dbc=bare.dbc | _TEMP
listen = "127.0.0.1:0" | listen = "0.0.0.0:0" | tls-init
token_file | tls_certificate = "none.pem"\ntls_key = "none.pem"\ntoken_file | none.pem
token_file | tls_certificate = "tokens"\ntls_key = "key.pem"\ntoken_file | tokens
token_file = "tokens" | token_file = "nobody" | nobody
token_file = "tokens" | token_file = "open" | mode 644
token_file = "tokens" | token_file = "short" | 128 bits
table | [audit]\ndir = "tokens" | is no folder
table | [audit]\ndir = "tokens/audit" | tokens is no folder
table | [audit]\ndir = "nowhere/audit" | nowhere is no folder
table | [audit]\ndir = "odd" | audit.log is a folder, expected a file
table | [audit]\ndir = "" | audit.dir
table | [audit]\ndir = "a\u0000b" | cannot be used
table | [audit]\ndir = "/proc/x" | "/proc" cannot be used
table | [audit]\ndir = "llllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllll" | cannot be used
// An axis of the machine whose position is not read.
["X", "Y", "Z"] | ["X", "Y"] | axis Z
// Read-only controllers: one in first place, and one that overlaps a barrier's words.
FOCAS | url = "focas://127.0.0.1:1"\naxes = []\nreads = ["X", "Y", "Z"] | expected it after a [[controller]] that writes
// Keys that a kind of controller cannot use.
key | digital = { position_bits = 8 } | digital: found this key for a FANUC control
limit_um = 150.0 | limit_um = 2000.1 | guard.limit_um
slew_um_per_s = 500.0 | slew_um_per_s = 5000.1 | guard.slew_um_per_s
hold_ms | limit_urad = 2000.1\nslew_urad_per_s = 1.0\nhold_ms | guard.limit_urad
hold_ms | limit_urad = 100.0\nslew_urad_per_s = 5000.1\nhold_ms | guard.slew_urad_per_s
cycle_ms = 4.0 | cycle_ms = 0.24 | cycle_ms
cycle_ms = 4.0 | cycle_ms = 101.0 | cycle_ms
hold_ms = 50 | hold_ms = 201 | guard.hold_ms
table | [shdr]\nlisten = "here" | shdr.listen: found "here", expected an address and port such as 127.0.0.1:8080
table | [shdr]\ndevice = " " | shdr.device: found ` `, expected a name
table | [shdr]\nlisten = "192.0.2.7:7878" | shdr.listen: found `192.0.2.7:7878`, which other computers reach
table | [opc_ua]\nlisten = "[::]:4840"\nanyone_may_read = false | opc_ua.listen: found `[::]:4840`, which other computers reach
table | [opc_ua]\nport = 4840 | opc_ua.port
table | [shdr]\nport = 7878 | shdr.port
table | [sparkplug]\nurl = "mqtt://192.0.2.9" | found [sparkplug], which is gone, expected [opc_ua] or [shdr]
table | [several] | found several machines in one gateway, which is gone
focas://127.0.0.1:1 | sinumerik-s7://192.0.2.9 | found "sinumerik-s7://192.0.2.9", the S7 protocol, which is gone, expected opc.tcp://HOST:4840
machine = "machine.toml"\n | [[machine]]\nname = "mill-1"\n | several machines in one gateway are gone
machine.toml | missing.toml | missing.toml
"#;

/// Changes of `RIGHT` with `LINES` in place of `FOCAS`.
const CHANGES_ON_LINES: &str = r#"
// `unseen`: a duplicate, a missing state, and a state that the device reports.
"emergency_stop"] | "referenced"] | duplicate referenced
, "emergency_stop"] | ] | this device does not show emergency_stop
// Positions beyond the range of the word: 15 lines of 1/128 mm are 256 mm.
correction_bits = 8 | position_mm_per_count = 0.0078125 | axis X: found a travel from
// A latch in addition to all eight lines of the module.
correction_bits = 8 | latch = 8 | outputs: found 8, expected a line below 8
// Without a latch the control has no edge to time out on.
correction_bits = 8 | time_out_ms = 450 | found this key without latch
"#;

/// A configuration with one error, and a part of its message.
pub(crate) struct Wrong {
    pub(crate) text: String,
    pub(crate) machine: &'static str,
    pub(crate) says: &'static str,
}

impl Wrong {
    fn of(machine: &'static str, changes: &[(&str, &str)], says: &'static str) -> Self {
        let text = changes.iter().fold(RIGHT.to_owned(), changed);
        Self { text, machine, says }
    }
}

fn changed(text: String, (from, to): &(&str, &str)) -> String {
    let key = format!("{to}\nheartbeat");
    let (from, to) = match *from {
        "key" => ("heartbeat", &*key),
        "table" => return text + to + "\n",
        "FOCAS" => (FOCAS, *to),
        "HEARTBEAT" => (HEARTBEAT, *to),
        from => (from, *to),
    };
    assert!(text.contains(from), "{from}");
    text.replace(from, to)
}

/// One case for each rule that a configuration can break.
pub(crate) fn cases() -> Vec<Wrong> {
    let simple =
        rows(CHANGES).into_iter().map(|[from, to, says]| Wrong::of(MACHINE, &[(from, to)], says));
    let on_lines = rows(CHANGES_ON_LINES).into_iter().map(|[from, to, says]| {
        let to_lines = [("FOCAS", LINES), ("limit_um = 150.0", "limit_um = 120.0")];
        Wrong::of(MACHINE, &[to_lines[0], to_lines[1], (from, to)], says)
    });
    let focas = "focas://127.0.0.1:1";
    let thermometer = "modbus://127.0.0.1:1?unit=1&profile=PTA8C04";
    let listen = "listen = \"127.0.0.1:0\"";
    let tls =
        "listen = \"0.0.0.0:0\"\ntls_certificate = \"certificate.pem\"\ntls_key = \"key.pem\"";
    let barrier = "barrier = { machine = 1, scan_ms = 8.0, frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 } }";
    let five = "[\"X\", \"Y\", \"Z\", \"B\", \"C\"]";
    let others: [(_, &[(&str, &str)], _); 10] = [
        (FIVE, &[("[\"X\", \"Y\", \"Z\"]", five)], "limit_urad"),
        // The error in the URL is reported with its line, before the errors in other keys that follow from it.
        (
            MACHINE,
            &[("HEARTBEAT", barrier), (focas, "192.0.2.10")],
            "controller[0].url: 192.0.2.10: this is no device URL",
        ),
        (MACHINE, &[("\"column\"]", "\"a\\nb\"]")], "expected a name of visible characters"),
        (
            MACHINE,
            &[
                ("\"column\"]", "\"column\", \"x\", \"y\"]"),
                ("profile=PTA8C04", "profile=WAGO-750-461"),
            ],
            "4 names for the 2 channels",
        ),
        (MACHINE, &[("\"column\"]", "\"nowhere\"]"), (thermometer, "can://can9")], "nowhere"),
        (MACHINE, &[("token_file = \"tokens\"", ""), (listen, tls)], "reading needs a token"),
        (FIVE, &[], "in reads = [\"C\", \"B\"] where they are not"),
        // `fixed` cannot state the position of a rotary axis that turns.
        (FIVE, &[("key", "fixed = { B = 0.0, C = 0.0 }")], "name it in reads = [\"B\"]"),
        (FIVE, &[("key", "reads = [\"C\"]\nnot_driven = [\"B\"]")], "not_driven: axis B"),
        ("structure = \"w X' b Y Z t\"", &[], "machine.toml"),
    ];
    let others = others.map(|(machine, changes, says)| Wrong::of(machine, changes, says));
    simple.chain(on_lines).chain(others).collect()
}

/// A DBC file without counter signals. A variant of it has an angle for X.
const BARE: &str = "VERSION \"\"\nNS_ :\nBS_:\nBU_: CNC\nBO_ 256 POSITION: 8 CNC\n SG_ X_POS : 0|32@1- (0.0001,0) [0|0] \"mm\" CNC\nBO_ 257 CORRECTION: 8 CNC\n SG_ X_CORR : 0|16@1- (1,0) [0|0] \"um\" CNC\n";

fn folder() -> tempfile::TempDir {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().expect("writable");
    let write = |name: &str, text: &str, mode: u32| {
        let file = dir.path().join(name);
        std::fs::write(&file, text).expect("writable");
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).expect("ours");
    };
    token_file(dir.path());
    write("open", "anna operate 0123456789abcdef0123456789abcdef\n", 0o644);
    write("short", "anna operate 0123\n", 0o600);
    write("bare.dbc", BARE, 0o644);
    write("barrier.dbc", volcomp_can::BARRIER_DBC, 0o644);
    write("deg.dbc", &BARE.replace("\"um\"", "\"deg\""), 0o644);
    // A dangling link, and a folder in place of the log.
    std::os::unix::fs::symlink("missing", dir.path().join("nowhere")).expect("writable");
    std::fs::create_dir_all(dir.path().join("odd/audit.log")).expect("writable");
    volcomp_gateway::http::tls::make(dir.path(), &["localhost".to_owned()]).expect("a pair");
    dir
}

#[test]
fn check_and_the_daemon_refuse_alike() {
    let dir = folder();
    let config = dir.path().join("G.toml");
    for case in cases() {
        std::fs::write(dir.path().join("machine.toml"), case.machine).expect("writable");
        // Files in URLs are relative to the working directory.
        let text = (case.text).replace("dbc=", &format!("dbc={}/", path(dir.path())));
        std::fs::write(&config, &text).expect("writable");
        let check = check::check(&config, false, false).expect_err(&text);
        let daemon = machine(&config).plan().err().expect(&text);
        let said = check.to_string();
        assert_eq!(said, daemon.to_string(), "{text}");
        assert!(said.contains(case.says), "{said} for {} in {text}", case.says);
        assert_eq!([check.status(), daemon.status()], [2; 2], "{said}");
    }
}

/// `check` and the gateway as programs report the same message as the library. `--json` prints the message as one
/// object.
#[test]
fn a_wrong_configuration_ends_the_programs() {
    let dir = folder();
    let config = dir.path().join("G.toml");
    std::fs::write(dir.path().join("machine.toml"), MACHINE).expect("writable");
    let unwatched = RIGHT.replace("heartbeat = { pmc = \"R\", at = 120 }", "");
    std::fs::write(&config, unwatched).expect("writable");
    let call = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(arguments)
            .output()
            .expect("it was built for this test");
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let check = call(&["check", path(&config)]);
    assert_eq!(check, call(&["--config", path(&config)]));
    assert!(check.starts_with("error: ") && check.contains("unwatched = true"));
    let reported = call(&["check", path(&config), "--json"]);
    let error: serde_json::Value = serde_json::from_str(&reported).expect("one object");
    assert_eq!(error["status"], 2);
    let reported = error["error"].as_str();
    assert!(reported.is_some_and(|text| text.contains("unwatched = true")));
}

#[test]
fn a_plan_describes_what_is_opened() {
    use volcomp_gateway::{config::Config, plan::Plan};
    let dir = folder();
    let lines = "url = \"modbus://127.0.0.1:1?profile=ADAM-6050\"\naxes = [\"X\"]\nfixed = { Y = 0.0, Z = 0.0 }\nunwatched = true\nunseen = [\"referenced\", \"alarm\", \"emergency_stop\"]\n[controller.digital]\nposition_bits = 8\nposition_mm_per_count = 10.0\ncorrection_bits = 6";
    let slow = RIGHT.replace("cycle_ms = 4.0", "cycle_ms = 20.0");
    // Six correction bits including the sign hold at most 31 µm.
    let lines = slow.replace(FOCAS, lines).replace("limit_um = 150.0", "limit_um = 31.0");
    for text in [slow, lines] {
        std::fs::write(dir.path().join("machine.toml"), MACHINE).expect("writable");
        let config = Config::parse(&text, "G.toml", dir.path()).unwrap_or_else(|e| panic!("{e}"));
        let plan = Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
        let opened = plan.open().unwrap_or_else(|e| panic!("{e}"));
        let described: Vec<_> = opened.controllers.iter().collect();
        assert_eq!(opened.cycle.descriptions().collect::<Vec<_>>(), described);
    }
}
