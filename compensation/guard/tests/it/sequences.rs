//! Random sequences of all faults, on machines of three and five axes with one to three paths to their control.
//!
//! The paths are driven as by a gateway. The motion of the axes is checked after every write and scan: no axis steps,
//! or exceeds its slew or limit. `VOLCOMP_SEQUENCES` is the number of sequences, `VOLCOMP_CYCLES` their length.

use std::{collections::VecDeque, time::Duration};

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    AxisLimits, BarrierLink, ControlTimeOut, CorrectionReport, Guard, Inputs, Interlock,
    Interlocks, Limits, Output, PathHealth, ReadBack, Reading, Reasons, Request,
    RequestedCorrection, Scheme, Selector, State,
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Settings},
    protocol::{Counts, Layout},
};
use volcomp_vocabulary::{AxisKind, AxisName, PerChannel};

use crate::world::{MACHINE, PERIOD, SCAN, limits, same_places};

fn environment(name: &str, otherwise: u32) -> u32 {
    let environment = std::env::var(name).ok();
    environment.and_then(|environment| environment.parse().ok()).unwrap_or(otherwise)
}

/// The checks after each cycle.
#[derive(Default)]
struct Watch {
    /// Times and corrections of the axes since the last restart of the time windows.
    trace: VecDeque<(f64, PerChannel<f64>)>,
}

impl Watch {
    fn look(&mut self, machine: &mut Machine) -> Result<(), String> {
        let seen = std::mem::take(&mut machine.seen);
        let (now, applied) = (machine.now.as_secs_f64(), machine.applied);
        if seen.changed || seen.began {
            self.trace.clear();
        }
        if !seen.changed && seen.step > 1.0 + 1e-6 {
            return Err(format!("a step of {} times what is allowed at {now} s", seen.step));
        }
        if seen.not_finite || !applied.iter().all(|value| value.is_finite()) {
            return Err(format!("no number at {now} s"));
        }
        if seen.out > 1.0 + 1e-6 {
            return Err(format!("{} of the limit at {now} s", seen.out));
        }
        // With a barrier the axis moves at the barrier's rate, which was checked at every scan.
        if matches!(machine.kind, Kind::Barrier | Kind::LinesWithTimeOut) {
            return Ok(());
        }
        let limits = machine.limits();
        for back in [1, 2, 3, 5, 9, 17, 33, 65, 129] {
            let Some((then, before)) = self.trace.len().checked_sub(back).map(|at| self.trace[at])
            else {
                break;
            };
            for i in 0..limits.count {
                let axis = &limits.axes[i];
                let most = axis.slew_per_s * (now - then) + 2.0 * axis.resolution;
                let moved = (applied[i] - before[i]).abs();
                if moved > most * (1.0 + 1e-6) {
                    return Err(format!(
                        "axis {i} moved by {moved} in {} s at {now} s",
                        now - then
                    ));
                }
            }
        }
        self.trace.push_back((now, applied));
        if self.trace.len() > 130 {
            self.trace.pop_front();
        }
        Ok(())
    }
}

