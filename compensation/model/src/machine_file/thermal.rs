//! The table `[thermal]` of a machine file.

use std::collections::BTreeMap;

use volcomp_document::{InputError, Section};
use volcomp_kinematics::Structure;
use volcomp_vocabulary::{ErrorName, bounds::PLAUSIBLE_DEGC};

use crate::{
    error::ThermalRefusal,
    seen::Seen,
    thermal::{Drift, Expansion, MARGINS_K, Thermal, default_margin_k},
};

pub(super) fn decode_thermal(
    section: &Section<'_>,
    structure: &Structure,
) -> Result<Thermal, InputError> {
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
        // Checked against the terms and against the ranges before it.
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

/// The range of any finite number.
const NUMBERS: core::ops::RangeInclusive<f64> = f64::NEG_INFINITY..=f64::INFINITY;

/// The error motion to which a thermal term is added.
fn decode_motion(term: &Section<'_>, structure: &Structure) -> Result<ErrorName, InputError> {
    let value = term.require("error")?;
    let found = value.text()?;
    let known = |name: &ErrorName| !name.location && structure.index_of(name.axis).is_some();
    found.parse().ok().filter(known).ok_or_else(|| {
        let refusal = ThermalRefusal::Motion {
            found: found.to_owned(),
            structure: structure.to_string(),
        };
        value.error(refusal.to_string())
    })
}

fn decode_expansion(term: &Section<'_>, structure: &Structure) -> Result<Expansion, InputError> {
    term.allow(&["error", "sensor", "um_per_m_k", "fixed_mm"])?;
    let expansion = Expansion {
        error: decode_motion(term, structure)?,
        sensor: term.require("sensor")?.text()?.to_owned(),
        um_per_m_k: term.require("um_per_m_k")?.number()?,
        fixed_mm: term.number_or("fixed_mm", NUMBERS, 0.0)?,
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
        lag_s: term.number_or("lag_s", NUMBERS, 0.0)?,
    };
    match drift.check(structure) {
        Ok(()) => Ok(drift),
        Err(refusal) => Err(term.error(refusal.to_string())),
    }
}
