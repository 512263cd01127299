//! Which manifests a machine accepts, including those of the fuzz corpus.

use std::path::Path;

use proptest::prelude::*;
use volcomp_fleet::{Desired, Manifest, ManifestRejection, ModelRef, SigningKey, Trust};
use volcomp_vocabulary::AxisName;

const MODEL: &str = "structure = \"w X' b Y Z t\"\n";

fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

fn manifest() -> Manifest {
    Manifest {
        machine: "mill-1".parse().unwrap(),
        serial: "4711".to_owned(),
        version: 5,
        axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
        model: ModelRef::of(MODEL.as_bytes()),
        enable: true,
        confirm: None,
        condition_s: None,
        telemetry_s: None,
        issued: String::new(),
    }
}

fn trust() -> Trust {
    Trust {
        keys: vec![key(1).verifying_key(), key(2).verifying_key()],
        machine: "mill-1".parse().unwrap(),
        serial: "4711".to_owned(),
        axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
        highest: 4,
    }
}

fn signed(change: impl FnOnce(&mut Manifest)) -> Desired {
    let mut manifest = manifest();
    change(&mut manifest);
    Desired::sign(&manifest, MODEL, &key(1)).unwrap()
}

#[test]
fn any_trusted_key_is_accepted() {
    for seed in [1, 2] {
        let desired = Desired::sign(&manifest(), MODEL, &key(seed)).unwrap();
        let desired = Desired::parse(&desired.bytes().unwrap()).unwrap();
        let accepted = trust().accept(&desired).unwrap();
        assert_eq!(accepted.manifest, manifest());
        assert_eq!(accepted.model.as_deref(), Some(MODEL));
    }
}

#[test]
fn each_rejection_reason_is_reported() {
    let refused = |desired: &Desired| trust().accept(desired).unwrap_err();
    let another = Desired::sign(&manifest(), MODEL, &key(3)).unwrap();
    assert!(matches!(refused(&another), ManifestRejection::Key { .. }));
    let machine = signed(|m| m.machine = "mill-2".parse().unwrap());
    assert!(matches!(refused(&machine), ManifestRejection::Machine { .. }));
    let serial = signed(|m| m.serial = "4712".to_owned());
    assert!(matches!(refused(&serial), ManifestRejection::Serial { .. }));
    let axes = signed(|m| m.axes.swap(0, 1));
    assert!(matches!(refused(&axes), ManifestRejection::Axes { .. }));
    for version in [0, 4] {
        let old = signed(|m| m.version = version);
        assert!(matches!(
            refused(&old),
            ManifestRejection::Version { found, highest: 4 } if found == version
        ));
    }
    let mut model = signed(|_| {});
    model.model = Some(MODEL.replace('Z', "W"));
    assert!(matches!(refused(&model), ManifestRejection::Model));
    let mut manifest = signed(|_| {});
    manifest.manifest = manifest.manifest.replace("\"version\":5", "\"version\":9");
    assert!(matches!(refused(&manifest), ManifestRejection::Signature));
    let mut short = signed(|_| {});
    short.signature.truncate(40);
    assert!(matches!(refused(&short), ManifestRejection::Document(_)));
}

/// A key of order 1 is rejected. Plain verification would accept any signature by the neutral point; `verify_strict`
/// rejects it.
#[test]
fn a_key_of_small_order_verifies_nothing() {
    use base64::{Engine, engine::general_purpose::STANDARD};
    let mut neutral = [0; 32];
    neutral[0] = 1;
    let mut signature = [0; 64];
    signature[0] = 1;
    let mut desired = signed(|_| {});
    desired.key = STANDARD.encode(neutral);
    desired.signature = STANDARD.encode(signature);
    let mut trust = trust();
    trust.keys = vec![volcomp_fleet::VerifyingKey::from_bytes(&neutral).unwrap()];
    assert!(matches!(trust.accept(&desired), Err(ManifestRejection::Signature)));
}

#[test]
fn a_signature_of_the_bare_manifest_is_rejected() {
    use base64::{Engine, engine::general_purpose::STANDARD};
    use ed25519_dalek::Signer;
    let mut desired = signed(|_| {});
    let bare = key(1).sign(desired.manifest.as_bytes());
    desired.signature = STANDARD.encode(bare.to_bytes());
    assert!(matches!(trust().accept(&desired), Err(ManifestRejection::Signature)));
}

proptest! {
    /// A manifest with any byte changed is rejected, or it equals the signed manifest including its model.
    #[test]
    fn a_changed_byte_is_never_accepted(at in 0_usize..2000, to in any::<u8>()) {
        let mut bytes = signed(|_| {}).bytes().unwrap();
        let length = bytes.len();
        bytes[at % length] = to;
        if let Ok(desired) = Desired::parse(&bytes)
            && let Ok(accepted) = trust().accept(&desired)
        {
            prop_assert_eq!(accepted.manifest, manifest());
            if let Some(model) = accepted.model {
                prop_assert_eq!(model, MODEL);
            }
        }
    }

    #[test]
    fn anything_can_be_parsed_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        if let Ok(desired) = Desired::parse(&bytes) {
            prop_assert!(trust().accept(&desired).is_err());
        }
    }

    /// Accepted names have 1 to 64 characters, none of which has a meaning in subjects.
    #[test]
    fn machine_and_site_names_are_restricted(text in ".{0,70}") {
        if let Ok(name) = text.parse::<volcomp_fleet::MachineId>() {
            prop_assert!(!name.as_str().contains(['.', '*', '>', ' ', '$']));
            prop_assert!(!name.as_str().is_empty() && name.as_str().len() <= 64);
        }
    }
}

#[test]
fn the_fuzz_corpus_is_accepted() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/fleet");
    let trust = Trust {
        keys: vec![SigningKey::from_bytes(&[7; 32]).verifying_key()],
        machine: "mill-1".parse().unwrap(),
        serial: "4711".to_owned(),
        axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
        highest: 0,
    };
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let desired = Desired::parse(&std::fs::read(&path).unwrap());
        if name.starts_with("accepted-") {
            trust.accept(&desired.unwrap()).expect(&name);
        } else if name.starts_with("signature-") {
            let refused = trust.accept(&desired.unwrap()).unwrap_err();
            assert!(matches!(refused, ManifestRejection::Signature), "{name}: {refused}");
        } else if name.starts_with("model-") {
            let refused = trust.accept(&desired.unwrap()).unwrap_err();
            assert!(matches!(refused, ManifestRejection::Model), "{name}: {refused}");
        } else {
            assert!(desired.is_err(), "{name}");
        }
        seen += 1;
    }
    assert!(seen >= 5);
}
