//! The machine file: decoded with precise errors, written back with its checksum.

use core::fmt::Write;
use std::collections::BTreeMap;

use sha2::{Digest, Sha256};
use volcomp_document::{Document, InputError, Section, Value};
use volcomp_kinematics::Structure;
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use crate::{
    curve_file::{CurveContext, decode_error_curve, write_error_curve},
    error::ModelError,
    machine::{Axis, Machine, Parts, Tool},
    thermal::{Drift, Expansion, Thermal},
};

const TOP_KEYS: [&str; 11] = [
    "name",
    "checksum",
    "structure",
    "type",
    "axes",
    "tool",
    "tools",
    "workpiece",
    "errors",
    "assembly",
    "thermal",
];

impl Machine {
    /// Decodes the text of a machine file; `file` names it in messages.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ModelError> {
        Self::decode(&Document::new(file, text))
    }

    /// Decodes a document that is a machine file.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn decode(document: &Document) -> Result<Self, ModelError> {
        document.decode(|root| decode_machine(&root))
    }

    /// The machine as a machine file, with its checksum.
    pub fn to_toml(&self) -> String {
        let text = canonical(self);
        let (head, rest) = text.split_once('\n').unwrap_or((&text, ""));
        format!("{head}\nchecksum = \"{}\"\n{rest}", checksum_of(&text))
    }

    /// `sha256:` and 64 hexadecimal digits over everything that the machine file states: comments,
    /// blanks and the order of keys do not count.
    pub fn checksum(&self) -> String {
        checksum_of(&canonical(self))
    }
}

fn checksum_of(canonical: &str) -> String {
    let mut text = String::from("sha256:");
    for byte in Sha256::digest(canonical.as_bytes()) {
        let _ = write!(text, "{byte:02x}"); // writing to a String cannot fail
    }
    text
}

fn decode_machine(root: &Section<'_>) -> Result<Machine, ModelError> {
    root.allow(&TOP_KEYS)?;
    let structure = decode_structure(root)?;
    let axes = decode_axes(root, &structure)?;
    let tool = root
        .section("tool")?
        .map_or_else(|| Ok(Tool::default()), |s| decode_tool(&s))?;
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
            section.get("origin").map_or(Ok([0.0; 3]), |v| v.vector())?
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
        machine.thermal = decode_thermal(&section, &machine)?;
    }
    check_checksum(root, &machine)?;
    Ok(machine)
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

