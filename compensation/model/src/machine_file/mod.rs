//! Reads machine files, with messages that name file, line and key, and writes them with a checksum.

use std::{collections::BTreeMap, path::Path};

use sha2::{Digest, Sha256};
use volcomp_document::{Document, FileKind, InputError, Section, Value};
use volcomp_kinematics::{MotionFrame, Structure};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName, UnknownErrorName, bounds::PLAUSIBLE_DEGC};

use crate::{
    axis::Axis,
    curve_file::{CurveContext, decode_error_curve},
    error::{ModelError, ThermalRefusal},
    machine::{Machine, Parts},
    provenance::hexadecimal,
    thermal::{Drift, Expansion, MARGINS_K, Seen, Thermal, default_margin_k},
    tool::Tool,
};

mod denavit_hartenberg;
mod provenance;
mod write;

use denavit_hartenberg::place_by_table;
use provenance::decode_provenance;
use write::canonical;

const TOP_KEYS: [&str; 14] = [
    "name",
    "checksum",
    "structure",
    "type",
    "correct",
    "axes",
    "dh",
    "tool",
    "tools",
    "workpiece",
    "errors",
    "assembly",
    "thermal",
    "provenance",
];

impl Machine {
    /// Reads a machine file; [`parse`](Self::parse) takes its text.
    ///
    /// # Errors
    /// A file that cannot be read or is not UTF-8, or an invalid machine, with file, line and key.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ModelError> {
        Self::decode(&Document::read(path.as_ref())?)
    }

    /// Decodes the text of a machine file; `file` is its name in messages.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ModelError> {
        Self::decode(&Document::new(file, text))
    }

    /// Decodes a parsed document as a machine file.
    ///
    /// # Errors
    /// Invalid input, with file, line and key.
    pub fn decode(document: &Document) -> Result<Self, ModelError> {
        document.decode(|root| decode_machine(&root))
    }

    /// Writes the machine as a machine file, with its checksum.
    pub fn to_toml(&self) -> String {
        let text = canonical(self);
        let (head, rest) = text.split_once('\n').unwrap_or((&text, ""));
        format!("{head}\nchecksum = \"{}\"\n{rest}", checksum_of(&text))
    }

    /// `sha256:` and 64 hexadecimal digits over all content of the machine file; comments, blanks and the order of keys do not matter.
    pub fn checksum(&self) -> String {
        checksum_of(&canonical(self))
    }
}

fn checksum_of(canonical: &str) -> String {
    format!("sha256:{}", hexadecimal(&Sha256::digest(canonical.as_bytes())))
}

fn decode_machine(root: &Section<'_>) -> Result<Machine, ModelError> {
    root.allow_in(FileKind::Machine, &TOP_KEYS)?;
    refuse_keys_below_a_table(root)?;
    let structure = decode_structure(root)?;
    let mut axes = decode_axes(root, &structure)?;
    place_by_table(root, &structure, &mut axes)?;
    let tool = root.section("tool")?.map_or_else(|| Ok(Tool::default()), |s| decode_tool(&s))?;
    let mut tools = BTreeMap::new();
    if let Some(section) = root.section("tools")? {
        for (name, value) in section.values() {
            tools.insert(name.to_owned(), decode_tool(&value.section()?)?);
        }
    }
    check_gauge_keys(root, &tool, &tools)?;
    let origin = match root.section("workpiece")? {
        Some(section) => {
            section.allow(&["origin"])?;
            section.optional("origin", Value::vector)?.unwrap_or_default()
        }
        None => [0.0; 3],
    };
    let mut machine = Machine::from_parts(Parts {
        name: root.get("name").map_or(Ok(""), |v| v.text())?.to_owned(),
        structure,
        axes,
        tool,
        tools,
        workpiece_origin_mm: origin,
    })
    .map_err(|e| root.error(e.to_string()))?;
    decode_errors(root, &mut machine)?;
    decode_assembly(root, &mut machine)?;
    if let Some(section) = root.section("thermal")? {
        let thermal = decode_thermal(&section, machine.chain().structure())?;
        machine.set_thermal(thermal).map_err(|e| section.error(e.to_string()))?;
    }
    decode_correct(root, &mut machine)?;
    decode_provenance(root, &mut machine)?;
    check_checksum(root, &machine)?;
    Ok(machine)
}

