//! Reads the observations of a shop file.

use std::path::PathBuf;

use volcomp_document::{InputError, Section, Value};
use volcomp_identify::Unknown;
use volcomp_model::{BODY_DIAGONALS, Machine};
use volcomp_vocabulary::{AxisName, Um};

use crate::{
    instrument::{Instrument, decode_instrument},
    observation::{Bar, MOST_MARKS, Poses, Reads, Setting, ShopObservation},
    plan::{MOST_POSES, read_plan},
    shop::{ShopLine, TAKEN, decode_file_name},
};

const POSES: usize = 30;

pub(crate) fn decode_observations(
    root: &Section<'_>,
    truth: &Machine,
    instrument: &Instrument,
    lines: &[ShopLine],
    inputs: &mut Vec<PathBuf>,
) -> Result<(Vec<ShopObservation>, Vec<Unknown>), InputError> {
    let mut observations: Vec<ShopObservation> = Vec::new();
    let Some(value) = root.get("observation") else {
        return match root.get("unknown") {
            Some(unknown) => Err(unknown.error(
                "found what is to be identified, expected an [[observation]] to identify it from",
            )),
            None => Ok((observations, Vec::new())),
        };
    };
    for item in value.items()? {
        let section = item.section()?;
        let observation = decode(&section, truth, instrument, &observations, inputs)?;
        let names = observation.file_names();
        let others = observations.iter().flat_map(ShopObservation::file_names);
        let others = others.chain(lines.iter().map(|line| line.name.clone()));
        let taken = others.chain(TAKEN.map(str::to_owned));
        if let Some(name) = taken.into_iter().find(|other| names.contains(other)) {
            return Err(section.error(format!("the file {name} is written already")));
        }
        observations.push(observation);
    }
    let unknown = root.require("unknown")?;
    Ok((observations, Unknown::decode(&unknown, truth)?))
}

fn decode(
    section: &Section<'_>,
    truth: &Machine,
    instrument: &Instrument,
    before: &[ShopObservation],
    inputs: &mut Vec<PathBuf>,
) -> Result<ShopObservation, InputError> {
    let kind = section.require("kind")?.one_of(
        &["points", "sphere", "distance", "step-gauge", "ball-row", "diagonals"].map(|k| (k, k)),
    )?;
    let own: &[&str] = match kind {
        "points" => &["poses", "frame", "target", "drift_um", "drift_urad", "tools"],
        "sphere" => &["poses", "centres", "reads", "drift_um", "tools"],
        "distance" => &["poses", "point", "dead_length_mm", "radius_mm", "drift_um", "tools"],
        "step-gauge" => &BAR_KEYS,
        "ball-row" => &[&BAR_KEYS[..], &["reads", "drift_um"]].concat(),
        _ => &["diagonals", "targets", "runs", "both_directions", "alignment_urad", "drift_um"],
    };
    section.allow(&[&["kind", "file", "at", "noise_um", "resolution_um"], own].concat())?;
    let name = match section.get("file") {
        Some(file) => decode_file_name(&file)?,
        None => free_name(kind, before),
    };
    let at = at(section, truth, kind == "diagonals")?;
    let mut poses = |spheres: usize| poses(section, truth, &at, spheres, inputs);
    let setting = match kind {
        "points" => Setting::Points {
            poses: poses(0)?,
            frame: section.optional("frame", Value::vector::<6>)?.unwrap_or_default(),
            target: section.optional("target", Value::vector::<3>)?,
        },
        "sphere" => {
            let centres = centres(&section.require("centres")?)?;
            Setting::Sphere { poses: poses(centres.len())?, centres, reads: reads(section)? }
        }
        "distance" => Setting::Distance {
            poses: poses(0)?,
            point: section.require("point")?.vector()?,
            dead_length_mm: section.number_or(
                "dead_length_mm",
                f64::NEG_INFINITY..=f64::INFINITY,
                0.0,
            )?,
            radius_mm: section.optional("radius_mm", Value::positive)?,
        },
        "step-gauge" => Setting::StepGauge(bar(section)?),
        "ball-row" => Setting::BallRow { bar: bar(section)?, reads: reads(section)? },
        _ => Setting::Diagonals { names: diagonals(section, truth)? },
    };
    Ok(ShopObservation {
        name,
        instrument: own_instrument(section, instrument, &setting)?,
        at,
        tools: tools(section, truth)?,
        setting,
    })
}

const BAR_KEYS: [&str; 8] = [
    "origin",
    "direction",
    "distances",
    "calibration_um",
    "alignment_urad",
    "runs",
    "both_directions",
    "tools",
];

/// Decodes the instrument of an observation, whose keys override those of the shop's instrument. A set-up drifts only if the observation itself
/// states a drift.
fn own_instrument(
    section: &Section<'_>,
    base: &Instrument,
    setting: &Setting,
) -> Result<Instrument, InputError> {
    let mut base = base.clone();
    base.length.drift = Um(0.0);
    base.angle = crate::instrument::Imperfections::default();
    let instrument = decode_instrument(section, &base)?;
    let marks = match setting {
        Setting::StepGauge(bar) | Setting::BallRow { bar, .. } => bar.distances.len(),
        _ => 1,
    };
    instrument.check_count(marks).map_err(|error| section.error(error.to_string()))?;
    Ok(instrument)
}

/// Returns a file name that is not used yet: `sphere`, then `sphere-2`, …
fn free_name(kind: &str, before: &[ShopObservation]) -> String {
    let same = before.iter().filter(|other| other.setting.kind() == kind);
    match same.count() {
        0 => kind.to_owned(),
        count => format!("{kind}-{}", count + 1),
    }
}

