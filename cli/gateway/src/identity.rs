//! What a person confirms: a machine file together with the limits within which it corrects.

use std::collections::{BTreeMap, BTreeSet};

use sha2::{Digest, Sha256};
use volcomp_runtime::{AxisSettings, GuardSettings, Model};
use volcomp_vocabulary::AxisName;

use crate::documents::{ConfirmedLimits, LimitChanges, Question};

/// The limits, rates and accelerations of a configuration by their keys. An acceleration that is not limited has none.
pub(crate) fn limits(guard: &GuardSettings) -> ConfirmedLimits {
    let of = |unit: &str, settings: AxisSettings<f64>| {
        [
            (format!("limit_{unit}"), settings.limit),
            (format!("slew_{unit}_per_s"), settings.slew_per_s),
            (format!("accel_{unit}_per_s2"), settings.accel_per_s2),
        ]
    };
    let rotary = guard.rotary.map(|rotary| of("urad", rotary.map(|x| x.0)));
    let without = guard.without_barrier;
    let all = of("um", guard.linear.map(|x| x.0))
        .into_iter()
        .chain(rotary.into_iter().flatten())
        .chain([
            ("limit_without_barrier_um".to_owned(), without.linear.0),
            ("limit_without_barrier_urad".to_owned(), without.rotary.0),
        ]);
    all.filter(|(_, value)| value.is_finite()).collect()
}

/// The limits that differ, with the old and the new value.
pub(crate) fn changes(old: &ConfirmedLimits, new: &ConfirmedLimits) -> LimitChanges {
    let keys: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    keys.into_iter()
        .map(|key| (key.clone(), [old.get(key).copied(), new.get(key).copied()]))
        .filter(|(_, [old, new])| old != new)
        .collect()
}

/// The facts by which a change is judged.
pub(crate) struct Judge {
    /// The present temperatures by the name of the sensor, °C.
    pub degc: BTreeMap<String, f64>,
    /// The axes that each controller writes.
    pub written: Vec<Vec<AxisName>>,
    /// Moves of linear axes up to this need no confirmation, µm.
    pub confirm_um: f64,
    /// Moves of rotary axes up to this need no confirmation, µrad.
    pub confirm_urad: Option<f64>,
    /// The hash that a person has confirmed.
    pub confirmed: Option<String>,
}

impl Judge {
    /// The question that a person must confirm before `new` takes the place of `old`; `None` where there is none, or it
    /// is confirmed. The move of the correction is judged at the reference temperature and at the present ones.
    pub(crate) fn question(
        &self,
        [old, new]: [&Model; 2],
        limits: LimitChanges,
        to: &ConfirmedLimits,
    ) -> Option<Question> {
        let degc = |name: &str| self.degc.get(name).copied();
        let written = || self.written.iter().map(Vec::as_slice);
        let cold = old.largest_move(new, written());
        let warm = old.warmed(degc).largest_move(&new.warmed(degc), written());
        let worst = cold.max(warm);
        let (worst_um, worst_urad) = (worst.linear.to_um().0, worst.rotary.to_urad().0);
        let moves =
            worst_um > self.confirm_um || worst_urad > self.confirm_urad.unwrap_or(f64::INFINITY);
        let hash = hash(new, &limits, to);
        let is_small = !moves && limits.is_empty();
        if is_small || self.confirmed.as_ref() == Some(&hash) {
            return None;
        }
        // A machine with other axes moves infinitely far, which is no number in JSON.
        let finite = |x: f64| x.is_finite().then_some(x);
        Some(Question {
            model: hash,
            worst_corner_um: finite(worst_um),
            worst_corner_urad: finite(worst_urad),
            confirm_um: self.confirm_um,
            confirm_urad: self.confirm_urad,
            limits,
        })
    }
}

/// The hash by which a change is confirmed: of the machine file, and where limits change of the new limits besides.
fn hash(model: &Model, changes: &LimitChanges, limits: &ConfirmedLimits) -> String {
    if changes.is_empty() {
        return model.hash.clone();
    }
    let mut digest = Sha256::new().chain_update(&model.hash);
    for (key, value) in limits {
        digest.update(format!("\n{key} = {value}"));
    }
    format!("sha256:{}", crate::hex(&digest.finalize()))
}
