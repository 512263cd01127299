//! The unit of the deviations in a measurement file that does not state it.

use std::path::Path;

use clap::ValueEnum;
use volcomp_metrology::{DeviationUnit, Measurement};

use crate::failure::Failure;

/// A unit of deviations, as `--unit` names it.
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
    /// The unit in which deviations of this kind are computed and answered.
    fn answered(self) -> DeviationUnit {
        match self {
            Self::Mm | Self::Um | Self::Nm => DeviationUnit::Um,
            Self::Deg | Self::Arcsec | Self::Rad | Self::Mrad | Self::Urad => DeviationUnit::Urad,
        }
    }

    /// How many µm or µrad it is.
    fn size(self) -> f64 {
        match self {
            Self::Mm | Self::Mrad => 1e3,
            Self::Um | Self::Urad => 1.0,
            Self::Nm => 1e-3,
            Self::Deg => 1e6_f64.to_radians(),
            Self::Arcsec => (1e6 / 3600.0_f64).to_radians(),
            Self::Rad => 1e6,
        }
    }

    /// The unit as people read it.
    fn symbol(self) -> String {
        match self {
            Self::Um | Self::Urad => self.answered().to_string(),
            _ => self.key(),
        }
    }

    fn is_answered_in(self, unit: DeviationUnit) -> bool {
        matches!(
            (self, unit),
            (Self::Um, DeviationUnit::Um) | (Self::Urad, DeviationUnit::Urad)
        )
    }

    /// The word on the command line.
    fn key(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// The note that the unit of a file is not stated, with a hint where the sizes are those of mm.
fn not_stated(measurement: &Measurement) -> String {
    /// A machine tool whose deviations all are smaller, in µm, is not known.
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

/// Brings the deviations of a file into µm or µrad: out of the unit asked for, where the file states none. Without
/// either they are taken for µm. The option never turns angles into lengths, nor one stated unit into another.
pub(crate) fn apply(
    file: &Path,
    measurement: &mut Measurement,
    asked: Option<Unit>,
) -> Result<DeviationUnit, Failure> {
    let Some(asked) = asked else {
        if measurement.unit.is_none() {
            let note = not_stated(measurement);
            measurement.notes.push(note);
        }
        return Ok(measurement.unit.unwrap_or(DeviationUnit::Um));
    };
    match measurement.unit {
        Some(found) if !asked.is_answered_in(found) => Err(Failure::in_file(
            file,
            format_args!(
                "found deviations in {found}, expected {} (--unit {})",
                asked.symbol(),
                asked.key()
            ),
        )),
        Some(found) => Ok(found),
        None => {
            for reading in &mut measurement.readings {
                reading.deviation *= asked.size();
            }
            measurement.unit = Some(asked.answered());
            Ok(asked.answered())
        }
    }
}
