//! Trace of a circle in its plane as plain data, and the conversion of positions to a trace.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use super::LARGEST_RADIUS_MM;
use crate::MetrologyError;

/// The plane of a circle; angles run from the first axis to the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum CircularPlane {
    /// The XY plane; angles run from X to Y.
    #[default]
    Xy,
    /// The YZ plane; angles run from Y to Z.
    Yz,
    /// The ZX plane; angles run from Z to X.
    Zx,
}

impl CircularPlane {
    /// The two axes of the plane. Angles run from the first to the second.
    pub fn axes(self) -> [AxisName; 2] {
        match self {
            Self::Xy => [AxisName::X, AxisName::Y],
            Self::Yz => [AxisName::Y, AxisName::Z],
            Self::Zx => [AxisName::Z, AxisName::X],
        }
    }

    /// Squareness error of the plane. [`opening`](crate::opening) returns whether a positive value opens or closes the
    /// angle between the axes.
    pub fn squareness(self) -> ErrorName {
        let (component, axis) = match self {
            Self::Xy => (Component::EC, AxisName::Y),
            Self::Yz => (Component::EA, AxisName::Z),
            Self::Zx => (Component::EB, AxisName::Z),
        };
        ErrorName::location(component, axis)
    }
}

/// Sense of the motion on the circle, seen with the first axis to the right and the second axis up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Sense {
    /// Motion from the first axis to the second, so the angle increases.
    CounterClockwise,
    /// Motion from the second axis to the first, so the angle decreases.
    Clockwise,
}

impl Sense {
    /// Both senses, counter-clockwise first.
    pub const BOTH: [Self; 2] = [Self::CounterClockwise, Self::Clockwise];

    /// Sign of the change of the angle: +1 if the angle increases, −1 if it decreases.
    pub fn sign(self) -> f64 {
        match self {
            Self::CounterClockwise => 1.0,
            Self::Clockwise => -1.0,
        }
    }

