//! A controller as a guard sees it, with all that may go wrong.

use std::time::Duration;

use volcomp_guard::{AxisLimits, Guard, Inputs, Limits, Output, Reading, Reasons, Request, State};
use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

pub(crate) const PERIOD: Duration = Duration::from_millis(4);
pub(crate) const STEP: f64 = 0.001;

pub(crate) fn limits() -> Limits {
    let axis = AxisLimits {
        kind: AxisKind::Linear,
        limit: 0.150,
        warn: 0.100,
        slew_per_s: 0.5,
        accel_per_s2: 20.0,
        resolution: STEP,
        includes_correction: false,
    };
    Limits {
        axes: [axis; MAX_AXES],
        count: 2,
        period: PERIOD,
        hold: Duration::from_millis(50),
        zero_after: Duration::from_millis(500),
        ramp: Duration::from_millis(500),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 2,
    }
}

/// A controller, a guard and time.
#[expect(clippy::struct_excessive_bools, reason = "each is a fault of its own")]
pub(crate) struct World {
    pub(crate) guard: Guard,
    pub(crate) now: Duration,
    /// What the axes have, written or cleared.
    pub(crate) applied: PerChannel<f64>,
    pub(crate) target: Option<PerChannel<f64>>,
    pub(crate) positions: PerChannel<f64>,
    pub(crate) referenced: bool,
    pub(crate) alarm: bool,
    pub(crate) emergency_stop: bool,
    pub(crate) answers: bool,
    pub(crate) tells_applied: bool,
    pub(crate) sticks: bool,
    /// Positions do not get younger.
    pub(crate) frozen_at: Option<Duration>,
    pub(crate) really_includes: bool,
    pub(crate) forbids: Reasons,
}

pub(crate) fn axes(x: f64, y: f64) -> PerChannel<f64> {
    let mut values = PerChannel::ZERO;
    (values[0], values[1]) = (x, y);
    values
}

impl World {
    pub(crate) fn new(limits: &Limits) -> Self {
        Self {
            guard: Guard::new(*limits).expect("the limits of the tests are good"),
            now: Duration::from_secs(1),
            applied: PerChannel::ZERO,
            target: Some(axes(0.040, -0.020)),
            positions: PerChannel::ZERO,
            referenced: true,
            alarm: false,
            emergency_stop: false,
            answers: true,
            tells_applied: true,
            sticks: true,
            frozen_at: None,
            really_includes: false,
            forbids: Reasons::NONE,
        }
    }

    pub(crate) fn reading(&self) -> Option<Reading> {
        let mut positions = self.positions;
        if self.really_includes {
            for (position, applied) in positions.iter_mut().zip(&self.applied) {
                *position += applied;
            }
        }
        self.answers.then_some(Reading {
            taken: self.frozen_at.unwrap_or(self.now),
            positions,
            applied: self.tells_applied.then_some(self.applied),
            referenced: self.referenced,
            alarm: self.alarm,
            emergency_stop: self.emergency_stop,
        })
    }

    pub(crate) fn cycle_after(&mut self, dt: Duration, request: Option<Request>) -> Output {
        self.now += dt;
        let inputs = Inputs {
            now: self.now,
            reading: self.reading(),
            target: self.target,
            request,
            forbids: self.forbids,
        };
        let output = self.guard.cycle(&inputs);
        // A controller that does not answer may still listen; one that can be asked is then not written to.
        if output.write && self.sticks {
            self.applied = output.correction;
        }
        output
    }

    pub(crate) fn request(&mut self, request: Request) -> Output {
        self.cycle_after(PERIOD, Some(request))
    }

    pub(crate) fn run(&mut self, time: Duration) -> Output {
        let mut output = self.cycle_after(PERIOD, None);
        let end = self.now + time;
        while self.now < end {
            output = self.cycle_after(PERIOD, None);
        }
        output
    }

    /// Armed and through with its ramp.
    pub(crate) fn compensating(limits: &Limits) -> Self {
        let mut world = Self::new(limits);
        world.request(Request::Arm);
        let output = world.run(Duration::from_secs(2));
        assert_eq!(output.state, State::Compensating);
        world
    }
}
