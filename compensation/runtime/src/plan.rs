//! Checks the settings of one controller against its machine, as far as possible without a device.

use std::time::Duration;

use volcomp_guard::{
    AxisLimits, ControlTimeOut, Limits, ROUNDING, Reasons, ceiling, reversal_threshold,
};
use volcomp_kinematics::Correctors;
use volcomp_port::{Axis, Description, Heartbeat};
use volcomp_vocabulary::{
    AxisKind, AxisName, Displacement, MAX_AXES, Mm, PerAxis, PerChannel, Rad, Urad,
};

use crate::{
    error::PlanError,
    model::Model,
    settings::{AxisSettings, BarrierSettings, GuardSettings, PathSettings},
};

/// Minimum test shift, in steps: the larger of the position step and the correction step. A smaller shift proves
/// nothing.
pub const SHIFT_STEPS: f64 = 4.0;

/// Rate, per second, at which a remaining correction on a rotary axis that neither corrects nor has limits returns to zero.
const HELD_SLEW_PER_S: Urad = Urad(100.0);

/// Plan of a controller path: checked against machine and settings, not opened.
#[derive(Clone, Debug, PartialEq)]
pub struct PathPlan {
    /// The driver's description of the controller.
    pub description: Description,
    /// The limits that the guard enforces, mm and rad.
    pub limits: Limits,
    /// Machine index of each axis whose position the controller reports; written axes come first.
    pub machine_axis: PerChannel<usize>,
    /// Travel after which the direction of each reported axis counts as reversed, mm or rad.
    pub reversal: PerChannel<f64>,
    /// Resolution of the reported positions, mm or rad; 0 if none is configured.
    pub position_steps: PerChannel<f64>,
    /// Correcting axes of the controller; the other axes of the machine are held.
    pub correctors: Correctors,
    /// Maximum movement of the tip by half a step of a correcting rotary axis.
    pub rotary_step: Mm,
    /// Rotary axes that could correct but do not, because the error of the tool would increase.
    pub uncorrected: Vec<UncorrectedAxis>,
    /// Fixed positions of machine axes from the configuration, mm and rad; `None` for axes that are read.
    pub fixed: PerAxis<Option<f64>>,
    /// Reasons reported in every cycle.
    pub notes: Reasons,
    /// `None`: corrections are written as plain values.
    pub barrier: Option<BarrierSettings>,
    /// Whether the path carries the correction of thermal terms alone.
    pub only_thermal: bool,
    /// Whether the control has no read-back.
    pub no_read_back: bool,
    /// Time for which a control without a barrier is watched for foreign changes before the first write.
    pub watch: Duration,
    /// Behaviour of a control without read-back when writes stop; `None`: it keeps its correction.
    pub time_out: Option<ControlTimeOut>,
}

/// A rotary axis that could correct but does not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncorrectedAxis {
    pub axis: AxisName,
    pub why: UncorrectedReason,
}

/// Reasons why a rotary axis that could correct does not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UncorrectedReason {
    /// The correcting linear axes do not span all directions, so they cannot compensate the axis's movement of the tip.
    Uncatchable,
    /// Half a step of the axis moves the tip by up to this amount in the work space, which exceeds the permitted
    /// amount.
    Coarse(Mm),
}

