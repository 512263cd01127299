//! Tables of one axis over one axis, and of the component errors themselves.

use volcomp_vocabulary::{
    AxisKind, AxisName, Coordinate, Direction, Displacement, ErrorName, brought_into,
};

use super::{format::Format, text::ExchangeError};

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
        let name = self.title();
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

    /// The positions as files state them: mm or deg.
    pub(crate) fn positions_at_edge(&self) -> impl Iterator<Item = f64> {
        self.positions.iter().map(|at| self.input_at_edge(*at))
    }

    /// What the table is, for messages.
    pub(crate) fn title(&self) -> String {
        format!("table {} over {}", self.output, self.input)
    }

    /// First position and spacing of an evenly spaced table, mm or deg.
    pub(crate) fn even(&self, format: Format) -> Result<(f64, f64), ExchangeError> {
        let (Some(spacing), Some(first)) = (self.spacing(), self.positions.first()) else {
            return Err(ExchangeError::unfit(
                format,
                self.title(),
                "positions at different distances",
                "the same distance everywhere",
            ));
        };
        Ok((self.input_at_edge(*first), self.input_at_edge(spacing)))
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

/// A position or a deviation (mm or rad) that a file states in mm or deg.
pub(crate) fn from_edge(axis: AxisName, mm_or_deg: f64) -> f64 {
    Displacement::from_coordinate(axis.kind(), mm_or_deg).mm_or_rad()
}

/// One error motion at positions of its axis, in the sign of the machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorTable {
    /// Which error.
    pub name: ErrorName,
    /// Positions of its axis, rising, mm or rad.
    pub positions: Vec<f64>,
    /// The error at each, mm or rad.
    pub values: Vec<f64>,
}

impl ErrorTable {
    /// A position as files state it: mm or deg.
    pub(crate) fn at_edge(&self, position: f64) -> f64 {
        Displacement::new(self.name.axis.kind(), position).mm_or_deg()
    }

    /// Why these numbers are no table; `None` where they are one.
    pub fn refusal(&self) -> Option<String> {
        let name = self.name;
        let nodes = self.positions.len();
        if nodes < 2 || self.values.len() != nodes {
            return Some(format!(
                "{name}: found {nodes} positions and {} values, expected as many of both, 2 at the least",
                self.values.len()
            ));
        }
        if let Some(pair) = self.positions.windows(2).find(|pair| pair[0] >= pair[1]) {
            let [a, b] = [pair[0], pair[1]].map(|at| self.at_edge(at));
            return Some(format!(
                "{name}: found the positions {a} and {b}, expected rising ones"
            ));
        }
        let mut all = self.positions.iter().chain(&self.values);
        (!all.all(|x| x.is_finite())).then(|| format!("{name}: expected finite numbers"))
    }
}

/// The component errors of a machine as tables and numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorTables {
    /// Error motions.
    pub curves: Vec<ErrorTable>,
    /// Location errors, mm or rad.
    pub locations: Vec<(ErrorName, f64)>,
}

/// Tables of one kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Tables of one axis over one axis.
    Axes(Vec<AxisTable>),
    /// The component errors themselves.
    Errors(ErrorTables),
}

/// A table in the units of JSON documents.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct ListedTable {
    /// The axis over which it goes.
    pub input: AxisName,
    /// The letter of the axis that deviates, or the name of an error.
    pub output: String,
    /// The positions, mm or deg.
    pub positions: Vec<f64>,
    /// The values after positive motion, or of both.
    pub forward: Vec<f64>,
    /// The values after negative motion; `None`: as `forward`.
    pub backward: Option<Vec<f64>>,
    /// The unit of the values: `um` or `urad`.
    pub unit: &'static str,
    /// Whether the positions repeat with the length of the table.
    pub modulo: bool,
}

impl ListedTable {
    fn new(
        input: AxisName,
        output: (String, AxisKind),
        positions: &[f64],
        forward: &[f64],
    ) -> Self {
        let (output, kind) = output;
        let edge = |at: &f64| Displacement::new(input.kind(), *at).mm_or_deg();
        Self {
            input,
            output,
            positions: positions.iter().map(edge).collect(),
            forward: micro(kind, forward),
            backward: None,
            unit: micro_unit(kind),
            modulo: false,
        }
    }
}

fn micro(kind: AxisKind, values: &[f64]) -> Vec<f64> {
    let of = |value: &f64| Displacement::new(kind, *value).um_or_urad();
    values.iter().map(of).collect()
}

/// The unit of a deviation in documents.
pub(crate) fn micro_unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "um",
        AxisKind::Rotary => "urad",
    }
}

/// A value of tables, and where it is.
pub(crate) struct Entry {
    pub(crate) what: String,
    pub(crate) value: Displacement,
}

impl Content {
    /// Why the numbers of one of them are no table.
    pub(crate) fn refusal(&self) -> Option<String> {
        match self {
            Self::Axes(tables) => tables.iter().find_map(AxisTable::refusal),
            Self::Errors(errors) => errors.curves.iter().find_map(ErrorTable::refusal),
        }
    }

    /// The tables in the units of documents, in their order; location errors are not among them.
    pub fn listed(&self) -> Vec<ListedTable> {
        match self {
            Self::Axes(tables) => (tables.iter())
                .map(|table| {
                    let kind = table.output.kind();
                    let output = (table.output.to_string(), kind);
                    ListedTable {
                        backward: table.backward.as_ref().map(|values| micro(kind, values)),
                        modulo: table.modulo,
                        ..ListedTable::new(table.input, output, &table.positions, &table.forward)
                    }
                })
                .collect(),
            Self::Errors(errors) => (errors.curves.iter())
                .map(|table| {
                    let output = (table.name.to_string(), table.name.component.kind());
                    ListedTable::new(table.name.axis, output, &table.positions, &table.values)
                })
                .collect(),
        }
    }

    /// The first value that is not allowed; NaN is for the caller to refuse.
    pub(crate) fn first_refused(&self, allows: impl Fn(Displacement) -> bool) -> Option<Entry> {
        let refused = |kind: AxisKind, value: &f64| {
            let value = Displacement::new(kind, *value);
            (!allows(value)).then_some(value)
        };
        match self {
            Self::Axes(tables) => tables.iter().find_map(|table| {
                let kind = table.output.kind();
                let sides = [Some(&table.forward), table.backward.as_ref()];
                let mut values = (sides.into_iter().flatten())
                    .flat_map(|side| side.iter().zip(&table.positions));
                values.find_map(|(value, at)| {
                    let at = Coordinate(Displacement::new(table.input.kind(), *at));
                    Some(Entry {
                        value: refused(kind, value)?,
                        what: format!("the deviation of {} at {} {at}", table.output, table.input),
                    })
                })
            }),
            Self::Errors(errors) => {
                let mut curves = errors.curves.iter();
                let of_curves = curves.find_map(|table| {
                    let kind = table.name.component.kind();
                    let mut values = table.values.iter().zip(&table.positions);
                    values.find_map(|(value, at)| {
                        let axis = table.name.axis;
                        let at = Coordinate(Displacement::new(axis.kind(), *at));
                        Some(Entry {
                            value: refused(kind, value)?,
                            what: format!("{} at {axis} {at}", table.name),
                        })
                    })
                });
                let mut locations = errors.locations.iter();
                of_curves.or_else(|| {
                    locations.find_map(|(name, value)| {
                        Some(Entry {
                            value: refused(name.component.kind(), value)?,
                            what: name.to_string(),
                        })
                    })
                })
            }
        }
    }
}
