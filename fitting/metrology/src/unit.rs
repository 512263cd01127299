//! Units of deviations and targets in files, and the column heads that state them.
//!
//! Values are converted to the internal units. A head is a name alone, or a name followed by a unit.

use volcomp_document::{Column, CsvTable, quoted, split_head, unit_named};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::MetrologyError;

/// Internal unit of the deviations of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum DeviationUnit {
    /// Micrometres: a linear error.
    #[serde(rename = "um")]
    Um,
    /// Microradians: an angular error.
    #[serde(rename = "urad")]
    Urad,
}

impl DeviationUnit {
    pub fn key(self) -> &'static str {
        match self {
            Self::Um => "um",
            Self::Urad => "urad",
        }
    }
}

impl std::fmt::Display for DeviationUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Um => "µm",
            Self::Urad => "µrad",
        })
    }
}

/// Unit of deviations in a file, or as requested by the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReadingUnit {
    Mm,
    Um,
    Nm,
    Inch,
    Deg,
    Arcsec,
    Rad,
    Mrad,
    Urad,
}

impl ReadingUnit {
    /// Unit with this name, case-insensitive, as in a column header: `mm`, `µm`, `arcsec`; `None` for an unknown unit.
    pub fn named(name: &str) -> Option<Self> {
        if ["in", "inch", "inches"].contains(&name.to_lowercase().as_str()) {
            return Some(Self::Inch);
        }
        Some(match unit_named(name)? {
            "mm" => Self::Mm,
            "um" => Self::Um,
            "nm" => Self::Nm,
            "rad" => Self::Rad,
            "mrad" => Self::Mrad,
            "urad" => Self::Urad,
            "deg" => Self::Deg,
            "arcsec" => Self::Arcsec,
            _ => return None,
        })
    }

    /// Internal unit to which deviations in this unit are converted.
    pub fn deviation_unit(self) -> DeviationUnit {
        match self {
            Self::Mm | Self::Um | Self::Nm | Self::Inch => DeviationUnit::Um,
            Self::Deg | Self::Arcsec | Self::Rad | Self::Mrad | Self::Urad => DeviationUnit::Urad,
        }
    }

    /// Factor from a coordinate to deviations: µm per mm if this is a unit of length, µrad per degree if it is a unit
    /// of angle.
    pub(crate) fn micro_of_coordinate(self) -> f64 {
        match self.deviation_unit() {
            DeviationUnit::Um => Self::Mm.micro(),
            DeviationUnit::Urad => Self::Deg.micro(),
        }
    }

    /// Size of this unit in µm or µrad.
    pub fn micro(self) -> f64 {
        match self {
            Self::Mm | Self::Mrad => 1e3,
            Self::Um | Self::Urad => 1.0,
            Self::Nm => 1e-3,
            Self::Inch => 25.4e3,
            Self::Deg => 1e6_f64.to_radians(),
            Self::Arcsec => (1e6 / 3600.0_f64).to_radians(),
            Self::Rad => 1e6,
        }
    }
}

impl From<DeviationUnit> for ReadingUnit {
    fn from(unit: DeviationUnit) -> Self {
        match unit {
            DeviationUnit::Um => Self::Um,
            DeviationUnit::Urad => Self::Urad,
        }
    }
}

impl std::fmt::Display for ReadingUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mm => "mm",
            Self::Um => "µm",
            Self::Nm => "nm",
            Self::Inch => "inch",
            Self::Deg => "deg",
            Self::Arcsec => "arcsec",
            Self::Rad => "rad",
            Self::Mrad => "mrad",
            Self::Urad => "µrad",
        })
    }
}

/// Unit of targets in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetUnit {
    Mm,
    Deg,
}

impl TargetUnit {
    pub fn key(self) -> &'static str {
        self.kind().coordinate_unit()
    }

    /// Unit with any of its names; `None` for a unit that is not valid for targets.
    pub(crate) fn named(text: &str) -> Option<Self> {
        match unit_named(text)? {
            "mm" => Some(Self::Mm),
            "deg" => Some(Self::Deg),
            _ => None,
        }
    }

    /// Kind of axis whose targets have this unit.
    pub fn kind(self) -> AxisKind {
        match self {
            Self::Mm => AxisKind::Linear,
            Self::Deg => AxisKind::Rotary,
        }
    }
}

