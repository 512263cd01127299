//! Circular tests by ISO 230-4: the deviations of a ballbar trace or of positions, and the machine errors that they
//! indicate.
//!
//! A trace has the radial deviation over the angle of a circle in the plane of two linear axes. The centre of the
//! least-squares circle is removed, because it depends on the set-up of the ballbar or the circle instead of the
//! machine.

mod signatures;

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use volcomp_document::{Column, CsvTable, quoted};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::text::{Place, decode, range, refuse_empty};
use crate::unit::{heads, one_column, unit_of, with_unit};
use crate::{MetrologyError, ReadingUnit, StandardQuantity};

pub use signatures::{Signature, SignatureKind, Signatures, circular_signatures};

/// Maximum radius of a circular test, mm.
pub const LARGEST_RADIUS_MM: f64 = 100_000.0;

/// The plane of a circle; angles run from the first axis to the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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

#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TracePoint {
    /// Angle from the first axis to the second, rad.
    pub angle_rad: f64,
    /// Actual minus nominal radius, µm.
    pub deviation_um: f64,
    pub sense: Sense,
}

/// Trace of a circle in one or both senses.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
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
fn least_squares_circle(
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
fn one_turn(angles_rad: &[f64], senses: &[Sense]) -> OneTurn {
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

/// Deviations of a circular test, µm. Each circle is fitted by least squares, to first order in deviation/radius.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct CircularDeviations {
    /// Circular deviation G of each sense, counter-clockwise first: range of the radii about the centre of the circle
    /// of that sense.
    pub g_um: [Option<f64>; 2],
    /// Bidirectional circular deviation G(b): range of the radii of both senses about the centre of their common
    /// circle.
    pub g_b_um: Option<f64>,
    /// Largest radial deviation F_max of each sense from the nominal radius, about the centre of the circle of that
    /// sense; `None` unless the radius was stated.
    pub f_max_um: [Option<f64>; 2],
    /// Smallest radial deviation F_min of each sense from the nominal radius, about the centre of the circle of that
    /// sense; `None` unless the radius was stated.
    pub f_min_um: [Option<f64>; 2],
    /// Mean bidirectional radial deviation D: radius of the circle through both senses minus the nominal radius.
    pub d_um: Option<f64>,
    /// Centre offset that was removed, along the first and the second axis, µm.
    pub centre_um: [f64; 2],
}

/// Evaluates a trace by ISO 230-4.
///
/// # Errors
/// The points of a sense do not determine a circle, or contain numbers that are not finite.
pub fn circular_deviations(trace: &CircularTrace) -> Result<CircularDeviations, MetrologyError> {
    let mut found = CircularDeviations {
        g_um: [None; 2],
        g_b_um: None,
        f_max_um: [None; 2],
        f_min_um: [None; 2],
        d_um: None,
        centre_um: [0.0; 2],
    };
    let all = circle(&trace.points, &trace.name)?;
    found.centre_um = [all[1], all[2]];
    for (k, sense) in Sense::BOTH.into_iter().enumerate() {
        let points = trace.of(sense);
        if points.is_empty() {
            continue;
        }
        let centred = about(&points, circle(&points, &trace.name)?);
        let [low, high] = range(centred.into_iter());
        found.g_um[k] = Some(high - low);
        if trace.radius_is_stated {
            found.f_max_um[k] = Some(high);
            found.f_min_um[k] = Some(low);
        }
    }
    if found.g_um.iter().all(Option::is_some) {
        let [low, high] = range(about(&trace.points, all).into_iter());
        found.g_b_um = Some(high - low);
        found.d_um = trace.radius_is_stated.then_some(all[0]);
    }
    Ok(found)
}

impl CircularDeviations {
    pub fn quantities(&self) -> Vec<StandardQuantity> {
        let larger = |values: [Option<f64>; 2]| values.into_iter().flatten().reduce(f64::max);
        let smaller = |values: [Option<f64>; 2]| values.into_iter().flatten().reduce(f64::min);
        [
            ("G_ccw", "circular deviation, counter-clockwise", self.g_um[0]),
            ("G_cw", "circular deviation, clockwise", self.g_um[1]),
            ("G_b", "bidirectional circular deviation", self.g_b_um),
            ("F_max", "largest radial deviation", larger(self.f_max_um)),
            ("F_min", "smallest radial deviation", smaller(self.f_min_um)),
            ("D", "mean bidirectional radial deviation", self.d_um),
        ]
        .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, value))
        .to_vec()
    }
}

