//! FANUC pitch error compensation as a parameter file: increments between consecutive points, in detection units.

use core::fmt::Write;
use std::collections::BTreeMap;

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisName, Displacement};

use super::options::{ReadOptions, WriteOptions, Written};
use super::table::{AxisTable, from_file_unit};
use super::text::{ExchangeError, FilePosition, Format, TextFile, Warning, number, short, whole};

/// Parameter number of point 0: the value of point n is in N(10000 + n). Not verified against a FANUC manual.
const DATA: u32 = 10_000;

#[derive(Default)]
struct Records {
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
        let mut found = Records::default();
        for (index, line) in file.text.split(['\n', '\r']).enumerate() {
            let text = line.trim().trim_end_matches(';').trim();
            if text.is_empty() || text == "%" {
                continue;
            }
            record(file.at(index + 1), text, &mut found)?;
        }
        for (number, parameters) in &found.axes {
            let has = |wanted: u32| parameters.contains_key(&wanted);
            if !(has(3621) && has(3622) && has(3624)) {
                continue;
            }
            let last = parameters.values().map(|(_, line)| *line).max();
            let here = file.at(last.unwrap_or(1));
            let axis = options.axes.axis(*number).ok_or_else(|| {
                here.error(
                    format!("axis number {number}"),
                    format!("the letter of this number: --axis-numbers X={number}"),
                )
            })?;
            let reader =
                Reader { here, parameters, data: &found.data, unit: options.detection_unit };
            let Some(table) = reader.table(axis, warnings)? else {
                continue;
            };
            if tables.iter().any(|known| known.input == axis) {
                return Err(here.error(format!("a second table of {axis}"), "one"));
            }
            tables.push(table);
        }
    }
    Ok(tables)
}

/// Reads a record such as `N03620A1P10A2P20` or `N10000P-3`.
fn record(here: FilePosition<'_>, text: &str, found: &mut Records) -> Result<(), ExchangeError> {
    let wrong = || here.error(quoted(text), "a record such as N03620A1P10 or N10000P-3");
    let rest = text.strip_prefix('N').ok_or_else(wrong)?;
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    let (parameter, mut rest) = rest.split_at(digits);
    let parameter: u32 = parameter.parse().map_err(|_| wrong())?;
    while !rest.is_empty() {
        let (kind, behind) = rest.split_at_checked(1).ok_or_else(wrong)?;
        let (axis, value) = match kind {
            "P" => (None, behind),
            "A" | "S" | "T" | "L" => {
                let (axis, value) = behind.split_once('P').ok_or_else(wrong)?;
                let axis: u16 = axis.parse().map_err(|_| wrong())?;
                (Some((kind, axis)), value)
            }
            _ => return Err(wrong()),
        };
        let length = value
            .bytes()
            .take_while(|b| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.'))
            .count();
        let (value, behind) = value.split_at(length);
        let size = number(value).ok_or_else(wrong)?;
        match axis {
            Some(("A", axis)) if (3600..3700).contains(&parameter) => {
                let parameters = found.axes.entry(axis).or_default();
                parameters.insert(parameter, (value.to_owned(), here.line.unwrap_or(1)));
            }
            None if (DATA..DATA + 10_000).contains(&parameter) => {
                let steps = whole(size).ok_or_else(wrong)?;
                found.data.insert(parameter - DATA, steps);
            }
            // Other parameters are skipped, because a file contains all parameters of the control.
            _ => {}
        }
        rest = behind;
    }
    Ok(())
}

struct Extent {
    first: u32,
    last: u32,
    reference: u32,
    interval: f64,
}

struct Reader<'a> {
    here: FilePosition<'a>,
    parameters: &'a BTreeMap<u32, (String, usize)>,
    data: &'a BTreeMap<u32, i64>,
    unit: f64,
}

