//! Reads machine files, with messages that name file, line and key, and writes them with a checksum.

use core::fmt::Write;
use std::{collections::BTreeMap, path::Path};

use sha2::{Digest, Sha256};
use volcomp_document::{Document, FileKind, InputError, Section, Value, toml_string};
use volcomp_kinematics::{
    DhConvention, DhRow, DhTable, MotionFrame, Pose, Structure,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName, UnknownErrorName, bounds::PLAUSIBLE_DEGC};

use crate::{
    axis::{Axis, Tool},
    curve_file::{CurveContext, decode_error_curve, write_error_curve},
    error::{ModelError, ThermalRefusal},
    machine::{Machine, Parts},
    provenance::{Origin, Provenance, Source, hexadecimal},
    thermal::{Drift, Expansion, MARGINS_K, Seen, Thermal, default_margin_k},
};

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

/// Direction components below this are rounding errors of sines and cosines of right angles.
const DIRECTION_ROUNDING: f64 = 1e-14;
/// Coordinates below this are rounding errors, mm.
const POINT_ROUNDING_MM: f64 = 1e-10;
/// Maximum distance of a configured point from the line of its axis, mm.
const ON_THE_LINE_MM: f64 = 1e-6;

/// Sets the directions and points of the axes from `[dh]`, if the file has it.
fn place_by_table(
    root: &Section<'_>,
    structure: &Structure,
    axes: &mut [Axis],
) -> Result<(), InputError> {
    let Some(section) = root.section("dh")? else {
        return Ok(());
    };
    section.allow(&["convention", "base", "rows"])?;
    let conventions = [("distal", DhConvention::Distal), ("proximal", DhConvention::Proximal)];
    let table = DhTable {
        convention: section.one_of("convention", &conventions, DhConvention::Distal)?,
        base: match section.section("base")? {
            Some(base) => decode_base(&base)?,
            None => Pose::identity(),
        },
        rows: decode_rows(&section.require("rows")?, structure)?.into_iter().collect(),
    };
    let chain = table.to_chain(structure.clone()).map_err(|e| section.error(e.to_string()))?;
    let stated = root.require("axes")?.section()?;
    for (axis, joint) in axes.iter_mut().zip(chain.joints()) {
        let keys = stated.require(&axis.name.to_string())?.section()?;
        if let Some(value) = keys.get("direction") {
            return Err(value.error(format!(
                "found the direction of axis {} beside [dh], expected one of them",
                axis.name
            )));
        }
        axis.direction = Some(rounded(&joint.direction, DIRECTION_ROUNDING));
        // A linear axis has no fixed line; `point` is the point to which its errors apply.
        if axis.name.kind() == AxisKind::Linear {
            continue;
        }
        match (axis.point_mm, keys.get("point")) {
            (Some(point), Some(value)) => {
                let off_mm = (Vector3::from(point) - joint.point_mm).cross(&joint.direction).norm();
                // NaN is rejected as well.
                if off_mm > ON_THE_LINE_MM || off_mm.is_nan() {
                    return Err(value.error(format!(
                        "found a point {off_mm:.6} mm off the line that [dh] gives axis {}, expected one on it",
                        axis.name
                    )));
                }
            }
            _ => axis.point_mm = Some(rounded(&joint.point_mm, POINT_ROUNDING_MM)),
        }
    }
    Ok(())
}

fn rounded(vector: &Vector3<f64>, below: f64) -> [f64; 3] {
    vector.map(|x| if x.abs() < below { 0.0 } else { x }).into()
}

fn decode_base(section: &Section<'_>) -> Result<Pose, InputError> {
    section.allow(&["point", "x", "z"])?;
    let vector = |key: &str, default: [f64; 3]| {
        Ok::<_, InputError>(Vector3::from(section.optional(key, Value::vector)?.unwrap_or(default)))
    };
    let (point, x, z) =
        (vector("point", [0.0; 3])?, vector("x", [1.0, 0.0, 0.0])?, vector("z", [0.0, 0.0, 1.0])?);
    // The vector is scaled first, so that the squares neither underflow nor overflow.
    let unit = |v: Vector3<f64>| (v.amax() > 0.0).then(|| (v / v.amax()).normalize());
    let frame = unit(z).zip(unit(x)).and_then(|(z, x)| {
        let y = z.cross(&x).try_normalize(1e-6)?;
        Some(Matrix3::from_columns(&[y.cross(&z), y, z]))
    });
    let Some(rotation) = frame else {
        return Err(section.error(
            "found x along z or a vector of zeros, expected two directions across each other",
        ));
    };
    Ok(Pose { rotation, translation_mm: point })
}

