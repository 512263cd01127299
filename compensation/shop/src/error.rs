use volcomp_document::{InputError, ReadError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_vocabulary::ErrorName;

/// Reasons why a shop cannot make measurement files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShopError {
    /// The shop file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The shop file contains an invalid value.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The file of the truth machine is invalid, or the machine lacks an axis to be measured.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The instrument of a line is invalid (only possible for a shop built in code).
    #[error("the line of {error}: {source}")]
    Instrument {
        /// Error that the line measures.
        error: ErrorName,
        /// Reason why the instrument is rejected.
        source: InstrumentError,
    },
    /// An error cannot be measured by the requested method (only possible for a shop built in code).
    #[error("the line of {error}: {source}")]
    Method {
        /// Error that the line should measure.
        error: ErrorName,
        /// Reason why the method does not fit the error.
        source: MetrologyError,
    },
    /// More readings than a shop may make.
    #[error(
        "the shop makes {found} readings, expected at most {most}: fewer targets, runs or poses"
    )]
    Readings {
        /// Number of readings of all lines and observations.
        found: usize,
        /// Maximum number of readings.
        most: usize,
    },
    /// An observation cannot be made.
    #[error("the observation {name}: {source}")]
    Observation {
        /// Name of the observation's row file, without extension.
        name: String,
        /// Reason why the observation cannot be made.
        source: Box<ObservationError>,
    },
}

/// Reasons why an observation cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ObservationError {
    /// The instrument is invalid (only possible for a shop built in code).
    #[error(transparent)]
    Instrument(#[from] InstrumentError),
    /// The machine lacks an axis or a tool, or a coordinate is not a number.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// Too few of the requested poses with the tip at a target position are within the travels.
    #[error(
        "{what} at [{}, {}, {}] mm in workpiece axes: found {found} of {poses} poses within travel, expected a place that the tool reaches with the rotary axes all over their travel, or rotary axes held by `at`",
        at[0], at[1], at[2]
    )]
    Reach {
        /// Noun for the target position in the message.
        what: String,
        /// Position, mm in workpiece axes.
        at: [f64; 3],
        /// Number of poses found.
        found: usize,
        /// Number of poses requested.
        poses: usize,
    },
    /// The tip cannot reach a point within the travels.
    #[error(
        "found no position within travel with the tool at [{:.3}, {:.3}, {:.3}] mm in workpiece axes, expected a bar within reach of the linear axes",
        at[0], at[1], at[2]
    )]
    NotReached {
        /// The point, mm in workpiece axes.
        at: [f64; 3],
    },
    /// The tip cannot reach a sphere at a planned pose within the travels.
    #[error(
        "row {pose} of the plan: found no position within travel with the tool at sphere S{sphere}, [{}, {}, {}] mm in workpiece axes, expected rotary positions at which the linear axes reach it",
        at[0], at[1], at[2]
    )]
    PlannedReach {
        /// Row of the plan, from 1.
        pose: usize,
        /// Number of the sphere, from 1, as in `S1`.
        sphere: usize,
        /// Centre of the sphere, mm in workpiece axes.
        at: [f64; 3],
    },
    /// The tip is too far from a sphere at a planned pose.
    #[error(
        "row {pose} of the plan: found the tool {apart_mm:.3} mm from sphere S{sphere}, expected at most {most_mm} mm; without columns of linear axes these follow to the sphere by themselves"
    )]
    PlannedApart {
        /// Row of the plan, from 1.
        pose: usize,
        /// Number of the sphere, from 1, as in `S1`.
        sphere: usize,
        /// Distance of the nominal tip from the centre, mm.
        apart_mm: f64,
        /// Maximum of this distance, mm.
        most_mm: f64,
    },
    /// A plan refers to a sphere that does not exist (only possible for a shop built in code).
    #[error("found sphere S{found} in the plan, expected S1 to S{most}")]
    NoSphere {
        /// Number of the sphere in the plan, from 1.
        found: usize,
        /// Number of spheres of the observation.
        most: usize,
    },
    /// Too few or too many poses, marks or diagonals (only possible for a shop built in code).
    #[error("found {found} {what}, expected {least} to {most}")]
    Count {
        /// Plural noun of the counted things: poses, marks or diagonals.
        what: &'static str,
        /// Number of poses, marks or diagonals that was found.
        found: usize,
        /// Minimum number of poses, marks or diagonals.
        least: usize,
        /// Maximum number of poses, marks or diagonals.
        most: usize,
    },
    /// A diagonal has an unknown name (only possible for a shop built in code).
    #[error("found the diagonal {name:?}, expected one of PPP, NPP, PNP, PPN")]
    NoDiagonal {
        /// The rejected name.
        name: String,
    },
    /// A direction has zero length.
    #[error("found a direction of zero length, expected a vector with a length above 0")]
    NoDirection,
}

/// Reasons why an instrument is rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InstrumentError {
    /// Too few or too many targets.
    #[error("found {found} targets, expected 2 to {most}")]
    Targets {
        /// Number of targets that the instrument would measure on a line.
        found: usize,
        /// Maximum number of targets on a line.
        most: usize,
    },
    /// The number of runs is zero.
    #[error("found no runs, expected at least 1")]
    NoRuns,
    /// More readings than one line may have.
    #[error("found {targets} targets in {runs} runs, expected at most {most} readings")]
    Readings {
        /// Number of targets of the line.
        targets: usize,
        /// Number of runs in each direction.
        runs: u32,
        /// Maximum number of readings.
        most: usize,
    },
    /// A number is not finite, or is negative where that is not allowed.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// Key of the quantity in a shop file, with its unit.
        what: &'static str,
        /// The rejected number.
        found: f64,
        /// Description of the allowed numbers.
        expected: &'static str,
    },
}
