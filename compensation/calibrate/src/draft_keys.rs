//! Which keys a measurement of a draft has: they follow from its error, its unit and its format, whoever says these and when.

use volcomp_metrology::{DeviationUnit, FileFormat, MotionKind, Quantity};
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::draft::{CHANNEL_KEYS, Proposed, open};

/// What a file says of itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Told {
    /// Every axis of the machine, with the place that a name or a text gives it.
    pub(crate) places: Vec<(AxisName, Option<f64>)>,
    /// The axis that moved, where the error is not known.
    pub(crate) axis: Option<AxisName>,
    pub(crate) quantity: Option<Quantity>,
    pub(crate) format: Option<FileFormat>,
    /// The unit of the readings, of the file or as it was answered.
    pub(crate) unit: Option<DeviationUnit>,
    /// Whether the unit is asked for.
    pub(crate) asks_unit: bool,
    /// Whether it is a log, of which nobody said which channel is what.
    pub(crate) is_log: bool,
}

impl Proposed {
    /// Gives it the places and the keys that follow from what is known now; what was stated or answered of them stays.
    pub(crate) fn follow(&mut self) {
        let own = self.error.map(|error| error.axis).or(self.told.axis);
        let held = self
            .told
            .places
            .iter()
            .filter(|(axis, _)| Some(*axis) != own);
        let known = |axis: AxisName| {
            let mut at = self.at.iter();
            at.find(|(of, _)| *of == axis).and_then(|(_, place)| *place)
        };
        self.at = held
            .map(|(axis, hinted)| (*axis, known(*axis).or(*hinted)))
            .collect();
        let mut keys = keys(self.error, &self.told);
        for (key, value) in &mut keys {
            if let Some((_, stated)) = self.keys.iter().find(|(of, _)| of == key) {
                value.clone_from(stated);
            }
        }
        self.keys = keys;
    }

    /// Whether the error or the unit, or what else decides which keys there are, was left to be answered.
    pub(crate) fn may_lose_keys(&self) -> bool {
        self.error.is_none() || self.told.asks_unit || self.told.is_log
    }

    /// Whether this is a key of other errors or units that this measurement does not have.
    pub(crate) fn has_lost(&self, key: &str) -> bool {
        if let Some(letter) = key.strip_prefix("at.") {
            let is_it = |(axis, _): &(AxisName, Option<f64>)| axis.to_string() == letter;
            return self.told.places.iter().any(is_it) && !self.at.iter().any(is_it);
        }
        FOLLOWING.contains(&key) && !self.keys.iter().any(|(of, _)| *of == key)
    }
}

/// The keys that one error has and another has not.
const FOLLOWING: [&str; 6] = [
    "point",
    "rides",
    "holds_location",
    "sign",
    "bridge_mm",
    "reading",
];

fn keys(error: Option<ErrorName>, told: &Told) -> Vec<(&'static str, String)> {
    let mut keys = Vec::new();
    if told.is_log {
        let channels = CHANNEL_KEYS.map(|key| format!("{key} = {}", open()));
        keys.push(("channels", format!("{{ {} }}", channels.join(", "))));
    }
    if error.is_none_or(|error| !error.component.is_angular()) {
        keys.push(("point", open()));
        keys.push(("rides", open()));
    }
    if error.is_some_and(|error| error.axis.is_rotary()) {
        keys.push(("holds_location", open()));
    }
    if told.asks_unit {
        keys.push(("unit", open()));
    }
    // Whether the table or the tool moved gives no sign to a positioning alone.
    let is_positioning = match error {
        Some(error) => MotionKind::of(error) == MotionKind::Positioning,
        None => told.quantity.is_none_or(|q| q == Quantity::Positioning),
    };
    if !is_positioning || told.format == Some(FileFormat::RenishawExport) {
        keys.push(("sign", open()));
    }
    // A straightness whose readings are angles was measured by a level on a bridge, or by an angular interferometer.
    let is_straightness = error.is_some_and(|error| {
        MotionKind::of(error) == MotionKind::Straightness && !error.axis.is_rotary()
    });
    let reads_angles = match told.unit {
        Some(unit) => unit == DeviationUnit::Urad,
        None => told.quantity == Some(Quantity::Angle),
    };
    if is_straightness && reads_angles {
        keys.push(("method", "\"angular\"".to_owned()));
        keys.push(("bridge_mm", open()));
        keys.push(("reading", open()));
    }
    keys
}
