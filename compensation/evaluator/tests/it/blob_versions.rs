//! Versions of a compiled machine as bytes: thermal offsets are in, older versions are read, and what is refused can be matched.

use sha2::{Digest, Sha256};
use volcomp_evaluator::{BlobError, CompiledMachine, EvaluatorError};
use volcomp_kinematics::{ErrorMotion, MotionFrame, State};
use volcomp_model::{Machine, Tolerance};
use volcomp_vocabulary::PerAxis;

use crate::EXAMPLE;

/// Bytes of head: letters, version, checksum.
const HEAD: usize = 44;
/// Bytes of the thermal offsets of one axis: six numbers at the tip and three slopes.
const THERMAL: usize = 9 * 8;
/// Bytes of the motion frame of one axis.
const FRAME: usize = 8;

fn compiled() -> CompiledMachine {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    machine.compile(Tolerance::default()).unwrap()
}

fn places() -> impl Iterator<Item = State> {
    (0..50).map(|step| {
        let q = f64::from(step);
        State {
            q: PerAxis::leading([0.01 * q, 80.0 * q, 40.0 * q, 25.0 * q]),
            ..State::default()
        }
    })
}

/// The same machine as the version before thermal offsets would have written it.
fn version_2(machine: &CompiledMachine) -> Vec<u8> {
    let mut blob = version_3(machine);
    blob.truncate(blob.len() - THERMAL * machine.chain().joints().len());
    blob[8] = 2;
    mended(blob)
}

/// The same machine as the version before motion frames would have written it.
fn version_3(machine: &CompiledMachine) -> Vec<u8> {
    let mut blob = machine.to_blob();
    blob.truncate(blob.len() - FRAME * machine.chain().joints().len());
    blob[8] = 3;
    mended(blob)
}

fn mended(mut blob: Vec<u8>) -> Vec<u8> {
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
fn what_is_refused_can_be_matched() {
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
    assert_eq!(
        refused(&version),
        BlobError::Version {
            found: 5,
            expected: 4
        }
    );
    let mut changed = blob.clone();
    changed[100] ^= 1;
    assert_eq!(refused(&changed), BlobError::Checksum);
    let mut longer = blob.clone();
    longer.push(0);
    assert_eq!(refused(&mended(longer)), BlobError::TooLong);
    let mut no_number = blob.clone();
    let last = no_number.len() - FRAME * axes - 8;
    no_number[last..last + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    assert_eq!(refused(&mended(no_number)), BlobError::NotFinite);
    let mut frame = blob.clone();
    let last = frame.len() - FRAME;
    frame[last] = 2;
    assert!(matches!(
        refused(&mended(frame)),
        BlobError::TooMany { found: 2, .. }
    ));
    let mut letters = blob;
    letters[HEAD] = 200;
    assert!(matches!(
        refused(&mended(letters)),
        BlobError::TooMany { found: 200, .. }
    ));
}
