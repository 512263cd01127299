//! Roles of the columns of a table or of the channels of a log, as stated in a TOML file.

use std::path::{Path, PathBuf};

use volcomp_document::{Document, InputError, Section, Value};

use crate::dwell::Channels;
use crate::{DeviationUnit, MetrologyError, ReadingUnit, TargetUnit};

/// Information from the user about a file that the file itself does not contain.
#[derive(Debug, Clone, PartialEq)]
pub enum Mapping {
    /// Roles of the columns of a table.
    Columns(Columns),
    /// Roles of the channels of a log, and the criteria for standstill of the axis.
    Channels(Channels),
}

/// Column of a table, named by its header or by its number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ColumnName {
    /// Header of the column, case-insensitive.
    Head(String),
    /// Number of the column, from 1.
    Number(usize),
}

/// Roles of the columns of a table, and the notation of its cells.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    pub target: ColumnName,
    /// Column of the deviations, or of measured positions from which the targets are subtracted.
    pub reading: ColumnName,
    /// Whether `reading` is a column of measured positions.
    pub reads_position: bool,
    /// Column of the run numbers. `None`: runs are counted.
    pub run: Option<ColumnName>,
    /// Column of the directions of approach. `None`: directions follow from the order of travel.
    pub direction: Option<ColumnName>,
    /// Separator of the cells. `None`: cells are separated by one or more blanks.
    pub separator: Option<char>,
    /// Whether numbers have a decimal comma.
    pub decimal_comma: bool,
    /// Unit of the readings; `None` if it is not stated.
    pub unit: Option<ReadingUnit>,
    /// Unit of the targets, mm or deg; `None` if it is not stated.
    pub target_unit: Option<TargetUnit>,
    /// Number of lines above the first reading, including blank lines. The last of these lines that is not blank
    /// contains the heads.
    pub header_rows: usize,
}

const UNITS: [(&str, ReadingUnit); 10] = [
    ("um", ReadingUnit::Um),
    ("µm", ReadingUnit::Um),
    ("mm", ReadingUnit::Mm),
    ("nm", ReadingUnit::Nm),
    ("urad", ReadingUnit::Urad),
    ("µrad", ReadingUnit::Urad),
    ("mrad", ReadingUnit::Mrad),
    ("rad", ReadingUnit::Rad),
    ("arcsec", ReadingUnit::Arcsec),
    ("deg", ReadingUnit::Deg),
];

impl Mapping {
    /// Path of the mapping file that belongs to a measurement file: `x.csv.toml` for `x.csv`.
    pub fn beside(file: &Path) -> PathBuf {
        let mut name = file.file_name().unwrap_or_default().to_owned();
        name.push(".toml");
        file.with_file_name(name)
    }

    /// Reads the mapping file that belongs to a measurement file; `None` if there is no mapping file.
    ///
    /// # Errors
    /// The mapping file cannot be read, is not valid TOML, or contains other keys than columns or channels.
    pub fn read_beside(file: &Path) -> Result<Option<Self>, MetrologyError> {
        let path = Self::beside(file);
        if !path.is_file() {
            return Ok(None);
        }
        let unreadable = |error: volcomp_document::ReadError| MetrologyError::Mapping {
            message: error.to_string(),
        };
        let document = Document::read(&path).map_err(unreadable)?;
        Ok(document.decode(|root| Self::decode(&root))?)
    }

    /// Decodes the mapping under the key `columns` or `channels` of a table; `None` if the table has neither key.
    ///
    /// # Errors
    /// Both keys, another key, or an invalid value.
    pub fn decode(root: &Section<'_>) -> Result<Option<Self>, InputError> {
        root.allow(&["columns", "channels"])?;
        Self::decode_keys(root)
    }

    /// Like [`Mapping::decode`], for a table that may have other keys.
    ///
    /// # Errors
    /// Both keys, or an invalid value.
    pub fn decode_keys(section: &Section<'_>) -> Result<Option<Self>, InputError> {
        match (section.section("columns")?, section.section("channels")?) {
            (Some(_), Some(channels)) => Err(channels.error(
                "found `columns` and `channels` together, expected one of them: a table has columns, a log has channels",
            )),
            (Some(columns), None) => Columns::decode(&columns).map(|c| Some(Self::Columns(c))),
            (None, Some(channels)) => Channels::decode(&channels).map(|c| Some(Self::Channels(c))),
            (None, None) => Ok(None),
        }
    }
}

