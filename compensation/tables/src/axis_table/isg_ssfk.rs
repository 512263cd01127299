//! ISG kernel and TwinCAT: the axis compensation `kw.ssfk` in 0.1 µm.

use core::fmt::Write;
use std::collections::BTreeMap;

use super::{
    AxisTable, ExchangeError, Format, LineError, ReadOptions, TextFile, Warning, WriteOptions,
    Written,
    exchange::{deviation_from_edge, edge_of},
    text::{number, whole},
};

const FORMAT: Format = Format::IsgSsfk;
/// One step of the numbers, mm or deg.
const STEP: f64 = 1e-4;
/// The number of entries that a kernel has without further ado.
const MOST_ENTRIES: usize = 1500;

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    let mut crossed = Vec::new();
    for table in tables {
        if !table.is_own() {
            crossed.push(table);
            continue;
        }
        let unfit = |found: String, expected: String| ExchangeError::Unfit {
            format: FORMAT,
            what: format!("axis {}", table.input),
            found,
            expected,
        };
        let count = table.positions.len();
        if count > MOST_ENTRIES {
            return Err(unfit(
                format!("{count} positions"),
                format!("{MOST_ENTRIES} at the most: take a larger step"),
            ));
        }
        let Some(axis) = options.axes.number(table.input) else {
            let expected = format!(
                "its number in the control: --axis-numbers {}=1",
                table.input
            );
            return Err(unfit("no number".to_owned(), expected));
        };
        let steps = |value: f64| {
            whole(value / STEP)
                .ok_or_else(|| unfit(value.to_string(), "a smaller number".to_owned()))
        };
        let positions: Vec<i64> = edge_of(table).map(steps).collect::<Result<_, _>>()?;
        if positions.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(unfit(
                "positions closer than 0.1 µm".to_owned(),
                "rising ones".to_owned(),
            ));
        }
        let pitch = positions[1] - positions[0];
        let is_even = positions.windows(2).all(|pair| pair[1] - pair[0] == pitch);
        let mut text = String::new();
        let mut put = |key: &str, value: i64| {
            // Writing to a string does not fail.
            let _ = writeln!(text, "{key:<36} {value}");
        };
        put("kopf.log_achs_nr", axis.into());
        put("kw.ssfk.interval", if is_even { pitch } else { 0 });
        put("kw.ssfk.kw_startpos", positions[0]);
        put(
            "kw.ssfk.kw_nr_max",
            i64::try_from(count).unwrap_or(i64::MAX),
        );
        put("kw.ssfk.bilateral", table.backward.is_some().into());
        put("kw.ssfk.modulo", table.modulo.into());
        for (place, position) in positions.iter().enumerate() {
            if !is_even {
                put(&format!("kw.ssfk.table[{place}].setpoint"), *position);
            }
            put(
                &format!("kw.ssfk.table[{place}].pos"),
                steps(table.output_at_edge(table.forward[place]))?,
            );
            if let Some(backward) = &table.backward {
                put(
                    &format!("kw.ssfk.table[{place}].neg"),
                    steps(table.output_at_edge(backward[place]))?,
                );
            }
        }
        written.files.push(TextFile {
            name: format!("axis-{}.lis", table.input),
            text,
        });
    }
    written.leave_out("the form of kw.crosscomp is not known", &crossed);
    Ok(written)
}

/// What stands in a file about one axis.
#[derive(Default)]
struct Found {
    line: usize,
    numbers: BTreeMap<String, i64>,
    entries: BTreeMap<usize, [Option<i64>; 3]>,
}

pub(crate) fn read(
    files: &[&TextFile],
    options: &ReadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let mut tables: Vec<AxisTable> = Vec::new();
    for file in files {
        let mut found = Found::default();
        for (index, whole_line) in file.text.lines().enumerate() {
            let line = index + 1;
            let text = whole_line.split(['#', ';']).next().unwrap_or("");
            let text = text.split("//").next().unwrap_or("").trim();
            let Some((key, value)) = text.split_once([' ', '\t', '=']) else {
                if text.is_empty() {
                    continue;
                }
                return Err(LineError::at(
                    file,
                    line,
                    volcomp_document::quoted(text),
                    "a key and a number",
                ));
            };
            let key = key.trim();
            let value = value.trim().trim_start_matches('=').trim();
            if key == "kopf.log_achs_nr" && found.numbers.contains_key(key) {
                tables.push(table(file, &found, options, warnings)?);
                found = Found::default();
            }
            let is_ours = key == "kopf.log_achs_nr" || key.starts_with("kw.ssfk.");
            if !is_ours {
                continue;
            }
            let Some(number) = number(value).and_then(whole) else {
                return Err(LineError::at(
                    file,
                    line,
                    volcomp_document::quoted(value),
                    format!("a whole number for {key}"),
                ));
            };
            found.line = line;
            take(&mut found, key, number).map_err(|expected| {
                LineError::at(file, line, format!("the key `{key}`"), expected)
            })?;
        }
        if !found.numbers.is_empty() || !found.entries.is_empty() {
            tables.push(table(file, &found, options, warnings)?);
        }
    }
    if let Some(twice) = (1..tables.len()).find(|place| {
        tables[..*place]
            .iter()
            .any(|known| known.input == tables[*place].input)
    }) {
        return Err(ExchangeError::NoCurves(format!(
            "found two tables of axis {}, expected one",
            tables[twice].input
        )));
    }
    Ok(tables)
}

