#![no_main]
//! Responses of devices to a search of the network: no panic on any bytes, and stored texts have no control characters.

use libfuzzer_sys::fuzz_target;
use volcomp_centre::discover::{Identification, parse_identification};

fuzz_target!(|bytes: &[u8]| {
    if let Some(Identification::Objects(objects)) = parse_identification(bytes) {
        assert!(objects.iter().flatten().all(|text| !text.contains(char::is_control)));
    }
});