impl Columns {
    /// Decodes the table `columns`.
    ///
    /// # Errors
    /// An unknown key, an invalid value, or no key for the readings.
    pub fn decode(section: &Section<'_>) -> Result<Self, InputError> {
        section.allow(&[
            "target",
            "deviation",
            "measured",
            "run",
            "direction",
            "separator",
            "decimal_comma",
            "unit",
            "target_unit",
            "header_rows",
        ])?;
        let (reading, reads_position) = match (section.get("deviation"), section.get("measured")) {
            (Some(value), None) => (column(&value)?, false),
            (None, Some(value)) => (column(&value)?, true),
            (Some(_), Some(both)) => {
                return Err(both.error("found `deviation` and `measured`, expected one of them"));
            }
            (None, None) => {
                return Err(section.error(
                    "expected `deviation`, the column of deviations, or `measured`, that of measured positions",
                ));
            }
        };
        let separators = [
            (",", Some(',')),
            (";", Some(';')),
            ("tab", Some('\t')),
            ("\t", Some('\t')),
            ("blank", None),
        ];
        let columns = Self {
            target: column(&section.require("target")?)?,
            reading,
            reads_position,
            run: section.optional("run", column)?,
            direction: section.optional("direction", column)?,
            separator: section.one_of("separator", &separators, Some(','))?,
            decimal_comma: section.truth_or("decimal_comma", false)?,
            unit: section.optional("unit", |value| value.one_of(&UNITS))?,
            target_unit: section.optional("target_unit", |value| {
                value.one_of(&[("mm", TargetUnit::Mm), ("deg", TargetUnit::Deg)])
            })?,
            header_rows: section.whole_or("header_rows", 0..=1000, 1)?,
        };
        if columns.decimal_comma && columns.separator == Some(',') {
            return Err(section.error(
                "found decimal commas and the separator `,`, expected `separator = \";\"`, \"tab\" or \"blank\"",
            ));
        }
        if columns.reads_position && columns.unit.is_none() {
            return Err(section.error(
                "found `measured` without `unit`, expected the unit of the measured positions: `unit = \"mm\"`",
            ));
        }
        columns.refuse_contradictory_units(section)?;
        let is_head = |name: &&ColumnName| matches!(name, ColumnName::Head(_));
        if columns.header_rows == 0 && columns.names().any(|(_, name)| is_head(&name)) {
            return Err(section.error(
                "found names of columns and `header_rows = 0`, expected their numbers from 1",
            ));
        }
        Ok(columns)
    }

    /// Returns an error if measured positions are lengths and targets are angles, or the reverse, because the targets
    /// are subtracted from the positions.
    fn refuse_contradictory_units(&self, section: &Section<'_>) -> Result<(), InputError> {
        let (true, Some(unit), Some(target)) = (self.reads_position, self.unit, self.target_unit)
        else {
            return Ok(());
        };
        let (found, expected) = match (unit.deviation_unit(), target) {
            (DeviationUnit::Um, TargetUnit::Deg) => ("deg", "mm"),
            (DeviationUnit::Urad, TargetUnit::Mm) => ("mm", "deg"),
            _ => return Ok(()),
        };
        Err(section.error(format!(
            "found `target_unit = \"{found}\"` and measured positions in {unit}, expected `target_unit = \"{expected}\"`: the targets are subtracted from the positions"
        )))
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = (&'static str, &ColumnName)> {
        [
            ("target", Some(&self.target)),
            ("reading", Some(&self.reading)),
            ("run", self.run.as_ref()),
            ("direction", self.direction.as_ref()),
        ]
        .into_iter()
        .filter_map(|(what, name)| Some((what, name?)))
    }
}

fn column(value: &Value<'_>) -> Result<ColumnName, InputError> {
    if value.is_number() {
        return Ok(ColumnName::Number(value.whole(1..=10_000)?));
    }
    let name = value.text()?.trim();
    if name.is_empty() {
        return Err(
            value.error("found an empty name, expected the head of a column or its number from 1")
        );
    }
    Ok(ColumnName::Head(name.to_owned()))
}

impl Channels {
    /// Decodes the table `channels`.
    ///
    /// # Errors
    /// An unknown or missing key, an invalid value, or the same channel as target and reading.
    pub fn decode(section: &Section<'_>) -> Result<Self, InputError> {
        section.allow(&[
            "target",
            "reading",
            "reading_is",
            "unit",
            "targets",
            "within",
            "dwell_s",
            "settle_s",
            "zero_at_first",
        ])?;
        let reads_position =
            section.require("reading_is")?.one_of(&[("position", true), ("deviation", false)])?;
        let channels = Self {
            target: section.require("target")?.text()?.to_owned(),
            reading: section.require("reading")?.text()?.to_owned(),
            reads_position,
            unit: section.require("unit")?.one_of(&UNITS)?,
            targets: section.optional("targets", Value::numbers)?.unwrap_or_default(),
            within: section.number_or("within", 0.0..=10.0, 0.005)?,
            dwell_s: section.number_or("dwell_s", 0.0..=86_400.0, 1.0)?,
            settle_s: section.number_or("settle_s", 0.0..=86_400.0, 0.0)?,
            zero_at_first: section.truth_or("zero_at_first", false)?,
        };
        if channels.target == channels.reading {
            return Err(section.error("found one channel as `target` and `reading`, expected two"));
        }
        let mut sorted = channels.targets.clone();
        sorted.sort_by(f64::total_cmp);
        if let Some([twice, ..]) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(
                section.error(format!("found the target {twice} twice, expected each target once"))
            );
        }
        Ok(channels)
    }
}
