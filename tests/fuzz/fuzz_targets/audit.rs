#![no_main]
//! Audit logs: no panic on any bytes, and the complete records are still complete without the rest.

use libfuzzer_sys::fuzz_target;
use volcomp_gateway::audit::verify;

fuzz_target!(|bytes: &[u8]| {
    let found = verify(bytes);
    assert_eq!(verify(&bytes[..found.end]).records, found.records);
});
