//! Reads a file of observations, its machine file and its row files.

use std::path::{Component, Path, PathBuf};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_document::{CsvTable, Document, FileKind, InputError, Section, Value, read_text};
use volcomp_model::Machine;

use crate::{
    ball_row,
    checks::input::{
        MOST_DRIFT, MOST_FOLDS, oblique, refuse_units, standard_uncertainty_um, unit_vector,
    },
    error::IdentifyError,
    observations::{Kind, NumberKind, Observation, Observations},
    rows::{RowKind, read_rows},
    setup_keys::{Head, ReadFile, Reading, frame, number, point_of, targets},
    timeline::{Timed, set_times},
    unknown_file::{decode_penalty, decode_unknown},
};

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

    /// Decodes unknowns and observations from the root of a file, for a machine that is already known. The file is one
    /// of observations, or another with the same keys. Row files are named relative to `folder`;
    /// [`Observations::files`] contains only them.
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
    let mut odd = found.machine.notes();
    odd.extend(found.unknown.iter().filter_map(|unknown| {
        let name = unknown.error;
        let is_curve = |curve: &ErrorCurve| {
            !matches!(curve, ErrorCurve::Single(Field::Curve(Curve::Constant(_))))
        };
        let is_dropped = unknown.basis.is_some() && found.machine.error(name).is_some_and(is_curve);
        is_dropped.then(|| {
            format!("the curve of {name} in the machine file is dropped: {name} is unknown here")
        })
    }));
    found.notes.splice(0..0, odd);
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
    let mut reading = Reading::default();
    let mut files = Vec::new();
    let mut observations = Vec::new();
    let items = root.require("observation")?.items()?;
    let sections: Vec<Section<'_>> = items.iter().map(Value::section).collect::<Result<_, _>>()?;
    refuse_same_file(&sections)?;
    // Fitted observations first: the others refer to their set-ups.
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
            &mut reading,
            &mut files,
        )?;
        observations.push(observation);
    }
    let observations = set_times(observations, &machine, &mut reading.notes);
    reading
        .notes
        .extend(one_tool(&machine, &reading.without_tool));
    Ok(Observations {
        files,
        unknown,
        observations,
        setup: reading.setup,
        robust: root.truth_or("robust", false)?,
        folds: root.whole_or("folds", 0..=MOST_FOLDS, 10)?,
        notes: reading.notes,
        ..Observations::of(machine)
    })
}

/// Note on files whose rows use the tool of `[tool]` although the machine file has several.
fn one_tool(machine: &Machine, files: &[String]) -> Option<String> {
    let tools: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    (tools.len() > 1 && !files.is_empty()).then(|| {
        format!(
            "{}: no column `tool`, so all rows are taken with the tip of `[tool]`; the machine file has the tools {} too: if one of them was in the spindle, add the column",
            files.join(", "),
            tools.join(", ")
        )
    })
}

