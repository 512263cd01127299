//! Observations and unknowns as plain data, as stated in a file of observations.

use std::{ops::Range, path::PathBuf};

use volcomp_kinematics::{
    Chain, State,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::basis::Basis;

/// Extension of the range of curves at both ends, as a fraction of the observed range, if spheres or balls were probed.
const SPHERE_MARGIN: f64 = 1e-3;

/// Content of a file of observations and of the files that it names.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Paths of the file of observations, its machine file and its row files: they must not be overwritten.
    pub files: Vec<PathBuf>,
    /// The machine: its geometry, its known errors, and start values of its unknown errors.
    pub machine: Machine,
    /// Error motions of `machine` that the same calibration fitted to measured lines. `uncertainty_um` does not include
    /// the uncertainty of these fits, but the reported uncertainties do; the warning about large residuals states this.
    pub measured: Vec<ErrorName>,
    pub unknown: Vec<Unknown>,
    /// Observations in the order of the file.
    pub observations: Vec<Observation>,
    /// Frames, points and numbers of the set-ups that the observations refer to.
    pub setup: SetUp,
    /// Whether rows that do not fit get less weight (Huber).
    pub robust: bool,
    /// Number of parts into which poses are divided for cross-validation; 0: no cross-validation.
    pub folds: usize,
    /// Notes on the files.
    pub notes: Vec<String>,
}

/// An error to be identified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknown {
    /// Error motion or location error with an unknown value.
    pub error: ErrorName,
    /// Kind of curve; [`Basis::Constant`] for a location error. `None` if only the reversal value is unknown.
    pub basis: Option<Basis>,
    /// Second axis on which the error depends, with the curve's modes along it; `None`: it depends on its own axis only.
    pub second: Option<SecondAxis>,
    /// Whether the reversal value is unknown.
    pub reversal: bool,
    /// Whether the curve's modes are penalised, with a weight chosen from the observations.
    pub penalised: bool,
}

impl Unknown {
    /// An unknown with a single value: a location error, or the constant of a curve.
    pub fn constant(error: ErrorName) -> Self {
        Self {
            error,
            basis: Some(Basis::Constant),
            second: None,
            reversal: false,
            penalised: false,
        }
    }
}

/// Second axis on which an error depends: products of the modes of the error's own curve and of a curve along this axis are identified in
/// addition to the own curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SecondAxis {
    /// The second axis; it differs from the axis of the error.
    pub axis: AxisName,
    /// Kind of curve along the second axis. Its modes are multiplied by the modes of the error's own curve up to the
    /// same order.
    pub basis: Basis,
}

/// A frame, point or number of a set-up: known, or identified from this start value.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity<T> {
    /// Name in results: `tracker.csv:frame`.
    pub name: String,
    /// Value, or start value of the search; `None`: the start value is derived from the observations.
    pub value: Option<T>,
    /// Whether the quantity is identified.
    pub unknown: bool,
    /// Order of the drift over the rows; 0: no drift.
    pub drift: usize,
    /// Standard uncertainty of a calibrated value that is identified as well, in the unit of the value; `None`: not
    /// calibrated, or not identified.
    pub known_within: Option<f64>,
}

impl<T> Quantity<T> {
    /// Creates a quantity that is known if it has a value and unknown otherwise.
    pub fn new(name: String, value: Option<T>, drift: usize) -> Self {
        Self { name, unknown: value.is_none(), value, drift, known_within: None }
    }
}

/// Quantities of the set-ups of all observations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetUp {
    /// Frames of trackers: x, y, z in mm and a, b, c in deg, in workpiece axes.
    pub frames: Vec<Quantity<[f64; 6]>>,
    /// Points in mm: targets on tools, centres of spheres, points on the table.
    pub points: Vec<Quantity<[f64; 3]>>,
    /// Dead lengths, offsets and ball distances in mm; slopes and tilts in mm/mm.
    pub numbers: Vec<Quantity<f64>>,
    /// Kind of each number, which defines its unit in results.
    pub number_kinds: Vec<NumberKind>,
}

impl SetUp {
    pub(crate) fn add_point(&mut self, point: Quantity<[f64; 3]>) -> usize {
        self.points.push(point);
        self.points.len() - 1
    }

