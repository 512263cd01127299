//! Reads a file of observations, its machine file and its row files.

use std::path::{Component, Path, PathBuf};

use volcomp_document::{
    CsvTable, Document, FileKind, InputError, ReadError, Section, Value, read_text,
};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;

use crate::{
    ball_row::{self, Balls},
    error::IdentifyError,
    observations::{Kind, NumberKind, Observation, Observations, Quantity, SetUp},
    rows::{RowKind, read_rows},
    timeline::set_times,
    units::check_units,
    unknown_file::{decode_penalty, decode_unknown},
};

/// Gives the text of a file.
pub type ReadFile<'a> = dyn Fn(&Path) -> Result<String, ReadError> + 'a;

/// The highest order of a drift.
const MOST_DRIFT: usize = 12;
/// The most parts into which poses are divided.
const MOST_FOLDS: usize = 100;

/// How a set-up's key is stated: a value, or a name under which it is to be found.
#[derive(Clone, Debug, PartialEq)]
enum Stated<T> {
    Known(T),
    Unknown(String),
}

/// What was read of an observation that another may refer to.
struct Told {
    kind: Kind,
    judge: bool,
    frame: Option<(String, usize)>,
    point: Option<(String, usize)>,
    numbers: Vec<(NumberKind, String, usize)>,
}

/// The set-up while observations are read.
#[derive(Default)]
pub(crate) struct Reading {
    pub(crate) setup: SetUp,
    told: Vec<Told>,
    /// Names of tools and spheres with the place of their point.
    pub(crate) targets: Vec<(String, usize)>,
    pub(crate) spheres: Vec<(String, usize)>,
    pub(crate) rows_of_balls: Vec<Balls>,
    pub(crate) notes: Vec<String>,
}

impl Observations {
    /// Reads a file of observations, its machine file and its row files.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, IdentifyError> {
        let document = Document::read(path)?;
        Self::decode(&document, path, &read_text)
    }

    /// Decodes the text of a file of observations at `path`; `read` gives the text of every file that it names.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
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

    /// The keys of the root of a file that [`Observations::of_section`] reads.
    pub const KEYS: [&'static str; 5] = ["unknown", "observation", "penalty", "robust", "folds"];

    /// Decodes what the root of a file says of unknowns and observations, for a machine that is there already: a file of
    /// observations, or another that has these keys too. Row files are named relative to `folder`; they alone stand in
    /// [`Observations::files`].
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
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
    let odd = found.machine.notes();
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
    // Those that are fitted first: the others refer to their set-ups.
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
    Ok(Observations {
        files,
        machine,
        unknown,
        observations,
        setup: reading.setup,
        robust: root.truth_or("robust", false)?,
        folds: root.whole_or("folds", 0..=MOST_FOLDS, 10)?,
        notes: reading.notes,
    })
}

