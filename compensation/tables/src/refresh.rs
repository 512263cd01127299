//! How often a map has to be sent anew, and how long that takes.

use crate::{
    Map,
    control::{FRAME_WORDS, REPORT_WORDS},
};

/// What a kelvin at a sensor changes in the corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// The name of the sensor.
    pub sensor: String,
    /// The largest change of the correction over the work space for a kelvin, mm.
    pub mm_per_k: f64,
}

/// The time after which a map made at held temperatures is off by more than `within_mm`, s, where every sensor goes by
/// `k_per_h` in the direction that is worst; `None`: no temperature changes it. Lags of the terms only make it later.
pub fn refresh_s(sensitivities: &[Sensitivity], k_per_h: f64, within_mm: f64) -> Option<f64> {
    let mm_per_h: f64 = sensitivities
        .iter()
        .map(|s| s.mm_per_k * k_per_h.abs())
        .sum();
    (mm_per_h > 0.0).then(|| within_mm / mm_per_h * 3600.0)
}

/// What bringing a map into a control takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Frames that are written, one after the other.
    pub frames: usize,
    /// Bytes that go over the wire, besides the protocol of the bus: the frames, a report read before each, the map read back.
    pub bytes: usize,
}

impl Transfer {
    /// The transfer of a map without any loss.
    #[must_use]
    pub fn of(map: &Map) -> Self {
        let words = map.words().len();
        let frames = words.div_ceil(crate::control::DATA) + 2;
        Self {
            frames,
            bytes: 2 * (frames * (FRAME_WORDS + REPORT_WORDS) + words),
        }
    }

    /// How long it takes over a link of so many bytes in a second, where an exchange of a frame takes `exchange_s`
    /// besides, s.
    #[must_use]
    pub fn takes_s(&self, bytes_per_s: f64, exchange_s: f64) -> f64 {
        self.bytes as f64 / bytes_per_s + self.frames as f64 * exchange_s
    }
}
