//! One cycle: positions, thermal state, model, guard, correction. Nothing here allocates, locks or logs.
//!
//! State: the paths with their guards, which path is active, the directions of travel, the thermal lags of the model.

mod choice;

use std::time::{Duration, Instant};

use volcomp_guard::{
    DirectionMemory, Limits, MAX_PATHS, Output, Reasons, Request, Selector, State as GuardState,
};
use volcomp_kinematics::State;
use volcomp_port::Description;
use volcomp_vocabulary::{AxisKind, PerAxis, PerChannel};

use crate::{
    asked::Asked,
    error::{LimitsRefusal, PlanError},
    model::Model,
    path::ControlPath,
    place::Place,
    replacement::Replacement,
    report::Report,
    sensors::Sensors,
};

/// The longest time that an exchange with a controller may take, however long its positions may be held.
const LONGEST_EXCHANGE: Duration = Duration::from_secs(10);

/// Travel after which a direction counts as turned: of linear axes 5 µm.
const REVERSAL_MM: f64 = 0.005;
/// Travel after which a direction counts as turned: of rotary axes 5e-4 deg.
const REVERSAL_RAD: f64 = 8.726_646_259_971_648e-6;

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
    selector: Selector,
    /// The active path was switched and is to be armed.
    taking_over: bool,
    directions: PerAxis<DirectionMemory>,
    sensors: Sensors,
    degraded: bool,
    /// Where the machine was commanded in this cycle; `None` while a position is not known.
    commanded: Option<State>,
    last: Option<Duration>,
    start: Instant,
    period: Duration,
    report: Report,
}

impl Cycle {
    /// A cycle over some paths in the order of preference; a better path takes over again when it was usable for
    /// `hand_back`.
    ///
    /// # Errors
    /// [`PlanError::Paths`]: no path, or more than [`MAX_PATHS`]. [`PlanError::Period`]: another period than that for
    /// which a path was planned.
    pub fn new(
        model: Box<Model>,
        mut paths: Vec<ControlPath>,
        hand_back: Duration,
        sensors: Sensors,
        period: Duration,
    ) -> Result<Self, PlanError> {
        if !(1..=MAX_PATHS).contains(&paths.len()) {
            return Err(PlanError::Paths { found: paths.len() });
        }
        // A guard has checked the period of its plan, so none that makes no sense comes through.
        for path in &paths {
            let planned = path.guard.limits().period;
            if planned != period {
                return Err(PlanError::Period {
                    device: path.controller.description().device.clone(),
                    found: period,
                    planned,
                });
            }
        }
        choice::number_channels(&mut paths);
        Ok(Self {
            model: Replacement::new(model, &sensors.names()),
            paths,
            selector: Selector::new(hand_back),
            taking_over: false,
            directions: PerAxis::default(),
            sensors,
            degraded: false,
            commanded: None,
            last: None,
            start: Instant::now(),
            period,
            report: Report::default(),
        })
    }

    /// Lets the clock begin at `start` instead of when the cycle was made: for clocks that a test counts.
    #[must_use]
    pub fn with_start(mut self, start: Instant) -> Self {
        self.start = start;
        self
    }

    /// Starts from the correction that was applied when the program ended (mm, rad), for controllers that cannot be
    /// asked for the correction they hold.
    pub fn restore(&mut self, correction: &PerAxis<f64>) {
        for path in &mut self.paths {
            let mut applied = PerChannel::ZERO;
            let places = applied.iter_mut().zip(path.machine_axis);
            for (into, machine_axis) in places.take(path.guard.limits().count) {
                *into = correction[machine_axis];
            }
            path.guard.restore(&applied);
        }
    }

    /// The report of the last cycle.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// The descriptions of the controllers by their drivers, in the order of the paths.
    pub fn descriptions(&self) -> impl Iterator<Item = &Description> {
        self.paths.iter().map(|path| path.controller.description())
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
        std::mem::swap(&mut self.model, replacement);
        for path in &mut self.paths {
            path.fit_to(&self.model);
        }
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
        path.set_limits(limits)
            .map_err(|source| LimitsRefusal::Limits {
                path: index,
                source,
            })
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
        let since_start = now.saturating_duration_since(self.start);
        let last = self.last.replace(since_start).unwrap_or(since_start);
        let dt = since_start.saturating_sub(last).min(self.period * 5);
        self.read_all(now, since_start);
        if asked.request == Some(Request::Acknowledge) {
            self.sensors.acknowledge();
        }
        let (computes, read) = (own_clock(), Instant::now());
        self.thermal(since_start, dt);
        let output = self.decide(since_start, asked);
        let (computed, writes) = (own_clock(), Instant::now());
        self.write_all(&output);
        let (tells, written) = (own_clock(), Instant::now());
        self.tell(since_start, asked, &output);
        Spent {
            exchange: read.saturating_duration_since(now) + (written - writes),
            own: computed.saturating_sub(computes) + own_clock().saturating_sub(tells),
        }
    }

    /// Asks every controller where it is, the active one first.
    fn read_all(&mut self, now: Instant, since_start: Duration) {
        let active = self.selector.active();
        let deadline = now + self.patience(active);
        self.read(active, deadline, since_start);
        for index in 0..self.paths.len() {
            if index != active {
                // Those that stand by must not hold up the one that corrects.
                let deadline = Instant::now() + self.period.mul_f64(0.1);
                self.read(index, deadline, since_start);
            }
        }
    }

