//! Reads a file of observations, its machine file and its row files.

use std::path::{Component, Path, PathBuf};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_document::{CsvTable, Document, FileKind, InputError, Section, Value, read_text};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::basis::Basis;
use crate::checks::{
    MAX_COEFFICIENTS, MAX_DRIFT_ORDER, MAX_FOLDS, MAX_SECOND_ORDER, MIN_SPLINE_COEFFICIENTS,
    oblique, refuse_units, standard_uncertainty_um, unit_vector,
};
use crate::error::IdentifyError;
use crate::observations::{Kind, NumberKind, Observation, Observations, SecondAxis, Unknown};
use crate::row_file::{self, RowKind, read_rows};
use crate::setup_keys::{ObservationHeader, ReadFile, ReadState, frame, number, point_of, targets};
use crate::timeline::{OrderedObservation, set_times};

impl Observations {
    /// Reads a file of observations, its machine file and its row files.
    ///
    /// # Errors
    /// An unreadable file or an invalid entry, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, IdentifyError> {
        let document = Document::read(path)?;
        Self::decode(&document, path, &read_text)
    }

    /// Decodes the text of a file of observations at `path`. `read` returns the text of every file that it names.
    ///
    /// # Errors
    /// An unreadable file or an invalid entry, with file, line and key.
    pub fn parse(text: &str, path: &Path, read: &ReadFile<'_>) -> Result<Self, IdentifyError> {
        let document = Document::new(&path.display().to_string(), text);
        Self::decode(&document, path, read)
    }

    fn decode(
        document: &Document,
        path: &Path,
        read: &ReadFile<'_>,
    ) -> Result<Self, IdentifyError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut found = document.decode(|root| decode(&root, folder, read))?;
        found.files.insert(0, path.to_owned());
        Ok(found)
    }

    /// Keys at the root of a file that [`Observations::of_section`] reads.
    pub const KEYS: [&'static str; 5] = ["unknown", "observation", "penalty", "robust", "folds"];

    /// Decodes unknowns and observations from the root of a file, for a machine that is already known. The file is a
    /// file of observations, or another file with the same keys. Row files are named relative to `folder`;
    /// [`Observations::files`] contains only the row files.
    ///
    /// # Errors
    /// An unreadable file or an invalid entry, with file, line and key.
    pub fn of_section(
        root: &Section<'_>,
        machine: &Machine,
        folder: &Path,
        read: &ReadFile<'_>,
    ) -> Result<Self, IdentifyError> {
        observations(root, machine.clone(), folder, read)
    }
}

fn decode(
    root: &Section<'_>,
    folder: &Path,
    read: &ReadFile<'_>,
) -> Result<Observations, IdentifyError> {
    let keys = [&["machine"][..], &Observations::KEYS].concat();
    root.allow_in(FileKind::Observations, &keys)?;
    let machine_file = folder.join(root.require("machine")?.text()?);
    let machine = Machine::parse(&read(&machine_file)?, &machine_file.display().to_string())?;
    let mut found = observations(root, machine, folder, read)?;
    found.files.insert(0, machine_file);
    let mut machine_notes = found.machine.notes();
    machine_notes.extend(found.unknown.iter().filter_map(|unknown| {
        let name = unknown.error;
        let is_curve = |curve: &ErrorCurve| {
            !matches!(curve, ErrorCurve::Single(Field::Curve(Curve::Constant(_))))
        };
        let is_dropped = unknown.basis.is_some() && found.machine.error(name).is_some_and(is_curve);
        is_dropped.then(|| {
            format!("the curve of {name} in the machine file is dropped: {name} is unknown here")
        })
    }));
    found.notes.splice(0..0, machine_notes);
    Ok(found)
}