impl PathPlan {
    /// Checks the description of a controller against machine and settings.
    ///
    /// # Errors
    /// The first conflict.
    pub fn new(
        description: Description,
        model: &Model,
        guard: &GuardSettings,
        settings: &PathSettings,
        period: Duration,
    ) -> Result<Self, PlanError> {
        let device = || description.device.clone();
        description.check().map_err(|source| PlanError::Axes { device: device(), source })?;
        let mut machine_axis = PerChannel([0; MAX_AXES]);
        for (place, axis) in machine_axis.iter_mut().zip(description.shown_axes()) {
            *place = place_in(model, &description, axis)?;
        }
        let fixed = fixed_positions(&description, model, settings)?;
        let axes = names(&description);
        let mut steps = PerAxis::ZERO;
        for (place, axis) in machine_axis.iter().zip(&description.axes) {
            steps[*place] = axis.step();
        }
        let rotary_step = guard.rotary_step.to_mm();
        let correctors = model.correctors_of(&description, rotary_step);
        let uncorrected = uncorrected(model, &axes, &correctors, &steps);
        if correctors.linear().is_empty() && correctors.rotary().is_empty() {
            return Err(PlanError::NothingToCorrect {
                device: device(),
                uncorrected: !uncorrected.is_empty(),
                axes,
                machine: model.name.clone(),
            });
        }
        let mut notes = Reasons::CANNOT_SEE_OTHERS.when(!description.sees_other_gateways);
        match (description.heartbeat, settings.unwatched) {
            (Heartbeat::Unwatched, false) => return Err(PlanError::Unwatched { device: device() }),
            // The configuration takes precedence over the heartbeat counter that the driver found.
            (_, true) => notes |= Reasons::UNWATCHED,
            (Heartbeat::Watched, false) => {}
        }
        if description.shortest_cycle > period {
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            return Err(PlanError::CycleTooShort {
                device: device(),
                found_ms: ms(period),
                shortest_ms: ms(description.shortest_cycle),
            });
        }
        if settings.only_thermal && model.sensors().is_empty() {
            return Err(PlanError::NoThermalTerms {
                device: device(),
                machine: model.name.clone(),
            });
        }
        let barrier = barrier(&description, settings)?;
        notes |= Reasons::NO_BARRIER.when(barrier.is_none());
        let position_steps = position_steps(&description, settings)?;
        let limits = limits(
            &description,
            &position_steps,
            &machine_axis,
            &correctors,
            guard,
            settings,
            period,
        )?;
        Ok(Self {
            reversal: reversals(&description, &position_steps, Some(&limits)),
            position_steps,
            rotary_step,
            uncorrected,
            barrier,
            only_thermal: settings.only_thermal,
            no_read_back: barrier.is_none() && !description.tells_applied,
            watch: settings.watch,
            time_out: settings.time_out,
            limits,
            machine_axis,
            fixed,
            notes,
            description,
            correctors,
        })
    }

    /// Checks that the paths to one machine are interchangeable: they use the same channel, and none leaves a correction on an axis that
    /// another does not write, unless its control ramps to zero on its own.
    ///
    /// # Errors
    /// The first conflicting pair.
    pub fn check_together(plans: &[Self]) -> Result<(), PlanError> {
        check_together(|| {
            let plans = plans.iter();
            plans.map(|plan| (&plan.description, plan.goes_to_zero()))
        })
    }

    pub(crate) fn goes_to_zero(&self) -> bool {
        self.barrier.is_some() || self.no_read_back && self.time_out.is_some()
    }

    /// Whether the axis at this channel index corrects. Zero is written to the other axes.
    pub fn corrects(&self, place: usize) -> bool {
        place < self.description.axes.len() && self.correctors.contains(self.machine_axis[place])
    }
}

