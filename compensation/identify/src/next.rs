//! Proposes the next pose to measure. Candidates are random poses that the instruments of the files can measure and
//! have not yet measured; the pose that most reduces the largest uncertainty is selected.

use std::collections::BTreeMap;

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{
    State,
    nalgebra::{DMatrix, DVector, Vector3},
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::{
    equation::Equations,
    fit::{Fitted, bring},
    observations::{Kind, MachinePose, Observation, Observations, Row, RowReading},
    params::Values,
    system::{Rows, System},
};

/// A pose to be measured next.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Next {
    /// Coordinates of every axis, mm or deg.
    pub pose: BTreeMap<AxisName, f64>,
    /// File whose set-up is to be used.
    pub file: String,
    /// What the instrument is to measure at the pose.
    pub kind: Kind,
    /// Sphere, ball or target at this pose; `None` if there is no choice.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub target: Option<String>,
    /// Tool in the spindle; `None` for that of `[tool]`.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub tool: Option<String>,
    /// Unknown for which the pose was selected: an undetermined unknown if a candidate pose informs about one, else the
    /// error coefficient whose effect on the tip in the workspace has the largest uncertainty.
    pub parameter: String,
    /// Factor by which the pose reduces the standard uncertainty of `parameter`, at least 1; `None` if `parameter` is
    /// not determined yet.
    pub improvement: Option<f64>,
}

/// Selects the most useful pose. If candidates inform about undetermined unknowns, the most informative of these is
/// selected. Otherwise the pose is selected that minimises the largest uncertainty of any error coefficient, weighted
/// by its largest effect on the tip in the workspace.
pub(crate) fn next(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Option<Next> {
    let values = &fitted.solution.values;
    let candidates = candidates(system, observations, values);
    let prepared = system.prepare(candidates.iter().map(|candidate| &candidate.row));
    let ahead = system.plain_equations(&prepared, values, true);
    let left = fitted.rank.left_at_zero();
    let missing: Vec<usize> =
        left.filter(|column| system.is_convention(*column) == Some(false)).collect();
    let of_missing = || {
        let now = system.equations(rows, values).jacobian;
        most_informative(system, &now, &ahead, &missing)
    };
    let found = (!missing.is_empty()).then(of_missing).flatten();
    let (place, parameter, improvement) = match found {
        Some((place, parameter)) => (place, parameter, None),
        None => most_reducing(&largest_effects(system, values), fitted, &ahead)?,
    };
    let Candidate { row, file, kind } = &candidates[place];
    let target = match row.reading {
        RowReading::Sphere { centre, .. } => Some(&system.setup.points[centre].name),
        RowReading::Ball { distance, .. } => Some(&system.setup.numbers[distance].name),
        RowReading::Point { target: Some(target), .. } => Some(&system.setup.points[target].name),
        _ => None,
    };
    let machine = &system.machine;
    let mut tools = machine.tools().keys();
    let is_in_spindle =
        |name: &&String| machine.tip_of(name).is_ok_and(|tip| tip == row.pose.tip_mm);
    let is_of_tool = row.pose.tip_mm == machine.chain().tool_tip_mm();
    let tool = tools.find(is_in_spindle).filter(|_| !is_of_tool);
    let axes = system.machine.axes().iter().zip(&row.pose.state.q);
    Some(Next {
        pose: axes
            .map(|(axis, &q)| {
                let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
                // Rounding removes the error of the conversion to radians and back.
                (axis.name, (at * 1e6).round() / 1e6)
            })
            .collect(),
        file: file.clone(),
        kind: *kind,
        target: target.cloned(),
        tool: tool.cloned(),
        parameter: system.name(parameter),
        improvement,
    })
}

/// Returns the candidate that minimises the largest uncertainty, the parameter with the largest uncertainty
/// now, and the factor by which this uncertainty decreases.
fn most_reducing(
    effects: &DVector<f64>,
    fitted: &Fitted,
    ahead: &Equations,
) -> Option<(usize, usize, Option<f64>)> {
    let kept = &fitted.rank.kept;
    let effect: Vec<f64> = kept.iter().map(|&param| effects[param]).collect();
    let covariance = &fitted.solution.covariance;
    let uncertain = |covariance: &DVector<f64>| {
        let sizes = effect.iter().zip(covariance).map(|(e, v)| e * v.max(0.0).sqrt());
        let sizes = sizes.enumerate();
        sizes.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    let (worst, before) = uncertain(&covariance.diagonal());
    if before <= 0.0 {
        return None;
    }
    let jacobian = ahead.jacobian.select_columns(kept);
    // A new reading has the variance on which the covariance is based.
    let variance = fitted.solution.counted;
    let mut best: Option<(f64, f64, usize)> = None;
    for (place, after) in variances_after(covariance, &jacobian, ahead, variance) {
        let (_, largest) = uncertain(&after);
        let own = effect[worst] * after[worst].max(0.0).sqrt();
        if best.is_none_or(|(least, ..)| largest < least) {
            best = Some((largest, own, place));
        }
    }
    let (_, own, place) = best?;
    // Rounding must not give a factor below 1.
    let improvement = (before / own.max(f64::MIN_POSITIVE)).max(1.0);
    Some((place, kept[worst], Some(improvement)))
}

/// Variances of all unknowns after each candidate, with the index of the candidate; `variance` is the variance of a new
/// reading.
fn variances_after<'a>(
    covariance: &'a DMatrix<f64>,
    jacobian: &'a DMatrix<f64>,
    ahead: &'a Equations,
    variance: f64,
) -> impl Iterator<Item = (usize, DVector<f64>)> + 'a {
    let places = ahead.places.iter().enumerate();
    places.filter_map(move |(place, &(first, size))| {
        let rows = jacobian.rows(first, size);
        let carried = covariance * rows.transpose();
        let inner = rows * &carried + DMatrix::identity(size, size) * variance;
        let gain = &carried * inner.try_inverse()?;
        let after = |k, _| covariance[(k, k)] - gain.row(k).dot(&carried.row(k));
        Some((place, DVector::from_fn(covariance.nrows(), after)))
    })
}

