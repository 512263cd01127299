//! The book and the README files say what the gateway does: configurations are read, console blocks run, and
//! the tables of keys are those of the decoder.

#[path = "../../../../docs/options.rs"]
mod options;
#[path = "../../../../docs/reader.rs"]
mod reader;

use std::{collections::BTreeSet, path::Path};

use reader::{Block, blocks, chapter, compare_keys, decoded_keys, joined, pages, used_keys};
use volcomp_gateway::config::Config;

/// What a part of a configuration is put into.
const SMALL: &str = r#"
machine = "machine.toml"
[[controller]]
url = "focas://192.0.2.10:8193"
axes = ["X", "Y", "Z"]
"#;

fn decode(text: &str) -> Result<(), String> {
    Config::parse(text, "gateway.toml", Path::new(""))
        .map(drop)
        .map_err(|e| e.to_string())
}

/// The text of a configuration, made whole.
fn whole(block: &Block) -> Option<String> {
    if block.is("gateway file") {
        Some(block.text.clone())
    } else if block.is("part of a gateway file") {
        Some(joined(SMALL, &block.text))
    } else {
        None
    }
}

#[test]
fn every_configuration_is_read_by_the_gateway() {
    let mut count = 0;
    for block in pages().iter().flat_map(|page| blocks(page)) {
        if let Some(text) = whole(&block) {
            decode(&text).unwrap_or_else(|e| panic!("{}: {e}", block.place));
            count += 1;
        }
    }
    assert!(count > 2, "only {count} configurations were read");
}

#[test]
fn keys_of_the_configuration() {
    let page = chapter("gateway.md");
    let (mut decoded, mut used) = (BTreeSet::new(), BTreeSet::new());
    for mut block in blocks(&page) {
        if let Some(text) = whole(&block) {
            used.extend(used_keys(&block.text));
            block.text = text;
            decoded.extend(decoded_keys(&block, &[], decode));
        }
    }
    compare_keys(&page, &decoded, &used);
}

#[test]
fn every_console_block_prints_what_it_says() {
    reader::run_console_blocks(
        &[("volcomp-gateway", env!("CARGO_BIN_EXE_volcomp-gateway"))],
        &["volcomp", "focas-sim", "cargo"],
    );
}

#[test]
fn every_option_is_in_the_chapter_on_commands() {
    options::compare_options("volcomp-gateway", env!("CARGO_BIN_EXE_volcomp-gateway"));
}
