//! A file of parameters, as volcomp or a control puts it out.

use std::collections::BTreeMap;

use volcomp_vocabulary::AxisName;

use super::super::{
    AxisTable, ExchangeError, LineError, ReadOptions, TextFile, Warning,
    exchange::deviation_from_edge,
    text::{number, whole},
};
use super::DATA;

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
        let Some(size) = super::super::text::number(value) else {
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

/// The points of an axis, and how far they are apart.
struct Extent {
    first: u32,
    last: u32,
    reference: u32,
    interval: f64,
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

    /// Which points an axis has; `None` where it has none.
    fn extent(
        &self,
        axis: AxisName,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<Extent>, ExchangeError> {
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
        Ok(Some(Extent {
            first,
            last,
            reference,
            interval,
        }))
    }

    fn table(
        &self,
        axis: AxisName,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<AxisTable>, ExchangeError> {
        let Some(Extent {
            first,
            last,
            reference,
            interval,
        }) = self.extent(axis, warnings)?
        else {
            return Ok(None);
        };
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
            for value in &mut sums {
                *value -= base;
            }
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
                return Err(LineError::at(
                    self.file,
                    self.line,
                    "3605#0 is 1 without 3626",
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
