//! A table of one input axis and one output axis.

use volcomp_vocabulary::{AxisName, Direction, Displacement, brought_into};

/// What is smaller counts as nothing, mm or rad.
pub(crate) const NOTHING: f64 = 1e-9;

/// The deviation of one axis over the commanded position of one axis, linear between the nodes and held beyond the ends.
///
/// **Sign:** deviation = actual − commanded of the output axis. A control that removes it adds its negative to the command.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTable {
    /// The axis whose commanded position chooses the value.
    pub input: AxisName,
    /// The axis that deviates; the input axis itself in a table of positioning.
    pub output: AxisName,
    /// Positions of the input axis, rising, mm or rad.
    pub positions: Vec<f64>,
    /// The deviation at each position where the input axis came in its positive direction, mm or rad of the output axis.
    pub forward: Vec<f64>,
    /// The same where it came in its negative direction; `None`: as `forward`.
    pub backward: Option<Vec<f64>>,
    /// Whether the positions repeat with the length of the table.
    pub modulo: bool,
}

impl AxisTable {
    /// Whether the input axis itself deviates.
    pub fn is_own(&self) -> bool {
        self.input == self.output
    }

    /// The deviation at a position (mm or rad) of the input axis, mm or rad; the mean of both directions where none is known.
    pub fn deviation(&self, position: f64, approach: Option<Direction>) -> f64 {
        let position = self.looked_up(position);
        let forward = interpolated(&self.positions, &self.forward, position);
        let Some(backward) = &self.backward else {
            return forward;
        };
        let backward = interpolated(&self.positions, backward, position);
        match approach {
            Some(Direction::Positive) => forward,
            Some(Direction::Negative) => backward,
            None => 0.5 * (forward + backward),
        }
    }

    fn looked_up(&self, position: f64) -> f64 {
        match (self.positions.first(), self.positions.last()) {
            (Some(&low), Some(&high)) if self.modulo && high > low => {
                brought_into([low, high], high - low, position)
            }
            _ => position,
        }
    }

    /// The mean of both directions at each position.
    pub fn mean(&self) -> Vec<f64> {
        let Some(backward) = &self.backward else {
            return self.forward.clone();
        };
        let pairs = self.forward.iter().zip(backward);
        pairs.map(|(a, b)| 0.5 * (a + b)).collect()
    }

    /// Whether every deviation is nothing.
    pub fn is_nothing(&self) -> bool {
        let backward = self.backward.iter().flatten();
        let mut all = self.forward.iter().chain(backward);
        all.all(|value| value.abs() < NOTHING)
    }

    /// The distance of the positions where it is the same everywhere, but for rounding.
    pub fn spacing(&self) -> Option<f64> {
        let (&first, &last) = (self.positions.first()?, self.positions.last()?);
        let parts = self.positions.len().checked_sub(1).filter(|&n| n > 0)?;
        let spacing = (last - first) / parts as f64;
        let even = self.positions.iter().enumerate().all(|(place, at)| {
            let expected = first + spacing * place as f64;
            (at - expected).abs() <= 1e-6 * spacing.abs() + 1e-9
        });
        even.then_some(spacing)
    }

    /// Why these numbers are no table; `None` where they are one.
    pub fn refusal(&self) -> Option<String> {
        let name = format!("table {} over {}", self.output, self.input);
        let nodes = self.positions.len();
        if nodes < 2 {
            return Some(format!(
                "{name}: found {nodes} positions, expected 2 at the least"
            ));
        }
        let backward = self.backward.as_ref().map_or(nodes, Vec::len);
        if self.forward.len() != nodes || backward != nodes {
            return Some(format!(
                "{name}: expected a value at each of its {nodes} positions"
            ));
        }
        if let Some(pair) = self.positions.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Some(format!(
                "{name}: found the positions {} and {}, expected rising ones",
                self.input_at_edge(pair[0]),
                self.input_at_edge(pair[1])
            ));
        }
        let mut values = self.forward.iter().chain(self.backward.iter().flatten());
        let finite =
            self.positions.iter().all(|at| at.is_finite()) && values.all(|v| v.is_finite());
        (!finite).then(|| format!("{name}: expected finite numbers"))
    }

    /// A position as files state it: mm or deg.
    pub fn input_at_edge(&self, position: f64) -> f64 {
        Displacement::new(self.input.kind(), position).mm_or_deg()
    }

    /// A deviation as most controls state it: mm or deg.
    pub fn output_at_edge(&self, deviation: f64) -> f64 {
        Displacement::new(self.output.kind(), deviation).mm_or_deg()
    }

    pub(crate) fn input_from_edge(input: AxisName, mm_or_deg: f64) -> f64 {
        Displacement::from_coordinate(input.kind(), mm_or_deg).mm_or_rad()
    }

    /// The same curves at other positions; those between are lost.
    pub(crate) fn at_positions(&self, positions: Vec<f64>) -> Self {
        let along = |values: &Vec<f64>| {
            let each = positions.iter();
            each.map(|&at| interpolated(&self.positions, values, at))
                .collect()
        };
        Self {
            forward: along(&self.forward),
            backward: self.backward.as_ref().map(along),
            positions,
            ..self.clone()
        }
    }
}

/// Linear between the nodes, held beyond the ends; 0 without nodes.
pub(crate) fn interpolated(positions: &[f64], values: &[f64], at: f64) -> f64 {
    let above = positions.partition_point(|position| *position <= at);
    let value = |place: usize| values.get(place).copied().unwrap_or(0.0);
    let Some(below) = above.checked_sub(1) else {
        return value(0);
    };
    let (Some(low), Some(high)) = (positions.get(below), positions.get(above)) else {
        return value(positions.len().saturating_sub(1));
    };
    let share = (at - low) / (high - low);
    (1.0 - share) * value(below) + share * value(above)
}