/// Runs a sequence; returns the states that occurred, or the first violation.
fn run(seed: u64, kind: Kind, axes: usize, ways: usize, cycles: u32) -> Result<Vec<State>, String> {
    let mut machine = Machine::new(seed, kind, axes, ways);
    let mut watch = Watch::default();
    let mut states = Vec::new();
    for cycle in 0..cycles {
        // Before arming, a control with a barrier is observed for 1 s, a control without a barrier for 0.7 s.
        let request = if cycle > 400 && cycle % 8 == 0 {
            machine.random_event()
        } else {
            (cycle % 100 == 0).then_some(Request::Arm)
        };
        let dt = machine.next_dt();
        let output = machine.cycle(dt, request);
        watch
            .look(&mut machine)
            .map_err(|wrong| format!("cycle {cycle}, {:?}: {wrong}", output.state))?;
        if states.last() != Some(&output.state) {
            states.push(output.state);
        }
    }
    // After repair, acknowledgement and disarming the correction must go to zero.
    machine.repair();
    for cycle in 0..1600 {
        let request = match cycle {
            // Three acknowledgements, because a fault follows if a correction beyond the limit is found while
            // disarming, or is confirmed later.
            300 | 700 | 1100 => Some(Request::Acknowledge),
            320 | 720 | 1120 => Some(Request::Disarm),
            _ => None,
        };
        let dt = Duration::from_millis(4);
        let output = machine.cycle(dt, request);
        watch
            .look(&mut machine)
            .map_err(|wrong| format!("at the end, {cycle}, {:?}: {wrong}", output.state))?;
        if cycle > 1140 && output.state == State::Disarmed && !machine.holds() {
            return Ok(states);
        }
    }
    Err(format!("it does not come to rest: {:?}", machine.guard.state()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(environment("VOLCOMP_SEQUENCES", 96)))]

    #[test]
    fn nothing_leaves_its_bounds(
        seed: u64,
        kind in prop::sample::select(KINDS.to_vec()),
        axes in prop::sample::select(vec![3_usize, 5]),
        ways in 1..=3_usize,
    ) {
        let cycles = environment("VOLCOMP_CYCLES", 2000);
        if let Err(wrong) = run(seed, kind, axes, ways, cycles) {
            prop_assert!(false, "{wrong}");
        }
    }
}

#[test]
fn sequences_visit_every_state() {
    for kind in KINDS {
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..60 {
            let (axes, ways) = (3 + 2 * (seed % 2), 1 + seed % 3);
            let states = run(seed as u64, kind, axes, ways, 4000).unwrap_or_default();
            seen.extend(states.into_iter().map(State::name));
        }
        let all = ["arming", "compensating", "disarmed", "faulted", "holding", "ramping-out"];
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), all, "{kind:?}");
    }
}

#[test]
fn sequences_that_once_failed() {
    for (seed, kind, axes, ways, cycles) in FAILED {
        assert_eq!(
            run(seed, kind, axes, ways, cycles).map(|_| ()),
            Ok(()),
            "{seed} {kind:?} {axes} {ways}"
        );
    }
}

const FAILED: [(u64, Kind, usize, usize, u32); 6] = [
    (15841279278081801058, Kind::Late, 5, 3, 700),
    (9344477052774393391, Kind::Lossy, 5, 3, 1000),
    (15637356826912720972, Kind::Lossy, 5, 3, 1000),
    (13427742941852155154, Kind::Lines, 5, 1, 1000),
    (2102507349263377414, Kind::Late, 5, 3, 1000),
    (9392928835973895512, Kind::Late, 3, 1, 1000),
];

const STANDBY_EVERY: Duration = Duration::from_millis(100);
/// Timeout after which the control of lines ramps to zero, and maximum duration of that ramp.
const LINES_TIME_OUT: ControlTimeOut =
    ControlTimeOut { after: Duration::from_millis(300), to_zero: Duration::from_millis(300) };
/// Observation time before the first write. During it, no other program may have changed a control without a barrier.
const WATCH: Duration = Duration::from_millis(700);
/// Maximum age of a reading.
const OLDEST: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Words with read-back at any delay; no write is lost.
    Late,
    /// Words with read-back within the delay of the path; any write may be lost.
    Lossy,
    /// Lines without read-back.
    Lines,
    /// Lines whose control ramps to zero when writes stop.
    LinesWithTimeOut,
    Barrier,
}

pub(crate) const KINDS: [Kind; 5] =
    [Kind::Late, Kind::Lossy, Kind::Lines, Kind::LinesWithTimeOut, Kind::Barrier];

/// One path to the control.
#[expect(clippy::struct_excessive_bools, reason = "separate faults")]
struct Way {
    read_back: ReadBack,
    online: bool,
    frozen_at: Option<Duration>,
    /// Values that the next reading reports instead of the applied correction.
    false_reading: Option<PerChannel<f64>>,
    /// Index of a word of the next report, and the bits to flip.
    flipped_word: Option<(usize, u16)>,
    late: Duration,
    hides_correction: bool,
    /// Writes are lost.
    loses: bool,
    /// Writes return an error, lost or not.
    fails: bool,
    reading: Option<Reading>,
    requested_at: Option<Duration>,
    sent: Option<Duration>,
}

struct Late {
    at: Duration,
    way: usize,
    words: Vec<u16>,
}

