#![no_main]
//! Values under a machine's key: no panic on any bytes, and only values signed by the trusted key are accepted.

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
