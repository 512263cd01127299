//! The text of the server's configuration.

use volcomp_fleet::{MachineUser, NoConfiguration, ServerSettings};

use crate::bench::identity;

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
fn nothing_breaks_out_of_its_place() {
    for bad in ["a\"b", "a\nb", "a\\b"] {
        let mut named = settings();
        named.name = bad.to_owned();
        assert!(matches!(named.text(), Err(NoConfiguration::Text { .. })));
        let mut keyed = settings();
        keyed.machines[0].nkey = bad.to_owned();
        assert!(matches!(keyed.text(), Err(NoConfiguration::Nkey { .. })));
    }
    // The seed in place of the public key would stand in a file that others read.
    let mut seed = settings();
    seed.machines[0].nkey = nkeys::KeyPair::new_user().seed().unwrap();
    assert!(matches!(seed.text(), Err(NoConfiguration::Nkey { .. })));
}

#[test]
fn one_key_is_one_user() {
    let mut twice = settings();
    twice.machines.push(MachineUser {
        identity: identity("mill-b"),
        nkey: twice.machines[0].nkey.clone(),
    });
    assert!(matches!(twice.text(), Err(NoConfiguration::Twice { .. })));
}