impl Reader<'_> {
    fn real(&self, parameter: u32) -> Option<f64> {
        number(self.text(parameter))
    }

    fn text(&self, parameter: u32) -> &str {
        self.parameters.get(&parameter).map_or("", |(text, _)| text)
    }

    fn point(&self, parameter: u32) -> Option<u32> {
        let point = self.real(parameter).and_then(whole)?;
        u32::try_from(point).ok().filter(|point| *point < 10_000)
    }

    /// Points of an axis; `None` if it has none.
    fn extent(
        &self,
        axis: AxisName,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<Extent>, ExchangeError> {
        let interval = self.real(3624).unwrap_or(0.0);
        let (Some(first), Some(last)) = (self.point(3621), self.point(3622)) else {
            let found = "no number of a point in 3621 or 3622";
            return Err(self.here.error(found, "0 to 9999"));
        };
        if interval == 0.0 || first == last {
            let text = format!("axis {axis}: no interval or no points: left out");
            warnings.push(self.here.warning(text));
            return Ok(None);
        }
        let reference = self.point(3620).unwrap_or(first);
        if interval < 0.0 || first > last || !(first..=last).contains(&reference) {
            let found =
                format!("points {first} to {last}, reference {reference}, interval {interval}");
            return Err(self.here.error(
                found,
                "the reference between the first point and the last, and an interval above 0",
            ));
        }
        if !self.text(3624).contains('.') {
            let text = format!(
                "axis {axis}: the interval {interval} has no decimal point: taken as mm or deg, older controls mean least input increments"
            );
            warnings.push(self.here.warning(text));
        }
        Ok(Some(Extent { first, last, reference, interval }))
    }

    fn table(
        &self,
        axis: AxisName,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<AxisTable>, ExchangeError> {
        let Some(Extent { first, last, reference, interval }) = self.extent(axis, warnings)? else {
            return Ok(None);
        };
        let magnification = self.real(3623).filter(|m| *m > 0.0).unwrap_or(1.0);
        let place = (reference - first) as usize;
        let summed = |from: u32| -> Vec<i64> {
            let mut sum = 0;
            let mut sums: Vec<i64> = (from..=from + (last - first))
                .map(|point| {
                    let step = self.data.get(&point).copied().unwrap_or(0);
                    sum += step.clamp(-1_000_000, 1_000_000);
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
            each.map(|edge| from_file_unit(axis, edge)).collect()
        };
        let is_missing = |point: &u32| !self.data.contains_key(point);
        let missing = (first..=last).filter(is_missing).count();
        if missing > 0 {
            warnings.push(
                self.here.warning(format!("axis {axis}: {missing} points are missing: read as 0")),
            );
        }
        let backward = match (self.text(3605).ends_with('1'), self.point(3626)) {
            (false, _) => None,
            (true, Some(from)) => Some(deviations(summed(from), self.real(3627).unwrap_or(0.0))),
            (true, None) => {
                return Err(self
                    .here
                    .error("3605#0 is 1 without 3626", "the first point for negative motion"));
            }
        };
        let at =
            |point: u32| from_file_unit(axis, interval * (f64::from(point) - f64::from(reference)));
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

const FORMAT: Format = Format::Fanuc;
/// Maximum number of points: N10000 to N19999.
const MAX_POINTS: usize = 10_000;
/// Maximum magnitude of an increment on a control with the option for larger ones. Not verified against a FANUC manual.
const MAX_INCREMENT: i64 = 127;
/// Maximum magnitude of an increment on every control. Not verified against a FANUC manual.
const MAX_STANDARD_INCREMENT: i64 = 7;

struct Points {
    axis: u16,
    reference: u32,
    first: u32,
    last: u32,
    interval: f64,
    turn: f64,
    /// Number of the first point for negative motion, and the value at the reference position after negative motion:
    /// forward deviation − backward deviation, in detection units. `None`: both directions share their points.
    negative: Option<(u32, i64)>,
}

#[derive(Default)]
struct PitchData {
    axes: Vec<Points>,
    /// Number of each point, and its pitch error increment.
    data: Vec<(u32, i64)>,
    next: u32,
    /// Axes with increments above [`MAX_STANDARD_INCREMENT`], which not every control accepts.
    wide: Vec<AxisName>,
    offsets: Vec<String>,
}

fn not_representable(
    table: &AxisTable,
    found: impl Into<String>,
    expected: impl Into<String>,
) -> ExchangeError {
    ExchangeError::not_representable(FORMAT, format!("axis {}", table.input), found, expected)
}

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    if !(options.detection_unit > 0.0 && options.detection_unit.is_finite()) {
        return Err(ExchangeError::option(
            "--detection-unit",
            &options.detection_unit,
            "a number above 0",
        ));
    }
    let mut written = Written::default();
    let mut crossed = Vec::new();
    let mut data = PitchData::default();
    for table in tables {
        if table.is_own() {
            data.add_table(table, options)?;
        } else {
            crossed.push(table);
        }
    }
    let why = "pitch error compensation corrects its own axis alone";
    written.leave_out(why, &crossed);
    if data.axes.is_empty() {
        return Ok(written);
    }
    data.axes.sort_by_key(|points| points.axis);
    written
        .files
        .push(TextFile { name: "PITCH.TXT".to_owned(), text: text(&data.axes, &data.data) });
    written.notes.push(format!(
        "detection unit {} mm or deg, magnification 1",
        short(options.detection_unit, 9)
    ));
    if !data.offsets.is_empty() {
        written.notes.push(format!(
            "the deviation at the reference position is taken as 0: {}",
            data.offsets.join(", ")
        ));
    }
    if !data.wide.is_empty() {
        let names: Vec<String> = data.wide.iter().map(ToString::to_string).collect();
        written.notes.push(format!(
            "steps beyond -{MAX_STANDARD_INCREMENT} to {MAX_STANDARD_INCREMENT} on {}: a control takes them by option only (from memory, unproven)",
            names.join(", ")
        ));
    }
    Ok(written)
}

impl PitchData {
    fn add_table(
        &mut self,
        table: &AxisTable,
        options: &WriteOptions,
    ) -> Result<(), ExchangeError> {
        let Some(axis) = options.axes.number(table.input) else {
            let name = table.input;
            let expected = format!("its number in the control: --axis-numbers {name}=1");
            return Err(not_representable(table, "no number", expected));
        };
        let (low, interval) = table.even(FORMAT)?;
        let count = table.positions.len();
        let reference = reference_of(table, low, interval)?;
        let base = table.forward[reference];
        if base.abs() > 1e-6 {
            // mm to µm, rad to µrad.
            let micro = base * Displacement::new(table.output.kind(), 1.0).um_or_urad();
            let micro = short(micro, 2);
            self.offsets.push(format!("{} {micro} µm or µrad", table.input));
        }
        let counted = |values: &[f64]| -> Result<Vec<i64>, ExchangeError> {
            let units = values.iter().map(|value| {
                let units =
                    (base - value) * table.output_in_file_unit(1.0) / options.detection_unit;
                whole(units)
                    .ok_or_else(|| not_representable(table, units.to_string(), "a smaller number"))
            });
            units.collect()
        };
        let sets = 1 + usize::from(table.backward.is_some());
        if self.next as usize + sets * count > MAX_POINTS {
            let found = format!("{count} points more");
            let expected = format!("at most {MAX_POINTS} for all axes together");
            return Err(not_representable(table, found, expected));
        }
        let first = self.add_points(table, &counted(&table.forward)?)?;
        let last = self.next - 1;
        let mut negative = None;
        if let Some(backward) = &table.backward {
            let units = counted(backward)?;
            negative = Some((self.add_points(table, &units)?, units[reference]));
        }
        self.axes.push(Points {
            axis,
            reference: first + u32::try_from(reference).unwrap_or(0),
            first,
            last,
            interval,
            turn: if table.modulo { interval * (count - 1) as f64 } else { 0.0 },
            negative,
        });
        Ok(())
    }

    /// Stores cumulative values as increments between points. Returns the number of the first point.
    fn add_points(&mut self, table: &AxisTable, units: &[i64]) -> Result<u32, ExchangeError> {
        let first = self.next;
        let steps = std::iter::once(0).chain(units.windows(2).map(|pair| pair[1] - pair[0]));
        for step in steps {
            if step.abs() > MAX_INCREMENT {
                let found = format!("a step of {step} detection units from point to point");
                let expected = format!("at most {MAX_INCREMENT}: use a smaller step");
                return Err(not_representable(table, found, expected));
            }
            if step.abs() > MAX_STANDARD_INCREMENT && self.wide.last() != Some(&table.input) {
                self.wide.push(table.input);
            }
            self.data.push((self.next, step));
            self.next += 1;
        }
        Ok(first)
    }
}

/// Index of the node at machine zero, which is the reference position.
fn reference_of(table: &AxisTable, low: f64, interval: f64) -> Result<usize, ExchangeError> {
    let place = (0.0 - low) / interval;
    let count = table.positions.len();
    let reference = whole(place)
        .filter(|k| (place - *k as f64).abs() < 1e-6)
        .and_then(|k| usize::try_from(k).ok())
        .filter(|k| *k < count);
    reference.ok_or_else(|| {
        let high = low + interval * (count - 1) as f64;
        not_representable(
            table,
            format!("no point at machine zero, between {low} and {high}"),
            "one there, where the reference position is: --at with whole steps from 0",
        )
    })
}

fn text(all: &[Points], data: &[(u32, i64)]) -> String {
    let mut text = String::from("%\n");
    let mut put = |number: u32, of: &dyn Fn(&Points) -> Option<String>| {
        let values: String = all
            .iter()
            .filter_map(|points| Some(format!("A{}P{}", points.axis, of(points)?)))
            .collect();
        if !values.is_empty() {
            let _ = writeln!(text, "N{number:05}{values}");
        }
    };
    put(3605, &|points| Some(format!("{:08}", u8::from(points.negative.is_some()))));
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

/// Formats a number with a decimal point, as in known files: 30.0.
fn real(value: f64) -> String {
    let text = short(value, 9);
    if text.contains('.') { text } else { text + ".0" }
}
