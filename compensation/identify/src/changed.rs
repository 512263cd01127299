//! What may change between the rows of a file, how it moves what is seen, and how it is told.

use core::{
    fmt::{self, Display, Formatter},
    ops::Range,
};

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    error::at,
    observations::{NumberKind, Observation, Observations, Row, Seen},
    params::Part,
    prepared::Rows,
    system::{Equations, System},
    values::Values,
};

/// A step in mm or rad that is small beside what bends, and large beside rounding.
const STEP: f64 = 1e-4;

/// What changed, and by how much: mm and rad.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum What {
    /// The zero of an axis.
    Zero(AxisName, f64),
    /// The length of the tool.
    Longer(f64),
    /// A frame, a point or a number of the set-up, under its name in answers.
    Part(String, Vec<f64>),
    /// All spheres of a file together.
    Spheres(Vec<f64>),
}

impl What {
    /// What it is, whatever its size.
    pub(crate) fn kind(&self) -> Self {
        match self {
            Self::Zero(axis, _) => Self::Zero(*axis, 0.0),
            Self::Longer(_) => Self::Longer(0.0),
            Self::Part(name, _) => Self::Part(name.clone(), Vec::new()),
            Self::Spheres(_) => Self::Spheres(Vec::new()),
        }
    }

    /// The same by so much. Of a drift from the first row to the last: twice what the odd polynomials have.
    pub(crate) fn by(&self, by: &DVector<f64>, order: usize) -> Self {
        let columns = by.len() / order.max(1);
        let size = |place: usize| match order {
            0 => by[place],
            _ => (1..=order)
                .filter(|k| k % 2 == 1)
                .map(|k| 2.0 * by[(k - 1) * columns + place])
                .sum(),
        };
        let all = || (0..columns).map(size).collect();
        match self {
            Self::Zero(axis, _) => Self::Zero(*axis, size(0)),
            Self::Longer(_) => Self::Longer(size(0)),
            Self::Part(name, _) => Self::Part(name.clone(), all()),
            Self::Spheres(_) => Self::Spheres(all()),
        }
    }
}

/// A length in the unit in which it is read at once.
fn length(mm: f64) -> String {
    if mm.abs() < 1.0 {
        format!("{:.1} µm", 1e3 * mm)
    } else {
        format!("{mm:.3} mm")
    }
}

fn vector(mm: &[f64]) -> String {
    let largest = mm.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    let (scale, digits, unit) = if largest < 1.0 {
        (1e3, 1, "µm")
    } else {
        (1.0, 3, "mm")
    };
    let numbers: Vec<String> = mm
        .iter()
        .map(|x| format!("{:.digits$}", scale * x))
        .collect();
    format!("[{}] {unit}", numbers.join(", "))
}

/// The rest of a sentence that begins with "they fit if".
impl Display for What {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Zero(axis, by) => match axis.kind() {
                AxisKind::Linear => write!(f, "the zero of {axis} is shifted by {}", length(*by)),
                AxisKind::Rotary => {
                    write!(f, "the zero of {axis} is shifted by {:.1} µrad", 1e6 * by)
                }
            },
            Self::Longer(by) => write!(f, "the tool or the spindle is longer by {}", length(*by)),
            Self::Part(name, by) => match &by[..] {
                [one] => write!(f, "{name} changes by {}", length(*one)),
                [.., a, b, c] if by.len() == 6 => write!(
                    f,
                    "{name} has moved by {} and turned by [{:.1}, {:.1}, {:.1}] µrad",
                    vector(&by[..3]),
                    1e6 * a,
                    1e6 * b,
                    1e6 * c
                ),
                _ => write!(f, "{name} has moved by {}", vector(by)),
            },
            Self::Spheres(by) => write!(f, "all spheres have moved by {}", vector(by)),
        }
    }
}

/// A jump or a drift in the rows of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Changed {
    pub(crate) file: String,
    /// The line of the row at which it begins, from 1.
    pub(crate) line: usize,
    /// The place of this row in its file; `None` for a drift.
    pub(crate) row: Option<usize>,
    /// The order of a drift; 0 for a jump.
    pub(crate) order: usize,
    pub(crate) what: What,
    /// What explains it as well.
    pub(crate) or: Vec<What>,
    /// How far it moves what is seen at the most.
    pub(crate) size_mm: f64,
    /// What is left of the rows of the file with it, root mean square.
    pub(crate) left_mm: f64,
    /// The share of the squares of what is left of the file that goes with it.
    pub(crate) explains: f64,
    /// Axes that moved one way as the rows went on.
    pub(crate) ordered_by: Vec<AxisName>,
}

