//! Keys of an observation's set-up: frames, targets, points and numbers, known or identified under a name.

use std::path::Path;

use volcomp_document::{InputError, ReadError, Section, Value, quoted};
use volcomp_kinematics::nalgebra::Vector3;

use crate::observations::{Kind, NumberKind, Quantity, SetUp};

const MAX_TARGET_UNCERTAINTY_MM: f64 = 1000.0;

/// Returns the text of a file.
pub type ReadFile<'a> = dyn Fn(&Path) -> Result<String, ReadError> + 'a;

#[derive(Default)]
pub(crate) struct ReadState {
    pub(crate) setup: SetUp,
    named: Vec<(Kind, &'static str, String, usize)>,
    targets: Vec<(String, usize)>,
    pub(crate) spheres: Vec<(String, usize)>,
    pub(crate) rows_of_balls: Vec<BallRow>,
    pub(crate) notes: Vec<String>,
    pub(crate) without_tool: Vec<String>,
    pub(crate) texts: Vec<(String, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct Ball {
    pub(crate) name: String,
    pub(crate) distance_mm: f64,
    pub(crate) uncertainty_mm: f64,
    /// Index of the distance among the numbers of the set-up, once a reading refers to the ball.
    pub(crate) number: Option<usize>,
}

#[derive(Clone, Debug)]
pub(crate) struct BallRow {
    pub(crate) file: String,
    pub(crate) balls: Vec<Ball>,
}

impl BallRow {
    /// Index of a ball's distance among the numbers of the set-up; the number is added at the first use of the ball.
    pub(crate) fn distance_of(&mut self, name: &str, setup: &mut SetUp) -> Result<usize, String> {
        let file = self.file.as_str();
        let Some(place) = self.balls.iter().position(|ball| ball.name == name) else {
            let known: Vec<&str> = self.balls.iter().map(|ball| ball.name.as_str()).collect();
            return Err(format!(
                "found {}, expected a ball of {file}: {}",
                quoted(name),
                known.join(", ")
            ));
        };
        let ball = &mut self.balls[place];
        let number = || Quantity {
            name: format!("{file}:ball {name}"),
            value: Some(ball.distance_mm),
            unknown: ball.uncertainty_mm > 0.0,
            drift: 0,
            known_within: Some(ball.uncertainty_mm),
        };
        let number = match ball.number {
            Some(number) => number,
            None => setup.add_number(NumberKind::Distance, number()),
        };
        ball.number = Some(number);
        Ok(number)
    }
}

/// Data that all keys of one observation share.
pub(crate) struct ObservationHeader<'a> {
    pub(crate) section: &'a Section<'a>,
    pub(crate) kind: Kind,
    pub(crate) file: &'a str,
    pub(crate) drift: usize,
    /// Whether the rows are only predicted. A name then refers to a part of a fitted observation's set-up.
    pub(crate) judge: bool,
}

impl ObservationHeader<'_> {
    fn places(&self, key: &str, name: &str, state: &ReadState) -> Vec<usize> {
        let own = state
            .named
            .iter()
            .filter(|(kind, of, known, _)| *kind == self.kind && *of == key && known == name);
        own.map(|(.., place)| *place).collect()
    }

    /// A part of a set-up by its name, for a predicted observation: index of the part if exactly one fitted observation
    /// has a part of this name.
    fn fitted(&self, key: &str, name: &str, state: &ReadState) -> Result<usize, InputError> {
        self.only(key, name, self.places(key, name, state))
    }

    fn only(&self, key: &str, name: &str, mut places: Vec<usize>) -> Result<usize, InputError> {
        places.dedup();
        match places[..] {
            [place] => Ok(place),
            [] => Err(self.section.error(format!(
                "found `judge = true` with {key} \"{name}\", expected a fitted observation of this kind with the same {key}"
            ))),
            _ => Err(self.section.error(format!(
                "found `judge = true` with {key} \"{name}\", which {} fitted observations have: expected a name that only one of them has",
                places.len()
            ))),
        }
    }

    /// Order of drift; 0 for a predicted observation, because only parts of fitted observations drift.
    fn fitted_drift(&self, drift: usize) -> usize {
        if self.judge { 0 } else { drift }
    }
}

/// Value of a key of a set-up: a known value, or the name of an unknown that is identified.
#[derive(Clone, Debug, PartialEq)]
enum KeyValue<T> {
    Known(T),
    Unknown(String),
}

impl<T> KeyValue<T> {
    /// Decodes a value, or the name of an unknown; "known" means the default.
    fn decode<'v>(
        value: Option<Value<'v>>,
        default: T,
        decode: impl Fn(&Value<'v>) -> Result<T, InputError>,
    ) -> Result<Self, InputError> {
        let Some(value) = value else {
            return Ok(Self::Known(default));
        };
        match value.text() {
            Ok("known") => Ok(Self::Known(default)),
            Ok("") => {
                Err(value.error("found an empty name, expected \"unknown\", a name, or numbers"))
            }
            Ok(name) => Ok(Self::Unknown(name.to_owned())),
            Err(_) => decode(&value).map(Self::Known),
        }
    }

    fn known(self) -> Option<T> {
        match self {
            Self::Known(known) => Some(known),
            Self::Unknown(_) => None,
        }
    }
}

pub(crate) fn frame(
    of: &ObservationHeader<'_>,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    let stated = match of.section.get("frame") {
        None => KeyValue::Unknown("unknown".to_owned()),
        value => KeyValue::decode(value, [0.0; 6], Value::vector::<6>)?,
    };
    let place = state.setup.frames.len();
    let mut own_name = format!("{}:frame", of.file);
    if let KeyValue::Unknown(name) = &stated {
        if of.judge {
            return of.fitted("frame", name, state);
        }
        if name != "unknown" {
            // Trackers with the same name share a frame.
            if let Some(&place) = of.places("frame", name, state).first() {
                return Ok(place);
            }
            own_name = format!("frame {name}");
        }
        let named = (of.kind, "frame", name.clone(), place);
        state.named.push(named);
    }
    let drift = of.fitted_drift(of.drift);
    let frame = Quantity::new(own_name, stated.known(), drift);
    state.setup.frames.push(frame);
    Ok(place)
}

