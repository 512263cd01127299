#![no_main]
//! Values of the key of a machine: no panic on any bytes, and nothing is accepted but what the trusted key signed.

use libfuzzer_sys::fuzz_target;
use volcomp_fleet::{Desired, SigningKey, Trust};

fuzz_target!(|bytes: &[u8]| {
    let Ok(desired) = Desired::parse(bytes) else { return };
    let again = desired.bytes().expect("plain data");
    assert_eq!(Desired::parse(&again).expect("its own bytes"), desired);
    let trust = Trust {
        keys: vec![SigningKey::from_bytes(&[7; 32]).verifying_key()],
        machine: "mill-1".parse().expect("a name"),
        serial: "4711".to_owned(),
        axes: Vec::new(),
        highest: 0,
    };
    // No manifest for a machine without axes was ever signed with this key.
    assert!(trust.accept(&desired).is_err());
});
