//! The table `[guard]`: what is allowed to every controller.

use std::time::Duration;

use volcomp_document::{InputError, Section};
use volcomp_model::Fading;
use volcomp_runtime::{
    AxisSettings, GuardSettings, Rapid, WithoutBarrier,
    guard::{SensorLimits, ceiling},
};
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
        "limit_without_barrier_um",
        "limit_without_barrier_urad",
        "rotary_step_um",
        "hold_ms",
        "zero_after_ms",
        "ramp_s",
        "stop_s",
        "hand_back_s",
        "rapid_m_per_min",
        "rapid_rpm",
        "max_degc_per_min",
        "range_degc",
        "temperature_stale_s",
        "temperature_hold_s",
        "temperature_fade_s",
        "temperature_stuck_s",
        "temperature_neighbours_k",
    ])?;
    let hold_ms = section
        .require("hold_ms")?
        .number_in(cycle_ms..=ceiling::HOLD.as_secs_f64() * 1e3)?;
    let zero_after_ms = section
        .require("zero_after_ms")?
        .number_in(hold_ms..=600_000.0)?;
    let linear = axis_settings(section, &LINEAR)?.map(Um);
    let default = GuardSettings::new(linear);
    let seconds = |key: &str, range, default: Duration| {
        section
            .number_or(key, range, default.as_secs_f64())
            .map(Duration::from_secs_f64)
    };
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
        None => default.temperatures.range_degc,
    };
    let believed = default.temperatures;
    let stuck_s = section.number_or(
        "temperature_stuck_s",
        0.0..=1e7,
        believed
            .stuck_after
            .map_or(0.0, |after| after.as_secs_f64()),
    )?;
    let number = |key: &str, range, default| section.number_or(key, range, default);
    Ok(GuardSettings {
        linear,
        rotary: rotary(section)?,
        without_barrier: without_barrier(section, default.without_barrier)?,
        rotary_step: Um(section.number_or(
            "rotary_step_um",
            1e-3..=1000.0,
            default.rotary_step.0,
        )?),
        hold: Duration::from_secs_f64(hold_ms * 1e-3),
        zero_after: Duration::from_secs_f64(zero_after_ms * 1e-3),
        ramp: seconds("ramp_s", 0.0..=600.0, default.ramp)?,
        stop: seconds("stop_s", 0.0..=600.0, default.stop)?,
        hand_back: seconds("hand_back_s", 0.0..=3600.0, default.hand_back)?,
        rapid: rapid(section, default.rapid)?,
        temperatures: SensorLimits {
            max_degc_per_min: number(
                "max_degc_per_min",
                0.01..=1000.0,
                default.temperatures.max_degc_per_min,
            )?,
            range_degc,
            stale: seconds("temperature_stale_s", 0.1..=3600.0, believed.stale)?,
            stuck_after: (stuck_s > 0.0).then(|| Duration::from_secs_f64(stuck_s)),
            neighbours_k: section
                .get("temperature_neighbours_k")
                .map(|value| value.number_in(0.1..=1000.0))
                .transpose()?,
        },
        fading: Fading {
            hold_s: number("temperature_hold_s", 0.0..=1e6, default.fading.hold_s)?,
            fade_s: number("temperature_fade_s", 1.0..=1e6, default.fading.fade_s)?,
        },
    })
}

/// How fast axes move at the most.
fn rapid(section: &Section<'_>, default: Rapid) -> Result<Rapid, InputError> {
    let (linear, rotary) = (default.linear_m_per_min, default.rotary_rpm);
    Ok(Rapid {
        linear_m_per_min: section.number_or("rapid_m_per_min", 0.1..=1e4, linear)?,
        rotary_rpm: section.number_or("rapid_rpm", 0.1..=1e5, rotary)?,
    })
}

/// The largest corrections on a path without a barrier.
fn without_barrier(
    section: &Section<'_>,
    default: WithoutBarrier,
) -> Result<WithoutBarrier, InputError> {
    let linear = ("limit_without_barrier_um", 1e-3..=LINEAR.most);
    let rotary = ("limit_without_barrier_urad", 1e-3..=ROTARY.most);
    Ok(WithoutBarrier {
        linear: Um(section.number_or(linear.0, linear.1, default.linear.0)?),
        rotary: Urad(section.number_or(rotary.0, rotary.1, default.rotary.0)?),
    })
}

/// The settings of rotary axes; `None` without `limit_urad`, and then no other key of them makes sense.
fn rotary(section: &Section<'_>) -> Result<Option<AxisSettings<Urad>>, InputError> {
    if section.get("limit_urad").is_some() {
        return Ok(Some(axis_settings(section, &ROTARY)?.map(Urad)));
    }
    for name in AXIS_KEYS {
        if let Some(value) = section.get(&ROTARY.key(name)) {
            return Err(value.error(
                "found this key without limit_urad, expected both or neither: without limit_urad no rotary axis is corrected",
            ));
        }
    }
    Ok(None)
}

/// The keys that each kind of axis has, without their units.
const AXIS_KEYS: [&str; 6] = [
    "limit",
    "warn",
    "slew_per_s",
    "accel_per_s2",
    "confirm",
    "test_shift",
];

/// The keys of one kind of axis: their unit, µm or µrad, and the largest values that are taken.
struct OfKind {
    unit: &'static str,
    most: f64,
    fastest_per_s: f64,
    test_shift: f64,
}

const LINEAR: OfKind = OfKind {
    unit: "um",
    most: ceiling::LIMIT.0 * 1e3,
    fastest_per_s: ceiling::SLEW_PER_S.0 * 1e3,
    test_shift: AxisSettings::<Um>::TEST_SHIFT.0,
};
const ROTARY: OfKind = OfKind {
    unit: "urad",
    most: ceiling::LIMIT_ROTARY.0 * 1e6,
    fastest_per_s: ceiling::SLEW_PER_S_ROTARY.0 * 1e6,
    test_shift: AxisSettings::<Urad>::TEST_SHIFT.0,
};

impl OfKind {
    /// The key of a name such as `slew_per_s`: `slew_um_per_s`.
    fn key(&self, name: &str) -> String {
        let unit = self.unit;
        match name.split_once("_per") {
            Some((name, per)) => format!("{name}_{unit}_per{per}"),
            None => format!("{name}_{unit}"),
        }
    }
}

/// The settings of one kind of axis. A test shift that is not stated is the default, or the limit if that is smaller.
fn axis_settings(section: &Section<'_>, of: &OfKind) -> Result<AxisSettings<f64>, InputError> {
    let [limit, warn, slew_per_s, accel_per_s2, confirm, test_shift] =
        AXIS_KEYS.map(|name| of.key(name));
    let limit = section.require(&limit)?.number_in(1e-3..=of.most)?;
    Ok(AxisSettings {
        limit,
        warn: section.number_or(&warn, 0.0..=limit, limit)?,
        slew_per_s: section
            .require(&slew_per_s)?
            .number_in(1e-3..=of.fastest_per_s)?,
        accel_per_s2: section.number_or(&accel_per_s2, 1e-3..=1e12, f64::INFINITY)?,
        confirm: section.number_or(&confirm, 0.0..=1e6, limit)?,
        test_shift: section.number_or(&test_shift, 0.0..=limit, of.test_shift.min(limit))?,
    })
}
