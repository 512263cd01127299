//! One cycle: positions, thermal state, model, guard, correction. Nothing here allocates, locks or logs.

use std::time::{Duration, Instant};

use volcomp_guard::{
    AxisValues, DirectionMemory, Guard, Inputs, MAX_AXES, MAX_PATHS, Output, PathHealth, Reading, Reasons, Request,
    Selector, SensorCheck, SensorLimits, State as GuardState,
};
use volcomp_kinematics::{Approach, State};
use volcomp_port::{Controller, Fault, Quality, Snapshot, Thermometer};

use crate::{
    model::Model,
    report::{MAX_SENSORS, Report, SensorReport},
};

/// Temperatures are looked at so often.
const THERMAL_PERIOD: Duration = Duration::from_millis(100);
/// Another gateway is believed for so long after it was seen.
const OTHER_GATEWAY_FOR: Duration = Duration::from_secs(5);
/// The last motion of an axis counts from here on: 5 um, and 5e-4 deg.
const REVERSAL_MM: f64 = 0.005;
const REVERSAL_RAD: f64 = 8.726_646_259_971_648e-6;

/// One controller with its guard.
pub struct ControlPath {
    /// The controller.
    pub controller: Box<dyn Controller>,
    /// Its guard.
    pub guard: Guard,
    /// For each of its axes the place in the machine.
    pub machine_axis: [usize; MAX_AXES],
    /// Machine axes that stand where the configuration says, mm and rad.
    pub fixed: [Option<f64>; MAX_AXES],
    /// Paths with the same number replace one another.
    pub channel: u32,
    /// What is always to be told of it: unwatched, blind to others.
    pub notes: Reasons,
    reading: Option<Snapshot>,
    /// Positions without correction, as they held.
    positions: AxisValues,
    taken: Option<Duration>,
    other_gateway: Option<Duration>,
}

impl ControlPath {
    /// A path before its first cycle.
    pub fn new(controller: Box<dyn Controller>, guard: Guard, machine_axis: [usize; MAX_AXES], fixed: [Option<f64>; MAX_AXES], channel: u32, notes: Reasons) -> Self {
        Self { controller, guard, machine_axis, fixed, channel, notes, reading: None, positions: [0.0; MAX_AXES], taken: None, other_gateway: None }
    }

    fn count(&self) -> usize {
        self.guard.limits().count
    }
}

/// What a cycle is asked besides.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Asked {
    /// What somebody asked for.
    pub request: Option<Request>,
    /// Why arming is forbidden, if it is.
    pub forbids: Reasons,
    /// What is to be told besides.
    pub notes: Reasons,
}

/// How long the exchanges and the rest of a cycle took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    /// With controllers.
    pub exchange: Duration,
    /// By the thread's CPU clock, without them.
    pub own: Duration,
}

/// Everything that a cycle works on.
pub struct Cycle {
    model: Box<Model>,
    paths: Vec<ControlPath>,
    selector: Selector,
    /// The active path was switched and is to be armed.
    taking_over: bool,
    directions: [DirectionMemory; MAX_AXES],
    thermometers: Vec<Box<dyn Thermometer>>,
    checks: Vec<SensorCheck>,
    sensor_limits: SensorLimits,
    /// For each sensor of the model the place among the temperatures.
    sensor_of_model: Vec<Option<usize>>,
    model_degc: Vec<Option<f64>>,
    degraded: bool,
    since_thermal: Duration,
    last: Option<Duration>,
    start: Instant,
    period: Duration,
    report: Report,
}

/// Temperatures and what is asked of them.
pub struct Sensors {
    /// The thermometers.
    pub thermometers: Vec<Box<dyn Thermometer>>,
    /// What each may say.
    pub limits: SensorLimits,
}

impl Sensors {
    /// All names, in order.
    pub fn names(&self) -> Vec<String> {
        self.thermometers.iter().flat_map(|thermometer| thermometer.names().iter().cloned()).take(MAX_SENSORS).collect()
    }
}

