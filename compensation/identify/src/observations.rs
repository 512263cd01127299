//! What was observed and what is to be found: plain data, as a file of observations states it.

use std::{ops::Range, path::PathBuf};

use volcomp_kinematics::{
    Chain, State,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::basis::Basis;

/// Part of the range of the observations that is added to it at both ends where spheres or balls were probed.
const SPHERE_MARGIN: f64 = 1e-3;

/// Everything that a file of observations states, with the files that it names read.
#[derive(Clone, Debug)]
pub struct Observations {
    /// The file of observations, its machine file and its row files, as paths: what must not be overwritten.
    pub files: Vec<PathBuf>,
    /// The machine: its geometry, the errors that are known, and start values of those that are not.
    pub machine: Machine,
    /// Error motions of `machine` that were measured together with these observations: their own uncertainty is not in `uncertainty_um`,
    /// so they are not blamed for what it leaves.
    pub measured: Vec<ErrorName>,
    /// What is to be found.
    pub unknown: Vec<Unknown>,
    /// The observations in the order of the file.
    pub observations: Vec<Observation>,
    /// Frames, points and lengths of the set-ups that the observations refer to.
    pub setup: SetUp,
    /// Whether rows that do not fit count less (Huber).
    pub robust: bool,
    /// Into how many parts the poses are divided to judge what was found; 0: not judged.
    pub folds: usize,
    /// Notes on the files.
    pub notes: Vec<String>,
}

/// One error that is to be found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknown {
    /// The error.
    pub error: ErrorName,
    /// Its curve; `None` where only the reversal value is to be found. A location error is a constant.
    pub basis: Option<Basis>,
    /// The second axis that the error depends on, with the curve's modes along it; `None`: it depends on its own alone.
    pub second: Option<SecondAxis>,
    /// Whether the reversal value is to be found.
    pub reversal: bool,
    /// Whether a penalty on the curve's modes is chosen from the observations.
    pub penalised: bool,
}

impl Unknown {
    /// An error of which one number is to be found: a location error, or the constant of a curve.
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

/// A second axis on which an error depends: products of the modes of its own curve and of a curve along this axis are
/// found too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SecondAxis {
    /// The axis.
    pub axis: AxisName,
    /// The kind of curve along it. Modes of the error's own curve up to the order of this one make products.
    pub basis: Basis,
}

/// A frame, a point or a length of a set-up: known, or to be found from this start.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity<T> {
    /// The name in answers: `tracker.csv:frame`.
    pub name: String,
    /// The value, or the start of the search; `None`: a start is made from the observations.
    pub value: Option<T>,
    /// Whether it is to be found.
    pub unknown: bool,
    /// The order of its drift over the rows.
    pub drift: usize,
    /// Standard uncertainty of the value, in its unit, where it is found beside what a calibration says of it.
    pub known_within: Option<f64>,
}

impl<T> Quantity<T> {
    /// A part of a set-up that is known, or to be found where it has no value.
    pub fn new(name: String, value: Option<T>, drift: usize) -> Self {
        Self {
            name,
            unknown: value.is_none(),
            value,
            drift,
            known_within: None,
        }
    }
}

/// What the set-ups of all observations consist of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetUp {
    /// Frames of trackers: x, y, z in mm and a, b, c in deg, in workpiece axes.
    pub frames: Vec<Quantity<[f64; 6]>>,
    /// Points in mm: targets on tools, centres of spheres, points on the table.
    pub points: Vec<Quantity<[f64; 3]>>,
    /// Dead lengths, offsets and distances of balls in mm, slopes and tilts in mm/mm.
    pub numbers: Vec<Quantity<f64>>,
    /// What each of the numbers is, for its unit in answers.
    pub number_kinds: Vec<NumberKind>,
}

impl SetUp {
    /// Adds a point and gives its place.
    pub(crate) fn add_point(&mut self, point: Quantity<[f64; 3]>) -> usize {
        self.points.push(point);
        self.points.len() - 1
    }

    /// Adds a number and gives its place.
    pub fn add_number(&mut self, kind: NumberKind, number: Quantity<f64>) -> usize {
        self.number_kinds.push(kind);
        self.numbers.push(number);
        self.numbers.len() - 1
    }
}

