//! First stage: the angular errors, from their readings alone.

use std::collections::BTreeMap;

use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::{
    calibration_file::CalibrationFile,
    contradictions::{contradictions, noise_of_lines},
    error::CalibrateError,
    fitted::{Fitted, fit, joint_of, lines_of, measured},
    locations::without_others,
    profile::Profile,
    set_up::SetUp,
};

/// The fitted angular errors, and the machine with them.
pub(crate) struct Angular {
    pub(crate) fitted: Vec<Fitted>,
    /// The machine of the file with its fitted tilts: what Abbe's principle and held tilts are taken from.
    pub(crate) tilted: Machine,
    /// The standard deviation of each fitted tilt at a target, µrad, where its readings show it.
    pub(crate) noise_urad: BTreeMap<ErrorName, f64>,
    pub(crate) notes: Vec<String>,
    /// Those of the notes that say which lines contradict each other.
    pub(crate) contradictions: Vec<(ErrorName, String)>,
}

/// Fits every angular error; `step` is called after each.
///
/// `known` is the machine of the file with the errors that are known before. What the location errors and the other axes of
/// `whole` add is taken off the readings of rotary axes.
pub(crate) fn angular(
    file: &CalibrationFile,
    known: &Machine,
    (whole, set_up): (&Machine, &SetUp),
    mut step: impl FnMut(),
) -> Result<Angular, CalibrateError> {
    let mut result = Angular {
        fitted: Vec::new(),
        tilted: known.clone(),
        noise_urad: BTreeMap::new(),
        notes: Vec::new(),
        contradictions: Vec::new(),
    };
    let names = measured(file).into_iter();
    for error in names.filter(|error| error.component.is_angular()) {
        let joint = joint_of(&file.machine, error)?;
        let mut profiles = Vec::new();
        for line in lines_of(file, error) {
            let read = Profile::new(line, &joint)?;
            profiles.push(without_others(read, whole, set_up)?);
        }
        let told = contradictions(error, &profiles, None)?;
        result
            .notes
            .extend(told.iter().map(|(_, text)| text.clone()));
        result.contradictions.extend(told);
        let noise = noise_of_lines(&profiles);
        result.noise_urad.extend(noise.map(|noise| (error, noise)));
        let (fitted, _) = fit(file, error, profiles)?;
        for one in &fitted {
            one.set_in(&mut result.tilted)?;
        }
        result.fitted.extend(fitted);
        step();
    }
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use volcomp_vocabulary::AxisName;

    use crate::testing::{file, line, name};

    /// ECX = 3 + 0.02 q is zero at the reference q = 200: 0.02 (q − 200).
    #[test]
    fn a_curve_is_zero_at_the_reference() {
        let mut file = file(vec![line("ECX", |q| 3.0 + 0.02 * q), line("EXX", |q| q)]);
        file.reference[0] = 200.0;
        let mut steps = 0;
        let found = angular(
            &file,
            &file.machine,
            (
                &file.machine,
                &SetUp::of(&file.machine, &[], [AxisName::X, AxisName::Y], |_| None),
            ),
            || steps += 1,
        )
        .unwrap();
        assert_eq!(
            (steps, found.fitted.len()),
            (1, 1),
            "the linear error is left alone"
        );
        for q in [0.0, 200.0, 730.0] {
            let value = found.fitted[0].branches.mean_at(q);
            assert!((value - 0.02 * (q - 200.0)).abs() < 1e-9, "{value} at {q}");
        }
        assert!(found.tilted.error(name("ECX")).is_some());
        assert!(found.tilted.error(name("EXX")).is_none());
    }
}
