//! .com and .cma of the TNC 640.

use volcomp_vocabulary::AxisName;

use super::super::{
    AxisTable, ExchangeError, LineError, TextFile, Warning, exchange::deviation_from_edge,
    text::number,
};
use super::{MOST_LINES, axis_in, begin, is_turn, lines};

/// What a .cma says: which table each axis has as its input.
struct Assigned(Vec<(AxisName, String)>);

fn read_cma(file: &TextFile) -> Result<Assigned, ExchangeError> {
    let all: Vec<(usize, &str)> = lines(file).collect();
    begin(file, all.first())?;
    let Some((line, head)) = all.get(1) else {
        return Err(LineError::whole(
            file,
            "no line of column names",
            "NR ACTIVE X Y Z",
        ));
    };
    let names: Vec<&str> = head.split_whitespace().collect();
    let is_axis = |name: &str| name.parse::<AxisName>().is_ok();
    if names.first() != Some(&"NR")
        || names.get(1) != Some(&"ACTIVE")
        || !names.iter().skip(2).all(|name| is_axis(name))
    {
        return Err(LineError::at(
            file,
            *line,
            volcomp_document::quoted(head),
            "NR ACTIVE and axes",
        ));
    }
    for (line, text) in all.iter().skip(2) {
        if *text == "[END]" {
            break;
        }
        let cells: Vec<&str> = text.split_whitespace().collect();
        if cells.get(1) != Some(&"*") {
            continue;
        }
        if cells.len() != names.len() {
            return Err(LineError::at(
                file,
                *line,
                format!("{} cells", cells.len()),
                format!("{}", names.len()),
            ));
        }
        let pairs = names.iter().zip(&cells).skip(2);
        let assigned = pairs
            .filter_map(|(axis, table)| Some((axis.parse().ok()?, table.to_ascii_uppercase())));
        return Ok(Assigned(assigned.collect()));
    }
    Err(LineError::whole(
        file,
        "no active line",
        "one with * in the column ACTIVE",
    ))
}

pub(crate) fn read_tnc640(
    files: &[&TextFile],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let is_cma = |file: &&&TextFile| file.base().to_ascii_uppercase().ends_with(".CMA");
    let assigned = files
        .iter()
        .find(is_cma)
        .map(|file| read_cma(file))
        .transpose()?;
    let mut tables: Vec<AxisTable> = Vec::new();
    for file in files.iter().filter(|file| !is_cma(file)) {
        let found = read_com(file, assigned.as_ref(), warnings)?;
        for table in found {
            if tables
                .iter()
                .any(|known| (known.input, known.output) == (table.input, table.output))
            {
                let found = format!("a second table {} over {}", table.output, table.input);
                return Err(LineError::whole(file, found, "one"));
            }
            tables.push(table);
        }
    }
    Ok(tables)
}

fn read_com(
    file: &TextFile,
    assigned: Option<&Assigned>,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let all: Vec<(usize, &str)> = lines(file).collect();
    let name = begin(file, all.first())?;
    let Some(input) = input_of(file, name, assigned, warnings)? else {
        return Ok(Vec::new());
    };
    let head = columns_of(file, input, &all)?;
    let Rows {
        positions,
        backlash,
        columns,
        ends,
    } = rows_of(file, input, &head, &all)?;
    let Columns {
        outputs,
        has_backlash,
        ..
    } = head;
    if !ends {
        warnings.push(Warning::whole(file, "no [END]: is it whole?"));
    }
    if has_backlash
        && backlash.iter().all(|value| *value == 0.0)
        && columns.iter().flatten().any(|value| *value != 0.0)
    {
        warnings.push(Warning::whole(
            file,
            "BACKLASH is 0 everywhere: read as no deviation after negative motion",
        ));
    }
    let tables: Vec<AxisTable> = outputs
        .into_iter()
        .zip(columns)
        .map(|(output, forward)| AxisTable {
            input,
            output,
            positions: positions.clone(),
            forward,
            backward: (has_backlash && output == input).then(|| backlash.clone()),
            modulo: is_turn(input, &positions),
        })
        .collect();
    match tables.iter().find_map(AxisTable::refusal) {
        Some(refusal) => Err(LineError::whole(file, refusal, "a whole table")),
        None => Ok(tables),
    }
}