/// Rejects root keys below the header of a table, which in TOML belong to that table even after an empty line.
fn refuse_keys_below_a_table(root: &Section<'_>) -> Result<(), InputError> {
    const ABOVE_TABLES: [&str; 3] = ["structure", "correct", "checksum"];
    for (table, value) in root.values() {
        // The keys of `tools` are names chosen by the user.
        let Some(section) = value.section().ok().filter(|_| table != "tools") else {
            continue;
        };
        for key in ABOVE_TABLES {
            if let Some(value) = section.get(key) {
                return Err(value.error(format!(
                    "found `{key}` below [{table}], expected it above the first table of the file"
                )));
            }
        }
    }
    Ok(())
}

fn check_checksum(root: &Section<'_>, machine: &Machine) -> Result<(), InputError> {
    let Some(value) = root.get("checksum") else {
        return Ok(());
    };
    let (found, expected) = (value.text()?, machine.checksum());
    if found == expected {
        return Ok(());
    }
    Err(value.error(format!(
        "found {found}, expected {expected}: the file was changed after it was written; if that was meant, remove this line"
    )))
}

fn decode_errors(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("errors")? else {
        return Ok(());
    };
    let mut seen: BTreeMap<ErrorName, String> = BTreeMap::new();
    for (key, value) in section.values() {
        let name: ErrorName = key.parse().map_err(|e: UnknownErrorName| {
            let upper = key.to_uppercase();
            value.error(match upper.parse::<ErrorName>() {
                Ok(_) => format!("found `{key}`, expected upper-case letters: `{upper}`"),
                Err(_) => e.to_string(),
            })
        })?;
        if let Some(other) = seen.insert(name, key.to_owned()) {
            return Err(value.error(format!("{key} is the same error as {other}")).into());
        }
        let axis = machine.axis(name.axis).ok_or_else(|| value.error(machine.lacks(name.axis)))?;
        let set = if name.location {
            if value.section().is_ok() {
                let message = "a location error is one number, never a curve";
                return Err(value.error(message).into());
            }
            let number = value.number()?;
            machine.set_location(name, number)
        } else {
            let context = CurveContext { axes: machine.axes(), travel: axis.travel };
            let curve = decode_error_curve(&value, &context)?;
            machine.set_error(name, curve)
        };
        set.map_err(|e| match e {
            // The key of the value already names the error.
            ModelError::Refused { reason, .. } => value.error(reason.to_string()),
            other => value.error(other.to_string()),
        })?;
    }
    Ok(())
}

fn decode_assembly(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("assembly")? else {
        return Ok(());
    };
    for (key, value) in section.values() {
        let six = value.vector::<6>()?;
        let name = key.parse::<AxisName>();
        name.ok()
            .filter(|&name| machine.axis(name).is_some())
            .ok_or_else(|| {
                let structure = machine.chain().structure();
                value.error(format!("the structure `{structure}` has no axis {key}"))
            })
            .map_err(ModelError::from)
            .and_then(|name| machine.set_assembly(name, six))?;
    }
    Ok(())
}

fn decode_structure(root: &Section<'_>) -> Result<Structure, InputError> {
    match (root.get("structure"), root.section("type")?) {
        (Some(value), None) => value
            .text()?
            .parse()
            .map_err(|e: volcomp_kinematics::StructureError| value.error(e.to_string())),
        (None, Some(section)) => {
            section.allow(&["translational", "rotary", "rotary_axes"])?;
            // `Structure` rejects numbers above 3.
            let number = |key: &str| section.whole_or(key, 0..=u8::MAX, 0);
            section.require("translational")?;
            let rotary_axes = section
                .get("rotary_axes")
                .map_or_else(|| Ok(Vec::new()), |v| v.items())?
                .iter()
                .map(decode_axis_name)
                .collect::<Result<Vec<_>, _>>()?;
            Structure::from_type(number("translational")?, number("rotary")?, &rotary_axes)
                .map_err(|e| section.error(e.to_string()))
        }
        (Some(value), Some(_)) => {
            Err(value.error("found structure and [type] together, expected one of them"))
        }
        (None, None) => Err(root.error("key `structure` (or table [type]) is missing")),
    }
}