#[derive(Clone, Copy, Default)]
struct Channel {
    lost: f64,
    late: f64,
    doubled: f64,
    torn: f64,
}

pub(crate) struct Machine {
    pub(crate) kind: Kind,
    pub(crate) guard: Guard,
    limits: Limits,
    random: ChaCha8Rng,
    ways: Vec<Way>,
    selector: Selector,
    interlocks: Interlocks,
    pub(crate) now: Duration,
    scanned: Duration,
    barrier: Option<Barrier>,
    mailboxes: Vec<Vec<u16>>,
    in_transit: Vec<Late>,
    channel: Channel,
    /// Time and values of the last write to words or lines.
    got: Duration,
    written: PerChannel<f64>,
    pub(crate) applied: PerChannel<f64>,
    /// Largest possible correction of each axis when its limit was lowered or a foreign write occurred.
    beyond: PerChannel<f64>,
    /// Start times and values of applied corrections, for late readings.
    past: VecDeque<(Duration, PerChannel<f64>)>,
    requested: Option<RequestedCorrection>,
    positions: PerChannel<f64>,
    interlock: Interlock,
    really_includes: bool,
    forbids: Reasons,
    /// Readings are not delayed until this time, after a foreign change of the correction.
    prompt_until: Duration,
    pub(crate) seen: AxisMotion,
}

/// Motion of an axis since the last call.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AxisMotion {
    /// Largest change by one write or scan, as a fraction of the permitted change.
    pub(crate) step: f64,
    /// Largest correction after a write that increased it, as a fraction of its limit. For a correction beyond a
    /// lowered limit, or from a foreign write, the fraction refers to that correction.
    pub(crate) out: f64,
    pub(crate) not_finite: bool,
    /// A foreign change of the correction occurred.
    pub(crate) changed: bool,
    /// Limits changed, the gateway restarted, or another path took over, so that time windows restart.
    pub(crate) began: bool,
}

/// X, Y, Z and, with five axes, A and C: limits of 0.15 mm and 150 µrad, steps of 1 µm and 5 µrad.
fn full_limits(axes: usize) -> Limits {
    let mut limits = limits();
    limits.count = axes;
    for axis in limits.axes.iter_mut().skip(3) {
        *axis = AxisLimits {
            kind: AxisKind::Rotary,
            limit: 150e-6,
            warn: 100e-6,
            slew_per_s: 500e-6,
            accel_per_s2: 20e-3,
            resolution: 5e-6,
            ..*axis
        };
    }
    limits
}

fn layout(axes: usize) -> Layout {
    let all = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::A, AxisName::C];
    Layout::of(all.into_iter().take(axes)).expect("each once")
}

fn barrier(limits: &Limits, tick: u16, epoch: u16, applied: &PerChannel<f64>) -> Barrier {
    let counts = |i: usize, value: f64| {
        let axis = &limits.axes[i];
        let count = (value / axis.resolution).round();
        (-1000..1000_i16).find(|n| f64::from(*n) == count).expect("a small number")
    };
    let settings = Settings {
        axes: layout(limits.count),
        machine: MACHINE,
        limit: PerChannel::from_fn(|i| counts(i, limits.axes[i].limit)),
        // 1 mm/s and 2.5 mrad/s, at least twice the guard's slew.
        rate: PerChannel::from_fn(|i| if i < 3 { 2 } else { 1 }),
        step_scans: 1,
        hold_scans: 25,
        time_out_scans: 100,
    };
    let held = Counts::from_fn(|i| counts(i, applied[i]));
    Barrier::start(settings, epoch, tick, &held).expect("valid")
}