/// The axis over whose positions a file goes; `None` where the .CMA does not name it.
fn input_of(
    file: &TextFile,
    name: &str,
    assigned: Option<&Assigned>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<AxisName>, ExchangeError> {
    let stem = name.split('.').next().unwrap_or(name).to_ascii_uppercase();
    Ok(Some(match assigned {
        Some(Assigned(pairs)) => {
            let Some((axis, _)) = pairs
                .iter()
                .find(|(_, table)| table.split('.').next() == Some(stem.as_str()))
            else {
                warnings.push(Warning::whole(
                    file,
                    "the active line of the .CMA does not name it: left out",
                ));
                return Ok(None);
            };
            *axis
        }
        None => axis_in(name).ok_or_else(|| {
            LineError::at(
                file,
                1,
                format!("the table `{name}`"),
                "a name such as AXIS_X.COM, or the .CMA that names it",
            )
        })?,
    }))
}

/// The columns of a file.
struct Columns {
    outputs: Vec<AxisName>,
    has_backlash: bool,
    cells: usize,
}

fn columns_of(
    file: &TextFile,
    input: AxisName,
    all: &[(usize, &str)],
) -> Result<Columns, ExchangeError> {
    if all.first().is_some_and(|(_, line)| line.contains("DATUM:")) {
        return Err(LineError::at(
            file,
            1,
            "DATUM",
            "a table of a TNC 640; this one is of an iTNC 530",
        ));
    }
    if all
        .first()
        .is_some_and(|(_, line)| line.split_whitespace().any(|word| word == "INCH"))
    {
        return Err(LineError::at(file, 1, "INCH", "MM"));
    }
    let Some((head_line, head)) = all.get(1) else {
        return Err(LineError::whole(
            file,
            "no line of column names",
            "NR AXISPOS and axes",
        ));
    };
    let names: Vec<&str> = head.split_whitespace().collect();
    let wrong = || {
        LineError::at(
            file,
            *head_line,
            volcomp_document::quoted(head),
            "NR AXISPOS, BACKLASH or not, and axes",
        )
    };
    if names.first() != Some(&"NR") || names.get(1) != Some(&"AXISPOS") {
        return Err(wrong());
    }
    let has_backlash = names.get(2) == Some(&"BACKLASH");
    let outputs = names.iter().skip(if has_backlash { 3 } else { 2 });
    let outputs: Vec<AxisName> = outputs
        .map(|name| name.parse().map_err(|_| wrong()))
        .collect::<Result<_, _>>()?;
    if outputs.is_empty()
        || (1..outputs.len()).any(|place| outputs[..place].contains(&outputs[place]))
    {
        return Err(wrong());
    }
    if has_backlash && !outputs.contains(&input) {
        return Err(wrong());
    }
    Ok(Columns {
        outputs,
        has_backlash,
        cells: names.len(),
    })
}

/// The values of a file, column by column.
#[derive(Default)]
struct Rows {
    positions: Vec<f64>,
    backlash: Vec<f64>,
    columns: Vec<Vec<f64>>,
    ends: bool,
}

fn rows_of(
    file: &TextFile,
    input: AxisName,
    head: &Columns,
    all: &[(usize, &str)],
) -> Result<Rows, ExchangeError> {
    let mut positions: Vec<f64> = Vec::new();
    let mut backlash = Vec::new();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); head.outputs.len()];
    let mut ends = false;
    for (line, text) in all.iter().skip(2) {
        if *text == "[END]" {
            ends = true;
            break;
        }
        let cells: Vec<&str> = text.split_whitespace().collect();
        if cells.len() != head.cells {
            return Err(LineError::at(
                file,
                *line,
                format!("{} cells", cells.len()),
                format!("{} as in the line of names", head.cells),
            ));
        }
        let cell = |place: usize| -> Result<f64, ExchangeError> {
            let text = cells.get(place).copied().unwrap_or("");
            number(text).ok_or_else(|| {
                LineError::at(file, *line, volcomp_document::quoted(text), "a number")
            })
        };
        let at = AxisTable::input_from_edge(input, cell(1)?);
        if positions.last().is_some_and(|last| *last >= at) {
            return Err(LineError::at(
                file,
                *line,
                "a position that does not rise",
                "rising positions",
            ));
        }
        if positions.len() == MOST_LINES {
            return Err(LineError::too_many(file, *line, MOST_LINES));
        }
        positions.push(at);
        if head.has_backlash {
            backlash.push(deviation_from_edge(input, cell(2)?));
        }
        let from = if head.has_backlash { 3 } else { 2 };
        for (place, (column, output)) in columns.iter_mut().zip(&head.outputs).enumerate() {
            column.push(deviation_from_edge(*output, cell(from + place)?));
        }
    }
    Ok(Rows {
        positions,
        backlash,
        columns,
        ends,
    })
}
