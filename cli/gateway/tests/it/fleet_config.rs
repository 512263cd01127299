//! Errors in the `[fleet]` table of a configuration, and the output of `check`.

use std::path::Path;

use volcomp_gateway::config::Config;
use volcomp_test_support::rows;

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
    let (_, message, status) = crate::online::check(&config, &[]);
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
    let check = |options: &[&str]| crate::online::check(&config, options);
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
    crate::documents::validate("gateway-check.json", &plan);
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
