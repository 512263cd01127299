//! The text of the server's configuration.

use volcomp_fleet::{MachineUser, ServerConfigError, ServerSettings};

use crate::identity;

fn settings() -> ServerSettings {
    ServerSettings {
        name: "one".to_owned(),
        listen: "127.0.0.1:4222".to_owned(),
        store: "/var/lib/nats".into(),
        tls: None,
        cluster: None,
        centres: vec![nkeys::KeyPair::new_user().public_key()],
        machines: vec![MachineUser {
            identity: identity("mill-a"),
            nkey: nkeys::KeyPair::new_user().public_key(),
        }],
    }
}

#[test]
fn texts_cannot_inject_configuration() {
    for bad in ["a\"b", "a\nb", "a\\b"] {
        let mut named = settings();
        named.name = bad.to_owned();
        assert!(matches!(named.text(), Err(ServerConfigError::Text { .. })));
        let mut keyed = settings();
        keyed.machines[0].nkey = bad.to_owned();
        assert!(matches!(keyed.text(), Err(ServerConfigError::Nkey { .. })));
    }
    // A seed given instead of the public key would appear in a file that others can read.
    let mut seed = settings();
    seed.machines[0].nkey = nkeys::KeyPair::new_user().seed().unwrap();
    assert!(matches!(seed.text(), Err(ServerConfigError::Nkey { .. })));
}

#[test]
fn duplicate_nkeys_are_rejected() {
    let mut twice = settings();
    twice
        .machines
        .push(MachineUser { identity: identity("mill-b"), nkey: twice.machines[0].nkey.clone() });
    assert!(matches!(twice.text(), Err(ServerConfigError::Twice { .. })));
}

#[test]
fn an_address_has_a_scheme_a_host_and_a_port() {
    for right in [
        "nats://127.0.0.1:4222",
        "tls://nats.shop.lan",
        "nats://a:1, tls://[2001:db8::1]:4222 ,nats://[::1]",
    ] {
        assert_eq!(volcomp_fleet::wrong_address(right), None, "{right}");
    }
    for (text, wrong) in [
        ("", ""),
        ("127.0.0.1:4222", "127.0.0.1:4222"),
        ("nats://a:1,", ""),
        ("nats://a:1,ws://b:1", "ws://b:1"),
        ("nats://", "nats://"),
        ("nats://:4222", "nats://:4222"),
        ("nats://a:", "nats://a:"),
        ("nats://a:0", "nats://a:0"),
        ("nats://a:65536", "nats://a:65536"),
        ("nats://a:+1", "nats://a:+1"),
        ("nats://a:1:2", "nats://a:1:2"),
        ("nats://a b:1", "nats://a b:1"),
        ("nats://u:p@a:1", "nats://u:p@a:1"),
        ("nats://a:1/x", "nats://a:1/x"),
        ("nats://[::1", "nats://[::1"),
        ("nats://[::1]4222", "nats://[::1]4222"),
        ("nats://[a]:1", "nats://[a]:1"),
    ] {
        assert_eq!(volcomp_fleet::wrong_address(text), Some(wrong), "{text}");
    }
}
