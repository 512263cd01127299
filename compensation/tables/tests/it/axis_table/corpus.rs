//! The kept inputs of the fuzz targets `table_…`.

use std::fs;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::axis_table::{Format, WriteOptions, curves, read, to_toml, write};

use super::{numbers, read_text};

#[test]
fn the_corpus_is_read_and_refused_as_its_names_say() {
    let mut targets = 0;
    for format in Format::ALL {
        let folder = volcomp_test_support::root()
            .join("tests/fuzz/corpus")
            .join(format!("table_{}", format.name().replace('-', "_")));
        let mut seen = [0; 2];
        for entry in
            fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        {
            let path = entry.expect("an entry").path();
            let name = path
                .file_name()
                .expect("a name")
                .to_string_lossy()
                .into_owned();
            let text = String::from_utf8(fs::read(&path).expect("read")).expect("UTF-8");
            let is_valid = name.starts_with("valid-");
            let found = read_text(format, "X.comp", &text);
            assert_eq!(found.is_ok(), is_valid, "{format} {name}: {found:?}");
            seen[usize::from(is_valid)] += 1;
        }
        assert!(seen.iter().all(|count| *count >= 1), "{format}: {seen:?}");
        targets += 1;
    }
    assert_eq!(targets, Format::ALL.len());
}

/// What the fuzz targets look for, on a drawn few thousand texts near the kept ones: no panic, and what is read can be written and
/// read again.
#[test]
fn broken_texts_are_refused_and_nothing_else() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let pieces = [
        "-",
        ".",
        "1e9",
        "1e-9",
        "\n",
        " ",
        "[",
        "]",
        "0",
        "-0.000",
        "nan",
        ";",
        "=",
        "X",
        "{",
        "}",
        "%",
        "9999999999",
        "µ",
    ];
    for format in Format::ALL {
        let folder = volcomp_test_support::root()
            .join("tests/fuzz/corpus")
            .join(format!("table_{}", format.name().replace('-', "_")));
        let texts: Vec<String> = fs::read_dir(&folder)
            .expect("a corpus")
            .map(|entry| fs::read_to_string(entry.expect("an entry").path()).expect("UTF-8"))
            .collect();
        let mut read_again = 0;
        for number in 0..600 {
            let mut characters: Vec<char> = texts[number % texts.len()].chars().collect();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..characters.len());
                let to = (at + rng.random_range(0..4)).min(characters.len());
                let piece = pieces[rng.random_range(0..pieces.len())];
                characters.splice(at..to, piece.chars());
            }
            let text: String = characters.into_iter().collect();
            let Ok(found) = read_text(format, "X.comp", &text) else {
                continue;
            };
            if let Ok(curves) = curves(&found.content) {
                to_toml(&curves);
            }
            let options = WriteOptions {
                axes: numbers(),
                ..WriteOptions::default()
            };
            let Ok(written) = write(format, &found.content, &options) else {
                continue;
            };
            if read(format, &written.files, &super::options()).is_ok() {
                read_again += 1;
            }
        }
        assert!(read_again > 0, "{format}: {read_again}");
    }
}