/// Implements [`PathPlan::check_together`] for pairs of a path and whether its control ramps to zero on its own.
pub(crate) fn check_together<'a, I>(paths: impl Fn() -> I) -> Result<(), PlanError>
where
    I: Iterator<Item = (&'a Description, bool)>,
{
    for (path, goes_to_zero) in paths() {
        for (other, _) in paths() {
            if path.channel != other.channel {
                return Err(PlanError::Channels {
                    device: other.device.clone(),
                    found: other.channel.clone(),
                    expected: path.channel.clone(),
                });
            }
            if let Some(axis) = left_to(path, other).filter(|_| !goes_to_zero) {
                return Err(PlanError::LeavesAxis {
                    device: path.device.clone(),
                    axis,
                    other: other.device.clone(),
                });
            }
        }
    }
    Ok(())
}

/// The first axis that `path` writes and `other` does not; `None` if there is none.
pub(crate) fn left_to(path: &Description, other: &Description) -> Option<AxisName> {
    let mut axes = path.axes.iter().map(|axis| axis.name);
    axes.find(|name| other.axes.iter().all(|axis| axis.name != *name))
}

pub(crate) fn place_in(
    model: &Model,
    description: &Description,
    axis: AxisName,
) -> Result<usize, PlanError> {
    model.index_of(axis).ok_or_else(|| PlanError::NoSuchAxis {
        device: description.device.clone(),
        axis,
        machine: model.name.clone(),
        axes: model.axes.clone(),
    })
}

pub(crate) fn names(description: &Description) -> Vec<AxisName> {
    description.axes.iter().map(|axis| axis.name).collect()
}

fn uncorrected(
    model: &Model,
    written: &[AxisName],
    correctors: &Correctors,
    steps: &PerAxis<f64>,
) -> Vec<UncorrectedAxis> {
    let may = model.correctors_among(written);
    let lacks = may.rotary().iter().filter(|axis| !correctors.contains(**axis));
    let why = |axis: usize| {
        if correctors.linear().len() < 3 {
            UncorrectedReason::Uncatchable
        } else {
            UncorrectedReason::Coarse(model.rotary_step_error(axis, Rad(steps[axis])))
        }
    };
    let uncorrected = |&axis: &usize| UncorrectedAxis { axis: model.axes[axis], why: why(axis) };
    lacks.map(uncorrected).collect()
}

/// Correction steps in machine order, mm and rad; 0 for axes that are not written.
pub(crate) fn steps_in_machine(limits: &Limits, machine_axis: &PerChannel<usize>) -> PerAxis<f64> {
    let mut steps = PerAxis::ZERO;
    let axes = limits.axes.iter().zip(machine_axis).take(limits.count);
    for (axis, place) in axes {
        steps[*place] = axis.resolution;
    }
    steps
}

/// The configured fixed positions of machine axes, mm and rad.
fn fixed_positions(
    description: &Description,
    model: &Model,
    settings: &PathSettings,
) -> Result<PerAxis<Option<f64>>, PlanError> {
    let device = || description.device.clone();
    let mut fixed = PerAxis([None; MAX_AXES]);
    for axis in &settings.not_driven {
        if !axis.is_rotary() || !settings.fixed.contains_key(axis) {
            return Err(PlanError::NotDriven { device: device(), axis: *axis });
        }
    }
    for (name, at) in &settings.fixed {
        let index = model.index_of(*name).ok_or_else(|| PlanError::NoSuchFixedAxis {
            device: device(),
            axis: *name,
            machine: model.name.clone(),
            axes: model.axes.clone(),
        })?;
        if at.kind() != name.kind() || !at.mm_or_rad().is_finite() {
            return Err(PlanError::FixedPosition { device: device(), axis: *name });
        }
        if description.shows(*name) {
            return Err(PlanError::FixedIsShown { device: device(), axis: *name });
        }
        if name.is_rotary() && !settings.not_driven.contains(name) {
            return Err(PlanError::FixedRotary { device: device(), axis: *name });
        }
        if !model.is_within_travel(index, *at) {
            return Err(PlanError::FixedBeyond {
                device: device(),
                axis: *name,
                found: *at,
                travel: model.travel[index],
            });
        }
        fixed[index] = Some(at.mm_or_rad());
    }
    Ok(fixed)
}

/// Barrier of a control, on whose existence driver and settings must agree; `None` without one.
fn barrier(
    description: &Description,
    settings: &PathSettings,
) -> Result<Option<BarrierSettings>, PlanError> {
    match (description.barrier, settings.barrier) {
        (true, Some(barrier)) if !barrier.scan.is_zero() => Ok(Some(barrier)),
        (false, None) => Ok(None),
        (has, _) => Err(PlanError::Barrier { device: description.device.clone(), has }),
    }
}

/// Limits of a non-correcting axis without configured ones: a remaining correction returns to zero slowly.
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

/// Limits that the guard of a controller enforces, mm and rad: the configured limits, but without a barrier at most
/// [`without_barrier`](GuardSettings::without_barrier). An axis that does not correct needs no configured limits and
/// has no test shift; its limit is lowered to what the device can carry.
///
/// Errors: a correcting rotary axis without limits, a correcting axis whose limit exceeds what the device can carry, limits that a guard rejects.
fn limits(
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
            // The axis may correct with another model, so the bounds of the device and of a path
            // without a barrier apply as well.
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
                // The limit is less than one step: only zero may be written.
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
        axis: source.axis.and_then(|(place, _)| axis_of(description, place)),
        source,
    })?;
    Ok(limits)
}

/// Resolution of the position of each reported axis, mm or rad; 0 if none is configured.
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

/// Travel after which the direction of each reported axis counts as reversed, mm or rad. `limits` is `None` for a read-only controller: it writes no
/// correction that could be mistaken for travel.
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
        let axis = written(place).unwrap_or(AxisLimits { kind: name.kind(), ..AxisLimits::NONE });
        *into = reversal_threshold(&axis, *step, delay);
    }
    reversal
}

fn without_barrier(limits: &mut AxisLimits, guard: &GuardSettings) {
    let most = match limits.kind {
        AxisKind::Linear => guard.without_barrier.linear.to_mm().0,
        AxisKind::Rotary => guard.without_barrier.rotary.to_rad().0,
    };
    lower_to(limits, most);
}

/// Lowers a limit, and the warning threshold with it, to `most` (mm or rad).
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
    // A correction clipped to the largest writable one must be reported. Limits below one step, and warnings above the limit, are left to
    // the check, which rejects them.
    let reachable = limits.reachable();
    if reachable > 0.0 && limits.warn <= limits.limit {
        limits.warn = limits.warn.min(reachable);
    }
    limits
}