impl Machine {
    pub(crate) fn new(seed: u64, kind: Kind, axes: usize, ways: usize) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut limits = full_limits(axes);
        limits.read_back_cycles = random.random_range(1..6);
        if kind == Kind::Barrier {
            limits.read_back_cycles = limits.read_back_cycles.max(3);
        }
        let includes = random.random();
        for (i, axis) in limits.axes.iter_mut().enumerate() {
            axis.includes_correction = includes;
            limits.test_shift[i] = 5.0 * axis.resolution;
        }
        if random.random() {
            limits.test_shift = PerChannel::ZERO;
        }
        let now = Duration::from_secs(1);
        let (tick, epoch) = (random.random(), random.random());
        let barrier = (kind == Kind::Barrier)
            .then(|| barrier(&full_limits(axes), tick, epoch, &PerChannel::ZERO));
        let mut machine = Self {
            kind,
            guard: Guard::new(limits).expect("valid"),
            limits,
            random,
            ways: Vec::new(),
            selector: Selector::new(Duration::from_millis(500)),
            interlocks: Interlocks::default(),
            now,
            scanned: now,
            barrier,
            mailboxes: vec![Vec::new(); ways],
            in_transit: Vec::new(),
            channel: Channel::default(),
            got: now,
            written: PerChannel::ZERO,
            applied: PerChannel::ZERO,
            beyond: PerChannel::ZERO,
            past: VecDeque::from([(now, PerChannel::ZERO)]),
            requested: None,
            positions: PerChannel::ZERO,
            interlock: Interlock::default(),
            really_includes: includes,
            forbids: Reasons::NONE,
            prompt_until: now,
            seen: AxisMotion::default(),
        };
        machine.ways = (0..ways).map(|_| Way::new(machine.read_back(77))).collect();
        machine.requested = Some(machine.any_request());
        machine
    }

    fn read_back(&self, owner: u16) -> ReadBack {
        match self.kind {
            Kind::Late | Kind::Lossy => ReadBack::plain(WATCH),
            Kind::Lines => ReadBack::no_read_back(None),
            Kind::LinesWithTimeOut => ReadBack::no_read_back(Some(LINES_TIME_OUT)),
            Kind::Barrier => {
                ReadBack::barrier(BarrierLink::new(owner, MACHINE, layout(self.limits.count), SCAN))
            }
        }
    }

    fn axes(&self) -> core::ops::Range<usize> {
        0..self.limits.count
    }

    fn active(&self) -> usize {
        self.selector.active()
    }

    fn any_request(&mut self) -> RequestedCorrection {
        let count = self.limits.count;
        let random = &mut self.random;
        let mut requested = RequestedCorrection::default();
        let size = if random.random() { 0.3 } else { 0.03 };
        for i in 0..count {
            if i < 3 {
                requested.position[i] = random.random_range(-size..size);
            } else {
                requested.rotary[i] = random.random_range(-400e-6..400e-6);
                for l in 0..3 {
                    requested.follow[i][l] = random.random_range(-300.0..300.0);
                }
            }
        }
        requested
    }

    fn interlocked(&self) -> bool {
        self.interlock.is_set()
    }

    pub(crate) fn pass(&mut self, time: Duration) {
        self.now += time;
        while self.scanned + SCAN <= self.now {
            self.scanned += SCAN;
            self.scan();
        }
    }

    fn scan(&mut self) {
        let holds = self.interlocked();
        if self.kind == Kind::LinesWithTimeOut
            && self.scanned.saturating_sub(self.got) > LINES_TIME_OUT.after
        {
            // 0.15 mm and 150 µrad ramp to zero in less than the 300 ms of the ramp.
            let to_zero = PerChannel::from_fn(|i| {
                let step = self.limits.axes[i].resolution;
                let toward = (self.applied[i].abs() - step).max(0.0);
                toward.copysign(self.applied[i])
            });
            self.put(to_zero);
        }
        let Some(mut barrier) = self.barrier else {
            return;
        };
        let mut torn = None;
        for place in (0..self.in_transit.len()).rev() {
            if self.in_transit[place].at <= self.scanned {
                let Late { way, words, .. } = self.in_transit.swap_remove(place);
                if self.random.random_bool(self.channel.torn)
                    && self.mailboxes[way].len() == words.len()
                {
                    let cut = self.random.random_range(1..words.len());
                    self.mailboxes[way][..cut].copy_from_slice(&words[..cut]);
                    torn = Some((way, words));
                } else {
                    self.mailboxes[way] = words;
                }
            }
        }
        let before = barrier.memory().applied;
        let boxes: Vec<&[u16]> = self.mailboxes.iter().map(Vec::as_slice).collect();
        barrier.scan(&boxes, holds);
        if let Some((way, words)) = torn {
            self.mailboxes[way] = words;
        }
        self.barrier = Some(barrier);
        let after = barrier.memory().applied;
        for i in self.axes() {
            let moved = f64::from((after[i] - before[i]).abs());
            let most = if i < 3 { 2.0 } else { 1.0 };
            self.seen.step = self.seen.step.max(moved / if holds { 1e-9 } else { most });
            let limit = full_limits(self.limits.count).axes[i];
            let out = f64::from(after[i].abs()) * limit.resolution / limit.limit;
            self.seen.out = self.seen.out.max(out);
        }
        let resolution = |i: usize| self.limits.axes[i].resolution;
        self.put(PerChannel::from_fn(|i| f64::from(after[i]) * resolution(i)));
    }

    fn put(&mut self, values: PerChannel<f64>) {
        if values != self.applied {
            self.past.push_back((self.scanned.max(self.now), values));
        }
        if self.past.len() > 4000 {
            self.past.pop_front();
        }
        self.applied = values;
    }

    fn write(&mut self, values: PerChannel<f64>) {
        for i in self.axes() {
            let axis = &self.limits.axes[i];
            let moved = (values[i] - self.applied[i]).abs();
            let most = (axis.slew_per_s * PERIOD.as_secs_f64()).max(axis.resolution);
            self.seen.step = self.seen.step.max(moved / most);
            if values[i].abs() > self.applied[i].abs() + 1e-12 {
                let most = axis.limit.max(self.beyond[i]);
                self.seen.out = self.seen.out.max(values[i].abs() / most);
            }
            self.seen.not_finite |= !values[i].is_finite();
        }
        (self.got, self.written) = (self.now, values);
        self.put(values);
    }

    fn read(&mut self, index: usize, now: Duration) {
        // The response is late, within its deadline.
        let exchange = Duration::from_micros(self.random.random_range(0..1000));
        self.pass(exchange);
        let barrier = self.barrier;
        let late =
            if self.now < self.prompt_until { Duration::ZERO } else { self.ways[index].late };
        let then = self.now.saturating_sub(late);
        let past = self.past.iter().rev().find(|(since, _)| *since <= then);
        let applied = past.map_or(self.applied, |(_, values)| *values);
        let mut positions = self.positions;
        if self.really_includes {
            for (position, applied) in positions.iter_mut().zip(&self.applied) {
                *position += applied;
            }
        }
        let limits = *self.guard.limits();
        let way = &mut self.ways[index];
        way.requested_at = Some(now);
        let mut words = [0; REPORT_WORDS];
        let length = barrier.map_or(0, |barrier| barrier.report().encode(&mut words));
        if let Some((word, bits)) = way.flipped_word.take() {
            words[word % length.max(1)] ^= bits;
        }
        let false_reading = way.false_reading.take();
        let reported = if !way.online || way.hides_correction {
            CorrectionReport::Missing
        } else if barrier.is_some() {
            CorrectionReport::Barrier(&words[..length])
        } else if way.read_back.status().scheme == Scheme::NoReadBack {
            CorrectionReport::Missing
        } else {
            CorrectionReport::Values(false_reading.unwrap_or(applied))
        };
        way.read_back.receive(now, self.now, &reported, &limits);
        way.reading =
            way.online.then_some(Reading { taken: way.frozen_at.unwrap_or(self.now), positions });
        let interlock = way.online.then_some(self.interlock);
        self.interlocks.update(index, interlock);
    }

    /// Whether the applied correction is known when this path writes.
    fn is_ready(&self, index: usize) -> bool {
        let known = self.ways[index].read_back.status();
        if index == self.active() {
            return true;
        }
        if known.scheme != Scheme::NoReadBack {
            return known.confirmed.is_some();
        }
        let before = &self.ways[self.active()];
        let zero = before.read_back.zero_after_last_write(&self.limits);
        match before.sent {
            None => true,
            Some(sent) => zero.is_some_and(|wait| self.now.saturating_sub(sent) > wait),
        }
    }

    /// Selects the active path; returns true if it changed.
    fn select(&mut self, now: Duration) -> bool {
        let stays = matches!(self.guard.state(), State::Faulted(_))
            || !self.interlocks.reasons().is_empty();
        if self.ways.len() < 2 || stays {
            return false;
        }
        let health: Vec<PathHealth> = (0..self.ways.len())
            .map(|index| {
                let way = &self.ways[index];
                let age = |at: Duration| now.saturating_sub(at);
                let usable = match way.reading {
                    Some(reading) if index == self.active() => {
                        age(reading.taken) <= self.limits.hold
                    }
                    Some(_) => way.requested_at.is_some_and(|at| age(at) <= 3 * STANDBY_EVERY),
                    None => false,
                };
                PathHealth { usable, ready: self.is_ready(index) }
            })
            .collect();
        let choice = self.selector.choose(now, &health);
        if choice.switched {
            self.ways[choice.active].read_back.take_over(now, false);
            self.guard.take_path(self.limits, &same_places()).expect("valid");
            self.seen.began = true;
        }
        choice.switched
    }

    /// Suspends the program at random between two of its steps.
    fn may_stop(&mut self) {
        if self.random.random_range(0..800) == 0 {
            let most = if self.random.random() { 60 } else { 3000 };
            let stopped = Duration::from_millis(self.random.random_range(0..most));
            self.pass(stopped);
        }
    }

    pub(crate) fn cycle(&mut self, dt: Duration, request: Option<Request>) -> Output {
        self.pass(dt);
        let begun = self.now;
        self.read(self.active(), begun);
        self.may_stop();
        if request == Some(Request::Acknowledge) {
            self.interlocks.acknowledge();
            for way in &mut self.ways {
                way.read_back.acknowledge(begun);
            }
        }
        let switched = self.select(begun);
        if switched {
            self.read(self.active(), begun);
        }
        self.may_stop();
        let takes_over = (switched && self.guard.state().is_armed()).then_some(Request::TakeOver);
        let way = &self.ways[self.active()];
        let output = self.guard.cycle(&Inputs {
            now: begun,
            reading: way.reading,
            read_back: *way.read_back.status(),
            interlocks: self.interlocks.reasons(),
            requested: self.requested,
            fast_ramp_out: false,
            request: request.or(takes_over),
            forbids: self.forbids,
        });
        self.may_stop();
        self.send(&output);
        self.may_stop();
        let standby = (0..self.ways.len()).filter(|index| *index != self.active());
        let next = standby.min_by_key(|index| self.ways[*index].requested_at);
        if let Some(next) = next.filter(|next| {
            let requested_at = self.ways[*next].requested_at;
            requested_at.is_none_or(|at| begun.saturating_sub(at) >= STANDBY_EVERY)
        }) {
            self.read(next, begun);
        }
        output
    }

    fn send(&mut self, output: &Output) {
        if !output.write {
            return;
        }
        if self.guard.time_to_send(self.now).is_none() {
            self.guard.not_sent();
            return;
        }
        let (active, limits) = (self.active(), self.limits);
        let way = &mut self.ways[active];
        let has_no_read_back = way.read_back.status().scheme == Scheme::NoReadBack;
        let ok = way.online && !way.fails;
        // A failed write may have arrived, except on lines.
        let lands = way.online && !way.loses && (ok || !has_no_read_back);
        if self.barrier.is_some() {
            let mut words = [0; FRAME_WORDS];
            let frame = way.read_back.frame(&output.correction, &limits, &mut words);
            if let Some(length) = frame {
                self.post(active, words[..length].to_vec(), lands);
                // The frame may be in transit for any time.
                self.may_stop();
            }
        } else if lands {
            self.write(output.correction);
            self.may_stop();
        }
        let now = self.now;
        let way = &mut self.ways[active];
        way.sent = Some(now);
        way.read_back.sent(now, &output.correction, ok);
        if !ok {
            self.guard.not_sent();
        }
    }

    /// Sends a frame into the channel, which may deliver it after a cut and reconnect.
    fn post(&mut self, way: usize, words: Vec<u16>, lands: bool) {
        let now = self.now;
        let late = Duration::from_millis(self.random.random_range(0..1000));
        if self.random.random_bool(self.channel.doubled) {
            let words = words.clone();
            self.in_transit.push(Late { at: now + late, way, words });
        }
        let late = self.random.random_bool(self.channel.late) || (!lands && self.random.random());
        if self.random.random_bool(self.channel.lost) || (!lands && !late) {
            return;
        }
        let after = Duration::from_millis(self.random.random_range(0..1000));
        let at = if late { now + after } else { now };
        self.in_transit.push(Late { at, way, words });
    }

    pub(crate) fn next_dt(&mut self) -> Duration {
        let hangs = 40_000 * u64::from(self.random.random_range(0..300) == 0);
        Duration::from_micros(self.random.random_range(3000..5000) + hangs)
    }

    pub(crate) fn limits(&self) -> &Limits {
        &self.limits
    }

    pub(crate) fn holds(&self) -> bool {
        self.axes().any(|i| self.applied[i].abs() > 0.5 * self.limits.axes[i].resolution)
    }
}

