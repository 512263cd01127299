//! Replays the fuzz corpus: `valid-…` files must parse, `broken-…` files must be rejected.

use std::path::Path;

use sha2::{Digest, Sha256};
use volcomp_kinematics::State;
use volcomp_model::{CompiledMachine, Machine, evaluator::BLOB_VERSION};
use volcomp_vocabulary::PerAxis;

fn replay(target: &str, is_read: impl Fn(&[u8]) -> bool) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus").join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let read = is_read(&std::fs::read(&path).unwrap());
        assert!(read || !name.starts_with("valid-"), "{name} was refused");
        assert!(!read || !name.starts_with("broken-"), "{name} was read");
        count += 1;
    }
    assert!(count >= 3, "{count} files for {target}");
}

#[test]
fn machine_files() {
    replay("machine", |bytes| {
        let text = String::from_utf8_lossy(bytes);
        Machine::parse(&text, "corpus").is_ok_and(|machine| {
            let again = Machine::parse(&machine.to_toml(), "written").unwrap();
            assert_eq!(again.checksum(), machine.checksum());
            true
        })
    });
}

#[test]
fn compiled_machines() {
    replay("compiled", |body| {
        let mut blob = b"VOLCOMPM".to_vec();
        blob.extend(BLOB_VERSION.to_le_bytes());
        blob.extend(Sha256::digest(body));
        blob.extend(body);
        CompiledMachine::from_blob(&blob).is_ok_and(|machine| {
            let _ = machine.evaluate(&State { q: PerAxis([f64::INFINITY; 9]), ..State::default() });
            true
        })
    });
}