fn decode_rows(value: &Value<'_>, structure: &Structure) -> Result<Vec<DhRow>, InputError> {
    let axes = structure.axes();
    let items = value.items()?;
    if items.len() != axes.len() {
        return Err(value.error(format!(
            "found {} rows, expected {}: one for each axis of `{structure}`, from the workpiece to the tool",
            items.len(),
            axes.len()
        )));
    }
    let mut rows = Vec::new();
    for (item, &axis) in items.iter().zip(axes) {
        let row = item.section()?;
        row.allow(&["axis", "theta", "d", "a", "alpha"])?;
        let named = row.require("axis")?;
        if named.text()?.parse::<AxisName>() != Ok(axis) {
            return Err(named.error(format!(
                "found \"{}\", expected \"{axis}\": rows are in the order of `{structure}`",
                named.text()?
            )));
        }
        let number = |key: &str| {
            let stated = row.optional(key, Value::number)?;
            Ok::<_, InputError>(stated.unwrap_or(0.0))
        };
        rows.push(DhRow {
            theta_rad: number("theta")?.to_radians(),
            d_mm: number("d")?,
            a_mm: number("a")?,
            alpha_rad: number("alpha")?.to_radians(),
        });
    }
    Ok(rows)
}

const MAX_RUNS_OR_TARGETS: usize = 100_000_000;

fn decode_provenance(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("provenance")? else {
        return Ok(());
    };
    section.allow(&["version", "serial", "date", "undecided", "error"])?;
    let text = |key: &str| section.optional(key, |v| v.text().map(str::to_owned));
    let provenance = Provenance {
        version: text("version")?,
        serial: text("serial")?,
        date: text("date")?,
        undecided: section.optional("undecided", decode_names)?.unwrap_or_default(),
        errors: section.tables("error", decode_origin)?,
    };
    let refused = machine.set_provenance(provenance);
    refused.map_err(|refusal| section.error(refusal.to_string()).into())
}

fn decode_names(value: &Value<'_>) -> Result<Vec<ErrorName>, InputError> {
    let name = |item: &Value<'_>| {
        let name = item.text()?.parse::<ErrorName>();
        name.map_err(|e| item.error(e.to_string()))
    };
    value.items()?.iter().map(name).collect()
}

fn decode_origin(section: &Section<'_>) -> Result<Origin, InputError> {
    let value = section.require("error")?;
    let error: ErrorName = (value.text()?.parse())
        .map_err(|e: volcomp_vocabulary::UnknownErrorName| value.error(e.to_string()))?;
    let unit = error.component.unit();
    let (residual, leave_one_out) = (format!("residual_{unit}"), format!("leave_one_out_{unit}"));
    section.allow(&["error", "method", "rule", &residual, &leave_one_out, "from"])?;
    Ok(Origin {
        error,
        method: section.require("method")?.text()?.to_owned(),
        rule: section.optional("rule", |v| v.text().map(str::to_owned))?,
        residual: section.optional(&residual, Value::number)?,
        leave_one_out: section.optional(&leave_one_out, Value::number)?,
        sources: section.tables("from", decode_source)?,
    })
}

fn decode_source(section: &Section<'_>) -> Result<Source, InputError> {
    section.allow(&["file", "sha256", "runs", "targets", "at", "date"])?;
    let count = |key: &str| section.optional(key, |v| v.count(MAX_RUNS_OR_TARGETS));
    let mut at = Vec::new();
    if let Some(axes) = section.section("at")? {
        for (key, value) in axes.values() {
            let axis = key.parse::<AxisName>();
            let axis = axis.map_err(|e| value.error(e.to_string()))?;
            at.push((axis, value.number()?));
        }
    }
    at.sort_by_key(|(axis, _)| *axis);
    Ok(Source {
        file: section.require("file")?.text()?.to_owned(),
        sha256: section.require("sha256")?.text()?.to_owned(),
        runs: count("runs")?,
        targets: count("targets")?,
        at,
        date: section.optional("date", |v| v.text().map(str::to_owned))?,
    })
}

