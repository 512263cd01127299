//! The points of one table.

use volcomp_vocabulary::AxisName;

use super::super::{
    AxisTable, ExchangeError, LineError, Warning, exchange::deviation_from_edge,
    table::interpolated,
};
use super::found::Parameters;

/// More points no table of a control has.
const MOST_POINTS: f64 = 100_000.0;

/// The points of a table: positions in mm or deg, values as they stand; `None` where it is not defined.
pub(super) struct Points {
    positions: Vec<f64>,
    values: Vec<f64>,
    modulo: bool,
}

/// From where to where, in which steps, and how many.
struct Extent {
    min: f64,
    max: f64,
    step: f64,
    last: u32,
    is_whole: bool,
}

fn extent(
    name: &str,
    parameters: &Parameters<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Extent>, ExchangeError> {
    // A table has a statement, and that stands in a file.
    let Some(file) = parameters.file else {
        return Ok(None);
    };
    let line = parameters.line;
    let used = parameters.values.values().any(|value| *value != 0.0);
    let step = parameters.number("_STEP").unwrap_or(0.0);
    if step == 0.0 {
        let though = if used { ", though it has values" } else { "" };
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: not defined, its step is 0{though}: left out"),
        ));
        return Ok(None);
    }
    let (Some(min), Some(max)) = (parameters.number("_MIN"), parameters.number("_MAX")) else {
        return Err(LineError::at(
            file,
            line,
            format!("{name} without MIN or MAX"),
            "both",
        ));
    };
    if step < 0.0
        || max < min
        || (max - min) / step > MOST_POINTS
        || (max > min && (max - min) / step < 1e-3)
    {
        let found = format!("{name} from {min} to {max} in steps of {step}");
        return Err(LineError::at(
            file,
            line,
            found,
            "a step above 0, MAX above MIN, and points that a control has",
        ));
    }
    if max == min {
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: MIN and MAX are both {min}: left out"),
        ));
        return Ok(None);
    }
    let parts = (max - min) / step;
    let is_whole = (parts - parts.round()).abs() < 1e-6;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "above 0, MOST_POINTS at the most"
    )]
    let last = if is_whole {
        parts.round()
    } else {
        parts.ceil()
    } as u32;
    Ok(Some(Extent {
        min,
        max,
        step,
        last,
        is_whole,
    }))
}

pub(super) fn points(
    name: &str,
    parameters: &Parameters<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Points>, ExchangeError> {
    let (
        Some(file),
        Some(Extent {
            min,
            max,
            step,
            last,
            is_whole,
        }),
    ) = (parameters.file, extent(name, parameters, warnings)?)
    else {
        return Ok(None);
    };
    let line = parameters.line;
    let mut positions = Vec::new();
    let mut values = Vec::new();
    for point in 0..=last {
        let Some(value) = parameters.values.get(&point) else {
            let found = format!("{name} without point {point}");
            return Err(LineError::at(
                file,
                line,
                found,
                format!("points 0 to {last}: what the control holds there is not known"),
            ));
        };
        positions.push(min + step * f64::from(point));
        values.push(*value);
    }
    if !is_whole {
        let beyond = min + step * f64::from(last);
        warnings.push(Warning::at(
            file,
            line,
            format!(
                "{name}: (MAX - MIN) / STEP is {}, no whole number. Point {last} is taken to stand at {beyond}, and the value at MAX = {max} \
                 is held from there on; whoever made it may have meant point {last} to stand at {max}",
                (max - min) / step
            ),
        ));
        let at_end = interpolated(&positions, &values, max);
        positions.pop();
        values.pop();
        positions.push(max);
        values.push(at_end);
    }
    let unused = parameters
        .values
        .range(last + 1..)
        .filter(|(_, value)| **value != 0.0)
        .count();
    if unused > 0 {
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: {unused} values behind point {last} are not 0, and are not used"),
        ));
    }
    let modulo = match parameters.number("_IS_MODULO").unwrap_or(0.0) {
        0.0 => false,
        1.0 => true,
        -1.0 => {
            warnings.push(Warning::at(
                file,
                line,
                format!("{name}: IS_MODULO is -1: read as 1; a control expects 0 or 1"),
            ));
            true
        }
        found => {
            return Err(LineError::at(
                file,
                line,
                format!("{name} with IS_MODULO {found}"),
                "0 or 1",
            ));
        }
    };
    Ok(Some(Points {
        positions,
        values,
        modulo,
    }))
}

impl Points {
    pub(super) fn table(self, input: AxisName, output: AxisName) -> AxisTable {
        AxisTable {
            input,
            output,
            positions: self
                .positions
                .iter()
                .map(|at| AxisTable::input_from_edge(input, *at))
                .collect(),
            forward: self
                .values
                .iter()
                .map(|value| deviation_from_edge(output, *value))
                .collect(),
            backward: None,
            modulo: self.modulo,
        }
    }
}