    /// Adds a number and returns its index.
    pub fn add_number(&mut self, kind: NumberKind, number: Quantity<f64>) -> usize {
        self.number_kinds.push(kind);
        self.numbers.push(number);
        self.numbers.len() - 1
    }
}

/// Kind of a number of a set-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberKind {
    /// Dead length, mm in files and results.
    DeadLength,
    /// Offset of a line, µm in files and results.
    Offset,
    /// Slope of a line, µm/m in files and results.
    Slope,
    /// Tilt of a ball row to a side, µrad in results.
    Tilt,
    /// Distance of a ball along its row, mm in files and results.
    Distance,
}

impl NumberKind {
    /// Unit in keys and results, and the factor from mm or mm/mm to this unit.
    pub(crate) fn unit(self) -> (&'static str, f64) {
        match self {
            Self::DeadLength | Self::Distance => ("mm", 1.0),
            Self::Offset => ("um", 1e3),
            Self::Slope => ("um_per_m", 1e6),
            Self::Tilt => ("urad", 1e6),
        }
    }
}

/// The rows of one file.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Path of the row file, as stated in the file of observations.
    pub file: String,
    /// What the instrument measures.
    pub kind: Kind,
    /// Whether the rows are only predicted, not fitted.
    pub judge: bool,
    pub rows: Vec<Row>,
}

/// The quantity that an instrument measures at each pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Kind {
    /// Positions of a target on the tool, from a tracker.
    Points,
    /// Positions of the machine at which the probe is at the centre of a sphere.
    Sphere,
    /// Distances of the tip from a point, or between two poses.
    Distance,
    /// Displacements along a line of sight.
    Line,
    /// Positions of the tip relative to the balls of a row.
    BallRow,
}

impl Kind {
    /// Keyword in files and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::Sphere => "sphere",
            Self::Distance => "distance",
            Self::Line => "line",
            Self::BallRow => "ball-row",
        }
    }
}

/// A pose of the machine, with its functional point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MachinePose {
    /// Coordinates (mm, rad) and approach directions.
    pub state: State,
    /// Functional point, mm in MCS at machine zero, without the offset of a target.
    pub tip_mm: Vector3<f64>,
}

impl MachinePose {
    /// Functional point of the ideal machine, mm in workpiece axes.
    pub(crate) fn ideal_tip_mm(&self, chain: &Chain) -> Vector3<f64> {
        let pose = chain.ideal_pose(&self.state);
        pose.transform_point(&self.tip_mm) - chain.workpiece_origin_mm()
    }
}

/// One row: a pose and its reading.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line in the row file, from 1; 0 if the row is from no file.
    pub line: usize,
    /// Pose at which the reading was taken.
    pub pose: MachinePose,
    /// Reading with the parts of the set-up to which it refers.
    pub reading: RowReading,
    /// Run to which the row belongs. Within a run every axis approaches from its position in the previous row; the
    /// direction of approach to the first rows is unknown. `None`: the row belongs to no run, and an axis without a
    /// stated direction is evaluated with the mean of both directions, as in means of bidirectional readings.
    pub run: Option<usize>,
    /// Time between −1 (first row) and 1 (last row), for the drift.
    pub time: f64,
    /// Standard uncertainty of each component of the reading, mm.
    pub uncertainty_mm: f64,
}

impl Row {
    /// Poses of the row: two for a length between poses, otherwise one.
    pub(crate) fn poses(&self) -> impl Iterator<Item = &MachinePose> {
        let from = match &self.reading {
            RowReading::Pair { from, .. } => Some(from),
            _ => None,
        };
        core::iter::once(&self.pose).chain(from)
    }
}

