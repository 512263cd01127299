//! Binary format: a machine that is written and read again is the same, with thermal offsets and motion frames; older
//! versions can be read; invalid bytes are rejected.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use volcomp_evaluator::{BlobError, EvaluatorError};
use volcomp_kinematics::{ErrorMotion, MotionFrame, State};
use volcomp_model::{CompiledMachine, Machine, Tolerance};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::PerAxis;

use crate::{
    EXAMPLE,
    machines::{machine, random_state},
};

/// Header length, bytes: signature, version, checksum.
const HEAD: usize = 44;
/// Length of the thermal offsets of one axis, bytes: six numbers at the tip, three slopes.
const THERMAL: usize = 9 * 8;
/// Length of the motion frame of one axis, bytes.
const FRAME: usize = 8;

fn compiled() -> CompiledMachine {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    machine.compile(Tolerance::default()).unwrap()
}

fn places() -> impl Iterator<Item = State> {
    (0..50).map(|step| {
        let q = f64::from(step);
        State { q: PerAxis::leading([0.01 * q, 80.0 * q, 40.0 * q, 25.0 * q]), ..State::default() }
    })
}

/// The machine in format version 2, without thermal offsets.
fn version_2(machine: &CompiledMachine) -> Vec<u8> {
    let mut blob = version_3(machine);
    blob.truncate(blob.len() - THERMAL * machine.chain().joints().len());
    blob[8] = 2;
    with_checksum(blob)
}

/// The machine in format version 3, without motion frames.
fn version_3(machine: &CompiledMachine) -> Vec<u8> {
    let mut blob = machine.to_blob();
    blob.truncate(blob.len() - FRAME * machine.chain().joints().len());
    blob[8] = 3;
    with_checksum(blob)
}

fn with_checksum(mut blob: Vec<u8>) -> Vec<u8> {
    let sum = Sha256::digest(&blob[HEAD..]);
    blob[12..HEAD].copy_from_slice(&sum);
    blob
}

#[test]
fn thermal_offsets_go_with_the_bytes() {
    let cold = compiled();
    let mut warm = cold.clone();
    let offset = ErrorMotion::from_um_urad([5.0, -3.0, 2.0, 4.0, 7.0, -6.0]);
    warm.set_thermal_offset(1, &offset, [1e-5, 0.0, 2e-6]);
    let read = CompiledMachine::from_blob(&warm.to_blob()).unwrap();
    let mut moved = 0.0_f64;
    for state in places() {
        assert_eq!(read.evaluate(&state), warm.evaluate(&state));
        assert_eq!(read.first_order(&state), warm.first_order(&state));
        let (a, b) = (warm.evaluate(&state), cold.evaluate(&state));
        moved = moved.max((a.position_mm[0] - b.position_mm[0]).abs());
    }
    assert!(moved > 0.005, "the offsets move the tip: {moved} mm");
}

#[test]
fn version_2_is_read_without_thermal_offsets() {
    let cold = compiled();
    let read = CompiledMachine::from_blob(&version_2(&cold)).unwrap();
    for state in places() {
        assert_eq!(read.evaluate(&state), cold.evaluate(&state));
    }
}

#[test]
fn motion_frames_go_with_the_bytes_and_version_3_has_none() {
    let fixed = compiled();
    let text = EXAMPLE.replace("[axes.C]", "[axes.C]\nmotion_frame = \"turning\"");
    let turning = Machine::parse(&text, "m").unwrap();
    let turning = turning.compile(Tolerance::default()).unwrap();
    let read = CompiledMachine::from_blob(&turning.to_blob()).unwrap();
    let older = CompiledMachine::from_blob(&version_3(&turning)).unwrap();
    assert_eq!(read, turning);
    let mut moved = 0.0_f64;
    for state in places() {
        assert_eq!(read.evaluate(&state), turning.evaluate(&state));
        let (a, b) = (turning.evaluate(&state), fixed.evaluate(&state));
        moved = moved.max((a.position_mm[0] - b.position_mm[0]).abs());
    }
    assert!(moved > 1e-4, "the frame moves the tip: {moved} mm");
    for joint in older.chain().joints() {
        assert_eq!(joint.motion_frame, MotionFrame::Fixed);
    }
}

#[test]
fn each_fault_of_a_blob_has_its_error() {
    let machine = compiled();
    let axes = machine.chain().joints().len();
    let blob = machine.to_blob();
    let refused = |blob: &[u8]| match CompiledMachine::from_blob(blob) {
        Err(EvaluatorError::Blob(reason)) => reason,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(&blob[..30]), BlobError::CutOff);
    assert_eq!(refused(&[b'x'; 60]), BlobError::NotABlob);
    let mut version = blob.clone();
    version[8] = 5;
    assert_eq!(refused(&version), BlobError::Version { found: 5, expected: 4 });
    let mut changed = blob.clone();
    changed[100] ^= 1;
    assert_eq!(refused(&changed), BlobError::Checksum);
    assert_eq!(refused(&blob[..blob.len() - 8]), BlobError::Checksum);
    let mut longer = blob.clone();
    longer.push(0);
    assert_eq!(refused(&with_checksum(longer)), BlobError::TooLong);
    let mut no_number = blob.clone();
    let last = no_number.len() - FRAME * axes - 8;
    no_number[last..last + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    assert_eq!(refused(&with_checksum(no_number)), BlobError::NotFinite);
    let mut frame = blob.clone();
    let last = frame.len() - FRAME;
    frame[last] = 2;
    assert!(matches!(refused(&with_checksum(frame)), BlobError::TooMany { found: 2, .. }));
    let mut letters = blob;
    letters[HEAD] = 200;
    assert!(matches!(refused(&with_checksum(letters)), BlobError::TooMany { found: 200, .. }));
}

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

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(2000))]
    /// Changed bytes with a corrected checksum give a machine or an error, and the machine can be evaluated.
    #[test]
    fn changed_blobs_do_not_panic(place in 44..40_000_usize, byte in 0..=255_u8, cut in 0..3_usize) {
        static BLOB: std::sync::LazyLock<Vec<u8>> = std::sync::LazyLock::new(|| {
            let machine = Machine::parse(EXAMPLE, "m").unwrap();
            machine.compile(Tolerance::from_nm(100.0)).unwrap().to_blob()
        });
        let mut blob = BLOB.clone();
        // The first bytes have counts and names, the rest mostly numbers.
        let place = if place % 2 == 0 { 44 + place % 400 } else { place };
        if let Some(there) = blob.get_mut(place) {
            *there = byte;
        }
        blob.truncate(blob.len() - cut);
        let blob = with_checksum(blob);
        if let Ok(machine) = CompiledMachine::from_blob(&blob) {
            for q in [-1e9, -1.0, 0.0, 400.0, 1e300, f64::NAN] {
                let state = State { q: PerAxis([q; 9]), ..State::default() };
                let _ = (machine.evaluate(&state), machine.first_order(&state));
            }
        }
    }
}
