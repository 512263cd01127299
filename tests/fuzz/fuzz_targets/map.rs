#![no_main]
//! Images of maps: no panic on any bytes, also in a look-up; a map that is read is written to an image that is read equally.

use libfuzzer_sys::fuzz_target;
use volcomp_tables::{ByteOrder, Map, Position};

fuzz_target!(|bytes: &[u8]| {
    // A correct checksum, so that the code after its check is reached.
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
