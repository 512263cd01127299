//! Axes, counts and times as the call and the control have them.

use std::time::Duration;

use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, PerChannel};

use crate::error::SimError;

/// A time from a number of units of `unit_s` seconds.
pub(crate) fn duration(place: &str, found: f64, unit_s: f64) -> Result<Duration, SimError> {
    Duration::try_from_secs_f64(found * unit_s)
        .map_err(|_| SimError::input(place, found.to_string(), "a time that is not negative"))
}

/// One count of an axis, as the words of the simulated control have it: 1 µm and 0.001 deg.
pub(crate) fn count(kind: AxisKind) -> Displacement {
    match kind {
        AxisKind::Linear => Displacement::Length(Mm(0.001)),
        AxisKind::Rotary => Displacement::Angle(Deg(0.001).to_rad()),
    }
}

/// The letters of axes, commas between.
pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(AxisName::to_string).collect();
    letters.join(",")
}

/// A place of a path, mm and rad, as the control counts: mm and deg.
pub(crate) fn outside(axes: &[AxisName], place: &PerChannel<f64>) -> Vec<f64> {
    let of = |(axis, value): (&AxisName, &f64)| Displacement::new(axis.kind(), *value).mm_or_deg();
    axes.iter().zip(place.iter()).map(of).collect()
}