impl Cycle {
    /// Puts it together: one path at least, [`MAX_PATHS`] at the most.
    pub fn new(model: Box<Model>, mut paths: Vec<ControlPath>, hand_back: Duration, sensors: Sensors, period: Duration) -> Self {
        paths.truncate(MAX_PATHS);
        let names = sensors.names();
        let mut cycle = Self {
            sensor_of_model: Vec::new(),
            model_degc: Vec::new(),
            checks: vec![SensorCheck::default(); names.len()],
            model,
            paths,
            selector: Selector::new(hand_back),
            taking_over: false,
            directions: [DirectionMemory::default(); MAX_AXES],
            thermometers: sensors.thermometers,
            sensor_limits: sensors.limits,
            degraded: false,
            since_thermal: THERMAL_PERIOD,
            last: None,
            start: Instant::now(),
            period,
            report: Report::default(),
        };
        (cycle.sensor_of_model, cycle.model_degc) = sensor_places(&cycle.model, &names);
        cycle
    }

    /// What was applied when the program ended, machine's order: for controllers that cannot be asked.
    pub fn restore(&mut self, correction: &AxisValues) {
        for path in &mut self.paths {
            let mut applied = [0.0; MAX_AXES];
            for (into, machine_axis) in applied.iter_mut().zip(path.machine_axis).take(path.guard.limits().count) {
                *into = correction[machine_axis];
            }
            path.guard.restore(&applied);
        }
    }

    /// What the last cycle told.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// The paths.
    pub fn paths(&self) -> &[ControlPath] {
        &self.paths
    }

    /// When its clock began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Another model from the next cycle on, with the places of its sensors; `replacement` becomes the old one,
    /// to be freed elsewhere.
    pub fn swap_model(&mut self, replacement: &mut Replacement) {
        std::mem::swap(&mut self.model, &mut replacement.model);
        std::mem::swap(&mut self.sensor_of_model, &mut replacement.sensor_of_model);
        std::mem::swap(&mut self.model_degc, &mut replacement.model_degc);
        self.since_thermal = THERMAL_PERIOD;
    }

    /// Other limits for the path at `index`; refused ones leave the old.
    pub fn set_limits(&mut self, index: usize, limits: &volcomp_guard::Limits) {
        if let Some(path) = self.paths.get_mut(index) {
            // Checked before it was sent.
            let _ = path.guard.set_limits(*limits);
        }
    }

    /// One cycle, begun at `now`.
    pub fn run(&mut self, now: Instant, asked: &Asked, own_clock: &mut dyn FnMut() -> Duration) -> Spent {
        let begun = own_clock();
        let since_start = now.saturating_duration_since(self.start);
        let dt = since_start.saturating_sub(self.last.unwrap_or(since_start)).min(self.period * 5);
        self.last = Some(since_start);
        let (mut spent, mut exchange_cpu) = (Spent::default(), Duration::ZERO);
        let (before, wall) = (own_clock(), Instant::now());
        self.read_all(now, since_start);
        spent.exchange += wall.elapsed();
        exchange_cpu += own_clock().saturating_sub(before);
        self.thermal(since_start, dt);
        let output = self.decide(since_start, asked);
        let (before, wall) = (own_clock(), Instant::now());
        self.write_all(now, &output);
        spent.exchange += wall.elapsed();
        exchange_cpu += own_clock().saturating_sub(before);
        self.tell(since_start, asked, &output);
        spent.own = own_clock().saturating_sub(begun).saturating_sub(exchange_cpu);
        spent
    }

    /// Every controller says where it is, the active one first.
    fn read_all(&mut self, now: Instant, since_start: Duration) {
        let active = self.selector.active();
        let deadline = now + self.period.mul_f64(0.6);
        self.read(active, deadline, since_start);
        for index in 0..self.paths.len() {
            if index != active {
                let deadline = Instant::now() + self.period.mul_f64(0.1);
                self.read(index, deadline, since_start);
            }
        }
    }

