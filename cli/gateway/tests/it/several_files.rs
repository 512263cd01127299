//! The file of several machines: what is refused, and what the commands say of it.

use std::process::Command;

use serde_json::Value;
use volcomp_test_support::free_port;

use crate::{
    online::{check, said},
    program::{change, path},
    several::{NAMES, Shop},
};

/// Each thing of which every machine needs one of its own, however it is spelled.
#[test]
fn what_two_machines_have_in_common_is_refused() {
    let shop = Shop::new();
    let config = |name: &str| shop.config(name);
    let refused = |what: &str| {
        for run in [false, true] {
            let output = if run {
                Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
                    .args(["--config", path(&shop.file)])
                    .output()
                    .expect("built")
            } else {
                check(&shop.file, &[])
            };
            let (_, errors, status) = said(&output);
            assert_eq!(status, Some(2), "{errors}");
            assert!(
                errors.contains("mill-1 and mill-2 have in common"),
                "{errors}"
            );
            assert!(errors.contains(what), "{errors}");
        }
    };
    let (_, errors, status) = said(&check(&shop.file, &[]));
    assert_eq!(status, Some(0), "{errors}");
    let [one, two] = [0, 1].map(|number| shop.controls[number].address());
    let by_name = format!("focas://localhost:{}", one.port());
    change(&config("mill-2"), &format!("focas://{two}"), &by_name);
    refused(&format!("one device, focas://{one} and {by_name}"));
    change(&config("mill-2"), &by_name, &format!("focas://{two}"));
    // A folder by another spelling, which is not there yet.
    let link = shop.dir.path().join("elsewhere");
    std::os::unix::fs::symlink(shop.dir.path().join("mill-1"), &link).expect("writable");
    let end = "[dashboard]";
    change(
        &config("mill-2"),
        end,
        "[audit]\ndir = \"../elsewhere/audit\"\n[dashboard]",
    );
    refused("[audit] dir = ");
    change(
        &config("mill-2"),
        "[audit]\ndir = \"../elsewhere/audit\"\n",
        "",
    );
    // A dashboard.
    let port = free_port();
    let address = format!("127.0.0.1:{port}");
    for name in ["mill-1", "mill-2"] {
        change(&config(name), "127.0.0.1:0", &address);
    }
    refused(&format!("[dashboard] listen = {address}"));
    change(&config("mill-2"), &address, "127.0.0.1:0");
    other_systems(&shop, &address, &refused);
    fleet(&shop, &refused);
    // The configuration itself.
    change(&shop.file, "mill-2/G.toml", "elsewhere/G.toml");
    refused("config = ");
    change(&shop.file, "elsewhere/G.toml", "mill-2/G.toml");
    // The overview's own.
    change(&shop.file, "127.0.0.1:0", &format!("127.0.0.1:{port}"));
    let (_, errors, status) = said(&check(&shop.file, &[]));
    assert_eq!(status, Some(2), "{errors}");
    assert!(errors.contains("the overview and mill-1 have in common: [dashboard] listen"));
}

/// Their place in a fleet.
fn fleet(shop: &Shop, refused: &dyn Fn(&str)) {
    if !cfg!(feature = "fleet") {
        return;
    }
    for name in ["mill-1", "mill-2"] {
        use std::os::unix::fs::PermissionsExt as _;
        let file = shop.dir.path().join(name).join("nkey");
        let seed = nkeys::KeyPair::new_user().seed().expect("a seed");
        std::fs::write(&file, seed).expect("writable");
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("ours");
    }
    let member = |machine: &str, dir: &str| {
        format!(
            "[fleet]\nurl = \"nats://127.0.0.1:1\"\nsite = \"berlin\"\nmachine = \"{machine}\"\nserial = \"4711\"\nnkey_file = \"nkey\"\ntrusted_keys = [\"6kpsY+KcUgq+9VB7Ey7F+ZVHdq6+vnuSQh7qaRRG0iw=\"]\ndir = \"{dir}\"\n[dashboard]"
        )
    };
    let one = member("mill-1", "fleet");
    change(&shop.config("mill-1"), "[dashboard]", &one);
    for (other, what) in [
        (member("mill-1", "fleet"), "[fleet] machine = mill-1"),
        (member("mill-2", "../mill-1/fleet"), "[fleet] dir = "),
    ] {
        change(&shop.config("mill-2"), "[dashboard]", &other);
        refused(what);
        change(&shop.config("mill-2"), &other, "[dashboard]");
    }
    change(&shop.config("mill-1"), &one, "[dashboard]");
}

