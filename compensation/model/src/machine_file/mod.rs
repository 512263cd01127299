//! Reads machine files with precise error messages, and writes them with a checksum.

use std::{collections::BTreeMap, path::Path};

use sha2::{Digest, Sha256};
use volcomp_document::{Document, FileKind, InputError, Section, Value};

use crate::{
    error::ModelError,
    machine::{Machine, Parts},
    provenance::hexadecimal,
    tool::Tool,
};

mod axes;
mod denavit_hartenberg;
mod errors;
mod provenance;
mod thermal;
mod tool;
mod write;

use axes::{decode_axes, decode_correct, decode_structure};
use denavit_hartenberg::place_by_table;
use errors::{decode_assembly, decode_errors};
use provenance::decode_provenance;
use thermal::decode_thermal;
use tool::{check_gauge_keys, decode_tool};
use write::canonical;

const TOP_KEYS: [&str; 14] = [
    "name",
    "checksum",
    "structure",
    "type",
    "correct",
    "axes",
    "dh",
    "tool",
    "tools",
    "workpiece",
    "errors",
    "assembly",
    "thermal",
    "provenance",
];

impl Machine {
    /// Reads a machine file; [`parse`](Self::parse) takes its text.
    ///
    /// # Errors
    /// A file that cannot be read, is not UTF-8 or not a valid machine: with file, line and key.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ModelError> {
        Self::decode(&Document::read(path.as_ref())?)
    }

    /// Decodes the text of a machine file; `file` is its name in messages.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ModelError> {
        Self::decode(&Document::new(file, text))
    }

    /// Decodes a parsed document as a machine file.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn decode(document: &Document) -> Result<Self, ModelError> {
        document.decode(|root| decode_machine(&root))
    }

    /// The machine as a machine file, with its checksum.
    pub fn to_toml(&self) -> String {
        let text = canonical(self);
        let (head, rest) = text.split_once('\n').unwrap_or((&text, ""));
        format!("{head}\nchecksum = \"{}\"\n{rest}", checksum_of(&text))
    }

    /// `sha256:` and 64 hexadecimal digits over all content of the machine file; comments, blanks and the order of keys do not matter.
    pub fn checksum(&self) -> String {
        checksum_of(&canonical(self))
    }
}

fn checksum_of(canonical: &str) -> String {
    format!(
        "sha256:{}",
        hexadecimal(&Sha256::digest(canonical.as_bytes()))
    )
}

fn decode_machine(root: &Section<'_>) -> Result<Machine, ModelError> {
    root.allow_in(FileKind::Machine, &TOP_KEYS)?;
    refuse_keys_below_a_table(root)?;
    let structure = decode_structure(root)?;
    let mut axes = decode_axes(root, &structure)?;
    place_by_table(root, &structure, &mut axes)?;
    let tool = root
        .section("tool")?
        .map_or_else(|| Ok(Tool::default()), |s| decode_tool(&s))?;
    let mut tools = BTreeMap::new();
    if let Some(section) = root.section("tools")? {
        for (name, value) in section.values() {
            tools.insert(name.to_owned(), decode_tool(&value.section()?)?);
        }
    }
    check_gauge_keys(root, &tool, &tools)?;
    let origin = match root.section("workpiece")? {
        Some(section) => {
            section.allow(&["origin"])?;
            section
                .optional("origin", Value::vector)?
                .unwrap_or_default()
        }
        None => [0.0; 3],
    };
    let mut machine = Machine::from_parts(Parts {
        name: root.get("name").map_or(Ok(""), |v| v.text())?.to_owned(),
        structure,
        axes,
        tool,
        tools,
        workpiece_origin_mm: origin,
    })
    .map_err(|e| root.error(e.to_string()))?;
    decode_errors(root, &mut machine)?;
    decode_assembly(root, &mut machine)?;
    if let Some(section) = root.section("thermal")? {
        let thermal = decode_thermal(&section, machine.chain().structure())?;
        machine
            .set_thermal(thermal)
            .map_err(|e| section.error(e.to_string()))?;
    }
    decode_correct(root, &mut machine)?;
    decode_provenance(root, &mut machine)?;
    check_checksum(root, &machine)?;
    Ok(machine)
}

/// In TOML a key below the header of a table belongs to that table, even after an empty line.
fn refuse_keys_below_a_table(root: &Section<'_>) -> Result<(), InputError> {
    const ABOVE_TABLES: [&str; 3] = ["structure", "correct", "checksum"];
    for (table, value) in root.values() {
        // The keys of `tools` are user-defined names.
        let Some(section) = value.section().ok().filter(|_| table != "tools") else {
            continue;
        };
        for key in ABOVE_TABLES {
            if let Some(value) = section.get(key) {
                return Err(value.error(format!(
                    "found `{key}` below [{table}], expected it above the first table of the file"
                )));
            }
        }
    }
    Ok(())
}

fn check_checksum(root: &Section<'_>, machine: &Machine) -> Result<(), InputError> {
    let Some(value) = root.get("checksum") else {
        return Ok(());
    };
    let (found, expected) = (value.text()?, machine.checksum());
    if found == expected {
        return Ok(());
    }
    Err(value.error(format!(
        "found {found}, expected {expected}: the file was changed after it was written; if that was meant, remove this line"
    )))
}
