//! Third stage: the slopes of the straightness lines, cleared of what the tilts of held axes add.

use std::collections::BTreeMap;

use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{calibration_file::Line, others::OtherErrors, set_up::SetUp};

/// The least-squares slope of each measured straightness error, by the coordinate of the machine coordinate system.
pub(crate) type Slopes = BTreeMap<ErrorName, Urad>;

/// The mean slope of the lines of each straightness error, from the slopes that were removed from them.
pub(crate) fn slopes(
    removed: &[(&Line, Urad)],
    tilted: &Machine,
    set_up: &SetUp,
) -> Result<Slopes, ModelError> {
    let mut sums: BTreeMap<ErrorName, (Urad, f64)> = BTreeMap::new();
    for (line, slope) in removed {
        let (sum, count) = sums.entry(line.setup.error).or_default();
        *sum = *sum + (*slope - held_slope(line, tilted, set_up)?);
        *count += 1.0;
    }
    let mean = |(error, (sum, count)): (ErrorName, (Urad, f64))| {
        let direction = tilted.chain().joints()[tilted.index_of(error.axis)?].direction;
        let along_mcs = direction[error.axis.mcs_index()].signum();
        Ok((error, Urad(along_mcs * sum.0 / count)))
    };
    sums.into_iter().map(mean).collect()
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
        let removed = [(&lines[0], Urad(10.0)), (&lines[1], Urad(14.0))];
        let found = slopes(
            &removed,
            &tilted,
            &SetUp::of(&tilted, &[], [AxisName::X, AxisName::Y], |_| None),
        )
        .unwrap();
        let slope = found[&name("EXY")];
        assert!((slope - Urad(16.0)).abs() < Urad(1e-9), "{slope}");
    }
}
