#![no_main]
//! Laser files: no panic on any bytes, and an accepted file can be evaluated and written.

use libfuzzer_sys::fuzz_target;
use volcomp_metrology::{RenishawKind, evaluate, parse_renishaw, write_renishaw};

fuzz_target!(|bytes: &[u8]| {
    for kind in [RenishawKind::Linear, RenishawKind::Angular, RenishawKind::Straightness] {
        if let Ok(measurement) = parse_renishaw(bytes, "fuzz", kind) {
            let _ = evaluate(&measurement);
            let _ = write_renishaw(&measurement);
        }
    }
});
