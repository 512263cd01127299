//! Checks the book and the README files: TOML blocks parse, console blocks run, and tables of keys match the decoders.

use std::{collections::BTreeSet, fs, path::Path};

use volcomp_calibrate::CalibrationFile;
use volcomp_identify::Observations;
use volcomp_model::Machine;
use volcomp_shop::Shop;
use volcomp_test_support::{
    book::{
        Block, blocks, chapter, compare_keys, decoded_keys, joined, pages, run_console_blocks,
        used_keys,
    },
    root,
};

/// The machine file to which a fragment of a machine file is added.
const SMALL_MACHINE: &str = r#"
structure = "w C' A' b X Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 600.0]
[axes.Z]
travel = [-500.0, 0.0]
[axes.A]
travel = [-120.0, 30.0]
[axes.C]
travel = [0.0, 360.0]
"#;

/// Possible starts of the first line of a `toml` block.
const KINDS: [&str; 15] = [
    "machine file",
    "part of a machine file",
    "calibration file",
    "part of a calibration file",
    "shop file",
    "part of a shop file",
    "observations file",
    "part of an observations file",
    "set-up file",
    "part file",
    "gateway file",
    "part of a gateway file",
    "file of a map sender",
    "centre file",
    "part of a centre file",
];

fn machine(text: &str) -> Result<(), String> {
    Machine::parse(text, "machine.toml").map(drop).map_err(|e| e.to_string())
}

/// Parses a text as if it were a file in a copy of a folder of `examples`.
fn beside_the_examples<T, E: ToString>(
    examples: &str,
    text: &str,
    read: impl Fn(&Path) -> Result<T, E>,
) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
    for entry in fs::read_dir(root().join("examples").join(examples)).map_err(|e| e.to_string())? {
        let entry = entry.map_err(|e| e.to_string())?;
        fs::copy(entry.path(), folder.path().join(entry.file_name())).map_err(|e| e.to_string())?;
    }
    let file = folder.path().join("of-the-book.toml");
    fs::write(&file, text).map_err(|e| e.to_string())?;
    read(&file).map(drop).map_err(|e| e.to_string())
}

type Decode = fn(&str) -> Result<(), String>;

/// Completes the text of a block and selects its decoder. `None` for a block that another test parses.
fn decoder(block: &Block) -> Option<(String, Decode)> {
    let calibration = |text: &str| beside_the_examples("calibration", text, CalibrationFile::read);
    let shop = |text: &str| beside_the_examples("calibration", text, Shop::read);
    let observations = |text: &str| beside_the_examples("identification", text, Observations::read);
    let text = &block.text;
    Some(if block.is("machine file") {
        (text.clone(), machine)
    } else if block.is("part of a machine file") {
        (joined(SMALL_MACHINE, text), machine)
    } else if block.is("calibration file") {
        (text.clone(), calibration)
    } else if block.is("part of a calibration file") {
        (joined("machine = \"machine.toml\"", text), calibration)
    } else if block.is("observations file") {
        (text.clone(), observations)
    } else if block.is("part of an observations file") {
        (joined("machine = \"machine.toml\"", text), observations)
    } else if block.is("shop file") {
        (text.clone(), shop)
    } else if block.is("part of a shop file") {
        (joined("machine = \"truth.toml\"\nformat = \"csv\"", text), shop)
    } else if block.is("part file") {
        (text.clone(), |text| {
            let part = volcomp_nc::Part::parse(text, "of-the-book.toml");
            part.map(drop).map_err(|e| e.to_string())
        })
    } else if block.is("set-up file") {
        (text.clone(), |text| {
            let setup = volcomp_nc::SetUp::parse(text, "of-the-book.toml");
            setup.map(drop).map_err(|e| e.to_string())
        })
    } else {
        return None;
    })
}

#[test]
fn every_toml_block_is_read_by_the_program() {
    let mut count = 0;
    for block in pages().iter().flat_map(|page| blocks(page)) {
        if block.info != "toml" {
            assert!(
                !block.info.starts_with("toml"),
                "{}: found `{}`, expected `toml` alone",
                block.place,
                block.info
            );
            continue;
        }
        assert!(
            KINDS.iter().any(|kind| block.is(kind)),
            "{}: the first line is `{}`, expected a comment that begins with one of {KINDS:?}",
            block.place,
            block.label()
        );
        if let Some((text, decode)) = decoder(&block) {
            decode(&text).unwrap_or_else(|e| panic!("{}: {e}", block.place));
            count += 1;
        }
    }
    assert!(count > 2, "only {count} blocks were read");
}

/// Checks that a chapter documents exactly the keys of the decoders, and that its blocks show each key.
fn keys_of(name: &str, free: &[&str]) {
    let page = chapter(name);
    let (mut decoded, mut used) = (BTreeSet::new(), BTreeSet::new());
    for mut block in blocks(&page) {
        if let Some((text, decode)) = decoder(&block) {
            used.extend(used_keys(&block.text));
            block.text = text;
            decoded.extend(decoded_keys(&block, free, decode));
        }
    }
    compare_keys(&page, &decoded, &used);
}

#[test]
fn keys_of_the_machine_file() {
    keys_of("machine-file.md", &["thermal.drift.sensors"]);
}

#[test]
fn keys_of_the_calibration_file() {
    keys_of("calibration-file.md", &[]);
}

#[test]
fn keys_of_the_shop_file() {
    keys_of("shop-file.md", &[]);
}

#[test]
fn keys_of_the_file_of_observations() {
    keys_of("observations-file.md", &["observation.target"]);
}

#[test]
fn every_console_block_prints_what_it_says() {
    run_console_blocks(
        &[("volcomp", env!("CARGO_BIN_EXE_volcomp"))],
        &["volcomp-gateway", "focas-sim", "cargo"],
    );
}

#[test]
fn every_crate_is_in_the_chapters_on_crates() {
    let [architecture, integrators] = ["architecture.md", "integrators.md"]
        .map(|name| fs::read_to_string(chapter(name)).expect("a chapter"));
    let mut count = 0;
    for group in ["foundation", "fitting", "compensation", "drivers", "cli", "."] {
        for entry in fs::read_dir(root().join(group)).expect("a folder of the repository") {
            let folder = entry.expect("an entry").path();
            let Ok(text) = fs::read_to_string(folder.join("Cargo.toml")) else {
                continue;
            };
            let manifest: toml::Table = text.parse().expect("a manifest");
            let name = manifest["package"]["name"].as_str().expect("a name");
            assert!(architecture.contains(&format!("| `{name}` |")), "architecture.md: {name}");
            // Programs and the Python package have chapters of their own.
            if group != "cli" && name != "volcomp-python" {
                assert!(integrators.contains(&format!("\n## {name}\n")), "integrators.md: {name}");
                // The chapter includes the example that is marked in the README.
                let readme = fs::read_to_string(folder.join("README.md")).expect("a README");
                assert!(
                    readme.contains("<!-- ANCHOR: example -->\n```rust"),
                    "README.md of {name}: the first example is not marked"
                );
            }
            count += 1;
        }
    }
    assert!(count > 15, "found {count} crates");
}
