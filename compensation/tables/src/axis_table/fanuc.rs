//! FANUC pitch error compensation as a file of parameters: steps from point to point, in detection units.

use core::fmt::Write;
use std::collections::BTreeMap;

use super::{
    AxisTable, ExchangeError, Format, LineError, ReadOptions, TextFile, Warning, WriteOptions,
    Written,
    exchange::{deviation_from_edge, even},
    text::{number, short, whole},
};

const FORMAT: Format = Format::Fanuc;
/// Where the data begin: N10000 + point, from memory.
const DATA: u32 = 10_000;
/// More points than that have no place in N10000 to N19999.
const MOST_POINTS: usize = 10_000;
/// What a point holds by option, and without it: from memory.
const MOST_STEPS: i64 = 127;
const FEW_STEPS: i64 = 7;

/// The points of one axis.
struct Points {
    axis: u16,
    reference: u32,
    first: u32,
    last: u32,
    interval: f64,
    turn: f64,
    /// The first point for negative motion, and the value at the reference position after it.
    negative: Option<(u32, i64)>,
}

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    let mut crossed = Vec::new();
    let mut all: Vec<Points> = Vec::new();
    let mut data: Vec<(u32, i64)> = Vec::new();
    let mut next = 0_u32;
    let mut is_wide = Vec::new();
    let mut offsets = Vec::new();
    if !(options.detection_unit > 0.0 && options.detection_unit.is_finite()) {
        return Err(ExchangeError::Wish {
            what: "--detection-unit".to_owned(),
            found: options.detection_unit.to_string(),
            expected: "a number above 0".to_owned(),
        });
    }
    for table in tables {
        if !table.is_own() {
            crossed.push(format!("{} over {}", table.output, table.input));
            continue;
        }
        let unfit = |found: String, expected: String| ExchangeError::Unfit {
            format: FORMAT,
            what: format!("axis {}", table.input),
            found,
            expected,
        };
        let Some(axis) = options.axes.number(table.input) else {
            let expected = format!(
                "its number in the control: --axis-numbers {}=1",
                table.input
            );
            return Err(unfit("no number".to_owned(), expected));
        };
        let (low, interval) = even(FORMAT, table)?;
        let count = table.positions.len();
        let place = (0.0 - low) / interval;
        let Some(reference) = whole(place)
            .filter(|k| (place - *k as f64).abs() < 1e-6)
            .and_then(|k| usize::try_from(k).ok())
            .filter(|k| *k < count)
        else {
            return Err(unfit(
                format!(
                    "no point at machine zero, between {low} and {}",
                    low + interval * (count - 1) as f64
                ),
                "one there, where the reference position is: --at with whole steps from 0"
                    .to_owned(),
            ));
        };
        let base = table.forward[reference];
        if base.abs() > 1e-6 {
            offsets.push(format!(
                "{} {} µm or µrad",
                table.input,
                short(base * table_micro(table), 2)
            ));
        }
        let counted = |values: &[f64]| -> Result<Vec<i64>, ExchangeError> {
            let units = values.iter().map(|value| {
                let units = (base - value) * table.output_at_edge(1.0) / options.detection_unit;
                whole(units).ok_or_else(|| unfit(units.to_string(), "a smaller number".to_owned()))
            });
            units.collect()
        };
        let mut put = |units: &[i64], from: u32| -> Result<(), ExchangeError> {
            for (point, step) in (from..)
                .zip(std::iter::once(0).chain(units.windows(2).map(|pair| pair[1] - pair[0])))
            {
                if step.abs() > MOST_STEPS {
                    return Err(unfit(
                        format!("a step of {step} detection units from point to point"),
                        format!("{MOST_STEPS} at the most: take a smaller step"),
                    ));
                }
                if step.abs() > FEW_STEPS && is_wide.last() != Some(&table.input) {
                    is_wide.push(table.input);
                }
                data.push((point, step));
            }
            Ok(())
        };
        let sets = if table.backward.is_some() { 2 } else { 1 };
        if next as usize + sets * count > MOST_POINTS {
            return Err(unfit(
                format!("{count} points more"),
                format!("{MOST_POINTS} of all axes at the most"),
            ));
        }
        let length = u32::try_from(count).unwrap_or(u32::MAX);
        let first = next;
        put(&counted(&table.forward)?, first)?;
        next += length;
        let negative = match &table.backward {
            None => None,
            Some(backward) => {
                let units = counted(backward)?;
                put(&units, next)?;
                let from = next;
                next += length;
                Some((from, units[reference]))
            }
        };
        all.push(Points {
            axis,
            reference: first + u32::try_from(reference).unwrap_or(0),
            first,
            last: first + length - 1,
            interval,
            turn: if table.modulo {
                interval * (count - 1) as f64
            } else {
                0.0
            },
            negative,
        });
    }
    if !crossed.is_empty() {
        written.notes.push(format!(
            "left out, as pitch error compensation corrects its own axis alone: {}",
            crossed.join(", ")
        ));
    }
    if all.is_empty() {
        return Ok(written);
    }
    all.sort_by_key(|points| points.axis);
    written.files.push(TextFile {
        name: "PITCH.TXT".to_owned(),
        text: text(&all, &data),
    });
    written.notes.push(format!(
        "detection unit {} mm or deg, magnification 1",
        short(options.detection_unit, 9)
    ));
    if !offsets.is_empty() {
        written.notes.push(format!(
            "the deviation at the reference position is taken as 0: {}",
            offsets.join(", ")
        ));
    }
    if !is_wide.is_empty() {
        let names: Vec<String> = is_wide.iter().map(ToString::to_string).collect();
        written.notes.push(format!(
            "steps beyond -{FEW_STEPS} to {FEW_STEPS} on {}: a control takes them by option only (from memory, unproven)",
            names.join(", ")
        ));
    }
    Ok(written)
}

