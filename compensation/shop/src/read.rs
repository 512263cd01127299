//! Reads a shop file and its truth machine.

use std::path::Path;

use volcomp_calibrate::{
    CurveChoice, HOLDS_LOCATION, Method, Setup, decode_holds_location, decode_location_errors,
    decode_motion, is_square,
};
use volcomp_document::{Document, FileKind, InputError, Section};
use volcomp_metrology::{TiltReading, squareness_parts, tilt_sign};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName, Urad};

use crate::{
    error::ShopError,
    instrument::{INSTRUMENT_KEYS, Instrument, MAX_TARGETS, bridge_targets, decode_instrument},
    read_observation::decode_observations,
    shop::{Format, Header, Shop, ShopLine, ShopLocation, TAKEN, decode_file_name},
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