/// What a number of a set-up is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberKind {
    /// A dead length, mm in files and answers.
    DeadLength,
    /// The offset of a line, µm in files and answers.
    Offset,
    /// The slope of a line, µm/m in files and answers.
    Slope,
    /// The tilt of a row of balls to a side, µrad in answers.
    Tilt,
    /// The distance of a ball along its row, mm in files and answers.
    Distance,
}

impl NumberKind {
    /// The unit in keys and answers, and its number for one mm or mm/mm.
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
    /// The name of the row file, as the file of observations states it.
    pub file: String,
    /// What was observed.
    pub kind: Kind,
    /// Whether the rows are only predicted.
    pub judge: bool,
    /// The rows.
    pub rows: Vec<Row>,
}

/// The kinds of observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Kind {
    /// Positions of a target on the tool, from a tracker.
    Points,
    /// Where the probe is on the centre of a sphere.
    Sphere,
    /// Distances.
    Distance,
    /// Displacements along a line of sight.
    Line,
    /// Where the tip is against the balls of a row.
    BallRow,
}

impl Kind {
    /// The word in files and answers.
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

/// One pose of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stand {
    /// Coordinates (mm, rad) and directions of approach.
    pub state: State,
    /// The functional point, mm in MCS at machine zero, without the offset of a target.
    pub tip_mm: Vector3<f64>,
}

impl Stand {
    /// The functional point of the ideal machine, mm in workpiece axes.
    pub(crate) fn ideal_tip_mm(&self, chain: &Chain) -> Vector3<f64> {
        let pose = chain.ideal_pose(&self.state);
        pose.transform_point(&self.tip_mm) - chain.workpiece_origin_mm()
    }
}

/// One row: a pose and what was seen there.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The line in its file, from 1; 0 where it is of none.
    pub line: usize,
    /// Where the machine stood.
    pub stand: Stand,
    /// What was seen.
    pub seen: Seen,
    /// Which run of the machine it is of: in one run every axis comes from where it was in the row before, and to the first rows
    /// from a side that is not known. `None` where an axis without a direction has the mean of both, as in means of readings in both.
    pub run: Option<usize>,
    /// Place in time between −1 (first row) and 1 (last row), for the drift.
    pub time: f64,
    /// Standard uncertainty of each number, mm.
    pub uncertainty_mm: f64,
}

impl Row {
    /// Its poses: two of a length between poses.
    pub(crate) fn stands(&self) -> impl Iterator<Item = &Stand> {
        let from = match &self.seen {
            Seen::Pair { from, .. } => Some(from),
            _ => None,
        };
        core::iter::once(&self.stand).chain(from)
    }
}

/// What was seen at a pose; numbers `frame`, `target` and so on are places in [`SetUp`].
#[derive(Clone, Debug, PartialEq)]
pub enum Seen {
    /// The target on the tool, mm in the frame of the tracker.
    Point {
        /// Which frame.
        frame: usize,
        /// The point of the target's offset, mm in tool axes at machine zero, if it is not the tip.
        target: Option<usize>,
        /// The reading.
        at_mm: Vector3<f64>,
    },
    /// The tip is at a sphere's centre, but for an offset in workpiece axes.
    Sphere {
        /// The point of the centre.
        centre: usize,
        /// Tip minus centre, mm.
        offset_mm: Vector3<f64>,
    },
    /// The distance of the tip from a point.
    Distance {
        /// The point.
        point: usize,
        /// The dead length, which is added to the reading.
        dead: usize,
        /// The reading.
        length_mm: f64,
    },
    /// The distance of the tip from where it is at another pose.
    Pair {
        /// The other pose.
        from: Stand,
        /// The dead length, which is added to the reading.
        dead: usize,
        /// The reading.
        length_mm: f64,
    },
    /// The displacement along a line of sight.
    Line {
        /// Unit direction in workpiece axes.
        direction: Vector3<f64>,
        /// The number that is added to every reading.
        offset: usize,
        /// The number that is multiplied by the place along the line.
        slope: usize,
        /// The reading, mm.
        deviation_mm: f64,
    },
    /// The tip against a ball of a row.
    Ball {
        /// The point at which the distance along the row is zero.
        origin: usize,
        /// The numbers of the tilts to side 1 and side 2.
        tilts: [usize; 2],
        /// The number of the ball's distance.
        distance: usize,
        /// Unit directions in workpiece axes as columns: along the row as it is laid, to side 1, to side 2.
        axes: Matrix3<f64>,
        /// Tip minus ball along and to the sides, mm, as far as read.
        offset_mm: [Option<f64>; 3],
    },
}

