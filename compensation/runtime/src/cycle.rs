//! One cycle: positions, thermal state, model, guard, correction. Nothing here allocates, locks or logs.
//!
//! State: the paths with what is known of them, which path writes, the guard, the interlocks, the directions of travel,
//! the thermal lags of the model.

mod choice;
mod lag;
mod standby;
mod told;
mod wanted;

use std::time::{Duration, Instant};

use volcomp_guard::{
    DirectionMemory, Guard, Interlocks, Limits, Output, PositionCheck, Reasons, Request, Selector,
    State as GuardState,
};
use volcomp_kinematics::State;
use volcomp_port::{Clock, Description};
use volcomp_vocabulary::PerAxis;

use self::{lag::Lag, standby::Standby};
use crate::{
    asked::Asked,
    attendant::STANDBY_EVERY,
    error::{OrderRefusal, PlanError, StartError},
    model::Model,
    path::ControlPath,
    plan::check_together,
    reader::PositionReader,
    replacement::Replacement,
    report::Report,
    sensors::Sensors,
    settings::Rapid,
};

/// How long the parts of a cycle took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    /// The exchanges with controllers.
    pub exchange: Duration,
    /// The rest, by the CPU clock of the thread.
    pub own: Duration,
}

/// Everything that a cycle works on.
pub struct Cycle {
    model: Replacement,
    paths: Vec<ControlPath>,
    readers: Vec<PositionReader>,
    guard: Guard,
    selector: Selector,
    interlocks: Interlocks,
    directions: PerAxis<DirectionMemory>,
    rapid: Rapid,
    checks: PerAxis<PositionCheck>,
    sensors: Sensors,
    degraded: bool,
    /// Whether no path was left with a correction before the start, as far as that was written down, or a person says.
    left_nothing: bool,
    /// When a stop was seen last, since the start.
    stopped: Duration,
    standby: Standby,
    lag: Lag,
    /// Where the machine was commanded in this cycle; `None` while a position is not known.
    commanded: Option<State>,
    last: Option<Duration>,
    start: Instant,
    /// The clock that a test counts.
    clock: Option<Clock>,
    period: Duration,
    report: Report,
}

impl Cycle {
    /// A cycle over some paths in the order of preference; a better path takes over again when it was usable for
    /// `hand_back`.
    ///
    /// # Errors
    /// [`PlanError::Paths`]: no path, or more than [`MAX_PATHS`](volcomp_guard::MAX_PATHS). [`PlanError::Period`]:
    /// another period than that for which a path was planned. Those of
    /// [`PathPlan::check_together`](crate::PathPlan::check_together).
    pub fn new(
        model: Box<Model>,
        mut paths: Vec<ControlPath>,
        hand_back: Duration,
        sensors: Sensors,
        period: Duration,
    ) -> Result<Self, PlanError> {
        let Some(first) = paths
            .first()
            .filter(|_| paths.len() <= volcomp_guard::MAX_PATHS)
        else {
            return Err(PlanError::Paths { found: paths.len() });
        };
        for path in &paths {
            // A plan has checked the period, so none that makes no sense comes through.
            let planned = path.limits().period;
            if planned != period {
                return Err(PlanError::Period {
                    device: path.description.device.clone(),
                    found: period,
                    planned,
                });
            }
        }
        check_together(|| {
            let paths = paths.iter();
            paths.map(|path| (&path.description, path.goes_to_zero))
        })?;
        let guard = Guard::new(first.limits()).map_err(|source| PlanError::Limits {
            device: first.description.device.clone(),
            axis: None,
            source,
        })?;
        for path in &mut paths {
            path.fit_to(&model);
        }
        Ok(Self {
            model: Replacement::new(model, &sensors.names()),
            guard,
            paths,
            readers: Vec::new(),
            selector: Selector::new(hand_back),
            interlocks: Interlocks::default(),
            directions: PerAxis::default(),
            rapid: Rapid::default(),
            checks: PerAxis::default(),
            sensors,
            degraded: false,
            left_nothing: false,
            stopped: Duration::ZERO,
            standby: Standby::default(),
            lag: Lag::default(),
            commanded: None,
            last: None,
            start: Instant::now(),
            clock: None,
            period,
            report: Report::default(),
        })
    }

    /// Reads positions of further axes from controllers that are never written to. In reports they come after the paths.
    ///
    /// # Errors
    /// [`PlanError::Paths`]: more than [`MAX_PATHS`](volcomp_guard::MAX_PATHS) together with the paths.
    pub fn with_readers(mut self, readers: Vec<PositionReader>) -> Result<Self, PlanError> {
        let found = self.paths.len() + readers.len();
        if found > volcomp_guard::MAX_PATHS {
            return Err(PlanError::Paths { found });
        }
        self.readers = readers;
        Ok(self)
    }

    /// Takes another speed than [`Rapid::default`] for the fastest at which axes move.
    #[must_use]
    pub fn with_rapid(mut self, rapid: Rapid) -> Self {
        self.rapid = rapid;
        self
    }