/// µm in a mm, µrad in a rad.
fn table_micro(table: &AxisTable) -> f64 {
    volcomp_vocabulary::Displacement::new(table.output.kind(), 1.0).um_or_urad()
}

fn text(all: &[Points], data: &[(u32, i64)]) -> String {
    let mut text = String::from("%\n");
    let mut put = |number: u32, of: &dyn Fn(&Points) -> Option<String>| {
        let values: String = all
            .iter()
            .filter_map(|points| Some(format!("A{}P{}", points.axis, of(points)?)))
            .collect();
        if !values.is_empty() {
            // Writing to a string does not fail.
            let _ = writeln!(text, "N{number:05}{values}");
        }
    };
    put(3605, &|points| {
        Some(format!("{:08}", u8::from(points.negative.is_some())))
    });
    put(3620, &|points| Some(points.reference.to_string()));
    put(3621, &|points| Some(points.first.to_string()));
    put(3622, &|points| Some(points.last.to_string()));
    put(3623, &|_| Some("1".to_owned()));
    put(3624, &|points| Some(real(points.interval)));
    put(3625, &|points| Some(real(points.turn)));
    put(3626, &|points| Some(points.negative?.0.to_string()));
    put(3627, &|points| Some(points.negative?.1.to_string()));
    for (point, step) in data {
        let _ = writeln!(text, "N{:05}P{step}", DATA + point);
    }
    text + "%\n"
}

/// With a decimal point, as 30.0 stands in known files.
fn real(value: f64) -> String {
    let text = short(value, 9);
    if text.contains('.') {
        text
    } else {
        text + ".0"
    }
}

/// What stands in a file: by parameter and axis, and by point.
#[derive(Default)]
struct Found {
    axes: BTreeMap<u16, BTreeMap<u32, (String, usize)>>,
    data: BTreeMap<u32, i64>,
}

pub(crate) fn read(
    files: &[&TextFile],
    options: &ReadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let mut tables: Vec<AxisTable> = Vec::new();
    for file in files {
        let mut found = Found::default();
        for (index, line) in file.text.split(['\n', '\r']).enumerate() {
            let text = line.trim().trim_end_matches(';').trim();
            if text.is_empty() || text == "%" {
                continue;
            }
            record(file, index + 1, text, &mut found)?;
        }
        for (number, parameters) in &found.axes {
            let has = |wanted: u32| parameters.contains_key(&wanted);
            if !(has(3621) && has(3622) && has(3624)) {
                continue;
            }
            let line = parameters
                .values()
                .map(|(_, line)| *line)
                .max()
                .unwrap_or(1);
            let axis = options.axes.axis(*number).ok_or_else(|| {
                LineError::at(
                    file,
                    line,
                    format!("axis number {number}"),
                    format!("the letter of this number: --axis-numbers X={number}"),
                )
            })?;
            let reader = Reader {
                file,
                line,
                parameters,
                data: &found.data,
                unit: options.detection_unit,
            };
            let Some(table) = reader.table(axis, warnings)? else {
                continue;
            };
            if tables.iter().any(|known| known.input == axis) {
                return Err(LineError::at(
                    file,
                    line,
                    format!("a second table of {axis}"),
                    "one",
                ));
            }
            tables.push(table);
        }
    }
    Ok(tables)
}