/// Returns the candidate that is most informative about undetermined unknowns, and the unknown about which
/// it informs most. Unknowns get a prior of the size of errors and set-ups, so that all of them
/// have a covariance.
fn most_informative(
    system: &System,
    now: &DMatrix<f64>,
    ahead: &Equations,
    missing: &[usize],
) -> Option<(usize, usize)> {
    /// Prior standard uncertainty of errors, mm and rad: larger than those of any machine, so that the prior is
    /// negligible compared with a reading.
    const LARGEST_ERROR: f64 = 1e-1;
    /// Prior standard uncertainty of set-ups, mm and rad: they may be anywhere in a workspace.
    const ANYWHERE: f64 = 1e3;
    /// Minimum reduction factor of the assumed uncertainty for a pose to inform about an unknown.
    /// The factor is near 1 for an unknown that has no effect at the pose, or whose effect equals
    /// that of equally uncertain unknowns.
    const MIN_REDUCTION: f64 = 2.0;
    let sizes = DVector::from_fn(system.params.len(), |column, _| {
        if column < system.params.setup() { ANYWHERE } else { LARGEST_ERROR }
    });
    let scaled = |jacobian: &DMatrix<f64>| {
        let mut scaled = jacobian.clone();
        for (mut column, size) in scaled.column_iter_mut().zip(&sizes) {
            column *= *size;
        }
        scaled
    };
    let now = scaled(now);
    let count = sizes.len();
    let information = now.transpose() * &now + DMatrix::identity(count, count);
    let covariance = information.cholesky()?.inverse();
    let jacobian = scaled(&ahead.jacobian);
    let mut best: Option<(f64, usize, usize)> = None;
    for (place, after) in variances_after(&covariance, &jacobian, ahead, 1.0) {
        // Factor by which the variance of each unknown decreases.
        let times = missing.iter().map(|&column| {
            let before = covariance[(column, column)];
            (before / after[column].max(f64::MIN_POSITIVE), column)
        });
        let gains: Vec<(f64, usize)> = times.collect();
        let sum: f64 = gains.iter().map(|(times, _)| times.ln()).sum();
        let Some(&(times, most)) = gains.iter().max_by(|a, b| a.0.total_cmp(&b.0)) else {
            continue;
        };
        if times > MIN_REDUCTION * MIN_REDUCTION && best.is_none_or(|(largest, ..)| sum > largest) {
            best = Some((sum, place, most));
        }
    }
    best.map(|(_, place, most)| (place, most))
}

const CANDIDATES: usize = 200;
/// Maximum number of draws per candidate: many poses are out of reach, especially on a machine with
/// short travels.
const TRIES: usize = 10;
/// Resolution of linear coordinates, mm, so that they can be typed by hand.
const STEP_MM: f64 = 1e-3;
/// Coordinates that differ by less are treated as equal, mm and rad.
const SAME_BELOW: f64 = 2.0 * STEP_MM;

/// A pose that could be measured, as a row of the same kind as the rows of a file.
pub(crate) struct Candidate {
    pub(crate) row: Row,
    pub(crate) file: String,
    pub(crate) kind: Kind,
}

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