/// Least-squares circle through the radial deviations δ. Returns the radius deviation r and the centre (a, b) in δ =
/// r + a cos θ + b sin θ, µm.
fn circle(points: &[TracePoint], name: &str) -> Result<Vector3<f64>, MetrologyError> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let (sin, cos) = p.angle_rad.sin_cos();
        let row = Vector3::new(1.0, cos, sin);
        normal += row * row.transpose();
        right += row * p.deviation_um;
    }
    let singular = normal.singular_values();
    let strong = singular.min() > 1e-9 * singular.max();
    let solved = if strong { normal.lu().solve(&right) } else { None };
    solved.filter(|s| s.iter().all(|x| x.is_finite())).ok_or_else(|| {
        MetrologyError::readings(
            name,
            "points",
            "an arc too short for a centre, or numbers that are not finite",
            "points around the circle",
        )
    })
}

/// Radial deviations about the centre of `circle`, µm.
fn about(points: &[TracePoint], circle: Vector3<f64>) -> Vec<f64> {
    let centred = |p: &TracePoint| {
        let (sin, cos) = p.angle_rad.sin_cos();
        p.deviation_um - circle[1] * cos - circle[2] * sin
    };
    points.iter().map(centred).collect()
}

const FEWEST_POINTS: usize = 16;

