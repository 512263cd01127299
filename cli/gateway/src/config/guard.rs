use serde::{Deserialize, Serialize};
use volcomp_devices::Setting;
use volcomp_document::Mistakes;
use volcomp_model::Fading;
use volcomp_runtime::{
    AxisSettings, GuardSettings, Rapid, WithoutBarrier,
    guard::{SensorLimits, ceiling},
};
use volcomp_vocabulary::{Um, Urad};

use volcomp_devices::config::{ms, of_ms};

/// Limit with which a machine is set to work, µm.
const FIRST_LIMIT_UM: f64 = 20.0;

/// The table `[guard]`: limits, rates and times of the correction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardTable {
    pub limit_um: f64,
    pub warn_um: Option<f64>,
    pub slew_um_per_s: f64,
    pub accel_um_per_s2: Option<f64>,
    pub confirm_um: Option<f64>,
    pub test_shift_um: Option<f64>,
    pub limit_urad: Option<f64>,
    pub warn_urad: Option<f64>,
    pub slew_urad_per_s: Option<f64>,
    pub accel_urad_per_s2: Option<f64>,
    pub confirm_urad: Option<f64>,
    pub test_shift_urad: Option<f64>,
    pub limit_without_barrier_um: f64,
    pub limit_without_barrier_urad: f64,
    pub rotary_step_um: f64,
    pub hold_ms: f64,
    pub zero_after_ms: f64,
    pub ramp_s: f64,
    pub stop_s: f64,
    pub hand_back_s: f64,
    pub rapid_m_per_min: f64,
    pub rapid_rpm: f64,
    pub max_degc_per_min: f64,
    pub range_degc: [f64; 2],
    pub temperature_stale_s: f64,
    pub temperature_hold_s: f64,
    pub temperature_fade_s: f64,
    pub temperature_stuck_s: f64,
    pub temperature_neighbours_k: Option<f64>,
}

impl Default for GuardTable {
    fn default() -> Self {
        let guard = GuardSettings::new(AxisSettings::new(Um(0.0), Um(0.0)));
        let temperatures = guard.temperatures;
        let stuck_after = temperatures.stuck_after.unwrap_or_default();
        Self {
            limit_um: 0.0,
            warn_um: None,
            slew_um_per_s: 0.0,
            accel_um_per_s2: None,
            confirm_um: None,
            test_shift_um: None,
            limit_urad: None,
            warn_urad: None,
            slew_urad_per_s: None,
            accel_urad_per_s2: None,
            confirm_urad: None,
            test_shift_urad: None,
            limit_without_barrier_um: guard.without_barrier.linear.0,
            limit_without_barrier_urad: guard.without_barrier.rotary.0,
            rotary_step_um: guard.rotary_step.0,
            hold_ms: ms(guard.hold),
            zero_after_ms: ms(guard.zero_after),
            ramp_s: guard.ramp.as_secs_f64(),
            stop_s: guard.stop.as_secs_f64(),
            hand_back_s: guard.hand_back.as_secs_f64(),
            rapid_m_per_min: guard.rapid.linear_m_per_min,
            rapid_rpm: guard.rapid.rotary_rpm,
            max_degc_per_min: temperatures.max_degc_per_min,
            range_degc: temperatures.range_degc,
            temperature_stale_s: temperatures.stale.as_secs_f64(),
            temperature_hold_s: guard.fading.hold_s,
            temperature_fade_s: guard.fading.fade_s,
            temperature_stuck_s: stuck_after.as_secs_f64(),
            temperature_neighbours_k: temperatures.neighbours_k,
        }
    }
}

/// The settings of the axes of one kind. The default of `accel` is unlimited; `warn` and `confirm` default to `limit`;
/// `test_shift` defaults to `default_shift`, but at most `limit`.
fn axes(
    limit: f64,
    slew_per_s: f64,
    [warn, accel, confirm, test_shift]: [Option<f64>; 4],
    default_shift: f64,
) -> AxisSettings<f64> {
    AxisSettings {
        limit,
        warn: warn.unwrap_or(limit),
        slew_per_s,
        accel_per_s2: accel.unwrap_or(f64::INFINITY),
        confirm: confirm.unwrap_or(limit),
        test_shift: test_shift.unwrap_or(default_shift.min(limit)),
    }
}