/// Draws a random row at another pose, of the same kind as the rows of a file.
///
/// A target is assumed visible to its tracker anywhere within the travel. Spheres and balls are stationary: the tip is
/// at the same point of the workpiece, with other rotary coordinates. For a ballbar or tracer, distance and direction
/// are between those of two rows. A line of sight is stationary too: the pose is between two of its poses. A step gauge
/// has no faces except those already measured. `None` if the axes cannot reach the pose, or if it was measured already.
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
    // In tenths, so that coordinates can be typed by hand.
    let share = f64::from(random.random_range(0..=10_u8)) / 10.0;
    let chain = system.machine.chain();
    let tip = row.pose.ideal_tip_mm(chain);
    match row.reading {
        RowReading::Pair { .. } => return None,
        RowReading::Line { .. } => {
            let other_q = other.pose.state.q;
            for (q, to) in row.pose.state.q.iter_mut().zip(other_q) {
                *q += share * (to - *q);
            }
        }
        RowReading::Point { .. } => move_axes(system, &mut row, |_| true, random),
        RowReading::Sphere { .. } | RowReading::Ball { .. } => {
            move_axes(system, &mut row, |kind| kind == AxisKind::Rotary, random);
            if !bring(system, &mut row.pose, tip) {
                return None;
            }
        }
        RowReading::Distance { point, .. } => {
            let point = values.points[point][0];
            let to = between(tip - point, other.pose.ideal_tip_mm(chain) - point, share)?;
            move_axes(system, &mut row, |kind| kind == AxisKind::Rotary, random);
            if !bring(system, &mut row.pose, point + to) {
                return None;
            }
        }
    }
    for (axis, q) in system.machine.axes().iter().zip(&mut row.pose.state.q) {
        if axis.name.kind() == AxisKind::Linear {
            *q = (*q / STEP_MM).round() * STEP_MM;
        }
        let at = Displacement::new(axis.name.kind(), *q).mm_or_deg();
        if !axis.may_stand_at(at) {
            return None;
        }
    }
    let is_new = |known: &Row| {
        let places = known.pose.state.q.iter().zip(&row.pose.state.q);
        let moved = system.machine.axes().iter().zip(places).any(|(axis, (a, b))| {
            // Coordinates that differ by whole turns of a periodic axis are the same pose.
            let turn = axis.modulo.map(f64::to_radians);
            let turns = turn.map_or(0.0, |turn| turn * ((a - b) / turn).round());
            (a - b - turns).abs() > SAME_BELOW
        });
        moved || known.pose.tip_mm != row.pose.tip_mm
    };
    rows.iter().all(is_new).then_some(row)
}

fn move_axes(
    system: &System,
    row: &mut Row,
    moves: impl Fn(AxisKind) -> bool,
    random: &mut impl Rng,
) {
    for (axis, q) in system.machine.axes().iter().zip(&mut row.pose.state.q) {
        let kind = axis.name.kind();
        if moves(kind) {
            let [low, high] = axis.travel;
            let at = (low + (high - low) * random.random::<f64>()).round();
            *q = Displacement::from_coordinate(kind, at.max(low).min(high)).mm_or_rad();
        }
    }
}

/// Vector with a length and direction between those of `from` (`share` 0) and `to` (`share` 1); `None` if one of the
/// two vectors is zero or they are opposite.
fn between(from: Vector3<f64>, to: Vector3<f64>, share: f64) -> Option<Vector3<f64>> {
    let unit = |vector: Vector3<f64>| vector.try_normalize(STEP_MM);
    let direction = unit(from)? * (1.0 - share) + unit(to)? * share;
    let length = from.norm() + share * (to.norm() - from.norm());
    Some(direction.try_normalize(STEP_MM)? * length)
}

/// Positions at which effects are evaluated, as fractions of the travel of a linear axis.
const LINEAR: [f64; 3] = [0.0, 0.5, 1.0];
/// Positions of a rotary axis, as fractions of its travel or of one turn if it covers one. The
/// spacing is uneven, so that no harmonic of a Fourier series is zero at all of them.
const ROTARY: [f64; 4] = [0.0, 0.27, 0.53, 0.81];

/// Largest tip displacement, mm, per unit (mm or rad) of every parameter, over a grid of the travels; 0 for set-ups.
pub(crate) fn largest_effects(system: &System, values: &Values) -> DVector<f64> {
    let machine = &system.machine;
    let mut states = vec![State::default()];
    for (place, axis) in machine.axes().iter().enumerate() {
        let [low, high] = axis.all_poses();
        let shares: &[f64] = match axis.name.kind() {
            AxisKind::Linear => &LINEAR,
            AxisKind::Rotary => &ROTARY,
        };
        let at = |share: &f64| {
            let at = low + share * (high - low);
            Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad()
        };
        let with = |state: &State| {
            let mut states = vec![*state; shares.len()];
            for (state, share) in states.iter_mut().zip(shares) {
                state.q[place] = at(share);
            }
            states
        };
        states = states.iter().flat_map(with).collect();
    }
    let mut tips = vec![machine.chain().tool_tip_mm()];
    tips.extend(machine.tools().keys().filter_map(|name| machine.tip_of(name).ok()));
    let poses = states.iter().flat_map(|state| tips.iter().map(move |tip_mm| (*state, *tip_mm)));
    let rows: Vec<Row> = poses
        .map(|(state, tip_mm)| Row {
            line: 0,
            pose: MachinePose { state, tip_mm },
            // The reading is a placeholder: only the effects at the pose are used.
            reading: RowReading::Line {
                direction: Vector3::x(),
                offset: 0,
                slope: 0,
                deviation_mm: 0.0,
            },
            run: None,
            time: 0.0,
            uncertainty_mm: 1.0,
        })
        .collect();
    let mut largest = DVector::zeros(system.params.len());
    for row in &system.prepare(rows.iter()).0 {
        for (coefficient, moved) in system.moved_by(&row.pose, values) {
            let size: &mut f64 = &mut largest[system.params.setup() + coefficient];
            *size = size.max(moved.norm());
        }
    }
    largest
}