    /// Key in documents: `ccw` or `cw`.
    pub fn key(self) -> &'static str {
        match self {
            Self::CounterClockwise => "ccw",
            Self::Clockwise => "cw",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TracePoint {
    /// Angle from the first axis to the second, rad.
    pub angle_rad: f64,
    /// Actual minus nominal radius, µm.
    pub deviation_um: f64,
    pub sense: Sense,
}

/// Trace of a circle in one or both senses.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CircularTrace {
    /// Name of the source file, for messages.
    pub name: String,
    /// Nominal radius, mm.
    pub radius_mm: f64,
    /// Whether the radius was stated. If not, it is the mean radius of the points, and a deviation from the nominal
    /// radius is unknown.
    pub radius_is_stated: bool,
    /// Points in the order of the file.
    pub points: Vec<TracePoint>,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

impl CircularTrace {
    /// Whether the trace has a point in this sense.
    pub fn has(&self, sense: Sense) -> bool {
        self.points.iter().any(|p| p.sense == sense)
    }

    pub(super) fn of(&self, sense: Sense) -> Vec<TracePoint> {
        let here = self.points.iter().filter(|p| p.sense == sense);
        here.copied().collect()
    }
}

/// Centre and radius of the least-squares circle through points in a plane. Gauss–Newton iteration on the distances,
/// from the algebraic circle.
pub(super) fn least_squares_circle(
    points_mm: &[[f64; 2]],
    name: &str,
) -> Result<([f64; 2], f64), MetrologyError> {
    const STEPS: usize = 50;
    let refuse =
        |found: &str| MetrologyError::readings(name, "points", found, "points on a circle");
    let count = points_mm.len() as f64;
    let mean = |k: usize| points_mm.iter().map(|p| p[k]).sum::<f64>() / count;
    let middle = [mean(0), mean(1)];
    // Solve u² + v² = 2 a u + 2 b v + c, with coordinates u and v relative to the mean.
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points_mm {
        let (u, v) = (p[0] - middle[0], p[1] - middle[1]);
        let row = Vector3::new(2.0 * u, 2.0 * v, 1.0);
        normal += row * row.transpose();
        right += row * (u * u + v * v);
    }
    let start = normal.lu().solve(&right);
    let start = start.filter(|s| s.iter().all(|x| x.is_finite()));
    let start = start.ok_or_else(|| refuse("points on one line"))?;
    let squared = start[2] + start[0] * start[0] + start[1] * start[1];
    let mut centre = [start[0], start[1]];
    let mut radius = squared.max(0.0).sqrt();
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for p in points_mm {
            let (u, v) = (p[0] - middle[0] - centre[0], p[1] - middle[1] - centre[1]);
            let distance = u.hypot(v);
            if distance == 0.0 {
                return Err(refuse("a point at the centre"));
            }
            let row = Vector3::new(u / distance, v / distance, 1.0);
            normal += row * row.transpose();
            right += row * (distance - radius);
        }
        let step = normal.lu().solve(&right);
        let step = step.filter(|s| s.iter().all(|x| x.is_finite()));
        let step = step.ok_or_else(|| refuse("points on one line"))?;
        centre = [centre[0] + step[0], centre[1] + step[1]];
        radius += step[2];
        if step.norm() <= 1e-12 * radius.abs() {
            break;
        }
    }
    if !(radius.is_finite() && radius > 0.0 && radius <= LARGEST_RADIUS_MM) {
        return Err(refuse(&format!("a circle of {radius} mm")));
    }
    Ok(([middle[0] + centre[0], middle[1] + centre[1]], radius))
}

/// Minimum turn that counts as motion, 1°. It is far more than the jitter of a position at standstill, and far less
/// than the arc of a test.
const LEAST_TURN_RAD: f64 = std::f64::consts::PI / 180.0;

/// Sense at each point of a path, from the change of the angle after the point. At standstill the previous sense is
/// kept.
///
/// Only a turn of more than `LEAST_TURN_RAD` counts, because positions at standstill jitter.
pub(super) fn senses(angles_rad: &[f64]) -> Vec<Sense> {
    let mut found = vec![Sense::CounterClockwise; angles_rad.len()];
    let mut angle = 0.0;
    // Index and angle of the smallest and of the largest angle since the last change of sense. Of equal angles, the
    // last point counts.
    let (mut least, mut greatest) = ((0, 0.0), (0, 0.0));
    let mut last: Option<Sense> = None;
    for (index, pair) in angles_rad.windows(2).enumerate() {
        angle += turn(pair);
        let here = (index + 1, angle);
        if angle <= least.1 {
            least = here;
        }
        if angle >= greatest.1 {
            greatest = here;
        }
        let turned = if last != Some(Sense::CounterClockwise) && angle - least.1 > LEAST_TURN_RAD {
            Some((Sense::CounterClockwise, least))
        } else if last != Some(Sense::Clockwise) && greatest.1 - angle > LEAST_TURN_RAD {
            Some((Sense::Clockwise, greatest))
        } else {
            None
        };
        if let Some((sense, from)) = turned {
            // Points before the first turn are at standstill, and get the sense of that turn.
            let from = if last.is_none() { 0 } else { from.0 };
            found[from..].fill(sense);
            (least, greatest) = (here, here);
            last = Some(sense);
        }
    }
    found
}

pub(super) struct OneTurn {
    pub(super) keeps: Vec<bool>,
    pub(super) notes: Vec<String>,
}

/// Selects one turn of each sense, because a part of the circle that is measured twice would count twice in the
/// least-squares circle.
///
/// - If a run is longer than a turn, its middle is kept, because its ends contain starting and stopping.
/// - If some of several runs are whole turns, the longest run is kept.
/// - Overlapping arcs are all kept, with a note. Points are also kept if their angles do not progress in their sense,
///   because then they have no order.
pub(super) fn one_turn(angles_rad: &[f64], senses: &[Sense]) -> OneTurn {
    let mut found = OneTurn { keeps: vec![true; angles_rad.len()], notes: Vec::new() };
    for sense in Sense::BOTH {
        let Some(runs) = runs(angles_rad, senses, sense) else {
            continue;
        };
        let turned: f64 = runs.iter().map(Run::turned).sum();
        let longest = runs.iter().rev().max_by(|a, b| a.turned().total_cmp(&b.turned()));
        let Some(longest) = longest.filter(|_| turned > TAU + LEAST_TURN_RAD) else {
            continue;
        };
        if !longest.is_whole_turn() {
            found.notes.push(format!(
                "{}: arcs of together {:.0}° overlap; what was run twice is evaluated twice",
                sense.key(),
                turned.to_degrees(),
            ));
            continue;
        }
        let from = (0.5 * (longest.turned() - TAU)).max(0.0) - 1e-9;
        for run in &runs {
            for (index, angle) in run.angles.iter().enumerate() {
                // The interval is half-open, because the point that closes the turn repeats the first point.
                let is_inside = (from..from + TAU).contains(angle);
                found.keeps[run.first + index] = run.first == longest.first && is_inside;
            }
        }
        found.notes.push(format!(
            "{}: {:.0}° were run; one turn is evaluated, and {:.0}° are left out",
            sense.key(),
            turned.to_degrees(),
            (turned - longest.turned().min(TAU)).to_degrees(),
        ));
    }
    found
}

/// Consecutive points in one sense of motion.
struct Run {
    /// Index of the first point.
    first: usize,
    /// Angle of each point from the first point in the sense of motion, rad. It may exceed one turn.
    angles: Vec<f64>,
}

impl Run {
    fn turned(&self) -> f64 {
        self.angles.last().copied().unwrap_or(0.0)
    }

    /// Whether the run is a whole turn, which means that one more step after the last point would close it.
    fn is_whole_turn(&self) -> bool {
        let steps = self.angles.windows(2).map(|pair| pair[1] - pair[0]);
        self.turned() + steps.fold(LEAST_TURN_RAD, f64::max) >= TAU
    }
}

/// The runs in one sense of motion; `None` if the angle goes back by more than `LEAST_TURN_RAD` within a run.
fn runs(angles_rad: &[f64], senses: &[Sense], sense: Sense) -> Option<Vec<Run>> {
    let mut runs: Vec<Run> = Vec::new();
    for (index, here) in senses.iter().enumerate() {
        if *here != sense {
            continue;
        }
        match runs.last_mut() {
            Some(run) if run.first + run.angles.len() == index => {
                let way = sense.sign() * turn(&angles_rad[index - 1..=index]);
                if way < -LEAST_TURN_RAD {
                    return None;
                }
                run.angles.push(run.turned() + way);
            }
            _ => runs.push(Run { first: index, angles: vec![0.0] }),
        }
    }
    Some(runs)
}

/// Second angle minus first angle, in the shorter direction, rad.
fn turn(pair: &[f64]) -> f64 {
    let turn = (pair[1] - pair[0]).rem_euclid(std::f64::consts::TAU);
    if turn > std::f64::consts::PI { turn - std::f64::consts::TAU } else { turn }
}