impl GuardTable {
    /// Converts the keys to typed units, with defaults for missing ones.
    pub fn settings(&self) -> GuardSettings {
        let linear = axes(
            self.limit_um,
            self.slew_um_per_s,
            [self.warn_um, self.accel_um_per_s2, self.confirm_um, self.test_shift_um],
            AxisSettings::<Um>::TEST_SHIFT.0,
        );
        let rotary = self.limit_urad.zip(self.slew_urad_per_s);
        let rotary = rotary.map(|(limit, slew)| {
            let more =
                [self.warn_urad, self.accel_urad_per_s2, self.confirm_urad, self.test_shift_urad];
            axes(limit, slew, more, AxisSettings::<Urad>::TEST_SHIFT.0).map(Urad)
        });
        let seconds = |s: f64| of_ms(s * 1e3);
        GuardSettings {
            linear: linear.map(Um),
            rotary,
            without_barrier: WithoutBarrier {
                linear: Um(self.limit_without_barrier_um),
                rotary: Urad(self.limit_without_barrier_urad),
            },
            rotary_step: Um(self.rotary_step_um),
            hold: of_ms(self.hold_ms),
            zero_after: of_ms(self.zero_after_ms),
            ramp: seconds(self.ramp_s),
            stop: seconds(self.stop_s),
            hand_back: seconds(self.hand_back_s),
            rapid: Rapid { linear_m_per_min: self.rapid_m_per_min, rotary_rpm: self.rapid_rpm },
            temperatures: SensorLimits {
                max_degc_per_min: self.max_degc_per_min,
                range_degc: self.range_degc,
                stale: seconds(self.temperature_stale_s),
                stuck_after: (self.temperature_stuck_s > 0.0)
                    .then(|| seconds(self.temperature_stuck_s)),
                neighbours_k: self.temperature_neighbours_k,
            },
            fading: Fading { hold_s: self.temperature_hold_s, fade_s: self.temperature_fade_s },
        }
    }

    /// The keys of `[guard]` that `init` writes, with their values and comments.
    pub(crate) fn first(cycle_ms: f64, is_rotary: bool) -> Vec<Setting> {
        let mut settings = vec![
            Setting::number(
                "limit_um",
                FIRST_LIMIT_UM,
                "Largest correction of a linear axis, µm: 0.001 to 2000; begin with a small one",
            ),
            Setting::number(
                "slew_um_per_s",
                500.0,
                "Largest rate of this correction, µm/s: 0.001 to 5000",
            ),
            Setting::number(
                "accel_um_per_s2",
                20000.0,
                "Largest acceleration of this correction, µm/s²: 0.001 to 1e12",
            ),
            Setting::number(
                "confirm_um",
                FIRST_LIMIT_UM,
                "Larger changes by a new machine file need confirmation, µm: 0 to 1e6",
            ),
        ];
        if is_rotary {
            settings.extend([
                Setting::number(
                    "limit_urad",
                    150.0,
                    "Largest correction of a rotary axis, µrad: 0.001 to 2000",
                ),
                Setting::number(
                    "slew_urad_per_s",
                    500.0,
                    "Largest rate of this correction, µrad/s: 0.001 to 5000",
                ),
            ]);
        }
        settings.extend([
            Setting::number(
                "hold_ms",
                (2.0 * cycle_ms).clamp(100.0, 200.0),
                "Hold the correction if readings are older, ms: one cycle to 200",
            ),
            Setting::number(
                "zero_after_ms",
                1000.0,
                "Ramp it to zero if they are older, ms: hold_ms to 600000",
            ),
            Setting::number("ramp_s", 0.5, "Ramp duration, s: 0 to 600"),
            Setting::number(
                "max_degc_per_min",
                5.0,
                "Maximum temperature rate, K/min: 0.01 to 1000; faster is a jump",
            ),
        ]);
        settings
    }