impl Way {
    fn new(read_back: ReadBack) -> Self {
        Self {
            read_back,
            online: true,
            frozen_at: None,
            false_reading: None,
            flipped_word: None,
            late: Duration::ZERO,
            hides_correction: false,
            loses: false,
            fails: false,
            reading: None,
            requested_at: None,
            sent: None,
        }
    }
}

impl Machine {
    pub(crate) fn random_event(&mut self) -> Option<Request> {
        let index = self.random.random_range(0..self.ways.len());
        let now = self.now;
        match self.random.random_range(0..64) {
            0 | 1 => self.ways[index].online ^= true,
            2 => self.interlock.emergency_stop ^= true,
            3 => self.interlock.alarm ^= true,
            4 => self.interlock.unreferenced ^= true,
            5 => self.ways[index].frozen_at = self.ways[index].frozen_at.xor(Some(now)),
            6..10 => self.requested = Some(self.any_request()),
            10 => self.requested = None,
            11 => {
                let mut requested = self.any_request();
                requested.position[0] = f64::NAN;
                self.requested = Some(requested);
            }
            12 => {
                let is_nan = self.random.random();
                self.positions[0] = if is_nan { f64::NAN } else { f64::INFINITY };
            }
            13 => self.positions[0] = self.random.random_range(-1e3..1e3),
            14 => self.foreign_write(),
            15 => return Some(Request::Disarm),
            16 => return Some(Request::Switched),
            17 => return Some(Request::Acknowledge),
            18 => {
                self.forbids = if self.forbids.is_empty() { Reasons::AUDIT } else { Reasons::NONE }
            }
            19 => self.ways[index].loses = self.kind == Kind::Lossy || self.kind == Kind::Barrier,
            20 => {
                self.ways[index].fails = true;
                self.ways[index].loses = match self.kind {
                    Kind::Late => false,
                    Kind::Lines | Kind::LinesWithTimeOut => true,
                    Kind::Lossy | Kind::Barrier => self.random.random(),
                };
            }
            21 => self.ways[index].hides_correction ^= true,
            22 => self.really_includes ^= true,
            23..27 => self.falsify(index),
            27..31 => {
                let most = match self.kind {
                    Kind::Late => OLDEST,
                    Kind::Lossy => self.limits.delay(),
                    _ => Duration::ZERO,
                };
                self.ways[index].late = most.mul_f64(self.random.random());
            }
            31..34 => self.change_limits(),
            34 => self.power_up(),
            35 => self.restart(),
            36 => {
                let mut often = || [0.0, 0.05, 0.3][self.random.random_range(0..3)];
                self.channel =
                    Channel { lost: often(), late: often(), doubled: often(), torn: often() };
            }
            37..50 => return Some(Request::Arm),
            50..56 => self.all_is_well(),
            _ => {}
        }
        None
    }

