//! Warnings of a report, most severe first.

use volcomp_calibrate::{
    Calibration, CalibrationFile, Line, Method, squareness_lines_of_one_run, with_files,
};
use volcomp_metrology::{
    MATERIAL_WITHIN_K, MotionKind, Quantity, REFERENCE_DEGC, environment_notes, outlier_hints,
    shortfalls,
};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    report::{Warning, WarningKind},
    stated::Stated,
};

pub(crate) fn of_calibration(
    file: &CalibrationFile,
    calibration: &Calibration,
    not_measured: &[String],
    stated: &Stated,
) -> Vec<Warning> {
    let mut all = Vec::new();
    let mut add = |kind: WarningKind, text: String| {
        // A message that occurs twice is kept with its most severe kind.
        if all.iter().all(|warning: &Warning| warning.text != text) {
            all.push(Warning { kind, text });
        }
    };
    for (_, text) in &calibration.contradictions {
        add(WarningKind::Contradiction, text.clone());
    }
    let named = |line: &Line, text: String| format!("{}: {text}", line.file.display());
    for line in &file.measurements {
        let error = line.setup.error;
        let is_test =
            MotionKind::of(error) == MotionKind::Positioning && line.setup.method == Method::Direct;
        if is_test {
            let lacks = shortfalls(&line.readings, error.axis.kind(), stated.edition);
            if !lacks.is_empty() {
                add(WarningKind::Few, named(line, lacks.join("; ")));
            }
        }
    }
    let mut silent = Vec::new();
    let mut surroundings = Vec::new();
    for line in &file.measurements {
        let environment = &line.readings.environment;
        let is_length = line.setup.error.axis.kind() == AxisKind::Linear
            && MotionKind::of(line.setup.error) == MotionKind::Positioning;
        let quantity = if is_length { Quantity::Positioning } else { Quantity::Angle };
        for text in environment_notes(environment, quantity) {
            surroundings.push((line.file.display().to_string(), text));
        }
        let is_silent = environment.material_temperature.iter().flatten().next().is_none();
        if is_length && is_silent {
            silent.push(line.file.display().to_string());
        }
    }
    for text in with_files(surroundings) {
        add(WarningKind::Temperature, text);
    }
    if let Some(text) = stated.material_degc.and_then(material) {
        add(WarningKind::Temperature, text);
    }
    if let ([first, others @ ..], None) = (silent.as_slice(), stated.material_degc) {
        let files = match others.len() {
            0 => format!("{first} states"),
            more => format!("{first} and {more} other positioning files state"),
        };
        add(
            WarningKind::Temperature,
            format!(
                "{files} no material temperature: whether the lengths hold for 20 °C is not known"
            ),
        );
    }
    for line in &file.measurements {
        for hint in outlier_hints(&line.readings) {
            add(WarningKind::Outlier, named(line, hint.text));
        }
    }
    for text in not_measured {
        add(WarningKind::NotMeasured, text.clone());
    }
    let of_one_run: Vec<String> =
        squareness_lines_of_one_run(file).map(|line| line.file.display().to_string()).collect();
    if !of_one_run.is_empty() {
        add(
            WarningKind::Few,
            format!(
                "{}: one run; U of the squareness from it does not contain the alignment and drift of the reference, which several runs show",
                of_one_run.join(", ")
            ),
        );
    }
    for text in &calibration.warnings {
        add(WarningKind::Note, text.clone());
    }
    all.sort_by_key(|warning| warning.kind);
    all
}

/// Warning if the stated material temperature is far from 20 °C.
fn material([low, high]: [f64; 2]) -> Option<String> {
    let farthest = (low - REFERENCE_DEGC).abs().max((high - REFERENCE_DEGC).abs());
    (farthest > MATERIAL_WITHIN_K).then(|| {
        format!(
            "the material temperature is stated as {low:.2} to {high:.2} °C, farther than {MATERIAL_WITHIN_K} K from 20 °C: whether the readings are brought to 20 °C is not known"
        )
    })
}

pub(crate) fn warnings<T: ToString>(
    kind: WarningKind,
    texts: &[T],
) -> impl Iterator<Item = Warning> {
    texts.iter().map(move |text| Warning { kind, text: text.to_string() })
}

pub(crate) fn is_measured(calibration: &Calibration, pair: [AxisName; 2]) -> bool {
    let named = calibration.squareness.iter().map(|(error, _)| *error);
    let found = calibration.identified.iter().flat_map(|of| &of.found.parameters);
    let found =
        found.filter(|parameter| parameter.determined).filter_map(|parameter| parameter.error);
    named.chain(found).any(|error| error.location && crate::squares::pair_of(error) == Some(pair))
}
