//! The table `[guard]`: what is allowed to every controller.

use std::time::Duration;

use volcomp_document::{InputError, Section};
use volcomp_model::Fading;
use volcomp_runtime::{AxisSettings, GuardSettings, guard::SensorLimits};
use volcomp_vocabulary::{Um, Urad};

pub(super) fn guard(section: &Section<'_>, cycle_ms: f64) -> Result<GuardSettings, InputError> {
    section.allow(&[
        "limit_um",
        "warn_um",
        "slew_um_per_s",
        "accel_um_per_s2",
        "confirm_um",
        "test_shift_um",
        "limit_urad",
        "warn_urad",
        "slew_urad_per_s",
        "accel_urad_per_s2",
        "confirm_urad",
        "test_shift_urad",
        "hold_ms",
        "zero_after_ms",
        "ramp_s",
        "stop_s",
        "hand_back_s",
        "max_degc_per_min",
        "range_degc",
        "temperature_stale_s",
        "temperature_hold_s",
        "temperature_fade_s",
        "temperature_stuck_s",
        "temperature_neighbours_k",
    ])?;
    let hold_ms = section.require("hold_ms")?.number_in(cycle_ms..=60_000.0)?;
    let zero_after_ms = section
        .require("zero_after_ms")?
        .number_in(hold_ms..=600_000.0)?;
    let seconds = |key: &str, range, default| {
        section
            .number_or(key, range, default)
            .map(Duration::from_secs_f64)
    };
    let believed = SensorLimits::default();
    let range_degc = match section.get("range_degc") {
        Some(value) => {
            let [low, high] = value.vector::<2>()?;
            if low >= high {
                return Err(value.error(format!(
                    "found {low} to {high}, expected the lower temperature first"
                )));
            }
            [low, high]
        }
        None => believed.range_degc,
    };
    let stuck_s = section.number_or(
        "temperature_stuck_s",
        0.0..=1e7,
        believed
            .stuck_after
            .map_or(0.0, |after| after.as_secs_f64()),
    )?;
    let fading = Fading::default();
    let rotary = section.get("limit_urad").is_some();
    Ok(GuardSettings {
        linear: axis_settings(section, "um", 5.0)?.map(Um),
        rotary: rotary
            .then(|| axis_settings(section, "urad", 20.0))
            .transpose()?
            .map(|settings| settings.map(Urad)),
        hold: Duration::from_secs_f64(hold_ms * 1e-3),
        zero_after: Duration::from_secs_f64(zero_after_ms * 1e-3),
        ramp: seconds("ramp_s", 0.0..=600.0, 0.5)?,
        stop: seconds("stop_s", 0.0..=600.0, 5.0)?,
        hand_back: seconds("hand_back_s", 0.0..=3600.0, 2.0)?,
        temperatures: SensorLimits {
            max_degc_per_min: section.number_or(
                "max_degc_per_min",
                0.01..=1000.0,
                believed.max_degc_per_min,
            )?,
            range_degc,
            stale: seconds(
                "temperature_stale_s",
                0.1..=3600.0,
                believed.stale.as_secs_f64(),
            )?,
            stuck_after: (stuck_s > 0.0).then(|| Duration::from_secs_f64(stuck_s)),
            neighbours_k: section
                .get("temperature_neighbours_k")
                .map(|value| value.number_in(0.1..=1000.0))
                .transpose()?,
        },
        fading: Fading {
            hold_s: section.number_or("temperature_hold_s", 0.0..=1e6, fading.hold_s)?,
            fade_s: section.number_or("temperature_fade_s", 1.0..=1e6, fading.fade_s)?,
        },
    })
}

/// The keys of one kind of axis, which end in `unit`. A test shift that is not stated is `test_shift`, or the limit if
/// that is smaller.
fn axis_settings(
    section: &Section<'_>,
    unit: &str,
    test_shift: f64,
) -> Result<AxisSettings<f64>, InputError> {
    let key = |name: &str| match name.split_once("_per") {
        Some((name, per)) => format!("{name}_{unit}_per{per}"),
        None => format!("{name}_{unit}"),
    };
    let limit = section.require(&key("limit"))?.number_in(1e-3..=10_000.0)?;
    Ok(AxisSettings {
        limit,
        warn: section.number_or(&key("warn"), 0.0..=limit, limit)?,
        slew_per_s: section.require(&key("slew_per_s"))?.number_in(1e-3..=1e7)?,
        accel_per_s2: section.number_or(&key("accel_per_s2"), 1e-3..=1e12, f64::INFINITY)?,
        confirm: section.number_or(&key("confirm"), 0.0..=1e6, limit)?,
        test_shift: section.number_or(&key("test_shift"), 0.0..=limit, test_shift.min(limit))?,
    })
}
