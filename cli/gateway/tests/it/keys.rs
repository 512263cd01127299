//! The keys of a configuration, with every kind of controller and for `[fleet]`.
//!
//! A key without effect for a kind of controller is rejected, and the message names the key.

use std::path::Path;

use volcomp_devices::{Address, Driver, config::uses};
use volcomp_gateway::{config::Config, http::Tokens};
use volcomp_port::{Description, DeviceError};
use volcomp_test_support::{corpus, rows};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Urad};

/// A URL of each scheme, and the name of its kind of controller.
const URLS: [(&str, &str); 7] = [
    ("focas://192.0.2.10:8193", "a FANUC control"),
    ("can://can0", "a bridge on CAN"),
    ("gpio://?position=a:0-14&correction=b:0-7", "digital lines"),
    ("modbus://192.0.2.40?profile=ADAM-6050", "digital lines"),
    ("modbus-rtu:///dev/ttyUSB0?profile=WAGO-750-8DI/8DO", "digital lines"),
    ("opc.tcp://192.0.2.20:4840", "a SINUMERIK control"),
    ("linuxcnc://127.0.0.1:47001", "a LinuxCNC control"),
];

/// The keys of `[[controller]]` other than URL and axes.
const KEYS: [&str; 19] = [
    "channel",
    "reads",
    "fixed",
    "not_driven",
    "includes_correction",
    "terms",
    "hold_ms",
    "test_shift",
    "unwatched",
    "unseen",
    "resolution_um",
    "resolution_urad",
    "area",
    "heartbeat",
    "referenced",
    "barrier",
    "digital",
    "sinumerik",
    "linuxcnc",
];

fn driver(url: &str) -> &'static Driver {
    let address = Address::parse(url).expect("right");
    address.driver().expect("built in")
}

/// A valid value for a key, and an axis for which the value is valid.
fn value(key: &str, kind: &str) -> (&'static str, &'static str) {
    match key {
        "barrier" if kind == "a FANUC control" => (
            "{ machine = 1, scan_ms = 8.0, frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 } }",
            "X",
        ),
        "barrier" => ("{ machine = 1, scan_ms = 8.0 }", "X"),
        "channel" => ("\"emzps\"", "X"),
        "fixed" => ("{ Y = 1.0 }", "X"),
        "reads" => ("[\"A\", \"C\"]", "X"),
        "not_driven" => ("[\"A\"]", "X"),
        "terms" => ("[\"thermal\"]", "X"),
        "hold_ms" if kind == "a SINUMERIK control" => ("1500.0", "X"),
        "hold_ms" => ("100.0", "X"),
        "includes_correction" | "test_shift" | "unwatched" => ("true", "X"),
        "resolution_um" => ("1.0", "X"),
        "resolution_urad" => ("1.0", "C"),
        "area" => ("{ pmc = \"R\", first = 100, width = 2 }", "X"),
        "heartbeat" => ("{ pmc = \"R\", at = 120 }", "X"),
        "referenced" => ("false", "X"),
        "sinumerik" => ("{ numbers = [1] }", "X"),
        "linuxcnc" => ("{ key_file = \"volcomp.key\", ini = \"mill.ini\" }", "X"),
        "digital" => ("{ position_bits = 8 }", "X"),
        "unseen" => ("[\"alarm\", \"referenced\"]", "X"),
        other => panic!("no value for the key {other}"),
    }
}

/// Further keys that `key` needs for a controller of this kind.
fn needed(key: &str, kind: &str) -> String {
    if kind != "a SINUMERIK control" {
        return String::new();
    }
    let needed = ["terms", "hold_ms"].into_iter().filter(|needed| *needed != key);
    needed.fold(String::new(), |text, needed| {
        text + &format!("{needed} = {}\n", value(needed, kind).0)
    })
}

#[test]
fn every_key_with_every_kind_of_controller() {
    let [mut taken, mut refused] = [0, 0];
    for (url, kind) in URLS {
        for key in KEYS {
            let (value, axis) = value(key, kind);
            let text = format!(
                "machine = \"m.toml\"\n[[controller]]\nurl = \"{url}\"\naxes = [\"{axis}\"]\n{key} = {value}\n{}",
                needed(key, kind)
            );
            let found = Config::parse(&text, "G.toml", Path::new("")).map_err(|e| e.to_string());
            if uses(driver(url), false, key) {
                assert!(found.is_ok(), "{key} for {url}: {found:?}");
                taken += 1;
            } else {
                let message = found.expect_err(key);
                assert!(message.starts_with("G.toml:5: "), "{message}");
                let mut names = URLS.iter().filter(|(other, _)| uses(driver(other), false, key));
                let first = names.next().expect("someone uses it").1;
                for part in [key, kind, first] {
                    assert!(message.contains(part), "{part}: {message}");
                }
                refused += 1;
            }
        }
    }
    // 19 keys times 7 URLs.
    assert_eq!([taken, refused], [91, 42]);
}