/// Reads a trace from CSV text. `name` is the name of the file in messages.
///
/// The header has `angle` (deg, or `angle rad`) and one of `deviation`, `radius deviation` and `radial deviation` (µm,
/// or followed by `mm` or `nm`). Or it has the two coordinates of the plane in mm, such as `x` and `y` in X–Y. A column
/// `direction` with `ccw` or `+` and `cw` or `-` states the sense of each point. Without this column the sense follows
/// from the order of the rows. `radius_mm` is the nominal radius. Without a radius, positions are measured against
/// their mean radius.
///
/// # Errors
/// Wrong header, units or cells, a radius that is out of range, fewer than 16 points, positions that are not on a
/// circle, or angles without a radius. Messages name the file, the line, what was found and what was expected.
pub fn parse_trace(
    bytes: &[u8],
    name: &str,
    plane: CircularPlane,
    radius_mm: Option<f64>,
) -> Result<CircularTrace, MetrologyError> {
    if let Some(radius) = radius_mm
        && !(radius > 0.0 && radius <= LARGEST_RADIUS_MM)
    {
        let found = format!("{radius} mm");
        let expected = "above 0 and at most 100000 mm";
        return Err(refuse(name, "nominal radius", found, expected));
    }
    let (text, encoding_note) = decode(bytes, name)?;
    let expected = "the header `angle,deviation` or `x,y`, and a point in each row";
    refuse_empty(&text, name, expected)?;
    let table = CsvTable::parse(name, &text)?;
    let letters = plane.axes().map(|axis| axis.to_string());
    let columns = TraceColumns::of(&table, [&letters[0], &letters[1]])?;
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    let mut pairs = Vec::new();
    let mut stated = Vec::new();
    for row in table.rows() {
        let place = Place::new(name, row.line());
        let pair = match columns.kind {
            Kind::Radial { angle, deviation } => {
                let number = |what: &str, (column, unit): (_, f64)| {
                    Ok::<f64, MetrologyError>(
                        place.number(what, &row.cell(column).decimal_text()?)? * unit,
                    )
                };
                [number("angle", angle)?, number("deviation", deviation)?]
            }
            Kind::Positions([x, y]) => [
                place.number(&letters[0], &row.cell(x).decimal_text()?)?,
                place.number(&letters[1], &row.cell(y).decimal_text()?)?,
            ],
        };
        pairs.push(pair);
        if let Some(column) = columns.direction {
            stated.push(sense_of(place, row.cell(column).text())?);
        }
    }
    if pairs.len() < FEWEST_POINTS {
        let found = pairs.len().to_string();
        return Err(refuse(name, "points", found, "at least 16 around the circle"));
    }
    let is_positions = matches!(columns.kind, Kind::Positions(_));
    let angles = angles(&pairs, is_positions, name)?;
    let senses = if stated.is_empty() {
        notes.push("the sense of the motion is taken from the order of the rows".to_owned());
        senses(&angles)
    } else {
        stated
    };
    let one_turn = one_turn(&angles, &senses);
    notes.extend(one_turn.notes);
    let kept = pairs.into_iter().zip(senses).zip(one_turn.keeps);
    let kept = kept.filter_map(|(point, keeps)| keeps.then_some(point));
    let (mut radial, senses): (Vec<[f64; 2]>, Vec<Sense>) = kept.unzip();
    let mut radius = radius_mm;
    if is_positions {
        let (centre, mean_mm) = least_squares_circle(&radial, name)?;
        let nominal = *radius.get_or_insert(mean_mm);
        for pair in &mut radial {
            let (u, v) = (pair[0] - centre[0], pair[1] - centre[1]);
            *pair = [v.atan2(u), (u.hypot(v) - nominal) * 1e3];
        }
        notes.push(format!(
            "the centre of the points, {:.4}, {:.4} mm, is taken out",
            centre[0], centre[1]
        ));
    }
    let Some(nominal) = radius else {
        let found = "none".to_owned();
        let expected =
            "one, with deviations over angles: squareness and scale are sizes against it";
        return Err(refuse(name, "nominal radius", found, expected));
    };
    // A deviation above a hundredth of the radius (10 µm per mm) must be in another unit.
    if let Some([_, deviation]) = radial.iter().find(|pair| pair[1].abs() > 10.0 * nominal) {
        let found = format!("{deviation} µm at a radius of {nominal} mm");
        let expected = "deviations below a hundredth of the radius";
        return Err(refuse(name, "deviation", found, expected));
    }
    let points = radial.iter().zip(senses);
    Ok(CircularTrace {
        name: name.to_owned(),
        radius_mm: nominal,
        radius_is_stated: radius_mm.is_some(),
        points: points
            .map(|(pair, sense)| TracePoint { angle_rad: pair[0], deviation_um: pair[1], sense })
            .collect(),
        notes,
    })
}

/// Angles of the points, rad. The angles of positions are about the centre of their least-squares circle.
fn angles(pairs: &[[f64; 2]], is_positions: bool, name: &str) -> Result<Vec<f64>, MetrologyError> {
    if !is_positions {
        return Ok(pairs.iter().map(|pair| pair[0]).collect());
    }
    let (centre, _) = least_squares_circle(pairs, name)?;
    let angle = |[x, y]: &[f64; 2]| (y - centre[1]).atan2(x - centre[0]);
    Ok(pairs.iter().map(angle).collect())
}

/// Whether the header of a table is that of a trace in one of the planes. A third coordinate or a target column
/// excludes this.
pub(crate) fn looks_like_circle(text: &str, name: &str) -> bool {
    let Ok(table) = CsvTable::parse(name, text) else {
        return false;
    };
    let planes = [CircularPlane::Xy, CircularPlane::Yz, CircularPlane::Zx];
    let fitting = planes.iter().filter(|plane| {
        let letters = plane.axes().map(|axis| axis.to_string());
        TraceColumns::of(&table, [&letters[0], &letters[1]]).is_ok()
    });
    let has = |name: &str| {
        let mut heads = table.names();
        heads.any(|(_, head)| unit_of(head, name).is_some())
    };
    // Columns of angles match every plane, columns of coordinates only their own plane.
    !has("target") && matches!((fitting.count(), has("angle")), (1, false) | (3, true))
}