/// Unit in a head with this name, such as `target mm`, `target_mm` or `deviation [µm]`; empty for the name alone.
/// `None` if the head has another name.
pub(crate) fn unit_of<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let (found, unit) = split_head(head);
    found.eq_ignore_ascii_case(name).then_some(unit)
}

/// The column with this name, alone or followed by a unit, and its unit. Errors: two such columns.
pub(crate) fn with_unit<'t>(
    table: &'t CsvTable,
    name: &str,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    one_column(table, name, |head| unit_of(head, name))
}

/// The column for whose head `unit` returns a unit (possibly empty), and this unit; `None` if there is no such column.
/// Errors: two such columns.
pub(crate) fn one_column<'t>(
    table: &'t CsvTable,
    name: &str,
    unit: impl Fn(&'t str) -> Option<&'t str>,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    let mut named = table.names().filter_map(|(column, head)| Some((column, unit(head)?)));
    let first = named.next();
    if named.next().is_some() {
        let message = format!("column `{name}` appears twice");
        return Err(table.header_error(message).into());
    }
    Ok(first)
}

/// Error for readings in inches with targets without a unit: the targets may be in inches or in mm.
pub(crate) fn inches_without_targets(table: &CsvTable) -> MetrologyError {
    let message = "found deviations in inches and targets without a unit, expected `target inch`, `target mm` or `target deg`";
    table.header_error(message).into()
}

pub(crate) fn heads(table: &CsvTable) -> String {
    let heads: Vec<&str> = table.names().map(|(_, name)| name).collect();
    quoted(&heads.join(&table.separator().to_string()))
}

pub(crate) fn not_read(names: &[&str]) -> Option<String> {
    (!names.is_empty()).then(|| format!("columns that are not read: {}", names.join(", ")))
}

/// Direction of approach by any of its usual words, case-insensitive.
pub(crate) fn direction_named(text: &str) -> Option<Direction> {
    match text.to_lowercase().as_str() {
        "+" | "+1" | "1" | "f" | "fw" | "fwd" | "forward" | "forwards" | "pos" | "positive"
        | "up" | "↑" => Some(Direction::Positive),
        "-" | "−" | "-1" | "r" | "b" | "rev" | "reverse" | "bw" | "bwd" | "back" | "backward"
        | "backwards" | "neg" | "negative" | "down" | "↓" => Some(Direction::Negative),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse_csv;

    /// 1 arcsec is 4.848 µrad, 1° is 17453 µrad.
    #[test]
    fn units_are_brought_into_micrometres_and_microradians() {
        for (unit, held, size) in [
            ("mm", DeviationUnit::Um, 1000.0),
            ("µm", DeviationUnit::Um, 1.0),
            ("in", DeviationUnit::Um, 25_400.0),
            ("Inch", DeviationUnit::Um, 25_400.0),
            ("arcsec", DeviationUnit::Urad, 4.848_136_811),
            ("deg", DeviationUnit::Urad, 17_453.292_52),
        ] {
            let found = ReadingUnit::named(unit).unwrap();
            assert_eq!(found.deviation_unit(), held);
            assert!((found.micro() / size - 1.0).abs() < 1e-9, "{unit}");
        }
        assert_eq!(ReadingUnit::named("thou"), None);
    }

    /// A requested unit that differs from the unit in the header is rejected. A unit is never applied twice.
    #[test]
    fn a_requested_unit_must_be_the_stated_one() {
        let mut read = parse_csv(b"target,deviation mm\n0,0.002\n1,0.003\n", "x.csv").unwrap();
        assert_eq!(read.convert_from(ReadingUnit::Um), Err(ReadingUnit::Mm));
        assert_eq!(read.convert_from(ReadingUnit::Mm), Ok(()));
        assert!((read.readings[0].deviation - 2.0).abs() < 1e-12);
        let mut plain = parse_csv(b"target,deviation\n0,2\n1,3\n", "x.csv").unwrap();
        assert_eq!(plain.convert_from(ReadingUnit::Arcsec), Ok(()));
        assert!((plain.readings[0].deviation - 9.696_273_622).abs() < 1e-6);
        assert_eq!(plain.unit, Some(DeviationUnit::Urad));
    }
}
