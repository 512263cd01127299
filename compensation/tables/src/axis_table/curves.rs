//! Converts tables back to curves of a machine file.

use core::fmt::Write;

use volcomp_curve::{Curve, ErrorCurve, Field, Table};
use volcomp_model::write_curve;
use volcomp_vocabulary::{AxisName, Component, Displacement, ErrorName};

use super::{
    table::{AxisTable, Content, ErrorTable, ErrorTables},
    text::ExchangeError,
};

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
