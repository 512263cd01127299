//! The limits of the axes of a controller: what settings, device and machine make of them together.

use std::time::Duration;

use volcomp_guard::{AxisLimits, Limits, ROUNDING, ceiling, reversal_threshold};
use volcomp_kinematics::Correctors;
use volcomp_port::{Axis, Description};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerChannel, Urad};

use crate::{
    error::PlanError,
    settings::{AxisSettings, GuardSettings, PathSettings},
};

/// The test shift is at least so many steps of the position and of the correction: a smaller one proves nothing.
pub const SHIFT_STEPS: f64 = 4.0;

/// How fast a correction that is left over on an axis that does not correct, and for which no limits are stated, goes
/// back to zero: a tenth of a milliradian in a second.
const HELD_SLEW_PER_S: Urad = Urad(100.0);

/// The limits of an axis that does not correct where none are stated: its goal is zero, and what is left over there
/// goes back slowly.
fn held_limits(axis: &Axis) -> AxisLimits {
    AxisLimits {
        kind: axis.kind(),
        limit: axis.step(),
        warn: axis.step(),
        slew_per_s: HELD_SLEW_PER_S.to_rad().0,
        accel_per_s2: f64::INFINITY,
        resolution: axis.step(),
        includes_correction: axis.includes_correction,
    }
}

/// The limits that the guard of a controller enforces, mm and rad. Axes that do not correct have no test shift, and
/// need no limits; where some are stated, those of the device and of a path without a barrier bound them, too.
///
/// # Errors
/// Rotary axes that correct and have no limits, limits that a guard refuses, or that are larger than what the device
/// can be told.
pub(super) fn limits(
    description: &Description,
    position_steps: &PerChannel<f64>,
    machine_axis: &PerChannel<usize>,
    correctors: &Correctors,
    guard: &GuardSettings,
    settings: &PathSettings,
    period: Duration,
) -> Result<Limits, PlanError> {
    let mut axes = [AxisLimits::NONE; MAX_AXES];
    let mut test_shift = PerChannel::ZERO;
    let places = axes.iter_mut().zip(&mut test_shift).zip(machine_axis);
    let places = places.zip(position_steps);
    for ((((into, shift), place), position_step), axis) in places.zip(&description.axes) {
        let of_kind = guard.of(axis.name);
        if !correctors.contains(*place) {
            // Another model may correct it: the bounds of the device and of a path without a barrier hold all the same.
            *into =
                of_kind.map_or_else(|| held_limits(axis), |of_kind| axis_limits(axis, &of_kind));
            if let Some(largest) = axis.largest {
                lower_to(into, largest.mm_or_rad());
            }
            if !description.barrier {
                without_barrier(into, guard);
            }
            let most = match into.kind {
                AxisKind::Linear => ceiling::LIMIT.0,
                AxisKind::Rotary => ceiling::LIMIT_ROTARY.0,
            };
            if into.resolution > into.limit.min(most * ROUNDING) {
                // Not even one step of it may be written.
                *into = into.held_at_zero();
            }
            continue;
        }
        let of_kind = of_kind.ok_or_else(|| PlanError::NoRotaryLimits {
            device: description.device.clone(),
            axis: axis.name,
        })?;
        *into = axis_limits(axis, &of_kind);
        if let Some(largest) = axis.largest
            && into.limit > largest.mm_or_rad() * ROUNDING
        {
            return Err(PlanError::BeyondDevice {
                device: description.device.clone(),
                axis: axis.name,
                found: of_kind.limit,
                largest,
            });
        }
        if !description.barrier {
            without_barrier(into, guard);
        }
        let asked = of_kind.test_shift.mm_or_rad();
        let wanted = asked.max(SHIFT_STEPS * axis.step().max(*position_step));
        if settings.proves && asked > 0.0 && wanted <= into.limit {
            *shift = wanted;
        }
    }
    let hold = settings.hold.unwrap_or(guard.hold);
    let limits = Limits {
        axes,
        count: description.axes.len(),
        period,
        hold,
        only_thermal: settings.only_thermal,
        zero_after: guard.zero_after.max(hold),
        ramp: guard.ramp,
        test_shift,
        read_back_cycles: settings.read_back_cycles,
    };
    limits.check().map_err(|source| PlanError::Limits {
        device: description.device.clone(),
        axis: source
            .axis
            .and_then(|(place, _)| axis_of(description, place)),
        source,
    })?;
    Ok(limits)
}

/// The smallest step of the position of each axis that a controller shows, mm or rad; 0 where none is stated.
pub(crate) fn position_steps(
    description: &Description,
    settings: &PathSettings,
) -> Result<PerChannel<f64>, PlanError> {
    let mut steps = PerChannel::ZERO;
    for (into, name) in steps.iter_mut().zip(description.shown_axes()) {
        *into = match settings.position_steps.get(&name) {
            None => 0.0,
            Some(step) if step.kind() == name.kind() && step.mm_or_rad() >= 0.0 => step.mm_or_rad(),
            Some(_) => {
                return Err(PlanError::PositionStep {
                    device: description.device.clone(),
                    axis: name,
                });
            }
        };
    }
    Ok(steps)
}

/// Travel after which the direction of each axis that a controller shows counts as turned, mm or rad. On one that is
/// only read no correction is taken for travel.
pub(crate) fn reversals(
    description: &Description,
    position_steps: &PerChannel<f64>,
    limits: Option<&Limits>,
) -> PerChannel<f64> {
    let mut reversal = PerChannel::ZERO;
    let delay = limits.map_or(Duration::ZERO, Limits::delay);
    let written = |place: usize| {
        let limits = limits.filter(|limits| place < limits.count)?;
        Some(limits.axes[place])
    };
    let shown = description.shown_axes().zip(position_steps);
    for (place, (into, (name, step))) in reversal.iter_mut().zip(shown).enumerate() {
        let axis = written(place).unwrap_or(AxisLimits {
            kind: name.kind(),
            ..AxisLimits::NONE
        });
        *into = reversal_threshold(&axis, *step, delay);
    }
    reversal
}

/// The limit of an axis on a path without a barrier, and its warning, which lies within.
fn without_barrier(limits: &mut AxisLimits, guard: &GuardSettings) {
    let most = match limits.kind {
        AxisKind::Linear => guard.without_barrier.linear.to_mm().0,
        AxisKind::Rotary => guard.without_barrier.rotary.to_rad().0,
    };
    lower_to(limits, most);
}

/// A limit of `most` (mm or rad) at the most, and its warning, which lies within.
fn lower_to(limits: &mut AxisLimits, most: f64) {
    if limits.warn <= limits.limit {
        limits.warn = limits.warn.min(most);
    }
    limits.limit = limits.limit.min(most);
}

fn axis_of(description: &Description, place: usize) -> Option<AxisName> {
    Some(description.axes.get(place)?.name)
}

fn axis_limits(axis: &Axis, guard: &AxisSettings<Displacement>) -> AxisLimits {
    let guard = guard.map(Displacement::mm_or_rad);
    let mut limits = AxisLimits {
        kind: axis.kind(),
        limit: guard.limit,
        warn: guard.warn,
        slew_per_s: guard.slew_per_s,
        accel_per_s2: guard.accel_per_s2,
        resolution: axis.step(),
        includes_correction: axis.includes_correction,
    };
    // A correction that is cut to the largest one that can be written is reported. A limit below one step, and a
    // warning above the limit, are for the check to refuse.
    let reachable = limits.reachable();
    if reachable > 0.0 && limits.warn <= limits.limit {
        limits.warn = limits.warn.min(reachable);
    }
    limits
}
