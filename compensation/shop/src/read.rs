//! Reads a shop file, with its truth machine and its observations.
//!
//! The number of readings is limited, because all readings are in memory at once.

use std::path::{Path, PathBuf};

use volcomp_calibrate::{
    CurveChoice, HOLDS_LOCATION, Method, Setup, decode_holds_location, decode_location_errors,
    decode_motion, is_square,
};
use volcomp_document::{Document, FileKind, InputError, Section, Value};
use volcomp_identify::Unknown;
use volcomp_metrology::{TiltReading, squareness_parts, tilt_sign};
use volcomp_model::{BODY_DIAGONALS, Machine};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName, Um, Urad};

use crate::error::ShopError;
use crate::instrument::{
    INSTRUMENT_KEYS, Instrument, MAX_TARGETS, bridge_targets, decode_instrument,
};
use crate::poses::{MOST_POSES, read_plan};
use crate::shop::{
    Bar, Format, Header, MOST_MARKS, Poses, Reads, Setting, Shop, ShopLine, ShopLocation,
    ShopObservation, TAKEN, decode_file_name,
};

const TOP_KEYS: [&str; 10] = [
    "machine",
    "seed",
    "format",
    "header",
    "instrument",
    "measurement",
    "squareness",
    "location",
    "observation",
    "unknown",
];

impl Shop {
    /// Reads a shop file and its truth machine.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, ShopError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut inputs = vec![path.to_owned()];
        let mut shop = Self::decode(&Document::read(path)?, |machine| {
            inputs.push(folder.join(machine));
            Ok(Machine::read(folder.join(machine))?)
        })?;
        inputs.append(&mut shop.inputs);
        shop.inputs = inputs;
        Ok(shop)
    }

    /// Decodes the text of a shop file. `file` is its name in messages, and plans of poses are relative to it. `machine` returns the
    /// machine file with a name.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn parse(
        text: &str,
        file: &str,
        machine: impl FnOnce(&str) -> Result<Machine, ShopError>,
    ) -> Result<Self, ShopError> {
        Self::decode(&Document::new(file, text), machine)
    }

    fn decode(
        document: &Document,
        machine: impl FnOnce(&str) -> Result<Machine, ShopError>,
    ) -> Result<Self, ShopError> {
        document.decode(|root| {
            root.allow_in(FileKind::Shop, &TOP_KEYS)?;
            let truth = machine(root.require("machine")?.text()?)?;
            Ok(decode(&root, truth)?)
        })
    }
}

fn decode(root: &Section<'_>, truth: Machine) -> Result<Shop, InputError> {
    let default = Instrument::default();
    let instrument = match root.section("instrument")? {
        Some(section) => {
            section.allow(&INSTRUMENT_KEYS)?;
            decode_instrument(&section, &default)?
        }
        None => default,
    };
    let items = |key: &str| root.get(key).map_or_else(|| Ok(Vec::new()), |value| value.items());
    let usual = Usual {
        instrument: &instrument,
        format: root.one_of("format", &Format::NAMES, Format::default())?,
    };
    let mut lines: Vec<ShopLine> = Vec::new();
    for item in items("measurement")? {
        decode_measurement(&item.section()?, &truth, &usual, &mut lines)?;
    }
    let mut squareness: Vec<(ErrorName, Urad)> = Vec::new();
    for item in items("squareness")? {
        let section = item.section()?;
        section.allow(&["error", "reference_angle_urad"])?;
        let value = section.require("error")?;
        let error = truth.decode_error(&value)?;
        squareness_parts(error).map_err(|e| value.error(e.to_string()))?;
        if squareness.iter().any(|(other, _)| *other == error) {
            return Err(value.error(format!("{error} appears twice")));
        }
        let angle = section.get("reference_angle_urad");
        let angle = angle.map_or(Ok(0.0), |value| value.number())?;
        squareness.push((error, Urad(angle)));
    }
    let mut locations: Vec<ShopLocation> = Vec::new();
    for item in items("location")? {
        decode_location(&item.section()?, &truth, &mut locations)?;
    }
    let mut inputs = Vec::new();
    let (observations, unknown) =
        decode_observations(root, &truth, &instrument, &lines, &mut inputs)?;
    Ok(Shop {
        truth,
        seed: root.get("seed").map_or(Ok(0), |v| v.count(usize::MAX))? as u64,
        lines,
        squareness,
        locations,
        header: match root.section("header")? {
            Some(section) => decode_header(&section)?,
            None => Header::default(),
        },
        observations,
        unknown,
        inputs,
    })
}