/// Reading at a pose. `frame`, `target` and similar fields are indices in [`SetUp`].
#[derive(Clone, Debug, PartialEq)]
pub enum RowReading {
    /// Position of the target on the tool, mm in the frame of the tracker.
    Point {
        /// Index of the frame of the tracker.
        frame: usize,
        /// Index of the point with the target's offset, mm in tool axes at machine zero; `None`: the target is the tip.
        target: Option<usize>,
        /// Measured position, mm.
        at_mm: Vector3<f64>,
    },
    /// The tip is at the centre of a sphere, except for an offset in workpiece axes.
    Sphere {
        /// Index of the centre point.
        centre: usize,
        /// Tip minus centre, mm.
        offset_mm: Vector3<f64>,
    },
    /// Distance of the tip from a point.
    Distance {
        /// Index of the point from which the distance is measured.
        point: usize,
        /// Index of the dead length, which is added to the reading.
        dead: usize,
        /// Measured length, mm.
        length_mm: f64,
    },
    /// Distance between the tips at two poses.
    Pair {
        /// Pose from which the distance is measured.
        from: MachinePose,
        /// Index of the dead length, which is added to the reading.
        dead: usize,
        /// Measured length, mm.
        length_mm: f64,
    },
    /// Displacement along a line of sight.
    Line {
        /// Unit direction in workpiece axes.
        direction: Vector3<f64>,
        /// Index of the offset, which is added to every reading.
        offset: usize,
        /// Index of the slope, which is multiplied by the distance along the line.
        slope: usize,
        /// Measured displacement, mm.
        deviation_mm: f64,
    },
    /// Position of the tip relative to a ball of a row.
    Ball {
        /// Index of the point at which the distance along the row is zero.
        origin: usize,
        /// Indices of the tilts to side 1 and side 2.
        tilts: [usize; 2],
        /// Index of the number with the distance of the ball along the row.
        distance: usize,
        /// Unit directions in workpiece axes as columns: along the row as placed, to side 1, to side 2.
        axes: Matrix3<f64>,
        /// Tip minus ball along the row and to the sides, mm; `None` if not measured.
        offset_mm: [Option<f64>; 3],
    },
}

impl RowReading {
    pub(crate) fn count(&self) -> usize {
        match self {
            Self::Point { .. } | Self::Sphere { .. } => 3,
            Self::Distance { .. } | Self::Pair { .. } | Self::Line { .. } => 1,
            Self::Ball { offset_mm, .. } => offset_mm.iter().flatten().count(),
        }
    }

    pub(crate) fn parts(&self) -> Vec<Part> {
        match *self {
            Self::Point { frame, target, .. } => {
                let target = target.map(Part::Point);
                core::iter::once(Part::Frame(frame)).chain(target).collect()
            }
            Self::Sphere { centre, .. } => vec![Part::Point(centre)],
            Self::Distance { point, dead, .. } => vec![Part::Point(point), Part::Number(dead)],
            Self::Pair { dead, .. } => vec![Part::Number(dead)],
            Self::Line { offset, slope, .. } => vec![Part::Number(offset), Part::Number(slope)],
            Self::Ball { origin, tilts: [first, second], distance, .. } => vec![
                Part::Point(origin),
                Part::Number(first),
                Part::Number(second),
                Part::Number(distance),
            ],
        }
    }

    /// Reverses the sign of a reading whose direction depends on the instrument: sphere, line and ball readings. Positions and lengths are unchanged.
    pub(crate) fn invert(&mut self) {
        match self {
            Self::Sphere { offset_mm, .. } => *offset_mm = -*offset_mm,
            Self::Line { deviation_mm, .. } => *deviation_mm = -*deviation_mm,
            Self::Ball { offset_mm, .. } => {
                for reading in offset_mm.iter_mut().flatten() {
                    *reading = -*reading;
                }
            }
            Self::Point { .. } | Self::Distance { .. } | Self::Pair { .. } => {}
        }
    }
}

/// Maximum gap, deg, that a Fourier series may bridge: a third of a turn.
const WIDEST_GAP_DEG: f64 = 120.0;

impl Observations {
    /// Creates observations of this machine without any rows or unknowns.
    pub fn of(machine: Machine) -> Self {
        Self {
            files: Vec::new(),
            machine,
            measured: Vec::new(),
            unknown: Vec::new(),
            observations: Vec::new(),
            setup: SetUp::default(),
            robust: false,
            folds: 0,
            notes: Vec::new(),
        }
    }

    pub(crate) fn fitted(&self) -> impl Iterator<Item = (&Observation, Range<usize>)> {
        let fitted = self.observations.iter().filter(|o| !o.judge);
        fitted.scan(0, |first, observation| {
            let own = *first..*first + observation.rows.len();
            *first = own.end;
            Some((observation, own))
        })
    }