/// What other systems know the machines by. The first machine has its dashboard at `address`.
fn other_systems(shop: &Shop, address: &str, refused: &dyn Fn(&str)) {
    let table = |name: &str, from: &str, to: &str| change(&shop.config(name), from, to);
    let shdr = |listen: &str| {
        format!("[shdr]\nlisten = \"{listen}\"\nanyone_may_read = true\n[dashboard]")
    };
    if cfg!(feature = "shdr") {
        let port = free_port();
        let [own, all] = [format!("127.0.0.1:{port}"), format!("0.0.0.0:{port}")];
        table("mill-1", "[dashboard]", &shdr(&own));
        table("mill-2", "[dashboard]", &shdr(&own));
        refused(&format!("[shdr] listen = {own}"));
        table("mill-2", &shdr(&own), &shdr(&all));
        refused(&format!("one port, [shdr] listen = {own} and {all}"));
        table("mill-2", &shdr(&all), &shdr(address));
        refused(&format!(
            "one port, [dashboard] listen = {address} and [shdr] listen = {address}"
        ));
        table("mill-2", &shdr(address), "[dashboard]");
        table("mill-1", &shdr(&own), "[dashboard]");
    }
    if cfg!(feature = "sparkplug") {
        let node = |url: &str, node: &str| {
            format!(
                "[sparkplug]\nurl = \"{url}\"\ngroup = \"shop\"\nnode = \"{node}\"\n[dashboard]"
            )
        };
        let own = node("mqtt://broker.invalid", "gateway");
        let same = node("mqtt://BROKER.invalid:1883", "gateway");
        let other = node("mqtt://broker.invalid", "gateway-2");
        table("mill-1", "[dashboard]", &own);
        table("mill-2", "[dashboard]", &same);
        refused(
            "[sparkplug] group and node at one broker, mqtt://broker.invalid and mqtt://BROKER.invalid:1883: \
             the client volcomp-shop-gateway",
        );
        table("mill-2", &same, &own);
        refused(
            "[sparkplug] group and node at mqtt://broker.invalid: the client volcomp-shop-gateway",
        );
        table("mill-2", &own, &other);
        let (_, errors, status) = said(&check(&shop.file, &[]));
        assert_eq!(status, Some(0), "{errors}");
        table("mill-2", &other, "[dashboard]");
        table("mill-1", &own, "[dashboard]");
    }
}

/// Files that are wrong, and what is said of them.
#[test]
fn wrong_files_of_several_machines() {
    let shop = Shop::new();
    let text = std::fs::read_to_string(&shop.file).expect("readable");
    let nested = shop.dir.path().join("nested.toml");
    for (from, to, expected) in [
        (
            "mill-2\"",
            "MILL-1\"",
            "shop.toml:5: machine[1].name: found \"MILL-1\" beside \"mill-1\"",
        ),
        (
            "name = \"mill-2\"",
            "name = \"../x\"",
            "machine[1].name: found \"../x\", expected 1 to 40",
        ),
        (
            "name = \"mill-2\"",
            "name = \"\"",
            "machine[1].name: found \"\"",
        ),
        (
            "name = \"mill-2\"\n",
            "",
            "machine[1]: key `name` is missing",
        ),
        (
            "config = \"mill-2/G.toml\"",
            "config = \"\"",
            "machine[1].config: found an empty text",
        ),
        (
            "config = \"mill-2/G.toml\"",
            "config = \"none.toml\"",
            "machine mill-2: ",
        ),
        (
            "config = \"mill-2/G.toml\"",
            "config = \"shop.toml\"",
            "found [[machine]], which holds several machines",
        ),
        (
            "[dashboard]",
            "[guard]\nlimit_um = 1\n[dashboard]",
            "found `guard` beside [[machine]]",
        ),
        ("[dashboard]", "[tokens]\n[dashboard]", "unknown key"),
        (
            "127.0.0.1:0",
            "0.0.0.0:0",
            "tls_certificate and tls_key are needed",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&shop.file, text.replace(from, to)).expect("writable");
        let (_, errors, status) = said(&check(&shop.file, &[]));
        assert_eq!(status, Some(2), "{errors}");
        assert!(errors.contains(expected), "{expected}: {errors}");
    }
    std::fs::write(&nested, "machine = []\n").expect("writable");
    let (_, errors, status) = said(&check(&nested, &[]));
    assert_eq!(status, Some(2), "{errors}");
    assert!(
        errors.contains("found 0 [[machine]], expected 1 to 64"),
        "{errors}"
    );
}

