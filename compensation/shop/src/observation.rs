use volcomp_model::BODY_DIAGONALS;
use volcomp_vocabulary::{AxisName, Um, Urad};

use crate::{
    error::ObservationError,
    instrument::Instrument,
    plan::{MOST_POSES, Plan},
};

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
