//! Tables of one axis over another, tables of component errors, and their conversion to curves of a machine file.

use core::fmt::Write;

use volcomp_curve::{Curve, ErrorCurve, Field, Table};
use volcomp_model::write_curve;
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, Coordinate, Direction, Displacement, ErrorName, brought_into,
};

use super::text::{ExchangeError, Format};

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

/// Contents of the section `[errors]` of a machine file. Curves have their coordinate in mm or deg and their value in µm or µrad.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Error motions with their curves.
    pub motions: Vec<(ErrorName, ErrorCurve)>,
    /// Location errors, µm or µrad.
    pub locations: Vec<(ErrorName, f64)>,
}

/// Component of the own motion of an axis: the translation along a linear axis, or the rotation about a rotary one.
pub(crate) fn own_component(axis: AxisName) -> Component {
    match (axis.is_rotary(), axis.mcs_index()) {
        (false, 0) => Component::EX,
        (false, 1) => Component::EY,
        (false, _) => Component::EZ,
        (true, 0) => Component::EA,
        (true, 1) => Component::EB,
        (true, _) => Component::EC,
    }
}

/// Error motion of the input axis that a table describes: its component along or about the output axis.
fn name_of(table: &AxisTable) -> ErrorName {
    ErrorName::motion(own_component(table.output), table.input)
}

/// Converts tables to curves of a machine file.
///
/// # Errors
/// Two tables describe the same error, or a table is not a valid curve.
pub fn curves(content: &Content) -> Result<Curves, ExchangeError> {
    let found = match content {
        Content::Axes(tables) => {
            let each = tables.iter().map(|table| Ok((name_of(table), curve_of(table)?)));
            Curves { motions: each.collect::<Result<_, ExchangeError>>()?, locations: Vec::new() }
        }
        Content::Errors(errors) => of_errors(errors)?,
    };
    let names: Vec<ErrorName> = found.motions.iter().map(|(name, _)| *name).collect();
    match (1..names.len()).find(|place| names[..*place].contains(&names[*place])) {
        Some(place) => Err(ExchangeError::NoCurves(format!(
            "found two tables of {}, expected one for each error",
            names[place]
        ))),
        None => Ok(found),
    }
}

fn curve_of(table: &AxisTable) -> Result<ErrorCurve, ExchangeError> {
    let kind = table.output.kind();
    let curve = |values: &[f64]| {
        let micro = |value: &f64| Displacement::new(kind, *value).um_or_urad();
        linear(table.input, &table.positions, values.iter().map(micro))
    };
    let forward = curve(&table.forward)?;
    Ok(match &table.backward {
        None => ErrorCurve::from(forward),
        Some(backward) => {
            ErrorCurve::Pair { forward: forward.into(), backward: curve(backward)?.into() }
        }
    })
}

fn linear(
    axis: AxisName,
    positions: &[f64],
    values: impl Iterator<Item = f64>,
) -> Result<Curve, ExchangeError> {
    // Ten decimals; further digits are rounding errors of the unit conversion.
    let tidy = |x: f64| (x * 1e10).round() / 1e10 + 0.0;
    let edge = |at: &f64| tidy(Displacement::new(axis.kind(), *at).mm_or_deg());
    let nodes = positions.iter().map(edge).zip(values.map(tidy));
    let table = Table::linear(nodes.map(|(at, value)| [at, value]).collect());
    Ok(Curve::Table(
        table.map_err(|error| ExchangeError::NoCurves(format!("table over {axis}: {error}")))?,
    ))
}

fn of_errors(errors: &ErrorTables) -> Result<Curves, ExchangeError> {
    let micro =
        |name: ErrorName, value: f64| Displacement::new(name.component.kind(), value).um_or_urad();
    let motion = |table: &ErrorTable| {
        let values = table.values.iter().map(|value| micro(table.name, *value));
        Ok((table.name, ErrorCurve::from(linear(table.name.axis, &table.positions, values)?)))
    };
    Ok(Curves {
        motions: errors.curves.iter().map(motion).collect::<Result<_, ExchangeError>>()?,
        locations: errors
            .locations
            .iter()
            .map(|(name, value)| (*name, micro(*name, *value)))
            .collect(),
    })
}

/// Formats the curves as the section `[errors]` of a machine file.
pub fn to_toml(curves: &Curves) -> String {
    let mut text = String::from("[errors]\n");
    let field = |field: &Field| match field {
        Field::Curve(curve) => write_curve(curve),
        // Tables never become grids.
        Field::Grid(_) => "0.0".to_owned(),
    };
    for (name, curve) in &curves.motions {
        let _ = match curve {
            ErrorCurve::Single(single) => writeln!(text, "{name} = {}", field(single)),
            ErrorCurve::Pair { forward, backward } => {
                writeln!(
                    text,
                    "{name} = {{ forward = {}, backward = {} }}",
                    field(forward),
                    field(backward)
                )
            }
            ErrorCurve::Reversal { mean, reversal } => {
                writeln!(text, "{name} = {{ mean = {}, reversal = {reversal:?} }}", field(mean))
            }
        };
    }
    for (name, value) in &curves.locations {
        let _ = writeln!(text, "{name} = {value:?}");
    }
    text
}