    /// How long an exchange may take. Longer than a cycle where positions may be held for longer: an answer that
    /// comes late costs a few cycles, a connection that is given up costs many.
    fn patience(&self, index: usize) -> Duration {
        let hold = self
            .paths
            .get(index)
            .map_or(Duration::ZERO, |path| path.guard.limits().hold);
        let patience = self.period.mul_f64(0.6).max(hold / 3);
        patience.min(LONGEST_EXCHANGE)
    }

    fn read(&mut self, index: usize, deadline: Instant, since_start: Duration) {
        let start = self.start;
        let answered =
            (self.paths.get_mut(index)).is_some_and(|p| p.read(deadline, start, since_start));
        self.report.faults += u64::from(!answered);
    }

    /// Temperatures, the lags, and the model with them: in every cycle, since work that is done seldom finds nothing
    /// of it in the caches and makes the longest cycles.
    fn thermal(&mut self, since_start: Duration, dt: Duration) {
        self.sensors
            .read(since_start, self.start, &mut self.report.sensors);
        self.degraded = self.model.warm(dt, &self.report.sensors);
    }

    /// The correction that the model asks for at a place, mm and rad.
    fn wanted(&mut self, place: &Place) -> (PerAxis<f64>, Reasons) {
        let mut state = State::default();
        for (q, position) in state.q.iter_mut().zip(&place.positions) {
            *q = *position;
        }
        self.approach(&mut state, place.known);
        (self.report.positions, self.report.known) = (place.positions, place.known);
        self.commanded = place.is_complete(self.model.axes.len()).then_some(state);
        if self.commanded.is_none() {
            let unknown = Reasons::AXIS_UNKNOWN.when(place.oldest.is_some());
            return (PerAxis::ZERO, unknown);
        }
        let correctors = &self.paths[self.selector.active()].correctors;
        let wanted = self.model.correction_of(&state, correctors);
        let outside = self.model.is_outside_range(&state);
        let notes = Reasons::SINGULAR.when(wanted.singular)
            | Reasons::NEAR_SINGULAR.when(wanted.near_singular && !wanted.singular)
            | Reasons::OUTSIDE_RANGE.when(outside);
        (wanted.delta, notes)
    }

    /// Which path corrects, what the model asks for, what each guard makes of it.
    fn decide(&mut self, now: Duration, asked: &Asked) -> [Output; MAX_PATHS] {
        let before = self.selector.active();
        let mut notes = self.select(now);
        let active = self.selector.active();
        let place = Place::seen_by(&self.paths, active, self.model.axes.len(), now);
        let (wanted, of_model) = self.wanted(&place);
        notes |= of_model | Reasons::FALLBACK.when(active != 0);
        self.report.wanted = wanted;
        let mut outputs = [Output::default(); MAX_PATHS];
        for (index, output) in outputs.iter_mut().enumerate().take(self.paths.len()) {
            let request = self.request_for(index, active, before, asked);
            // Those that do not correct let go.
            let (target, oldest) = if index == active {
                let share = || self.share(index, &wanted);
                (
                    place.is_complete(self.model.axes.len()).then(share),
                    place.oldest,
                )
            } else {
                (Some(PerChannel::ZERO), None)
            };
            *output = self.paths[index].guarded(now, oldest, target, request, asked);
        }
        self.taking_over &= self.paths[active].guard.state() == GuardState::Disarmed;
        outputs[active].reasons |= notes;
        outputs
    }

    /// From which direction each axis came, from positions without correction.
    fn approach(&mut self, state: &mut State, known: u16) {
        let axes = self.directions.iter_mut().zip(&self.model.axes);
        for (index, (memory, name)) in axes.enumerate() {
            if known >> index & 1 == 0 {
                continue;
            }
            let threshold = match name.kind() {
                AxisKind::Linear => REVERSAL_MM,
                AxisKind::Rotary => REVERSAL_RAD,
            };
            state.approach[index] = memory.at(state.q[index], threshold, None);
        }
    }

    /// The part of the wanted correction (mm, rad) that a path shall apply: the whole less the part that paths on
    /// other channels apply; zero for axes that do not correct.
    fn share(&self, index: usize, wanted: &PerAxis<f64>) -> PerChannel<f64> {
        let path = &self.paths[index];
        let mut share = PerChannel::ZERO;
        for (i, share) in share.iter_mut().enumerate() {
            if !path.corrects(i) {
                continue;
            }
            let machine_axis = path.machine_axis[i];
            let others = self.paths.iter().enumerate();
            let others = others.filter(|(other, p)| *other != index && p.channel != path.channel);
            let held: f64 = others.map(|(_, other)| other.output_of(machine_axis)).sum();
            *share = wanted[machine_axis] - held;
        }
        share
    }

    fn write_all(&mut self, outputs: &[Output; MAX_PATHS]) {
        for (index, output) in outputs.iter().enumerate().take(self.paths.len()) {
            let deadline = Instant::now() + self.patience(index);
            let path = &mut self.paths[index];
            if output.write && path.controller.apply(&output.correction, deadline).is_err() {
                path.guard.write_failed();
                self.report.faults += 1;
            }
        }
    }

    fn tell(&mut self, since_start: Duration, asked: &Asked, outputs: &[Output; MAX_PATHS]) {
        let active = self.selector.active();
        let output = &outputs[active];
        let report = &mut self.report;
        report.correction = PerAxis::ZERO;
        let channel = self.paths[active].channel;
        for (index, (path, output)) in self.paths.iter().zip(outputs).enumerate() {
            // Another path on the same channel is replaced by the active one.
            if index != active && path.channel == channel {
                continue;
            }
            for i in 0..path.count() {
                report.correction[path.machine_axis[i]] += output.correction[i];
            }
        }
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
    }
}
