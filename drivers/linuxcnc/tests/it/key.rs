//! Tests of the key and of the authentication code of datagrams: published test vectors, both implementations with
//! random bytes, and rejected files.

use std::{fmt::Write as _, path::Path};

use proptest::prelude::*;
use volcomp_linuxcnc::Key;

use crate::{
    bridge::{KEY, KEY_TEXT},
    c_bridge::Run,
    component::write_key,
};

/// SipHash-2-4 with 64 bits of the bytes 00, 01, … with the key 00 01 … 0f. The index is the number of bytes, from 0
/// (`vectors.h` of the SipHash authors).
const VECTORS: [&str; 64] = [
    "310e0edd47db6f72",
    "fd67dc93c539f874",
    "5a4fa9d909806c0d",
    "2d7efbd796666785",
    "b7877127e09427cf",
    "8da699cd64557618",
    "cee3fe586e46c9cb",
    "37d1018bf50002ab",
    "6224939a79f5f593",
    "b0e4a90bdf82009e",
    "f3b9dd94c5bb5d7a",
    "a7ad6b22462fb3f4",
    "fbe50e86bc8f1e75",
    "903d84c02756ea14",
    "eef27a8e90ca23f7",
    "e545be4961ca29a1",
    "db9bc2577fcc2a3f",
    "9447be2cf5e99a69",
    "9cd38d96f0b3c14b",
    "bd6179a71dc96dbb",
    "98eea21af25cd6be",
    "c7673b2eb0cbf2d0",
    "883ea3e395675393",
    "c8ce5ccd8c030ca8",
    "94af49f6c650adb8",
    "eab8858ade92e1bc",
    "f315bb5bb835d817",
    "adcf6b0763612e2f",
    "a5c91da7acaa4dde",
    "716595876650a2a6",
    "28ef495c53a387ad",
    "42c341d8fa92d832",
    "ce7cf2722f512771",
    "e37859f94623f3a7",
    "381205bb1ab0e012",
    "ae97a10fd434e015",
    "b4a31508beff4d31",
    "81396229f0907902",
    "4d0cf49ee5d4dcca",
    "5c73336a76d8bf9a",
    "d0a704536ba93e0e",
    "925958fcd6420cad",
    "a915c29bc8067318",
    "952b79f3bc0aa6d4",
    "f21df2e41d4535f9",
    "87577519048f53a9",
    "10a56cf5dfcd9adb",
    "eb75095ccd986cd0",
    "51a9cb9ecba312e6",
    "96afadfc2ce666c7",
    "72fe52975a4364ee",
    "5a1645b276d592a1",
    "b274cb8ebf87870a",
    "6f9bb4203de7b381",
    "eaecb2a30b22a87f",
    "9924a43cc1315724",
    "bd838d3aafbf8db7",
    "0b1a2a3265d51aea",
    "135079a3231ce660",
    "932b2846e4d70666",
    "e1915f5cb1eca46c",
    "f325965ca16d629f",
    "575ff28e60381be5",
    "724506eb4c328a95",
];

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

fn code_of_component(run: &mut Run, bytes: &[u8]) -> String {
    let number = u64::from_str_radix(&run.command(&format!("mac {}", hex(bytes))), 16).unwrap();
    hex(&number.to_le_bytes())
}

fn with_key(dir: &Path, key: &[u8; 16]) -> Option<Run> {
    let file = dir.join("key");
    write_key(&file, &hex(key), 0o600);
    let mut run = Run::new()?;
    assert_eq!(run.command(&format!("key {}", file.display())), "0");
    Some(run)
}

#[test]
fn both_sides_pass_the_published_test_vectors() {
    let dir = tempfile::tempdir().unwrap();
    let numbers: [u8; 64] = std::array::from_fn(|n| u8::try_from(n).unwrap());
    let key = *numbers.first_chunk().unwrap();
    let mut run = with_key(dir.path(), &key);
    for (length, expected) in VECTORS.iter().enumerate() {
        let bytes = &numbers[..length];
        assert_eq!(hex(&Key::new(key).mac(bytes)), *expected, "{length}");
        if let Some(run) = &mut run {
            assert_eq!(code_of_component(run, bytes), *expected, "{length}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn both_sides_compute_the_same_code(key: [u8; 16], datagrams in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..500), 1..20)) {
        let dir = tempfile::tempdir().unwrap();
        let Some(mut run) = with_key(dir.path(), &key) else { return Ok(()) };
        for bytes in datagrams {
            prop_assert_eq!(code_of_component(&mut run, &bytes), hex(&Key::new(key).mac(&bytes)));
        }
    }
}

/// The gateway and the bridge accept and reject the same key files.
#[test]
fn files_without_a_secret_key_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("key");
    let read = || {
        let mut run = Run::new()?;
        Some(run.command(&format!("key {}", file.display())) == "0")
    };
    assert!(Key::read(&file).is_err() && read() != Some(true), "the file is missing");
    let digits = KEY_TEXT.trim();
    for (text, mode, is_taken) in [
        (KEY_TEXT.to_owned(), 0o600, true),
        (KEY_TEXT.to_owned(), 0o400, true),
        (digits.to_uppercase(), 0o600, true),
        (format!("{digits}\r\n \n"), 0o600, true),
        (KEY_TEXT.to_owned(), 0o640, false),
        (KEY_TEXT.to_owned(), 0o604, false),
        (String::new(), 0o600, false),
        (digits[1..].to_owned(), 0o600, false),
        (digits[2..].to_owned(), 0o600, false),
        (format!("{digits}0"), 0o600, false),
        (format!("{digits}00"), 0o600, false),
        (format!(" {digits}"), 0o600, false),
        (format!("{digits}\0"), 0o600, false),
        (format!("0x{}", &digits[2..]), 0o600, false),
        (format!("+{}", &digits[1..]), 0o600, false),
        (digits.replace("70", "ä"), 0o600, false),
        (digits.repeat(3), 0o600, false),
    ] {
        write_key(&file, &text, mode);
        let key = Key::read(&file);
        assert_eq!(key.is_ok(), is_taken, "{mode:o} {text:?}: {key:?}");
        assert!(key.is_err() || key.is_ok_and(|key| key == KEY), "{text:?}");
        if let Some(taken) = read() {
            assert_eq!(taken, is_taken, "the component, {mode:o} {text:?}");
        }
    }
}

#[test]
fn debug_output_hides_the_key() {
    assert_eq!(format!("{KEY:?}"), "Key");
}
