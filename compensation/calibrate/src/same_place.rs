//! Measurements of one error with all axes at the same places: only one of them can hold.

use crate::draft::{Proposed, open};

impl Proposed {
    /// Whether both are of one error with the axes at the same places, and the measured point as far as it is known of both. Places
    /// that are open are the same.
    fn is_at_place_of(&self, other: &Self) -> bool {
        let is_one_point = match (self.point(), other.point()) {
            (Some(one), Some(other)) => one == other,
            _ => true,
        };
        self.error.is_some() && self.error == other.error && self.at == other.at && is_one_point
    }

    fn has_known_place(&self) -> bool {
        self.at.iter().all(|(_, place)| place.is_some())
    }

    fn point(&self) -> Option<&str> {
        let mut keys = self.keys.iter();
        let point = keys.find(|(key, value)| *key == "point" && *value != open());
        point.map(|(_, value)| value.as_str())
    }
}

/// Those at the same places become one measurement, whose file is asked for; those of which a place is not known are named.
pub(crate) fn join(proposed: &mut Vec<Proposed>, conflicts: &mut Vec<String>) {
    let mut kept: Vec<Proposed> = Vec::new();
    for of in proposed.drain(..) {
        let Some(other) = kept.iter_mut().find(|other| of.is_at_place_of(other)) else {
            kept.push(of);
            continue;
        };
        if of.has_known_place() {
            conflicts.push(keep_one(other, &of));
            other.files.extend(of.files);
            other.said.extend(of.said);
        } else {
            conflicts.push(format!(
                "{}: `at` has to tell them apart, else keep one",
                both_measure(other, &of)
            ));
            kept.push(of);
        }
    }
    *proposed = kept;
}

/// What is said of measurements that answers have brought to the same places. Those of which the draft itself knew it stand in
/// one measurement already.
pub(crate) fn conflicts(now: &[Proposed]) -> Vec<String> {
    let told = |(place, of): (usize, &Proposed)| {
        let mut before = now[..place].iter();
        let other = before.find(|other| of.has_known_place() && of.is_at_place_of(other))?;
        Some(keep_one(other, of))
    };
    now.iter().enumerate().filter_map(told).collect()
}

fn keep_one(one: &Proposed, other: &Proposed) -> String {
    format!("{} at the same place: keep one", both_measure(one, other))
}

fn both_measure(one: &Proposed, other: &Proposed) -> String {
    format!(
        "{} and {} both measure {}",
        one.files.join(", "),
        other.files.join(", "),
        one.error.map_or(String::new(), |error| error.to_string())
    )
}
