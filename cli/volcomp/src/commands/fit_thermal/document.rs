//! The result of a thermal fit as a document.

use volcomp_fit::ThermalEffect;

use super::{Arguments, Channel, Judged, terms, verdict::Verdict};
use crate::answers::fit_thermal::{
    Displacement, DriftTerm, ExpansionTerm, FitThermal, LeftOut, Number, Prediction, Seen, Segment,
    Size,
};

pub(super) fn document(
    channels: &[Channel],
    sensors: &[String],
    arguments: &Arguments,
) -> FitThermal {
    let displacement = |channel: &Channel| displacement(channel, sensors, arguments);
    FitThermal {
        displacements: channels.iter().map(displacement).collect(),
        train: (arguments.data.len() == 1).then_some(arguments.train),
        sensors: sensors.to_vec(),
    }
}

fn displacement(channel: &Channel, sensors: &[String], arguments: &Arguments) -> Displacement {
    let angular = channel.is_angular();
    let in_um = |value: f64| (!angular).then_some(value);
    let in_urad = |value: f64| angular.then_some(value);
    let name = |sensor: usize| sensors.get(sensor).cloned().unwrap_or_default();
    let prediction = |judged: &Judged| Prediction {
        rms_um: in_um(judged.rms),
        rms_urad: in_urad(judged.rms),
        worst_segment: judged.worst.as_ref().map(|worst| Segment {
            from_s: worst.from_s,
            to_s: worst.to_s,
            rms_um: in_um(worst.rms),
            rms_urad: in_urad(worst.rms),
        }),
        forward_rms_um: in_um(judged.validated),
        forward_rms_urad: in_urad(judged.validated),
        penalties: judged.penalties.clone(),
        lags_s: judged.lags_s.clone(),
        sensors: judged.sensors.iter().map(|sensor| name(*sensor)).collect(),
    };
    let found = &channel.terms;
    let number = |number: &volcomp_fit::ThermalNumber| {
        let lag_s = match number.effect {
            ThermalEffect::Drift { lag_s } => Some(lag_s),
            ThermalEffect::Expansion => None,
        };
        let scale = if lag_s.is_none() { 1e3 } else { 1.0 };
        let value = number.value * scale;
        let uncertainty = number.uncertainty * scale;
        Number {
            sensor: name(number.sensor),
            lag_s,
            um_per_k: lag_s.and(in_um(value)),
            urad_per_k: lag_s.and(in_urad(value)),
            um_per_m_k: lag_s.is_none().then_some(value),
            uncertainty_um_per_k: lag_s.and(in_um(uncertainty)),
            uncertainty_urad_per_k: lag_s.and(in_urad(uncertainty)),
            uncertainty_um_per_m_k: lag_s.is_none().then_some(uncertainty),
        }
    };
    let size = |size: &volcomp_fit::ThermalSize| Size {
        numbers: size.numbers,
        rms_um: in_um(size.rms),
        rms_urad: in_urad(size.rms),
        standard_error_um: in_um(size.standard_error),
        standard_error_urad: in_urad(size.standard_error),
    };
    let left_out = arguments.data.iter().zip(&channel.left_out);
    let left_out = left_out.map(|(file, &rms)| LeftOut {
        file: file.display().to_string(),
        rms_um: in_um(rms),
        rms_urad: in_urad(rms),
    });
    let (constant, spread) = found.constant_at(arguments.reference);
    let (drift, expansions) = terms::terms(found, sensors);
    Displacement {
        name: channel.name.clone(),
        error: channel.error.map(|error| error.to_string()),
        recommended: channel.verdict() == Verdict::Good,
        without_terms_rms_um: in_um(channel.none),
        without_terms_rms_urad: in_urad(channel.none),
        baseline: prediction(&channel.plain),
        dense: channel.dense.as_ref().map(prediction),
        fit: prediction(&channel.few),
        left_out: left_out.collect(),
        numbers: found.numbers.iter().map(number).collect(),
        sizes: found.path.iter().map(size).collect(),
        drift: drift
            .into_iter()
            .map(|(lag_s, sensors)| DriftTerm {
                lag_s,
                sensors,
                um_per_k: in_um(1.0),
                urad_per_k: in_urad(1.0),
            })
            .collect(),
        expansion: expansions
            .into_iter()
            .map(|term| ExpansionTerm {
                sensor: term.sensor,
                um_per_m_k: term.um_per_m_k,
                fixed_mm: term.fixed_mm,
            })
            .collect(),
        seen: found
            .seen
            .iter()
            .map(|seen| Seen {
                sensor: name(seen.sensor),
                degc: seen.degc,
                k_per_min: seen.k_per_min,
            })
            .collect(),
        constant_um: in_um(constant),
        constant_urad: in_urad(constant),
        constant_spread_um: in_um(spread),
        constant_spread_urad: in_urad(spread),
        toml: terms::toml(channel, sensors, arguments.reference),
    }
}