/// Decodes the number of poses or the file of a plan; `spheres` is the number of spheres.
fn poses(
    section: &Section<'_>,
    truth: &Machine,
    held: &[(AxisName, f64)],
    spheres: usize,
    inputs: &mut Vec<PathBuf>,
) -> Result<Poses, InputError> {
    match section.get("poses") {
        Some(value) if value.text().is_ok() => {
            if let Some(radius) = section.get("radius_mm") {
                return Err(radius.error(
                    "found it beside a plan of poses, expected a number of poses with it: a plan says where the tip goes",
                ));
            }
            let (path, plan) = read_plan(&value, truth, held, spheres)?;
            inputs.push(path);
            Ok(Poses::Planned(plan))
        }
        Some(value) => match value.count(MOST_POSES) {
            Ok(count) if count > 0 => Ok(Poses::Drawn(count)),
            _ => Err(value.error(format!(
                "expected 1 to {MOST_POSES} poses, or the name of a file with planned poses"
            ))),
        },
        None => Ok(Poses::Drawn(POSES)),
    }
}

fn reads(section: &Section<'_>) -> Result<Reads, InputError> {
    let words = [("coordinates", Reads::Coordinates), ("offset", Reads::Offset)];
    section.one_of("reads", &words, Reads::Coordinates)
}

fn centres(value: &Value<'_>) -> Result<Vec<[f64; 3]>, InputError> {
    let centres: Vec<[f64; 3]> =
        value.items()?.iter().map(Value::vector).collect::<Result<_, _>>()?;
    if centres.is_empty() {
        return Err(value.error("found no sphere, expected at least one centre [x, y, z]"));
    }
    Ok(centres)
}

fn bar(section: &Section<'_>) -> Result<Bar, InputError> {
    let direction = section.require("direction")?;
    let along = direction.vector::<3>()?;
    if along.iter().all(|x| x.abs() < 1e-12) {
        return Err(
            direction.error("found a zero direction, expected a vector of any other length")
        );
    }
    let value = section.require("distances")?;
    let distances = value.numbers()?;
    if !(2..=MOST_MARKS).contains(&distances.len()) {
        let found = distances.len();
        return Err(value.error(format!("found {found} distances, expected 2 to {MOST_MARKS}")));
    }
    let falls = |pair: &&[f64]| matches!(pair, [before, after] if after <= before);
    if let Some([before, after]) = distances.windows(2).find(falls) {
        return Err(
            value.error(format!("found {after} mm after {before} mm, expected rising distances"))
        );
    }
    Ok(Bar {
        origin: section.require("origin")?.vector()?,
        direction: along,
        distances,
        calibration: Um(section.number_or("calibration_um", 0.0..=f64::INFINITY, 0.0)?),
    })
}

fn diagonals(section: &Section<'_>, truth: &Machine) -> Result<Vec<String>, InputError> {
    for axis in [AxisName::X, AxisName::Y, AxisName::Z] {
        if truth.axis(axis).is_none() {
            let structure = truth.chain().structure();
            return Err(section.error(format!(
                "the structure `{structure}` has no axis {axis}, expected X, Y and Z for body diagonals"
            )));
        }
    }
    let Some(value) = section.get("diagonals") else {
        return Ok(BODY_DIAGONALS.map(str::to_owned).to_vec());
    };
    let mut names: Vec<String> = Vec::new();
    for item in value.items()? {
        let name = item.one_of(&BODY_DIAGONALS.map(|name| (name, name)))?;
        if names.iter().any(|other| other == name) {
            return Err(item.error(format!("{name} appears twice")));
        }
        names.push(name.to_owned());
    }
    if names.is_empty() {
        let all = BODY_DIAGONALS.join(", ");
        return Err(value.error(format!("found no diagonal, expected some of {all}")));
    }
    Ok(names)
}

/// Decodes the coordinates of the axes that do not move. Along diagonals these cannot be X, Y and Z.
fn at(
    section: &Section<'_>,
    truth: &Machine,
    diagonals: bool,
) -> Result<Vec<(AxisName, f64)>, InputError> {
    let mut at = Vec::new();
    let Some(held) = section.section("at")? else {
        return Ok(at);
    };
    for (key, value) in held.values() {
        let axis = truth.axes().iter().find(|axis| axis.name.to_string() == key);
        let Some(axis) = axis else {
            let structure = truth.chain().structure();
            return Err(value.error(format!("the structure `{structure}` has no axis {key}")));
        };
        let moves = [AxisName::X, AxisName::Y, AxisName::Z].contains(&axis.name);
        if moves && diagonals {
            return Err(value.error(format!("{key} moves along the diagonals")));
        }
        let found = value.number()?;
        axis.check_coordinate(found).map_err(|message| value.error(message))?;
        at.push((axis.name, found));
    }
    Ok(at)
}

fn tools(section: &Section<'_>, truth: &Machine) -> Result<Vec<String>, InputError> {
    let mut tools: Vec<String> = Vec::new();
    let Some(value) = section.get("tools") else {
        return Ok(tools);
    };
    for item in value.items()? {
        let tool = item.text()?;
        if !truth.tools().contains_key(tool) {
            let known: Vec<&str> = truth.tools().keys().map(String::as_str).collect();
            return Err(item.error(format!(
                "found {tool:?}, expected a tool of the machine file: {}",
                known.join(", ")
            )));
        }
        if tools.iter().any(|other| other == tool) {
            return Err(item.error(format!("tool {tool} appears twice")));
        }
        tools.push(tool.to_owned());
    }
    Ok(tools)
}