    pub(crate) fn all_is_well(&mut self) {
        self.interlock = Interlock::default();
        self.channel = Channel::default();
        self.forbids = Reasons::NONE;
        self.positions[0] = 0.0;
        self.requested = Some(self.any_request());
        for way in &mut self.ways {
            (way.online, way.hides_correction, way.loses, way.fails) = (true, false, false, false);
            (way.frozen_at, way.false_reading, way.flipped_word) = (None, None, None);
        }
    }

    /// Ends all faults and delays, and restores the full limits.
    pub(crate) fn repair(&mut self) {
        self.all_is_well();
        for way in &mut self.ways {
            way.late = Duration::ZERO;
        }
        let full = full_limits(self.limits.count);
        for i in self.axes() {
            self.limits.axes[i] = AxisLimits {
                includes_correction: self.limits.axes[i].includes_correction,
                ..full.axes[i]
            };
        }
        self.limits.ramp = full.ramp;
        self.guard.set_limits(self.limits).expect("valid");
        (self.really_includes, self.seen.began) = (self.limits.axes[0].includes_correction, true);
    }

    /// Falsifies the next reading: torn, of another axis, NaN, or far off.
    fn falsify(&mut self, index: usize) {
        let mut false_reading = self.applied;
        match self.random.random_range(0..4) {
            0 => false_reading.swap(0, 1),
            1 => false_reading[0] += 0.256,
            2 => false_reading[0] = f64::NAN,
            _ => false_reading[0] = self.random.random_range(-70.0..70.0),
        }
        self.ways[index].false_reading = Some(false_reading);
        let bits = 1 << self.random.random_range(0..16_u16);
        self.ways[index].flipped_word = Some((self.random.random_range(0..REPORT_WORDS), bits));
    }

