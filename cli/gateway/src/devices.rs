//! Derives the settings of the guard and the plan documents from the configured devices. Compares
//! the settings reported by a control with the configuration, by the rules of the guard.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use volcomp_devices::{ControllerDevice, GuardRequirements, config::of_ms};
use volcomp_guard::{
    AxisLimits, BarrierMisfit, Limits, RATE_OVER_SLEW, barrier::Report, barrier_misfits,
    protocol::Layout, scans_fit,
};
use volcomp_port::{DeviceError, Words};
use volcomp_runtime::{BarrierSettings, PathSettings};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::{
    config::{BarrierConfig, ControllerConfig},
    documents::{AxisPlan, OnlineBarrier, OnlineBarrierAxis, OnlinePlan, round},
};

/// Settings of a controller's path that the driver does not determine, for cycles of length `period`.
pub(crate) fn settings(
    device: &dyn ControllerDevice,
    config: &ControllerConfig,
    period: Duration,
) -> PathSettings {
    let driver = device.settings();
    let behind = driver.shown_within;
    let behind = behind.map_or(period, |within| within.min(longest_read_back(period)));
    // The control processes a frame in its next scan and shows it in the report of the scan after that.
    let behind = config.barrier.map_or(behind, |barrier| behind.max(2 * (barrier.scan() + period)));
    let cycles = behind.as_nanos().div_ceil(period.as_nanos().max(1));
    PathSettings {
        fixed: config
            .fixed
            .iter()
            .map(|(name, at)| (*name, Displacement::from_coordinate(name.kind(), *at)))
            .collect(),
        not_driven: config.not_driven.iter().copied().collect(),
        unwatched: config.unwatched,
        only_thermal: config.terms.is_some(),
        hold: config.hold_ms.map(of_ms),
        proves: config.test_shift.unwrap_or(!driver.is_coarse),
        position_steps: driver.position_steps,
        read_back_cycles: usize::try_from(cycles).unwrap_or(usize::MAX).max(1),
        barrier: config
            .barrier
            .map(|barrier| BarrierSettings { machine: barrier.machine, scan: barrier.scan() }),
        ..PathSettings::default()
    }
}

fn longest_read_back(period: Duration) -> Duration {
    let cycles = u32::try_from(volcomp_runtime::guard::MOST_READ_BACK_CYCLES).unwrap_or(u32::MAX);
    period.saturating_mul(cycles)
}

/// Limits that a control must report so that the guard arms.
pub(crate) fn needs(limits: &Limits) -> GuardRequirements {
    let axes = || limits.axes.iter().take(limits.count);
    let largest = |value: fn(&AxisLimits) -> f64| {
        [AxisKind::Linear, AxisKind::Rotary].map(|kind| {
            let values = axes().filter(|axis| axis.kind == kind).map(value);
            values.fold(0.0, f64::max)
        })
    };
    GuardRequirements {
        slew_per_min: axes().map(|axis| round(axis.slew_per_s * 60.0)).collect(),
        limit: largest(AxisLimits::reachable),
        rate_per_s: largest(|axis| RATE_OVER_SLEW * axis.slew_per_s),
        zero_after: limits.zero_after,
    }
}

/// Reads the settings that a control reports, and compares them with the configuration and the guard's limits (`None`:
/// the control is only read). Returns `None` if the control's bus reports no settings. Writes nothing.
///
/// # Errors
/// The control cannot be reached, or contradicts the configuration.
pub(crate) fn online(
    device: &dyn ControllerDevice,
    own: &ControllerConfig,
    limits: Option<&Limits>,
) -> Result<Option<OnlinePlan>, DeviceError> {
    let Some(mut control) = device.inspect(limits.map(needs).as_ref())? else {
        return Ok(None);
    };
    let barrier = own.barrier.as_ref().zip(limits).map(|(barrier, limits)| {
        let name = device.describe()?.device;
        self::barrier(&name, barrier, &own.axes, limits, &control.reports)
    });
    let barrier = barrier.transpose()?;
    let fastest = control.fastest_per_min.iter_mut();
    for per_min in fastest.flat_map(BTreeMap::values_mut) {
        *per_min = round(*per_min);
    }
    Ok(Some(OnlinePlan {
        url: own.url.clone(),
        barrier,
        notes: std::mem::take(&mut control.notes),
        control,
    }))
}

