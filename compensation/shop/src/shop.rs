//! A virtual shop as plain data: its truth machine, lines, location errors and observations.

use std::path::PathBuf;

use volcomp_calibrate::{CurveChoice, Setup};
use volcomp_document::{InputError, Value};
use volcomp_identify::Unknown;
use volcomp_model::{BODY_DIAGONALS, Machine};
use volcomp_vocabulary::{AxisName, ErrorName, Um, Urad};

use crate::error::ObservationError;
use crate::instrument::Instrument;
use crate::poses::{MOST_POSES, Plan};

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

/// A volumetric observation of the truth machine.
#[derive(Clone, Debug, PartialEq)]
pub struct ShopObservation {
    /// Name of the row file without its extension.
    pub name: String,
    /// Imperfections, targets and runs; `alignment` is the standard deviation of each tilt with which a bar or a laser is set up.
    pub instrument: Instrument,
    /// Coordinates of the axes that do not move, mm or deg.
    pub at: Vec<(AxisName, f64)>,
    /// Tools of the machine file, used in turn from pose to pose; empty: the tool in the spindle.
    pub tools: Vec<String>,
    /// The kind of instrument and its set-up.
    pub setting: Setting,
}

/// An instrument and its set-up. Points and directions are in workpiece axes, mm.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// A laser tracker that follows a target on the tool.
    Points {
        /// Poses at which the tracker measures.
        poses: Poses,
        /// Pose of the tracker in workpiece axes: x, y, z in mm, then a, b, c in deg about the fixed X, Y and Z.
        frame: [f64; 6],
        /// Offset of the target from the tip, mm in tool axes at machine zero; `None`: the target is at the tip.
        target: Option<[f64; 3]>,
    },
    /// A touch probe or an R-test on spheres on the table.
    Sphere {
        /// Poses: random ones for each sphere, or those of a plan.
        poses: Poses,
        /// Centres of the spheres, mm in workpiece axes.
        centres: Vec<[f64; 3]>,
        /// Quantity that the probe records.
        reads: Reads,
    },
    /// Distances from a point on the table: ballbar or laser tracer.
    Distance {
        /// Poses at which distances are measured.
        poses: Poses,
        /// Point on the table from which distances are measured, mm.
        point: [f64; 3],
        /// Length by which every reading is too short, mm.
        dead_length_mm: f64,
        /// Distance of all poses from the point, mm (ballbar); `None`: anywhere within the travels (laser tracer).
        radius_mm: Option<f64>,
    },
    /// A step gauge: distances between its faces.
    StepGauge(Bar),
    /// A ball bar whose balls are probed in order.
    BallRow {
        /// The bar; its marks are the balls.
        bar: Bar,
        /// Quantity that the probe records.
        reads: Reads,
    },
    /// A laser along body diagonals.
    Diagonals {
        /// Names of the measured diagonals, such as `PPP`.
        names: Vec<String>,
    },
}

/// The poses at which an instrument takes readings.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// Random poses over the travels: their number.
    Drawn(usize),
    /// Commanded poses of a plan.
    Planned(Plan),
}

impl Poses {
    /// Number of poses; for drawn poses, the number for each sphere.
    pub fn count(&self) -> usize {
        match self {
            Self::Drawn(count) => *count,
            Self::Planned(plan) => plan.poses.len(),
        }
    }
}

/// Quantity that a probe records at a sphere or a ball.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reads {
    /// Coordinates of the machine with the tip at the actual centre (touch probe).
    Coordinates,
    /// Offset of the tip from the actual centre with the machine at the nominal one (R-test, indicators).
    Offset,
}

/// A bar with marks.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Point of the bar at distance 0, mm in workpiece axes.
    pub origin: [f64; 3],
    /// Nominal direction of the bar in workpiece axes; not necessarily a unit vector.
    pub direction: [f64; 3],
    /// The calibrated distances along the bar, mm.
    pub distances: Vec<f64>,
    /// Standard uncertainty of every calibrated distance except that of 0 mm.
    pub calibration: Um,
}

impl Setting {
    /// Name of the kind of instrument in a shop file.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Points { .. } => "points",
            Self::Sphere { .. } => "sphere",
            Self::Distance { .. } => "distance",
            Self::StepGauge(_) => "step-gauge",
            Self::BallRow { .. } => "ball-row",
            Self::Diagonals { .. } => "diagonals",
        }
    }
}

impl ShopObservation {
    pub(crate) fn check(&self) -> Result<(), ObservationError> {
        self.instrument.check()?;
        let (what, found, [least, most]) = match &self.setting {
            Setting::Points { poses, .. }
            | Setting::Sphere { poses, .. }
            | Setting::Distance { poses, .. } => ("poses", poses.count(), [1, MOST_POSES]),
            Setting::StepGauge(bar) | Setting::BallRow { bar, .. } => {
                ("distances", bar.distances.len(), [2, MOST_MARKS])
            }
            Setting::Diagonals { names } => {
                let is_one = |name: &&String| !BODY_DIAGONALS.contains(&name.as_str());
                if let Some(name) = names.iter().find(is_one) {
                    return Err(ObservationError::NoDiagonal { name: name.clone() });
                }
                ("diagonals", names.len(), [1, BODY_DIAGONALS.len()])
            }
        };
        if !(least..=most).contains(&found) {
            return Err(ObservationError::Count { what, found, least, most });
        }
        Ok(())
    }

    /// Standard uncertainty of a reading for the file of observations, µm: noise and rounding.
    pub(crate) fn uncertainty_um(&self) -> f64 {
        let length = &self.instrument.length;
        let rounding = length.resolution.0 / 12.0_f64.sqrt();
        length.noise.0.hypot(rounding).max(LEAST_UNCERTAINTY_UM)
    }

    pub(crate) fn file_names(&self) -> Vec<String> {
        let name = &self.name;
        match &self.setting {
            Setting::BallRow { .. } => vec![name.clone(), format!("{name}-row")],
            Setting::Diagonals { names } => {
                names.iter().map(|diagonal| format!("{name}-{}", diagonal.to_lowercase())).collect()
            }
            _ => vec![name.clone()],
        }
    }

    pub(crate) fn drifts(&self) -> bool {
        self.instrument.length.drift != Um(0.0) || self.instrument.angle.drift != Urad(0.0)
    }
}
pub(crate) const MOST_MARKS: usize = 10_000;

/// Minimum of the standard uncertainty, which applies to an instrument without noise, µm.
const LEAST_UNCERTAINTY_UM: f64 = 1e-3;