#[test]
fn a_controller_that_is_only_read_has_no_keys_about_corrections() {
    for (url, kind) in URLS {
        let of = |rest: &str| {
            let text =
                format!("machine = \"m.toml\"\n[[controller]]\nurl = \"{url}\"\naxes = []\n{rest}");
            Config::parse(&text, "G.toml", Path::new("")).map_err(|e| e.to_string())
        };
        assert!(of("reads = [\"C\"]\n").is_ok(), "{url}");
        assert!(of("reads = [\"C\"]\nunseen = [\"alarm\"]\n").is_ok(), "{url}");
        for (rest, says) in [
            ("", "found 0 axes"),
            ("reads = []\n", "found no axis"),
            ("reads = [\"C\", \"C\"]\n", "duplicate axis C"),
        ] {
            let message = of(rest).expect_err(rest);
            assert!(message.contains(says), "{message}");
        }
        for key in KEYS {
            let reads = ["reads", "referenced", "unseen", "digital", "sinumerik", "linuxcnc"];
            if reads.contains(&key) || !uses(driver(url), false, key) {
                continue;
            }
            let (value, _) = value(key, kind);
            let message = of(&format!("reads = [\"C\"]\n{key} = {value}\n")).expect_err(key);
            assert!(message.contains("only read") && message.contains(key), "{message}");
        }
    }
    let twice = "machine = \"m.toml\"\n[[controller]]\nurl = \"can://can0\"\naxes = [\"X\"]\nreads = [\"C\", \"X\"]\n";
    let refused = Config::parse(twice, "G.toml", Path::new("")).expect_err("refused");
    assert!(refused.to_string().contains("axis X is also in axes"), "{refused}");
}

/// A linear axis is rejected if it has the rotary key of a pair in addition to the linear key, because both keys of a
/// pair are checked.
#[test]
fn a_key_of_the_other_kind_is_refused_next_to_the_right_one() {
    let text = "machine = \"m.toml\"\n[[controller]]\nurl = \"gpio://?position=a:0-14&correction=b:0-7\"\naxes = [\"X\"]\n[controller.digital]\nposition_mm_per_count = 0.1\nposition_deg_per_count = 0.1\n";
    let refused = Config::parse(text, "G.toml", Path::new("")).expect_err("refused");
    let message = refused.to_string();
    assert!(message.starts_with("G.toml:7: "), "{message}");
}

/// Each key for rotary axes is rejected if `limit_urad` is missing.
#[test]
fn keys_of_rotary_axes_need_their_limit() {
    for key in
        ["warn_urad", "slew_urad_per_s", "accel_urad_per_s2", "confirm_urad", "test_shift_urad"]
    {
        let text = format!(
            "machine = \"m.toml\"\n[guard]\nlimit_um = 100.0\nslew_um_per_s = 100.0\nhold_ms = 50\nzero_after_ms = 500\n{key} = 1.0\n[[controller]]\nurl = \"can://can0\"\naxes = [\"X\"]\n"
        );
        let refused = Config::parse(&text, "G.toml", Path::new("")).expect_err(key);
        let message = refused.to_string();
        assert!(message.starts_with("G.toml:7: ") && message.contains(key), "{message}");
        assert!(message.contains("limit_urad"), "{message}");
    }
}

