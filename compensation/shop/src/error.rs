//! The reasons why a virtual shop makes no measurement files.

use volcomp_document::{InputError, ReadError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_vocabulary::ErrorName;

/// Why a shop makes no measurement files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShopError {
    /// The shop file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in the shop file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Something in the file of the truth machine is wrong, or the machine lacks an axis that is to be measured.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The instrument of a line cannot be (only possible when built in code).
    #[error("the line of {error}: {source}")]
    Instrument {
        /// The error to be measured.
        error: ErrorName,
        /// The reason why the instrument is refused.
        source: InstrumentError,
    },
    /// An error cannot be measured by the method asked for (only possible when built in code).
    #[error("the line of {error}: {source}")]
    Method {
        /// The error to be measured.
        error: ErrorName,
        /// Why the method does not fit the error.
        source: MetrologyError,
    },
    /// More readings than a shop may make.
    #[error(
        "the shop makes {found} readings, expected at most {most}: fewer targets, runs or poses"
    )]
    Readings {
        /// The readings of all lines and observations.
        found: usize,
        /// The largest number allowed.
        most: usize,
    },
    /// An observation cannot be made.
    #[error("the observation {name}: {source}")]
    Observation {
        /// The name of its row file.
        name: String,
        /// Why it cannot be made.
        source: Box<ObservationError>,
    },
}

/// The reason why an observation cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ObservationError {
    /// The instrument cannot be (only possible when built in code).
    #[error(transparent)]
    Instrument(#[from] InstrumentError),
    /// The machine lacks an axis or a tool, or a coordinate is no number.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// Too few poses with the tip at a point lie within travel.
    #[error(
        "{what} at [{}, {}, {}] mm in workpiece axes: found {found} of {poses} poses within travel, expected a place that the tool reaches with the rotary axes all over their travel, or rotary axes held by `at`",
        at[0], at[1], at[2]
    )]
    Reach {
        /// What the tip goes to.
        what: String,
        /// Where it is, mm in workpiece axes.
        at: [f64; 3],
        /// How many poses were found.
        found: usize,
        /// How many were asked for.
        poses: usize,
    },
    /// The tip cannot be brought to a point.
    #[error(
        "found no position within travel with the tool at [{:.3}, {:.3}, {:.3}] mm in workpiece axes, expected a bar within reach of the linear axes",
        at[0], at[1], at[2]
    )]
    NotReached {
        /// The point, mm in workpiece axes.
        at: [f64; 3],
    },
    /// The tip cannot be brought to a sphere at a planned pose.
    #[error(
        "row {pose} of the plan: found no position within travel with the tool at sphere S{sphere}, [{}, {}, {}] mm in workpiece axes, expected rotary positions at which the linear axes reach it",
        at[0], at[1], at[2]
    )]
    PlannedReach {
        /// The row of the plan, from 1.
        pose: usize,
        /// The sphere, from 1.
        sphere: usize,
        /// Its centre, mm in workpiece axes.
        at: [f64; 3],
    },
    /// The tip is far from a sphere at a planned pose.
    #[error(
        "row {pose} of the plan: found the tool {apart_mm:.3} mm from sphere S{sphere}, expected at most {most_mm} mm; without columns of linear axes these follow to the sphere by themselves"
    )]
    PlannedApart {
        /// The row of the plan, from 1.
        pose: usize,
        /// The sphere, from 1.
        sphere: usize,
        /// How far the nominal tip is from the centre, mm.
        apart_mm: f64,
        /// How far it may be, mm.
        most_mm: f64,
    },
    /// A plan names a sphere that there is not (only possible when built in code).
    #[error("found sphere S{found} in the plan, expected S1 to S{most}")]
    NoSphere {
        /// The sphere, from 1.
        found: usize,
        /// The number of spheres.
        most: usize,
    },
    /// Too few or too many poses, marks or diagonals (only possible when built in code).
    #[error("found {found} {what}, expected {least} to {most}")]
    Count {
        /// What is counted.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there must be.
        least: usize,
        /// How many there may be.
        most: usize,
    },
    /// A diagonal that a working space does not have (only possible when built in code).
    #[error("found the diagonal {name:?}, expected one of PPP, NPP, PNP, PPN")]
    NoDiagonal {
        /// Its name.
        name: String,
    },
    /// A direction of no length.
    #[error("found a direction of no length, expected one that points somewhere")]
    NoDirection,
}

/// The reason why an instrument is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InstrumentError {
    /// Too few or too many targets.
    #[error("found {found} targets, expected 2 to {most}")]
    Targets {
        /// The number of targets.
        found: usize,
        /// The largest number allowed.
        most: usize,
    },
    /// There is no run over the targets.
    #[error("found no runs, expected at least 1")]
    NoRuns,
    /// More readings than a line may have.
    #[error("found {targets} targets in {runs} runs, expected at most {most} readings")]
    Readings {
        /// The number of targets.
        targets: usize,
        /// The number of runs in each direction.
        runs: u32,
        /// The largest number of readings allowed.
        most: usize,
    },
    /// A number that is not finite, or negative where that has no meaning.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// The quantity, as the key of a shop file with its unit.
        what: &'static str,
        /// The number that was found.
        found: f64,
        /// The numbers that are allowed, in words.
        expected: &'static str,
    },
}
