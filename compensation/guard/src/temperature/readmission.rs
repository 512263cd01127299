//! The rule by which a sensor that jumped is believed again.

use core::time::Duration;

use super::{neighbours::common_change, types::MAX_SENSORS};

/// How long a sensor that jumped must agree before it is believed again.
const AGREES_FOR: Duration = Duration::from_secs(600);
/// How closely it must agree, K.
const AGREES_WITHIN_K: f64 = 1.0;

/// What is known of a sensor from the last moment at which it was believed.
#[derive(Clone, Copy, Debug)]
pub(super) struct BeforeJump {
    /// The place of the sensor among all.
    pub own: usize,
    /// Its temperature, °C.
    pub degc: f64,
    /// When that temperature was measured.
    pub taken: Duration,
    /// The temperatures of all sensors at that moment, °C; NaN for those that were not believed.
    pub neighbours: [f64; MAX_SENSORS],
}

impl BeforeJump {
    /// By how much the other sensors have changed since, K; `None` where fewer than two were believed at both times.
    pub(super) fn change(&self, believed: &[f64; MAX_SENSORS]) -> Option<f64> {
        common_change(&self.neighbours, believed, self.own)
    }
}

/// A sensor that jumped, and what would show that it is right again. Time alone does not.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readmission {
    before: BeforeJump,
    /// By how much the other sensors have changed since the sensor was believed, K, as far as they could tell; 0
    /// where they never could.
    change: f64,
    /// When the last reading since the jump was taken.
    seen: Option<Duration>,
    /// Since when its readings agree with its own temperature from before the jump.
    with_own: Option<Duration>,
    /// Since when its readings agree with that temperature and the change of the other sensors since.
    with_predicted: Option<Duration>,
}

impl Readmission {
    /// A sensor that jumps now.
    pub(super) fn new(before: &BeforeJump) -> Self {
        Self {
            before: *before,
            change: 0.0,
            seen: None,
            with_own: None,
            with_predicted: None,
        }
    }

    /// Takes a reading, and tells whether the sensor is believed again. A pause longer than `stale` lets the ten
    /// minutes begin anew, and the sensor's own temperature from before the jump predicts nothing by itself once it
    /// is older than that when the ten minutes begin: the machine has changed since, as the other sensors tell.
    pub(super) fn sees(
        &mut self,
        degc: f64,
        taken: Duration,
        believed: &[f64; MAX_SENSORS],
        stale: Duration,
    ) -> bool {
        if (self.seen).is_some_and(|seen| taken.saturating_sub(seen) > stale) {
            self.interrupt();
        }
        self.seen = Some(taken);
        self.change = self.before.change(believed).unwrap_or(self.change);
        let close = |expected: f64| (degc - expected).abs() <= AGREES_WITHIN_K;
        let began = self.with_own.unwrap_or(taken);
        let is_fresh = began.saturating_sub(self.before.taken) <= stale;
        let own = lasts(
            &mut self.with_own,
            is_fresh && close(self.before.degc),
            taken,
        );
        let predicted = lasts(
            &mut self.with_predicted,
            close(self.before.degc + self.change),
            taken,
        );
        own || predicted
    }

    /// Lets the ten minutes begin anew.
    pub(super) fn interrupt(&mut self) {
        self.with_own = None;
        self.with_predicted = None;
    }
}

/// Whether an agreement has lasted for ten minutes; `since` is when it began.
fn lasts(since: &mut Option<Duration>, agrees: bool, taken: Duration) -> bool {
    *since = agrees.then(|| since.unwrap_or(taken));
    since.is_some_and(|since| taken.saturating_sub(since) >= AGREES_FOR)
}