impl Seen {
    /// How many numbers were read.
    pub(crate) fn count(&self) -> usize {
        match self {
            Self::Point { .. } | Self::Sphere { .. } => 3,
            Self::Distance { .. } | Self::Pair { .. } | Self::Line { .. } => 1,
            Self::Ball { offset_mm, .. } => offset_mm.iter().flatten().count(),
        }
    }

    /// The parts of the set-up that it depends on.
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
            Self::Ball {
                origin,
                tilts: [first, second],
                distance,
                ..
            } => vec![
                Part::Point(origin),
                Part::Number(first),
                Part::Number(second),
                Part::Number(distance),
            ],
        }
    }

    /// Gives a reading whose direction is a matter of the instrument the opposite sign; places and lengths have none.
    pub(crate) fn turn(&mut self) {
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

/// A Fourier series runs through gaps up to a third of a turn.
const WIDEST_GAP_DEG: f64 = 120.0;

impl Observations {
    /// No observations yet, of a machine that they will be of.
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

    /// The files that are fitted, each with the places of its rows among all that are fitted.
    pub(crate) fn fitted(&self) -> impl Iterator<Item = (&Observation, Range<usize>)> {
        let fitted = self.observations.iter().filter(|o| !o.judge);
        fitted.scan(0, |first, observation| {
            let own = *first..*first + observation.rows.len();
            *first = own.end;
            Some((observation, own))
        })
    }

    /// The rows that are fitted.
    pub(crate) fn fitted_rows(&self) -> impl Iterator<Item = &Row> {
        self.fitted().flat_map(|(observation, _)| &observation.rows)
    }

    /// The coordinates of an axis at all poses that are fitted, mm or deg.
    fn coordinates(&self, axis: usize) -> impl Iterator<Item = f64> {
        let poses = self.fitted_rows().flat_map(Row::stands);
        poses.map(move |stand| self.machine.curve_coordinates(&stand.state)[axis])
    }

    /// The widest part of a turn, deg, in which no row that is fitted has a rotary axis.
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

    /// Messages on Fourier series over a part of a turn.
    pub(crate) fn guessed_turns(&self) -> Vec<String> {
        let series = (self.unknown.iter())
            .filter(|unknown| matches!(unknown.basis, Some(Basis::Fourier { .. })));
        let gaps = series.filter_map(|unknown| {
            let axis = self.machine.index_of(unknown.error.axis).ok()?;
            let gap = self.widest_gap_deg(axis);
            (gap > WIDEST_GAP_DEG).then(|| {
                let goes_round = self.machine.axes()[axis].modulo.is_some();
                // An axis with a `modulo` needs a curve that closes.
                let what_to_do = if goes_round {
                    "observe it all the way round, or take fewer harmonics"
                } else {
                    "legendre suits a part of a turn"
                };
                format!(
                    "{}: {} was observed nowhere over {gap:.0} deg of a turn: the Fourier series is only guessed there, and its coefficients may be large; {what_to_do}",
                    unknown.error, unknown.error.axis
                )
            })
        });
        gaps.collect()
    }

    /// The range of an axis in the rows that are fitted, mm or deg; its travel where the axis stood still, and for a Fourier
    /// series where the places go round, or the axis does: only a whole series closes there.
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
        // A range of a millionth of the travel is an axis that stood still.
        if range[1] - range[0] > 1e-6 * (travel[1] - travel[0]) {
            // The ideal machine would stand a little beside where the real one found the sphere or the ball.
            let is_probed = |row: &Row| matches!(row.seen, Seen::Sphere { .. } | Seen::Ball { .. });
            let margin = if self.fitted_rows().any(is_probed) {
                SPHERE_MARGIN
            } else {
                0.0
            };
            let wider = margin * (range[1] - range[0]);
            [range[0] - wider, range[1] + wider]
        } else {
            travel
        }
    }
}

/// A frame, a point or a number of a set-up, by its place among those of its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// Six numbers: small displacements along the axes (mm), then rotations about them (rad).
    Frame(usize),
    /// Three coordinates, mm.
    Point(usize),
    /// One number, mm or mm/mm.
    Number(usize),
}
