//! Second stage: the linear errors, after subtracting the contributions of the tilts of their axis; a straightness also without its line.

use volcomp_metrology::MotionKind;
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{Component, ErrorName};

use crate::{
    abbe::{Lever, without_abbe},
    artefact_poses::ArtefactPoses,
    calibration_file::{CalibrationFile, lines_of, measured},
    checks::contradictions::{Tilts, contradictions},
    error::CalibrateError,
    fitted::{Fitted, fit, joint_of},
    line_of_sight::without_others,
    profile::Profile,
    squares::RemovedSlope,
};

/// Minimum effect of 1 mrad, µm, at which an unmeasured tilt is reported: a lever arm of 1 mm.
const NAMED_ABOVE_UM_BY_MRAD: f64 = 1.0;

/// Fitted linear errors, and the slopes of the straightness lines that were removed.
pub(crate) struct Linear<'a> {
    pub(crate) fitted: Vec<Fitted>,
    /// Each measured straightness line with the total slope removed from it, as a function of the coordinate of the
    /// line.
    pub(crate) removed: Vec<RemovedSlope<'a>>,
    pub(crate) notes: Vec<String>,
    /// Subset of `notes`: contradictory measurement lines.
    pub(crate) contradictions: Vec<(ErrorName, String)>,
}

/// Fits every linear error, and calls `step` after each of them. The contributions of the tilts of the machine in
/// `tilts` and, for rotary axes, of the other axes of `whole` are subtracted.
pub(crate) fn linear<'a>(
    file: &'a CalibrationFile,
    tilts: &Tilts<'_>,
    (whole, artefacts): (&Machine, &ArtefactPoses),
    mut step: impl FnMut(),
) -> Result<Linear<'a>, CalibrateError> {
    let tilted = tilts.machine;
    let mut result = Linear {
        fitted: Vec::new(),
        removed: Vec::new(),
        notes: Vec::new(),
        contradictions: Vec::new(),
    };
    let names = measured(file).into_iter();
    for error in names.filter(|error| !error.component.is_angular()) {
        let joint = joint_of(tilted, error)?;
        let straightness = MotionKind::of(error) == MotionKind::Straightness;
        let mut profiles = Vec::new();
        for line in lines_of(file, error) {
            let read = Profile::new(line, &joint)?;
            let mut profile = without_abbe(without_others(read, whole, artefacts)?, tilted)?;
            profile.as_one_run = tilts.found_from.get(&error).cloned();
            result.notes.extend(levers_left_in(&profile, tilted)?);
            profiles.push(profile);
        }
        let found = contradictions(error, &profiles, Some(tilts))?;
        result.notes.extend(found.iter().map(|(_, text)| text.clone()));
        result.contradictions.extend(found);
        if straightness {
            let straight = |profile: Profile<'a>| {
                let line = profile.reference_line()?;
                Ok(profile.without_line(&line))
            };
            let profiles_of = profiles.into_iter().map(straight);
            profiles = profiles_of.collect::<Result<_, CalibrateError>>()?;
        }
        let (fitted, profiles) = fit(file, error, profiles)?;
        result.fitted.extend(fitted);
        if straightness {
            result.removed.extend(profiles.iter().map(RemovedSlope::of));
        }
        step();
    }
    Ok(result)
}

/// Notes on unknown tilts of the axis that would affect a line.
fn levers_left_in(profile: &Profile<'_>, tilted: &Machine) -> Result<Vec<String>, ModelError> {
    let line = profile.line;
    let targets = profile.all().map(|point| point.0);
    let effects = Lever::new(line, tilted)?.um_by_mrad(targets);
    let components = Component::ALL.into_iter().filter(|c| c.is_angular());
    let note = |(component, effect): (Component, f64)| {
        let tilt = ErrorName::motion(component, line.setup.error.axis);
        let is_left = effect >= NAMED_ABOVE_UM_BY_MRAD && tilted.error(tilt).is_none();
        is_left.then(|| {
            format!(
                "{tilt} was not measured: {} from {} keeps its part, over a lever of up to {effect:.0} mm",
                line.setup.error,
                line.file.display()
            )
        })
    };
    Ok(components.zip(effects).filter_map(note).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{file, line, machine};
    use std::collections::BTreeMap;
    use volcomp_vocabulary::AxisName;

    fn with_tilts<'a>(file: &'a CalibrationFile, machine: &Machine) -> Linear<'a> {
        let (noise_urad, found_from) = (&BTreeMap::new(), &BTreeMap::new());
        linear(
            file,
            &Tilts { machine, noise_urad, found_from },
            (machine, &ArtefactPoses::of(machine, &[], [AxisName::X, AxisName::Y], |_| None)),
            || (),
        )
        .unwrap()
    }

    /// EXX measured 400 mm from the point at which errors are stated, along −Y: a yaw of 0.05
    /// µrad/mm adds −ECX · y = 0.05 q · 0.4 µm, which the stage subtracts.
    #[test]
    fn what_a_yaw_adds_over_its_lever_is_removed() {
        let mut positioning = line("EXX", |q| 0.01 * q + 0.05 * q * 0.4);
        positioning.setup.point_mcs = Some([0.0, -400.0, 0.0]);
        let file = file(vec![positioning]);
        let tilted = machine("ECX = { poly = [0, 0.05] }");
        let found = with_tilts(&file, &tilted);
        for q in [0.0, 500.0, 1000.0] {
            let value = found.fitted[0].branches.mean_at(q);
            assert!((value - 0.01 * q).abs() < 1e-9, "{value} at {q}");
        }
        assert!(found.notes.is_empty(), "{:?}", found.notes);
        let left_in = with_tilts(&file, &machine("")).notes;
        assert_eq!(
            left_in,
            ["ECX was not measured: EXX from EXX.csv keeps its part, over a lever of up to 400 mm"]
        );
    }
}
