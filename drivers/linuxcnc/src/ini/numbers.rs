//! Checks the numbers of the bridge in an INI file. The bridge must accept them, and the gateway must be able to arm
//! with them.

use volcomp_vocabulary::{AxisKind, AxisName};

use super::{Expected, Ini, Problem};

/// Largest number of counts or scans that a word of the protocol can represent.
const MAX_WORD: f64 = i16::MAX as f64;

/// LinuxCNC's default for the maximum velocity of an axis, mm/s or deg/s.
const DEFAULT_MAX_VELOCITY: f64 = 1.0;

/// Limits that the guard requires of the bridge. In each pair the first value is for linear axes, the second for rotary
/// axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardMinimum {
    /// Largest correction, µm and millidegrees.
    pub limit: [f64; 2],
    /// Minimum rate of the barrier, µm/s and millidegrees per second. It is twice the slew.
    pub rate: [f64; 2],
    /// Age of the positions at which the guard begins to ramp the correction to zero, ms. The bridge's `TIME_OUT_MS`
    /// may not be larger.
    pub zero_after_ms: f64,
}

/// Keys of the settings for one kind of axis.
pub(super) struct Keys {
    pub(super) of: AxisKind,
    pub(super) step: &'static str,
    limit: &'static str,
    rate: &'static str,
}

pub(super) const KEYS: [Keys; 2] = [
    Keys { of: AxisKind::Linear, step: "STEP_NM", limit: "LIMIT_UM", rate: "RATE_UM_PER_S" },
    Keys { of: AxisKind::Rotary, step: "STEP_UDEG", limit: "LIMIT_MDEG", rate: "RATE_MDEG_PER_S" },
];

impl Ini {
    /// Reads a number in the bridge's section; `default` if the key is missing. Reports a malformed number, and a
    /// missing key without a default.
    fn number(
        &self,
        key: &'static str,
        default: Option<f64>,
        problems: &mut Vec<Problem>,
    ) -> Option<f64> {
        let Some(text) = self.get("VOLCOMP", key) else {
            if default.is_none() {
                let expected = "a number";
                problems.push(Problem::Missing { key, expected });
            }
            return default;
        };
        let found = text.parse().ok().filter(|found: &f64| found.is_finite());
        if found.is_none() {
            let (found, expected) = (text.to_owned(), "a number");
            problems.push(Problem::Number { key, found, expected });
        }
        found
    }

    /// Checks limits, rates and times by the rules of the bridge and the guard.
    pub(super) fn numbers(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        let scan_s = expected.scan_ms * 1e-3;
        for (at, keys) in KEYS.iter().enumerate() {
            let corrected = |axis: &&AxisName| axis.kind() == keys.of;
            if !expected.control.axes.iter().any(|axis| corrected(&axis)) {
                continue;
            }
            let step = self.number(keys.step, Some(1.0), problems);
            if let Some(found) = step.filter(|step| step.fract() != 0.0 || *step < 1.0) {
                problems.push(Problem::Number {
                    key: keys.step,
                    found: found.to_string(),
                    expected: "a whole number, 1 or more,",
                });
            }
            let step = step.filter(|step| *step >= 1.0).unwrap_or(1.0);
            let least = expected.least.as_ref();
            if let Some(found) = self.number(keys.limit, None, problems) {
                let guard = least.map_or(0.0, |least| least.limit[at]);
                check_range(
                    keys.limit,
                    found,
                    &[
                        (guard, "the limit of [guard] in the gateway's configuration"),
                        (step * 1e-3, "a count"),
                    ],
                    (MAX_WORD * step * 1e-3, "a word of the protocol holds 32767 counts"),
                    problems,
                );
            }
            let Some(rate) = self.number(keys.rate, None, problems) else {
                continue;
            };
            let guard = least.map_or(0.0, |least| least.rate[at]);
            check_range(
                keys.rate,
                rate,
                &[
                    (guard, "twice the slew of [guard] in the gateway's configuration"),
                    (step * 1e-3 / scan_s / MAX_WORD, "a count in 32767 scans"),
                ],
                (MAX_WORD * step * 1e-3 / scan_s, "a word of the protocol holds 32767 counts"),
                problems,
            );
            for axis in expected.control.axes.iter().filter(corrected) {
                self.check_offset_rate(*axis, keys.rate, rate, problems);
            }
        }
        if expected.control.axes.is_empty() {
            return;
        }
        let hold = self.number("HOLD_MS", Some(100.0), problems);
        let time_out = self.number("TIME_OUT_MS", Some(300.0), problems);
        if let Some(found) = hold {
            let least = (expected.scan_ms, "a period of the servo thread");
            let most = (MAX_WORD * expected.scan_ms, "a word of the protocol holds 32767 scans");
            check_range("HOLD_MS", found, &[least], most, problems);
        }
        if let Some(found) = time_out {
            let twice = (2.0 * hold.unwrap_or(0.0), "twice HOLD_MS");
            let word = (MAX_WORD * expected.scan_ms, "a word of the protocol holds 32767 scans");
            let guard = expected.least.as_ref().map(|least| least.zero_after_ms);
            let guard =
                guard.map_or(word, |ms| (ms, "guard.zero_after_ms in the gateway's configuration"));
            let most = if guard.0 < word.0 { guard } else { word };
            check_range("TIME_OUT_MS", found, &[twice], most, problems);
        }
    }

    /// Checks that the planner can move the offset of an axis at the rate of the bridge, mm/s or deg/s. Another check
    /// reports a missing or invalid fraction of its velocity.
    fn check_offset_rate(
        &self,
        axis: AxisName,
        key: &'static str,
        rate: f64,
        problems: &mut Vec<Problem>,
    ) {
        let section = format!("AXIS_{axis}");
        let number = |key| self.get(&section, key)?.parse::<f64>().ok();
        let Some(found) = number("OFFSET_AV_RATIO").filter(|ratio| *ratio > 0.0) else {
            return;
        };
        let velocity = number("MAX_VELOCITY").unwrap_or(DEFAULT_MAX_VELOCITY);
        let share = found * velocity * (1.0 + 1e-9);
        if share.is_nan() || share < rate * 1e-3 {
            problems.push(Problem::Slow {
                axis,
                found,
                // The minimum is rounded up to the digits shown in the message, so that the shown value is sufficient.
                expected: (rate * 1e-3 / velocity * 1e4 - 1e-6).ceil() / 1e4,
                velocity,
                key,
            });
        }
    }
}

/// Reports a number above `most`, or below the largest of `least`. Each bound comes with its reason.
fn check_range(
    key: &'static str,
    found: f64,
    least: &[(f64, &'static str)],
    most: (f64, &'static str),
    problems: &mut Vec<Problem>,
) {
    let small = (least.iter().copied())
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(least, _)| found < least * (1.0 - 1e-9));
    if let Some((expected, why)) = small {
        problems.push(Problem::TooSmall { key, found, expected, why });
    } else if found > most.0 * (1.0 + 1e-9) {
        let (expected, why) = most;
        problems.push(Problem::TooLarge { key, found, expected, why });
    }
}
