//! The content of a calibration file, with every file that it names already read: plain data.

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

/// A calibration file with everything it names read.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    /// The calibration file, its machine file and its measurement files, as paths: what must not be overwritten.
    pub files: Vec<PathBuf>,
    /// The serial number of the machine, where the calibration file states it.
    pub serial: Option<String>,
    /// The machine as its file states it.
    pub machine: Machine,
    /// Coordinates at which curves are zero, mm or deg, by the place of the axis in the chain; without a value, 0.
    pub reference: Vec<f64>,
    /// Primary and secondary reference axis: the primary has no tilt, the secondary none about the
    /// primary.
    pub reference_axes: [AxisName; 2],
    /// Every measured line, in the order of the file.
    pub measurements: Vec<Line>,
    /// Every squareness error, in the order of the file.
    pub squareness: Vec<Squareness>,
    /// The diagonals that squareness errors come from.
    pub diagonals: Vec<Diagonals>,
    /// Every location error that an instrument gave directly, in the order of the file.
    pub locations: Vec<Location>,
    /// What is to be found from observations of the whole machine.
    pub observations: Option<Observations>,
    /// Provenance of the files of the observations.
    pub observed: Vec<Source>,
    /// Contributions to the uncertainty that the scatter of the readings does not show.
    pub uncertainty: Uncertainty,
}

/// One measurement: an error along one line.
#[derive(Clone, Debug)]
pub struct Line {
    /// The error and how it was measured.
    pub setup: Setup,
    /// The measurement file, for messages.
    pub file: PathBuf,
    /// What the machine file tells of the measurement file; nothing for readings that come from none, more where readings are
    /// made from several.
    pub sources: Vec<Source>,
    /// Where the calibration file names it, for messages: `calibration.toml:12`.
    pub place: String,
    /// Its readings, in the sign of the error, µm or µrad; of the bridge for the angular method.
    pub readings: Measurement,
    /// The kind of curve wanted, where stated.
    pub curve: Option<CurveChoice>,
    /// The line that is taken out of a straightness, whose slope goes into the squareness.
    pub reference_line: ReferenceKind,
    /// Of a rotary axis: whether the readings were taken against the commanded pose, so that they hold what the location
    /// errors of the axis add; `false` where the instrument was centred on the axis itself (ISO 230-7).
    pub holds_location: bool,
}

/// A location error as an instrument gave it: `EX0C`, `EA0C`, `EC0Y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Location {
    /// The location error.
    pub error: ErrorName,
    /// Its value, µm or µrad.
    pub value: f64,
    /// The standard uncertainty (k = 1) of the value, µm or µrad.
    pub uncertainty: f64,
}

/// A squareness error and where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squareness {
    /// EC0Y, EA0Z or EB0Z.
    pub error: ErrorName,
    /// Its value or the angle of its reference.
    pub source: SquarenessSource,
}

/// Where a squareness value comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SquarenessSource {
    /// The value itself is given.
    Value(Urad),
    /// From the slopes of the two straightness errors and the angle of their reference.
    Slopes {
        /// φ − π/2, φ the angle between the + directions of the two reference beams.
        reference_angle: Urad,
    },
    /// From diagonals ([`CalibrationFile::diagonals`]).
    Diagonals,
}

/// Standard uncertainties (k = 1) that the scatter of the readings does not show: the table
/// `[uncertainty]` of a calibration file. All 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Of the laser's scale, its material temperature included, µm/m: the same for every positioning line.
    pub laser_um_per_m: f64,
    /// Of the reference angle of each squareness, µrad.
    pub square_urad: f64,
    /// Of the mean at each target of a linear reading, µm, independent between targets.
    pub reading_um: f64,
    /// Of the mean at each target of an angular reading, µrad, independent between targets.
    pub reading_urad: f64,
}

impl CalibrationFile {
    /// The coordinate at which the curves of an axis are zero, mm or deg, by the place of the axis in the chain.
    pub(crate) fn reference_at(&self, place: usize) -> f64 {
        self.reference.get(place).copied().unwrap_or(0.0)
    }
}

/// Diagonals from which one to three squareness errors are found together.
#[derive(Clone, Debug)]
pub struct Diagonals {
    /// The squareness errors.
    pub errors: Vec<ErrorName>,
    /// The diagonals as lines of sight. The offset of each is unknown, and a scale that all share: the laser's, its
    /// material temperature's, and that of the diagonals' mean.
    pub observations: Observations,
    /// Provenance of their files.
    pub sources: Vec<Source>,
}

/// The errors that a file measures, each once: first the angular ones, which Abbe needs, then the linear ones.
pub(crate) fn measured(file: &CalibrationFile) -> Vec<ErrorName> {
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|l| l.setup.error).collect();
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    names
}

/// The lines of one error, in the order of the file.
pub(crate) fn lines_of(file: &CalibrationFile, error: ErrorName) -> impl Iterator<Item = &Line> {
    let lines = file.measurements.iter();
    lines.filter(move |line| line.setup.error == error)
}

/// The machine of a calibration file with the location errors that the file states. The tilt of a squareness states all
/// of it: what the machine file had for the other axis of the pair goes.
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
