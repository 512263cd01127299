//! Content of a calibration file and of every file that it names, as plain data.

use std::path::PathBuf;

use volcomp_identify::Observations;
use volcomp_metrology::{Measurement, ReferenceKind};
use volcomp_model::{Machine, ModelError, Source};
use volcomp_vocabulary::{AxisName, ErrorName, Urad};

use crate::{
    curve_choice::CurveChoice,
    setup::Setup,
    squareness::{is_square, set_square},
};

/// A calibration file with the content of every file that it names.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    /// Paths of the calibration file, its machine file and its measurement files. None of them may be overwritten.
    pub files: Vec<PathBuf>,
    /// Serial number of the machine, if the calibration file states it.
    pub serial: Option<String>,
    /// The machine as stated in its file.
    pub machine: Machine,
    /// Coordinates at which the curves are zero, mm or deg, by index of the axis in the chain; 0
    /// for an axis without a value.
    pub reference: Vec<f64>,
    /// Primary and secondary reference axis. The primary axis has no squareness tilt; the secondary axis has no tilt
    /// about the primary axis.
    pub reference_axes: [AxisName; 2],
    /// Every measured line, in the order of the file.
    pub measurements: Vec<Line>,
    /// Every squareness error, in the order of the file.
    pub squareness: Vec<Squareness>,
    /// Sets of diagonals that determine squareness errors.
    pub diagonals: Vec<Diagonals>,
    /// Every location error that an instrument measured directly, in the order of the file.
    pub locations: Vec<Location>,
    /// Unknowns and observations of the whole machine.
    pub observations: Option<Observations>,
    /// Files of the observations, for the provenance.
    pub observed: Vec<Source>,
    /// Uncertainty contributions that the scatter of the readings does not show.
    pub uncertainty: Uncertainty,
}

/// One measurement: an error along one line.
#[derive(Clone, Debug)]
pub struct Line {
    /// The error, with the method and the location of the measurement.
    pub setup: Setup,
    /// The measurement file, for messages.
    pub file: PathBuf,
    /// Measurement files of the readings, for the provenance: usually one; none for readings without a file, several for readings computed from several
    /// files.
    pub sources: Vec<Source>,
    /// Location in the calibration file, for messages: `calibration.toml:12`.
    pub place: String,
    /// Readings with the sign of the error, µm or µrad; for the angular method the tilts of the bridge.
    pub readings: Measurement,
    /// Kind of curve stated in the file; `None` if it states none.
    pub curve: Option<CurveChoice>,
    /// Kind of reference line that is subtracted from a straightness; the slope of the line is part of the squareness.
    pub reference_line: ReferenceKind,
    /// For a rotary axis: whether the readings were taken relative to the commanded pose, so that
    /// they include the effect of the location errors of the axis; `false` if the instrument was
    /// centred on the axis itself (ISO 230-7).
    pub holds_location: bool,
}

/// A location error measured by an instrument: `EX0C`, `EA0C`, `EC0Y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Location {
    pub error: ErrorName,
    /// Value, µm or µrad.
    pub value: f64,
    /// The standard uncertainty (k = 1) of the value, µm or µrad.
    pub uncertainty: f64,
}

/// A squareness error, and how the calibration file determines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squareness {
    /// EC0Y, EA0Z or EB0Z.
    pub error: ErrorName,
    /// Stated value, slopes or diagonals.
    pub source: SquarenessSource,
}

/// How the value of a squareness is determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SquarenessSource {
    /// Stated value.
    Value(Urad),
    /// From the slopes of its two straightness errors, with the angle of their reference.
    Slopes {
        /// φ − π/2, φ the angle between the + directions of the two reference beams.
        reference_angle: Urad,
    },
    /// From body diagonals, [`CalibrationFile::diagonals`].
    Diagonals,
}

/// Standard uncertainties (k = 1) that the scatter of the readings does not show: the table `[uncertainty]` of a
/// calibration file. All are 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Uncertainty of the laser's scale, including the material temperature, µm/m: common to all positioning lines.
    pub laser_um_per_m: f64,
    /// Uncertainty of the reference angle of each squareness, µrad.
    pub square_urad: f64,
    /// Uncertainty of the mean of linear readings at each target, µm; independent between targets.
    pub reading_um: f64,
    /// Uncertainty of the mean of angular readings at each target, µrad; independent between targets.
    pub reading_urad: f64,
}

impl CalibrationFile {
    /// Coordinate at which the curves of an axis are zero, mm or deg, by index of the axis in the chain.
    pub(crate) fn reference_at(&self, place: usize) -> f64 {
        self.reference.get(place).copied().unwrap_or(0.0)
    }
}

/// Diagonals that determine one to three squareness errors together.
#[derive(Clone, Debug)]
pub struct Diagonals {
    /// The squareness errors that the diagonals determine.
    pub errors: Vec<ErrorName>,
    /// The diagonals as observations. Their unknowns include the offset of each diagonal, and one scale error that
    /// laser, material temperature and machine have in common.
    pub observations: Observations,
    /// Files of the diagonals, for the provenance.
    pub sources: Vec<Source>,
}

/// The measured errors of a file, each once: first the angular errors, which the Abbe correction needs, then the linear ones.
pub(crate) fn measured(file: &CalibrationFile) -> Vec<ErrorName> {
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|l| l.setup.error).collect();
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    names
}

pub(crate) fn lines_of(file: &CalibrationFile, error: ErrorName) -> impl Iterator<Item = &Line> {
    let lines = file.measurements.iter();
    lines.filter(move |line| line.setup.error == error)
}

/// The machine of a calibration file with the location errors stated in the file. A stated tilt of a squareness is the whole squareness, so the
/// tilt of the other axis is set to zero.
pub(crate) fn located(file: &CalibrationFile) -> Result<Machine, ModelError> {
    let mut machine = file.machine.clone();
    for location in &file.locations {
        if is_square(location.error) {
            let value = Urad(location.value);
            set_square(&mut machine, file.reference_axes, location.error, value)?;
        } else {
            machine.set_location(location.error, location.value)?;
        }
    }
    Ok(machine)
}
