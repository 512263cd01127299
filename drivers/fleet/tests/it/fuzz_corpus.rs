//! Replays the corpus of the fuzz target: valid and invalid values.

use std::path::Path;

use volcomp_fleet::{Desired, ManifestRejection, SigningKey, Trust};
use volcomp_vocabulary::AxisName;

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
