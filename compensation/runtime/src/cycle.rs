//! One cycle: positions, thermal state, model, guard, correction. Nothing here allocates, locks or logs.
//!
//! State: the paths with what is known of them, which path writes, the guard, the interlocks, the directions of travel,
//! the thermal lags of the model.

mod choice;
mod lag;
mod standby;

use std::time::{Duration, Instant};

use volcomp_guard::{
    DirectionMemory, Guard, Inputs, Interlocks, Limits, Output, Reading, Reasons, Request,
    Selector, State as GuardState, Wanted,
};
use volcomp_kinematics::State;
use volcomp_port::{Clock, Description};
use volcomp_vocabulary::{PerAxis, PerChannel};

use self::{lag::Lag, standby::Standby};
use crate::{
    asked::Asked,
    attendant::STANDBY_EVERY,
    error::{LimitsRefusal, PlanError, StartError},
    model::{Model, ModelWanted},
    path::ControlPath,
    place::Place,
    reader::PositionReader,
    replacement::Replacement,
    report::Report,
    sensors::Sensors,
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
    sensors: Sensors,
    degraded: bool,
    /// Whether no path was left with a correction before the start, as far as that was written down, or a person says.
    left_nothing: bool,
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
    /// another period than that for which a path was planned. [`PlanError::Channels`]: paths whose corrections would add
    /// up.
    pub fn new(
        model: Box<Model>,
        paths: Vec<ControlPath>,
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
        let channel = &first.description.channel;
        for path in &paths {
            let description = &path.description;
            // A plan has checked the period, so none that makes no sense comes through.
            let planned = path.limits().period;
            if planned != period {
                return Err(PlanError::Period {
                    device: description.device.clone(),
                    found: period,
                    planned,
                });
            }
            if description.channel != *channel {
                return Err(PlanError::Channels {
                    device: description.device.clone(),
                    found: description.channel.clone(),
                    expected: channel.clone(),
                });
            }
        }
        let guard = Guard::new(first.limits()).map_err(|source| PlanError::Limits {
            device: first.description.device.clone(),
            axis: None,
            source,
        })?;
        Ok(Self {
            model: Replacement::new(model, &sensors.names()),
            guard,
            paths,
            readers: Vec::new(),
            selector: Selector::new(hand_back),
            interlocks: Interlocks::default(),
            directions: PerAxis::default(),
            sensors,
            degraded: false,
            left_nothing: false,
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
            let mut applied = PerChannel::ZERO;
            let places = applied.iter_mut().zip(path.machine_axis);
            for (into, machine_axis) in places.take(limits.count) {
                *into = correction[machine_axis];
            }
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

    /// When the clock of the cycle began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Takes another model from the next cycle on; `replacement` holds the old one afterwards, to be freed elsewhere.
    pub fn swap_model(&mut self, replacement: &mut Replacement) {
        replacement.carry_over(&self.model);
        std::mem::swap(&mut self.model, replacement);
        for path in &mut self.paths {
            path.fit_to(&self.model);
        }
        let limits = self.paths[self.selector.active()].limits();
        // Only test shifts become zero or are again what was accepted before, so a guard does not refuse them.
        let _ = self.guard.set_limits(limits);
    }

    /// Takes other limits for the path at `index`. Allocates nothing.
    ///
    /// # Errors
    /// Limits that make no sense, of another number of axes or of another period, or for a path that is not there: the
    /// old ones stay.
    pub fn set_limits(&mut self, index: usize, limits: &Limits) -> Result<(), LimitsRefusal> {
        let paths = self.paths.len();
        let Some(path) = self.paths.get_mut(index) else {
            return Err(LimitsRefusal::NoSuchPath { path: index, paths });
        };
        if limits.period != self.period {
            return Err(LimitsRefusal::Period {
                path: index,
                found: limits.period,
                expected: self.period,
            });
        }
        let refused = |source| LimitsRefusal::Limits {
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
            // Where there was a stop or a fault, that is what the person has looked at: a sensor that jumped asks again.
            let is_fault = matches!(self.guard.state(), GuardState::Faulted(_))
                || asked.forbids.contains(Reasons::FAULTED_BEFORE);
            if !is_fault && self.interlocks.reasons().is_empty() {
                self.sensors.acknowledge();
            }
            self.interlocks.acknowledge();
            self.left_nothing = true;
            for path in &mut self.paths {
                path.read_back.acknowledge(since_start);
            }
        }
        let selects = own_clock();
        let (notes, switched) = self.select(since_start);
        let selected = own_clock();
        if switched {
            // What it said while it stood by may be some readings old.
            let active = self.selector.active();
            let deadline = self.instant() + self.paths[active].patience();
            self.read(active, deadline, since_start);
        }
        let (computes, read) = (own_clock(), Instant::now());
        self.thermal(since_start, passed);
        let output = self.decide(since_start, asked, notes, switched);
        let (computed, writes) = (own_clock(), Instant::now());
        self.write(&output, begun, since_start);
        self.read_readers(since_start);
        self.leave_standbys(since_start);
        let (tells, written) = (own_clock(), Instant::now());
        self.tell(since_start, asked, &output);
        Spent {
            exchange: read.saturating_duration_since(now) + (written - writes),
            own: selected.saturating_sub(selects)
                + computed.saturating_sub(computes)
                + own_clock().saturating_sub(tells),
        }
    }

    /// The present moment, by the clock of a test where there is one.
    fn instant(&self) -> Instant {
        self.clock.as_ref().map_or_else(Instant::now, Clock::now)
    }

    /// Asks the controllers that are only read, after the path that corrects has been written: they must not hold it up.
    /// Each may take half a cycle.
    fn read_readers(&mut self, since_start: Duration) {
        for index in 0..self.readers.len() {
            let deadline = self.instant() + self.period.mul_f64(0.5);
            let reader = &mut self.readers[index];
            self.report.faults += reader.read(deadline, self.start, since_start);
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

    /// The correction that the model asks for at a place, mm and rad; `None` while a position is not known.
    fn wanted(&mut self, place: &Place) -> (Option<ModelWanted>, Reasons) {
        let mut state = State::default();
        for (q, position) in state.q.iter_mut().zip(&place.positions) {
            *q = *position;
        }
        self.approach(&mut state, place);
        (self.report.positions, self.report.known) = (place.positions, place.known);
        self.commanded = place.is_complete(self.model.axes.len()).then_some(state);
        if self.commanded.is_none() {
            let unknown = Reasons::AXIS_UNKNOWN.when(place.oldest.is_some());
            return (None, unknown);
        }
        let path = &self.paths[self.selector.active()];
        let applied = in_machine(path, &self.guard.output());
        let wanted = self.model.wanted(&state, &path.correctors, &applied);
        let outside = self.model.is_outside_range(&state);
        let notes = Reasons::SINGULAR.when(wanted.singular)
            | Reasons::NEAR_SINGULAR.when(wanted.near_singular && !wanted.singular)
            | Reasons::LINEAR_NEAR_SINGULAR.when(wanted.linear_near_singular)
            | Reasons::OUTSIDE_RANGE.when(outside);
        (Some(wanted), notes)
    }

    /// What the model asks for, what the guard makes of it. `switched`: another path corrects than in the cycle before.
    fn decide(
        &mut self,
        now: Duration,
        asked: &Asked,
        mut notes: Reasons,
        switched: bool,
    ) -> Output {
        let active = self.selector.active();
        let axes = self.model.axes.len();
        let place = Place::seen_by(&self.paths, &self.readers, active, axes, now);
        let (wanted, of_model) = self.wanted(&place);
        notes |= of_model | Reasons::FALLBACK.when(active != 0) | self.standby_notes(now);
        let kept = wanted.map(|wanted| self.kept(&place, &wanted, now));
        let path = &self.paths[active];
        let wanted = wanted.map(|wanted| in_channel(path, &wanted));
        self.report.wanted =
            wanted.map_or(PerAxis::ZERO, |wanted| in_machine(path, &wanted.full()));
        let wanted = wanted.zip(kept).map(|(wanted, kept)| Wanted {
            position: wanted.position.map(|share| kept.part * share),
            rotary: wanted.rotary.map(|share| kept.part * share),
            ..wanted
        });
        notes |= kept.map_or(Reasons::NONE, |kept| kept.notes);
        let takes_over = (switched && self.guard.state().is_armed()).then_some(Request::TakeOver);
        let reading = path.reading.as_ref().map(|snapshot| Reading {
            taken: place.oldest.or(path.taken()).unwrap_or_default(),
            positions: snapshot.positions,
        });
        let lost = |then: Duration| now.saturating_sub(then) > path.limits().zero_after;
        if place.oldest.is_some_and(lost) {
            // What held so long ago is not told as if it were so.
            self.report.known = 0;
            self.report.wanted = PerAxis::ZERO;
            self.commanded = None;
        }
        let mut output = self.guard.cycle(&Inputs {
            now,
            reading,
            known: *path.known(),
            interlocks: self.interlocks.reasons(),
            wanted,
            let_go: kept.is_some_and(|kept| kept.let_go),
            request: asked.request.or(takes_over),
            forbids: asked.forbids,
        });
        let unproven =
            |place: usize| path.corrects(place) && path.limits().test_shift[place] == 0.0;
        let unproven = (0..path.count()).any(unproven);
        output.reasons |= notes | path.notes | Reasons::NOT_PROVEN.when(unproven);
        output
    }

    /// What the age of the positions leaves of what is wanted.
    fn kept(&mut self, place: &Place, wanted: &ModelWanted, now: Duration) -> lag::Kept {
        self.lag.see(place, &self.model);
        let path = &self.paths[self.selector.active()];
        let (limits, output) = (self.guard.limits(), self.guard.output());
        let seconds = |i: usize| (output[i] / limits.axes[i].slew_per_s).abs();
        let way_out = (0..limits.count).map(seconds).fold(0.0, f64::max);
        let asked = lag::Asked {
            model: &self.model,
            correctors: &path.correctors,
            limits,
            state: &self.commanded.unwrap_or_default(),
            wanted,
            applied: &in_machine(path, &output),
            way_out: Duration::try_from_secs_f64(way_out).unwrap_or(Duration::MAX),
        };
        let age = place
            .oldest
            .map_or(Duration::MAX, |taken| now.saturating_sub(taken));
        self.lag.kept(&asked, age, now)
    }

    /// From which direction each axis came, from positions without correction.
    fn approach(&mut self, state: &mut State, place: &Place) {
        let axes = self.model.axes.len();
        for (index, memory) in self.directions.iter_mut().enumerate().take(axes) {
            if place.known >> index & 1 == 0 {
                continue;
            }
            // The coarsest path that shows it; an axis that stands at a stated position does not turn.
            let paths = self.paths.iter().filter_map(|path| path.reversal_of(index));
            let readers = self.readers.iter();
            let readers = readers.filter_map(|reader| reader.reversal_of(index));
            let threshold = paths.chain(readers).fold(0.0, f64::max);
            let (taken, turn) = (place.taken[index], self.model.turn_of(index));
            state.approach[index] = memory.at(taken, state.q[index], threshold, turn);
        }
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
        if !sent {
            self.guard.not_sent();
            self.report.faults += 1;
        }
    }

    fn tell(&mut self, since_start: Duration, asked: &Asked, output: &Output) {
        let active = self.selector.active();
        let path = &self.paths[active];
        let report = &mut self.report;
        let known = path.known();
        let applied = known
            .confirmed
            .map_or(PerChannel::ZERO, |confirmed| confirmed.values);
        report.correction = in_machine(path, &applied);
        report.sent = in_machine(path, &output.correction);
        report.proven = PerAxis::default();
        let shown = &self.guard.verdict().axes;
        for i in 0..path.count() {
            report.proven[path.machine_axis[i]] = path.corrects(i).then_some(shown[i]);
        }
        let hold = self.guard.limits().hold;
        report.correction_known = known
            .confirmed
            .is_some_and(|confirmed| since_start.saturating_sub(confirmed.at) <= hold);
        let errors = self
            .commanded
            .map(|state| self.model.errors(&state, &report.correction));
        report.error = errors.map(|[without, _]| without);
        report.residual = errors.map(|[_, with]| with);
        report.cycle += 1;
        report.now = since_start;
        report.state = output.state;
        report.active = active;
        report.held_back = output.held_back;
        report.reasons =
            output.reasons | asked.forbids | asked.notes | Reasons::DEGRADED.when(self.degraded);
        let paths = self.paths.iter().map(|path| path.report(since_start));
        let readers = self.readers.iter();
        let readers = readers.map(|reader| reader.report(since_start));
        for (place, told) in paths.chain(readers).enumerate().take(report.paths.len()) {
            report.paths[place] = told;
            report.paths[place].reasons |= self.interlocks.said_by(place);
        }
    }
}

/// Values of a path's axes in machine order; zero for axes that it does not write.
fn in_machine(path: &ControlPath, values: &PerChannel<f64>) -> PerAxis<f64> {
    let mut machine = PerAxis::ZERO;
    for i in 0..path.count() {
        machine[path.machine_axis[i]] = values[i];
    }
    machine
}

/// What the model asks for, in the order of a path's axes; zero for axes that do not correct. A rotary axis that does not
/// correct but still holds a share goes to zero, and the linear axes follow it all the same.
fn in_channel(path: &ControlPath, wanted: &ModelWanted) -> Wanted {
    let of = |values: &PerAxis<f64>, i: usize| {
        if path.corrects(i) {
            values[path.machine_axis[i]]
        } else {
            0.0
        }
    };
    Wanted {
        position: PerChannel::from_fn(|i| of(&wanted.position, i)),
        rotary: PerChannel::from_fn(|i| of(&wanted.rotary, i)),
        follow: PerChannel::from_fn(|rotary| {
            if rotary >= path.count() {
                return PerChannel::ZERO;
            }
            let row = &wanted.follow[path.machine_axis[rotary]];
            PerChannel::from_fn(|i| of(row, i))
        }),
    }
}