impl Changed {
    pub(crate) fn is_jump(&self) -> bool {
        self.row.is_some()
    }

    /// Names the axes by whose place the rows are as much in order as by their number: an error of such an axis looks the same.
    pub(crate) fn look_alike(&mut self, machine: &Machine, observation: &Observation) {
        /// Of a drift: the axis follows the number of the row.
        const FOLLOWS: f64 = 0.9;
        let rows = &observation.rows;
        let axes = machine.axes().iter().enumerate();
        self.ordered_by = axes
            .filter(|(axis, _)| {
                let at = |row: &Row| row.stand.state.q[*axis];
                let ends = |rows: &[Row]| {
                    let low = rows.iter().map(at).fold(f64::INFINITY, f64::min);
                    let high = rows.iter().map(at).fold(f64::NEG_INFINITY, f64::max);
                    [low, high]
                };
                if let Some(first) = self.row {
                    let (before, after) = rows.split_at(first.min(rows.len()));
                    let ([l, h], [low, high]) = (ends(before), ends(after));
                    return h < low || high < l;
                }
                let n = rows.len() as f64;
                let mean = rows.iter().map(at).sum::<f64>() / n;
                let time = rows.iter().map(|row| row.time).sum::<f64>() / n;
                let [xx, xt, tt] = rows.iter().fold([0.0; 3], |[xx, xt, tt], row| {
                    let (x, t) = (at(row) - mean, row.time - time);
                    [xx + x * x, xt + x * t, tt + t * t]
                });
                xx > 0.0 && xt.abs() > FOLLOWS * (xx * tt).sqrt()
            })
            .map(|(_, axis)| axis.name)
            .collect();
    }

    /// What explains it, all that do so equally well.
    pub(crate) fn why(&self) -> String {
        const SHOWN: usize = 2;
        let others = self.or.iter().take(SHOWN);
        let all: Vec<String> = core::iter::once(&self.what)
            .chain(others)
            .map(ToString::to_string)
            .collect();
        all.join(", or if ")
    }
}

impl Display for Changed {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let why = self.why();
        if self.is_jump() {
            write!(
                f,
                "{}: at this row what is left jumps: this and the later rows fit if {why}: what is found is wrong by a part of that. Measure the file anew, or give these rows a file of their own with other names of spheres and set-ups",
                at(&self.file, self.line)
            )?;
        } else {
            write!(
                f,
                "{}: what is left follows the order of the rows: they fit if {why} from the first row to the last. Let the machine and the spindle come to a steady temperature, or try `drift = {}`",
                self.file, self.order
            )?;
        }
        if !self.ordered_by.is_empty() {
            let axes: Vec<String> = self.ordered_by.iter().map(ToString::to_string).collect();
            write!(
                f,
                ". The rows stand in the order of {} too: an error that is not among the unknowns looks the same",
                axes.join(", ")
            )?;
        }
        Ok(())
    }
}

/// How one thing moves the equations of a file.
pub(crate) struct Effect {
    /// Which of the files that are fitted.
    pub(crate) file: usize,
    pub(crate) what: What,
    /// One row for each equation of the file.
    pub(crate) columns: DMatrix<f64>,
}