/// The table as text. It is empty if nothing is recorded, so that files without provenance keep their text and
/// checksum.
fn write_provenance(provenance: &Provenance) -> String {
    if provenance.is_empty() {
        return String::new();
    }
    let mut text = String::from("\n[provenance]\n");
    let of_all = [
        ("version", &provenance.version),
        ("serial", &provenance.serial),
        ("date", &provenance.date),
    ];
    for (key, value) in of_all {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {}", toml_string(value)); // writing to a String cannot fail
        }
    }
    if !provenance.undecided.is_empty() {
        let names = provenance.undecided.iter().map(|name| format!("\"{name}\""));
        let names: Vec<String> = names.collect();
        let _ = writeln!(text, "undecided = [{}]", names.join(", "));
    }
    for origin in &provenance.errors {
        let unit = origin.error.component.unit();
        let _ = write!(
            text,
            "\n[[provenance.error]]\nerror = \"{}\"\nmethod = {}\n",
            origin.error,
            toml_string(&origin.method)
        );
        if let Some(rule) = &origin.rule {
            let _ = writeln!(text, "rule = {}", toml_string(rule));
        }
        if let Some(residual) = origin.residual {
            let _ = writeln!(text, "residual_{unit} = {residual:?}");
        }
        if let Some(error) = origin.leave_one_out {
            let _ = writeln!(text, "leave_one_out_{unit} = {error:?}");
        }
        if !origin.sources.is_empty() {
            let sources: Vec<String> = origin.sources.iter().map(write_source).collect();
            let _ = writeln!(text, "from = [\n    {},\n]", sources.join(",\n    "));
        }
    }
    text
}

fn write_source(source: &Source) -> String {
    let mut text = format!(
        "{{ file = {}, sha256 = {}",
        toml_string(&source.file),
        toml_string(&source.sha256)
    );
    for (key, count) in [("runs", source.runs), ("targets", source.targets)] {
        if let Some(count) = count {
            let _ = write!(text, ", {key} = {count}"); // writing to a String cannot fail
        }
    }
    if !source.at.is_empty() {
        let at = source.at.iter().map(|(axis, q)| format!("{axis} = {q:?}"));
        let _ = write!(text, ", at = {{ {} }}", at.collect::<Vec<_>>().join(", "));
    }
    if let Some(date) = &source.date {
        let _ = write!(text, ", date = {}", toml_string(date));
    }
    text + " }"
}

/// Writes the machine file, without its checksum, in a fixed order and spelling.
fn canonical(machine: &Machine) -> String {
    let mut text = format!("name = {}\n", toml_string(&machine.name));
    let mut line = |content: String| {
        text.push_str(&content);
        text.push('\n');
    };
    line(format!("structure = \"{}\"", machine.chain().structure()));
    if let Some(axes) = machine.correct() {
        let names: Vec<String> = axes.iter().map(|axis| format!("\"{axis}\"")).collect();
        line(format!("correct = [{}]", names.join(", ")));
    }
    for axis in machine.axes() {
        line(format!("\n[axes.{}]\ntravel = {:?}", axis.name, axis.travel));
        if let Some(point) = axis.point_mm {
            line(format!("point = {point:?}"));
        }
        if let Some(direction) = axis.direction {
            line(format!("direction = {direction:?}"));
        }
        if let Some(modulo) = axis.modulo {
            line(format!("modulo = {modulo:?}"));
        }
        if axis.motion_frame == MotionFrame::Turning {
            line("motion_frame = \"turning\"".to_owned());
        }
    }
    line("\n[tool]".to_owned());
    line(write_tool(machine.tool()));
    for (name, tool) in machine.tools() {
        line(format!("[tools.{}]\n{}", toml_string(name), write_tool(tool)));
    }
    line(format!("[workpiece]\norigin = {:?}", machine.workpiece_origin_mm()));
    line("\n[errors]".to_owned());
    for (name, curve) in machine.errors() {
        line(format!("{name} = {}", write_error_curve(curve, machine.axes())));
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
    line(write_thermal(machine.thermal()));
    text += &write_provenance(machine.provenance());
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
    // Files without tested ranges are written without `margin_k`, so that they keep their text and checksum.
    if !thermal.seen.is_empty() || thermal.margin_k != Thermal::default().margin_k {
        let _ = writeln!(text, "margin_k = {:?}", thermal.margin_k); // writing to a String cannot fail
    }
    for term in &thermal.expansion {
        let _ = write!(
            text,
            "\n[[thermal.expansion]]\nerror = \"{}\"\nsensor = {}\num_per_m_k = {:?}\nfixed_mm = {:?}\n",
            term.error,
            toml_string(&term.sensor),
            term.um_per_m_k,
            term.fixed_mm
        );
    }
    for term in &thermal.drift {
        let sensors: Vec<String> = term
            .sensors
            .iter()
            .map(|(name, weight)| format!("{} = {weight:?}", toml_string(name)))
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
    for seen in &thermal.seen {
        let _ = write!(
            text,
            "\n[[thermal.seen]]\nerror = \"{}\"\nsensor = {}\ndegc = {:?}\n",
            seen.error,
            toml_string(&seen.sensor),
            seen.degc
        );
        if let Some(rates) = seen.k_per_min {
            let _ = writeln!(text, "k_per_min = {rates:?}");
        }
    }
    text
}
