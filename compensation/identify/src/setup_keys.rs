//! The keys of an observation's set-up: frames, targets, points and numbers, known or to be found under a name.

use volcomp_document::{InputError, Section, Value};
use volcomp_kinematics::nalgebra::Vector3;

use crate::{
    ball_row::Balls,
    observations::{Kind, NumberKind, Quantity, SetUp},
};

/// A target that is known within more is not known.
const MOST_WITHIN_MM: f64 = 1000.0;

/// How a set-up's key is stated: a value, or a name under which it is to be found.
#[derive(Clone, Debug, PartialEq)]
enum Stated<T> {
    Known(T),
    Unknown(String),
}

/// The names under which an observation finds its set-up, with their places there: another observation may refer to them.
pub(crate) struct NamedSetUp {
    kind: Kind,
    judge: bool,
    frame: Option<(String, usize)>,
    point: Option<(String, usize)>,
    numbers: Vec<(NumberKind, String, usize)>,
}

impl NamedSetUp {
    /// No name yet, of an observation of this kind that is fitted or judged.
    pub(crate) fn new(kind: Kind, judge: bool) -> Self {
        Self {
            kind,
            judge,
            frame: None,
            point: None,
            numbers: Vec::new(),
        }
    }
}

/// The set-up while observations are read.
#[derive(Default)]
pub(crate) struct Reading {
    pub(crate) setup: SetUp,
    /// The names of the observations that were read before.
    pub(crate) before: Vec<NamedSetUp>,
    /// Names of tools and spheres with the place of their point.
    pub(crate) targets: Vec<(String, usize)>,
    pub(crate) spheres: Vec<(String, usize)>,
    pub(crate) rows_of_balls: Vec<Balls>,
    pub(crate) notes: Vec<String>,
    /// Files without a column `tool`.
    pub(crate) without_tool: Vec<String>,
    /// Names and texts of the row files that were read before.
    pub(crate) texts: Vec<(String, String)>,
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

pub(crate) fn frame(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    own: &mut NamedSetUp,
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
        let others = reading.before.iter().filter(|other| {
            other.kind == Kind::Points && (own.judge || name != "unknown") && !other.judge
        });
        let places: Vec<usize> = others
            .filter_map(|other| other.frame.as_ref().filter(|(n, _)| n == name))
            .map(|(_, place)| *place)
            .collect();
        if own.judge {
            return fitted_place(section, "frame", name, places);
        }
        if let Some(&place) = places.first() {
            own.frame = Some((name.clone(), place));
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
        drift: if own.judge { 0 } else { drift },
        known_within: None,
    });
    own.frame = named.map(|name| (name, place));
    Ok(place)
}

/// The targets by tool; the empty name stands for every tool.
pub(crate) fn targets(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    judge: bool,
    reading: &mut Reading,
) -> Result<Vec<(String, Option<usize>)>, InputError> {
    let within = section.optional("target_within_mm", |value| {
        let found = value.positive()?;
        if found <= MOST_WITHIN_MM {
            return Ok(found);
        }
        Err(value.error(format!(
            "found {found} mm, expected at most {MOST_WITHIN_MM} mm"
        )))
    })?;
    let Some(value) = section.get("target") else {
        return match section.get("target_within_mm") {
            Some(value) => Err(value.error(
                "found the uncertainty of a target without `target`, expected its offset from the tip beside it",
            )),
            None => Ok(Vec::new()),
        };
    };
    let one = |tool: &str, value: &Value<'_>, reading: &mut Reading| {
        let stated = stated(Some(value.clone()), [0.0; 3], Value::vector::<3>)?;
        let (known, unknown) = match stated {
            // Within its uncertainty it is found as well.
            Stated::Known(offset) => (Some(offset), within.is_some()),
            Stated::Unknown(_) if within.is_some() => {
                return Err(value.error(
                    "found a target that is to be found beside `target_within_mm`, expected the offset that is known within that",
                ));
            }
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
                .filter(|(name, place)| {
                    let is_named =
                        *name == key || (judge && tool.is_empty() && name.ends_with(':'));
                    is_named && reading.setup.points[*place].value == known
                })
                .map(|(_, place)| *place)
                .collect();
            if judge && known.is_none() {
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
            unknown: unknown && !judge,
            // A target that is to be found grows with the tool, as the frame drifts.
            drift: if unknown && !judge { drift } else { 0 },
            known_within: within.filter(|_| !judge),
        });
        if unknown && !judge {
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

pub(crate) fn point_of(
    section: &Section<'_>,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    own: &mut NamedSetUp,
) -> Result<usize, InputError> {
    let value = section.require("point")?;
    let stated = stated(Some(value), [0.0; 3], Value::vector::<3>)?;
    if let (Stated::Unknown(name), true) = (&stated, own.judge) {
        let others = reading.before.iter().filter(|other| other.kind == own.kind);
        let places = others.filter_map(|o| o.point.as_ref().filter(|(n, _)| n == name));
        return fitted_place(
            section,
            "point",
            name,
            places.map(|(_, place)| *place).collect(),
        );
    }
    let drift = if own.judge { 0 } else { drift };
    let place = point(section, "point", file, drift, reading)?;
    if let Stated::Unknown(name) = stated {
        own.point = Some((name, place));
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

pub(crate) fn number(
    section: &Section<'_>,
    key: &str,
    kind: NumberKind,
    file: &str,
    drift: usize,
    reading: &mut Reading,
    own: &mut NamedSetUp,
) -> Result<usize, InputError> {
    let stated = stated(section.get(key), 0.0, Value::number)?;
    if let (Stated::Unknown(name), true) = (&stated, own.judge) {
        let others = reading.before.iter().filter(|other| other.kind == own.kind);
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
        drift: if own.judge { 0 } else { drift },
        known_within: None,
    });
    reading.setup.number_kinds.push(kind);
    if let Stated::Unknown(name) = stated {
        own.numbers.push((kind, name, place));
    }
    Ok(place)
}
