//! HEIDENHAIN: .com and .cma of the TNC 640, .COM of the iTNC 530.

use core::fmt::Write;

use volcomp_vocabulary::AxisName;

use super::{
    AxisTable, ExchangeError, Format, LineError, TextFile, Warning, Written,
    exchange::{deviation_from_edge, edge_of, even},
    text::{number, signed},
};

/// Lines of a table.
const MOST_LINES: usize = 256;
/// Decimals of mm and deg, as in the files that are known.
const DECIMALS: usize = 4;
/// A TNC 407 counts in 0.1 µm, mm.
const STEP_OF_TNC407_MM: f64 = 1e-4;

/// The exponent n where a spacing is 2^n × 0.1 µm; `None` where it is none that a TNC 407 takes.
pub fn steps_of_tnc407(spacing_mm: f64) -> Option<u32> {
    (0..31).find(|n| (spacing_mm - STEP_OF_TNC407_MM * f64::from(1_u32 << n)).abs() < 1e-9)
}

/// Why a TNC 407 refuses a spacing, in words that name the nearest that it takes; `None` where it takes it.
pub fn spacing_refused_by_tnc407(spacing_mm: f64) -> Option<String> {
    if steps_of_tnc407(spacing_mm).is_some() {
        return None;
    }
    let at = |n: u32| STEP_OF_TNC407_MM * f64::from(1_u32 << n);
    let above = (0..31).find(|n| at(*n) > spacing_mm).unwrap_or(30);
    let below = above.saturating_sub(1);
    Some(format!(
        "a power of two times 0.1 µm: {} or {}",
        at(below),
        at(above)
    ))
}

fn unfit(format: Format, table: &AxisTable, found: String, expected: String) -> ExchangeError {
    ExchangeError::Unfit {
        format,
        what: format!("table {} over {}", table.output, table.input),
        found,
        expected,
    }
}

/// What every HEIDENHAIN table has to keep.
fn check(format: Format, table: &AxisTable) -> Result<(), ExchangeError> {
    let count = table.positions.len();
    if count > MOST_LINES {
        let expected = format!("{MOST_LINES} at the most: take a larger step");
        return Err(unfit(format, table, format!("{count} positions"), expected));
    }
    let (first, last) = (
        edge_of(table).next().unwrap_or(0.0),
        edge_of(table).last().unwrap_or(0.0),
    );
    if table.input.is_rotary() && (first < -1e-6 || last > 360.0 + 1e-6) {
        let found = format!("positions from {first} to {last} deg");
        return Err(unfit(format, table, found, "0 to 360 deg".to_owned()));
    }
    Ok(())
}

