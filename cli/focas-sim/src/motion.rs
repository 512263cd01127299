//! How the axes of the simulated machine move: they stand, go through a program, or go to and fro.

use std::{path::Path as FilePath, sync::Arc, time::Duration};

use volcomp_document::CsvTable;
use volcomp_focas::simulator::Motion;
use volcomp_port::simulated::{Move, Path};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerChannel};

use crate::{arguments::Arguments, error::SimError};

/// Feed of a row without one, mm/min or deg/min.
const DEFAULT_FEED_PER_MIN: f64 = 2000.0;
/// Acceleration of every move of a program, mm/s².
const ACCELERATION_MM_S2: f64 = 1000.0;

/// The motion that the call asks for.
pub(crate) fn motion(arguments: &Arguments, axes: &[AxisName]) -> Result<Motion, SimError> {
    let stands = match &arguments.at {
        None => vec![0.0; axes.len()],
        Some(at) => position(at, axes)?,
    };
    match &arguments.program {
        Some(file) => Ok(along(axes, &program(file, axes, &stands)?)),
        None if arguments.at.is_some() => Ok(Arc::new(move |_| stands.clone())),
        None => to_and_fro(arguments.stroke_mm, arguments.period_s, axes.len()),
    }
}

/// A position such as `X=100,C=30`, mm and deg.
fn position(text: &str, axes: &[AxisName]) -> Result<Vec<f64>, SimError> {
    let mut stands = vec![None; axes.len()];
    for item in text.split(',').filter(|item| !item.trim().is_empty()) {
        let wrong = |expected: String| SimError::input("--at", format!("`{item}`"), expected);
        let form = || wrong("an axis letter, = and a number, such as X=100".to_owned());
        let (name, number) = item.split_once('=').ok_or_else(form)?;
        let name: AxisName = name.trim().parse().map_err(|_| form())?;
        let place = axes.iter().position(|axis| *axis == name);
        let place = place.ok_or_else(|| wrong(format!("an axis of {}", letters(axes))))?;
        let number: f64 = number.trim().parse().map_err(|_| form())?;
        if !number.is_finite() {
            return Err(form());
        }
        if stands[place].replace(number).is_some() {
            return Err(wrong("every axis once".to_owned()));
        }
    }
    Ok(stands.into_iter().map(Option::unwrap_or_default).collect())
}

/// The letters of axes, commas between.
pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(AxisName::to_string).collect();
    letters.join(",")
}

fn to_and_fro(stroke: f64, period_s: f64, axes: usize) -> Result<Motion, SimError> {
    if !(period_s > 0.0 && period_s.is_finite()) {
        let found = period_s.to_string();
        return Err(SimError::input("--period-s", found, "a positive number"));
    }
    if !stroke.is_finite() {
        let found = stroke.to_string();
        return Err(SimError::input("--stroke-mm", found, "a number"));
    }
    Ok(Arc::new(move |elapsed: Duration| {
        let turn = std::f64::consts::TAU * elapsed.as_secs_f64() / period_s;
        let place = |axis: usize| {
            // A whole number of periods for each axis, so that all are at 0 together.
            let speed = f64::from(u8::try_from(axis + 1).unwrap_or(u8::MAX));
            0.5 * stroke * (1.0 - (turn * speed).cos())
        };
        (0..axes).map(place).collect()
    }))
}

/// Reads a program: the moves in mm and rad, axes without a column at `stands` (mm, deg).
fn program(file: &FilePath, axes: &[AxisName], stands: &[f64]) -> Result<Vec<Move>, SimError> {
    let name = file.display().to_string();
    let text = std::fs::read_to_string(file).map_err(|source| SimError::Read {
        file: name.clone(),
        source,
    })?;
    let table = CsvTable::parse(&name, &text)?;
    let letters_of_axes: Vec<String> = axes.iter().map(AxisName::to_string).collect();
    let mut known: Vec<&str> = letters_of_axes.iter().map(String::as_str).collect();
    known.extend(["feed", "dwell_s"]);
    if let Some(unknown) = table.names_besides(&known).first() {
        let message = format!(
            "found the column `{unknown}`, expected {}, feed or dwell_s",
            letters(axes)
        );
        return Err(table.header_error(message).into());
    }
    let columns = letters_of_axes.iter().map(|name| table.column(name));
    let columns = columns.collect::<Result<Vec<_>, _>>()?;
    let (feeds, dwells) = (table.column("feed")?, table.column("dwell_s")?);
    let mut moves: Vec<Move> = Vec::new();
    let mut coordinates: Vec<Vec<f64>> = Vec::new();
    for row in table.rows() {
        let mut to = stands.to_vec();
        for (coordinate, column) in to.iter_mut().zip(&columns) {
            if let Some(column) = column {
                *coordinate = row.cell(*column).number()?;
            }
        }
        let feed_per_min = feeds.map_or(Ok(DEFAULT_FEED_PER_MIN), |column| {
            let cell = row.cell(column);
            match cell.number()? {
                feed if feed > 0.0 => Ok(feed),
                feed => Err(cell.error(format!("found {feed}, expected a positive number"))),
            }
        })?;
        let dwell = dwells.map_or(Ok(Duration::ZERO), |column| {
            let (cell, seconds) = (row.cell(column), row.cell(column).number()?);
            let wrong = |_| cell.error(format!("found {seconds}, expected a time, s"));
            Duration::try_from_secs_f64(seconds).map_err(wrong)
        })?;
        moves.push(Move {
            to: inside(axes, &to),
            // Until it is known where the move comes from.
            feed_per_s: feed_per_min,
            dwell,
        });
        coordinates.push(to);
    }
    if moves.is_empty() {
        let message = "found no rows, expected at least one position";
        return Err(table.header_error(message).into());
    }
    let before = coordinates.iter().cycle().skip(coordinates.len() - 1);
    for (step, (from, to)) in moves.iter_mut().zip(before.zip(&coordinates)) {
        step.feed_per_s = feed_per_s(axes, from, to, step.feed_per_s);
    }
    Ok(moves)
}

/// Coordinates in mm and deg as a path has them: mm and rad.
fn inside(axes: &[AxisName], coordinates: &[f64]) -> PerChannel<f64> {
    let mut values = PerChannel::ZERO;
    for ((value, axis), coordinate) in values.iter_mut().zip(axes).zip(coordinates) {
        *value = Displacement::from_coordinate(axis.kind(), *coordinate).mm_or_rad();
    }
    values
}

/// The feed of a move in mm/s, or in rad/s where only rotary axes move.
fn feed_per_s(axes: &[AxisName], from: &[f64], to: &[f64], feed_per_min: f64) -> f64 {
    let mut moved = axes.iter().zip(from.iter().zip(to));
    let slides = moved.any(|(axis, (from, to))| !axis.is_rotary() && from != to);
    let kind = if slides {
        AxisKind::Linear
    } else {
        AxisKind::Rotary
    };
    Displacement::from_coordinate(kind, feed_per_min / 60.0).mm_or_rad()
}

/// Along a program, again and again.
fn along(axes: &[AxisName], moves: &[Move]) -> Motion {
    let path = Path::new(moves, ACCELERATION_MM_S2);
    let axes = axes.to_vec();
    Arc::new(move |elapsed| {
        let place = path.at(elapsed);
        let outside =
            |(axis, value): (&AxisName, &f64)| Displacement::new(axis.kind(), *value).mm_or_deg();
        axes.iter().zip(place.iter()).map(outside).collect()
    })
}