fn decode_axis_name(value: &Value<'_>) -> Result<AxisName, InputError> {
    let text = value.text()?;
    text.parse().map_err(|_| {
        value.error(format!("found \"{text}\", expected an axis letter: X Y Z A B C U V W"))
    })
}

fn decode_axes(root: &Section<'_>, structure: &Structure) -> Result<Vec<Axis>, InputError> {
    let section = root.require("axes")?.section()?;
    for (key, value) in section.values() {
        if key.parse().map_or(true, |name| structure.index_of(name).is_none()) {
            let upper = key.to_uppercase();
            let is_lower_case = upper != key && upper.parse::<AxisName>().is_ok();
            return Err(value.error(if is_lower_case {
                format!("found `{key}`, expected an upper-case letter: `{upper}`")
            } else {
                format!("the structure `{structure}` has no axis {key}")
            }));
        }
    }
    let decode =
        |&name: &AxisName| decode_axis(&section.require(&name.to_string())?.section()?, name);
    structure.axes().iter().map(decode).collect()
}

fn decode_axis(section: &Section<'_>, name: AxisName) -> Result<Axis, InputError> {
    section.allow(&["travel", "point", "direction", "modulo", "motion_frame"])?;
    let travel_value = section.require("travel")?;
    let travel: [f64; 2] = travel_value.vector()?;
    if travel[0] >= travel[1] {
        return Err(travel_value.error(format!(
            "found [{:?}, {:?}], expected the lower end below the upper end",
            travel[0], travel[1]
        )));
    }
    let modulo = section.optional("modulo", |value| {
        let period = value.number()?;
        if name.kind() == AxisKind::Rotary && period > 0.0 {
            return Ok(period);
        }
        Err(value.error(format!(
            "found {period:?} on axis {name}, expected a positive period in deg on a rotary axis"
        )))
    })?;
    let motion_frame = section.optional("motion_frame", |value| {
        let words = [
            ("fixed", MotionFrame::Fixed),
            ("turning", MotionFrame::Turning),
        ];
        let frame = value.one_of(&words)?;
        if name.kind() == AxisKind::Rotary {
            return Ok(frame);
        }
        Err(value.error(format!(
            "found a motion frame on axis {name}, whose error motions ride with its carriage, expected it on a rotary axis"
        )))
    })?;
    Ok(Axis {
        name,
        travel,
        modulo,
        direction: section.optional("direction", decode_direction)?,
        point_mm: section.optional("point", Value::vector)?,
        motion_frame: motion_frame.unwrap_or_default(),
    })
}

/// A direction vector of any length except zero.
fn decode_direction(value: &Value<'_>) -> Result<[f64; 3], InputError> {
    let direction = value.vector()?;
    if direction == [0.0; 3] {
        return Err(value.error("found a zero direction, expected a vector of any other length"));
    }
    Ok(direction)
}

fn decode_correct(root: &Section<'_>, machine: &mut Machine) -> Result<(), InputError> {
    let Some(value) = root.get("correct") else {
        return Ok(());
    };
    let mut axes: Vec<AxisName> = Vec::new();
    for item in value.items()? {
        let axis = decode_axis_name(&item)?;
        axes.push(axis);
        match machine.set_correct(Some(&axes)) {
            Ok(()) => {}
            Err(ModelError::NoSuchAxis { structure, .. }) => {
                return Err(item.error(format!("the structure `{structure}` has no axis {axis}")));
            }
            Err(error) => return Err(item.error(error.to_string())),
        }
    }
    machine.set_correct(Some(&axes)).map_err(|e| value.error(e.to_string()))
}

fn decode_thermal(section: &Section<'_>, structure: &Structure) -> Result<Thermal, InputError> {
    section.allow(&["reference", "expansion", "drift", "seen", "margin_k"])?;
    let mut thermal = Thermal {
        reference_degc: section.number_or("reference", PLAUSIBLE_DEGC, 20.0)?,
        expansion: section.tables("expansion", |term| decode_expansion(term, structure))?,
        drift: section.tables("drift", |term| decode_drift(term, structure))?,
        seen: Vec::new(),
        margin_k: section.number_or("margin_k", MARGINS_K, default_margin_k())?,
    };
    let mut all = Vec::new();
    section.tables("seen", |seen| {
        all.push(decode_seen(seen, structure)?);
        // Each range is checked against the terms and the preceding ranges.
        thermal.seen.clone_from(&all);
        let last = all.last().map_or(Ok(()), |last| last.check(&thermal));
        last.map_err(|refusal| seen.error(refusal.to_string()))
    })?;
    Ok(thermal)
}