fn sense_of(place: Place<'_>, text: &str) -> Result<Sense, MetrologyError> {
    match text.to_ascii_lowercase().as_str() {
        "ccw" | "+" => Ok(Sense::CounterClockwise),
        "cw" | "-" => Ok(Sense::Clockwise),
        _ => Err(place.malformed("direction", quoted(text), "`ccw` or `cw`, `+` or `-`")),
    }
}

fn refuse(name: &str, what: &str, found: String, expected: &str) -> MetrologyError {
    MetrologyError::readings(name, what, found, expected)
}

struct TraceColumns {
    kind: Kind,
    direction: Option<Column>,
}

enum Kind {
    /// Columns of angle and radial deviation, each with the factor from its unit to rad or µm.
    Radial { angle: (Column, f64), deviation: (Column, f64) },
    /// Columns of the two coordinates, mm.
    Positions([Column; 2]),
}

const EXPECTED_COLUMNS: &str = "the columns `angle` and `deviation` (or `radius deviation`, `radial deviation`; not a radius alone), or two of `x`, `y` and `z`";

impl TraceColumns {
    /// Finds the columns. The columns of coordinates have the names of the `axes` of the plane.
    fn of(table: &CsvTable, axes: [&str; 2]) -> Result<Self, MetrologyError> {
        let direction = table.column("direction")?;
        let angle = with_unit(table, "angle")?;
        let deviation = deviation(table)?;
        let positions = [with_unit(table, axes[0])?, with_unit(table, axes[1])?];
        let kind = match (angle, deviation, positions) {
            (Some(_), Some(_), [Some(_), Some(_)]) => {
                let message = "found angles and positions, expected one of them";
                return Err(table.header_error(message).into());
            }
            (Some((angle, angle_unit)), Some((deviation, unit)), _) => Kind::Radial {
                angle: (angle, angle_in_rad(table, angle_unit)?),
                deviation: (deviation, deviation_in_um(table, unit)?),
            },
            (None, None, [Some((x, x_unit)), Some((y, y_unit))]) => {
                for unit in [x_unit, y_unit] {
                    if !unit.is_empty() && !unit.eq_ignore_ascii_case("mm") {
                        let found = quoted(unit);
                        let message = format!("found positions in {found}, expected mm");
                        return Err(table.header_error(message).into());
                    }
                }
                Kind::Positions([x, y])
            }
            _ => {
                let found = heads(table);
                let [a, b] = axes;
                let message =
                    format!("found {found}, expected {EXPECTED_COLUMNS}, here `{a}` and `{b}`");
                return Err(table.header_error(message).into());
            }
        };
        Ok(Self { kind, direction })
    }
}

fn angle_in_rad(table: &CsvTable, unit: &str) -> Result<f64, MetrologyError> {
    if unit.is_empty() {
        return Ok(1.0_f64.to_radians());
    }
    match ReadingUnit::named(unit) {
        Some(ReadingUnit::Deg) => Ok(1.0_f64.to_radians()),
        Some(ReadingUnit::Rad) => Ok(1.0),
        _ => {
            let message = format!("found angles in {}, expected deg or rad", quoted(unit));
            Err(table.header_error(message).into())
        }
    }
}

fn deviation_in_um(table: &CsvTable, unit: &str) -> Result<f64, MetrologyError> {
    if unit.is_empty() {
        return Ok(1.0);
    }
    if let Some(unit @ (ReadingUnit::Mm | ReadingUnit::Um | ReadingUnit::Nm)) =
        ReadingUnit::named(unit)
    {
        return Ok(unit.micro());
    }
    let found = quoted(unit);
    let message = format!("found radial deviations in {found}, expected µm, mm or nm");
    Err(table.header_error(message).into())
}

/// Column of the radial deviations and its unit. The head is `deviation`, `radius deviation` or `radial deviation`.
fn deviation(table: &CsvTable) -> Result<Option<(Column, &str)>, MetrologyError> {
    if let Some(found) = with_unit(table, "deviation")? {
        return Ok(Some(found));
    }
    one_column(table, "radius deviation", |head| {
        let behind = unit_of(head, "radius").or_else(|| unit_of(head, "radial"));
        unit_of(behind?, "deviation")
    })
}