    pub(crate) fn fitted_rows(&self) -> impl Iterator<Item = &Row> {
        self.fitted().flat_map(|(observation, _)| &observation.rows)
    }

    /// Coordinates of an axis at all fitted poses, mm or deg.
    fn coordinates(&self, axis: usize) -> impl Iterator<Item = f64> {
        let poses = self.fitted_rows().flat_map(Row::poses);
        poses.map(move |pose| self.machine.curve_coordinates(&pose.state)[axis])
    }

    /// Widest gap, deg, between adjacent positions of a rotary axis in the fitted rows, modulo 360°.
    fn widest_gap_deg(&self, axis: usize) -> f64 {
        let angles = self.coordinates(axis).map(|at| at.rem_euclid(360.0));
        let mut angles: Vec<f64> = angles.collect();
        angles.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (angles.first(), angles.last()) else {
            return 360.0;
        };
        let gaps = angles.windows(2).map(|pair| pair[1] - pair[0]);
        gaps.fold(first + 360.0 - last, f64::max)
    }

    pub(crate) fn fourier_gap_notes(&self) -> Vec<String> {
        let series = (self.unknown.iter())
            .filter(|unknown| matches!(unknown.basis, Some(Basis::Fourier { .. })));
        let gaps = series.filter_map(|unknown| {
            let axis = self.machine.index_of(unknown.error.axis).ok()?;
            let gap = self.widest_gap_deg(axis);
            (gap > WIDEST_GAP_DEG).then(|| {
                let goes_round = self.machine.axes()[axis].modulo.is_some();
                // An axis with a `modulo` needs a curve that closes.
                let what_to_do = if goes_round {
                    "observe it over the full turn, or use fewer harmonics"
                } else {
                    "use `legendre` for a part of a turn"
                };
                format!(
                    "{}: {} was not observed over {gap:.0} deg of a turn: the Fourier series is undetermined there, and its coefficients may be large; {what_to_do}",
                    unknown.error, unknown.error.axis
                )
            })
        });
        gaps.collect()
    }

    /// Range over which the modes of a curve along an axis are defined, mm or deg: the range of the fitted rows,
    /// extended by [`SPHERE_MARGIN`] if spheres or balls were probed. The range is the whole travel for a constant, for
    /// an axis that did not move, and for a Fourier series if the axis has a `modulo` or no gap between its positions
    /// exceeds [`WIDEST_GAP_DEG`].
    pub(crate) fn range_of(&self, axis: usize, basis: Basis) -> [f64; 2] {
        let travel = self.machine.axes()[axis].travel;
        if basis == Basis::Constant {
            return travel;
        }
        let goes_round = self.machine.axes()[axis].modulo.is_some();
        if matches!(basis, Basis::Fourier { .. })
            && (goes_round || self.widest_gap_deg(axis) <= WIDEST_GAP_DEG)
        {
            return travel;
        }
        let ends = [f64::INFINITY, f64::NEG_INFINITY];
        let range =
            (self.coordinates(axis)).fold(ends, |range, at| [range[0].min(at), range[1].max(at)]);
        // A range below a millionth of the travel is an axis that did not move.
        if range[1] - range[0] > 1e-6 * (travel[1] - travel[0]) {
            // A probed row has the coordinates at which the real machine found the sphere or ball. The coordinates of
            // the ideal machine differ slightly and may be outside the range.
            let is_probed = |row: &Row| {
                matches!(row.reading, RowReading::Sphere { .. } | RowReading::Ball { .. })
            };
            let margin = if self.fitted_rows().any(is_probed) { SPHERE_MARGIN } else { 0.0 };
            let wider = margin * (range[1] - range[0]);
            [range[0] - wider, range[1] + wider]
        } else {
            travel
        }
    }
}

/// Reference to a frame, point or number of a set-up, by its index in the list of that kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// Six numbers: small displacements along the axes (mm), then rotations about them (rad).
    Frame(usize),
    /// Three coordinates, mm.
    Point(usize),
    /// One number, mm or mm/mm.
    Number(usize),
}