    pub(crate) fn complete(&mut self) {
        let settings = self.settings();
        let linear = settings.linear;
        self.warn_um.get_or_insert(linear.warn.0);
        self.confirm_um.get_or_insert(linear.confirm.0);
        self.test_shift_um.get_or_insert(linear.test_shift.0);
        if let Some(rotary) = settings.rotary {
            self.warn_urad.get_or_insert(rotary.warn.0);
            self.confirm_urad.get_or_insert(rotary.confirm.0);
            self.test_shift_urad.get_or_insert(rotary.test_shift.0);
        }
    }

    pub(super) fn validate(&self, cycle_ms: f64, found: &mut Mistakes<'_>) {
        for key in ["limit_um", "slew_um_per_s", "hold_ms", "zero_after_ms"] {
            found.require("guard", key);
        }
        // A missing or invalid limit must not restrict the valid ranges of the other keys.
        let above = |limit: f64| if limit > 0.0 { limit } else { f64::INFINITY };
        let most_um = ceiling::LIMIT.0 * 1e3;
        let most_urad = ceiling::LIMIT_ROTARY.0 * 1e6;
        let slew_um = 1e-3..=ceiling::SLEW_PER_S.0 * 1e3;
        let slew_urad = 1e-3..=ceiling::SLEW_PER_S_ROTARY.0 * 1e6;
        let limit = above(self.limit_um);
        let limit_urad = above(self.limit_urad.unwrap_or_default());
        let longest_ms = ceiling::HOLD.as_secs_f64() * 1e3;
        let [low, high] = self.range_degc;
        let keys = serde_json::to_value(self).unwrap_or_default();
        for (key, range) in [
            ("limit_um", 1e-3..=most_um),
            ("warn_um", 0.0..=limit),
            ("slew_um_per_s", slew_um),
            ("accel_um_per_s2", 1e-3..=1e12),
            ("confirm_um", 0.0..=1e6),
            ("test_shift_um", 0.0..=limit),
            ("limit_urad", 1e-3..=most_urad),
            ("warn_urad", 0.0..=limit_urad),
            ("slew_urad_per_s", slew_urad),
            ("accel_urad_per_s2", 1e-3..=1e12),
            ("confirm_urad", 0.0..=1e6),
            ("test_shift_urad", 0.0..=limit_urad),
            ("limit_without_barrier_um", 1e-3..=most_um),
            ("limit_without_barrier_urad", 1e-3..=most_urad),
            ("rotary_step_um", 1e-3..=1000.0),
            ("hold_ms", cycle_ms..=longest_ms),
            ("ramp_s", 0.0..=600.0),
            ("stop_s", 0.0..=600.0),
            ("hand_back_s", 0.0..=3600.0),
            ("rapid_m_per_min", 0.1..=1e4),
            ("rapid_rpm", 0.1..=1e5),
            ("max_degc_per_min", 0.01..=1000.0),
            ("temperature_stale_s", 0.1..=3600.0),
            ("temperature_hold_s", 0.0..=1e6),
            ("temperature_fade_s", 1.0..=1e6),
            ("temperature_stuck_s", 0.0..=1e7),
            ("temperature_neighbours_k", 0.1..=1000.0),
        ] {
            // JSON represents a non-finite number as null.
            let number = keys.get(key).and_then(serde_json::Value::as_f64);
            found.range(&format!("guard.{key}"), number.unwrap_or(f64::NAN), range);
        }
        if found.states("guard.hold_ms") {
            let range = self.hold_ms..=600_000.0;
            found.range("guard.zero_after_ms", self.zero_after_ms, range);
        }
        if low >= high || !(low.abs() < 1e6 && high.abs() < 1e6) {
            let message = format!("found {low} to {high}, expected the lower temperature first");
            found.add("guard.range_degc", message);
        }
        let of_rotary = [
            "warn_urad",
            "slew_urad_per_s",
            "accel_urad_per_s2",
            "confirm_urad",
            "test_shift_urad",
        ];
        if found.states("guard.limit_urad") {
            found.require("guard", "slew_urad_per_s");
            return;
        }
        for key in of_rotary {
            let key = format!("guard.{key}");
            if found.states(&key) {
                found.add(
                    &key,
                    "found this key without limit_urad, expected both or neither: without limit_urad no rotary axis is corrected",
                );
            }
        }
    }
}
