//! Platinum resistance thermometers by IEC 60751: the Callendar–Van Dusen equation in both directions, −200 to 850 °C.

use volcomp_vocabulary::bounds::PLAUSIBLE_DEGC;

/// Coefficient A of the standard, 1/°C.
pub const A: f64 = 3.9083e-3;
/// Coefficient B of the standard, 1/°C².
pub const B: f64 = -5.775e-7;
/// Coefficient C of the standard, 1/°C⁴. It applies only below 0 °C.
pub const C: f64 = -4.183e-12;
/// Lowest and highest temperature of the standard, °C.
pub const RANGE_DEGC: [f64; 2] = [*PLAUSIBLE_DEGC.start(), *PLAUSIBLE_DEGC.end()];

/// Resistance ratio R(t)/R₀ = 1 + A·t + B·t² at a temperature t in °C. Below 0 °C, C·(t − 100)·t³ is added. `None`
/// outside the range.
pub fn ratio(degc: f64) -> Option<f64> {
    (RANGE_DEGC[0]..=RANGE_DEGC[1]).contains(&degc).then(|| unchecked_ratio(degc))
}

fn unchecked_ratio(t: f64) -> f64 {
    let below = if t < 0.0 { C * (t - 100.0) * t } else { 0.0 };
    1.0 + t * (A + t * (B + below))
}

/// Temperature for a resistance ratio R/R₀, °C; `None` for a ratio outside the range or NaN.
pub fn temperature(ratio: f64) -> Option<f64> {
    let [low, high] = RANGE_DEGC.map(unchecked_ratio);
    // Accepts rounding errors at the ends of the range, 0.5 nK.
    if !((low - 2e-12)..=(high + 2e-12)).contains(&ratio) {
        return None;
    }
    // Solution of the quadratic equation, exact from 0 °C on. Below 0 °C it is the start value for Newton's method.
    let discriminant = A * A - 4.0 * B * (1.0 - ratio);
    let mut t = 2.0 * (ratio - 1.0) / (A + discriminant.sqrt());
    if ratio < 1.0 {
        for _ in 0..4 {
            let slope = A + t * (2.0 * B + t * C * (4.0 * t - 300.0));
            t -= (unchecked_ratio(t) - ratio) / slope;
        }
    }
    Some(t.clamp(RANGE_DEGC[0], RANGE_DEGC[1]))
}

/// Temperature of a two-wire sensor, °C; `None` outside the range of the standard. `leads_ohm`, the resistance of both
/// leads together in Ω, is subtracted first. `r0_ohm` is the resistance at 0 °C in Ω, 100 for a PT100.
pub fn two_wire(ohm: f64, leads_ohm: f64, r0_ohm: f64) -> Option<f64> {
    temperature((ohm - leads_ohm) / r0_ohm)
}