    /// A foreign change of the correction, followed by readings without delay.
    fn foreign_write(&mut self) {
        if self.kind != Kind::Lossy {
            return;
        }
        let mut values = PerChannel::ZERO;
        if self.random.random() {
            for i in self.axes() {
                let steps = f64::from(self.random.random_range(-40..40));
                values[i] = steps * self.limits.axes[i].resolution;
            }
        }
        self.seen.changed = true;
        self.prompt_until = self.now + Duration::from_secs(2);
        self.put(values);
        self.may_be_beyond();
    }

    fn may_be_beyond(&mut self) {
        for i in self.axes() {
            let axis = &self.limits.axes[i];
            let reach = (axis.slew_per_s * PERIOD.as_secs_f64()).max(axis.resolution);
            self.beyond[i] = self.applied[i].abs() + reach;
        }
    }

    fn change_limits(&mut self) {
        let full = full_limits(self.limits.count);
        for i in self.axes() {
            let mut part = |least: f64| {
                if self.random.random() { 1.0 } else { self.random.random_range(least..1.0) }
            };
            let axis = &mut self.limits.axes[i];
            axis.limit = (full.axes[i].limit * part(0.05)).max(6.0 * axis.resolution);
            axis.warn = 0.5 * axis.limit;
            axis.slew_per_s = full.axes[i].slew_per_s * part(0.02);
            axis.accel_per_s2 = [f64::INFINITY, full.axes[i].accel_per_s2 * part(0.01)]
                [usize::from(self.random.random::<bool>())];
        }
        self.may_be_beyond();
        self.seen.began = true;
        let ramp_ms = self.random.random_range(0..500);
        self.limits.ramp = Duration::from_millis(ramp_ms);
        self.guard.set_limits(self.limits).expect("valid");
    }

    /// Restarts the control; its words keep their values.
    fn power_up(&mut self) {
        if let Some(before) = self.barrier {
            let epoch = before.memory().link.epoch;
            let tick = self.random.random();
            let full = full_limits(self.limits.count);
            self.barrier = Some(barrier(&full, tick, epoch, &self.applied));
        }
    }

    fn restart(&mut self) {
        let has_no_read_back = matches!(self.kind, Kind::Lines | Kind::LinesWithTimeOut);
        if has_no_read_back && self.ways.len() > 1 {
            return;
        }
        let age = self.now.saturating_sub(self.got);
        let owner = self.random.random_range(1..60_000);
        self.seen.began = true;
        self.guard = Guard::new(self.limits).expect("valid");
        self.selector = Selector::new(Duration::from_millis(500));
        self.interlocks = Interlocks::default();
        for index in 0..self.ways.len() {
            let mut way = Way::new(self.read_back(owner));
            way.late = self.ways[index].late;
            way.online = self.ways[index].online;
            self.ways[index] = way;
        }
        if has_no_read_back {
            let values = self.written;
            self.ways[0].read_back.restore(self.now, &values, age, &self.limits);
        }
    }
}
