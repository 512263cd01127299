#![no_main]
//! Audit logs: no panic on any bytes, and cutting the log after its complete records leaves the same records.

use libfuzzer_sys::fuzz_target;
use volcomp_gateway::audit::verify;

fuzz_target!(|bytes: &[u8]| {
    let found = verify(bytes);
    assert_eq!(verify(&bytes[..found.end]).records, found.records);
});
