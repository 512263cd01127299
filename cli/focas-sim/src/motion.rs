//! Motion of the simulated axes: at rest, along a program, or oscillating.

use std::{sync::Arc, time::Duration};

use volcomp_focas::simulator::Motion;
use volcomp_port::simulated::Path;
use volcomp_vocabulary::AxisName;

use crate::{
    arguments::Arguments,
    error::SimError,
    program::Program,
    quantities::{letters, outside},
    walk::Walk,
};

/// The requested motion. For a measurement also the walk through the program, which the motion follows.
pub(crate) fn motion(
    arguments: &Arguments,
    axes: &[AxisName],
) -> Result<(Motion, Option<Arc<Walk>>), SimError> {
    let stands = match &arguments.at {
        None => vec![0.0; axes.len()],
        Some(at) => position(at, axes)?,
    };
    match &arguments.program {
        Some(file) => {
            let program = Program::read(file, axes, &stands)?;
            let acceleration = arguments.acceleration_mm_s2()?;
            if arguments.report.is_none() {
                let path = Path::new(&program.moves, acceleration);
                return Ok((along(axes, path), None));
            }
            let walk = Arc::new(Walk::new(program, acceleration));
            Ok((walk.motion(axes), Some(walk)))
        }
        None if arguments.at.is_some() => Ok((Arc::new(move |_| stands.clone()), None)),
        None => {
            let motion = to_and_fro(arguments.stroke_mm, arguments.period_s, axes.len())?;
            Ok((motion, None))
        }
    }
}

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
            // Each axis makes a whole number of periods, so that all axes return to 0 at the same time.
            let speed = f64::from(u8::try_from(axis + 1).unwrap_or(u8::MAX));
            0.5 * stroke * (1.0 - (turn * speed).cos())
        };
        (0..axes).map(place).collect()
    }))
}

fn along(axes: &[AxisName], path: Path) -> Motion {
    let axes = axes.to_vec();
    Arc::new(move |elapsed| outside(&axes, &path.at(elapsed)))
}
