//! Replays the kept inputs of the fuzz target, which are datagrams without their code: those named `valid-…` must be read, those
//! named `broken-…` refused.

use volcomp_linuxcnc::{COMMAND_BYTES, Command, STATE_BYTES, State};

use crate::bridge::KEY;

#[test]
fn kept_files() {
    let folder = volcomp_test_support::root().join("tests/fuzz/corpus/linuxcnc");
    let mut valid = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().to_string_lossy().into_owned();
        let body = std::fs::read(entry.path()).unwrap();
        let bytes = [&body[..], &KEY.mac(&body)].concat();
        let again = match (State::decode(&bytes, &KEY), Command::decode(&bytes, &KEY)) {
            (Ok(state), _) => {
                let mut again = [0; STATE_BYTES];
                let length = state.encode(&KEY, &mut again);
                Some(again[..length].to_vec())
            }
            (_, Ok(command)) => {
                let mut again = [0; COMMAND_BYTES];
                let length = command.encode(&KEY, &mut again);
                Some(again[..length].to_vec())
            }
            _ => None,
        };
        assert!(again.is_some() || !name.starts_with("valid-"), "{name}");
        assert!(again.is_none() || !name.starts_with("broken-"), "{name}");
        if let Some(again) = again {
            assert_eq!(again, bytes, "{name}");
            valid += 1;
        }
    }
    assert_eq!(valid, 3);
}