fn take(found: &mut Found, key: &str, value: i64) -> Result<(), &'static str> {
    let Some(entry) = key.strip_prefix("kw.ssfk.table[") else {
        found.numbers.insert(key.to_owned(), value);
        return Ok(());
    };
    let (place, field) = entry.split_once("].").ok_or("kw.ssfk.table[n].pos")?;
    let place: usize = place
        .trim()
        .parse()
        .map_err(|_| "a whole number in the brackets")?;
    let field = match field {
        "setpoint" => 0,
        "pos" => 1,
        "neg" => 2,
        _ => return Err("setpoint, pos or neg behind the entry"),
    };
    if place >= 100_000 {
        return Err("an entry that a kernel has");
    }
    found.entries.entry(place).or_default()[field] = Some(value);
    Ok(())
}

fn table(
    file: &TextFile,
    found: &Found,
    options: &ReadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<AxisTable, ExchangeError> {
    let line = found.line;
    let get = |key: &str| found.numbers.get(key).copied();
    let Some(number) = get("kopf.log_achs_nr") else {
        return Err(LineError::whole(
            file,
            "no kopf.log_achs_nr",
            "the number of the axis",
        ));
    };
    let axis = u16::try_from(number)
        .ok()
        .and_then(|number| options.axes.axis(number))
        .ok_or_else(|| {
            LineError::whole(
                file,
                format!("axis number {number}"),
                format!("the letter of this number: --axis-numbers X={number}"),
            )
        })?;
    let interval = get("kw.ssfk.interval").unwrap_or(0);
    let is_bilateral = get("kw.ssfk.bilateral").unwrap_or(0) != 0;
    if interval < 0 {
        return Err(LineError::at(
            file,
            line,
            format!("interval {interval}"),
            "0 or more",
        ));
    }
    if let Some(unit) = get("kw.ssfk.unit").filter(|unit| *unit != 0) {
        warnings.push(Warning::whole(
            file,
            format!("kw.ssfk.unit is {unit}, whose meaning is not known: read in 0.1 µm"),
        ));
    }
    let entries = found.entries.len();
    if let Some(stated) =
        get("kw.ssfk.kw_nr_max").filter(|stated| usize::try_from(*stated) != Ok(entries))
    {
        warnings.push(Warning::whole(
            file,
            format!("kw_nr_max is {stated}, and there are {entries} entries: all are read"),
        ));
    }
    let mut read = AxisTable {
        input: axis,
        output: axis,
        positions: Vec::new(),
        forward: Vec::new(),
        backward: is_bilateral.then(Vec::new),
        modulo: get("kw.ssfk.modulo").unwrap_or(0) != 0,
    };
    fill(file, found, interval, &mut read)?;
    match read.refusal() {
        Some(refusal) => Err(LineError::whole(file, refusal, "a whole table")),
        None => Ok(read),
    }
}

/// Puts the entries into a table.
fn fill(
    file: &TextFile,
    found: &Found,
    interval: i64,
    read: &mut AxisTable,
) -> Result<(), ExchangeError> {
    let (axis, line) = (read.input, found.line);
    let start = found
        .numbers
        .get("kw.ssfk.kw_startpos")
        .copied()
        .unwrap_or(0);
    #[expect(clippy::cast_precision_loss, reason = "below 1e15")]
    let edge = |steps: i64| steps as f64 * STEP;
    for (expected, (place, [setpoint, forward, backward])) in found.entries.iter().enumerate() {
        let missing = |what: &str| {
            LineError::at(
                file,
                line,
                format!("no {what} of entry {expected}"),
                "all of it",
            )
        };
        if *place != expected {
            return Err(missing("values"));
        }
        let steps = match (interval, setpoint) {
            (0, Some(setpoint)) => *setpoint,
            (0, None) => return Err(missing("setpoint")),
            (interval, _) => start.saturating_add(
                interval.saturating_mul(i64::try_from(expected).unwrap_or(i64::MAX)),
            ),
        };
        if steps.unsigned_abs() > 1_000_000_000_000 {
            return Err(LineError::at(
                file,
                line,
                format!("a setpoint of {steps}"),
                "one that a machine has",
            ));
        }
        read.positions
            .push(AxisTable::input_from_edge(axis, edge(steps)));
        read.forward.push(deviation_from_edge(
            axis,
            edge(forward.ok_or_else(|| missing("pos"))?),
        ));
        if let Some(values) = &mut read.backward {
            values.push(deviation_from_edge(
                axis,
                edge(backward.ok_or_else(|| missing("neg"))?),
            ));
        }
    }
    Ok(())
}