/// Decodes a `[[location]]`: one or several location errors that are read with the same noise.
fn decode_location(
    section: &Section<'_>,
    truth: &Machine,
    locations: &mut Vec<ShopLocation>,
) -> Result<(), InputError> {
    section.allow(&["error", "errors", "noise_um", "noise_urad"])?;
    let errors = decode_location_errors(section, truth, [AxisName::X, AxisName::Y])?;
    for error in errors {
        if is_square(error) {
            return Err(section.error(format!(
                "found {error}, a squareness, which no mandrel shows: expected it in [[squareness]], with the straightness lines of both axes"
            )));
        }
        if locations.iter().any(|other| other.error == error) {
            return Err(section.error(format!("{error} appears in two [[location]] tables")));
        }
        let (own, other) = match error.component.kind() {
            AxisKind::Linear => ("noise_um", "noise_urad"),
            AxisKind::Rotary => ("noise_urad", "noise_um"),
        };
        if let Some(value) = section.get(other) {
            return Err(
                value.error(format!("{error} is in {}, expected `{own}`", error.component.unit()))
            );
        }
        let noise = section.number_or(own, 0.0..=f64::INFINITY, 0.0)?;
        locations.push(ShopLocation { error, noise });
    }
    Ok(())
}

fn decode_header(section: &Section<'_>) -> Result<Header, InputError> {
    section.allow(&[
        "date",
        "by",
        "serial",
        "location",
        "air_degc",
        "material_degc",
        "expansion_um_per_m_k",
    ])?;
    let text =
        |key: &str| section.get(key).map(|value| value.text().map(str::to_owned)).transpose();
    let number = |key: &str| section.get(key).map(|value| value.number()).transpose();
    Ok(Header {
        date: text("date")?,
        by: text("by")?,
        serial: text("serial")?,
        location: text("location")?,
        air_degc: number("air_degc")?,
        material_degc: number("material_degc")?,
        expansion_um_per_m_k: number("expansion_um_per_m_k")?,
    })
}

struct Usual<'s> {
    instrument: &'s Instrument,
    format: Format,
}