    /// Lets the clock begin at `start` instead of when the cycle was made: for clocks that a test counts.
    #[must_use]
    pub fn with_start(mut self, start: Instant) -> Self {
        self.start = start;
        self
    }

    /// Takes the time from this clock, in the middle of a cycle too: for clocks that a test counts.
    #[must_use]
    pub fn with_clock(mut self, clock: Clock) -> Self {
        self.start = clock.start();
        self.clock = Some(clock);
        self
    }

    /// Tells which correction (mm, rad) was sent last before the program ended, `age` ago, for controllers that cannot be
    /// asked for the correction they hold. Controllers that can be asked are asked.
    /// Numbers that are none say that it is not known; without this call it is not known for paths that do not answer.
    pub fn restore(&mut self, correction: &PerAxis<f64>, age: Duration) {
        self.left_nothing = correction.iter().all(|value| *value == 0.0);
        for path in &mut self.paths {
            let limits = path.limits();
            let applied = path.in_channel(correction);
            path.read_back
                .restore(Duration::ZERO, &applied, age, &limits);
        }
    }

    /// Lets threads of their own ask the paths that stand by and the controllers that are only read, so that one that answers slowly, or hangs, costs the cycle
    /// nothing. Without it they are asked in the cycle, after the write and for half a period at the most: for clocks that
    /// a test counts. [`start`](crate::start) calls it.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn attend_standbys(&mut self) -> Result<(), StartError> {
        for reader in &mut self.readers {
            reader.attend(self.period, self.period.max(Duration::from_millis(20)))?;
        }
        if self.paths.len() < 2 {
            return Ok(());
        }
        for path in &mut self.paths {
            path.device
                .attend(&path.description.device, STANDBY_EVERY)?;
        }
        self.leave_standbys(Duration::ZERO);
        Ok(())
    }

    /// The report of the last cycle.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// The descriptions of the controllers by their drivers, in the order of the paths, then those that are only read.
    pub fn descriptions(&self) -> impl Iterator<Item = &Description> {
        let readers = self.readers.iter().map(PositionReader::description);
        let paths = self.paths.iter().map(|path| &path.description);
        paths.chain(readers)
    }

    /// The time from one cycle to the next.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// The clock of the cycle: the system's, or one that a test counts.
    pub fn clock(&self) -> Clock {
        let system = || Clock::System(self.start);
        self.clock.clone().unwrap_or_else(system)
    }

    /// When the clock of the cycle began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Takes another model from the next cycle on; `replacement` holds the old one afterwards, to be freed elsewhere.
    ///
    /// # Errors
    /// A model with other axes, or with the same in another order: the old one stays.
    pub fn swap_model(&mut self, replacement: &mut Replacement) -> Result<(), OrderRefusal> {
        if replacement.axes != self.model.axes {
            return Err(OrderRefusal::OtherAxes);
        }
        replacement.carry_over(&self.model);
        std::mem::swap(&mut self.model, replacement);
        self.lag.forget();
        // The new model determines where an axis may stand: it alone judges the next position.
        let axes = self.model.axes.len();
        for (index, check) in self.checks.iter_mut().enumerate().take(axes) {
            if self.model.position_limits(index, &self.rapid)
                != replacement.position_limits(index, &self.rapid)
            {
                check.forget();
            }
        }
        for path in &mut self.paths {
            path.fit_to(&self.model);
        }
        let limits = self.paths[self.selector.active()].limits();
        // Only test shifts become zero or are again what was accepted before, so a guard does not refuse them.
        let _ = self.guard.set_limits(limits);
        Ok(())
    }

    /// Takes other limits for the path at `index`. Allocates nothing.
    ///
    /// # Errors
    /// Limits that make no sense, of other axes, other steps or another period, or for a path that is not there: the old
    /// ones stay.
    pub fn set_limits(&mut self, index: usize, limits: &Limits) -> Result<(), OrderRefusal> {
        let paths = self.paths.len();
        let Some(path) = self.paths.get_mut(index) else {
            return Err(OrderRefusal::NoSuchPath { path: index, paths });
        };
        if limits.period != self.period {
            return Err(OrderRefusal::Period {
                path: index,
                found: limits.period,
                expected: self.period,
            });
        }
        let refused = |source| OrderRefusal::Limits {
            path: index,
            source,
        };
        path.set_limits(limits).map_err(refused)?;
        if index == self.selector.active() {
            let limits = path.limits();
            self.guard.set_limits(limits).map_err(refused)?;
        }
        Ok(())
    }

    /// Counts periods that were missed.
    pub fn count_overruns(&mut self, missed: u64) {
        self.report.overruns += missed;
    }

    /// A person has looked. Where there was a stop or a fault, that is what they have looked at, and what the path that
    /// writes was left with, which a fault waits for: a sensor that jumped, and what others were left with, ask again.
    fn acknowledge(&mut self, since_start: Duration, asked: &Asked) {
        let is_fault = matches!(self.guard.state(), GuardState::Faulted(_))
            || asked.forbids.contains(Reasons::FAULTED_BEFORE);
        let is_stop_or_fault = is_fault || !self.interlocks.reasons().is_empty();
        self.interlocks.acknowledge();
        let active = self.selector.active();
        for (index, path) in self.paths.iter_mut().enumerate() {
            if index == active || !is_stop_or_fault {
                path.read_back.acknowledge(since_start);
            }
        }
        if !is_stop_or_fault {
            self.sensors.acknowledge();
            self.left_nothing = true;
        }
    }

    /// Runs one cycle, begun at `now`. `own_clock` is the CPU clock of the thread.
    pub fn run(
        &mut self,
        now: Instant,
        asked: &Asked,
        own_clock: &mut dyn FnMut() -> Duration,
    ) -> Spent {
        let begun = Instant::now();
        let since_start = now.saturating_duration_since(self.start);
        let last = self.last.replace(since_start).unwrap_or(since_start);
        let passed = since_start.saturating_sub(last);
        let patience = self.paths[self.selector.active()].patience();
        self.read(self.selector.active(), now + patience, since_start);
        self.hear_standbys(since_start);
        if asked.request == Some(Request::Acknowledge) {
            self.acknowledge(since_start, asked);
        }
        let mut computes = own_clock();
        let (notes, switched) = self.select(since_start);
        let mut own = Duration::ZERO;
        if switched {
            own = own_clock().saturating_sub(computes);
            // What it said while it stood by may be some readings old.
            let active = self.selector.active();
            let deadline = self.instant() + self.paths[active].patience();
            self.read(active, deadline, since_start);
            computes = own_clock();
        }
        let read = Instant::now();
        self.thermal(since_start, passed);
        let output = self.decide(since_start, asked, notes);
        let (computed, writes) = (own_clock(), Instant::now());
        self.write(&output, begun, since_start);
        self.read_readers(since_start);
        self.leave_standbys(since_start);
        let (tells, written) = (own_clock(), Instant::now());
        self.tell(since_start, asked, &output);
        Spent {
            exchange: read.saturating_duration_since(now) + (written - writes),
            own: own + computed.saturating_sub(computes) + own_clock().saturating_sub(tells),
        }
    }

    /// The present moment, by the clock of a test where there is one.
    fn instant(&self) -> Instant {
        self.clock.as_ref().map_or_else(Instant::now, Clock::now)
    }

    /// Asks the controllers that are only read, after the path that corrects has been written: they must not hold it up.
    /// Each may take half a cycle.
    fn read_readers(&mut self, since_start: Duration) {
        let hold = self.guard.limits().hold;
        for index in 0..self.readers.len() {
            let deadline = self.instant() + self.period.mul_f64(0.5);
            let reader = &mut self.readers[index];
            self.report.faults += reader.read(deadline, self.start, since_start, hold);
            self.interlocks
                .see(self.paths.len() + index, reader.interlock());
        }
    }

    fn read(&mut self, index: usize, deadline: Instant, since_start: Duration) {
        let start = self.start;
        let Some(path) = self.paths.get_mut(index) else {
            return;
        };
        let answered = path.read(deadline, start, since_start);
        self.report.faults += u64::from(!answered);
        self.interlocks.see(index, path.interlock());
    }

    /// Temperatures, the lags, and the model with them: in every cycle, since work that is done seldom finds nothing
    /// of it in the caches and makes the longest cycles.
    fn thermal(&mut self, since_start: Duration, passed: Duration) {
        self.sensors
            .read(since_start, self.start, &mut self.report.sensors);
        // A sensor that was not asked since the program stood is not missing.
        let dt = passed.min(self.period * 5);
        self.degraded = self
            .model
            .warm(dt, passed.saturating_sub(dt), &self.report.sensors);
    }

    /// Sends the output on the path that corrects. The age of what it depends on is looked at once more.
    fn write(&mut self, output: &Output, begun: Instant, since_start: Duration) {
        if !output.write {
            return;
        }
        let now = match &self.clock {
            Some(clock) => clock.elapsed(),
            None => since_start + begun.elapsed(),
        };
        // By the same clock as the age: a test's clock may be far from the system's.
        let at = self.instant();
        let path = &mut self.paths[self.selector.active()];
        let left = self.guard.time_to_send(now);
        let sent = left.is_some_and(|left| {
            let deadline = at + left.min(path.patience());
            path.send(&output.correction, deadline, now)
        });
        if sent {
            self.report.sent = Some(path.in_machine(&output.correction));
        }
        // One barrier may report it to all paths that lead there.
        if let Some(frame) = path.read_back.last_frame() {
            for path in &mut self.paths {
                path.read_back.also_sent(frame);
            }
        }
        if !sent {
            self.guard.not_sent();
            self.report.faults += 1;
        }
    }
}
