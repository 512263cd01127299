//! A compiled machine as bytes: the same machine when read again; broken bytes are refused and never panic.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::State;
use volcomp_model::{CompiledMachine, Machine, Tolerance};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::PerAxis;

use crate::{
    EXAMPLE,
    machines::{machine, random_state},
};

#[test]
fn a_blob_is_the_same_machine() {
    let mut machines = vec![Machine::parse(EXAMPLE, "m").unwrap()];
    machines.extend(all_types().iter().map(|s| machine(s, 400)));
    for machine in machines {
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let blob = compiled.to_blob();
        let read = CompiledMachine::from_blob(&blob).unwrap();
        assert_eq!(read.tolerance(), compiled.tolerance());
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        for _ in 0..500 {
            let state = random_state(&machine, &mut rng);
            let (one, other) = (compiled.evaluate(&state), read.evaluate(&state));
            for k in 0..3 {
                assert!((one.position_mm[k] - other.position_mm[k]).abs() < 1e-15);
                assert!((one.rotation_rad[k] - other.rotation_rad[k]).abs() < 1e-18);
            }
            assert_eq!(compiled.outside_range(&state), read.outside_range(&state));
        }
    }
}

#[test]
fn broken_blobs_are_refused() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let blob = machine.compile(Tolerance::default()).unwrap().to_blob();
    let reason = |blob: &[u8]| CompiledMachine::from_blob(blob).unwrap_err().to_string();
    assert!(reason(&blob[..20]).contains("ends too early"));
    assert!(reason(b"something else that is long enough for a head of bytes").contains("VOLCOMPM"));
    let mut version = blob.clone();
    version[8] = 9;
    assert!(reason(&version).contains("found version 9, expected 4"));
    let mut changed = blob.clone();
    changed[100] ^= 1;
    assert!(reason(&changed).contains("checksum"));
    assert!(reason(&blob[..blob.len() - 8]).contains("checksum"));
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(2000))]
    /// Bytes changed with their checksum mended make a machine or a message, and evaluate without panic.
    #[test]
    fn changed_blobs_do_not_panic(place in 44..40_000_usize, byte in 0..=255_u8, cut in 0..3_usize) {
        use sha2::{Digest, Sha256};
        static BLOB: std::sync::LazyLock<Vec<u8>> = std::sync::LazyLock::new(|| {
            let machine = Machine::parse(EXAMPLE, "m").unwrap();
            machine.compile(Tolerance::from_nm(100.0)).unwrap().to_blob()
        });
        let mut blob = BLOB.clone();
        // Small places hold the counts and names, the rest is mostly numbers.
        let place = if place % 2 == 0 { 44 + place % 400 } else { place };
        if let Some(there) = blob.get_mut(place) {
            *there = byte;
        }
        blob.truncate(blob.len() - cut);
        let sum = Sha256::digest(&blob[44..]);
        blob[12..44].copy_from_slice(&sum);
        if let Ok(machine) = CompiledMachine::from_blob(&blob) {
            for q in [-1e9, -1.0, 0.0, 400.0, 1e300, f64::NAN] {
                let state = State { q: PerAxis([q; 9]), ..State::default() };
                let _ = (machine.evaluate(&state), machine.first_order(&state));
            }
        }
    }
}