/// Decodes a `[[measurement]]`: one line for each of its errors.
fn decode_measurement(
    section: &Section<'_>,
    truth: &Machine,
    usual: &Usual<'_>,
    lines: &mut Vec<ShopLine>,
) -> Result<(), InputError> {
    let keys = [
        &["error", "errors", "file", "format", "curve", HOLDS_LOCATION][..],
        &Setup::KEYS,
        &INSTRUMENT_KEYS,
    ];
    section.allow(&keys.concat())?;
    let named = match (section.get("error"), section.get("errors")) {
        (Some(one), None) => vec![one],
        (None, Some(several)) => several.items()?,
        (Some(_), Some(several)) => {
            return Err(several.error("found error and errors together, expected one of them"));
        }
        (None, None) => return Err(section.error("key `error` (or `errors`) is missing")),
    };
    if named.is_empty() {
        return Err(section.error("found no error in `errors`, expected at least one"));
    }
    let mut errors: Vec<ErrorName> = Vec::new();
    for value in &named {
        let error = decode_motion(value, truth)?;
        if errors.contains(&error) {
            return Err(value.error(format!("{error} appears twice")));
        }
        errors.push(error);
        let name = match section.get("file") {
            Some(file) if named.len() > 1 => {
                return Err(file.error("one file for several errors, expected `error` with it"));
            }
            Some(file) => decode_file_name(&file)?,
            None => free_name(error, lines),
        };
        if lines.iter().any(|line| line.name == name) || TAKEN.contains(&name.as_str()) {
            return Err(value.error(format!("the file {name} is written already")));
        }
        let setup = Setup::decode(section, error, truth)?;
        let instrument = decode_instrument(section, usual.instrument)?;
        if let Method::Angular { bridge_mm, .. } = setup.method {
            // Only straightness is allowed here.
            tilt_sign(error, TiltReading::Slope).map_err(|e| value.error(e.to_string()))?;
            let travel = truth.axis(error.axis).map_or([0.0; 2], |axis| axis.travel);
            let steps = (travel[1] - travel[0]) / bridge_mm;
            if !(1.0..=MAX_TARGETS as f64).contains(&steps) {
                return Err(value.error(format!(
                    "the travel holds {steps:.1} bridges, expected 1 to {MAX_TARGETS}"
                )));
            }
            instrument
                .check_count(bridge_targets(travel, bridge_mm).len())
                .map_err(|e| value.error(e.to_string()))?;
        }
        let curve = section.get("curve");
        let line = ShopLine {
            format: section.one_of("format", &Format::NAMES, usual.format)?,
            setup,
            instrument,
            curve: curve.map(|value| CurveChoice::decode(&value, error.axis)).transpose()?,
            holds_location: decode_holds_location(section, error)?,
            name,
        };
        if let Some(reason) = line.format.refuses(&line) {
            return Err(value.error(format!("{error}: {reason}")));
        }
        lines.push(line);
    }
    Ok(())
}

/// Returns a file name that is not used yet: `eyy`, then `eyy-2`, …
fn free_name(error: ErrorName, lines: &[ShopLine]) -> String {
    let base = error.to_string().to_lowercase();
    let before = lines.iter().filter(|line| line.setup.error == error);
    match before.count() {
        0 => base,
        count => format!("{base}-{}", count + 1),
    }
}

const POSES: usize = 30;

fn decode_observations(
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
        let observation = decode_observation(&section, truth, instrument, &observations, inputs)?;
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

fn decode_observation(
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
        None => free_observation_name(kind, before),
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
fn free_observation_name(kind: &str, before: &[ShopObservation]) -> String {
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

const MOST_READINGS: usize = 5_000_000;

impl Shop {
    pub(crate) fn check_size(&self) -> Result<(), ShopError> {
        let lines = self.lines.iter().map(|line| self.readings_of(line));
        let observations = self.observations.iter().map(rows_of);
        let found = lines.chain(observations).fold(0, usize::saturating_add);
        if found > MOST_READINGS {
            let most = MOST_READINGS;
            return Err(ShopError::Readings { found, most });
        }
        Ok(())
    }

    fn readings_of(&self, line: &ShopLine) -> usize {
        let targets = match line.setup.method {
            Method::Direct => line.instrument.targets,
            Method::Angular { bridge_mm, .. } => {
                let axis = self.truth.axis(line.setup.error.axis);
                axis.map_or(0, |axis| bridge_targets(axis.travel, bridge_mm).len())
            }
        };
        over(&line.instrument, targets)
    }
}

fn over(instrument: &Instrument, targets: usize) -> usize {
    let directions = 1 + usize::from(instrument.both_directions);
    targets.saturating_mul(instrument.runs as usize).saturating_mul(directions)
}

fn rows_of(observation: &ShopObservation) -> usize {
    let instrument = &observation.instrument;
    match &observation.setting {
        Setting::Sphere { poses: Poses::Drawn(poses), centres, .. } => {
            poses.saturating_mul(centres.len())
        }
        Setting::Points { poses, .. }
        | Setting::Sphere { poses, .. }
        | Setting::Distance { poses, .. } => poses.count(),
        Setting::StepGauge(bar) | Setting::BallRow { bar, .. } => {
            over(instrument, bar.distances.len())
        }
        Setting::Diagonals { names } => {
            over(instrument, instrument.targets).saturating_mul(names.len())
        }
    }
}
