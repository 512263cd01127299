#![no_main]
//! Compiled machines with a corrected checksum: no panic on reading or evaluating any bytes.

use libfuzzer_sys::fuzz_target;
use sha2::{Digest, Sha256};
use volcomp_evaluator::{BLOB_VERSION, CompiledMachine};
use volcomp_kinematics::State;
use volcomp_vocabulary::PerAxis;

fuzz_target!(|body: &[u8]| {
    let mut blob = b"VOLCOMPM".to_vec();
    blob.extend(BLOB_VERSION.to_le_bytes());
    blob.extend(Sha256::digest(body));
    blob.extend(body);
    if let Ok(machine) = CompiledMachine::from_blob(&blob) {
        for q in [-1e9, 0.0, 400.0, f64::INFINITY, f64::NAN] {
            let state = State { q: PerAxis([q; 9]), ..State::default() };
            let _ = (machine.evaluate(&state), machine.first_order(&state), machine.outside_range(&state));
        }
        assert!(CompiledMachine::from_blob(&machine.to_blob()).is_ok());
    }
});
