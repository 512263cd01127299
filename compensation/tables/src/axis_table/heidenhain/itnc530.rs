//! .COM of the iTNC 530.

use super::super::{
    AxisTable, ExchangeError, LineError, TextFile, Warning, exchange::deviation_from_edge,
    text::number,
};
use super::{MOST_LINES, axis_in, begin, is_turn, lines, spacing_refused_by_tnc407};

pub(crate) fn read_itnc530(
    files: &[&TextFile],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    files
        .iter()
        .map(|file| read_itnc530_file(file, warnings))
        .collect()
}

fn read_itnc530_file(
    file: &TextFile,
    warnings: &mut Vec<Warning>,
) -> Result<AxisTable, ExchangeError> {
    let all: Vec<(usize, &str)> = lines(file).collect();
    let name = begin(file, all.first())?;
    let axis = axis_in(name).ok_or_else(|| {
        LineError::at(
            file,
            1,
            format!("the table `{name}`"),
            "a name such as AXIS-X.COM",
        )
    })?;
    let head = all.first().map_or("", |(_, line)| *line);
    let stated = |word: &str| {
        let rest = head
            .split_whitespace()
            .find_map(|part| part.strip_prefix(word));
        rest.and_then(number)
    };
    let (Some(datum), Some(distance)) =
        (stated("DATUM:"), stated("DISTANCE:").filter(|d| *d > 0.0))
    else {
        return Err(LineError::at(
            file,
            1,
            volcomp_document::quoted(head),
            "DATUM:+0.0000 DISTANCE:+50.0000",
        ));
    };
    let mut table = AxisTable {
        input: axis,
        output: axis,
        positions: Vec::new(),
        forward: Vec::new(),
        backward: None,
        modulo: false,
    };
    for (line, text) in all.iter().skip(1) {
        if text.starts_with("NR") {
            continue;
        }
        if *text == "[END]" {
            break;
        }
        let cells: Vec<Option<f64>> = text.split_whitespace().map(number).collect();
        let [Some(place), Some(at), Some(value)] = cells.as_slice() else {
            return Err(LineError::at(
                file,
                *line,
                volcomp_document::quoted(text),
                "number, position and value",
            ));
        };
        let expected = table.positions.len();
        if *place != expected as f64 {
            return Err(LineError::at(
                file,
                *line,
                format!("number {place}"),
                expected.to_string(),
            ));
        }
        if expected == MOST_LINES {
            return Err(LineError::too_many(file, *line, MOST_LINES));
        }
        let by_distance = datum + distance * expected as f64;
        if (by_distance - at).abs() > 0.001 {
            return Err(LineError::at(
                file,
                *line,
                format!("position {at}"),
                format!("{by_distance}, by DATUM and DISTANCE"),
            ));
        }
        table.positions.push(AxisTable::input_from_edge(axis, *at));
        table.forward.push(deviation_from_edge(axis, *value));
    }
    table.modulo = is_turn(axis, &table.positions);
    if !axis.is_rotary()
        && let Some(expected) = spacing_refused_by_tnc407(distance)
    {
        let text = format!("a TNC 407 would refuse the distance {distance}; it takes {expected}");
        warnings.push(Warning::at(file, 1, text));
    }
    match table.refusal() {
        Some(refusal) => Err(LineError::whole(file, refusal, "a whole table")),
        None => Ok(table),
    }
}