/// `N03620A1P10A2P20`, `N10000P-3`.
fn record(
    file: &TextFile,
    line: usize,
    text: &str,
    found: &mut Found,
) -> Result<(), ExchangeError> {
    let wrong = || {
        LineError::at(
            file,
            line,
            volcomp_document::quoted(text),
            "a record such as N03620A1P10 or N10000P-3",
        )
    };
    let rest = text.strip_prefix('N').ok_or_else(wrong)?;
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    let (number, mut rest) = rest.split_at(digits);
    let number: u32 = number.parse().map_err(|_| wrong())?;
    while !rest.is_empty() {
        let (kind, behind) = rest.split_at_checked(1).ok_or_else(wrong)?;
        let (axis, value) = match kind {
            "P" => (None, behind),
            "A" | "S" | "T" | "L" => {
                let (axis, value) = behind.split_once('P').ok_or_else(wrong)?;
                (
                    Some((kind, axis.parse::<u16>().map_err(|_| wrong())?)),
                    value,
                )
            }
            _ => return Err(wrong()),
        };
        let length = value
            .bytes()
            .take_while(|b| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.'))
            .count();
        let (value, behind) = value.split_at(length);
        let Some(size) = super::text::number(value) else {
            return Err(wrong());
        };
        match axis {
            Some(("A", axis)) if (3600..3700).contains(&number) => {
                found
                    .axes
                    .entry(axis)
                    .or_default()
                    .insert(number, (value.to_owned(), line));
            }
            None if (DATA..DATA + 10_000).contains(&number) => {
                found
                    .data
                    .insert(number - DATA, whole(size).ok_or_else(wrong)?);
            }
            // Another parameter: files hold all of them.
            _ => {}
        }
        rest = behind;
    }
    Ok(())
}

struct Reader<'a> {
    file: &'a TextFile,
    line: usize,
    parameters: &'a BTreeMap<u32, (String, usize)>,
    data: &'a BTreeMap<u32, i64>,
    unit: f64,
}

impl Reader<'_> {
    fn real(&self, parameter: u32) -> Option<f64> {
        self.parameters
            .get(&parameter)
            .and_then(|(text, _)| number(text))
    }

    fn point(&self, parameter: u32) -> Option<u32> {
        let point = self.real(parameter).and_then(whole)?;
        u32::try_from(point).ok().filter(|point| *point < 10_000)
    }

    fn table(
        &self,
        axis: volcomp_vocabulary::AxisName,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<AxisTable>, ExchangeError> {
        let wrong =
            |found: String, expected: &str| LineError::at(self.file, self.line, found, expected);
        let interval = self.real(3624).unwrap_or(0.0);
        let (Some(first), Some(last)) = (self.point(3621), self.point(3622)) else {
            return Err(wrong(
                "no number of a point in 3621 or 3622".to_owned(),
                "0 to 9999",
            ));
        };
        if interval == 0.0 || first == last {
            warnings.push(Warning::at(
                self.file,
                self.line,
                format!("axis {axis}: no interval or no points: left out"),
            ));
            return Ok(None);
        }
        let reference = self.point(3620).unwrap_or(first);
        if interval < 0.0 || first > last || !(first..=last).contains(&reference) {
            let found =
                format!("points {first} to {last}, reference {reference}, interval {interval}");
            return Err(wrong(
                found,
                "the reference between the first point and the last, and an interval above 0",
            ));
        }
        if !self
            .parameters
            .get(&3624)
            .is_some_and(|(text, _)| text.contains('.'))
        {
            let text = format!(
                "axis {axis}: the interval {interval} has no decimal point: taken as mm or deg, older controls mean least input increments"
            );
            warnings.push(Warning::at(self.file, self.line, text));
        }
        let magnification = self.real(3623).filter(|m| *m > 0.0).unwrap_or(1.0);
        let place = (reference - first) as usize;
        let summed = |from: u32| -> Vec<i64> {
            let mut sum = 0;
            let mut sums: Vec<i64> = (from..=from + (last - first))
                .map(|point| {
                    sum += self
                        .data
                        .get(&point)
                        .copied()
                        .unwrap_or(0)
                        .clamp(-1_000_000, 1_000_000);
                    sum
                })
                .collect();
            let base = sums.get(place).copied().unwrap_or(0);
            sums.iter_mut().for_each(|value| *value -= base);
            sums
        };
        #[expect(clippy::cast_precision_loss, reason = "sums of few small numbers")]
        let deviations = |sums: Vec<i64>, at_reference: f64| -> Vec<f64> {
            let each = sums
                .into_iter()
                .map(|sum| 0.0 - (sum as f64 + at_reference) * magnification * self.unit);
            each.map(|edge| deviation_from_edge(axis, edge)).collect()
        };
        let missing = (first..=last)
            .filter(|point| !self.data.contains_key(point))
            .count();
        if missing > 0 {
            warnings.push(Warning::at(
                self.file,
                self.line,
                format!("axis {axis}: {missing} points stand in no record: read as 0"),
            ));
        }
        let is_both = self
            .parameters
            .get(&3605)
            .is_some_and(|(text, _)| text.ends_with('1'));
        let backward = match (is_both, self.point(3626)) {
            (false, _) => None,
            (true, Some(from)) => Some(deviations(summed(from), self.real(3627).unwrap_or(0.0))),
            (true, None) => {
                return Err(wrong(
                    "3605#0 is 1 without 3626".to_owned(),
                    "the first point for negative motion",
                ));
            }
        };
        let at = |point: u32| {
            AxisTable::input_from_edge(axis, interval * (f64::from(point) - f64::from(reference)))
        };
        let turn = self.real(3625).unwrap_or(0.0);
        Ok(Some(AxisTable {
            input: axis,
            output: axis,
            positions: (first..=last).map(at).collect(),
            forward: deviations(summed(first), 0.0),
            backward,
            modulo: axis.is_rotary()
                && turn > 0.0
                && (interval * f64::from(last - first) - turn).abs() < 1e-6,
        }))
    }
}