/// A file with ten errors in all its tables gives ten messages, each with line and key.
#[test]
fn every_mistake_is_reported_at_once() {
    let text = "cycle_ms = 400.0
auto_arm = 1
[guard]
limit_um = \"much\"
warn_um = 200
hold = 50
zero_after_ms = 500
[[controller]]
url = \"can://can0\"
axes = [\"X\", \"X\"]
area = { pmc = \"Q\", first = 100 }
unwatched = true
[[controller]]
url = \"sinumerik-s7://192.0.2.9\"
axes = [\"Q\"]
[dashboard]
listen = \"here\"
tls_key = \"key.pem\"
[several]
";
    let refused = Config::parse(text, "G.toml", Path::new("")).expect_err("wrong");
    let said = refused.to_string();
    let found: Vec<String> = said.lines().map(|line| line.chars().take(64).collect()).collect();
    let expected = [
        "G.toml:1: key `machine` is missing",
        "G.toml:1: cycle_ms: found 400, expected a number from 0.25 to 10",
        "G.toml:2: auto_arm: found 1, expected true or false",
        "G.toml:3: guard: key `slew_um_per_s` is missing",
        "G.toml:3: guard: key `hold_ms` is missing",
        "G.toml:4: guard.limit_um: found the text \"much\", expected a fin",
        "G.toml:6: guard.hold: unknown key, did you mean `hold_ms`?",
        "G.toml:10: controller[0].axes: duplicate axis X",
        "G.toml:11: controller[0].area.pmc: found \"Q\", expected one of: ",
        "G.toml:14: controller[1].url: found \"sinumerik-s7://192.0.2.9\", ",
        "G.toml:15: controller[1].axes: found \"Q\", expected one of the a",
        "G.toml:17: dashboard.listen: found \"here\", expected an address ",
        "G.toml:18: dashboard.tls_key: found one of tls_certificate and t",
        "G.toml:19: several: found several machines in one gateway, which",
    ];
    for (found, expected) in found.iter().zip(expected) {
        assert!(found.starts_with(expected), "{found}\n{said}");
    }
    assert_eq!(found.len(), expected.len(), "{said}");
}

/// A configuration of one axis on the eight lines of a module; no device is accessed.
fn lines(axis: &str, keys: &str) -> String {
    format!(
        "machine = \"m.toml\"\n[[controller]]\nurl = \"modbus://127.0.0.1:9?profile=WAGO-750-8DI/8DO\"\naxes = [\"{axis}\"]\nunwatched = true\n{keys}\n"
    )
}

fn parsed(text: &str) -> Result<Config, String> {
    Config::parse(text, "G.toml", Path::new("")).map_err(|e| e.to_string())
}

/// The description of the first controller before it is opened.
fn described(config: &Config) -> Result<Description, DeviceError> {
    volcomp_devices::controller(&config.controllers[0])?.describe()
}

/// A configured step of 5 µrad on digital lines is written as 5 µrad, instead of the default of 1000 µrad.
#[test]
fn a_rotary_axis_on_lines_has_its_own_steps() {
    let keys = "resolution_urad = 5.0\n[controller.digital]\nposition_bits = 8\nposition_deg_per_count = 1.5\nposition_zero_deg = -180.0";
    let config = parsed(&lines("C", keys)).expect("good");
    let axis = described(&config).expect("good").axes[0];
    assert_eq!(axis.name, AxisName::C);
    assert_eq!(axis.resolution, Displacement::Angle(Urad(5.0).to_rad()));
    let words = config.controllers[0].digital_axis(AxisName::C).expect("good");
    // A step of 1.5° is π/120 rad.
    let quarter = words.position.decode(60).position;
    assert!((quarter + std::f64::consts::FRAC_PI_2).abs() < 1e-12, "{quarter}");
    assert!(
        (words.position.decode(61).position - quarter - std::f64::consts::PI / 120.0).abs() < 1e-12
    );
    let linear =
        parsed(&lines("X", "resolution_um = 0.5\n[controller.digital]\nposition_bits = 8"));
    let step = described(&linear.expect("good")).expect("good").axes[0].resolution;
    assert_eq!(step, Displacement::from_micro(AxisKind::Linear, 0.5));
}

#[test]
fn keys_of_the_other_kind_are_refused() {
    for (axis, keys, line, key) in [
        ("C", "resolution_um = 5.0", 6, "resolution_um"),
        ("X", "resolution_urad = 5.0", 6, "resolution_urad"),
        ("C", "[controller.digital]\nposition_mm_per_count = 0.1", 7, "position_mm_per_count"),
        ("C", "[controller.digital]\nposition_zero_mm = 0.1", 7, "position_zero_mm"),
        ("Z", "[controller.digital]\nposition_deg_per_count = 0.1", 7, "position_deg_per_count"),
    ] {
        let message = parsed(&lines(axis, keys)).expect_err("refused");
        assert!(message.starts_with(&format!("G.toml:{line}: ")), "{message}");
        assert!(
            message.contains(key) && message.contains(&format!("the axes {axis}")),
            "{message}"
        );
    }
    let config = parsed(&lines("B", "resolution_urad = 5.0")).expect("each key for itself is good");
    let refused = described(&config).expect_err("refused");
    assert!(refused.is_input());
    let message = refused.to_string();
    assert!(message.contains("position_deg_per_count: missing"), "{message}");
    assert!(message.contains("axis B is rotary"), "{message}");
}

/// Replays the stored inputs of the fuzz target.
#[test]
fn configurations_and_tokens() {
    corpus::replay("config", |_, bytes| {
        let text = String::from_utf8_lossy(bytes);
        let has_tokens = || Tokens::parse(&text).is_ok_and(|tokens| !tokens.is_empty());
        let read = Config::parse(&text, "corpus", "".as_ref()).map(|_| ());
        read.or_else(|error| has_tokens().then_some(()).ok_or(error))
    });
}

const KEY: &str = "6kpsY+KcUgq+9VB7Ey7F+ZVHdq6+vnuSQh7qaRRG0iw=";

/// Parses a configuration with a fleet whose line for `key` is replaced.
fn with(key: &str, line: &str) -> Result<Config, String> {
    let lines = [
        ("url", "url = \"nats://127.0.0.1:4222\"".to_owned()),
        ("site", "site = \"berlin\"".to_owned()),
        ("machine", "machine = \"mill-1\"".to_owned()),
        ("serial", "serial = \"4711\"".to_owned()),
        ("nkey_file", "nkey_file = \"nkey\"".to_owned()),
        ("trusted_keys", format!("trusted_keys = [\"{KEY}\"]")),
    ];
    let mut text =
        "machine = \"m.toml\"\n[[controller]]\nurl = \"can://can0\"\naxes = [\"X\"]\n[fleet]\n"
            .to_owned();
    for (name, usual) in lines {
        text += if name == key { line } else { &usual };
        text += "\n";
    }
    if !text.contains(line) {
        text += line;
    }
    Config::parse(&text, "G.toml", Path::new("folder")).map_err(|e| e.to_string())
}

#[test]
fn each_wrong_key_is_named() {
    let config = with("", "").expect("right");
    let fleet = config.fleet.expect("there");
    assert_eq!(fleet.dir, Path::new("folder/fleet"));
    assert_eq!(fleet.nkey_file, Path::new("folder/nkey"));
    for [key, line, expected] in rows(
        r#"
url |  | url
url | url = "http://a:1" | expected nats://HOST:PORT
url | url = "nats://a:1," | expected nats://HOST:PORT
url | url = "nats://user:secret@a:1" | expected nats://HOST:PORT
site | site = "Berlin" | lower-case
machine | machine = "mill.1" | lower-case
serial | serial = " " | serial number
nkey_file | nkey_file = "" | expected a path
trusted_keys | trusted_keys = [] | at least one
trusted_keys | trusted_keys = ["abc"] | base64 of 32 bytes
// A trusted key that is publicly known, so that anyone can sign.
trusted_keys | trusted_keys = ["AQAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA="] | of large order
 | ca = "ca.pem" | tls://
 | password = "x" | password
"#,
    ) {
        let message = with(key, line).expect_err(line);
        assert!(message.contains(expected), "{line}: {message}");
        assert!(message.starts_with("G.toml:"), "{message}");
    }
    let twice = format!("trusted_keys = [\"{KEY}\", \"{KEY}\"]");
    let message = with("trusted_keys", &twice).expect_err("twice");
    assert!(message.contains("duplicate"), "{message}");
}

#[cfg(not(feature = "fleet"))]
#[test]
fn a_build_without_the_fleet_refuses_it() {
    let dir = tempfile::tempdir().expect("writable");
    let config = crate::manual::served_configuration(dir.path(), "");
    let text = std::fs::read_to_string(&config).expect("readable");
    let fleet = format!(
        "[fleet]\nurl = \"nats://127.0.0.1:4222\"\nsite = \"berlin\"\nmachine = \"mill-1\"\nserial = \"4711\"\nnkey_file = \"nkey\"\ntrusted_keys = [\"{KEY}\"]\n"
    );
    std::fs::write(&config, text + &fleet).expect("writable");
    let (_, message, status) = crate::check::check(&config, &[]);
    assert_eq!(status, 2);
    assert!(message.contains("--features fleet"), "{message}");
}

/// `check` prints the machine's identity, the trusted keys and the active manifest, and rejects a seed file that other users can read.
#[cfg(feature = "fleet")]
#[test]
fn check_says_who_the_machine_is() {
    use std::os::unix::fs::PermissionsExt;
    let Some(centre) = crate::fleet_bench::Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let check = |options: &[&str]| crate::check::check(&config, options);
    let (text, ..) = check(&[]);
    for words in [
        "machine = \"mill-1\"",
        "serial = \"4711\"",
        "# nkey = \"U",
        "# version = 0\n",
        "# enabled = true\n",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let plan = serde_json::from_str(&check(&["--json"]).0).expect("one document");
    crate::interop::validate("gateway-check.json", &plan);
    let nkey = dir.path().join("nkey");
    std::fs::set_permissions(&nkey, std::fs::Permissions::from_mode(0o640)).expect("ours");
    let (_, message, status) = check(&[]);
    assert_eq!(status, 2);
    assert!(message.contains("found mode 640"), "{message}");
    std::fs::write(&nkey, "SUNOSEED").expect("writable");
    std::fs::set_permissions(&nkey, std::fs::Permissions::from_mode(0o600)).expect("ours");
    let (_, message, _) = check(&[]);
    assert!(message.contains("seed of an nkey"), "{message}");
    assert!(!message.contains("NOSEED"), "{message}");
}