fn decode_structure(root: &Section<'_>) -> Result<Structure, InputError> {
    match (root.get("structure"), root.section("type")?) {
        (Some(value), None) => value
            .text()?
            .parse()
            .map_err(|e: volcomp_kinematics::StructureError| value.error(e.to_string())),
        (None, Some(section)) => {
            section.allow(&["translational", "rotary", "rotary_axes"])?;
            // At most 255, so that the number fits its type; above 3 is refused by the structure.
            let number = |key: &str| -> Result<u8, InputError> {
                let count = section.get(key).map_or(Ok(0), |v| v.count(255))?;
                Ok(u8::try_from(count).unwrap_or(u8::MAX))
            };
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
    axis_name(text).ok_or_else(|| {
        value.error(format!(
            "found \"{text}\", expected an axis letter: X Y Z A B C U V W"
        ))
    })
}

fn axis_name(text: &str) -> Option<AxisName> {
    let mut letters = text.chars();
    let name = AxisName::from_letter(letters.next()?)?;
    letters.next().is_none().then_some(name)
}

fn decode_axes(root: &Section<'_>, structure: &Structure) -> Result<Vec<Axis>, InputError> {
    let section = root.require("axes")?.section()?;
    for (key, value) in section.values() {
        if axis_name(key).is_none_or(|name| structure.index_of(name).is_none()) {
            return Err(value.error(format!("the structure `{structure}` has no axis {key}")));
        }
    }
    let decode =
        |&name: &AxisName| decode_axis(&section.require(&name.to_string())?.section()?, name);
    structure.axes().iter().map(decode).collect()
}

fn decode_axis(section: &Section<'_>, name: AxisName) -> Result<Axis, InputError> {
    section.allow(&["travel", "point", "direction", "modulo"])?;
    let travel_value = section.require("travel")?;
    let travel: [f64; 2] = travel_value.vector()?;
    if travel[0] >= travel[1] {
        return Err(travel_value.error(format!(
            "found [{:?}, {:?}], expected the lower end below the upper end",
            travel[0], travel[1]
        )));
    }
    let direction: Option<[f64; 3]> = section.get("direction").map(|v| v.vector()).transpose()?;
    if let (Some([0.0, 0.0, 0.0]), Some(value)) = (direction, section.get("direction")) {
        return Err(value.error("found a zero direction, expected a vector of any other length"));
    }
    let modulo = section
        .get("modulo")
        .map(|v| v.number().map(|n| (n, v)))
        .transpose()?;
    if let Some((period, value)) = &modulo
        && (name.kind() == AxisKind::Linear || *period <= 0.0)
    {
        return Err(value.error(format!(
            "found {period:?} on axis {name}, expected a positive period in deg on a rotary axis"
        )));
    }
    Ok(Axis {
        name,
        travel,
        modulo: modulo.map(|(period, _)| period),
        direction,
        point_mm: section.get("point").map(|v| v.vector()).transpose()?,
    })
}

fn decode_tool(section: &Section<'_>) -> Result<Tool, InputError> {
    section.allow(&["tip", "axis", "gauge", "length", "offset"])?;
    if let (Some(tip), Some(_)) = (section.get("tip"), section.get("gauge")) {
        return Err(tip.error("found tip and gauge together, expected one of them"));
    }
    let vector = |key: &str| section.get(key).map(|v| v.vector::<3>()).transpose();
    let axis = vector("axis")?;
    if let (Some([0.0, 0.0, 0.0]), Some(value)) = (axis, section.get("axis")) {
        return Err(value.error("found a zero direction, expected a vector of any other length"));
    }
    Ok(Tool {
        tip_mm: vector("tip")?,
        gauge_mm: vector("gauge")?,
        length_mm: section.get("length").map(|v| v.number()).transpose()?,
        offset_mm: vector("offset")?,
        axis,
    })
}

/// `length` and `offset` mean something only from a gauge point.
fn check_gauge_keys(
    root: &Section<'_>,
    tool: &Tool,
    tools: &BTreeMap<String, Tool>,
) -> Result<(), InputError> {
    let without_gauge =
        |t: &Tool| t.gauge_mm.is_none() && (t.length_mm.is_some() || t.offset_mm.is_some());
    let message = "length and offset need a gauge point: key `gauge` is missing";
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

fn decode_errors(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("errors")? else {
        return Ok(());
    };
    let mut seen: BTreeMap<ErrorName, String> = BTreeMap::new();
    for (key, value) in section.values() {
        let name: ErrorName = key
            .parse()
            .map_err(|e: volcomp_vocabulary::UnknownErrorName| value.error(e.to_string()))?;
        if let Some(other) = seen.insert(name, key.to_owned()) {
            return Err(value
                .error(format!("{key} is the same error as {other}"))
                .into());
        }
        let axis = machine.axis(name.axis).ok_or_else(|| {
            let structure = machine.chain().structure();
            value.error(format!(
                "the structure `{structure}` has no axis {}",
                name.axis
            ))
        })?;
        let set = if name.location {
            if !value.is_number() {
                let message = "a location error is one number, never a curve";
                return Err(value.error(message).into());
            }
            let number = value.number()?;
            machine.set_location(name, number)
        } else {
            let context = CurveContext {
                axes: machine.axes(),
                travel: axis.travel,
            };
            let curve = decode_error_curve(&value, &context)?;
            machine.set_error(name, curve)
        };
        set.map_err(|e| match e {
            // The key of the value names the error already.
            ModelError::Error { reason, .. } => value.error(reason),
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
        axis_name(key)
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

fn decode_thermal(section: &Section<'_>, machine: &Machine) -> Result<Thermal, InputError> {
    section.allow(&["reference", "expansion", "drift"])?;
    let terms = |key: &str| match section.get(key) {
        Some(value) => value.items()?.iter().map(Value::section).collect(),
        None => Ok(Vec::new()),
    };
    let expansion: Vec<Section<'_>> = terms("expansion")?;
    let drift: Vec<Section<'_>> = terms("drift")?;
    Ok(Thermal {
        reference_degc: section.get("reference").map_or(Ok(20.0), |v| v.number())?,
        expansion: expansion
            .iter()
            .map(|term| decode_expansion(term, machine))
            .collect::<Result<_, _>>()?,
        drift: drift
            .iter()
            .map(|term| decode_drift(term, machine))
            .collect::<Result<_, _>>()?,
    })
}

/// The error motion that a thermal term is added to.
fn decode_thermal_error(term: &Section<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let value = term.require("error")?;
    let text = value.text()?;
    text.parse()
        .ok()
        .filter(|name: &ErrorName| !name.location && machine.axis(name.axis).is_some())
        .ok_or_else(|| {
            let structure = machine.chain().structure();
            value.error(format!(
                "found \"{text}\", expected an error motion E?N of an axis of `{structure}`"
            ))
        })
}

fn decode_expansion(term: &Section<'_>, machine: &Machine) -> Result<Expansion, InputError> {
    term.allow(&["error", "sensor", "um_per_m_k", "fixed_mm"])?;
    let error = decode_thermal_error(term, machine)?;
    if error.axis.kind() == AxisKind::Rotary || error.component.is_angular() {
        return Err(term.error(format!(
            "found expansion of {error}, expected a linear error motion of a linear axis"
        )));
    }
    Ok(Expansion {
        error,
        sensor: term.require("sensor")?.text()?.to_owned(),
        um_per_m_k: term.require("um_per_m_k")?.number()?,
        fixed_mm: term.get("fixed_mm").map_or(Ok(0.0), |v| v.number())?,
    })
}

fn decode_drift(term: &Section<'_>, machine: &Machine) -> Result<Drift, InputError> {
    term.allow(&["error", "sensors", "um_per_k", "urad_per_k", "lag_s"])?;
    let error = decode_thermal_error(term, machine)?;
    let key = if error.component.is_angular() {
        "urad_per_k"
    } else {
        "um_per_k"
    };
    let mut sensors = BTreeMap::new();
    for (name, weight) in term.require("sensors")?.section()?.values() {
        sensors.insert(name.to_owned(), weight.number()?);
    }
    let lag = term.get("lag_s").map_or(Ok(0.0), |v| v.number())?;
    if lag < 0.0 || sensors.is_empty() {
        return Err(term.error("expected at least one sensor and a lag_s of 0 or more"));
    }
    Ok(Drift {
        error,
        sensors,
        per_k: term.require(key)?.number()?,
        lag_s: lag,
    })
}

/// The machine file without its checksum: fixed order, fixed spelling.
fn canonical(machine: &Machine) -> String {
    let mut text = format!("name = {}\n", quoted(&machine.name));
    let mut line = |content: String| {
        text.push_str(&content);
        text.push('\n');
    };
    line(format!("structure = \"{}\"", machine.chain().structure()));
    for axis in machine.axes() {
        line(format!(
            "\n[axes.{}]\ntravel = {:?}",
            axis.name, axis.travel
        ));
        if let Some(point) = axis.point_mm {
            line(format!("point = {point:?}"));
        }
        if let Some(direction) = axis.direction {
            line(format!("direction = {direction:?}"));
        }
        if let Some(modulo) = axis.modulo {
            line(format!("modulo = {modulo:?}"));
        }
    }
    line("\n[tool]".to_owned());
    line(write_tool(machine.tool()));
    for (name, tool) in machine.tools() {
        line(format!("[tools.{}]\n{}", quoted(name), write_tool(tool)));
    }
    line(format!(
        "[workpiece]\norigin = {:?}",
        machine.workpiece_origin_mm()
    ));
    line("\n[errors]".to_owned());
    for (name, curve) in machine.errors() {
        line(format!(
            "{name} = {}",
            write_error_curve(curve, machine.axes())
        ));
    }
    for (name, value) in machine.locations() {
        line(format!("{name} = {value:?}"));
    }
    line("\n[assembly]".to_owned());
    for (index, axis) in machine.axes().iter().enumerate() {
        if machine.assembly(index) != [0.0; 6] {
            line(format!("{} = {:?}", axis.name, machine.assembly(index)));
        }
    }
    line(write_thermal(&machine.thermal));
    text
}

fn write_tool(tool: &Tool) -> String {
    let mut text = String::new();
    let vectors = [
        ("tip", tool.tip_mm),
        ("gauge", tool.gauge_mm),
        ("offset", tool.offset_mm),
        ("axis", tool.axis),
    ];
    for (key, vector) in vectors {
        if let Some(vector) = vector {
            let _ = writeln!(text, "{key} = {vector:?}"); // writing to a String cannot fail
        }
    }
    if let Some(length) = tool.length_mm {
        let _ = writeln!(text, "length = {length:?}");
    }
    text
}

fn write_thermal(thermal: &Thermal) -> String {
    let mut text = format!("\n[thermal]\nreference = {:?}\n", thermal.reference_degc);
    for term in &thermal.expansion {
        let _ = write!(
            text,
            "\n[[thermal.expansion]]\nerror = \"{}\"\nsensor = {}\num_per_m_k = {:?}\nfixed_mm = {:?}\n",
            term.error,
            quoted(&term.sensor),
            term.um_per_m_k,
            term.fixed_mm
        );
    }
    for term in &thermal.drift {
        let sensors: Vec<String> = term
            .sensors
            .iter()
            .map(|(name, weight)| format!("{} = {weight:?}", quoted(name)))
            .collect();
        let unit = term.error.component.unit();
        let _ = write!(
            text,
            "\n[[thermal.drift]]\nerror = \"{}\"\nsensors = {{ {} }}\n{unit}_per_k = {:?}\nlag_s = {:?}\n",
            term.error,
            sensors.join(", "),
            term.per_k,
            term.lag_s
        );
    }
    text
}

/// A TOML basic string.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
