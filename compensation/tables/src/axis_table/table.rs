//! Tables of one axis over another, and tables of component errors.

use volcomp_vocabulary::{
    AxisKind, AxisName, Coordinate, Direction, Displacement, ErrorName, brought_into,
};

use super::{format::Format, text::ExchangeError};

/// Deviations below this magnitude are treated as zero, mm or rad.
pub(crate) const ZERO_BELOW: f64 = 1e-9;

/// Deviation of one axis over the commanded position of the same or another axis, linear between the nodes and constant beyond the ends.
///
/// **Sign:** deviation = actual − commanded of the output axis. A control that removes the deviation adds its negative to the command.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTable {
    /// Axis whose commanded position selects the value.
    pub input: AxisName,
    /// Axis that deviates; equal to the input axis in a positioning table.
    pub output: AxisName,
    /// Positions of the input axis, ascending, mm or rad.
    pub positions: Vec<f64>,
    /// Deviation at each position after positive motion of the input axis, mm or rad of the output axis.
    pub forward: Vec<f64>,
    /// Deviation after negative motion; `None`: the same as `forward`.
    pub backward: Option<Vec<f64>>,
    /// Whether the table repeats with the period of its length, as for a rotary axis over a full
    /// turn.
    pub modulo: bool,
}

impl AxisTable {
    /// Whether input and output axis are the same.
    pub fn is_own(&self) -> bool {
        self.input == self.output
    }

    /// Deviation at a position (mm or rad) of the input axis, mm or rad; the mean of both directions if `approach` is `None`.
    pub fn deviation(&self, position: f64, approach: Option<Direction>) -> f64 {
        let position = self.wrapped_position(position);
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

    fn wrapped_position(&self, position: f64) -> f64 {
        match (self.positions.first(), self.positions.last()) {
            (Some(&low), Some(&high)) if self.modulo && high > low => {
                brought_into([low, high], high - low, position)
            }
            _ => position,
        }
    }

    /// Mean of both directions at each position, mm or rad.
    pub fn mean(&self) -> Vec<f64> {
        let Some(backward) = &self.backward else {
            return self.forward.clone();
        };
        let pairs = self.forward.iter().zip(backward);
        pairs.map(|(a, b)| 0.5 * (a + b)).collect()
    }

    /// Whether every deviation is zero.
    pub fn is_zero(&self) -> bool {
        let backward = self.backward.iter().flatten();
        let mut all = self.forward.iter().chain(backward);
        all.all(|value| value.abs() < ZERO_BELOW)
    }

    /// Spacing of the positions, mm or rad; `None` if it is not uniform except for rounding.
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

    /// Reason why these numbers are not a valid table; `None` if they are.
    pub fn refusal(&self) -> Option<String> {
        let name = self.title();
        let nodes = self.positions.len();
        if nodes < 2 {
            return Some(format!("{name}: found {nodes} positions, expected at least 2"));
        }
        let backward = self.backward.as_ref().map_or(nodes, Vec::len);
        if self.forward.len() != nodes || backward != nodes {
            return Some(format!("{name}: expected a value at each of its {nodes} positions"));
        }
        if let Some(pair) = self.positions.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Some(format!(
                "{name}: found the positions {} and {}, expected increasing ones",
                self.input_in_file_unit(pair[0]),
                self.input_in_file_unit(pair[1])
            ));
        }
        let mut values = self.forward.iter().chain(self.backward.iter().flatten());
        let finite =
            self.positions.iter().all(|at| at.is_finite()) && values.all(|v| v.is_finite());
        (!finite).then(|| format!("{name}: expected finite numbers"))
    }

    /// Converts a position to the file unit, mm or deg.
    pub fn input_in_file_unit(&self, position: f64) -> f64 {
        Displacement::new(self.input.kind(), position).mm_or_deg()
    }

    /// Converts a deviation to the unit of most controls, mm or deg.
    pub fn output_in_file_unit(&self, deviation: f64) -> f64 {
        Displacement::new(self.output.kind(), deviation).mm_or_deg()
    }

    /// Positions in the file unit, mm or deg.
    pub(crate) fn positions_in_file_unit(&self) -> impl Iterator<Item = f64> {
        self.positions.iter().map(|at| self.input_in_file_unit(*at))
    }

    pub(crate) fn title(&self) -> String {
        format!("table {} over {}", self.output, self.input)
    }

    /// First position and spacing of an evenly spaced table, mm or deg. Errors: uneven spacing.
    pub(crate) fn even(&self, format: Format) -> Result<(f64, f64), ExchangeError> {
        let (Some(spacing), Some(first)) = (self.spacing(), self.positions.first()) else {
            return Err(ExchangeError::not_representable(
                format,
                self.title(),
                "positions at different distances",
                "the same distance everywhere",
            ));
        };
        Ok((self.input_in_file_unit(*first), self.input_in_file_unit(spacing)))
    }

