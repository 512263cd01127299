use std::path::PathBuf;

use volcomp_calibrate::{CurveChoice, Setup};
use volcomp_document::{InputError, Value};
use volcomp_identify::Unknown;
use volcomp_model::Machine;
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{instrument::Instrument, observation::ShopObservation};

/// Format of a measurement file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Files of a Renishaw laser: `.rtl` for lengths, `.rts` for straightness optics, `.rta` for angles.
    #[default]
    Renishaw,
    /// CSV tables with the columns `target`, `run`, `direction` and `deviation`, and units in the header.
    Csv,
    /// Position file of an API laser, `.pos`: means over the runs, lengths only.
    ApiPos,
    /// Text report of a 5529 laser, `.txt`: means and scatter over the runs of both directions.
    KeysightReport,
}

/// Header data for every measurement file, as far as its format supports them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Header {
    pub date: Option<String>,
    /// Name of the person who measured.
    pub by: Option<String>,
    /// The serial number of the machine.
    pub serial: Option<String>,
    /// Place at which the machine is installed.
    pub location: Option<String>,
    /// Air temperature during the test, °C.
    pub air_degc: Option<f64>,
    /// Material temperature during the test, °C. The readings of the virtual shop do not depend on it.
    pub material_degc: Option<f64>,
    /// Expansion coefficient set in the laser software, µm/(m·K).
    pub expansion_um_per_m_k: Option<f64>,
}

/// A truth machine with the measurements to be made on it.
#[derive(Clone, Debug)]
pub struct Shop {
    /// The actual machine, including its errors.
    pub truth: Machine,
    pub seed: u64,
    pub lines: Vec<ShopLine>,
    /// Squareness errors with the deviation φ − π/2 of their reference, where φ is the angle between the positive directions of the two
    /// beams.
    pub squareness: Vec<(ErrorName, Urad)>,
    /// Location errors that are measured directly.
    pub locations: Vec<ShopLocation>,
    /// Header data of every measurement file.
    pub header: Header,
    /// The volumetric observations to be made.
    pub observations: Vec<ShopObservation>,
    /// Unknowns of the file of observations.
    pub unknown: Vec<Unknown>,
    /// Paths of the input files: shop file, machine, plans of poses; empty if the shop was not read from a file.
    pub inputs: Vec<PathBuf>,
}

/// Name of the machine file that the calibration of the lines writes into the folder of the shop's files. If a shop has lines and
/// observations, its file of observations starts from this machine.
pub const CALIBRATED: &str = "calibrated.toml";

/// A location error that is measured directly, with a mandrel and an indicator or by a probing cycle of the control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShopLocation {
    pub error: ErrorName,
    /// Standard deviation of the reading, µm or µrad; the calibration file states it as the standard uncertainty.
    pub noise: f64,
}

/// A line to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ShopLine {
    /// The error, with the method and location of its measurement.
    pub setup: Setup,
    /// The instrument, with its targets and runs.
    pub instrument: Instrument,
    /// Kind of curve that the calibration file requests; `None`: the default.
    pub curve: Option<CurveChoice>,
    /// Whether the readings of a rotary axis refer to the commanded pose, so that they include the location errors of the axis. Otherwise
    /// the instrument is centred on the actual axis.
    pub holds_location: bool,
    /// Name of the measurement file without its extension.
    pub name: String,
    pub format: Format,
}

pub(crate) const TAKEN: [&str; 4] = ["machine", "calibration", "observations", "calibrated"];

pub(crate) fn decode_file_name(value: &Value<'_>) -> Result<String, InputError> {
    let name = value.text()?;
    if name.is_empty() || name.contains(['/', '\\']) {
        let expected = "expected a name without a folder";
        return Err(value.error(format!("found {name:?}, {expected}")));
    }
    Ok(name.to_owned())
}