pub(crate) fn write_tnc640(tables: &[AxisTable]) -> Result<Written, ExchangeError> {
    const FORMAT: Format = Format::HeidenhainTnc640;
    let mut written = Written::default();
    let mut inputs: Vec<AxisName> = tables.iter().map(|table| table.input).collect();
    inputs.sort_unstable_by_key(|axis| axis.index());
    inputs.dedup();
    let mut averaged = Vec::new();
    for &input in &inputs {
        let mut of: Vec<&AxisTable> = tables.iter().filter(|table| table.input == input).collect();
        of.sort_by_key(|table| table.output.index());
        for table in &of {
            check(FORMAT, table)?;
            if of
                .first()
                .is_some_and(|first| first.positions != table.positions)
            {
                return Err(unfit(
                    FORMAT,
                    table,
                    "other positions".to_owned(),
                    format!("those of the other tables over {input}"),
                ));
            }
            if table.backward.is_some() && !table.is_own() {
                averaged.push(format!("{} over {}", table.output, table.input));
            }
        }
        let Some(first) = of.first() else { continue };
        let backlash = of
            .iter()
            .find(|table| table.is_own())
            .and_then(|table| table.backward.as_ref().map(|b| (*table, b)));
        let mut text = format!("BEGIN AXIS_{input}.COM MM\n");
        let mut head = vec!["NR".to_owned(), "AXISPOS".to_owned()];
        if backlash.is_some() {
            head.push("BACKLASH".to_owned());
        }
        head.extend(of.iter().map(|table| table.output.to_string()));
        row(&mut text, &head);
        let columns: Vec<Vec<f64>> = of
            .iter()
            .map(|table| {
                if table.is_own() {
                    table.forward.clone()
                } else {
                    table.mean()
                }
            })
            .collect();
        for (place, at) in edge_of(first).enumerate() {
            let mut cells = vec![place.to_string(), signed(at, DECIMALS)];
            if let Some((table, values)) = backlash {
                cells.push(signed(table.output_at_edge(values[place]), DECIMALS));
            }
            let values = of.iter().zip(&columns);
            cells.extend(
                values.map(|(table, column)| signed(table.output_at_edge(column[place]), DECIMALS)),
            );
            row(&mut text, &cells);
        }
        text += "[END]\n";
        written.files.push(TextFile {
            name: format!("AXIS_{input}.COM"),
            text,
        });
    }
    if inputs.is_empty() {
        return Ok(written);
    }
    let mut text = "BEGIN CONFIG.CMA MM\n".to_owned();
    let names: Vec<String> = inputs.iter().map(ToString::to_string).collect();
    row(
        &mut text,
        &[&["NR".to_owned(), "ACTIVE".to_owned()][..], &names].concat(),
    );
    let files: Vec<String> = inputs.iter().map(|axis| format!("AXIS_{axis}")).collect();
    row(
        &mut text,
        &[&["0".to_owned(), "*".to_owned()][..], &files].concat(),
    );
    text += "[END]\n";
    written.files.push(TextFile {
        name: "CONFIG.CMA".to_owned(),
        text,
    });
    if !averaged.is_empty() {
        written.notes.push(format!("in the mean of both directions, as a .COM has one column of values after negative motion: {}", averaged.join(", ")));
    }
    Ok(written)
}

fn row(text: &mut String, cells: &[String]) {
    let mut line = String::new();
    for cell in cells {
        // Writing to a string does not fail.
        let _ = write!(line, "{cell:<14}");
    }
    text.push_str(line.trim_end());
    text.push('\n');
}

pub(crate) fn write_itnc530(
    tables: &[AxisTable],
    format: Format,
) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    let (mut crossed, mut averaged) = (Vec::new(), Vec::new());
    for table in tables {
        if !table.is_own() {
            crossed.push(format!("{} over {}", table.output, table.input));
            continue;
        }
        check(format, table)?;
        let (first, spacing) = even(format, table)?;
        let values: Vec<f64> = table
            .mean()
            .iter()
            .map(|value| table.output_at_edge(*value))
            .collect();
        if format == Format::HeidenhainTnc407 {
            if let Some(expected) = spacing_refused_by_tnc407(spacing) {
                return Err(unfit(
                    format,
                    table,
                    format!("a spacing of {spacing}"),
                    expected,
                ));
            }
            let steepest = values
                .windows(2)
                .map(|pair| (pair[1] - pair[0]).abs())
                .fold(0.0, f64::max);
            if steepest > spacing / 64.0 {
                let found = format!("a change of {steepest} from line to line");
                return Err(unfit(
                    format,
                    table,
                    found,
                    format!("{} at the most, a 64th of the spacing", spacing / 64.0),
                ));
            }
        }
        if table.backward.is_some() {
            averaged.push(table.input.to_string());
        }
        let input = table.input;
        let mut text = format!(
            "BEGIN AXIS-{input}.COM  DATUM:{} DISTANCE:{}\nNR    POSITION      {input}\n",
            signed(first, DECIMALS),
            signed(spacing, DECIMALS)
        );
        for (place, (at, value)) in edge_of(table).zip(values).enumerate() {
            let _ = writeln!(
                text,
                "{place:<5} {:<13} {}",
                signed(at, DECIMALS),
                signed(value, DECIMALS)
            );
        }
        text += "[END]\n";
        written.files.push(TextFile {
            name: format!("AXIS-{input}.COM"),
            text,
        });
    }
    if !crossed.is_empty() {
        written.notes.push(format!(
            "left out, as the form of a .COM with more columns is not known: {}",
            crossed.join(", ")
        ));
    }
    if !averaged.is_empty() {
        written.notes.push(format!(
            "in the mean of both directions: {}",
            averaged.join(", ")
        ));
    }
    Ok(written)
}