/// What the other commands say of several machines.
#[test]
fn the_commands_know_several_machines() {
    let shop = Shop::new();
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
        said(&command.args(arguments).output().expect("built"))
    };
    let file = path(&shop.file);
    let (text, errors, status) = run(&["check", file]);
    assert_eq!(status, Some(0), "{errors}");
    for name in NAMES {
        let head = format!("{name} ({})\n", shop.config(name).display());
        assert!(text.contains(&head), "{text}");
    }
    assert!(text.ends_with("overview              127.0.0.1:0\n  TLS                 no\n  reading             open to programs on this computer\n"), "{text}");
    let (json, ..) = run(&["check", file, "--json"]);
    let document: Value = serde_json::from_str(&json).expect("one document");
    crate::documents::validate("gateway-check-machines.json", &document);
    assert_eq!(document["machines"][2]["name"], "mill-3");
    // One of them.
    let (json, ..) = run(&["check", file, "--machine", "mill-2", "--json"]);
    let one: Value = serde_json::from_str(&json).expect("one document");
    assert_eq!(one, document["machines"][1]["plan"]);
    let one = ["--machine", "mill-2", "--fault", "emergency_stop", "--json"];
    let (json, errors, status) = run(&[&["rehearse", file][..], &one].concat());
    assert_eq!(status, Some(0), "{errors}");
    assert!(json.contains("mill-2/G.toml"), "{json}");
    for (arguments, expected) in [
        (
            vec!["rehearse", file],
            "holds several machines, expected --machine NAME with one of mill-1, mill-2, mill-3",
        ),
        (
            vec!["check", file, "--machine", "mill-4"],
            "--machine: found \"mill-4\", expected one of mill-1, mill-2, mill-3",
        ),
        (
            vec!["check", path(&shop.config("mill-1")), "--machine", "mill-1"],
            "but this is the configuration of one machine",
        ),
        (vec!["status", "--machine", "mill-1"], "--config"),
    ] {
        let (_, errors, status) = run(&arguments);
        assert_eq!(status, Some(2), "{errors}");
        assert!(errors.contains(expected), "{expected}: {errors}");
    }
    // Of a gateway that runs.
    for name in NAMES {
        let config = shop.config(name);
        change(
            &config,
            "127.0.0.1:0",
            &format!("127.0.0.1:{}", free_port()),
        );
    }
    let program = shop.start();
    shop.all_compensate(&program);
    let listen = program.address.to_string();
    let status = |more: &[&str]| {
        let (text, errors, status) = run(&[&["status", "--config", file][..], more].concat());
        assert_eq!(status, Some(0), "{errors}");
        text
    };
    let text = status(&["--listen", &listen]);
    assert_eq!(text.matches("compensating").count(), 3, "{text}");
    assert!(text.contains("X -20  Y -20  Z 0 µm"), "{text}");
    let json = status(&["--listen", &listen, "--json"]);
    let overview: Value = serde_json::from_str(&json).expect("one document");
    crate::documents::validate("gateway-overview.json", &overview);
    let text = status(&["--machine", "mill-2"]);
    assert!(
        text.starts_with("state             compensating\n"),
        "{text}"
    );
    let (_, errors, ended) = run(&["status", "--listen", &listen]);
    assert_eq!(ended, Some(1));
    assert!(errors.contains("several machines"), "{errors}");
}
