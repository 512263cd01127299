//! LinuxCNC's COMP_FILE: three numbers per line, at most 256 lines.

use core::fmt::Write;

use volcomp_vocabulary::{AxisName, CorrectionLimit, Displacement, bounds::is_plausible_error};

use super::options::Written;
use super::table::{AxisTable, from_file_unit};
use super::text::{ExchangeError, Format, TextFile, Warning, short};

const MAX_LINES: usize = 256;
/// Number of decimals of values in mm: 1 nm.
const DECIMALS: usize = 6;
/// Number of decimals of values in deg.
const DECIMALS_ROTARY: usize = 8;

/// Whether values are trims, nominal − actual (COMP_FILE_TYPE 1), instead of actual positions (0).
fn holds_trims(format: Format) -> bool {
    format == Format::LinuxcncType1
}

pub(crate) fn write(tables: &[AxisTable], format: Format) -> Result<Written, ExchangeError> {
    let value = |nominal: f64, deviation: f64| {
        if holds_trims(format) { -deviation } else { nominal + deviation }
    };
    let mut written = Written::default();
    let mut crossed = Vec::new();
    for table in tables {
        if !table.is_own() {
            crossed.push(table);
            continue;
        }
        let count = table.positions.len();
        if count > MAX_LINES {
            return Err(ExchangeError::not_representable(
                format,
                format!("axis {}", table.input),
                format!("{count} positions"),
                format!("at most {MAX_LINES}: use a larger step"),
            ));
        }
        let decimals = if table.input.is_rotary() { DECIMALS_ROTARY } else { DECIMALS };
        let mut text = String::new();
        let backward = table.backward.as_ref().unwrap_or(&table.forward);
        let rows = table.positions_in_file_unit().zip(&table.forward).zip(backward);
        for ((at, forward), backward) in rows {
            // Uses the nominal position as written, so that the difference to it is the exact deviation.
            let nominal: f64 = short(at, decimals).parse().unwrap_or(at);
            let [forward, backward] = [forward, backward]
                .map(|by| short(value(nominal, table.output_in_file_unit(*by)), decimals));
            let _ = writeln!(text, "{} {forward} {backward}", short(nominal, decimals));
        }
        if table.modulo {
            written.notes.push(format!(
                "axis {}: LinuxCNC does not repeat the table; beyond {} the end value holds",
                table.input,
                table.positions_in_file_unit().last().unwrap_or(0.0)
            ));
        }
        written.files.push(TextFile { name: format!("{}.comp", table.input), text });
    }
    written.leave_out("a COMP_FILE corrects its own joint alone", &crossed);
    if !written.files.is_empty() {
        let number = u8::from(holds_trims(format));
        let names = written.files.iter().map(|file| file.name.as_str());
        let names = names.collect::<Vec<_>>().join(" or ");
        written.notes.push(format!(
            "in the section [JOINT_n] of each axis: COMP_FILE = {names}, COMP_FILE_TYPE = {number}; machine units have to be mm and deg; \
             BACKLASH is ignored where there is a COMP_FILE"
        ));
    }
    Ok(written)
}

/// Axis of a file from its name, such as `X.comp`, `x.comp` or `axis-x.comp`.
fn axis_of(file: &TextFile) -> Result<AxisName, ExchangeError> {
    let base = file.base();
    let stem = base.split('.').next().unwrap_or(base);
    let last = stem.rsplit(['-', '_', ' ']).next().unwrap_or(stem);
    last.to_ascii_uppercase().parse().map_err(|_| {
        file.whole().error(
            format!("the name `{stem}`"),
            "a name that ends in the letter of the axis: X.comp, axis-x.comp",
        )
    })
}

pub(crate) fn read(
    files: &[&TextFile],
    format: Format,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    files.iter().map(|file| read_file(file, format, warnings)).collect()
}