/// The lines of a file without those that are empty, with their numbers.
fn lines(file: &TextFile) -> impl Iterator<Item = (usize, &str)> {
    let lines = file.text.lines().enumerate();
    lines
        .map(|(index, line)| (index + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty())
}

/// `AXIS_X.COM`, `AXIS-X.COM`: the letter.
fn axis_in(name: &str) -> Option<AxisName> {
    let stem = name.split('.').next()?.to_ascii_uppercase();
    stem.rsplit(['_', '-']).next()?.parse().ok()
}

/// The word behind BEGIN.
fn begin<'a>(
    file: &'a TextFile,
    line: Option<&(usize, &'a str)>,
) -> Result<&'a str, ExchangeError> {
    let found = line.map_or("", |(_, text)| *text);
    let name = found
        .strip_prefix("BEGIN ")
        .and_then(|rest| rest.split_whitespace().next());
    name.ok_or_else(|| {
        let number = line.map_or(1, |(number, _)| *number);
        LineError::at(
            file,
            number,
            volcomp_document::quoted(found),
            "BEGIN and the name of the table",
        )
    })
}

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
    let stem = name.split('.').next().unwrap_or(name).to_ascii_uppercase();
    let input = match assigned {
        Some(Assigned(pairs)) => {
            let Some((axis, _)) = pairs
                .iter()
                .find(|(_, table)| table.split('.').next() == Some(stem.as_str()))
            else {
                warnings.push(Warning::whole(
                    file,
                    "the active line of the .CMA does not name it: left out",
                ));
                return Ok(Vec::new());
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
    };
    if all.first().is_some_and(|(_, line)| line.contains("DATUM:")) {
        return Err(LineError::at(
            file,
            1,
            "DATUM",
            "a table of a TNC 640; this one is of an iTNC 530 (--format heidenhain-itnc530)",
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
    let mut positions: Vec<f64> = Vec::new();
    let mut backlash = Vec::new();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); outputs.len()];
    let mut ends = false;
    for (line, text) in all.iter().skip(2) {
        if *text == "[END]" {
            ends = true;
            break;
        }
        let cells: Vec<&str> = text.split_whitespace().collect();
        if cells.len() != names.len() {
            return Err(LineError::at(
                file,
                *line,
                format!("{} cells", cells.len()),
                format!("{} as in the line of names", names.len()),
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
            return Err(LineError::at(file, *line, "a line 257", "256 at the most"));
        }
        positions.push(at);
        if has_backlash {
            backlash.push(deviation_from_edge(input, cell(2)?));
        }
        let from = if has_backlash { 3 } else { 2 };
        for (place, (column, output)) in columns.iter_mut().zip(&outputs).enumerate() {
            column.push(deviation_from_edge(*output, cell(from + place)?));
        }
    }
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
    if has_backlash && !outputs.contains(&input) {
        return Err(wrong());
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

/// A table of a rotary axis over 0 to 360 deg repeats.
fn is_turn(axis: AxisName, positions: &[f64]) -> bool {
    let length = positions
        .last()
        .zip(positions.first())
        .map_or(0.0, |(last, first)| last - first);
    axis.is_rotary() && (length - core::f64::consts::TAU).abs() < 1e-6
}

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
            return Err(LineError::at(file, *line, "a line 257", "256 at the most"));
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
