//! A truth machine with the measurements to be made on it: plain data.

use std::path::PathBuf;

use volcomp_calibrate::{CurveChoice, Setup};
use volcomp_identify::Unknown;
use volcomp_model::Machine;
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{
    file::{Format, Header},
    instrument::Instrument,
    observation::ShopObservation,
};

/// A truth machine with the measurements to be made on it.
#[derive(Clone, Debug)]
pub struct Shop {
    /// The machine as it really is.
    pub truth: Machine,
    /// Seed of all that is random.
    pub seed: u64,
    /// The lines to be measured.
    pub lines: Vec<ShopLine>,
    /// Squareness errors, each with φ − π/2 of its reference: φ is the angle between the + directions of the two beams.
    pub squareness: Vec<(ErrorName, Urad)>,
    /// The location errors that are read directly.
    pub locations: Vec<ShopLocation>,
    /// What the measurement files say of the test.
    pub header: Header,
    /// The volumetric observations to be made.
    pub observations: Vec<ShopObservation>,
    /// What the file of observations asks for.
    pub unknown: Vec<Unknown>,
    /// The files that were read: the shop file, the machine, plans of poses; none where the shop was not read from a file.
    pub inputs: Vec<PathBuf>,
}

/// The machine file that the calibration of the lines is to write, beside the shop's files: where a shop has lines and
/// observations, its file of observations starts from this machine.
pub const CALIBRATED: &str = "calibrated.toml";

/// A location error that is read directly: a mandrel and an indicator, a probe in the control's own cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShopLocation {
    /// The location error.
    pub error: ErrorName,
    /// Standard deviation of what is read, µm or µrad; stated as its standard uncertainty.
    pub noise: f64,
}

/// A line to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ShopLine {
    /// The error and how it is measured.
    pub setup: Setup,
    /// With which instrument, over which targets, in how many runs.
    pub instrument: Instrument,
    /// The kind of curve that the calibration file asks for.
    pub curve: Option<CurveChoice>,
    /// Of a rotary axis: whether the readings are taken against the commanded pose, so that they hold what the location errors
    /// of the axis add; `false`: the instrument is centred on the axis as it is.
    pub holds_location: bool,
    /// Name of the measurement file without its ending.
    pub name: String,
    /// The kind of the measurement file.
    pub format: Format,
}
