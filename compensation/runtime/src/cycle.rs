//! One cycle: positions, thermal state, model, guard, correction. It does not allocate, lock or log.
//!
//! State: the paths and their data, the active path, the guard, the interlocks, the directions of travel, the thermal lags of the model.

mod lag;

use std::time::{Duration, Instant};

use volcomp_guard::{
    Confirmed, DirectionMemory, End, Guard, Inputs, Interlock, Interlocks, Limits, MAX_PATHS,
    Output, PathHealth, PositionCheck, PositionFlaw, Reading, Reasons, Request,
    RequestedCorrection, Scheme, Selector, State as GuardState, one_step,
};
use volcomp_kinematics::State;
use volcomp_port::{Clock, Description};
use volcomp_vocabulary::{PerAxis, PerChannel};

use self::lag::Lag;
use crate::{
    error::{OrderRefusal, PlanError, StartError},
    model::{CoupledCorrection, Model, Replacement},
    path::{ControlPath, MachinePosition, PositionReader},
    plan::check_together,
    report::{CycleInput, Report},
    sensors::Sensors,
    settings::Rapid,
    standby::STANDBY_INTERVAL,
};

/// Durations of the parts of one cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct CycleDurations {
    /// Time spent in exchanges with controllers.
    pub exchange: Duration,
    /// Compute time of the thread, by its CPU clock.
    pub own: Duration,
}

const STANDBY_SILENT: Duration = Duration::from_secs(2);

/// Length of a window. Outputs are remembered for one to two windows, which is longer than three readings of a standby
/// path plus a write in transit.
const WINDOW: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, Debug, Default)]
struct StandbyCheck {
    begun: Duration,
    /// Smallest and largest output of each machine axis, mm or rad, in this window and in the previous one.
    ranges: [[PerAxis<f64>; 2]; 2],
    /// Whether the last confirmed correction of each path differed from every recent output.
    holds: [bool; MAX_PATHS],
    /// Path that is to become active while its thread still holds the controller.
    wanted: Option<usize>,
}

impl StandbyCheck {
    fn add(&mut self, axis: usize, output: f64) {
        let [low, high] = &mut self.ranges[0];
        (low[axis], high[axis]) = (low[axis].min(output), high[axis].max(output));
    }

    fn advance(&mut self, now: Duration, outputs: &PerAxis<f64>) {
        if now.saturating_sub(self.begun) >= WINDOW {
            self.begun = now;
            self.ranges = [[*outputs; 2], self.ranges[0]];
        }
    }

    /// Whether the output of a machine axis had this value within the two windows, to one step.
    fn has_passed(&self, axis: usize, value: f64, step: f64) -> bool {
        let low = self.ranges[0][0][axis].min(self.ranges[1][0][axis]);
        let high = self.ranges[0][1][axis].max(self.ranges[1][1][axis]);
        (low - step..=high + step).contains(&value)
    }

    /// Whether a path reports a correction that differs from every recent output. All paths lead to
    /// the same axes, so each must report a recent output.
    fn reports_other_correction(&self, path: &ControlPath, confirmed: &Confirmed) -> bool {
        let limits = path.limits();
        (0..limits.count).any(|i| {
            let step = one_step(limits.axes[i].resolution);
            !self.has_passed(path.reported.machine_axis[i], confirmed.values[i], step)
        })
    }
}

/// The complete state of a cycle.
///
/// Invariants:
/// - There is an active path, and the guard has its limits.
/// - All paths are fitted to `model`, which always has the same axes in the same order.
/// - Paths and readers together are at most `MAX_PATHS`; their interlocks are numbered in this order.
/// - `commanded` is set only if every position is known, plausible and not too old.
/// - The active path's controller is held by the cycle, never by its thread.
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
    /// Whether no path has a correction from before the start, according to the stored state or the
    /// operator's confirmation.
    left_nothing: bool,
    /// Time of the last cycle with an interlock.
    stopped: Duration,
    standby: StandbyCheck,
    lag: Lag,
    /// Commanded position in this cycle; `None` while a position is unknown, implausible or too old.
    commanded: Option<State>,
    last: Option<Duration>,
    start: Instant,
    /// Clock advanced by a test; `None`: the system clock.
    clock: Option<Clock>,
    period: Duration,
    report: Report,
}