/// Indices of the targets by tool; the empty name applies to every tool, `None` is the tip.
pub(crate) fn targets(
    of: &ObservationHeader<'_>,
    state: &mut ReadState,
) -> Result<Vec<(String, Option<usize>)>, InputError> {
    let within = of.section.optional("target_within_mm", |value| {
        let found = value.positive()?;
        if found <= MAX_TARGET_UNCERTAINTY_MM {
            return Ok(found);
        }
        Err(value
            .error(format!("found {found} mm, expected at most {MAX_TARGET_UNCERTAINTY_MM} mm")))
    })?;
    let Some(value) = of.section.get("target") else {
        return match of.section.get("target_within_mm") {
            Some(value) => Err(value.error(
                "found the uncertainty of a target without `target`, expected its offset from the tip as well",
            )),
            None => Ok(Vec::new()),
        };
    };
    let Ok(by_tool) = value.section() else {
        let place = target(of, "", &value, within, state)?;
        return Ok(vec![(String::new(), Some(place))]);
    };
    let targets = by_tool.values().map(|(tool, value)| {
        let place = target(of, tool, &value, within, state)?;
        Ok((tool.to_owned(), Some(place)))
    });
    targets.collect()
}

fn target(
    of: &ObservationHeader<'_>,
    tool: &str,
    value: &Value<'_>,
    within: Option<f64>,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    let stated = KeyValue::decode(Some(value.clone()), [0.0; 3], Value::vector::<3>)?;
    let known = stated.known();
    if known.is_none() && within.is_some() {
        return Err(value.error(
            "found an unknown target with `target_within_mm`, expected the offset that is known to within this uncertainty",
        ));
    }
    // A target with an uncertainty is identified as well.
    let unknown = known.is_none() || within.is_some();
    let key = if tool.is_empty() { format!("{}:", of.file) } else { tool.to_owned() };
    if unknown {
        // A target named by its tool is the same in all files. A target without a tool in a predicted file is the
        // target in a fitted file of the same kind, if there is exactly one.
        let is_same = |(name, place): &&(String, usize)| {
            let is_named = *name == key || (of.judge && tool.is_empty() && name.ends_with(':'));
            is_named && state.setup.points[*place].value == known
        };
        let same = state.targets.iter().filter(is_same);
        let same: Vec<usize> = same.map(|(_, place)| *place).collect();
        if of.judge && known.is_none() {
            return of.only("target", tool, same);
        }
        if let Some(&place) = same.first() {
            return Ok(place);
        }
    }
    let is_found = unknown && !of.judge;
    let place = state.setup.add_point(Quantity {
        name: if tool.is_empty() {
            format!("{}:target", of.file)
        } else {
            format!("target {tool}")
        },
        value: known,
        unknown: is_found,
        // An identified target drifts like the frame, because the tool expands.
        drift: if is_found { of.drift } else { 0 },
        known_within: within.filter(|_| !of.judge),
    });
    if is_found {
        state.targets.push((key, place));
    }
    Ok(place)
}

pub(crate) fn point_of(
    of: &ObservationHeader<'_>,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    let value = of.section.require("point")?;
    let stated = KeyValue::decode(Some(value), [0.0; 3], Value::vector::<3>)?;
    if let (KeyValue::Unknown(name), true) = (&stated, of.judge) {
        return of.fitted("point", name, state);
    }
    let place = point(of, "point", of.fitted_drift(of.drift), state)?;
    if let KeyValue::Unknown(name) = stated {
        state.named.push((of.kind, "point", name, place));
    }
    Ok(place)
}

/// Index of a point of the set-up under a key; the point is unknown if the key states no coordinates.
pub(crate) fn point(
    of: &ObservationHeader<'_>,
    key: &str,
    drift: usize,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    let known = stated_vector(of.section, key)?.map(|(_, known)| known.into());
    let point = Quantity::new(format!("{}:{key}", of.file), known, drift);
    Ok(state.setup.add_point(point))
}

/// Three numbers under a key; `None` if the key is missing or marks them as unknown.
pub(crate) fn stated_vector<'a>(
    section: &Section<'a>,
    key: &str,
) -> Result<Option<(Value<'a>, Vector3<f64>)>, InputError> {
    let Some(value) = section.get(key) else {
        return Ok(None);
    };
    let stated = KeyValue::decode(Some(value.clone()), [0.0; 3], Value::vector::<3>)?;
    Ok(stated.known().map(|known| (value, Vector3::from(known))))
}

pub(crate) fn number(
    of: &ObservationHeader<'_>,
    key: &'static str,
    kind: NumberKind,
    drift: usize,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    let stated = KeyValue::decode(of.section.get(key), 0.0, Value::number)?;
    let place = state.setup.numbers.len();
    if let KeyValue::Unknown(name) = &stated {
        if of.judge {
            return of.fitted(key, name, state);
        }
        state.named.push((of.kind, key, name.clone(), place));
    }
    let known = stated.known().map(|number| number / kind.unit().1);
    let number = Quantity::new(format!("{}:{key}", of.file), known, of.fitted_drift(drift));
    Ok(state.setup.add_number(kind, number))
}