fn decode_seen(seen: &Section<'_>, structure: &Structure) -> Result<Seen, InputError> {
    seen.allow(&["error", "sensor", "degc", "k_per_min"])?;
    Ok(Seen {
        error: decode_motion(seen, structure)?,
        sensor: seen.require("sensor")?.text()?.to_owned(),
        degc: seen.require("degc")?.vector()?,
        k_per_min: seen.get("k_per_min").map(|v| v.vector()).transpose()?,
    })
}

const ANY_NUMBER: core::ops::RangeInclusive<f64> = f64::NEG_INFINITY..=f64::INFINITY;

fn decode_motion(term: &Section<'_>, structure: &Structure) -> Result<ErrorName, InputError> {
    let value = term.require("error")?;
    let found = value.text()?;
    let known = |name: &ErrorName| !name.location && structure.index_of(name.axis).is_some();
    found.parse().ok().filter(known).ok_or_else(|| {
        let refusal =
            ThermalRefusal::Motion { found: found.to_owned(), structure: structure.to_string() };
        value.error(refusal.to_string())
    })
}

fn decode_expansion(term: &Section<'_>, structure: &Structure) -> Result<Expansion, InputError> {
    term.allow(&["error", "sensor", "um_per_m_k", "fixed_mm"])?;
    let expansion = Expansion {
        error: decode_motion(term, structure)?,
        sensor: term.require("sensor")?.text()?.to_owned(),
        um_per_m_k: term.require("um_per_m_k")?.number()?,
        fixed_mm: term.number_or("fixed_mm", ANY_NUMBER, 0.0)?,
    };
    match expansion.check(structure) {
        Ok(()) => Ok(expansion),
        Err(refusal) => Err(term.error(refusal.to_string())),
    }
}

fn decode_drift(term: &Section<'_>, structure: &Structure) -> Result<Drift, InputError> {
    term.allow(&["error", "sensors", "um_per_k", "urad_per_k", "lag_s"])?;
    let error = decode_motion(term, structure)?;
    let per_k = format!("{}_per_k", error.component.unit());
    let mut sensors = BTreeMap::new();
    for (name, weight) in term.require("sensors")?.section()?.values() {
        sensors.insert(name.to_owned(), weight.number()?);
    }
    let drift = Drift {
        error,
        sensors,
        per_k: term.require(&per_k)?.number()?,
        lag_s: term.number_or("lag_s", ANY_NUMBER, 0.0)?,
    };
    match drift.check(structure) {
        Ok(()) => Ok(drift),
        Err(refusal) => Err(term.error(refusal.to_string())),
    }
}

fn decode_tool(section: &Section<'_>) -> Result<Tool, InputError> {
    section.allow(&["tip", "axis", "gauge", "length", "offset"])?;
    if let (Some(tip), Some(_)) = (section.get("tip"), section.get("gauge")) {
        return Err(tip.error("found tip and gauge together, expected one of them"));
    }
    let vector = |key: &str| section.optional(key, Value::vector);
    Ok(Tool {
        tip_mm: vector("tip")?,
        gauge_mm: vector("gauge")?,
        length_mm: section.optional("length", Value::number)?,
        offset_mm: vector("offset")?,
        axis: section.optional("axis", decode_direction)?,
    })
}

fn check_gauge_keys(
    root: &Section<'_>,
    tool: &Tool,
    tools: &BTreeMap<String, Tool>,
) -> Result<(), InputError> {
    let without_gauge =
        |t: &Tool| t.gauge_mm.is_none() && (t.length_mm.is_some() || t.offset_mm.is_some());
    let message = "length and offset need a gauge point: key `gauge` is missing, such as `gauge = [0.0, 0.0, 0.0]`";
    if let (true, Some(section)) = (without_gauge(tool), root.section("tool")?) {
        return Err(section.error(message));
    }
    if tool.gauge_mm.is_some() {
        return Ok(());
    }
    for (name, other) in tools {
        if without_gauge(other)
            && let Some(section) = root.section("tools")?.and_then(|s| s.get(name))
        {
            return Err(section.error(message));
        }
    }
    Ok(())
}
