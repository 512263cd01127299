//! Words, bytes and headers.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::{ByteOrder, HEADER_WORDS, Header, Map, MapError, axes_of};
use volcomp_test_support::corpus;

use crate::world;

fn some_map(seed: u64) -> (Map, u16) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let settings = world::settings(&mut rng);
    let counter = rng.random_range(1..=u16::MAX);
    (world::map(&mut rng, &settings, counter), settings.outputs.machine)
}

proptest! {
    #[test]
    fn an_image_comes_back(seed: u64, high_first: bool) {
        let (map, machine) = some_map(seed);
        let order = if high_first { ByteOrder::HighFirst } else { ByteOrder::LowFirst };
        let image = map.image(machine, order);
        prop_assert_eq!(image.len(), 2 * (map.words().len() + 2));
        prop_assert_eq!(Map::from_image(&image, machine), Ok(map));
    }

    #[test]
    fn random_bytes_do_not_panic(bytes: Vec<u8>, head: bool) {
        let mut bytes = bytes;
        if head && bytes.len() > 4 {
            bytes[..4].copy_from_slice(&[0x4D, 0x56, 1, 0]);
        }
        let _ = Map::from_image(&bytes, 1);
    }

    #[test]
    fn a_damaged_image_is_refused(seed: u64, at: prop::sample::Index, to: u8) {
        let (map, machine) = some_map(seed);
        let mut image = map.image(machine, ByteOrder::LowFirst);
        let at = at.index(image.len());
        prop_assume!(image[at] != to);
        image[at] = to;
        // 0 and 65535 have the same checksum, so this change, by one part of a step, is not detected.
        let found = Map::from_image(&image, machine);
        let same_weight = found.as_ref().is_ok_and(|found| {
            let pairs = found.words().iter().zip(map.words());
            pairs.into_iter().all(|(a, b)| a == b || [*a, *b] == [0, 65535] || [*a, *b] == [65535, 0])
        });
        prop_assert!(found.is_err() || same_weight);
    }

    #[test]
    fn a_header_comes_back(seed: u64) {
        let (map, _) = some_map(seed);
        let header = *map.header();
        prop_assert_eq!(Header::decode(&header.encode()), Ok(header));
        let names: Vec<_> = axes_of(header.grid).collect();
        prop_assert_eq!(names.len(), header.grid.count());
        let again = volcomp_tables::Layout::of(names);
        prop_assert_eq!(again, Ok(header.grid));
    }
}

#[test]
fn invalid_images_are_refused_with_a_reason() {
    let (map, machine) = some_map(3);
    let image = map.image(machine, ByteOrder::LowFirst);
    let wrong = |at: usize, to: u8| {
        let mut image = image.clone();
        image[at] = to;
        Map::from_image(&image, machine).expect_err("damaged").to_string()
    };
    assert_eq!(
        wrong(0, 0),
        "the first word is 0x5600, expected 0x564d (VM): this is not a volcomp map"
    );
    assert_eq!(wrong(2, 2), "layout version 2, expected 1");
    assert_eq!(wrong(18, 65), "an output step has 65 parts, expected 1 to 64");
    let last = image.len() - 1;
    assert_eq!(
        wrong(last, image[last] ^ 1),
        "the checksum does not fit: the map is damaged, or for the machine of another number"
    );
    assert_eq!(Map::from_image(&image, machine ^ 1), Err(MapError::Checksum));
    assert_eq!(
        Map::from_image(&image[1..], machine),
        Err(MapError::OddBytes { found: image.len() - 1 })
    );
    let short = Map::from_image(&image[..image.len() - 2], machine);
    let words = map.words().len();
    assert_eq!(short, Err(MapError::Count { found: words - 1, expected: words }));
    assert_eq!(
        Map::from_words(&[0; HEADER_WORDS - 1]),
        Err(MapError::Short { found: HEADER_WORDS - 1 })
    );
}

#[test]
fn corpus_files_are_read_or_refused_by_their_names() {
    corpus::replay("map", |_, bytes| Map::from_image(bytes, 1));
}
