//! HEIDENHAIN TNC 640: `.com` table files and `.cma` assignment files.

use core::{f64::consts::TAU, fmt::Write};
use std::borrow::Cow;

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisName, Direction, brought_into};

use super::options::Written;
use super::table::{AxisTable, from_file_unit};
use super::text::{ExchangeError, Format, TextFile, Warning, number, signed};

const MAX_LINES: usize = 256;
/// Decimals of lengths and angles in mm and deg, as in known files.
const DECIMALS: usize = 4;

/// Non-empty lines of a file with their line numbers, from 1.
fn lines(file: &TextFile) -> impl Iterator<Item = (usize, &str)> {
    let lines = file.text.lines().enumerate();
    lines.map(|(index, line)| (index + 1, line.trim())).filter(|(_, line)| !line.is_empty())
}

/// Axis letter in a file name such as `AXIS_X.COM` or `AXIS-X.COM`; `None` for other names.
fn axis_in(name: &str) -> Option<AxisName> {
    let stem = name.split('.').next()?.to_ascii_uppercase();
    stem.rsplit(['_', '-']).next()?.parse().ok()
}

fn begin<'a>(
    file: &'a TextFile,
    line: Option<&(usize, &'a str)>,
) -> Result<&'a str, ExchangeError> {
    let found = line.map_or("", |(_, text)| *text);
    let name = found.strip_prefix("BEGIN ").and_then(|rest| rest.split_whitespace().next());
    name.ok_or_else(|| {
        let here = file.at(line.map_or(1, |(number, _)| *number));
        here.error(quoted(found), "BEGIN and the name of the table")
    })
}

/// Content of a `.cma` file: the table name of each input axis.
struct TableAssignment(Vec<(AxisName, String)>);

fn read_cma(file: &TextFile) -> Result<TableAssignment, ExchangeError> {
    let all: Vec<(usize, &str)> = lines(file).collect();
    begin(file, all.first())?;
    let Some((line, head)) = all.get(1) else {
        let whole = file.whole();
        return Err(whole.error("no line of column names", "NR ACTIVE X Y Z"));
    };
    let names: Vec<&str> = head.split_whitespace().collect();
    let is_axis = |name: &str| name.parse::<AxisName>().is_ok();
    if names.first() != Some(&"NR")
        || names.get(1) != Some(&"ACTIVE")
        || !names.iter().skip(2).all(|name| is_axis(name))
    {
        return Err(file.at(*line).error(quoted(head), "NR ACTIVE and axes"));
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
            let found = format!("{} cells", cells.len());
            return Err(file.at(*line).error(found, names.len().to_string()));
        }
        let pairs = names.iter().zip(&cells).skip(2);
        let assigned = pairs
            .filter_map(|(axis, table)| Some((axis.parse().ok()?, table.to_ascii_uppercase())));
        return Ok(TableAssignment(assigned.collect()));
    }
    let whole = file.whole();
    Err(whole.error("no active line", "one with * in the column ACTIVE"))
}

pub(crate) fn read_tnc640(
    files: &[&TextFile],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let is_cma = |file: &&&TextFile| file.base().to_ascii_uppercase().ends_with(".CMA");
    let assigned = files.iter().find(is_cma).map(|file| read_cma(file));
    let assigned = assigned.transpose()?;
    let mut tables: Vec<AxisTable> = Vec::new();
    for file in files.iter().filter(|file| !is_cma(file)) {
        for table in read_com(file, assigned.as_ref(), warnings)? {
            if tables.iter().any(|known| known.title() == table.title()) {
                let found = format!("a second {}", table.title());
                return Err(file.whole().error(found, "one"));
            }
            tables.push(table);
        }
    }
    Ok(tables)
}