    fn read(&mut self, index: usize, deadline: Instant, since_start: Duration) {
        let Some(path) = self.paths.get_mut(index) else { return };
        match path.controller.read(deadline) {
            Ok(snapshot) => {
                let applied = snapshot.applied.unwrap_or_else(|| path.guard.output());
                let limits = path.guard.limits();
                for ((position, reported), (applied, limits)) in path.positions.iter_mut().zip(&snapshot.positions).zip(applied.iter().zip(&limits.axes)) {
                    *position = if limits.includes_correction { reported - applied } else { *reported };
                }
                let finite = path.positions.iter().take(limits.count).all(|x| x.is_finite());
                if finite {
                    path.taken = Some(snapshot.taken.saturating_duration_since(self.start));
                }
                path.reading = Some(snapshot);
            }
            Err(fault) => {
                path.reading = None;
                self.report.faults += 1;
                if fault == Fault::OtherGateway {
                    path.other_gateway = Some(since_start);
                }
            }
        }
    }

    /// Temperatures, their checks, the lags, and the model with them.
    fn thermal(&mut self, since_start: Duration, dt: Duration) {
        self.since_thermal += dt;
        if self.since_thermal < THERMAL_PERIOD {
            return;
        }
        let dt_s = self.since_thermal.as_secs_f64();
        self.since_thermal = Duration::ZERO;
        let mut place = 0;
        for thermometer in &mut self.thermometers {
            for latest in thermometer.latest() {
                let Some((check, told)) = self.checks.get_mut(place).zip(self.report.sensors.get_mut(place)) else { break };
                let taken = latest.taken.map(|taken| taken.saturating_duration_since(self.start));
                let degc = latest.degc.filter(|_| !matches!(latest.quality, Quality::Bad(_)));
                let found = check.check(since_start, degc, taken, &self.sensor_limits);
                *told = sensor_report(found);
                place += 1;
            }
        }
        for (degc, place) in self.model_degc.iter_mut().zip(&self.sensor_of_model) {
            *degc = place.and_then(|place| self.report.sensors.get(place)).and_then(|sensor| sensor.degc);
        }
        self.model.thermal.step(dt_s, &self.model_degc);
        self.degraded = self.model.thermal.is_degraded();
        self.model.thermal.apply(&mut self.model.compiled);
    }

    /// Positions of every machine axis as the path at `index` may use them, and when the oldest held: its own, else
    /// those of another path that are fresh, else what is fixed.
    fn positions_for(&self, index: usize, since_start: Duration) -> (AxisValues, u16, Option<Duration>) {
        let path = &self.paths[index];
        let (mut positions, mut known, mut oldest) = ([0.0; MAX_AXES], 0_u16, None::<Duration>);
        for machine_axis in 0..self.model.axes.len().min(MAX_AXES) {
            let shows = |path: &ControlPath| (0..path.count()).find(|&i| path.machine_axis[i] == machine_axis);
            let fresh = |path: &ControlPath| path.taken.is_some_and(|taken| since_start.saturating_sub(taken) <= path.guard.limits().hold);
            let own = shows(path).and_then(|i| Some((path.positions[i], path.taken?)));
            let others = || self.paths.iter().filter(|other| fresh(other)).find_map(|other| Some((other.positions[shows(other)?], other.taken?)));
            let found = own.or_else(others);
            let Some((position, taken)) = found.map(|(p, t)| (p, Some(t))).or_else(|| path.fixed[machine_axis].map(|p| (p, None))) else { continue };
            (positions[machine_axis], known) = (position, known | 1 << machine_axis);
            if let Some(taken) = taken {
                oldest = Some(oldest.map_or(taken, |oldest| oldest.min(taken)));
            }
        }
        (positions, known, oldest)
    }

    fn all_known(&self) -> u16 {
        ((1_u32 << self.model.axes.len().min(MAX_AXES)) - 1) as u16
    }

    /// Whether a path could correct now.
    fn health(&self, index: usize, since_start: Duration) -> PathHealth {
        let path = &self.paths[index];
        let (_, known, oldest) = self.positions_for(index, since_start);
        let fresh = oldest.is_some_and(|oldest| since_start.saturating_sub(oldest) <= path.guard.limits().hold);
        let free = path.reading.is_none_or(|r| r.state.referenced && !r.state.alarm && !r.state.emergency_stop);
        let active = index == self.selector.active();
        PathHealth {
            // A stop or an alarm of the active path is held, not fled from.
            usable: known == self.all_known() && fresh && (active || free && path.reading.is_some()),
            channel: path.channel,
            held_is_known: path.reading.is_some_and(|r| r.applied.is_some()),
        }
    }