fn read_file(
    file: &TextFile,
    format: Format,
    warnings: &mut Vec<Warning>,
) -> Result<AxisTable, ExchangeError> {
    let axis = axis_of(file)?;
    let mut table = AxisTable {
        input: axis,
        output: axis,
        positions: Vec::new(),
        forward: Vec::new(),
        backward: None,
        modulo: false,
    };
    let mut backward = Vec::new();
    let mut lines = file.text.lines().enumerate();
    for (index, line) in lines.by_ref() {
        let here = file.at(index + 1);
        let Some(three) = scanned(line) else {
            let behind = file.text.lines().skip(index + 1);
            let rest = behind.filter(|line| scanned(line).is_some()).count();
            if !line.trim().is_empty() || rest > 0 {
                warnings.push(here.warning(format!("LinuxCNC stops reading here, because this is not a line of three numbers; {rest} lines of numbers after it are ignored")));
            }
            break;
        };
        let [nominal, forward, back] = three;
        if !three.iter().all(|x| x.abs() <= 1e9) {
            return Err(here.error(format!("`{line}`"), "numbers in the range of a machine"));
        }
        let at = from_file_unit(axis, nominal);
        if table.positions.last().is_some_and(|last| *last >= at) {
            return Err(here.error(format!("nominal {nominal}"), "strictly increasing nominals"));
        }
        if table.positions.len() == MAX_LINES {
            return Err(here.too_many(MAX_LINES));
        }
        let deviations = [forward, back].map(|value| {
            let deviation = if holds_trims(format) { 0.0 - value } else { value - nominal };
            from_file_unit(axis, deviation)
        });
        let implausible = (deviations.into_iter())
            .map(|deviation| Displacement::new(axis.kind(), deviation))
            .find(|deviation| !is_plausible_error(*deviation));
        if let Some(deviation) = implausible {
            let (mut this, mut other) = ("positions (type 0)", "trims (type 1)");
            if holds_trims(format) {
                (this, other) = (other, this);
            }
            return Err(here.error(
                format!("a deviation of {deviation:.1}, read as {this}"),
                format!(
                    "at most {}; does the file have {other}?",
                    CorrectionLimit::LARGEST.of(axis.kind())
                ),
            ));
        }
        table.positions.push(at);
        table.forward.push(deviations[0]);
        backward.push(deviations[1]);
    }
    if table.positions.len() < 2 {
        return Err(file
            .whole()
            .error(format!("{} lines of three numbers", table.positions.len()), "at least 2"));
    }
    if backward.iter().zip(&table.forward).any(|(a, b)| (a - b).abs() > 1e-12) {
        table.backward = Some(backward);
    }
    Ok(table)
}

/// Numbers that `sscanf("%lf %lf %lf")` would read from a line, except hexadecimal ones; `None` if there are fewer than three.
fn scanned(line: &str) -> Option<[f64; 3]> {
    let mut rest = line;
    let mut found = [0.0; 3];
    for number in &mut found {
        rest = rest.trim_start();
        let length = prefix(rest.as_bytes())?;
        let (text, behind) = rest.split_at_checked(length)?;
        *number = text.parse::<f64>().ok().filter(|x| x.is_finite())? + 0.0;
        rest = behind;
    }
    Some(found)
}

fn prefix(bytes: &[u8]) -> Option<usize> {
    let digits = |from: usize| bytes.iter().skip(from).take_while(|b| b.is_ascii_digit()).count();
    let mut at = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    let whole = digits(at);
    at += whole;
    let mut parts = 0;
    if bytes.get(at) == Some(&b'.') {
        parts = digits(at + 1);
        at += 1 + parts;
    }
    if whole + parts == 0 {
        return None;
    }
    if matches!(bytes.get(at), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(at + 1), Some(b'+' | b'-')));
        let exponent = digits(at + 1 + sign);
        if exponent > 0 {
            at += 1 + sign + exponent;
        }
    }
    Some(at)
}