/// Rejects a row file that two observations name: a reading has one kind and one direction, so its rows would count
/// twice, or validate what was fitted to them. A file of ball distances (`row`) may be named once for every position of
/// the bar.
fn refuse_same_file(sections: &[Section<'_>]) -> Result<(), InputError> {
    let mut before: Vec<(PathBuf, Value<'_>)> = Vec::new();
    for section in sections {
        // A missing or invalid `file` is rejected where it is decoded.
        let Some((value, Ok(name))) = section.get("file").map(|v| (v.clone(), v.text())) else {
            continue;
        };
        // `a.csv` and `./a.csv` are one file.
        let path: PathBuf = Path::new(name)
            .components()
            .filter(|part| *part != Component::CurDir)
            .collect();
        if let Some((_, other)) = before.iter().find(|(known, _)| *known == path) {
            let place = other.error("");
            return Err(value.error(format!(
                "found {name:?}, which is the file of the observation at {}:{} too, expected another file: the rows of a file count in one observation",
                place.file, place.line
            )));
        }
        before.push((path, value));
    }
    Ok(())
}

/// Table of a row file, with a note if another row file has the same content.
fn read_table(
    file: &Value<'_>,
    path: &Path,
    read: &ReadFile<'_>,
    reading: &mut Reading,
) -> Result<CsvTable, IdentifyError> {
    let name = file.text()?;
    let text = read(path).map_err(|error| file.error(error.to_string()))?;
    let table = CsvTable::parse(&path.display().to_string(), &text)?;
    if let Some((other, _)) = reading.texts.iter().find(|(_, known)| *known == text) {
        reading.notes.push(format!(
            "{name} has the same content as {other}: is it one test under two names? Its rows count twice, as if it had been made twice"
        ));
    }
    reading.texts.push((name.to_owned(), text));
    Ok(table)
}

fn decode_observation(
    section: &Section<'_>,
    (folder, read): (&Path, &ReadFile<'_>),
    machine: &Machine,
    judge: bool,
    reading: &mut Reading,
    files: &mut Vec<PathBuf>,
) -> Result<Timed, IdentifyError> {
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
        Kind::BallRow => &ball_row::KEYS,
    };
    section.allow(&[&["kind", "file", "uncertainty_um", "drift", "judge"], own].concat())?;
    let file_value = section.require("file")?;
    let name = file_value.text()?.to_owned();
    let path = folder.join(&name);
    let table = read_table(&file_value, &path, read, reading)?;
    files.push(path);
    let drift = section.whole_or("drift", 0..=MOST_DRIFT, 0)?;
    let uncertainty_um = section
        .optional("uncertainty_um", |value| {
            standard_uncertainty_um(value.positive()?).map_err(|why| value.error(why))
        })?
        .unwrap_or(1.0);
    let of = Head {
        section,
        kind,
        file: &name,
        drift,
        judge,
    };
    let mut bar = None;
    let row_kind = match kind {
        Kind::Points => RowKind::Points {
            frame: frame(&of, reading)?,
            targets: targets(&of, reading)?,
        },
        Kind::Sphere => RowKind::Sphere { drift },
        Kind::Distance => {
            let is_pair = table.columns().any(|(_, name)| name == "from");
            let point = match section.get("point").filter(|_| is_pair) {
                Some(value) => {
                    return Err(value.error("found a point beside the column `from`, expected one of them: distances are between two poses or from a point").into());
                }
                None if is_pair => None,
                None => Some(point_of(&of, reading)?),
            };
            let dead = number(&of, "dead_length", NumberKind::DeadLength, 0, reading)?;
            RowKind::Distance { point, dead }
        }
        Kind::Line => RowKind::Line {
            direction: unit_vector(&section.require("direction")?)?,
            offset: number(&of, "offset", NumberKind::Offset, drift, reading)?,
            slope: number(&of, "slope", NumberKind::Slope, 0, reading)?,
        },
        Kind::BallRow => {
            let (kind, placement, path) = ball_row::decode(&of, (folder, read), reading)?;
            bar = Some(placement);
            files.push(path);
            kind
        }
    };
    let mut rows = read_rows(
        &table,
        &row_kind,
        machine,
        uncertainty_um * 1e-3,
        judge,
        reading,
    )?;
    refuse_units(&table, machine, &rows.rows, &reading.setup)?;
    if let (RowKind::Line { direction, .. }, Some(value)) = (&row_kind, section.get("direction"))
        && let Some(note) = oblique(&rows.rows, direction, machine)
    {
        reading.notes.push(value.error(note).to_string());
    }
    if let Some(bar) = bar {
        ball_row::place_bar(&bar, &table, machine, &mut rows.rows, &mut reading.setup)?;
    }
    if !rows.has_tool {
        reading.without_tool.push(name.clone());
    }
    let observation = Observation {
        file: name,
        kind,
        judge,
        rows: rows.rows,
    };
    Ok(Timed {
        observation,
        orders: rows.orders,
        has_order: rows.has_order,
        has_drift: drift > 0 || judge,
    })
}
