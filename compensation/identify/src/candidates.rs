//! Poses that could be measured next: those that the instruments of the files can take and have not taken yet.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_vocabulary::{AxisKind, Displacement};

use crate::{
    design::bring,
    observations::{Kind, Observation, Observations, Row, Seen},
    system::System,
    values::Values,
};

/// How many poses are looked at, of all files together.
const CANDIDATES: usize = 200;
/// Many draws are out of reach, most of them at a machine with short travels.
const TRIES: usize = 10;
/// Coordinates of linear axes are rounded to this, so that a person can type them, mm.
const STEP_MM: f64 = 1e-3;
/// Coordinates that differ by less are those of one pose, mm and rad.
const SAME_BELOW: f64 = 2.0 * STEP_MM;

/// A pose that could be measured, as a row like those of a file.
pub(crate) struct Candidate {
    pub(crate) row: Row,
    pub(crate) file: String,
    pub(crate) kind: Kind,
}

/// Candidates of every file that is fitted, drawn with a fixed seed.
pub(crate) fn candidates(
    system: &System,
    observations: &Observations,
    values: &Values,
) -> Vec<Candidate> {
    let files = observations.fitted().count().max(1);
    let each = CANDIDATES.div_ceil(files);
    let mut random = ChaCha8Rng::seed_from_u64(0x6e65_7874);
    let mut candidates = Vec::new();
    for (observation, _) in observations.fitted() {
        let drawn =
            (0..TRIES * each).filter_map(|_| drawn(system, observation, values, &mut random));
        candidates.extend(drawn.take(each).map(|row| Candidate {
            row,
            file: observation.file.clone(),
            kind: observation.kind,
        }));
    }
    candidates
}

/// A row like one of a file at another pose.
///
/// A target is seen from its tracker wherever the machine stands within its travel. A sphere and a ball stay where they are:
/// the tip stands at the same point of the workpiece, with other coordinates of the rotary axes. The tip at the end of a ballbar
/// or before a tracer stands at a distance from the point and in a direction that lie between those of two rows. A line of sight
/// stays, too: the machine stands between two of its places. A step gauge has faces only where it was read. `None`
/// where the axes do not get there, or where the machine stood already.
fn drawn(
    system: &System,
    observation: &Observation,
    values: &Values,
    random: &mut impl Rng,
) -> Option<Row> {
    let rows = &observation.rows;
    if rows.is_empty() {
        return None;
    }
    let mut of_rows = || &rows[random.random_range(0..rows.len())];
    let (mut row, other) = (of_rows().clone(), of_rows());
    // In tenths: places that a person can type.
    let share = f64::from(random.random_range(0..=10_u8)) / 10.0;
    let chain = system.machine.chain();
    let tip = row.stand.ideal_tip_mm(chain);
    match row.seen {
        Seen::Pair { .. } => return None,
        Seen::Line { .. } => {
            let there = other.stand.state.q;
            for (q, to) in row.stand.state.q.iter_mut().zip(there) {
                *q += share * (to - *q);
            }
        }
        Seen::Point { .. } => move_axes(system, &mut row, |_| true, random),
        Seen::Sphere { .. } | Seen::Ball { .. } => {
            move_axes(system, &mut row, |kind| kind == AxisKind::Rotary, random);
            if !bring(system, &mut row.stand, tip) {
                return None;
            }
        }
        Seen::Distance { point, .. } => {
            let point = values.points[point][0];
            let to = between(tip - point, other.stand.ideal_tip_mm(chain) - point, share)?;
            move_axes(system, &mut row, |kind| kind == AxisKind::Rotary, random);
            if !bring(system, &mut row.stand, point + to) {
                return None;
            }
        }
    }
    for (axis, q) in system.machine.axes().iter().zip(&mut row.stand.state.q) {
        if axis.name.kind() == AxisKind::Linear {
            *q = (*q / STEP_MM).round() * STEP_MM;
        }
        let at = Displacement::new(axis.name.kind(), *q).mm_or_deg();
        if !axis.may_stand_at(at) {
            return None;
        }
    }
    let is_new = |known: &Row| {
        let places = known.stand.state.q.iter().zip(&row.stand.state.q);
        let moved = system
            .machine
            .axes()
            .iter()
            .zip(places)
            .any(|(axis, (a, b))| {
                // Whole turns of an axis that goes round are no other pose.
                let turn = axis.modulo.map(f64::to_radians);
                let turns = turn.map_or(0.0, |turn| turn * ((a - b) / turn).round());
                (a - b - turns).abs() > SAME_BELOW
            });
        moved || known.stand.tip_mm != row.stand.tip_mm
    };
    rows.iter().all(is_new).then_some(row)
}

/// Draws whole mm and deg within the travel of every axis of these kinds.
fn move_axes(
    system: &System,
    row: &mut Row,
    moves: impl Fn(AxisKind) -> bool,
    random: &mut impl Rng,
) {
    for (axis, q) in system.machine.axes().iter().zip(&mut row.stand.state.q) {
        let kind = axis.name.kind();
        if moves(kind) {
            let [low, high] = axis.travel;
            let at = (low + (high - low) * random.random::<f64>()).round();
            *q = Displacement::from_coordinate(kind, at.max(low).min(high)).mm_or_rad();
        }
    }
}

/// A vector whose length and direction lie between those of two others; `None` where one has none, or they lie opposite.
fn between(from: Vector3<f64>, to: Vector3<f64>, share: f64) -> Option<Vector3<f64>> {
    let unit = |vector: Vector3<f64>| vector.try_normalize(STEP_MM);
    let direction = unit(from)? * (1.0 - share) + unit(to)? * share;
    let length = from.norm() + share * (to.norm() - from.norm());
    Some(direction.try_normalize(STEP_MM)? * length)
}