    /// Which path corrects, what the model wants, what each guard makes of it.
    fn decide(&mut self, since_start: Duration, asked: &Asked) -> [Output; MAX_PATHS] {
        let mut switch_notes = Reasons::NONE;
        let before = self.selector.active();
        let state_before = self.paths[before].guard.state();
        if self.paths.len() > 1 && !matches!(state_before, GuardState::Faulted(_)) {
            let mut health = [PathHealth::default(); MAX_PATHS];
            for (index, health) in health.iter_mut().enumerate().take(self.paths.len()) {
                *health = self.health(index, since_start);
            }
            let choice = self.selector.choose(since_start, &health[..self.paths.len()]);
            if choice.switched {
                self.taking_over = self.taking_over || state_before.is_armed();
            }
            switch_notes = Reasons::OTHER_CHANNEL_UNKNOWN.when(choice.blocked && state_before.is_armed());
        }
        let active = self.selector.active();
        let (positions, known, oldest) = self.positions_for(active, since_start);
        let complete = known == self.all_known();
        let mut state = State::default();
        state.q[..MAX_AXES].copy_from_slice(&positions);
        self.approach(&mut state, known);
        let (mut wanted, mut notes) = ([0.0; MAX_AXES], switch_notes);
        if complete {
            let (correction, singular) = self.model.correction(&state);
            wanted.copy_from_slice(&correction[..MAX_AXES]);
            notes |= Reasons::SINGULAR.when(singular);
            notes |= Reasons::OUTSIDE_RANGE.when(self.model.compiled.outside_range(&state) != 0);
            self.report.error = self.model.compiled.evaluate(&state).into_six();
        }
        (self.report.positions, self.report.known, self.report.wanted) = (positions, known, wanted);
        let mut outputs = [Output::default(); MAX_PATHS];
        for index in 0..self.paths.len() {
            let target = (index == active && complete).then(|| self.share(index, &wanted)).or_else(|| (index != active).then_some([0.0; MAX_AXES]));
            let request = self.request_for(index, active, before, asked);
            let path = &mut self.paths[index];
            let taken = if index == active { oldest } else { path.taken };
            let reading = path.reading.map(|snapshot| Reading {
                taken: taken.unwrap_or_default(),
                positions: snapshot.positions,
                applied: snapshot.applied,
                referenced: snapshot.state.referenced,
                alarm: snapshot.state.alarm,
                emergency_stop: snapshot.state.emergency_stop,
            });
            let other = path.other_gateway.is_some_and(|seen| since_start.saturating_sub(seen) < OTHER_GATEWAY_FOR);
            let other = Reasons::OTHER_GATEWAY.when(other);
            outputs[index] = path.guard.cycle(&Inputs { now: since_start, reading, target, request, forbids: asked.forbids | other });
            outputs[index].reasons |= other | path.notes;
        }
        if self.taking_over && self.paths[active].guard.state() != GuardState::Disarmed {
            self.taking_over = false;
        }
        outputs[active].reasons |= notes | Reasons::FALLBACK.when(active != 0);
        outputs
    }

    /// In which direction each axis came, from positions without correction.
    fn approach(&mut self, state: &mut State, known: u16) {
        for (index, (memory, (_, rotary))) in self.directions.iter_mut().zip(&self.model.axes).enumerate() {
            if known >> index & 1 == 0 {
                continue;
            }
            let threshold = if *rotary { REVERSAL_RAD } else { REVERSAL_MM };
            state.approach[index] = match memory.at(state.q[index], threshold) {
                Some(true) => Approach::Positive,
                Some(false) => Approach::Negative,
                None => Approach::Unknown,
            };
        }
    }

