//! The file of a map sender: which map goes into which control, and within which limits.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_devices::{Address, Scheme};
use volcomp_document::{Document, InputError, Section, Value};
use volcomp_focas::{Block, MapPlaces, PmcAddress, PmcArea};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_sinumerik::MapNodes;
use volcomp_tables::{
    Allowed, HEADER_WORDS, MOST_WORDS,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use super::{
    controller::byte,
    sinumerik::{SERVER_KEYS, keys_of_server},
};
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
    /// The largest correction, its fastest change and the longest silence that the control may be set to.
    pub allowed: Allowed,
    /// How the control is reached, and where the words lie in it.
    pub control: MapControl,
    /// The folder of the audit log.
    pub audit_dir: PathBuf,
}

/// The control that takes a map.
#[derive(Clone, Debug, PartialEq)]
pub enum MapControl {
    /// A SINUMERIK, over OPC UA.
    Sinumerik {
        /// How its server is reached.
        server: ServerConfig,
        /// The nodes of the words.
        nodes: MapNodes,
    },
    /// A FANUC control, over FOCAS.
    Fanuc {
        /// The longest time of an exchange.
        at_most: Duration,
        /// The places of the words in its PMC.
        places: MapPlaces,
    },
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
            "pmc",
            "audit",
        ])?;
        let number = |key, range| root.require(key)?.number_in(range);
        let most_um = ceiling::LIMIT.0 * 1e3;
        let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
        let (url, scheme) = url(&root.require("url")?)?;
        // A head and one value at the least.
        let capacity: usize = root
            .require("capacity")?
            .whole(HEADER_WORDS + 1..=MOST_WORDS)?;
        let control = match scheme {
            Scheme::Focas => fanuc(root, capacity)?,
            _ => sinumerik(root, folder)?,
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
            url,
            number: root.require("number")?.whole(0..=LARGEST_MACHINE)?,
            allowed: Allowed {
                limit_mm: number("limit_um", 0.001..=most_um)? * 1e-3,
                slew_mm_per_s: number("slew_um_per_s", 0.001..=fastest_um)? * 1e-3,
                zero_after_s: number("zero_after_ms", 100.0..=LONGEST_SILENCE_S * 1e3)? * 1e-3,
                scan_s: number("scan_ms", 0.1..=1000.0)? * 1e-3,
                capacity,
            },
            control,
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

fn url(value: &Value<'_>) -> Result<(String, Scheme), InputError> {
    let text = value.text()?;
    match Address::parse(text) {
        Ok(address) if matches!(address.scheme, Scheme::OpcUa | Scheme::Focas) => {
            Ok((text.to_owned(), address.scheme))
        }
        _ => Err(value.error(format!(
            "found {text:?}, expected opc.tcp://HOST:4840 (SINUMERIK) or focas://HOST:8193 (FANUC)"
        ))),
    }
}

/// Refuses a table of the other make.
fn none_of(root: &Section<'_>, keys: &[&str], scheme: &str) -> Result<(), InputError> {
    for key in keys {
        if let Some(value) = root.get(key) {
            return Err(value.error(format!(
                "found this table, expected it only for {scheme}://"
            )));
        }
    }
    Ok(())
}

fn sinumerik(root: &Section<'_>, folder: &Path) -> Result<MapControl, InputError> {
    none_of(root, &["pmc"], "focas")?;
    let server = match root.section("sinumerik")? {
        Some(section) => {
            section.allow(&SERVER_KEYS)?;
            keys_of_server(&section, folder)?
        }
        None => ServerConfig::default(),
    };
    let nodes = match root.section("nodes")? {
        Some(section) => nodes(&section)?,
        None => MapNodes::default(),
    };
    Ok(MapControl::Sinumerik { server, nodes })
}

fn fanuc(root: &Section<'_>, capacity: usize) -> Result<MapControl, InputError> {
    none_of(root, &["sinumerik", "nodes"], "opc.tcp")?;
    let section = root.section("pmc")?;
    if let Some(section) = &section {
        section.allow(&["time_out_ms", "mailbox", "report", "buffers"])?;
    }
    let place = |key, at| match section.as_ref().and_then(|section| section.get(key)) {
        None => {
            let area = PmcArea::D;
            Ok(PmcAddress { area, at })
        }
        Some(value) => {
            let place = byte(&value)?;
            if place.area.is_of_ladder() {
                return Ok(place);
            }
            Err(value.error(format!(
                "found {:?}, expected R or D, the memory of the ladder's own",
                place.area
            )))
        }
    };
    let places = MapPlaces {
        mailbox: place("mailbox", 0)?,
        report: place("report", 144)?,
        buffers: place("buffers", 200)?,
        capacity,
    };
    let at_most_ms = match section
        .as_ref()
        .and_then(|section| section.get("time_out_ms"))
    {
        Some(value) => value.number_in(10.0..=2000.0)?,
        None => 500.0,
    };
    if !places.fits() {
        return Err(root.require("capacity")?.error(format!(
            "found {capacity} words in each of two buffers from {:?}{} on, expected them to end at byte 65535 at the latest",
            places.buffers.area, places.buffers.at
        )));
    }
    if let Some(what) = overlap(&places) {
        return Err(root.error(format!("pmc: found {what} in one another's place, expected each of mailbox, report and buffers in its own")));
    }
    Ok(MapControl::Fanuc {
        at_most: Duration::from_secs_f64(at_most_ms * 1e-3),
        places,
    })
}

/// Two of the three that share bytes. Both buffers end within the addresses of the PMC: see [`MapPlaces::fits`].
fn overlap(places: &MapPlaces) -> Option<String> {
    let block = |what, first: PmcAddress, words: usize| {
        let end = usize::from(first.at) + 2 * words - 1;
        let at = u16::try_from(end).unwrap_or(u16::MAX);
        Block {
            key: what,
            what,
            first,
            last: PmcAddress { at, ..first },
        }
    };
    let mailbox = block("mailbox", places.mailbox, FRAME_WORDS);
    let report = block("report", places.report, REPORT_WORDS);
    let buffers = block("buffers", places.buffers, 2 * places.capacity);
    [(mailbox, report), (mailbox, buffers), (report, buffers)]
        .iter()
        .find(|(one, other)| one.shared(other).is_some())
        .map(|(one, other)| format!("{} and {}", one.what, other.what))
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
