//! The file of a map sender: which map goes into which control, and within which limits.

use std::path::{Path, PathBuf};

use volcomp_devices::{Address, Scheme};
use volcomp_document::{Document, InputError, Section, Value};
use volcomp_guard::ceiling;
use volcomp_sinumerik::MapNodes;
use volcomp_tables::Allowed;

use super::sinumerik::{SERVER_KEYS, keys_of_server};
use crate::{config::ServerConfig, error::GatewayError};

/// The longest time without a sender until a control goes to zero, s.
const LONGEST_SILENCE_S: f64 = 60.0;

/// Everything that the file of a map sender says. Paths are relative to its folder.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSender {
    /// The name of the file as messages have it.
    pub file: String,
    /// The file of the map, as `volcomp map-table` makes it.
    pub map: PathBuf,
    /// The URL of the control.
    pub url: String,
    /// The number of the machine in its control.
    pub number: u16,
    /// What the control may do.
    pub allowed: Allowed,
    /// How its server is reached.
    pub server: ServerConfig,
    /// Where the words lie in it.
    pub nodes: MapNodes,
    /// The folder of the audit log.
    pub audit_dir: PathBuf,
}

impl MapSender {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let file = path.display().to_string();
        Ok(Document::read(path)?.decode(|root| Self::decode(&root, &file, folder))?)
    }

    /// Takes the text of a file; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key what is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| Self::decode(&root, file, folder))
    }

    fn decode(root: &Section<'_>, file: &str, folder: &Path) -> Result<Self, InputError> {
        root.allow(&[
            "map",
            "url",
            "number",
            "capacity",
            "scan_ms",
            "limit_um",
            "slew_um_per_s",
            "zero_after_ms",
            "sinumerik",
            "nodes",
            "audit",
        ])?;
        let number = |key, range| root.require(key)?.number_in(range);
        let most_um = ceiling::LIMIT.0 * 1e3;
        let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
        let server = match root.section("sinumerik")? {
            Some(section) => {
                section.allow(&SERVER_KEYS)?;
                keys_of_server(&section, folder)?
            }
            None => ServerConfig::default(),
        };
        let audit = root
            .section("audit")?
            .map(|section| {
                section.allow(&["dir"])?;
                section.optional("dir", |value| not_empty(value).map(|dir| folder.join(dir)))
            })
            .transpose()?;
        Ok(Self {
            file: file.to_owned(),
            map: folder.join(not_empty(&root.require("map")?)?),
            url: url(&root.require("url")?)?,
            number: root.require("number")?.whole(0..=65534)?,
            allowed: Allowed {
                limit_mm: number("limit_um", 0.001..=most_um)? * 1e-3,
                slew_mm_per_s: number("slew_um_per_s", 0.001..=fastest_um)? * 1e-3,
                zero_after_s: number("zero_after_ms", 100.0..=LONGEST_SILENCE_S * 1e3)? * 1e-3,
                scan_s: number("scan_ms", 0.1..=1000.0)? * 1e-3,
                capacity: usize::from(root.require("capacity")?.whole::<u16>(69..=32767)?),
            },
            server,
            nodes: match root.section("nodes")? {
                Some(section) => nodes(&section)?,
                None => MapNodes::default(),
            },
            audit_dir: audit.flatten().unwrap_or_else(|| folder.join("audit")),
        })
    }
}

fn not_empty<'a>(value: &Value<'a>) -> Result<&'a str, InputError> {
    match value.text()? {
        "" => Err(value.error("found an empty text, expected a name")),
        text => Ok(text),
    }
}

fn url(value: &Value<'_>) -> Result<String, InputError> {
    let text = value.text()?;
    match Address::parse(text) {
        Ok(address) if address.scheme == Scheme::OpcUa => Ok(text.to_owned()),
        _ => Err(value.error(format!("found {text:?}, expected opc.tcp://HOST:4840"))),
    }
}

fn nodes(section: &Section<'_>) -> Result<MapNodes, InputError> {
    section.allow(&["mailbox", "report", "buffers"])?;
    let default = MapNodes::default();
    let text = |key, default: String| match section.get(key) {
        Some(value) => not_empty(&value).map(str::to_owned),
        None => Ok(default),
    };
    let buffers = text("buffers", default.buffers)?;
    if !(buffers.contains("{byte}") && buffers.contains("{count}")) {
        return Err(section.error(format!(
            "buffers: found {buffers:?}, expected {{byte}} and {{count}} in it: the buffers are read in pieces"
        )));
    }
    Ok(MapNodes {
        mailbox: text("mailbox", default.mailbox)?,
        report: text("report", default.report)?,
        buffers,
    })
}
