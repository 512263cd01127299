//! Third stage: the slopes of the straightness lines, cleared of what the tilts of held axes add.

use std::collections::BTreeMap;

use volcomp_metrology::{OfRun, slope_uncertainty_with_runs};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{
    calibration_file::Line, others::OtherErrors, profile::Profile, set_up::SetUp, setup::Method,
};

/// Slopes of lines of one error contradict each other when they differ by so many times their noise.
const TIMES_NOISE: f64 = 3.0;
/// Slopes that differ by less matter to no machine tool, µrad.
const NEVER_BELOW_URAD: f64 = 0.5;

/// The least-squares slope of each measured straightness error, by the coordinate of the machine coordinate system.
pub(crate) type Slopes = BTreeMap<ErrorName, Urad>;

/// The slope that was removed from a straightness line.
pub(crate) struct Removed<'a> {
    pub(crate) line: &'a Line,
    pub(crate) slope: Urad,
    /// Its standard deviation: from repeated runs, else from how unevenly the line runs; `None` where neither tells it.
    pub(crate) noise: Option<Urad>,
}

impl<'a> Removed<'a> {
    pub(crate) fn of(profile: &Profile<'a>) -> Self {
        let count = profile.all().count().max(1) as f64;
        let middle = profile.all().map(|(at, _)| at).sum::<f64>() / count;
        let spread: f64 = profile.all().map(|(at, _)| (at - middle).powi(2)).sum();
        let noise_um = profile
            .scatter_of_mean(OfRun::Zero)
            .map(|noise| noise.deviation)
            .or_else(|| profile.unevenness());
        let noise = noise_um.filter(|_| spread > 0.0);
        let of_line = noise.map(|um| 1e3 * um / spread.sqrt());
        let of_slope = match profile.line.setup.method {
            Method::Direct => slope_uncertainty_with_runs(&profile.line.readings, of_line),
            Method::Angular { .. } => of_line,
        };
        Self {
            line: profile.line,
            slope: profile.removed,
            noise: of_slope.map(Urad),
        }
    }
}

/// The mean slope of the lines of each straightness error, from the slopes that were removed from them, and notes on lines whose slopes contradict
/// each other.
pub(crate) fn slopes(
    removed: &[Removed<'_>],
    tilted: &Machine,
    set_up: &SetUp,
) -> Result<(Slopes, Vec<(ErrorName, String)>), ModelError> {
    let mut of_errors: BTreeMap<ErrorName, Vec<(&Removed<'_>, Urad)>> = BTreeMap::new();
    for of in removed {
        let slope = of.slope - held_slope(of.line, tilted, set_up)?;
        let all = of_errors.entry(of.line.setup.error).or_default();
        all.push((of, slope));
    }
    let mut slopes = Slopes::new();
    let mut contradictions = Vec::new();
    for (error, all) in of_errors {
        let direction = tilted.chain().joints()[tilted.index_of(error.axis)?].direction;
        let along_mcs = direction[error.axis.mcs_index()].signum();
        let sum: f64 = all.iter().map(|(_, slope)| slope.0).sum();
        slopes.insert(error, Urad(along_mcs * sum / all.len() as f64));
        contradictions.extend(contradiction(&all).map(|text| (error, text)));
    }
    Ok((slopes, contradictions))
}

/// A note on the steepest and the flattest line of an error, where no noise explains what they differ by.
fn contradiction(all: &[(&Removed<'_>, Urad)]) -> Option<String> {
    let by_slope = |a: &&(&Removed<'_>, Urad), b: &&(&Removed<'_>, Urad)| a.1.0.total_cmp(&b.1.0);
    let (low, low_slope) = all.iter().min_by(by_slope)?;
    let (high, high_slope) = all.iter().max_by(by_slope)?;
    let noise = low.noise?.0.hypot(high.noise?.0);
    let apart = high_slope.0 - low_slope.0;
    (apart > (TIMES_NOISE * noise).max(NEVER_BELOW_URAD)).then(|| {
        format!(
            "{}: the slopes of {} and {} contradict each other: {:.1} and {:.1} µrad, with a noise of {noise:.2} µrad. A squareness from their mean is that of neither; state the reference of each line, or leave one out",
            low.line.setup.error,
            low.line.file.display(),
            high.line.file.display(),
            low_slope.0,
            high_slope.0,
        )
    })
}

/// Slope of a line that all known errors of the machine give it at the held positions but those of its own travel: what
/// a perfect instrument would read along an axis that is straight and points where it should.
fn held_slope(line: &Line, tilted: &Machine, set_up: &SetUp) -> Result<Urad, ModelError> {
    /// Half of a way over which the slope is read, mm; the reading is a straight line.
    const REACH_MM: f64 = 500.0;
    let others = OtherErrors::new(line, tilted, set_up)?;
    let ends = others.readings([-REACH_MM, REACH_MM].into_iter())?;
    let read = (ends[1] - ends[0]) / (2.0 * REACH_MM) * 1e3;
    Ok(Urad(read + others.reference_slope_urad()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use volcomp_vocabulary::AxisName;

    use crate::testing::{line, machine, name};

    /// Two lines of Y with slopes of 10 and 14 µrad, seen from a table that X has yawed by 6 µrad at X = 300 and by
    /// 2 µrad at X = 100: a yaw c about +Z turns the line by −c, so 10 + 6 and 14 + 2 remain.
    #[test]
    fn the_yaw_of_a_held_table_is_taken_off_a_slope() {
        let tilted = machine("ECX = { poly = [0, 0.02] }");
        let mut lines = [line("EXY", |_| 0.0), line("EXY", |_| 0.0)];
        lines[0].setup.at[0] = 300.0;
        lines[1].setup.at[0] = 100.0;
        let removed = |line, slope| Removed {
            line,
            slope: Urad(slope),
            noise: Some(Urad(0.1)),
        };
        let removed = [removed(&lines[0], 10.0), removed(&lines[1], 14.0)];
        let (found, contradictions) = slopes(
            &removed,
            &tilted,
            &SetUp::of(&tilted, &[], [AxisName::X, AxisName::Y], |_| None),
        )
        .unwrap();
        let slope = found[&name("EXY")];
        assert!((slope - Urad(16.0)).abs() < Urad(1e-9), "{slope}");
        assert_eq!(contradictions, []);
        // Without the table that turns they are lines of two squares.
        let straight = machine("ECX = 0.0");
        let alone = SetUp::of(&straight, &[], [AxisName::X, AxisName::Y], |_| None);
        let (_, contradictions) = slopes(&removed, &straight, &alone).unwrap();
        assert!(
            contradictions[0].1.contains("10.0 and 14.0 µrad"),
            "{contradictions:?}"
        );
    }
}
