//! A table over up to three linear axes at once.

use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use super::{refusal::ExchangeError, sampled::TableOptions};

/// Most lines along an axis.
pub(crate) const MOST_LINES: usize = 25;
/// Most axes of a grid, and most axes that deviate: the space has no more directions.
const MOST_AXES: usize = 3;

/// The deviations (actual − commanded, mm) of linear axes on a grid of linear axes, linear in each axis within a cell and held
/// beyond the ends.
#[derive(Clone, Debug, PartialEq)]
pub struct GridTable {
    axes: Vec<AxisName>,
    lines: Vec<Vec<f64>>,
    outputs: Vec<AxisName>,
    values: Vec<f64>,
}

/// Why axes, lines and values are no grid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridTableError {
    /// A rotary axis, one that stands twice, or too many.
    #[error(
        "{what} of a grid: found {}, expected three different linear axes at the most",
        named(found)
    )]
    Axes {
        /// The axes, or the deviations.
        what: &'static str,
        /// Those that were given.
        found: Vec<AxisName>,
    },
    /// Not one set of lines for each axis.
    #[error(
        "found lines along {found} axes, expected one set for each of the {expected} axes of the grid"
    )]
    Sets {
        /// How many sets of lines there are.
        found: usize,
        /// How many axes the grid has.
        expected: usize,
    },
    /// The lines along an axis.
    #[error("axis {axis}: the lines of a grid must be finite, rising, and one at the least")]
    Lines {
        /// The axis.
        axis: AxisName,
    },
    /// Not one value of each deviating axis for each node.
    #[error("found {found} values, expected {expected}: one of each deviating axis for each node")]
    Count {
        /// How many values there are.
        found: usize,
        /// How many there have to be.
        expected: usize,
    },
    /// A value that is no finite number.
    #[error("value {place} of a grid, counted from 1: found {found}, expected a finite number")]
    Value {
        /// Its place, from 1.
        place: usize,
        /// The value, mm.
        found: f64,
    },
}

fn named(axes: &[AxisName]) -> String {
    let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
    names.join(" ")
}

