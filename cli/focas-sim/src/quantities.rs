//! Axes, counts and times in the units of the options and of the control.

use std::time::Duration;

use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, PerChannel};

use crate::error::SimError;

/// Converts a number of units of `unit_s` seconds to a duration.
pub(crate) fn duration(place: &str, found: f64, unit_s: f64) -> Result<Duration, SimError> {
    Duration::try_from_secs_f64(found * unit_s)
        .map_err(|_| SimError::input(place, found.to_string(), "a time that is not negative"))
}

/// One count of an axis in the words of the simulated control: 1 µm and 0.001 deg.
pub(crate) fn count(kind: AxisKind) -> Displacement {
    match kind {
        AxisKind::Linear => Displacement::Length(Mm(0.001)),
        AxisKind::Rotary => Displacement::Angle(Deg(0.001).to_rad()),
    }
}

/// Axis letters, separated by commas.
pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(AxisName::to_string).collect();
    letters.join(",")
}

/// Converts a position in mm and rad to the control's units, mm and deg.
pub(crate) fn outside(axes: &[AxisName], place: &PerChannel<f64>) -> Vec<f64> {
    let of = |(axis, value): (&AxisName, &f64)| Displacement::new(axis.kind(), *value).mm_or_deg();
    axes.iter().zip(place.iter()).map(of).collect()
}
