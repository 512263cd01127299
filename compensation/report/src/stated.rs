//! Header data of a report that the caller states; they override those of the files.

use volcomp_metrology::{Edition, Environment, Measurement, Metadata, StartEnd};
use volcomp_model::Machine;

use crate::report::{AxisTravel, Head};

/// Values from the caller, which override the values in the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stated {
    pub customer: Option<String>,
    /// Number of the certificate.
    pub certificate: Option<String>,
    /// Minimum and maximum air temperature, °C, instead of those in the files.
    pub air_degc: Option<[f64; 2]>,
    /// Minimum and maximum material temperature, °C, instead of those in the files.
    pub material_degc: Option<[f64; 2]>,
    /// Name of the machine, instead of that in the measurement files.
    pub machine: Option<String>,
    pub serial: Option<String>,
    /// Date of the measurement, instead of that in the files.
    pub date: Option<String>,
    /// Name of the person who measured.
    pub operator: Option<String>,
    /// Name of the measuring instrument.
    pub instrument: Option<String>,
    /// Edition of ISO 230-2 by which the tests are evaluated.
    pub edition: Edition,
}

pub(crate) fn head<'a>(
    source: &str,
    machine: &Machine,
    measurements: &(impl Iterator<Item = &'a Measurement> + Clone),
    stated: &Stated,
) -> Head {
    let of_files = |field: fn(&Metadata) -> Option<String>| {
        joined(measurements.clone().filter_map(|m| field(&m.metadata)))
    };
    let of_sensors = |field: fn(&Environment) -> Vec<StartEnd>| {
        let all = measurements.clone().flat_map(|m| field(&m.environment));
        range(all.flat_map(|value| [value.start, value.end]))
    };
    let program = |of: &Metadata| match (&of.owner, &of.version) {
        (Some(owner), Some(version)) => Some(format!("{owner} {version}")),
        (Some(owner), None) => Some(owner.clone()),
        _ => None,
    };
    let axes = machine.axes().iter().map(|axis| AxisTravel {
        axis: axis.name.to_string(),
        travel: axis.travel,
        unit: axis.name.kind().coordinate_unit().to_owned(),
    });
    Head {
        source: source.to_owned(),
        machine: stated.machine.clone().or_else(|| of_files(|m| m.machine.clone())),
        serial: stated.serial.clone().or_else(|| of_files(|m| m.serial.clone())),
        date: stated.date.clone().or_else(|| of_files(|m| m.date.clone())),
        operator: stated.operator.clone().or_else(|| of_files(|m| m.by.clone())),
        instrument: stated.instrument.clone().or_else(|| of_files(program)),
        customer: stated.customer.clone(),
        certificate: stated.certificate.clone(),
        air_degc: (stated.air_degc)
            .or_else(|| of_sensors(|e| e.air_temperature.into_iter().collect())),
        material_degc: (stated.material_degc)
            .or_else(|| of_sensors(|e| e.material_temperature.into_iter().flatten().collect())),
        structure: machine.chain().structure().to_string(),
        axes: axes.collect(),
        tool_tip_mm: machine.chain().tool_tip_mm().into(),
        files: Vec::new(),
    }
}

fn joined(texts: impl Iterator<Item = String>) -> Option<String> {
    const MOST: usize = 4;
    let mut once: Vec<String> = Vec::new();
    for text in texts {
        if !once.contains(&text) {
            once.push(text);
        }
    }
    let beyond = once.len().saturating_sub(MOST);
    once.truncate(MOST);
    if beyond > 0 {
        once.push("…".to_owned());
    }
    (!once.is_empty()).then(|| once.join("; "))
}

fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |range: Option<[f64; 2]>, value| {
        let [low, high] = range.unwrap_or([value; 2]);
        Some([low.min(value), high.max(value)])
    })
}