impl GridTable {
    /// A grid: the axes, the slowest first; the positions of the lines along each, mm; the axes that deviate; and for each node, the
    /// last axis of the grid the fastest, one deviation of each of them, mm.
    ///
    /// # Errors
    /// Axes that are not linear and different, lines that do not rise, and another number of values than the nodes take.
    pub fn new(
        axes: Vec<AxisName>,
        lines: Vec<Vec<f64>>,
        outputs: Vec<AxisName>,
        values: Vec<f64>,
    ) -> Result<Self, GridTableError> {
        for (what, found) in [("axes", &axes), ("deviations", &outputs)] {
            let twice = (1..found.len()).any(|place| found[..place].contains(&found[place]));
            if twice || found.len() > MOST_AXES || found.iter().any(|axis| axis.is_rotary()) {
                let found = found.clone();
                return Err(GridTableError::Axes { what, found });
            }
        }
        if lines.len() != axes.len() {
            return Err(GridTableError::Sets {
                found: lines.len(),
                expected: axes.len(),
            });
        }
        for (&axis, lines) in axes.iter().zip(&lines) {
            let rise = lines.windows(2).all(|pair| pair[0] < pair[1]);
            if lines.is_empty() || !rise || lines.iter().any(|line| !line.is_finite()) {
                return Err(GridTableError::Lines { axis });
            }
        }
        let sizes = lines.iter().map(Vec::len);
        let expected = sizes.fold(outputs.len(), usize::saturating_mul);
        if values.len() != expected {
            let found = values.len();
            return Err(GridTableError::Count { found, expected });
        }
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            return Err(GridTableError::Value {
                place: place + 1,
                found: values[place],
            });
        }
        Ok(Self {
            axes,
            lines,
            outputs,
            values,
        })
    }

    /// The axes of the grid, the slowest first.
    pub fn axes(&self) -> &[AxisName] {
        &self.axes
    }

    /// The positions of the lines along each axis of the grid, rising, mm.
    pub fn lines(&self) -> &[Vec<f64>] {
        &self.lines
    }

    /// The axes that deviate.
    pub fn outputs(&self) -> &[AxisName] {
        &self.outputs
    }

    /// For each node, the last axis of the grid the fastest, one deviation of each output, mm.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The deviation of each output in its turn, with its values at the nodes, mm.
    pub fn by_output(&self) -> impl Iterator<Item = (AxisName, impl Iterator<Item = &f64>)> {
        let (outputs, every) = (self.outputs.iter().enumerate(), self.outputs.len());
        outputs.map(move |(place, axis)| (*axis, self.values.iter().skip(place).step_by(every)))
    }

    /// The grid of a machine: the mean of both directions, the other axes where they stand.
    pub(crate) fn of(
        machine: &Machine,
        temperatures: &Temperatures,
        options: &TableOptions,
    ) -> Result<Self, ExchangeError> {
        let reference = machine.state(&options.reference(machine)?)?;
        let wanted = machine.correction_options();
        let correctors = wanted.correctors(machine.chain());
        let mut places = correctors.linear().to_vec();
        places.sort_unstable_by_key(|&place| machine.axes()[place].name.index());
        let axes: Vec<AxisName> = places
            .iter()
            .map(|&place| machine.axes()[place].name)
            .collect();
        let along = |&place: &usize| {
            let [low, high] = machine.axes()[place].travel;
            let parts = ((high - low) / options.step_mm - 1e-9).ceil();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "between 1 and 24"
            )]
            let parts = parts.clamp(1.0, (MOST_LINES - 1) as f64) as u32;
            let line = |part: u32| low + (high - low) * f64::from(part) / f64::from(parts);
            (0..=parts).map(line).collect()
        };
        let lines: Vec<Vec<f64>> = places.iter().map(along).collect();
        let mut values = Vec::new();
        for node in 0..nodes(&lines) {
            let mut state = reference;
            for (place, at) in places.iter().zip(node_at(&lines, node)) {
                state.q[*place] = at;
            }
            let found = machine.correction_at(&state, temperatures, &wanted);
            values.extend(places.iter().map(|&place| 0.0 - found.delta[place]));
        }
        Ok(Self::new(axes.clone(), lines, axes, values)?)
    }

    /// How many nodes there are.
    pub fn nodes(&self) -> usize {
        nodes(&self.lines)
    }

    /// Where a node is, mm.
    pub fn node(&self, index: usize) -> Vec<f64> {
        node_at(&self.lines, index)
    }

    /// The deviations of the outputs, mm, where the axes of the grid stand at these positions, mm.
    pub fn deviation(&self, at: impl Fn(AxisName) -> f64) -> Vec<f64> {
        let outputs = self.outputs.len();
        let cells: Vec<(usize, f64)> = self
            .lines
            .iter()
            .zip(&self.axes)
            .map(|(lines, axis)| {
                let at = at(*axis);
                let above = lines.partition_point(|line| *line <= at);
                let cell = above.saturating_sub(1).min(lines.len().saturating_sub(2));
                let share = match (lines.get(cell), lines.get(cell + 1)) {
                    (Some(low), Some(high)) => ((at - low) / (high - low)).clamp(0.0, 1.0),
                    _ => 0.0,
                };
                (cell, share)
            })
            .collect();
        let mut sum = vec![0.0; outputs];
        // At most `MOST_AXES` cells.
        for corner in 0..1_usize << cells.len() {
            let (mut node, mut weight) = (0, 1.0);
            for (axis, (cell, share)) in cells.iter().enumerate() {
                let far = corner >> axis & 1;
                node = node * self.lines[axis].len() + cell + far;
                weight *= if far == 1 { *share } else { 1.0 - share };
            }
            if weight == 0.0 {
                continue;
            }
            for (output, sum) in sum.iter_mut().enumerate() {
                let value = self.values.get(node * outputs + output);
                *sum += weight * value.copied().unwrap_or(0.0);
            }
        }
        sum
    }
}

/// How many nodes lines have; the number of values says that it is no more than memory holds.
pub(super) fn nodes(lines: &[Vec<f64>]) -> usize {
    let sizes = lines.iter().map(Vec::len);
    sizes.fold(1, usize::saturating_mul)
}

/// Where a node is, the last axis the fastest, mm.
pub(super) fn node_at(lines: &[Vec<f64>], mut index: usize) -> Vec<f64> {
    let mut at: Vec<f64> = Vec::with_capacity(lines.len());
    for lines in lines.iter().rev() {
        let count = lines.len().max(1);
        at.push(lines.get(index % count).copied().unwrap_or(0.0));
        index /= count;
    }
    at.reverse();
    at
}