fn read_com(
    file: &TextFile,
    assigned: Option<&TableAssignment>,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let all: Vec<(usize, &str)> = lines(file).collect();
    let name = begin(file, all.first())?;
    let Some(input) = input_of(file, name, assigned, warnings)? else {
        return Ok(Vec::new());
    };
    let head = columns_of(file, input, &all)?;
    let Rows { positions, backlash, columns, ends } = rows_of(file, input, &head, &all)?;
    let Columns { outputs, has_backlash, .. } = head;
    if !ends {
        warnings.push(file.whole().warning("no [END]: is the file complete?"));
    }
    if has_backlash
        && backlash.iter().all(|value| *value == 0.0)
        && columns.iter().flatten().any(|value| *value != 0.0)
    {
        let text = "BACKLASH is 0 everywhere: read as no deviation after negative motion";
        warnings.push(file.whole().warning(text));
    }
    let tables: Vec<AxisTable> = outputs
        .into_iter()
        .zip(columns)
        .map(|(output, forward)| {
            let mut table = AxisTable {
                input,
                output,
                positions: positions.clone(),
                forward,
                backward: (has_backlash && output == input).then(|| backlash.clone()),
                modulo: false,
            };
            table.modulo = is_turn(&table);
            table
        })
        .collect();
    match tables.iter().find_map(AxisTable::refusal) {
        Some(refusal) => Err(file.whole().error(refusal, "a complete table")),
        None => Ok(tables),
    }
}

/// Input axis of a table file, from the `.cma` file or from the file name; `None` if the `.cma` file does not name the table.
fn input_of(
    file: &TextFile,
    name: &str,
    assigned: Option<&TableAssignment>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<AxisName>, ExchangeError> {
    let Some(TableAssignment(pairs)) = assigned else {
        let axis = axis_in(name).ok_or_else(|| {
            file.at(1).error(
                format!("the table `{name}`"),
                "a name such as AXIS_X.COM, or the .CMA that names it",
            )
        });
        return axis.map(Some);
    };
    let stem = name.split('.').next().unwrap_or(name).to_ascii_uppercase();
    let mut pairs = pairs.iter();
    let named = pairs.find(|(_, table)| table.split('.').next() == Some(stem.as_str()));
    if named.is_none() {
        let text = "the active line of the .CMA does not name this table: left out";
        warnings.push(file.whole().warning(text));
    }
    Ok(named.map(|(axis, _)| *axis))
}

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
    let (here, first) = (file.at(1), all.first().map_or("", |(_, line)| line));
    if first.contains("DATUM:") {
        return Err(here.error("DATUM", "a table of a TNC 640; this one is of an iTNC 530"));
    }
    if first.split_whitespace().any(|word| word == "INCH") {
        return Err(here.error("INCH", "MM"));
    }
    let Some((head_line, head)) = all.get(1) else {
        let whole = file.whole();
        return Err(whole.error("no line of column names", "NR AXISPOS and axes"));
    };
    let names: Vec<&str> = head.split_whitespace().collect();
    let here = file.at(*head_line);
    let wrong = || here.error(quoted(head), "NR AXISPOS, BACKLASH or not, and axes");
    if names.first() != Some(&"NR") || names.get(1) != Some(&"AXISPOS") {
        return Err(wrong());
    }
    let has_backlash = names.get(2) == Some(&"BACKLASH");
    let outputs = names.iter().skip(if has_backlash { 3 } else { 2 });
    let outputs: Vec<AxisName> =
        outputs.map(|name| name.parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
    if outputs.is_empty()
        || (1..outputs.len()).any(|place| outputs[..place].contains(&outputs[place]))
        || has_backlash && !outputs.contains(&input)
    {
        return Err(wrong());
    }
    Ok(Columns { outputs, has_backlash, cells: names.len() })
}

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
    let mut rows = Rows { columns: vec![Vec::new(); head.outputs.len()], ..Rows::default() };
    for (line, text) in all.iter().skip(2) {
        let here = file.at(*line);
        if *text == "[END]" {
            rows.ends = true;
            break;
        }
        let cells: Vec<&str> = text.split_whitespace().collect();
        if cells.len() != head.cells {
            let expected = format!("{} as in the line of names", head.cells);
            return Err(here.error(format!("{} cells", cells.len()), expected));
        }
        let cell = |place: usize| -> Result<f64, ExchangeError> {
            let text = cells.get(place).copied().unwrap_or("");
            number(text).ok_or_else(|| here.error(quoted(text), "a number"))
        };
        let at = from_file_unit(input, cell(1)?);
        if rows.positions.last().is_some_and(|last| *last >= at) {
            return Err(here.error("a position that does not increase", "increasing positions"));
        }
        if rows.positions.len() == MAX_LINES {
            return Err(here.too_many(MAX_LINES));
        }
        rows.positions.push(at);
        if head.has_backlash {
            rows.backlash.push(from_file_unit(input, cell(2)?));
        }
        let from = if head.has_backlash { 3 } else { 2 };
        for (place, (column, output)) in rows.columns.iter_mut().zip(&head.outputs).enumerate() {
            column.push(from_file_unit(*output, cell(from + place)?));
        }
    }
    Ok(rows)
}