/// Everything that may change in each file.
pub(crate) fn effects(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
    equations: &Equations,
) -> Vec<Effect> {
    let machine = &system.machine;
    let mut effects = Vec::new();
    // Of axes and the tool by small steps.
    let by = |change: &dyn Fn(&mut Row)| {
        let moved: Vec<Row> = rows
            .iter()
            .map(|row| {
                let mut row = row.clone();
                // A shift goes out of the difference of two poses, and lines tell of errors alone.
                if !matches!(row.seen, Seen::Pair { .. } | Seen::Line { .. }) {
                    change(&mut row);
                }
                row
            })
            .collect();
        let there = system.plain_equations(&system.prepare(moved.iter()), values, false);
        (there.residuals - &equations.residuals) / STEP
    };
    let of_axes: Vec<(What, DVector<f64>)> = (0..machine.axes().len())
        .map(|axis| {
            let shift = |row: &mut Row| row.stand.state.q[axis] += STEP;
            (What::Zero(machine.axes()[axis].name, 0.0), by(&shift))
        })
        .collect();
    let longer = |row: &mut Row| row.stand.tip_mm -= STEP * machine.chain().tool_axis();
    let longer = by(&longer);
    for (file, (_, own)) in observations.fitted().enumerate() {
        let Some((first, last)) = own.clone().next().zip(own.clone().next_back()) else {
            continue;
        };
        let (first, last) = (equations.places[first], equations.places[last]);
        let (start, count) = (first.0, last.0 + last.1 - first.0);
        let one = |whole: &DVector<f64>| {
            DMatrix::from_column_slice(count, 1, whole.rows(start, count).into_owned().as_slice())
        };
        let at = |axis: usize| {
            own.clone()
                .map(move |row| rows.get(row).stand.state.q[axis])
        };
        let mut told: Vec<(What, DMatrix<f64>)> = Vec::new();
        for (axis, (what, column)) in of_axes.iter().enumerate() {
            let mut places = at(axis);
            let first = places.next();
            // An axis that stands says the same as the set-up.
            if first.is_some_and(|first| places.any(|q| (q - first).abs() > STEP)) {
                told.push((what.clone(), one(column)));
            }
        }
        told.push((What::Longer(0.0), one(&longer)));
        told.extend(of_set_up(
            system,
            rows,
            own,
            equations,
            start..start + count,
        ));
        effects.extend(told.into_iter().map(|(what, columns)| Effect {
            file,
            what,
            columns,
        }));
    }
    effects
}

/// The parts of the set-up of a file that may move, each alone and spheres together, with their columns in the equations of the
/// file.
fn of_set_up(
    system: &System,
    rows: &Rows,
    own: Range<usize>,
    equations: &Equations,
    places: Range<usize>,
) -> Vec<(What, DMatrix<f64>)> {
    let mut effects = Vec::new();
    let (start, count) = (places.start, places.len());
    let mut parts: Vec<Part> = own
        .clone()
        .flat_map(|row| rows.get(row).seen.parts())
        .collect();
    parts.sort_unstable();
    parts.dedup();
    let is_line = |row: usize| matches!(rows.get(row).seen, Seen::Line { .. });
    let mut spheres: Vec<DMatrix<f64>> = Vec::new();
    for part in parts {
        let columns: Vec<usize> = system
            .params
            .of(part)
            .iter()
            .filter(|column| column.order == 0)
            .map(|column| column.param)
            .collect();
        let name = match part {
            Part::Frame(place) => &system.setup.frames[place].name,
            Part::Point(place) => &system.setup.points[place].name,
            Part::Number(place) => {
                let kind = system.setup.number_kinds.get(place);
                let is_offset = kind == Some(&NumberKind::Offset);
                if !is_offset && kind != Some(&NumberKind::DeadLength) {
                    continue;
                }
                if is_offset && columns.is_empty() && own.clone().all(is_line) {
                    // A known offset has no column: it is added to every reading.
                    let weights = own.clone().map(|row| 1.0 / rows.get(row).uncertainty_mm);
                    let name = system.setup.numbers[place].name.clone();
                    let column = DMatrix::from_iterator(count, 1, weights);
                    effects.push((What::Part(name, Vec::new()), column));
                    continue;
                }
                &system.setup.numbers[place].name
            }
        };
        if columns.is_empty() {
            continue;
        }
        let jacobian = equations.jacobian.select_columns(&columns);
        let own_of = jacobian.rows(start, count).into_owned();
        let is_of = |row: usize| matches!(rows.get(row).seen, Seen::Sphere { centre, .. } if Part::Point(centre) == part);
        if own.clone().any(is_of) {
            spheres.push(own_of.clone());
        }
        effects.push((What::Part(name.clone(), Vec::new()), own_of));
    }
    if spheres.len() > 1 {
        let sum = spheres
            .iter()
            .fold(DMatrix::zeros(count, 3), |sum, one| sum + one);
        effects.push((What::Spheres(Vec::new()), sum));
    }
    effects
}