    /// What a path shall hold of the wanted correction: less what the others on other channels hold.
    fn share(&self, index: usize, wanted: &AxisValues) -> AxisValues {
        let path = &self.paths[index];
        let mut share = [0.0; MAX_AXES];
        for (i, share) in share.iter_mut().enumerate().take(path.count()) {
            let machine_axis = path.machine_axis[i];
            let held = |other: &ControlPath| -> f64 {
                let place = (0..other.count()).find(|&k| other.machine_axis[k] == machine_axis);
                place.map_or(0.0, |k| other.guard.output()[k])
            };
            let others = self.paths.iter().enumerate().filter(|(other, p)| *other != index && p.channel != path.channel);
            *share = wanted[machine_axis] - others.map(|(_, p)| held(p)).sum::<f64>();
        }
        share
    }

    fn request_for(&mut self, index: usize, active: usize, before: usize, asked: &Asked) -> Option<Request> {
        if asked.request == Some(Request::Disarm) {
            self.taking_over = false;
        }
        if index == active {
            let takes_over = self.taking_over && asked.request.is_none();
            return asked.request.or(takes_over.then_some(Request::TakeOver));
        }
        // The one that was active lets go; the others do as everybody is told, but only one is armed.
        match asked.request {
            Some(Request::Arm | Request::TakeOver | Request::Switched) | None => (index == before && before != active).then_some(Request::Disarm),
            other => other,
        }
    }

    fn write_all(&mut self, now: Instant, outputs: &[Output; MAX_PATHS]) {
        let deadline = now + self.period.mul_f64(0.9);
        for (path, output) in self.paths.iter_mut().zip(outputs) {
            if output.write && path.controller.apply(&output.correction, deadline).is_err() {
                // Whether it was taken the next reading tells.
                self.report.faults += 1;
            }
        }
    }

    fn tell(&mut self, since_start: Duration, asked: &Asked, outputs: &[Output; MAX_PATHS]) {
        let active = self.selector.active();
        let output = &outputs[active];
        self.report.correction = [0.0; MAX_AXES];
        let channel = self.paths[active].channel;
        for (index, (path, output)) in self.paths.iter().zip(outputs).enumerate() {
            // Another path on the same channel is replaced by the active one.
            if index != active && path.channel == channel {
                continue;
            }
            for i in 0..path.count() {
                self.report.correction[path.machine_axis[i]] += output.correction[i];
            }
        }
        self.report.cycle += 1;
        self.report.now = since_start;
        self.report.state = output.state;
        self.report.active = active;
        self.report.held_back = output.held_back;
        self.report.reasons = output.reasons | asked.forbids | asked.notes | Reasons::DEGRADED.when(self.degraded);
    }

    /// Periods that were missed.
    pub fn count_overruns(&mut self, missed: u64) {
        self.report.overruns += missed;
    }
}

/// A model with what belongs to it in a cycle.
pub struct Replacement {
    model: Box<Model>,
    sensor_of_model: Vec<Option<usize>>,
    model_degc: Vec<Option<f64>>,
}

impl Replacement {
    /// For temperatures of these names.
    pub fn new(model: Box<Model>, names: &[String]) -> Self {
        let (sensor_of_model, model_degc) = sensor_places(&model, names);
        Self { model, sensor_of_model, model_degc }
    }
}

fn sensor_places(model: &Model, names: &[String]) -> (Vec<Option<usize>>, Vec<Option<f64>>) {
    let wanted = model.thermal.sensors();
    let places = wanted.iter().map(|wanted| names.iter().position(|name| name == wanted));
    (places.collect(), vec![None; wanted.len()])
}

fn sensor_report(found: Result<f64, volcomp_guard::Rejected>) -> SensorReport {
    use volcomp_guard::Rejected;
    match found {
        Ok(degc) => SensorReport { degc: Some(degc), flaw: 0, used: true },
        Err(rejected) => {
            let flaw = match rejected {
                Rejected::Broken => 1,
                Rejected::Stale => 2,
                Rejected::OutOfRange => 3,
                Rejected::Jumping => 4,
            };
            SensorReport { degc: None, flaw, used: false }
        }
    }
}
