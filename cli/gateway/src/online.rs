//! What the barrier of a control told when it was asked, held against the configuration by the guard's own rule.

use std::time::{Duration, Instant};

use volcomp_guard::{
    BarrierMisfit, Limits, barrier::Report, barrier_misfits, protocol::Layout, scans_fit,
};
use volcomp_port::{DeviceError, Words};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    config::BarrierConfig,
    documents::{AxisPlan, OnlineBarrier, OnlineBarrierAxis, round},
};

/// The barrier of a control as its reports tell it, checked against the configuration of the controller.
///
/// # Errors
/// It tells no report for this machine and these axes, or settings that the guard would not arm with.
pub(crate) fn barrier(
    device: &str,
    config: &BarrierConfig,
    axes: &[AxisName],
    limits: &Limits,
    reports: &[(Instant, Words)],
) -> Result<OnlineBarrier, DeviceError> {
    // Axes that make no barrier were refused with the configuration.
    let layout = Layout::of(axes.iter().copied()).ok();
    let decoded = layout.map(|layout| {
        let decode = |(at, words): &(Instant, Words)| {
            Some((
                *at,
                Report::decode(config.machine, layout, words.as_slice())?,
            ))
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
    wrong.extend(misfits.map(|misfit| words_of(misfit, axes, limits)));
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

/// No report of a barrier, or one for another machine or other axes.
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

/// A misfit by the keys of the configuration.
fn words_of(misfit: BarrierMisfit, axes: &[AxisName], limits: &Limits) -> String {
    let micro = |axis: usize, value: f64| {
        round(Displacement::new(limits.axes[axis].kind, value).um_or_urad())
    };
    let units = |axis: usize| {
        if axes[axis].is_rotary() {
            ("urad", "µrad")
        } else {
            ("um", "µm")
        }
    };
    match misfit {
        BarrierMisfit::Limit {
            axis,
            found,
            expected,
        } => {
            let (key, unit) = units(axis);
            format!(
                "axis {}: guard.limit_{key} asks for {} {unit}, and the barrier lets {} {unit} through",
                axes[axis],
                micro(axis, expected),
                micro(axis, found)
            )
        }
        BarrierMisfit::Rate {
            axis,
            found,
            expected,
        } => {
            let (key, unit) = units(axis);
            format!(
                "axis {}: guard.slew_{key}_per_s asks for a barrier of at least {} {unit}/s, twice the slew, and its rate is {} {unit}/s",
                axes[axis],
                micro(axis, expected),
                micro(axis, found)
            )
        }
        BarrierMisfit::TimeOut { found, expected } => format!(
            "guard.zero_after_ms: found {} ms, and the barrier lets go after {} ms",
            ms(expected),
            ms(found)
        ),
    }
}

fn ms(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}