fn observations(
    root: &Section<'_>,
    machine: Machine,
    folder: &Path,
    read: &ReadFile<'_>,
) -> Result<Observations, IdentifyError> {
    let penalised = decode_penalty(root, false)?;
    let unknown = decode_unknown(&root.require("unknown")?, &machine, penalised)?;
    let mut state = ReadState::default();
    let mut files = Vec::new();
    let mut observations = Vec::new();
    let items = root.require("observation")?.items()?;
    let sections: Vec<Section<'_>> = items.iter().map(Value::section).collect::<Result<_, _>>()?;
    refuse_same_file(&sections)?;
    // Fitted observations are decoded first, because predicted observations refer to their set-ups.
    let mut order: Vec<(bool, usize)> = Vec::new();
    for (place, section) in sections.iter().enumerate() {
        order.push((section.truth_or("judge", false)?, place));
    }
    order.sort_unstable();
    for (judge, place) in order {
        let observation = decode_observation(
            &sections[place],
            (folder, read),
            &machine,
            judge,
            &mut state,
            &mut files,
        )?;
        observations.push(observation);
    }
    let observations = set_times(observations, &machine, &mut state.notes);
    state.notes.extend(missing_tool_column(&machine, &state.without_tool));
    Ok(Observations {
        files,
        unknown,
        observations,
        setup: state.setup,
        robust: root.truth_or("robust", false)?,
        folds: root.whole_or("folds", 0..=MAX_FOLDS, 10)?,
        notes: state.notes,
        ..Observations::of(machine)
    })
}

fn missing_tool_column(machine: &Machine, files: &[String]) -> Option<String> {
    let tools: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    (tools.len() > 1 && !files.is_empty()).then(|| {
        format!(
            "{}: no column `tool`, so all rows use the tip of `[tool]`; the machine file also has the tools {}: if one of them was in the spindle, add the column",
            files.join(", "),
            tools.join(", ")
        )
    })
}

