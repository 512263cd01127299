#![no_main]
//! Images of maps: no panic on any bytes; what is read comes back, and a look-up in it answers everywhere.

use libfuzzer_sys::fuzz_target;
use volcomp_tables::{ByteOrder, Map, Position};

fuzz_target!(|bytes: &[u8]| {
    // The checksum made right, so that what is behind it is reached.
    let words: Vec<u16> = bytes
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    if let Ok(map) = Map::from_words(&words) {
        let image = map.image(1, ByteOrder::HighFirst);
        assert_eq!(Map::from_image(&image, 1).as_ref(), Ok(&map));
        for steps in [i32::MIN, -1, 0, 1, 400_000, i32::MAX] {
            let position = Position {
                steps: [steps; 5],
                ..Position::default()
            };
            let _ = map.parts(&position);
        }
    }
    let _ = Map::from_image(bytes, 1);
});
