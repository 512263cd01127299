//! Replays the kept inputs of the fuzz target; a file named `valid-…` must be read, one named `broken-…` refused.

use std::{path::Path, time::Instant};

use volcomp_modbus::{Profile, read_channel};
use volcomp_port::Quality;

#[test]
fn kept_profiles() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/modbus");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).unwrap();
        let read = Profile::parse(&String::from_utf8_lossy(&bytes));
        assert!(
            read.is_ok() || !name.starts_with("valid-"),
            "{name}: {read:?}"
        );
        assert!(read.is_err() || !name.starts_with("broken-"), "{name}");
        if let Some(channels) = read.ok().and_then(|profile| profile.channels) {
            let registers: Vec<u16> = bytes.iter().map(|byte| u16::from(*byte) * 257).collect();
            for channel in 0..usize::from(channels.count) {
                let found = read_channel(&channels, &registers, channel, None, Instant::now());
                assert_eq!(
                    found.quality == Quality::Good,
                    found.degc.is_some(),
                    "{name}"
                );
            }
        }
        seen += 1;
    }
    assert!(seen >= 10);
}