/// Refuses a row file that two observations name: no reading is of two kinds or directions, so its rows would count twice, or
/// judge what was fitted to them. A file of ball distances (`row`) may be named as often as its bar was laid down.
fn refuse_same_file(sections: &[Section<'_>]) -> Result<(), InputError> {
    let mut before: Vec<(PathBuf, Value<'_>)> = Vec::new();
    for section in sections {
        // One without a file, or with something else there, is refused where it is decoded.
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

#[expect(clippy::too_many_lines, reason = "one arm for each kind")]
fn decode_observation(
    section: &Section<'_>,
    (folder, read): (&Path, &ReadFile<'_>),
    machine: &Machine,
    judge: bool,
    reading: &mut Reading,
    files: &mut Vec<PathBuf>,
) -> Result<crate::timeline::Timed, IdentifyError> {
    let kind = section.require("kind")?.one_of(&[
        ("points", Kind::Points),
        ("sphere", Kind::Sphere),
        ("distance", Kind::Distance),
        ("line", Kind::Line),
        ("ball-row", Kind::BallRow),
    ])?;
    let own: &[&str] = match kind {
        Kind::Points => &["frame", "target"],
        Kind::Sphere => &[],
        Kind::Distance => &["point", "dead_length"],
        Kind::Line => &["direction", "offset", "slope"],
        Kind::BallRow => &ball_row::KEYS,
    };
    section.allow(&[&["kind", "file", "uncertainty_um", "drift", "judge"], own].concat())?;
    let file_value = section.require("file")?;
    let name = file_value.text()?.to_owned();
    let path = folder.join(&name);
    let text = read(&path).map_err(|error| file_value.error(error.to_string()))?;
    let table = CsvTable::parse(&path.display().to_string(), &text)?;
    files.push(path);
    let drift = section.whole_or("drift", 0..=MOST_DRIFT, 0)?;
    let uncertainty_um = section
        .optional("uncertainty_um", Value::positive)?
        .unwrap_or(1.0);
    let mut told = Told {
        kind,
        judge,
        frame: None,
        point: None,
        numbers: Vec::new(),
    };
    let mut bar = None;
    let row_kind = match kind {
        Kind::Points => {
            let frame = frame(section, &name, drift, reading, &mut told)?;
            let targets = targets(section, &name, drift, judge, reading)?;
            RowKind::Points { frame, targets }
        }
        Kind::Sphere => RowKind::Sphere { drift },
        Kind::Distance => {
            let pairs = table.columns().any(|(_, name)| name == "from");
            let point = if pairs {
                if let Some(value) = section.get("point") {
                    return Err(value.error("found a point beside the column `from`, expected one of them: distances are between two poses or from a point").into());
                }
                None
            } else {
                Some(point_of(section, &name, drift, reading, &mut told)?)
            };
            let dead = number(
                section,
                "dead_length",
                NumberKind::DeadLength,
                &name,
                0,
                reading,
                &mut told,
            )?;
            RowKind::Distance { point, dead }
        }
        Kind::Line => {
            let value = section.require("direction")?;
            let direction = Vector3::from(value.vector::<3>()?);
            let direction = direction.try_normalize(1e-12).ok_or_else(|| {
                value.error("found a zero direction, expected a vector of any other length")
            })?;
            let offset = number(
                section,
                "offset",
                NumberKind::Offset,
                &name,
                drift,
                reading,
                &mut told,
            )?;
            let slope = number(
                section,
                "slope",
                NumberKind::Slope,
                &name,
                0,
                reading,
                &mut told,
            )?;
            RowKind::Line {
                direction,
                offset,
                slope,
            }
        }
        Kind::BallRow => {
            let (kind, placement, path) =
                ball_row::decode(section, (folder, read), &name, drift, judge, reading)?;
            bar = Some(placement);
            files.push(path);
            kind
        }
    };
    reading.told.push(told);
    let mut rows = read_rows(
        &table,
        &row_kind,
        machine,
        uncertainty_um * 1e-3,
        judge,
        reading,
    )?;
    check_units(&table, machine, &rows.rows, &reading.setup)?;
    if let Some(bar) = bar {
        ball_row::place_bar(&bar, &table, machine, &mut rows.rows, &mut reading.setup)?;
    }
    let observation = Observation {
        file: name,
        kind,
        judge,
        rows: rows.rows,
    };
    Ok(crate::timeline::Timed {
        observation,
        orders: rows.orders,
        has_order: rows.has_order,
        has_drift: drift > 0 || judge,
    })
}

/// A value, or the name of what is to be found; "known" stands for the default.
fn stated<'v, T>(
    value: Option<Value<'v>>,
    default: T,
    decode: impl Fn(&Value<'v>) -> Result<T, InputError>,
) -> Result<Stated<T>, InputError> {
    match value {
        None => Ok(Stated::Known(default)),
        Some(value) => match value.text() {
            Ok("known") => Ok(Stated::Known(default)),
            Ok("") => {
                Err(value.error("found an empty name, expected \"unknown\", a name, or numbers"))
            }
            Ok(name) => Ok(Stated::Unknown(name.to_owned())),
            Err(_) => decode(&value).map(Stated::Known),
        },
    }
}

/// The one set-up of a fitted observation that a judged one with this name uses.
fn fitted_place(
    section: &Section<'_>,
    key: &str,
    name: &str,
    found: Vec<usize>,
) -> Result<usize, InputError> {
    let mut places = found;
    places.dedup();
    match places[..] {
        [place] => Ok(place),
        [] => Err(section.error(format!(
            "found `judge = true` with {key} \"{name}\", expected a fitted observation of this kind with the same {key}"
        ))),
        _ => Err(section.error(format!(
            "found `judge = true` with {key} \"{name}\", which {} fitted observations have: expected a name that only one has, the same in both",
            places.len()
        ))),
    }
}

fn frame(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    told: &mut Told,
) -> Result<usize, InputError> {
    let value = section.get("frame");
    let stated = match value {
        None => Stated::Unknown("unknown".to_owned()),
        Some(_) => stated(value, [0.0; 6], Value::vector::<6>)?,
    };
    let named = match &stated {
        Stated::Known(_) => None,
        Stated::Unknown(name) => Some(name.clone()),
    };
    if let Some(name) = &named {
        let others = reading.told.iter().filter(|other| {
            other.kind == Kind::Points && (told.judge || name != "unknown") && !other.judge
        });
        let places: Vec<usize> = others
            .filter_map(|other| other.frame.as_ref().filter(|(n, _)| n == name))
            .map(|(_, place)| *place)
            .collect();
        if told.judge {
            return fitted_place(section, "frame", name, places);
        }
        if let Some(&place) = places.first() {
            told.frame = Some((name.clone(), place));
            return Ok(place);
        }
    }
    let place = reading.setup.frames.len();
    reading.setup.frames.push(Quantity {
        name: match &named {
            Some(name) if name != "unknown" => format!("frame {name}"),
            _ => format!("{file}:frame"),
        },
        value: match stated {
            Stated::Known(six) => Some(six),
            Stated::Unknown(_) => None,
        },
        unknown: named.is_some(),
        drift: if told.judge { 0 } else { drift },
        known_within: None,
    });
    told.frame = named.map(|name| (name, place));
    Ok(place)
}

/// The targets by tool; the empty name stands for every tool.
fn targets(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    judge: bool,
    reading: &mut Reading,
) -> Result<Vec<(String, Option<usize>)>, InputError> {
    let Some(value) = section.get("target") else {
        return Ok(Vec::new());
    };
    let one = |tool: &str, value: &Value<'_>, reading: &mut Reading| {
        let stated = stated(Some(value.clone()), [0.0; 3], Value::vector::<3>)?;
        let (known, unknown) = match stated {
            Stated::Known(offset) => (Some(offset), false),
            Stated::Unknown(_) => (None, true),
        };
        let key = if tool.is_empty() {
            format!("{file}:")
        } else {
            tool.to_owned()
        };
        if unknown {
            // A target by its tool is the same in all files; one without a tool is found by a judged file of the same
            // kind where there is one only.
            let same: Vec<usize> = reading
                .targets
                .iter()
                .filter(|(name, _)| {
                    *name == key || (judge && tool.is_empty() && name.ends_with(':'))
                })
                .map(|(_, place)| *place)
                .collect();
            if judge {
                return fitted_place(section, "target", tool, same).map(Some);
            }
            if let Some(&place) = same.first() {
                return Ok(Some(place));
            }
        }
        let place = reading.setup.points.len();
        reading.setup.points.push(Quantity {
            name: if tool.is_empty() {
                format!("{file}:target")
            } else {
                format!("target {tool}")
            },
            value: known,
            unknown,
            // A target that is to be found grows with the tool, as the frame drifts.
            drift: if unknown { drift } else { 0 },
            known_within: None,
        });
        if unknown {
            reading.targets.push((key, place));
        }
        Ok(Some(place))
    };
    match value.section() {
        Ok(by_tool) => by_tool
            .values()
            .map(|(tool, value)| Ok((tool.to_owned(), one(tool, &value, reading)?)))
            .collect(),
        Err(_) => Ok(vec![(String::new(), one("", &value, reading)?)]),
    }
}

fn point_of(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    told: &mut Told,
) -> Result<usize, InputError> {
    let value = section.require("point")?;
    let stated = stated(Some(value), [0.0; 3], Value::vector::<3>)?;
    if let (Stated::Unknown(name), true) = (&stated, told.judge) {
        let others = reading.told.iter().filter(|other| other.kind == told.kind);
        let places = others.filter_map(|o| o.point.as_ref().filter(|(n, _)| n == name));
        return fitted_place(
            section,
            "point",
            name,
            places.map(|(_, place)| *place).collect(),
        );
    }
    let drift = if told.judge { 0 } else { drift };
    let place = point(section, "point", file, drift, reading)?;
    if let Stated::Unknown(name) = stated {
        told.point = Some((name, place));
    }
    Ok(place)
}

/// A point of the set-up under a key; one that is not stated is to be found.
pub(crate) fn point(
    section: &Section<'_>,
    key: &str,
    file: &str,
    drift: usize,
    reading: &mut Reading,
) -> Result<usize, InputError> {
    let known = stated_vector(section, key)?.map(|(_, known)| known.into());
    let place = reading.setup.points.len();
    reading.setup.points.push(Quantity {
        name: format!("{file}:{key}"),
        value: known,
        unknown: known.is_none(),
        drift,
        known_within: None,
    });
    Ok(place)
}

/// Three numbers under a key; `None` where the key is not there or says that they are to be found.
pub(crate) fn stated_vector<'a>(
    section: &Section<'a>,
    key: &str,
) -> Result<Option<(Value<'a>, Vector3<f64>)>, InputError> {
    let Some(value) = section.get(key) else {
        return Ok(None);
    };
    match stated(Some(value.clone()), [0.0; 3], Value::vector::<3>)? {
        Stated::Known(known) => Ok(Some((value, Vector3::from(known)))),
        Stated::Unknown(_) => Ok(None),
    }
}

fn number(
    section: &Section<'_>,
    key: &str,
    kind: NumberKind,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    told: &mut Told,
) -> Result<usize, InputError> {
    let stated = stated(section.get(key), 0.0, Value::number)?;
    if let (Stated::Unknown(name), true) = (&stated, told.judge) {
        let others = reading.told.iter().filter(|other| other.kind == told.kind);
        let places = others.flat_map(|o| &o.numbers);
        let places = places.filter(|(k, n, _)| *k == kind && n == name);
        return fitted_place(
            section,
            key,
            name,
            places.map(|(.., place)| *place).collect(),
        );
    }
    let place = reading.setup.numbers.len();
    reading.setup.numbers.push(Quantity {
        name: format!("{file}:{key}"),
        value: match &stated {
            Stated::Known(number) => Some(number / kind.unit().1),
            Stated::Unknown(_) => None,
        },
        unknown: matches!(stated, Stated::Unknown(_)),
        drift: if told.judge { 0 } else { drift },
        known_within: None,
    });
    reading.setup.number_kinds.push(kind);
    if let Stated::Unknown(name) = stated {
        told.numbers.push((kind, name, place));
    }
    Ok(place)
}
