use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::axis_table::{Format, WriteOptions, curves, read, to_toml, write};
use volcomp_test_support::corpus::{self, replay};

use super::{numbers, read_text};

fn target(format: Format) -> String {
    format!("table_{}", format.name().replace('-', "_"))
}

#[test]
fn corpus_files_are_read_or_refused_by_their_names() {
    for format in Format::ALL {
        replay(&target(format), |_, bytes| {
            let text = std::str::from_utf8(bytes).expect("UTF-8");
            read_text(format, "X.comp", text)
        });
    }
}

/// Random mutations of the corpus do not panic; every text that is read can be written and read again.
#[test]
fn mutated_texts_do_not_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let pieces: Vec<&str> = "- . 1e9 1e-9 [ ] 0 -0.000 nan ; = X { } % 9999999999 µ"
        .split(' ')
        .chain(["\n", " "])
        .collect();
    for format in Format::ALL {
        let texts: Vec<String> = corpus::files(&target(format))
            .into_iter()
            .map(|(_, bytes)| String::from_utf8(bytes).expect("UTF-8"))
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
            let options = WriteOptions { axes: numbers(), ..WriteOptions::default() };
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
