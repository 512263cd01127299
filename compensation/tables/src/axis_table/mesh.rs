//! Bed meshes of printers and height maps of routers: Z heights of a surface over X and Y.

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use super::{
    exchange::ReadTables,
    table::{Content, ErrorTable, ErrorTables},
    text::{ExchangeError, FilePosition, TextFile, number, short},
};

/// Reads a mesh as the straightness curves `EZX` and `EZY`.
///
/// The first row is `mm` and the positions of X; each further row is a position of Y and the heights there, all in mm.
/// A height is the Z at which the tool touches a plane: where Z is high, the tool is low, so the errors have the
/// opposite sign. `EZX` and `EZY` are the least-squares fit of f(x) + g(y) to the heights minus their mean; a warning
/// states the residual.
///
/// # Errors
/// A row that is not of this form, positions that do not increase, implausible heights.
pub fn read_mesh(file: &TextFile) -> Result<ReadTables, ExchangeError> {
    let (xs, ys, heights) = rows(file)?;
    let mean =
        |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    let whole = mean(&mut heights.iter().flatten().copied(), xs.len() * ys.len());
    let of_x: Vec<f64> = (0..xs.len())
        .map(|x| mean(&mut heights.iter().map(|row| row[x]), ys.len()) - whole)
        .collect();
    let of_y: Vec<f64> =
        (heights.iter()).map(|row| mean(&mut row.iter().copied(), xs.len()) - whole).collect();
    let (mut largest, mut squares) = ((0.0, 0.0, 0.0), 0.0);
    for (row, (at_y, y)) in heights.iter().zip(of_y.iter().zip(&ys)) {
        for (height, (at_x, x)) in row.iter().zip(of_x.iter().zip(&xs)) {
            let left: f64 = height - whole - at_x - at_y;
            squares += left * left;
            if left.abs() > largest.0 {
                largest = (left.abs(), *x, *y);
            }
        }
    }
    let rms = (squares / (xs.len() * ys.len()) as f64).sqrt();
    let um = |mm: f64| short(mm * 1e3, 1);
    let warnings = vec![
        file.whole().warning(format!(
            "the mean height of {} um is left out: it is the offset of Z",
            um(whole)
        )),
        file.whole().warning(format!(
            "EZX and EZY leave up to {} um (X={} Y={}), {} um rms: what depends on X and Y together, such as a twisted bed, is no curve of one axis",
            um(largest.0),
            short(largest.1, 3),
            short(largest.2, 3),
            um(rms)
        )),
    ];
    let curve = |axis, positions, values: Vec<f64>| ErrorTable {
        name: ErrorName::motion(Component::EZ, axis),
        positions,
        values: values.into_iter().map(|height| 0.0 - height).collect(),
    };
    let content = Content::Errors(ErrorTables {
        curves: vec![curve(AxisName::X, xs, of_x), curve(AxisName::Y, ys, of_y)],
        locations: Vec::new(),
    });
    content.check_plausible(&[file])?;
    Ok(ReadTables { content, warnings })
}

type Rows = (Vec<f64>, Vec<f64>, Vec<Vec<f64>>);

fn rows(file: &TextFile) -> Result<Rows, ExchangeError> {
    let lines = file.text.lines().enumerate();
    let mut lines = lines
        .map(|(index, line)| (file.at(index + 1), line.trim().trim_start_matches('\u{feff}')))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let head = lines.next();
    let expected = "`mm` and at least two positions of X: mm,10,110,210";
    let Some((here, line)) = head else {
        return Err(file.whole().error("nothing", expected));
    };
    let (first, xs) = cells(line);
    let Some(xs) = xs.filter(|xs| first.eq_ignore_ascii_case("mm") && xs.len() > 1) else {
        return Err(here.error(quoted(line), expected));
    };
    increasing(here, AxisName::X, &xs)?;
    let (mut ys, mut heights) = (Vec::new(), Vec::new());
    for (here, line) in lines {
        let (y, row) = cells(line);
        let (Some(y), Some(row)) = (number(y), row.filter(|row| row.len() == xs.len())) else {
            let expected = format!("a position of Y and {} heights in mm", xs.len());
            return Err(here.error(quoted(line), expected));
        };
        ys.push(y);
        increasing(here, AxisName::Y, &ys)?;
        heights.push(row);
    }
    if ys.len() < 2 {
        let found = format!("{} rows of heights", ys.len());
        return Err(file.whole().error(found, "at least 2"));
    }
    Ok((xs, ys, heights))
}

/// First cell of a line, and the numbers after it; `None` if one of these is not a number.
fn cells(line: &str) -> (&str, Option<Vec<f64>>) {
    let mut cells = line.split([',', ';', '\t']).map(str::trim);
    let first = cells.next().unwrap_or("");
    (first, cells.map(number).collect())
}

fn increasing(here: FilePosition<'_>, axis: AxisName, at: &[f64]) -> Result<(), ExchangeError> {
    let Some(pair) = at.windows(2).find(|pair| pair[0] >= pair[1]) else {
        return Ok(());
    };
    let found = format!("{axis}={} after {axis}={}", pair[1], pair[0]);
    Err(here.error(found, "increasing positions"))
}