/// Rejects a row file that two observations name: its rows would count twice in the fit, or would validate a fit to themselves. A file of
/// ball distances (`row`) may be named once for every position of the bar.
fn refuse_same_file(sections: &[Section<'_>]) -> Result<(), InputError> {
    let mut before: Vec<(PathBuf, Value<'_>)> = Vec::new();
    for section in sections {
        // A missing or invalid `file` is rejected where it is decoded.
        let Some((value, Ok(name))) = section.get("file").map(|v| (v.clone(), v.text())) else {
            continue;
        };
        // `a.csv` and `./a.csv` are one file.
        let path: PathBuf =
            Path::new(name).components().filter(|part| *part != Component::CurDir).collect();
        if let Some((_, other)) = before.iter().find(|(known, _)| *known == path) {
            let place = other.error("");
            return Err(value.error(format!(
                "found {name:?}, which is also the file of the observation at {}:{}, expected another file: a row file belongs to one observation",
                place.file, place.line
            )));
        }
        before.push((path, value));
    }
    Ok(())
}

fn read_table(
    file: &Value<'_>,
    path: &Path,
    read: &ReadFile<'_>,
    state: &mut ReadState,
) -> Result<CsvTable, IdentifyError> {
    let name = file.text()?;
    let text = read(path).map_err(|error| file.error(error.to_string()))?;
    let table = CsvTable::parse(&path.display().to_string(), &text)?;
    if let Some((other, _)) = state.texts.iter().find(|(_, known)| *known == text) {
        state.notes.push(format!(
            "{name} has the same content as {other}: is it one test under two names? Its rows count twice"
        ));
    }
    state.texts.push((name.to_owned(), text));
    Ok(table)
}

fn decode_observation(
    section: &Section<'_>,
    (folder, read): (&Path, &ReadFile<'_>),
    machine: &Machine,
    judge: bool,
    state: &mut ReadState,
    files: &mut Vec<PathBuf>,
) -> Result<OrderedObservation, IdentifyError> {
    let kind = section.require("kind")?.one_of(&[
        ("points", Kind::Points),
        ("sphere", Kind::Sphere),
        ("distance", Kind::Distance),
        ("line", Kind::Line),
        ("ball-row", Kind::BallRow),
    ])?;
    let own: &[&str] = match kind {
        Kind::Points => &["frame", "target", "target_within_mm"],
        Kind::Sphere => &[],
        Kind::Distance => &["point", "dead_length"],
        Kind::Line => &["direction", "offset", "slope"],
        Kind::BallRow => &row_file::KEYS,
    };
    section.allow(&[&["kind", "file", "uncertainty_um", "drift", "judge"], own].concat())?;
    let file_value = section.require("file")?;
    let name = file_value.text()?.to_owned();
    let path = folder.join(&name);
    let table = read_table(&file_value, &path, read, state)?;
    files.push(path);
    let drift = section.whole_or("drift", 0..=MAX_DRIFT_ORDER, 0)?;
    let uncertainty_um = section
        .optional("uncertainty_um", |value| {
            standard_uncertainty_um(value.positive()?).map_err(|why| value.error(why))
        })?
        .unwrap_or(1.0);
    let of = ObservationHeader { section, kind, file: &name, drift, judge };
    let mut bar = None;
    let row_kind = match kind {
        Kind::Points => {
            RowKind::Points { frame: frame(&of, state)?, targets: targets(&of, state)? }
        }
        Kind::Sphere => RowKind::Sphere { drift },
        Kind::Distance => {
            let is_pair = table.columns().any(|(_, name)| name == "from");
            let point = match section.get("point").filter(|_| is_pair) {
                Some(value) => {
                    return Err(value.error("found a point in addition to the column `from`, expected one of them: distances are between two poses or from a point").into());
                }
                None if is_pair => None,
                None => Some(point_of(&of, state)?),
            };
            let dead = number(&of, "dead_length", NumberKind::DeadLength, 0, state)?;
            RowKind::Distance { point, dead }
        }
        Kind::Line => RowKind::Line {
            direction: unit_vector(&section.require("direction")?)?,
            offset: number(&of, "offset", NumberKind::Offset, drift, state)?,
            slope: number(&of, "slope", NumberKind::Slope, 0, state)?,
        },
        Kind::BallRow => {
            let (kind, placement, path) = row_file::decode(&of, (folder, read), state)?;
            bar = Some(placement);
            files.push(path);
            kind
        }
    };
    let mut rows = read_rows(&table, &row_kind, machine, uncertainty_um * 1e-3, judge, state)?;
    refuse_units(&table, machine, &rows.rows, &state.setup)?;
    if let (RowKind::Line { direction, .. }, Some(value)) = (&row_kind, section.get("direction"))
        && let Some(note) = oblique(&rows.rows, direction, machine)
    {
        state.notes.push(value.error(note).to_string());
    }
    if let Some(bar) = bar {
        row_file::place_bar(&bar, &table, machine, &mut rows.rows, &mut state.setup)?;
    }
    if !rows.has_tool {
        state.without_tool.push(name.clone());
    }
    let observation = Observation { file: name, kind, judge, rows: rows.rows };
    Ok(OrderedObservation {
        observation,
        orders: rows.orders,
        has_order: rows.has_order,
        has_drift: drift > 0 || judge,
    })
}

fn decode_penalty(section: &Section<'_>, default: bool) -> Result<bool, InputError> {
    section.one_of("penalty", &[("auto", true), ("none", false)], default)
}

impl Unknown {
    /// Decodes the key `unknown` of a file of observations: the errors to be identified on this machine.
    ///
    /// # Errors
    /// An entry that is not an error of the machine or is listed twice; a curve that the error cannot have.
    pub fn decode(value: &Value<'_>, machine: &Machine) -> Result<Vec<Self>, InputError> {
        let found = decode_unknown(value, machine, false)?;
        if found.is_empty() {
            return Err(value.error("found no unknown, expected at least one error to be found"));
        }
        Ok(found)
    }

    /// Formats this unknown as an item of the key `unknown`. `by_default` is true if the file has `penalty = "auto"` at
    /// its root, and false if it lacks that key.
    pub fn to_toml(&self, by_default: bool) -> String {
        let mut keys = vec![format!("error = \"{}\"", self.error)];
        match self.basis {
            Some(Basis::Legendre { order }) => keys.push(format!("legendre = {order}")),
            Some(Basis::BSpline { coefficients }) => {
                keys.push(format!("bspline = {coefficients}"));
            }
            Some(Basis::Fourier { harmonics }) => keys.push(format!("fourier = {harmonics}")),
            // A reversal value with a constant is written as a polynomial of order 0.
            Some(Basis::Constant) if self.reversal => keys.push("legendre = 0".to_owned()),
            Some(Basis::Constant) | None => {}
        }
        if let Some(second) = self.second {
            let curve = match second.basis {
                Basis::Fourier { harmonics } => format!("fourier = {harmonics}"),
                Basis::BSpline { coefficients } => format!("bspline = {coefficients}"),
                other => format!("legendre = {}", other.highest_order()),
            };
            let axis = second.axis;
            keys.push(format!("second = {{ axis = \"{axis}\", {curve} }}"));
        }
        if self.reversal {
            keys.push("reversal = true".to_owned());
        }
        if self.penalised != by_default {
            let penalty = if self.penalised { "auto" } else { "none" };
            keys.push(format!("penalty = \"{penalty}\""));
        }
        format!("{{ {} }}", keys.join(", "))
    }
}

/// Decodes every unknown. An empty list is valid: the observations then validate the machine as it is.
fn decode_unknown(
    value: &Value<'_>,
    machine: &Machine,
    penalised: bool,
) -> Result<Vec<Unknown>, InputError> {
    let mut found: Vec<Unknown> = Vec::new();
    for item in value.items()? {
        let unknown = decode_item(&item, machine, penalised)?;
        match found.iter_mut().find(|other| other.error == unknown.error) {
            None => found.push(unknown),
            // Two items may state one unknown: `{ error = "ECC", reversal = true }` together with
            // `{ error = "ECC", legendre = 3 }`.
            Some(other)
                if (other.basis.is_none() || unknown.basis.is_none())
                    && !(other.reversal && unknown.reversal) =>
            {
                other.reversal |= unknown.reversal;
                other.penalised |= unknown.basis.is_some() && unknown.penalised;
                other.basis = other.basis.or(unknown.basis);
                other.second = other.second.or(unknown.second);
            }
            Some(_) => return Err(item.error(format!("{} is listed twice", unknown.error))),
        }
        refuse_both_tilts(&item, unknown.error, &found)?;
    }
    Ok(found)
}

/// Rejects the tilts of two linear axes about the same direction. Together they rotate tool and workpiece alike, so only their difference, a
/// squareness, is observable.
fn refuse_both_tilts(
    item: &Value<'_>,
    error: ErrorName,
    found: &[Unknown],
) -> Result<(), InputError> {
    let is_tilt =
        |name: ErrorName| name.location && !name.axis.is_rotary() && name.component.is_angular();
    let of_other = |unknown: &&Unknown| {
        let other = unknown.error;
        is_tilt(other) && other.component == error.component && other.axis != error.axis
    };
    match found.iter().find(of_other).filter(|_| is_tilt(error)) {
        Some(other) => {
            let (first, second) = if other.error.axis < error.axis {
                (other.error, error)
            } else {
                (error, other.error)
            };
            Err(item.error(format!(
                "found {first} and {second}, expected one of them: a measurement determines only their difference, the squareness of {} and {}. {first} is zero by definition where {} is the reference axis",
                first.axis, second.axis, first.axis
            )))
        }
        None => Ok(()),
    }
}

fn decode_item(
    item: &Value<'_>,
    machine: &Machine,
    penalised: bool,
) -> Result<Unknown, InputError> {
    let Ok(section) = item.section() else {
        return Ok(Unknown::constant(decode_name(item, machine)?));
    };
    section.allow(&["error", "legendre", "bspline", "fourier", "second", "reversal", "penalty"])?;
    let name = section.require("error")?;
    let error = decode_name(&name, machine)?;
    let mut bases = Vec::new();
    if let Some(value) = section.get("legendre") {
        let order = value.whole(0..=MAX_COEFFICIENTS)?;
        bases.push((value, Basis::Legendre { order }));
    }
    if let Some(value) = section.get("bspline") {
        let coefficients = value.whole(4..=MAX_COEFFICIENTS)?;
        bases.push((value, Basis::BSpline { coefficients }));
    }
    if let Some(value) = section.get("fourier") {
        let harmonics = value.whole(0..=MAX_COEFFICIENTS / 2)?;
        if !error.axis.is_rotary() {
            let message = format!(
                "found a Fourier series for {error}, expected `legendre` or `bspline`: {} is a linear axis",
                error.axis
            );
            return Err(value.error(message));
        }
        bases.push((value, Basis::Fourier { harmonics }));
    }
    let reversal = section.truth_or("reversal", false)?;
    let basis = match bases.as_slice() {
        [] if error.location || !reversal || section.get("second").is_some() => {
            Some(Basis::Constant)
        }
        [] => None,
        [(value, basis)] => {
            let goes_round = machine.axis(error.axis).is_some_and(|axis| axis.modulo.is_some());
            if goes_round && !matches!(basis, Basis::Fourier { .. }) {
                return Err(value.error(format!(
                    "found a curve that does not close, expected `fourier`: {} has a modulo",
                    error.axis
                )));
            }
            Some(*basis)
        }
        [_, (value, _), ..] => {
            return Err(
                value.error("found two kinds of curve, expected one of legendre, bspline, fourier")
            );
        }
    };
    let second = match section.get("second") {
        Some(value) => Some(decode_second(&value, error, machine)?),
        None => None,
    };
    if error.location && (reversal || !bases.is_empty() || second.is_some()) {
        return Err(
            section.error(format!("{error}: a location error is one number, never a curve"))
        );
    }
    if reversal && matches!(machine.error(error), Some(ErrorCurve::Pair { .. })) && basis.is_none()
    {
        return Err(section.error(format!(
            "{error} has `forward` and `backward` in the machine file, expected one curve to which a reversal value is added: state a kind of curve too"
        )));
    }
    Ok(Unknown { error, basis, second, reversal, penalised: decode_penalty(&section, penalised)? })
}

fn decode_second(
    value: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
) -> Result<SecondAxis, InputError> {
    let section = value.section()?;
    section.allow(&["axis", "legendre", "bspline", "fourier"])?;
    let name = section.require("axis")?;
    let axis = name.text()?.parse::<AxisName>().ok();
    let axis = axis.filter(|axis| machine.axis(*axis).is_some());
    let Some(axis) = axis.filter(|axis| *axis != error.axis) else {
        let others = machine.axes().iter().map(|axis| axis.name);
        let others: Vec<String> =
            others.filter(|other| *other != error.axis).map(|other| other.to_string()).collect();
        return Err(name.error(format!(
            "found \"{}\", expected the second axis that {error} depends on, one of {}",
            name.text()?,
            others.join(", ")
        )));
    };
    let goes_round = machine.axis(axis).is_some_and(|a| a.modulo.is_some());
    let open = |value: Value<'_>, basis: Basis| {
        if goes_round {
            return Err(value.error(format!(
                "found a curve that does not close, expected `fourier`: {axis} has a modulo"
            )));
        }
        Ok(basis)
    };
    let keys = ["legendre", "bspline", "fourier"].map(|key| section.get(key));
    let basis = match keys {
        [Some(value), None, None] => {
            let order = value.whole(1..=MAX_SECOND_ORDER)?;
            open(value, Basis::Legendre { order })?
        }
        [None, Some(value), None] => {
            let coefficients = value.whole(MIN_SPLINE_COEFFICIENTS..=MAX_SECOND_ORDER)?;
            open(value, Basis::BSpline { coefficients })?
        }
        [None, None, Some(value)] => {
            let harmonics = value.whole(1..=MAX_SECOND_ORDER)?;
            if !axis.is_rotary() {
                return Err(value.error(format!(
                    "found a Fourier series along {axis}, expected `legendre`: it is a linear axis"
                )));
            }
            Basis::Fourier { harmonics }
        }
        [None, None, None] => {
            return Err(section.error(
                "found no kind of curve along the second axis, expected one of legendre, bspline, fourier",
            ));
        }
        [_, Some(value), _] | [_, _, Some(value)] => {
            return Err(value.error(
                "found two kinds of curve along the second axis, expected one of legendre, bspline, fourier",
            ));
        }
    };
    Ok(SecondAxis { axis, basis })
}

fn decode_name(value: &Value<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let name = machine.decode_error(value)?;
    let joint =
        machine.index_of(name.axis).ok().and_then(|index| machine.chain().joints().get(index));
    let no_effect = joint.and_then(|joint| joint.no_effect(name.component));
    match no_effect.filter(|_| name.location) {
        Some(reason) => Err(value.error(format!("{name} {reason}"))),
        None => Ok(name),
    }
}
