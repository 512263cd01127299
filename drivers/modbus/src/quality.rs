//! The faults that a single reading does not show: sensors that are stuck, jump, or disagree with their neighbours.

use std::time::{Duration, Instant};

use volcomp_port::{Quality, Reason, Temperature};

/// The limits within which the readings of a sensor are believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The lowest and the highest temperature that may occur on this machine, °C.
    pub valid_degc: [f64; 2],
    /// Faster is no temperature of a machine, K/min.
    pub max_degc_per_min: f64,
    /// Steps below this are not judged, K: the module's resolution and noise.
    pub step_k: f64,
    /// The same digits for so long are uncertain; `None`: never.
    pub stuck_after: Option<Duration>,
    /// Farther from the middle of the others is uncertain, K; `None`: never.
    pub neighbours_k: Option<f64>,
}

impl Default for Limits {
    /// −20 to 120 °C, 5 K/min above steps of 0.5 K, six hours of the same digits, neighbours not compared.
    fn default() -> Self {
        Self {
            valid_degc: [-20.0, 120.0],
            max_degc_per_min: 5.0,
            step_k: 0.5,
            stuck_after: Some(Duration::from_secs(6 * 3600)),
            neighbours_k: None,
        }
    }
}

/// The memory of one sensor.
#[derive(Clone, Copy, Debug, Default)]
struct Memory {
    /// The last temperature that was believed.
    believed: Option<(f64, Instant)>,
    /// The last digits and since when they stand.
    digits: Option<(f64, Instant)>,
}

/// Judges sensors over time.
#[derive(Clone, Debug)]
pub struct Judge {
    limits: Limits,
    memory: Vec<Memory>,
}

impl Judge {
    /// Of so many sensors.
    pub fn new(limits: Limits, sensors: usize) -> Self {
        Self {
            limits,
            memory: vec![Memory::default(); sensors],
        }
    }

    /// The reading, with its quality judged by the readings before it; `raw` is the number as the module sent it.
    pub fn see(&mut self, sensor: usize, raw: Option<f64>, reading: Temperature) -> Temperature {
        let Some(memory) = self.memory.get_mut(sensor) else {
            return reading;
        };
        let (Some(degc), Some(taken)) = (reading.degc, reading.taken) else {
            return reading;
        };
        let [low, high] = self.limits.valid_degc;
        if !(low..=high).contains(&degc) {
            return Temperature::bad(Reason::OutOfRange, taken);
        }
        if let Some((before, then)) = memory.believed {
            let minutes = taken.saturating_duration_since(then).as_secs_f64() / 60.0;
            let allowed = self.limits.step_k + self.limits.max_degc_per_min * minutes;
            if (degc - before).abs() > allowed {
                return Temperature::bad(Reason::TooFast, taken);
            }
        }
        memory.believed = Some((degc, taken));
        let digits = raw.unwrap_or(degc);
        let since = match memory.digits {
            Some((same, since)) if same.to_bits() == digits.to_bits() => since,
            _ => taken,
        };
        memory.digits = Some((digits, since));
        let stands = taken.saturating_duration_since(since);
        if self.limits.stuck_after.is_some_and(|after| stands >= after) {
            return Temperature {
                quality: Quality::Uncertain(Reason::Stuck),
                ..reading
            };
        }
        reading
    }

    /// Compares good sensors with the middle of the other good ones: at least two others are needed.
    pub fn compare(&self, all: &mut [Temperature]) {
        let Some(allowed) = self.limits.neighbours_k else {
            return;
        };
        let good: Vec<Option<f64>> = all
            .iter()
            .map(|t| t.degc.filter(|_| t.quality == Quality::Good))
            .collect();
        for (sensor, temperature) in all.iter_mut().enumerate() {
            let Some(degc) = good[sensor] else { continue };
            let mut others: Vec<f64> = good
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != sensor)
                .filter_map(|(_, degc)| *degc)
                .collect();
            others.sort_unstable_by(f64::total_cmp);
            let [.., _, _] = others[..] else { continue };
            let middle = 0.5 * (others[(others.len() - 1) / 2] + others[others.len() / 2]);
            if (degc - middle).abs() > allowed {
                temperature.quality = Quality::Uncertain(Reason::Disagrees);
            }
        }
    }
}
