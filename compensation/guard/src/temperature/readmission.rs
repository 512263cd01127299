//! The rule by which a sensor that jumped is believed again.

use core::time::Duration;

use super::{neighbours::common_change, types::MAX_SENSORS};

/// How long a sensor that jumped must agree before it is believed again.
const AGREES_FOR: Duration = Duration::from_secs(600);
/// How closely it must agree, K.
const AGREES_WITHIN_K: f64 = 1.0;

/// A sensor that jumped, and what would show that it is right again. Time alone does not.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readmission {
    /// The place of the sensor among all.
    own: usize,
    /// Its last temperature before the jump, °C.
    before: f64,
    /// The temperatures of all sensors before the jump, °C.
    neighbours: [f64; MAX_SENSORS],
    /// When the last reading since the jump was taken.
    seen: Option<Duration>,
    /// Since when its readings agree with the temperature before the jump.
    with_before: Option<Duration>,
    /// Since when its readings differ from its neighbours as they did before the jump.
    with_neighbours: Option<Duration>,
}

impl Readmission {
    /// A sensor that jumps now. `before` is its last temperature that was believed; `neighbours` are those of all
    /// sensors.
    pub(super) fn new(own: usize, before: f64, neighbours: &[f64; MAX_SENSORS]) -> Self {
        Self {
            own,
            before,
            neighbours: *neighbours,
            seen: None,
            with_before: None,
            with_neighbours: None,
        }
    }

    /// Takes a reading, and tells whether the sensor is believed again. A pause longer than `pause` lets the ten
    /// minutes begin anew.
    pub(super) fn sees(
        &mut self,
        degc: f64,
        taken: Duration,
        believed: &[f64; MAX_SENSORS],
        pause: Duration,
    ) -> bool {
        if (self.seen).is_some_and(|seen| taken.saturating_sub(seen) > pause) {
            self.interrupt();
        }
        self.seen = Some(taken);
        let close = |expected: f64| (degc - expected).abs() <= AGREES_WITHIN_K;
        let change = common_change(&self.neighbours, believed, self.own);
        let before = lasts(&mut self.with_before, close(self.before), taken);
        let neighbours = lasts(
            &mut self.with_neighbours,
            change.is_some_and(|change| close(self.before + change)),
            taken,
        );
        before || neighbours
    }

    /// Lets the ten minutes begin anew.
    pub(super) fn interrupt(&mut self) {
        self.with_before = None;
        self.with_neighbours = None;
    }
}

/// Whether an agreement has lasted for ten minutes; `since` is when it began.
fn lasts(since: &mut Option<Duration>, agrees: bool, taken: Duration) -> bool {
    *since = agrees.then(|| since.unwrap_or(taken));
    since.is_some_and(|since| taken.saturating_sub(since) >= AGREES_FOR)
}