impl Cycle {
    /// Creates a cycle over these paths in order of preference. A preferred path takes over again once it has been usable for `hand_back`.
    ///
    /// # Errors
    /// [`PlanError::Paths`]: no path, or more than [`MAX_PATHS`](volcomp_guard::MAX_PATHS). [`PlanError::Period`]: a
    /// path was planned for another period. The errors of
    /// [`PathPlan::check_together`](crate::PathPlan::check_together).
    pub fn new(
        model: Box<Model>,
        mut paths: Vec<ControlPath>,
        hand_back: Duration,
        sensors: Sensors,
        period: Duration,
    ) -> Result<Self, PlanError> {
        let Some(first) = paths.first().filter(|_| paths.len() <= volcomp_guard::MAX_PATHS) else {
            return Err(PlanError::Paths { found: paths.len() });
        };
        for path in &paths {
            // The plan has checked the period.
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
            standby: StandbyCheck::default(),
            lag: Lag::default(),
            commanded: None,
            last: None,
            start: Instant::now(),
            clock: None,
            period,
            report: Report::default(),
        })
    }

    /// Adds controllers that only report positions of further axes. In reports these controllers follow the paths.
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

    /// Sets the maximum speed of axes, instead of [`Rapid::default`].
    #[must_use]
    pub fn with_rapid(mut self, rapid: Rapid) -> Self {
        self.rapid = rapid;
        self
    }

    /// Sets the start of the cycle's time (default: the creation of the cycle), for clocks advanced by a test.
    #[must_use]
    pub fn with_start(mut self, start: Instant) -> Self {
        self.start = start;
        self
    }

    /// Sets the clock, for tests that also advance it within a cycle.
    #[must_use]
    pub fn with_clock(mut self, clock: Clock) -> Self {
        self.start = clock.start();
        self.clock = Some(clock);
        self
    }

    /// Restores the correction (mm, rad) that the program sent last before it ended, `age` ago, for controllers without read-back. NaN
    /// means unknown. Without this call the correction of paths that do not answer is unknown.
    pub fn restore(&mut self, correction: &PerAxis<f64>, age: Duration) {
        self.left_nothing = correction.iter().all(|value| *value == 0.0);
        for path in &mut self.paths {
            let limits = path.limits();
            let applied = path.in_channel(correction);
            path.read_back.restore(Duration::ZERO, &applied, age, &limits);
        }
    }

    /// Restores the interlock that the controller with this index in the reports showed when the program ended. Only the same controller or the
    /// operator can clear it.
    pub fn restore_interlock(&mut self, index: usize, interlock: Interlock) {
        self.interlocks.restore(index, interlock);
    }

    /// Starts threads that read the standby paths and the read-only controllers, so that slow or hanging exchanges do
    /// not delay the cycle. Without threads the cycle itself reads these controllers after the write, for at most half
    /// a period, which suits clocks advanced by a test. [`start`](crate::start) calls this.
    ///
    /// # Errors
    /// The operating system cannot create a thread.
    pub fn start_standby_threads(&mut self) -> Result<(), StartError> {
        for reader in &mut self.readers {
            reader.start_thread(self.period, self.period.max(Duration::from_millis(20)))?;
        }
        if self.paths.len() < 2 {
            return Ok(());
        }
        for path in &mut self.paths {
            path.device.start_thread(&path.description.device, STANDBY_INTERVAL)?;
        }
        self.release_standbys(Duration::ZERO);
        Ok(())
    }

    /// The report of the last cycle.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Descriptions of the controllers: those of the paths in order, then those of the read-only
    /// controllers.
    pub fn descriptions(&self) -> impl Iterator<Item = &Description> {
        let readers = self.readers.iter().map(PositionReader::description);
        let paths = self.paths.iter().map(|path| &path.description);
        paths.chain(readers)
    }

    pub fn period(&self) -> Duration {
        self.period
    }

    /// The clock of the cycle: the system's, or one advanced by a test.
    pub fn clock(&self) -> Clock {
        let system = || Clock::System(self.start);
        self.clock.clone().unwrap_or_else(system)
    }

    /// Instant at which the cycle's time is zero.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Replaces the model from the next cycle on; `replacement` receives the old one, to be freed on another thread.
    ///
    /// # Errors
    /// A model with other axes, or with the same axes in another order. The old model then stays active.
    pub fn swap_model(&mut self, replacement: &mut Replacement) -> Result<(), OrderRefusal> {
        if replacement.axes != self.model.axes {
            return Err(OrderRefusal::OtherAxes);
        }
        replacement.carry_over(&self.model);
        std::mem::swap(&mut self.model, replacement);
        self.lag.forget();
        // The range of valid positions depends on the model, so the next position is checked against the range alone. A position that has jumped
        // stays rejected.
        let axes = self.model.axes.len();
        for (index, check) in self.checks.iter_mut().enumerate().take(axes) {
            if self.model.position_limits(index, &self.rapid)
                != replacement.position_limits(index, &self.rapid)
                && !check.has_jumped()
            {
                check.forget();
            }
        }
        for path in &mut self.paths {
            path.fit_to(&self.model);
        }
        let limits = self.paths[self.selector.active()].limits();
        // Only the test shifts can differ from limits that the guard has accepted before.
        let _ = self.guard.set_limits(limits);
        Ok(())
    }

    /// Replaces the limits of the path at `index`. Does not allocate.
    ///
    /// # Errors
    /// Limits that are invalid, or of other axes, other steps or another period, or an `index` without a path: the old limits stay.
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
        let refused = |source| OrderRefusal::Limits { path: index, source };
        path.set_limits(limits).map_err(refused)?;
        if index == self.selector.active() {
            let limits = path.limits();
            self.guard.set_limits(limits).map_err(refused)?;
        }
        Ok(())
    }

    /// Adds missed periods to the report.
    pub fn count_overruns(&mut self, missed: u64) {
        self.report.overruns += missed;
    }

    /// Handles an acknowledgement. During an interlock or a fault it confirms the interlocks and the correction left on
    /// the active path. Otherwise it also confirms jumped sensors and the corrections left on all paths.
    fn acknowledge(&mut self, since_start: Duration, input: &CycleInput) {
        let is_fault = matches!(self.guard.state(), GuardState::Faulted(_))
            || input.forbids.contains(Reasons::FAULTED_BEFORE);
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

    /// Runs one cycle, which began at `now`. `own_clock` returns the CPU time used by the thread.
    pub fn run(
        &mut self,
        now: Instant,
        input: &CycleInput,
        own_clock: &mut dyn FnMut() -> Duration,
    ) -> CycleDurations {
        let begun = Instant::now();
        let since_start = now.saturating_duration_since(self.start);
        let last = self.last.replace(since_start).unwrap_or(since_start);
        let passed = since_start.saturating_sub(last);
        let time_out = self.paths[self.selector.active()].exchange_time_out();
        self.read(self.selector.active(), now + time_out, since_start);
        self.take_standby_answers(since_start);
        if input.request == Some(Request::Acknowledge) {
            self.acknowledge(since_start, input);
        }
        let mut computes = own_clock();
        let (notes, switched) = self.select(since_start);
        let mut own = Duration::ZERO;
        if switched {
            own = own_clock().saturating_sub(computes);
            // The last reading of a new active path was made on standby, and may be several cycles old.
            let active = self.selector.active();
            let deadline = self.instant() + self.paths[active].exchange_time_out();
            self.read(active, deadline, since_start);
            computes = own_clock();
        }
        let read = Instant::now();
        self.thermal(since_start, passed);
        let output = self.decide(since_start, input, notes);
        let (computed, writes) = (own_clock(), Instant::now());
        self.write(&output, begun, since_start);
        self.read_readers(since_start);
        self.release_standbys(since_start);
        let (is_known, written) = (own_clock(), Instant::now());
        self.fill_report(since_start, input, &output);
        CycleDurations {
            exchange: read.saturating_duration_since(now) + (written - writes),
            own: own + computed.saturating_sub(computes) + own_clock().saturating_sub(is_known),
        }
    }

    fn instant(&self) -> Instant {
        self.clock.as_ref().map_or_else(Instant::now, Clock::now)
    }

    /// Reads the read-only controllers, each for at most half a period. Called after the active path is written, so that they do not delay
    /// the write.
    fn read_readers(&mut self, since_start: Duration) {
        let hold = self.guard.limits().hold;
        for index in 0..self.readers.len() {
            let deadline = self.instant() + self.period.mul_f64(0.5);
            let reader = &mut self.readers[index];
            self.report.faults += reader.read(deadline, self.start, since_start, hold);
            self.interlocks.update(self.paths.len() + index, reader.interlock());
        }
    }

    fn read(&mut self, index: usize, deadline: Instant, since_start: Duration) {
        let start = self.start;
        let Some(path) = self.paths.get_mut(index) else {
            return;
        };
        let answered = path.read(deadline, start, since_start);
        self.report.faults += u64::from(!answered);
        self.interlocks.update(index, path.interlock());
    }

    /// Updates temperatures, thermal lags and model. Runs in every cycle: rarely executed code has cold caches and would make single cycles long.
    fn thermal(&mut self, since_start: Duration, passed: Duration) {
        self.sensors.read(since_start, self.start, &mut self.report.sensors);
        // After a pause of the program, sensors must not count as missing.
        let dt = passed.min(self.period * 5);
        self.degraded = self.model.warm(dt, passed.saturating_sub(dt), &self.report.sensors);
    }

    /// Sends the output on the active path, after a final check of the age of its inputs.
    fn write(&mut self, output: &Output, begun: Instant, since_start: Duration) {
        if !output.write {
            return;
        }
        let now = match &self.clock {
            Some(clock) => clock.elapsed(),
            None => since_start + begun.elapsed(),
        };
        // A test's clock may be far from the system's, so the deadline uses the same clock as the age.
        let at = self.instant();
        let path = &mut self.paths[self.selector.active()];
        let left = self.guard.time_to_send(now);
        let sent = left.is_some_and(|left| {
            let deadline = at + left.min(path.exchange_time_out());
            path.send(&output.correction, deadline, now)
        });
        if sent {
            self.report.sent = Some(path.in_machine(&output.correction));
        }
        // A barrier may report this frame on every path that leads to it.
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

    /// Combines the machine position for the path at `index`. For each axis it takes the position that the path itself
    /// reports, else that of a read-only controller, else a fresh position of another path, else the configured fixed
    /// position.
    fn machine_position(&self, index: usize, now: Duration) -> MachinePosition {
        let path = &self.paths[index];
        let mut place = MachinePosition::default();
        for axis in 0..self.model.axes.len() {
            let fresh = || self.paths.iter().filter(|other| other.is_fresh(now));
            let others = || fresh().find_map(|other| other.reported.position_of(axis));
            let mut readers = self.readers.iter();
            let read = || readers.find_map(|reader| reader.reported.position_of(axis));
            let own = path.reported.position_of(axis);
            if let Some((seen, taken)) = own.or_else(read).or_else(others) {
                place.positions[axis] = seen;
                place.taken[axis] = taken;
                let older = |than: Option<Duration>| Some(than.map_or(taken, |it| it.min(taken)));
                place.oldest = older(place.oldest);
                if own.is_none() {
                    place.oldest_of_others = older(place.oldest_of_others);
                }
            } else if let Some(fixed) = path.fixed[axis] {
                place.positions[axis] = fixed;
            } else {
                continue;
            }
            place.known |= 1 << axis;
        }
        place
    }

    /// Whether a path could correct now (`usable`), and whether it could become active now (`ready`).
    fn health(&self, index: usize, now: Duration) -> PathHealth {
        let path = &self.paths[index];
        let place = self.machine_position(index, now);
        let complete = place.is_complete(self.model.axes.len());
        // A standby path is read less often than positions expire, so its own positions must have been fresh when it was read. If positions
        // of other controllers that it needs are too old, switching to it is useless.
        let is_young = if index == self.selector.active() {
            path.is_young(place.oldest, now)
        } else {
            let others = place.oldest_of_others;
            let is_fresh = others.is_none() || path.is_young(others, now);
            path.answers(now) && path.was_fresh() && is_fresh
        };
        PathHealth {
            usable: complete && is_young,
            ready: path.device.is_held() && self.is_ready(index, now),
        }
    }

    /// Whether the applied correction will be known when this path writes: either its control
    /// reports it for all axes that the active path wrote, or the active path cannot have left a
    /// correction.
    fn is_ready(&self, index: usize, now: Duration) -> bool {
        let (path, active) = (&self.paths[index], self.selector.active());
        if index == active {
            return true;
        }
        let (known, before) = (path.read_back_status(), &self.paths[active]);
        if known.scheme != Scheme::NoReadBack {
            let other = known.reasons.contains(Reasons::OTHER_GATEWAY);
            let is_known = known.confirmed.is_some() && !other;
            if !is_known || !before.leaves_axes_to(path) {
                return is_known;
            }
        }
        let Some(sent) = before.last_sent() else {
            // Nothing was sent since the start, so only the reported or the stored correction can be applied.
            return match before.read_back_status().confirmed {
                Some(_) => !before.report(now).holds,
                None => self.left_nothing,
            };
        };
        let by_itself = before.read_back.zero_after_last_write(&before.limits());
        // During an interlock a control holds the applied correction, so the time to zero counts from its end.
        let since = sent.max(self.stopped);
        by_itself.is_some_and(|wait| now.saturating_sub(since) > wait)
    }

    /// Selects the active path. Returns the reason why a preferred path may not take over, and whether the path changed.
    fn select(&mut self, now: Duration) -> (Reasons, bool) {
        let state = self.guard.state();
        if !self.interlocks.reasons().is_empty() {
            self.stopped = now;
        }
        // These states keep the active path: a fault must be checked by the operator; an interlock
        // holds the correction on its path; disarming needs no positions.
        let disarms = matches!(state, GuardState::RampingOut(End::Disarmed));
        let stays = matches!(state, GuardState::Faulted(_))
            || !self.interlocks.reasons().is_empty()
            || disarms && self.paths[self.selector.active()].answers(now);
        if self.paths.len() < 2 || stays {
            self.standby.wanted = None;
            return (Reasons::NONE, false);
        }
        let mut health = [PathHealth::default(); MAX_PATHS];
        for (index, health) in health.iter_mut().enumerate().take(self.paths.len()) {
            *health = self.health(index, now);
        }
        let before = self.selector.active();
        let choice = self.selector.choose(now, &health[..self.paths.len()]);
        let is_left = choice.blocked && !self.is_ready(choice.preferred, now);
        if choice.blocked && !is_left {
            // The preferred path takes over once its thread has returned the controller.
            self.paths[choice.preferred].device.recall();
        }
        self.standby.wanted = (choice.blocked && !is_left).then_some(choice.preferred);
        if choice.switched {
            // A barrier at zero has also dropped the correction that it received over digital lines.
            let released = self.paths[before].read_back_status().scheme == Scheme::Barrier;
            self.paths[choice.active].read_back.take_over(now, released);
            let (path, left) = (&self.paths[choice.active], &self.paths[before]);
            // The plan has checked the limits.
            let _ = self.guard.take_path(path.limits(), &path.places_on(left));
        }
        let blocked = Reasons::OTHER_CHANNEL_UNKNOWN.when(is_left);
        (blocked, choice.switched)
    }

    /// Correction that the model requests at a position, mm and rad, with reasons; `None` while a position is unknown or rejected. `applied` is the
    /// correction on the axes, in machine order.
    fn wanted(
        &mut self,
        place: &MachinePosition,
        applied: &PerAxis<f64>,
    ) -> (Option<CoupledCorrection>, Reasons) {
        let mut state = State::default();
        for (q, position) in state.q.iter_mut().zip(&place.positions) {
            *q = *position;
        }
        (self.report.positions, self.report.known) = (place.positions, place.known);
        let refused = self.judge(place);
        // Runs also while a position is rejected, because the other axes may reverse meanwhile.
        self.approach(&mut state, place);
        if !refused.is_empty() {
            self.commanded = None;
            return (None, refused);
        }
        self.commanded = place.is_complete(self.model.axes.len()).then_some(state);
        if self.commanded.is_none() {
            let unknown = Reasons::AXIS_UNKNOWN.when(place.oldest.is_some());
            return (None, unknown);
        }
        let path = &self.paths[self.selector.active()];
        let of = |correctors| {
            let model = &self.model;
            model.wanted_by(path.only_thermal, &state, correctors, applied)
        };
        let mut wanted = of(&path.correctors);
        if let Some(followers) = &path.followers {
            // A remaining correction on rotary axes goes to zero while the tool tip stays in place.
            wanted.follow = of(followers).follow;
        }
        let outside = self.model.is_outside_range(&state);
        let notes = Reasons::SINGULAR.when(wanted.singular)
            | Reasons::NEAR_SINGULAR.when(wanted.near_singular && !wanted.singular)
            | Reasons::LINEAR_NEAR_SINGULAR.when(wanted.linear_near_singular)
            | Reasons::OUTSIDE_RANGE.when(outside);
        (Some(wanted), notes)
    }

    /// Checks the positions for plausibility; returns the reasons to reject them. While disarmed, the next position is
    /// accepted without comparison to the previous one.
    fn judge(&mut self, place: &MachinePosition) -> Reasons {
        (self.report.outside_travel, self.report.jumped) = (0, 0);
        self.report.not_believed = 0;
        let begins = !self.guard.state().is_armed();
        let axes = self.model.axes.len();
        for (index, check) in self.checks.iter_mut().enumerate().take(axes) {
            if place.known >> index & 1 == 1 {
                let limits = self.model.position_limits(index, &self.rapid);
                let (position, taken) = (place.positions[index], place.taken[index]);
                match check.judge(&limits, position, taken) {
                    Ok(()) => {}
                    Err(PositionFlaw::OutsideTravel) => self.report.outside_travel |= 1 << index,
                    Err(PositionFlaw::Jumped) => self.report.jumped |= 1 << index,
                }
            }
            if begins {
                check.forget();
            }
            self.report.not_believed |= u16::from(check.has_jumped()) << index;
        }
        Reasons::OUTSIDE_TRAVEL.when(self.report.outside_travel != 0)
            | Reasons::JUMPED.when(self.report.jumped != 0)
    }

    fn decide(&mut self, now: Duration, input: &CycleInput, mut notes: Reasons) -> Output {
        let active = self.selector.active();
        let place = self.machine_position(active, now);
        let applied = self.paths[active].in_machine(&self.guard.output());
        let (wanted, of_model) = self.wanted(&place, &applied);
        notes |= of_model | Reasons::FALLBACK.when(active != 0);
        notes |= self.standby_notes(now, &applied);
        let reduction = wanted.map(|wanted| self.reduction(&place, &wanted, &applied, now));
        let path = &self.paths[active];
        let wanted = wanted.map(|wanted| in_channel(path, &wanted));
        self.report.wanted = wanted.map_or(PerAxis::ZERO, |wanted| path.in_machine(&wanted.full()));
        let wanted = wanted.zip(reduction).map(|(wanted, reduction)| RequestedCorrection {
            position: wanted.position.map(|share| reduction.part * share),
            rotary: wanted.rotary.map(|share| reduction.part * share),
            ..wanted
        });
        notes |= reduction.map_or(Reasons::NONE, |reduction| reduction.notes);
        let reading = path.reading.as_ref().map(|snapshot| Reading {
            taken: place.oldest.or(path.reported.taken).unwrap_or_default(),
            positions: snapshot.positions,
        });
        let lost = |then: Duration| now.saturating_sub(then) > path.limits().zero_after;
        if place.oldest.is_some_and(lost) {
            // Positions this old are not reported as current.
            self.report.known = 0;
            self.report.wanted = PerAxis::ZERO;
            self.commanded = None;
        }
        let mut output = self.guard.cycle(&Inputs {
            now,
            reading,
            read_back: *path.read_back_status(),
            interlocks: self.interlocks.reasons(),
            requested: wanted,
            fast_ramp_out: reduction.is_some_and(|reduction| reduction.fast_ramp_out),
            request: input.request,
            forbids: input.forbids,
        });
        let unproven =
            |place: usize| path.corrects(place) && path.limits().test_shift[place] == 0.0;
        let unproven = (0..path.count()).any(unproven);
        if !self.guard.state().is_armed() || place.oldest.is_none_or(lost) {
            // A correction of zero cannot be reduced.
            notes = notes.without(Reasons::REDUCED_BY_AGE);
        }
        output.reasons |= notes | path.notes | Reasons::NOT_PROVEN.when(unproven);
        output
    }

    fn reduction(
        &mut self,
        place: &MachinePosition,
        wanted: &CoupledCorrection,
        applied: &PerAxis<f64>,
        now: Duration,
    ) -> lag::Reduction {
        self.lag.update(place, &self.model);
        let path = &self.paths[self.selector.active()];
        let limits = self.guard.limits();
        let input = lag::PredictionInputs {
            model: &self.model,
            correctors: &path.correctors,
            only_thermal: path.only_thermal,
            limits,
            state: &self.commanded.unwrap_or_default(),
            wanted,
            applied,
            way_out: self.guard.time_to_zero(),
        };
        let age = place.oldest.map_or(Duration::MAX, |taken| now.saturating_sub(taken));
        self.lag.reduction(&input, age, now)
    }

    /// Updates the direction of approach of each axis from its position, unless the position is unknown or rejected.
    /// After a gap longer than positions may be held, the direction is unknown.
    fn approach(&mut self, state: &mut State, place: &MachinePosition) {
        let axes = self.model.axes.len();
        let hold = self.guard.limits().hold;
        let rejected = self.report.outside_travel | self.report.jumped;
        for (index, memory) in self.directions.iter_mut().enumerate().take(axes) {
            if (place.known & !rejected) >> index & 1 == 0 {
                continue;
            }
            memory.forget_after(hold, place.taken[index]);
            // Reversal threshold: the largest of the controllers that report the axis; an axis at a fixed position does not reverse.
            let paths = self.paths.iter().map(|path| &path.reported);
            let readers = self.readers.iter().map(|reader| &reader.reported);
            let thresholds = paths.chain(readers).filter_map(|seen| seen.reversal_of(index));
            let threshold = thresholds.fold(0.0, f64::max);
            let (taken, turn) = (place.taken[index], self.model.turn_of(index));
            state.approach[index] = memory.at(taken, state.q[index], threshold, turn);
        }
    }

    fn take_standby_answers(&mut self, now: Duration) {
        let active = self.selector.active();
        for (index, path) in self.paths.iter_mut().enumerate() {
            let mut answered = None;
            while let Some(reading) = path.device.next_reading() {
                // A reading that was requested before the path became active is dropped.
                let path_report =
                    (index != active).then(|| path.receive_standby(&reading, self.start));
                if let Some(is_good) = path_report.flatten() {
                    self.report.faults += u64::from(!is_good);
                    answered = Some(is_good);
                }
            }
            path.device.take_back();
            if index != active && (answered.is_some() || path.drop_if_silent(now)) {
                self.interlocks.update(index, path.interlock());
            }
        }
    }

    /// Hands the controllers of standby paths to their threads. Without threads, reads one standby path here, after the active path was
    /// written so that the write is not delayed.
    fn release_standbys(&mut self, now: Duration) {
        let (active, wanted) = (self.selector.active(), self.standby.wanted);
        for (index, path) in self.paths.iter_mut().enumerate() {
            if index != active && wanted != Some(index) {
                path.device.hand_over(path.exchange_time_out());
            }
        }
        let here = self.paths.iter().enumerate();
        let here = here.filter(|(index, path)| *index != active && !path.device.has_thread());
        let next = here.min_by_key(|(_, path)| path.last_read());
        let Some((next, input)) = next.map(|(index, path)| (index, path.last_read())) else {
            return;
        };
        if input.is_none_or(|at| now.saturating_sub(at) >= STANDBY_INTERVAL) {
            let deadline = self.instant() + self.period.mul_f64(0.5);
            self.read(next, deadline, now);
        }
    }

    /// Reasons that concern the standby paths. `outputs`: the correction on the axes, in machine order.
    fn standby_notes(&mut self, now: Duration, outputs: &PerAxis<f64>) -> Reasons {
        let active = self.selector.active();
        self.standby.advance(now, outputs);
        for (axis, output) in outputs.iter().enumerate() {
            self.standby.add(axis, *output);
        }
        let mut notes = Reasons::NONE;
        for (index, path) in self.paths.iter().enumerate() {
            if index == active {
                continue;
            }
            // A report is compared with the recent outputs, not with the present one, because it is older.
            if let Some(confirmed) = &path.read_back_status().confirmed
                && now.saturating_sub(confirmed.at) <= STANDBY_INTERVAL * 2
            {
                self.standby.holds[index] = self.standby.reports_other_correction(path, confirmed);
            }
            let report = path.report(now);
            // A control without read-back keeps its correction unless it ramps to zero on its own.
            // The correction would add to the correction of another path.
            let keeps = report.scheme == Scheme::NoReadBack
                && path.read_back.zero_after_last_write(&path.limits()).is_none();
            let silent = report.answered.is_none_or(|ago| ago > STANDBY_SILENT);
            notes |= Reasons::STANDBY_SILENT.when(silent && now > STANDBY_SILENT)
                | Reasons::STANDBY_HOLDS.when(report.holds && (keeps || self.standby.holds[index]));
        }
        notes
    }

    fn fill_report(&mut self, since_start: Duration, input: &CycleInput, output: &Output) {
        let active = self.selector.active();
        let path = &self.paths[active];
        let report = &mut self.report;
        let confirmed = path.read_back_status().confirmed;
        let applied = confirmed.map_or(PerChannel::ZERO, |confirmed| confirmed.values);
        report.correction = path.in_machine(&applied);
        report.written = path.written().fold(0, |bits, axis| bits | 1 << axis);
        report.proven = PerAxis::default();
        let shown = &self.guard.verdict().axes;
        for (i, axis) in path.written().enumerate() {
            report.proven[axis] = path.corrects(i).then_some(shown[i]);
        }
        let hold = self.guard.limits().hold;
        report.correction_known =
            confirmed.is_some_and(|confirmed| since_start.saturating_sub(confirmed.at) <= hold);
        let errors = self.commanded.map(|state| self.model.errors(&state, &report.correction));
        report.error = errors.map(|[without, _]| without);
        report.residual = errors.map(|[_, with]| with);
        report.cycle += 1;
        report.now = since_start;
        report.state = output.state;
        report.active = active;
        report.held_back = output.held_back;
        report.reasons = output.reasons
            | input.forbids
            | input.notes
            | Reasons::DEGRADED.when(self.degraded)
            | Reasons::BEYOND_SEEN.when(self.model.is_beyond_seen());
        let paths = self.paths.iter().map(|path| path.report(since_start));
        let readers = self.readers.iter();
        let readers = readers.map(|reader| reader.report(since_start));
        for (place, path_report) in paths.chain(readers).enumerate().take(report.paths.len()) {
            report.paths[place] = path_report;
            report.paths[place].reasons |= self.interlocks.path_reasons(place);
        }
    }
}

/// Converts the model's correction to the axis order of a path; zero for axes that do not correct. A
/// remaining correction on a non-correcting rotary axis ramps to zero; all linear axes of the path
/// follow it, whether they correct or not.
fn in_channel(path: &ControlPath, wanted: &CoupledCorrection) -> RequestedCorrection {
    let of = |values: &PerAxis<f64>, i: usize| {
        if path.corrects(i) { values[path.reported.machine_axis[i]] } else { 0.0 }
    };
    RequestedCorrection {
        position: PerChannel::from_fn(|i| of(&wanted.position, i)),
        rotary: PerChannel::from_fn(|i| of(&wanted.rotary, i)),
        follow: PerChannel::from_fn(|rotary| {
            if rotary >= path.count() {
                return PerChannel::ZERO;
            }
            let row = &wanted.follow[path.reported.machine_axis[rotary]];
            PerChannel::from_fn(|i| {
                if i < path.count() { row[path.reported.machine_axis[i]] } else { 0.0 }
            })
        }),
    }
}
