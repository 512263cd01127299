//! A volumetric observation to be made: which instrument, how it stands, how many poses. Plain data.

use volcomp_model::BODY_DIAGONALS;
use volcomp_vocabulary::{AxisName, Um, Urad};

use crate::{error::ObservationError, instrument::Instrument, plan::Plan};

/// An observation to be made on the truth machine.
#[derive(Clone, Debug, PartialEq)]
pub struct ShopObservation {
    /// Name of the row file without its ending.
    pub name: String,
    /// How the instrument reads; `alignment` is the standard deviation of each tilt at which a bar or a laser stands.
    pub instrument: Instrument,
    /// Axes that stand still, mm or deg.
    pub at: Vec<(AxisName, f64)>,
    /// Tools of the machine file that take turns from pose to pose; none: the tool of the machine.
    pub tools: Vec<String>,
    /// The instrument and how it stands.
    pub setting: Setting,
}

/// An instrument and how it stands; points and directions in workpiece axes, mm.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// A tracker follows a target on the tool.
    Points {
        /// The poses.
        poses: Poses,
        /// The pose of the tracker: x, y, z in mm, then a, b, c in deg about the fixed X, Y and Z.
        frame: [f64; 6],
        /// Offset of the target from the tip, in tool axes at machine zero.
        target: Option<[f64; 3]>,
    },
    /// Spheres on the table.
    Sphere {
        /// The poses: so many at each sphere, or all of a plan.
        poses: Poses,
        /// Their centres.
        centres: Vec<[f64; 3]>,
        /// What is written.
        reads: Reads,
    },
    /// Distances from a point on the table.
    Distance {
        /// The poses.
        poses: Poses,
        /// The point.
        point: [f64; 3],
        /// What every reading is too short by.
        dead_length_mm: f64,
        /// All poses at this distance from the point (ballbar); `None`: anywhere in the travel (tracer).
        radius_mm: Option<f64>,
    },
    /// A step gauge: distances between its faces.
    StepGauge(Bar),
    /// A row of balls.
    BallRow {
        /// The bar.
        bar: Bar,
        /// What is written.
        reads: Reads,
    },
    /// A laser along body diagonals, `PPP` and so on.
    Diagonals {
        /// Which of them.
        names: Vec<String>,
    },
}

/// The poses at which an instrument reads.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// So many, drawn over the travels.
    Drawn(usize),
    /// Commands that were chosen beforehand.
    Planned(Plan),
}

impl Poses {
    /// How many there are, at each sphere where they are drawn.
    pub fn count(&self) -> usize {
        match self {
            Self::Drawn(count) => *count,
            Self::Planned(plan) => plan.poses.len(),
        }
    }
}

/// How a probe tells where it is against a sphere or a ball.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reads {
    /// The machine goes to the centre, its coordinates are written (touch probe).
    Coordinates,
    /// The machine goes where the centre is nominally, the offset is written (R-test, indicators).
    Offset,
}

/// A bar with marks.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Where the distance along the bar is zero.
    pub origin: [f64; 3],
    /// The nominal direction of the bar, of any length.
    pub direction: [f64; 3],
    /// The calibrated distances along the bar, mm.
    pub distances: Vec<f64>,
    /// Standard uncertainty of every calibrated distance but that of 0 mm.
    pub calibration: Um,
}

impl Setting {
    /// The word in a shop file.
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
    /// Whether it can be made: an instrument that can be, as many poses and marks as are allowed, diagonals that there are.
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
            return Err(ObservationError::Count {
                what,
                found,
                least,
                most,
            });
        }
        Ok(())
    }

    /// The standard uncertainty of a reading as the file of observations states it, µm: noise and rounding.
    pub(crate) fn uncertainty_um(&self) -> f64 {
        let length = &self.instrument.length;
        let rounding = length.resolution.0 / 12.0_f64.sqrt();
        length.noise.0.hypot(rounding).max(LEAST_UNCERTAINTY_UM)
    }

    /// The names of its files without their endings.
    pub(crate) fn file_names(&self) -> Vec<String> {
        let name = &self.name;
        match &self.setting {
            Setting::BallRow { .. } => vec![name.clone(), format!("{name}-row")],
            Setting::Diagonals { names } => names
                .iter()
                .map(|diagonal| format!("{name}-{}", diagonal.to_lowercase()))
                .collect(),
            _ => vec![name.clone()],
        }
    }

    /// Whether the set-up drifts.
    pub(crate) fn drifts(&self) -> bool {
        self.instrument.length.drift != Um(0.0) || self.instrument.angle.drift != Urad(0.0)
    }
}

/// Poses of one observation at the most.
pub(crate) const MOST_POSES: usize = 100_000;
/// Marks of a bar at the most.
pub(crate) const MOST_MARKS: usize = 10_000;

/// The uncertainty that is stated for an instrument without noise, µm.
const LEAST_UNCERTAINTY_UM: f64 = 1e-3;