/// Angles that differ by less are treated as equal, rad.
const SAME_RAD: f64 = 1e-8;

const WITHIN_A_TURN: &str = "a table over a rotary axis holds 0 to 360 deg";

/// Reason for leaving out full-turn tables whose two ends deviate differently.
const IN_TWO: &str = "a table over a rotary axis holds 0 to 360 deg, and its two ends, which are one position there, deviate differently";

#[derive(Default)]
struct AcceptedTables<'a> {
    tables: Vec<Cow<'a, AxisTable>>,
    /// Axes whose full-turn tables were shifted to 0 … 360 deg.
    wrapped: Vec<AxisName>,
    beyond: Vec<&'a AxisTable>,
    in_two: Vec<&'a AxisTable>,
}

impl<'a> AcceptedTables<'a> {
    fn new(tables: impl IntoIterator<Item = &'a AxisTable>) -> Self {
        let all: Vec<&AxisTable> = tables.into_iter().collect();
        let over = |input: AxisName| all.iter().copied().filter(move |of| of.input == input);
        let mut accepted = Self::default();
        for &table in &all {
            let input = table.input;
            if over(input).all(is_within_a_turn) {
                accepted.tables.push(Cow::Borrowed(table));
            } else if !over(input).all(is_turn) {
                accepted.beyond.push(table);
            } else if !over(input).all(closes) {
                accepted.in_two.push(table);
            } else {
                accepted.tables.push(Cow::Owned(wrapped(table)));
                if !accepted.wrapped.contains(&input) {
                    accepted.wrapped.push(input);
                }
            }
        }
        accepted
    }

    fn add_notes(&self, written: &mut Written) {
        written.leave_out(WITHIN_A_TURN, &self.beyond);
        written.leave_out(IN_TWO, &self.in_two);
        if !self.wrapped.is_empty() {
            let axes: Vec<String> = self.wrapped.iter().map(ToString::to_string).collect();
            written.notes.push(format!(
                "written from 0 to 360 deg, as a table over a rotary axis holds no others: at a negative position the control has to take the value \
                 a turn further on, which is unproven: {}",
                axes.join(", ")
            ));
        }
    }
}

fn is_within_a_turn(table: &AxisTable) -> bool {
    let positions = &table.positions;
    !table.input.is_rotary()
        || (positions.first().is_none_or(|at| *at >= -SAME_RAD)
            && positions.last().is_none_or(|at| *at <= TAU + SAME_RAD))
}

/// Whether the table of a rotary axis spans 360 deg, so that it repeats.
fn is_turn(table: &AxisTable) -> bool {
    let ends = table.positions.last().zip(table.positions.first());
    let length = ends.map_or(0.0, |(last, first)| last - first);
    table.input.is_rotary() && (length - TAU).abs() < 1e-6
}

/// Whether the values at both ends agree within half a digit of the file.
fn closes(table: &AxisTable) -> bool {
    let half_a_digit = 0.5 * 10.0_f64.powi(-i32::try_from(DECIMALS).unwrap_or(0));
    let mut both_directions = [Some(&table.forward), table.backward.as_ref()].into_iter().flatten();
    both_directions.all(|values| {
        let ends = values.first().zip(values.last());
        ends.is_none_or(|(a, b)| table.output_in_file_unit(a - b).abs() <= half_a_digit)
    })
}

/// Shifts a full-turn table to 0 … 360 deg. It keeps its nodes if one of them is at 0 or the spacing is uneven; otherwise it is resampled
/// from 0 with the same spacing.
fn wrapped(table: &AxisTable) -> AxisTable {
    let turn = AxisTable { modulo: true, ..table.clone() };
    let mut positions: Vec<f64> = if let Some(spacing) = table.spacing() {
        // Multiples of the spacing from 0; except for rounding they are existing nodes if one node is at 0.
        let inner = 1..table.positions.len().saturating_sub(1);
        inner.map(|place| spacing * place as f64).collect()
    } else {
        let each = table.positions.iter();
        each.map(|at| brought_into([0.0, TAU], TAU, *at)).collect()
    };
    positions.extend([0.0, TAU]);
    positions.sort_by(f64::total_cmp);
    positions.dedup_by(|next, before| *next - *before < SAME_RAD);
    if let Some(last) = positions.last_mut() {
        *last = TAU;
    }
    let along = |direction: Direction| -> Vec<f64> {
        let mut values: Vec<f64> =
            positions.iter().map(|at| turn.deviation(*at, Some(direction))).collect();
        if let [first, .., last] = values.as_mut_slice() {
            *last = *first;
        }
        values
    };
    let forward = along(Direction::Positive);
    let backward = table.backward.is_some().then(|| along(Direction::Negative));
    AxisTable { positions, forward, backward, ..turn }
}

