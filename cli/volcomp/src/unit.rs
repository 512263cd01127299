//! Unit of the deviations in a measurement file that does not state its unit.

use std::path::Path;

use clap::ValueEnum;
use volcomp_metrology::{DeviationUnit, Measurement, ReadingUnit};

use crate::failure::Failure;

/// A unit of deviations; the names are the values of `--unit`.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Unit {
    Mm,
    Um,
    Nm,
    Deg,
    Arcsec,
    Rad,
    Mrad,
    Urad,
}

impl Unit {
    fn of_readings(self) -> ReadingUnit {
        match self {
            Self::Mm => ReadingUnit::Mm,
            Self::Um => ReadingUnit::Um,
            Self::Nm => ReadingUnit::Nm,
            Self::Deg => ReadingUnit::Deg,
            Self::Arcsec => ReadingUnit::Arcsec,
            Self::Rad => ReadingUnit::Rad,
            Self::Mrad => ReadingUnit::Mrad,
            Self::Urad => ReadingUnit::Urad,
        }
    }

    fn key(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// The note that a file does not state its unit, with a hint if the values look like mm.
fn not_stated(measurement: &Measurement) -> String {
    /// Maximum deviation that is implausibly small for a machine tool, µm.
    const TOO_SMALL: f64 = 0.1;
    let sizes = measurement.readings.iter().map(|r| r.deviation.abs());
    let largest = sizes.fold(0.0, f64::max);
    let hint = if largest > 0.0 && largest < TOO_SMALL {
        format!("; all are below {TOO_SMALL}: are they mm?")
    } else {
        String::new()
    };
    format!(
        "the unit of the deviations is not stated, taken as µm: state it with --unit, or in the header as `deviation µm`{hint}"
    )
}

/// Converts the deviations of a file to µm or µrad. `stated` is the unit of a file without a unit; it may repeat the
/// unit of the file, but not change it. If neither states a unit, µm is assumed.
pub(crate) fn apply(
    file: &Path,
    measurement: &mut Measurement,
    stated: Option<Unit>,
) -> Result<DeviationUnit, Failure> {
    let Some(stated) = stated else {
        if measurement.unit.is_none() {
            let note = not_stated(measurement);
            measurement.notes.push(note);
        }
        return Ok(measurement.unit.unwrap_or(DeviationUnit::Um));
    };
    let unit = stated.of_readings();
    measurement.convert_from(unit).map_err(|found| {
        Failure::in_file(
            file,
            format_args!("found deviations in {found}, expected {unit} (--unit {})", stated.key()),
        )
    })?;
    Ok(unit.deviation_unit())
}