    /// Resamples the table at these positions, mm or rad; nodes in between are lost.
    pub(crate) fn at_positions(&self, positions: Vec<f64>) -> Self {
        let along = |values: &Vec<f64>| {
            let each = positions.iter();
            each.map(|&at| interpolated(&self.positions, values, at)).collect()
        };
        Self {
            forward: along(&self.forward),
            backward: self.backward.as_ref().map(along),
            positions,
            ..self.clone()
        }
    }
}

/// Linear interpolation between the nodes, constant beyond the ends; 0 without nodes.
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

/// Converts a position or deviation in a file (mm or deg) to mm or rad.
pub(crate) fn from_file_unit(axis: AxisName, mm_or_deg: f64) -> f64 {
    Displacement::from_coordinate(axis.kind(), mm_or_deg).mm_or_rad()
}

/// One error motion at positions of its axis, with the sign convention of the machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorTable {
    /// Error motion.
    pub name: ErrorName,
    /// Positions of the error's axis, ascending, mm or rad.
    pub positions: Vec<f64>,
    /// Error at each position, mm or rad.
    pub values: Vec<f64>,
}

impl ErrorTable {
    /// Converts a position to the file unit, mm or deg.
    pub(crate) fn position_in_file_unit(&self, position: f64) -> f64 {
        Displacement::new(self.name.axis.kind(), position).mm_or_deg()
    }

    /// Reason why these numbers are not a valid table; `None` if they are.
    pub fn refusal(&self) -> Option<String> {
        let name = self.name;
        let nodes = self.positions.len();
        if nodes < 2 || self.values.len() != nodes {
            return Some(format!(
                "{name}: found {nodes} positions and {} values, expected equal numbers of both, at least 2",
                self.values.len()
            ));
        }
        if let Some(pair) = self.positions.windows(2).find(|pair| pair[0] >= pair[1]) {
            let [a, b] = [pair[0], pair[1]].map(|at| self.position_in_file_unit(at));
            return Some(format!(
                "{name}: found the positions {a} and {b}, expected increasing ones"
            ));
        }
        let mut all = self.positions.iter().chain(&self.values);
        (!all.all(|x| x.is_finite())).then(|| format!("{name}: expected finite numbers"))
    }
}

/// Component errors of a machine as tables and single values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorTables {
    /// Error motions.
    pub curves: Vec<ErrorTable>,
    /// Location errors, mm or rad.
    pub locations: Vec<(ErrorName, f64)>,
}

/// Content of table files: axis tables, or component errors.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Tables of one axis over another.
    Axes(Vec<AxisTable>),
    /// The component errors themselves.
    Errors(ErrorTables),
}

/// A table in the units of JSON documents.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct ListedTable {
    /// Axis over whose positions the values are tabulated.
    pub input: AxisName,
    /// Letter of the deviating axis, or name of an error.
    pub output: String,
    /// Positions, mm or deg.
    pub positions: Vec<f64>,
    /// Values after positive motion, or after either motion if `backward` is `None`.
    pub forward: Vec<f64>,
    /// Values after negative motion; `None`: the same as `forward`.
    pub backward: Option<Vec<f64>>,
    /// Unit of the values: `um` or `urad`.
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

pub(crate) fn micro_unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "um",
        AxisKind::Rotary => "urad",
    }
}

pub(crate) struct TableValue {
    pub(crate) what: String,
    pub(crate) value: Displacement,
}

impl Content {
    /// Reason why the first invalid table is invalid; `None` if all are valid.
    pub(crate) fn refusal(&self) -> Option<String> {
        match self {
            Self::Axes(tables) => tables.iter().find_map(AxisTable::refusal),
            Self::Errors(errors) => errors.curves.iter().find_map(ErrorTable::refusal),
        }
    }

    /// Tables in the units of documents, without location errors.
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

    /// First value that `allows` rejects; `None` if there is none. The caller must reject NaN.
    pub(crate) fn first_refused(
        &self,
        allows: impl Fn(Displacement) -> bool,
    ) -> Option<TableValue> {
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
                    Some(TableValue {
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
                        Some(TableValue {
                            value: refused(kind, value)?,
                            what: format!("{} at {axis} {at}", table.name),
                        })
                    })
                });
                let mut locations = errors.locations.iter();
                of_curves.or_else(|| {
                    locations.find_map(|(name, value)| {
                        Some(TableValue {
                            value: refused(name.component.kind(), value)?,
                            what: name.to_string(),
                        })
                    })
                })
            }
        }
    }
}