/// Reads the barrier reports of a control and checks them against the configuration of the controller.
///
/// # Errors
/// There is no report for this machine and these axes, or the guard would not arm with the reported settings.
fn barrier(
    device: &str,
    config: &BarrierConfig,
    axes: &[AxisName],
    limits: &Limits,
    reports: &[(Instant, Words)],
) -> Result<OnlineBarrier, DeviceError> {
    // Validation of the configuration has already rejected invalid axes.
    let layout = Layout::of(axes.iter().copied()).ok();
    let decoded = layout.map(|layout| {
        let decode = |(at, words): &(Instant, Words)| {
            Some((*at, Report::decode(config.machine, layout, words.as_slice())?))
        };
        reports.iter().filter_map(decode).collect::<Vec<_>>()
    });
    let decoded = decoded.unwrap_or_default();
    let Some((_, last)) = decoded.last() else {
        return Err(strange(device, config.machine, axes, layout));
    };
    let scan = config.scan();
    let counted = match &decoded[..] {
        [(first_at, first), (last_at, last)] => Some((
            u32::from(last.tick.wrapping_sub(first.tick)),
            last_at.saturating_duration_since(*first_at),
        )),
        _ => None,
    };
    let mut wrong = Vec::new();
    if let Some((scans, passed)) = counted
        && !scans_fit(scans, passed, scan)
    {
        wrong.push(format!(
            "barrier.scan_ms: found {} ms, and the control counted {scans} scans in {} ms",
            ms(scan),
            ms(passed)
        ));
    }
    let misfits = barrier_misfits(&last.settings, scan, limits);
    wrong.extend(misfits.map(|misfit| words_of(misfit, axes)));
    if !wrong.is_empty() {
        return Err(DeviceError::protocol(
            device,
            wrong.join("; "),
            "set the barrier in the control, or the configuration, so that they fit: it would not arm",
        ));
    }
    let settings = &last.settings;
    let step_s = (scan * u32::from(settings.step_scans)).as_secs_f64();
    let micro = |axis: usize, counts: i16| {
        let of_axis = &limits.axes[axis];
        Displacement::new(of_axis.kind, f64::from(counts) * of_axis.resolution).um_or_urad()
    };
    Ok(OnlineBarrier {
        machine: settings.machine,
        layout: settings.axes.number(),
        owner: last.owner,
        scan_ms: counted
            .filter(|(scans, _)| *scans > 0)
            .map(|(scans, passed)| round(passed.as_secs_f64() * 1e3 / f64::from(scans))),
        hold_ms: ms(scan * u32::from(settings.hold_scans)),
        time_out_ms: ms(scan * u32::from(settings.time_out_scans)),
        axes: (axes.iter().enumerate())
            .map(|(index, name)| OnlineBarrierAxis {
                name: *name,
                unit: AxisPlan::unit_of(name.kind()).to_owned(),
                limit: round(micro(index, settings.limit[index])),
                rate_per_s: round(micro(index, settings.rate[index]) / step_s),
            })
            .collect(),
    })
}

fn strange(device: &str, machine: u16, axes: &[AxisName], layout: Option<Layout>) -> DeviceError {
    let letters: String = axes.iter().map(|name| name.letter()).collect();
    let number = layout.map_or(0, Layout::number);
    DeviceError::protocol(
        device,
        "barrier.report: found no report of a barrier for this machine and these axes",
        format!(
            "expected one of the machine {machine} and the axes {letters} in this order: set `machine` of the barrier to {machine} and `layout` to {number}, or state `machine` and `axes` as the barrier has them"
        ),
    )
}

/// Describes a mismatch in terms of the configuration keys.
pub(crate) fn words_of(misfit: BarrierMisfit, axes: &[AxisName]) -> String {
    let micro =
        |axis: usize, value: f64| round(Displacement::new(axes[axis].kind(), value).um_or_urad());
    let units = |axis: usize| {
        if axes[axis].is_rotary() { ("urad", "µrad") } else { ("um", "µm") }
    };
    match misfit {
        BarrierMisfit::Limit { axis, found, expected } => {
            let (key, unit) = units(axis);
            format!(
                "axis {}: guard.limit_{key} is {} {unit}, and the barrier permits {} {unit}",
                axes[axis],
                micro(axis, expected),
                micro(axis, found)
            )
        }
        BarrierMisfit::Rate { axis, found, expected } => {
            let (key, unit) = units(axis);
            format!(
                "axis {}: guard.slew_{key}_per_s needs a barrier rate of at least {} {unit}/s, twice the slew, and it is {} {unit}/s",
                axes[axis],
                micro(axis, expected),
                micro(axis, found)
            )
        }
        BarrierMisfit::TimeOut { found, expected } => format!(
            "guard.zero_after_ms: found {} ms, and the barrier releases the correction after {} ms",
            ms(expected),
            ms(found)
        ),
        BarrierMisfit::ScanPeriod { found, expected } => format!(
            "barrier.scan_ms: found {} ms, and the control's scans take {} ms",
            ms(expected),
            ms(found)
        ),
    }
}

fn ms(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}