pub(crate) fn write_tnc640(tables: &[AxisTable]) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    let accepted = AcceptedTables::new(tables);
    accepted.add_notes(&mut written);
    let tables = &accepted.tables;
    let mut inputs: Vec<AxisName> = tables.iter().map(|table| table.input).collect();
    inputs.sort_unstable_by_key(|axis| axis.index());
    inputs.dedup();
    let mut averaged = Vec::new();
    for &input in &inputs {
        let mut of: Vec<&AxisTable> = tables
            .iter()
            .map(AsRef::as_ref)
            .filter(|table: &&AxisTable| table.input == input)
            .collect();
        of.sort_by_key(|table| table.output.index());
        for table in &of {
            let not_representable = |found: String, expected: String| {
                ExchangeError::not_representable(
                    Format::HeidenhainTnc640,
                    table.title(),
                    found,
                    expected,
                )
            };
            let count = table.positions.len();
            if count > MAX_LINES {
                let expected = format!("at most {MAX_LINES}: use a larger step");
                return Err(not_representable(format!("{count} positions"), expected));
            }
            if of[0].positions != table.positions {
                let expected = format!("those of the other tables over {input}");
                return Err(not_representable("other positions".to_owned(), expected));
            }
            if table.backward.is_some() && !table.is_own() {
                averaged.push(format!("{} over {}", table.output, table.input));
            }
        }
        let Some(first) = of.first() else { continue };
        let own = of.iter().find(|table| table.is_own());
        let backlash = own.and_then(|table| table.backward.as_ref().map(|b| (*table, b)));
        let mut text = format!("BEGIN AXIS_{input}.COM MM\n");
        let mut head = vec!["NR".to_owned(), "AXISPOS".to_owned()];
        if backlash.is_some() {
            head.push("BACKLASH".to_owned());
        }
        head.extend(of.iter().map(|table| table.output.to_string()));
        row(&mut text, &head);
        let columns: Vec<Vec<f64>> = of
            .iter()
            .map(|table| if table.is_own() { table.forward.clone() } else { table.mean() })
            .collect();
        for (place, at) in first.positions_in_file_unit().enumerate() {
            let mut cells = vec![place.to_string(), signed(at, DECIMALS)];
            if let Some((table, values)) = backlash {
                cells.push(signed(table.output_in_file_unit(values[place]), DECIMALS));
            }
            let values = of.iter().zip(&columns);
            cells.extend(
                values.map(|(table, column)| {
                    signed(table.output_in_file_unit(column[place]), DECIMALS)
                }),
            );
            row(&mut text, &cells);
        }
        text += "[END]\n";
        written.files.push(TextFile { name: format!("AXIS_{input}.COM"), text });
    }
    if inputs.is_empty() {
        return Ok(written);
    }
    let mut text = "BEGIN CONFIG.CMA MM\n".to_owned();
    let names: Vec<String> = inputs.iter().map(ToString::to_string).collect();
    let mut line = |a: &str, b: &str, rest: &[String]| {
        row(&mut text, &[&[a.to_owned(), b.to_owned()], rest].concat());
    };
    line("NR", "ACTIVE", &names);
    let files: Vec<String> = inputs.iter().map(|axis| format!("AXIS_{axis}")).collect();
    line("0", "*", &files);
    text += "[END]\n";
    written.files.push(TextFile { name: "CONFIG.CMA".to_owned(), text });
    if !averaged.is_empty() {
        written.notes.push(format!("mean of both directions, because a .COM file has one column of values after negative motion: {}", averaged.join(", ")));
    }
    Ok(written)
}

fn row(text: &mut String, cells: &[String]) {
    let mut line = String::new();
    for cell in cells {
        let _ = write!(line, "{cell:<14}");
    }
    text.push_str(line.trim_end());
    text.push('\n');
}
