//! The file.

use core::fmt::Write;

use volcomp_vocabulary::AxisName;

use super::super::{
    AxisTable, ExchangeError, Format, TextFile, WriteOptions, Written,
    exchange::even,
    text::{short, whole},
};
use super::DATA;

const FORMAT: Format = Format::Fanuc;
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

/// What was found to be written.
#[derive(Default)]
struct Made {
    axes: Vec<Points>,
    /// Steps by point.
    data: Vec<(u32, i64)>,
    /// The next point that is free.
    next: u32,
    /// Axes with steps that not every control takes.
    wide: Vec<AxisName>,
    /// Deviations at reference positions, in words.
    offsets: Vec<String>,
}

fn unfit(table: &AxisTable, found: String, expected: String) -> ExchangeError {
    ExchangeError::Unfit {
        format: FORMAT,
        what: format!("axis {}", table.input),
        found,
        expected,
    }
}

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    if !(options.detection_unit > 0.0 && options.detection_unit.is_finite()) {
        return Err(ExchangeError::Wish {
            what: "--detection-unit".to_owned(),
            found: options.detection_unit.to_string(),
            expected: "a number above 0".to_owned(),
        });
    }
    let mut written = Written::default();
    let mut crossed = Vec::new();
    let mut made = Made::default();
    for table in tables {
        if table.is_own() {
            made.take(table, options)?;
        } else {
            crossed.push(table);
        }
    }
    written.leave_out(
        "pitch error compensation corrects its own axis alone",
        &crossed,
    );
    if made.axes.is_empty() {
        return Ok(written);
    }
    made.axes.sort_by_key(|points| points.axis);
    written.files.push(TextFile {
        name: "PITCH.TXT".to_owned(),
        text: text(&made.axes, &made.data),
    });
    written.notes.push(format!(
        "detection unit {} mm or deg, magnification 1",
        short(options.detection_unit, 9)
    ));
    if !made.offsets.is_empty() {
        written.notes.push(format!(
            "the deviation at the reference position is taken as 0: {}",
            made.offsets.join(", ")
        ));
    }
    if !made.wide.is_empty() {
        let names: Vec<String> = made.wide.iter().map(ToString::to_string).collect();
        written.notes.push(format!(
            "steps beyond -{FEW_STEPS} to {FEW_STEPS} on {}: a control takes them by option only (from memory, unproven)",
            names.join(", ")
        ));
    }
    Ok(written)
}

impl Made {
    fn take(&mut self, table: &AxisTable, options: &WriteOptions) -> Result<(), ExchangeError> {
        let Some(axis) = options.axes.number(table.input) else {
            let expected = format!(
                "its number in the control: --axis-numbers {}=1",
                table.input
            );
            return Err(unfit(table, "no number".to_owned(), expected));
        };
        let (low, interval) = even(FORMAT, table)?;
        let count = table.positions.len();
        let reference = reference_of(table, low, interval)?;
        let base = table.forward[reference];
        if base.abs() > 1e-6 {
            let micro = short(base * table_micro(table), 2);
            self.offsets
                .push(format!("{} {micro} µm or µrad", table.input));
        }
        let counted = |values: &[f64]| -> Result<Vec<i64>, ExchangeError> {
            let units = values.iter().map(|value| {
                let units = (base - value) * table.output_at_edge(1.0) / options.detection_unit;
                whole(units)
                    .ok_or_else(|| unfit(table, units.to_string(), "a smaller number".to_owned()))
            });
            units.collect()
        };
        let sets = 1 + usize::from(table.backward.is_some());
        if self.next as usize + sets * count > MOST_POINTS {
            let found = format!("{count} points more");
            return Err(unfit(
                table,
                found,
                format!("{MOST_POINTS} of all axes at the most"),
            ));
        }
        let first = self.put(table, &counted(&table.forward)?)?;
        let last = self.next - 1;
        let negative = match &table.backward {
            None => None,
            Some(backward) => {
                let units = counted(backward)?;
                Some((self.put(table, &units)?, units[reference]))
            }
        };
        self.axes.push(Points {
            axis,
            reference: first + u32::try_from(reference).unwrap_or(0),
            first,
            last,
            interval,
            turn: if table.modulo {
                interval * (count - 1) as f64
            } else {
                0.0
            },
            negative,
        });
        Ok(())
    }

    /// Puts sums down as steps from point to point; the first point.
    fn put(&mut self, table: &AxisTable, units: &[i64]) -> Result<u32, ExchangeError> {
        let first = self.next;
        let steps = std::iter::once(0).chain(units.windows(2).map(|pair| pair[1] - pair[0]));
        for step in steps {
            if step.abs() > MOST_STEPS {
                return Err(unfit(
                    table,
                    format!("a step of {step} detection units from point to point"),
                    format!("{MOST_STEPS} at the most: take a smaller step"),
                ));
            }
            if step.abs() > FEW_STEPS && self.wide.last() != Some(&table.input) {
                self.wide.push(table.input);
            }
            self.data.push((self.next, step));
            self.next += 1;
        }
        Ok(first)
    }
}

/// The node at machine zero, where the reference position is.
fn reference_of(table: &AxisTable, low: f64, interval: f64) -> Result<usize, ExchangeError> {
    let place = (0.0 - low) / interval;
    let count = table.positions.len();
    let reference = whole(place)
        .filter(|k| (place - *k as f64).abs() < 1e-6)
        .and_then(|k| usize::try_from(k).ok())
        .filter(|k| *k < count);
    reference.ok_or_else(|| {
        let high = low + interval * (count - 1) as f64;
        unfit(
            table,
            format!("no point at machine zero, between {low} and {high}"),
            "one there, where the reference position is: --at with whole steps from 0".to_owned(),
        )
    })
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
