//! The file of a map sender: which map goes into which control, and within which limits.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use volcomp_devices::{Address, Scheme};
use volcomp_document::{Document, InputErrors, Mistakes};
use volcomp_focas::{Block, MapPlaces, PmcAddress};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_sinumerik::MapNodes;
use volcomp_tables::{
    Allowed, HEADER_WORDS, MOST_WORDS,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use super::{AuditConfig, PmcByte, PmcLetter, SinumerikTable, tables::of_ms, validate};
use crate::error::GatewayError;

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
        server: Box<SinumerikTable>,
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

/// The keys of the file.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Keys {
    map: PathBuf,
    url: String,
    number: u16,
    capacity: usize,
    scan_ms: f64,
    limit_um: f64,
    slew_um_per_s: f64,
    zero_after_ms: f64,
    sinumerik: SinumerikTable,
    #[serde(with = "NodesKeys")]
    nodes: MapNodes,
    pmc: PmcTable,
    audit: AuditConfig,
}

#[derive(Serialize, Deserialize)]
#[serde(
    remote = "MapNodes",
    deny_unknown_fields,
    default = "MapNodes::default"
)]
struct NodesKeys {
    mailbox: String,
    report: String,
    buffers: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct PmcTable {
    time_out_ms: f64,
    mailbox: PmcByte,
    report: PmcByte,
    buffers: PmcByte,
}

impl Default for PmcTable {
    fn default() -> Self {
        let byte = |at| PmcByte {
            pmc: PmcLetter::D,
            at,
        };
        Self {
            time_out_ms: 500.0,
            mailbox: byte(0),
            report: byte(144),
            buffers: byte(200),
        }
    }
}

impl MapSender {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key everything that is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        Ok(Self::decode(
            &document,
            &path.display().to_string(),
            folder,
        )?)
    }

    /// Takes the text of a file; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key everything that is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(&Document::new(file, text), file, folder)
    }

    fn decode(document: &Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        let (mut keys, mut found) = document.structure::<Keys>(|_| None)?;
        let is_fanuc = keys.validate(&mut found);
        keys.sinumerik.join(folder);
        let sender = Self {
            file: file.to_owned(),
            map: folder.join(&keys.map),
            url: keys.url,
            number: keys.number,
            allowed: Allowed {
                limit_mm: keys.limit_um * 1e-3,
                slew_mm_per_s: keys.slew_um_per_s * 1e-3,
                zero_after_s: keys.zero_after_ms * 1e-3,
                scan_s: keys.scan_ms * 1e-3,
                capacity: keys.capacity,
            },
            control: if is_fanuc {
                MapControl::Fanuc {
                    at_most: of_ms(keys.pmc.time_out_ms),
                    places: keys.pmc.places(keys.capacity),
                }
            } else {
                MapControl::Sinumerik {
                    server: Box::new(keys.sinumerik),
                    nodes: keys.nodes,
                }
            },
            audit_dir: folder.join(keys.audit.dir),
        };
        found.none_or(sender)
    }
}

impl PmcTable {
    fn places(&self, capacity: usize) -> MapPlaces {
        MapPlaces {
            mailbox: self.mailbox.into(),
            report: self.report.into(),
            buffers: self.buffers.into(),
            capacity,
        }
    }
}

impl Keys {
    /// Whether the control is a FANUC, and every mistake.
    fn validate(&self, found: &mut Mistakes<'_>) -> bool {
        for key in [
            "map",
            "url",
            "number",
            "capacity",
            "scan_ms",
            "limit_um",
            "slew_um_per_s",
            "zero_after_ms",
        ] {
            found.require("", key);
        }
        if found.states("map") {
            validate::path("map", &self.map, found);
        }
        validate::path("audit.dir", &self.audit.dir, found);
        found.whole("number", self.number, 0..=LARGEST_MACHINE);
        // A head and one value at the least.
        found.whole("capacity", self.capacity, HEADER_WORDS + 1..=MOST_WORDS);
        let most_um = ceiling::LIMIT.0 * 1e3;
        let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
        found.range("limit_um", self.limit_um, 0.001..=most_um);
        found.range("slew_um_per_s", self.slew_um_per_s, 0.001..=fastest_um);
        let longest = LONGEST_SILENCE_S * 1e3;
        found.range("zero_after_ms", self.zero_after_ms, 100.0..=longest);
        found.range("scan_ms", self.scan_ms, 0.1..=1000.0);
        let scheme = Address::parse(&self.url).map(|address| address.scheme);
        let (others, scheme) = match scheme {
            Ok(Scheme::Focas) => {
                self.validate_pmc(found);
                (&["sinumerik", "nodes"][..], "opc.tcp")
            }
            Ok(Scheme::OpcUa) => {
                self.validate_nodes(found);
                (&["pmc"][..], "focas")
            }
            _ => {
                if found.states("url") {
                    let message = format!(
                        "found {:?}, expected opc.tcp://HOST:4840 (SINUMERIK) or focas://HOST:8193 (FANUC)",
                        self.url
                    );
                    found.add("url", message);
                }
                return false;
            }
        };
        for key in others {
            if found.states(key) {
                let message = format!("found this table, expected it only for {scheme}://");
                found.add(key, message);
            }
        }
        scheme == "opc.tcp"
    }

    fn validate_nodes(&self, found: &mut Mistakes<'_>) {
        validate::server(&self.sinumerik, "sinumerik", found);
        for key in ["numbers", "sign", "nodes"].map(|key| format!("sinumerik.{key}")) {
            if found.states(&key) {
                found.add(&key, "found this key, expected it only for a controller");
            }
        }
        let nodes = &self.nodes;
        for (key, node) in [("mailbox", &nodes.mailbox), ("report", &nodes.report)] {
            if node.is_empty() {
                found.add(
                    &format!("nodes.{key}"),
                    "found an empty text, expected a name",
                );
            }
        }
        if !(nodes.buffers.contains("{byte}") && nodes.buffers.contains("{count}")) {
            let message = format!(
                "found {:?}, expected {{byte}} and {{count}} in it: the buffers are read in pieces",
                nodes.buffers
            );
            found.add("nodes.buffers", message);
        }
    }

    fn validate_pmc(&self, found: &mut Mistakes<'_>) {
        let (pmc, capacity) = (&self.pmc, self.capacity);
        found.range("pmc.time_out_ms", pmc.time_out_ms, 10.0..=2000.0);
        for (key, place) in [
            ("mailbox", pmc.mailbox),
            ("report", pmc.report),
            ("buffers", pmc.buffers),
        ] {
            if !PmcAddress::from(place).area.is_of_ladder() {
                let message = format!(
                    "found {:?}, expected R or D, the memory of the ladder's own",
                    place.pmc
                );
                found.add(&format!("pmc.{key}"), message);
            }
        }
        let places = pmc.places(capacity);
        if !places.fits() {
            let message = format!(
                "found {capacity} words in each of two buffers from {:?}{} on, expected them to end at byte 65535 at the latest",
                places.buffers.area, places.buffers.at
            );
            found.add("capacity", message);
        } else if let Some(what) = overlap(&places) {
            let message = format!(
                "found {what} in one another's place, expected each of mailbox, report and buffers in its own"
            );
            found.add("pmc", message);
        }
    }
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
