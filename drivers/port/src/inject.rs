//! Seeded fault injection. Wrap a device in [`Faulty`] to test the code that uses it. Faults occur with set
//! probabilities ([`Faults`]) or on request ([`Injection`]), also from another thread ([`Remote`]).
//!
//! | fault | models |
//! | --- | --- |
//! | `delay`, `jitter` | a busy network, a control that serves its own screen first |
//! | `drop` | a lost answer; the request did not arrive either |
//! | `corrupt` | a flipped bit, a position that is not a number |
//! | `freeze` | a module that answers from a cache: the whole answer is the last one, with its old time |
//! | `disconnect` | an unplugged cable, a control that reboots |
//! | `lie` | a wrong read-back: a torn word, garbage in a register, the word of another axis |
//! | `constant` | a read-back or report that never changes: a copy in the ladder that is no longer executed |
//! | `late_write` | a write that stays in a queue or an old socket and arrives long after it was abandoned |
//! | `double_write` | a request repeated by the network, or by a library that retries |
//! | `torn_write` | words that the control reads while they are being written |
//! | `reordered_write` | two writes on two paths, of which the first arrives last |
//! | `late_answer` | an answer that is late, but within the deadline: its content is already old |
//! | `frozen_positions` | an interpolator that has stopped, or a position that is not updated, with a fresh time |
//! | `stop_after_read`, `stop_before_write` | a paused program: a stopped process, a suspended virtual machine, swapped memory |
//! | `dropped_flag` | an interlock that is no longer reported: a broken wire, another layout of a status word |
//! | `flicker` | a position that toggles by one count at standstill |
//! | `lag` | positions that show a correction later than the read-back does |
//!
//! For a reading that never returns, use a [`Hanging`] controller.

use std::{
    fmt,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_vocabulary::PerChannel;

use crate::{
    Clock, Controller, ControllerState, Description, DigitalIo, Fault, InputLevels, Snapshot,
    Temperature, Thermometer, Words,
};

/// Maximum error of a wrong read-back, correction steps.
const MAX_ERROR_STEPS: f64 = 5000.0;
const MAX_QUEUED_INJECTIONS: usize = 64;
const MAX_LAG: usize = 64;
const LATE_WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Function that is called instead of waiting. Its argument is the duration of the wait.
type Pause = Box<dyn FnMut(Duration) + Send>;

/// Function that delivers a write to this type of device before a deadline.
type Deliver<D> = fn(&mut D, &Write, Instant) -> Result<(), Fault>;

pub struct Faulty<D> {
    pub device: D,
    /// Probabilities and sizes of random faults. They may be changed between calls.
    pub faults: Faults,
    random: ChaCha8Rng,
    pending: PendingFaults,
    frozen: u32,
    disconnected: u32,
    delayed: DelayedWrites,
    last_write: Option<Write>,
    clock: Clock,
    pause: Option<Pause>,
    injections: Arc<Mutex<Vec<Injection>>>,
    last_snapshot: Option<Snapshot>,
    last_true: Option<Snapshot>,
    positions: [PerChannel<f64>; MAX_LAG],
    readings: usize,
    last_levels: Option<InputLevels>,
    last_temperatures: Vec<Temperature>,
}

#[derive(Clone, Copy, Debug, Default)]
struct PendingFaults {
    lie: Option<(Lie, u32)>,
    constant: u32,
    /// Reading whose read-back or report the following readings repeat; `None` while no such fault is active.
    constant_of: Option<Snapshot>,
    late_write: Option<u32>,
    double_write: Option<u32>,
    torn_write: bool,
    reordered_write: bool,
    late_answer: Option<Duration>,
    frozen_positions: u32,
    frozen_at: Option<PerChannel<f64>>,
    /// Axis index, factor, offset (mm or rad), and number of remaining readings with a wrong position.
    wrong_position: Option<(usize, f64, f64, u32)>,
    stop_after_read: Option<Duration>,
    stop_before_write: Option<Duration>,
    dropped_flag: u32,
    flicker: Option<usize>,
    jump: Option<(usize, f64)>,
}

/// Handle for requesting faults of a [`Faulty`] device that has another owner, also on another thread.
#[derive(Clone, Debug)]
pub struct Remote(Arc<Mutex<Vec<Injection>>>);

impl Remote {
    /// Requests a fault. It is injected at the next call to which it applies. If 64 requests are queued, discards the
    /// request and returns `false`.
    pub fn inject(&self, injection: Injection) -> bool {
        let mut injections = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let room = injections.len() < MAX_QUEUED_INJECTIONS;
        if room {
            injections.push(injection);
        }
        room
    }
}

impl<D: fmt::Debug> fmt::Debug for Faulty<D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Faulty")
            .field("device", &self.device)
            .field("faults", &self.faults)
            .field("pending", &self.pending)
            .finish_non_exhaustive()
    }
}

impl<D> Faulty<D> {
    /// Wraps a device. The same seed yields the same faults.
    pub fn new(device: D, faults: Faults, seed: u64) -> Self {
        Self {
            device,
            faults,
            random: ChaCha8Rng::seed_from_u64(seed),
            pending: PendingFaults::default(),
            frozen: 0,
            disconnected: 0,
            delayed: DelayedWrites::default(),
            last_write: None,
            clock: Clock::system(),
            pause: None,
            injections: Arc::new(Mutex::new(Vec::with_capacity(MAX_QUEUED_INJECTIONS))),
            last_snapshot: None,
            last_true: None,
            positions: [PerChannel::ZERO; MAX_LAG],
            readings: 0,
            last_levels: None,
            last_temperatures: Vec::new(),
        }
    }

    /// Sets the clock for deadlines, delays and pauses. A manual clock is advanced instead of waiting.
    #[must_use]
    pub fn with_clock(mut self, clock: Clock) -> Self {
        self.clock = clock;
        self
    }

    /// Sets a function that is called instead of waiting. Its argument is the duration of a delay or of a pause of the
    /// program. Pauses also occur between a reading and the following write.
    #[must_use]
    pub fn with_pause(mut self, pause: impl FnMut(Duration) + Send + 'static) -> Self {
        self.pause = Some(Box::new(pause));
        self
    }

    /// Returns a handle for requesting faults while the device has another owner.
    pub fn remote(&self) -> Remote {
        Remote(Arc::clone(&self.injections))
    }

    /// Requests a fault. It is injected at the next call to which it applies.
    pub fn inject(&mut self, injection: Injection) {
        let pending = &mut self.pending;
        match injection {
            Injection::Lie { lie, readings } => pending.lie = Some((lie, readings)),
            Injection::Constant { readings } => {
                (pending.constant, pending.constant_of) = (readings, None);
            }
            Injection::LateWrite { calls } => pending.late_write = Some(calls),
            Injection::DoubleWrite { calls } => pending.double_write = Some(calls),
            Injection::TornWrite => pending.torn_write = true,
            Injection::ReorderedWrite => pending.reordered_write = true,
            Injection::LateAnswer(time) => pending.late_answer = Some(time),
            Injection::FrozenPositions { readings } => {
                (pending.frozen_positions, pending.frozen_at) = (readings, None);
            }
            Injection::WrongPosition { axis, factor, add, readings } => {
                pending.wrong_position = (readings > 0).then_some((axis, factor, add, readings));
            }
            Injection::StopAfterRead(time) => pending.stop_after_read = Some(time),
            Injection::StopBeforeWrite(time) => pending.stop_before_write = Some(time),
            Injection::DroppedFlag { readings } => pending.dropped_flag = readings,
            Injection::Flicker { axis } => pending.flicker = Some(axis),
            Injection::Lag(readings) => self.faults.lag = readings,
            Injection::Disconnect { calls } => self.disconnected = calls,
            Injection::Jump { sensor, kelvin } => pending.jump = Some((sensor, kelvin)),
            Injection::Release => self.delayed.release(),
            Injection::Faults(faults) => self.faults = faults,
        }
    }

    fn occurs(&mut self, chance: f64) -> bool {
        chance > 0.0 && self.random.random::<f64>() < chance
    }

    /// Takes over the requests of [`Remote`] handles. If a handle holds the lock, the next call takes them over.
    fn take_injections(&mut self) {
        let injections = Arc::clone(&self.injections);
        if let Ok(mut injections) = injections.try_lock() {
            for index in 0..injections.len() {
                self.inject(injections[index]);
            }
            injections.clear();
        }
    }

    /// Draws the duration or delay of a fault, 1 to `calls` calls.
    fn calls(&mut self) -> u32 {
        self.random.random_range(1..=self.faults.calls.max(1))
    }

    fn stop_time(&mut self) -> Duration {
        self.faults.stop.mul_f64(self.random.random::<f64>())
    }

    fn pass_time(&mut self, time: Duration) {
        match (&mut self.pause, &self.clock) {
            (Some(pause), _) => pause(time),
            (None, Clock::Manual(..)) => self.clock.advance(time),
            (None, Clock::System(_)) => std::thread::sleep(time),
        }
    }

    /// Injects a disconnection, delay or loss before the exchange with the device.
    fn before(&mut self, deadline: Instant) -> Result<(), Fault> {
        self.take_injections();
        if self.disconnected == 0 && self.occurs(self.faults.disconnect) {
            self.disconnected = self.faults.calls;
        }
        if self.disconnected > 0 {
            self.disconnected -= 1;
            return Err(Fault::NotConnected);
        }
        if !self.faults.delay.is_zero() {
            let share = if self.faults.jitter { self.random.random::<f64>() } else { 1.0 };
            let left = deadline.saturating_duration_since(self.clock.now());
            let delay = self.faults.delay.mul_f64(share);
            self.pass_time(delay.min(left));
            if delay >= left {
                return Err(Fault::TimedOut);
            }
        }
        if self.occurs(self.faults.drop) {
            return Err(Fault::TimedOut);
        }
        Ok(())
    }

    fn is_frozen(&mut self) -> bool {
        if self.frozen == 0 && self.occurs(self.faults.freeze) {
            self.frozen = self.faults.calls;
        }
        let frozen = self.frozen > 0;
        self.frozen = self.frozen.saturating_sub(1);
        frozen
    }

    fn broken_number(&mut self, number: f64) -> f64 {
        match self.random.random_range(0..4) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => -number - 1.0,
            _ => number + self.random.random_range(-1e4..1e4),
        }
    }

    fn draw_reading(&mut self, axes: usize) {
        if self.occurs(self.faults.lie) {
            let lie = Lie::ALL[self.random.random_range(0..Lie::ALL.len())];
            self.inject(Injection::Lie { lie, readings: 1 });
        }
        if self.pending.constant == 0 && self.occurs(self.faults.constant) {
            let readings = self.calls();
            self.inject(Injection::Constant { readings });
        }
        if self.pending.frozen_positions == 0 && self.occurs(self.faults.frozen_positions) {
            let readings = self.calls();
            self.inject(Injection::FrozenPositions { readings });
        }
        if self.pending.dropped_flag == 0 && self.occurs(self.faults.dropped_flag) {
            let readings = self.calls();
            self.inject(Injection::DroppedFlag { readings });
        }
        if self.occurs(self.faults.flicker) {
            let axis = self.random.random_range(0..axes.max(1));
            self.inject(Injection::Flicker { axis });
        }
    }

    /// If a late answer was drawn or requested, waits for its delay, although the device has already answered. Returns
    /// the delay.
    fn delay_response(&mut self, deadline: Instant) -> Duration {
        let left = deadline.saturating_duration_since(self.clock.now());
        let most = left.mul_f64(0.9);
        if self.occurs(self.faults.late_answer) {
            self.pending.late_answer = Some(most.mul_f64(self.random.random::<f64>()));
        }
        let Some(late) = self.pending.late_answer.take() else {
            return Duration::ZERO;
        };
        let late = late.min(most);
        self.pass_time(late);
        late
    }

    /// Pauses the program after a reading, if a pause was drawn or requested.
    fn after_reading(&mut self) {
        if self.occurs(self.faults.stop_after_read) {
            self.pending.stop_after_read = Some(self.stop_time());
        }
        if let Some(time) = self.pending.stop_after_read.take() {
            self.pass_time(time);
        }
    }

    fn deliver_due(&mut self, deliver: Deliver<D>) {
        self.delayed.pass();
        self.deliver_delayed(deliver, false);
    }

    fn deliver_delayed(&mut self, deliver: Deliver<D>, written: bool) {
        while let Some(write) = self.delayed.take(written) {
            // The answer is discarded, because no caller waits for it.
            let _ = deliver(&mut self.device, &write, Instant::now() + LATE_WRITE_TIMEOUT);
        }
    }

    fn send(&mut self, write: Write, deadline: Instant, deliver: Deliver<D>) -> Result<(), Fault> {
        self.before(deadline)?;
        if self.occurs(self.faults.stop_before_write) {
            self.pending.stop_before_write = Some(self.stop_time());
        }
        if let Some(time) = self.pending.stop_before_write.take() {
            let left = deadline.saturating_duration_since(self.clock.now());
            self.pass_time(time);
            if time >= left {
                // Drivers never send a write whose deadline has passed.
                return Err(Fault::TimedOut);
            }
        }
        self.deliver_due(deliver);
        self.draw_write();
        let before = self.last_write.replace(write);
        if let Some(calls) = self.pending.late_write.take() {
            return match self.delayed.keep(write, calls) {
                Some(write) => deliver(&mut self.device, &write, deadline),
                None => Ok(()),
            };
        }
        if std::mem::take(&mut self.pending.reordered_write) {
            return match self.delayed.keep_for_next(write) {
                Some(write) => deliver(&mut self.device, &write, deadline),
                None => Ok(()),
            };
        }
        let mut sent = write;
        if std::mem::take(&mut self.pending.torn_write) && self.delayed.keep(write, 1).is_none() {
            let cut = self.random.random::<f64>();
            sent = write.torn(before.as_ref(), cut);
        }
        let result = deliver(&mut self.device, &sent, deadline);
        self.deliver_delayed(deliver, true);
        if let Some(calls) = self.pending.double_write.take() {
            // If the queue is full, both copies are delivered at once.
            if let Some(write) = self.delayed.keep(write, calls) {
                let _ = deliver(&mut self.device, &write, deadline);
            }
        }
        result
    }

    fn draw_write(&mut self) {
        if self.occurs(self.faults.late_write) {
            let calls = self.calls();
            self.inject(Injection::LateWrite { calls });
        }
        if self.occurs(self.faults.double_write) {
            let calls = self.calls();
            self.inject(Injection::DoubleWrite { calls });
        }
        if self.occurs(self.faults.torn_write) {
            self.inject(Injection::TornWrite);
        }
        if self.occurs(self.faults.reordered_write) {
            self.inject(Injection::ReorderedWrite);
        }
    }
}

fn deliver_to_controller<C: Controller>(
    device: &mut C,
    write: &Write,
    deadline: Instant,
) -> Result<(), Fault> {
    match write {
        Write::Frame(frame) => device.post(frame, deadline),
        Write::Values(values) => device.apply(values, deadline),
        Write::Levels(_) => Ok(()),
    }
}

impl<C: Controller> Controller for Faulty<C> {
    fn description(&self) -> &Description {
        self.device.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.before(deadline)?;
        self.deliver_due(deliver_to_controller);
        if self.is_frozen()
            && let Some(last) = self.last_snapshot
        {
            return Ok(last);
        }
        let mut snapshot = self.device.read(deadline)?;
        let late = self.delay_response(deadline);
        // Like drivers, take the middle of the exchange as the time of the reading.
        snapshot.taken += late / 2;
        snapshot.state_taken += late / 2;
        snapshot.correction_taken += late / 2;
        snapshot.uncertainty += late / 2;
        self.last_snapshot = Some(snapshot);
        let axes = self.device.description().axes.len().max(1);
        if self.occurs(self.faults.corrupt) {
            let axis = self.random.random_range(0..axes);
            snapshot.positions[axis] = self.broken_number(snapshot.positions[axis]);
        }
        self.draw_reading(axes);
        self.spoil_positions(&mut snapshot);
        self.spoil_read_back(&mut snapshot, axes);
        if self.pending.dropped_flag > 0 {
            self.pending.dropped_flag -= 1;
            snapshot.state =
                ControllerState { referenced: true, alarm: false, emergency_stop: false };
        }
        self.after_reading();
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.send(Write::Frame(*frame), deadline, deliver_to_controller)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.send(Write::Values(*corrections), deadline, deliver_to_controller)
    }
}

impl<C: Controller> Faulty<C> {
    fn spoil_positions(&mut self, snapshot: &mut Snapshot) {
        self.positions[self.readings % MAX_LAG] = snapshot.positions;
        let lag = usize::try_from(self.faults.lag).unwrap_or(MAX_LAG);
        let lag = lag.min(MAX_LAG - 1).min(self.readings);
        snapshot.positions = self.positions[(self.readings - lag) % MAX_LAG];
        self.readings += 1;
        if self.pending.frozen_positions > 0 {
            self.pending.frozen_positions -= 1;
            let frozen = self.pending.frozen_at.get_or_insert(snapshot.positions);
            snapshot.positions = *frozen;
        } else {
            self.pending.frozen_at = None;
        }
        if let Some((axis, factor, add, readings)) = self.pending.wrong_position {
            if let Some(position) = snapshot.positions.get_mut(axis) {
                *position = *position * factor + add;
            }
            let left = readings - 1;
            self.pending.wrong_position = (left > 0).then_some((axis, factor, add, left));
        }
        if let Some(index) = self.pending.flicker.take()
            && let Some(axis) = self.device.description().axes.get(index)
        {
            snapshot.positions[index] += axis.step();
        }
    }

    fn spoil_read_back(&mut self, snapshot: &mut Snapshot, axes: usize) {
        let before = self.last_true.replace(*snapshot).unwrap_or(*snapshot);
        if self.pending.constant > 0 {
            self.pending.constant -= 1;
            let of = self.pending.constant_of.get_or_insert(*snapshot);
            (snapshot.applied, snapshot.report) = (of.applied, of.report);
        }
        let Some((lie, readings)) = self.pending.lie else {
            return;
        };
        self.pending.lie = (readings > 1).then(|| (lie, readings - 1));
        if readings == 0 {
            return;
        }
        let [one, other] = self.two_of(axes);
        if let Some(applied) = &mut snapshot.applied {
            match lie {
                Lie::Value => {
                    let step =
                        self.device.description().axes.get(one).map_or(0.0, crate::Axis::step);
                    let steps = self.random.random_range(1.0..MAX_ERROR_STEPS).round();
                    let sign = if self.random.random() { 1.0 } else { -1.0 };
                    applied[one] += sign * steps * step;
                }
                Lie::NotANumber => applied[one] = f64::NAN,
                Lie::OtherAxis => applied.swap(one, other),
                Lie::Torn => applied[one] = before.applied.map_or(0.0, |before| before[one]),
                Lie::Zero => *applied = PerChannel::ZERO,
            }
        }
        if let Some(report) = &mut snapshot.report {
            let [one, other] = self.two_of(report.as_slice().len());
            let words = report.as_mut_slice();
            match lie {
                Lie::Value => {
                    if let Some(word) = words.get_mut(one) {
                        *word = self.random.random();
                    }
                }
                Lie::NotANumber => words.fill(u16::MAX),
                Lie::OtherAxis => {
                    if one < words.len() && other < words.len() {
                        words.swap(one, other);
                    }
                }
                Lie::Torn => {
                    let old = before.report.unwrap_or_default();
                    let rest = words.iter_mut().zip(old.as_slice()).skip(one + 1);
                    rest.for_each(|(word, old)| *word = *old);
                }
                Lie::Zero => words.fill(0),
            }
        }
    }

    /// Draws two indices below `count`. They differ if `count` is at least 2.
    fn two_of(&mut self, count: usize) -> [usize; 2] {
        let count = count.max(1);
        let one = self.random.random_range(0..count);
        let further = self.random.random_range(0..(count - 1).max(1)) + 1;
        [one, (one + further) % count]
    }
}

fn deliver_to_lines<D: DigitalIo>(
    device: &mut D,
    write: &Write,
    deadline: Instant,
) -> Result<(), Fault> {
    match write {
        Write::Levels(levels) => device.write(*levels, deadline),
        Write::Frame(_) | Write::Values(_) => Ok(()),
    }
}

impl<D: DigitalIo> DigitalIo for Faulty<D> {
    fn device(&self) -> &str {
        self.device.device()
    }

    fn inputs(&self) -> u32 {
        self.device.inputs()
    }

    fn outputs(&self) -> u32 {
        self.device.outputs()
    }

    fn shortest_cycle(&self) -> Duration {
        self.device.shortest_cycle() + self.faults.delay
    }

    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault> {
        self.before(deadline)?;
        self.deliver_due(deliver_to_lines);
        let frozen = self.is_frozen();
        let mut found = match self.last_levels {
            Some(last) if frozen => last,
            _ => {
                let found = self.device.read(deadline)?;
                self.delay_response(deadline);
                found
            }
        };
        self.last_levels = Some(found);
        if self.occurs(self.faults.corrupt) {
            found.levels ^= 1 << self.random.random_range(0..self.device.inputs().clamp(1, 64));
        }
        self.after_reading();
        Ok(found)
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        self.send(Write::Levels(levels), deadline, deliver_to_lines)
    }

    fn confirmed(&self) -> Option<u64> {
        self.device.confirmed()
    }

    fn reports_outputs(&self) -> bool {
        self.device.reports_outputs()
    }
}

impl<T: Thermometer> Thermometer for Faulty<T> {
    fn device(&self) -> &str {
        self.device.device()
    }

    fn names(&self) -> &[String] {
        self.device.names()
    }

    fn latest(&mut self) -> &[Temperature] {
        self.take_injections();
        if self.is_frozen() && !self.last_temperatures.is_empty() {
            return &self.last_temperatures;
        }
        self.last_temperatures.clear();
        let latest = self.device.latest();
        self.last_temperatures.extend_from_slice(latest);
        if self.occurs(self.faults.corrupt) && !self.last_temperatures.is_empty() {
            let sensor = self.random.random_range(0..self.last_temperatures.len());
            let degc = self.last_temperatures[sensor].degc.unwrap_or(20.0);
            self.last_temperatures[sensor].degc = Some(self.broken_number(degc));
        }
        if let Some((sensor, kelvin)) = self.pending.jump
            && let Some(Temperature { degc: Some(degc), .. }) =
                self.last_temperatures.get_mut(sensor)
        {
            *degc += kelvin;
        }
        &self.last_temperatures
    }
}

/// Probabilities of the faults per call, 0 to 1, and the size of the faults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Faults {
    /// Delay of every call. With `jitter` it is the maximum delay.
    pub delay: Duration,
    /// Whether the delay of each call is drawn uniformly from 0 to `delay`.
    pub jitter: bool,
    /// Probability that a call times out and its request does not reach the device.
    pub drop: f64,
    /// Probability that one number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// Probability that this answer and the next ones, `calls` answers in total, repeat the previous answer.
    pub freeze: f64,
    /// Probability that this call and the next ones, `calls` calls in total, find no connection.
    pub disconnect: f64,
    /// Duration of a freeze or disconnection, calls. For every other lasting fault, the maximum of the drawn duration
    /// or delay.
    pub calls: u32,
    /// Probability that the read-back of one reading is wrong, by one of the kinds of [`Lie`].
    pub lie: f64,
    /// Probability that this reading and the next ones, up to `calls` readings in total, show the read-back or the
    /// barrier's report of this reading.
    pub constant: f64,
    /// Probability that the call of a write succeeds, but the write is delivered only after up to `calls` further
    /// calls, even if the connection was lost in between.
    pub late_write: f64,
    /// Probability that a write is delivered at once, and a second time after up to `calls` further calls.
    pub double_write: f64,
    /// Probability that only some words or axes of a write are delivered. The rest follows with the next call.
    pub torn_write: f64,
    /// Probability that a write is delivered after the next write.
    pub reordered_write: f64,
    /// Probability that an answer arrives late, after up to 90 % of the time left before the deadline.
    pub late_answer: f64,
    /// Probability that this reading and the next ones, up to `calls` readings in total, show the positions of this
    /// reading with fresh times.
    pub frozen_positions: f64,
    /// Probability that the whole program pauses for up to `stop` after a reading.
    pub stop_after_read: f64,
    /// Probability that the whole program pauses for up to `stop` between the call of a write and its transmission.
    pub stop_before_write: f64,
    /// Maximum duration of the pauses of the program.
    pub stop: Duration,
    /// Probability that up to `calls` readings, starting with this one, report: referenced, no alarm, no emergency
    /// stop.
    pub dropped_flag: f64,
    /// Probability that the position of one axis is one correction step too large in one reading.
    pub flicker: f64,
    /// Number of readings by which positions lag, with fresh times; at most 63.
    pub lag: u32,
}

/// Kind of a wrong read-back. If the control has a barrier, the words of its report are corrupted, which its checksum
/// must reveal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Lie {
    /// One axis is off by up to 5000 steps, or one word is random.
    Value,
    /// One axis is NaN, or all words are 65535.
    NotANumber,
    /// Two axes, or two words, are exchanged.
    OtherAxis,
    /// Some axes or words have the values of the previous reading.
    Torn,
    /// All axes, or words, are zero.
    Zero,
}

impl Lie {
    pub const ALL: [Self; 5] =
        [Self::Value, Self::NotANumber, Self::OtherAxis, Self::Torn, Self::Zero];
}

/// A requested fault. It is injected at the next call to which it applies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Injection {
    /// The next `readings` readings show a wrong read-back.
    Lie { lie: Lie, readings: u32 },
    /// The next `readings` readings show the read-back of the first of these readings.
    Constant { readings: u32 },
    /// The next write is delivered after `calls` further calls on an open connection.
    LateWrite { calls: u32 },
    /// The next write is delivered at once, and a second time after `calls` further calls.
    DoubleWrite { calls: u32 },
    /// Only a part of the next write is delivered. The rest follows with the next call.
    TornWrite,
    /// The next write is delivered after the write that follows it.
    ReorderedWrite,
    /// The next answer is delayed by this time, but arrives before the deadline.
    LateAnswer(Duration),
    /// The next `readings` readings show the positions of the first of these readings.
    FrozenPositions { readings: u32 },
    /// The next `readings` readings report a wrong position of one axis, as after a jump or in another unit.
    WrongPosition {
        axis: usize,
        /// Factor by which the position is multiplied.
        factor: f64,
        /// Offset added after the multiplication, mm or rad.
        add: f64,
        readings: u32,
    },
    /// The program pauses for this time after the next reading.
    StopAfterRead(Duration),
    /// The program pauses for this time before the next write is sent.
    StopBeforeWrite(Duration),
    /// The next `readings` readings report: referenced, no alarm, no emergency stop.
    DroppedFlag { readings: u32 },
    /// The next reading shows the position of this axis one correction step too large.
    Flicker { axis: usize },
    /// From now on, positions lag by this number of readings, at most 63.
    Lag(u32),
    /// The next `calls` calls find no connection.
    Disconnect { calls: u32 },
    /// From now on, the temperature of one sensor of a thermometer is wrong by this offset. An offset of 0 K ends the
    /// fault.
    Jump {
        sensor: usize,
        /// Offset of the temperature, K.
        kelvin: f64,
    },
    /// The next call on an open connection delivers all delayed writes.
    Release,
    /// Replaces the probabilities and sizes of random faults.
    Faults(Faults),
}

/// Maximum number of delayed writes. Further writes are delivered at once.
const MAX_DELAYED: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Write {
    Frame(Words),
    Values(PerChannel<f64>),
    Levels(u64),
}

impl Write {
    /// Combines the first part of this write with the rest of the previous write, as a control reads them in the middle
    /// of the write. `cut` is the fraction of this write that belongs to the first part, 0 to 1.
    fn torn(&self, before: Option<&Self>, cut: f64) -> Self {
        match (*self, before) {
            (Self::Frame(new), Some(Self::Frame(old))) => {
                let mut mixed = new;
                let at = cut_index(cut, mixed.as_slice().len());
                let rest = mixed.as_mut_slice().iter_mut().zip(old.as_slice());
                rest.skip(at).for_each(|(word, old)| *word = *old);
                Self::Frame(mixed)
            }
            (Self::Frame(new), _) => {
                let mut mixed = new;
                let at = cut_index(cut, mixed.as_slice().len());
                mixed.as_mut_slice().iter_mut().skip(at).for_each(|word| *word = 0);
                Self::Frame(mixed)
            }
            (Self::Values(new), before) => {
                let old = match before {
                    Some(Self::Values(old)) => *old,
                    _ => PerChannel::ZERO,
                };
                let at = cut_index(cut, 3);
                Self::Values(PerChannel::from_fn(|i| if i < at { new[i] } else { old[i] }))
            }
            (Self::Levels(new), before) => {
                let old = match before {
                    Some(Self::Levels(old)) => *old,
                    _ => 0,
                };
                let first = (1_u64 << cut_index(cut, 16)) - 1;
                Self::Levels(new & first | old & !first)
            }
        }
    }
}

/// Number of elements before the cut. It is at least 1 and below `count`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a few words"
)]
fn cut_index(cut: f64, count: usize) -> usize {
    ((cut.clamp(0.0, 1.0) * count as f64) as usize).clamp(1, count.saturating_sub(1).max(1))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Due {
    After(u32),
    NextWrite,
}

/// The delayed writes. Their order has no meaning, because free slots are reused.
#[derive(Clone, Copy, Debug, Default)]
struct DelayedWrites([Option<(Write, Due)>; MAX_DELAYED]);

impl DelayedWrites {
    /// Delays a write by a number of calls, at least 1. Returns the write if the queue is full.
    fn keep(&mut self, write: Write, calls: u32) -> Option<Write> {
        self.put(write, Due::After(calls.max(1)))
    }

    /// Delays a write until the next write was delivered. Returns the write if the queue is full.
    fn keep_for_next(&mut self, write: Write) -> Option<Write> {
        self.put(write, Due::NextWrite)
    }

    fn put(&mut self, write: Write, due: Due) -> Option<Write> {
        match self.0.iter_mut().find(|slot| slot.is_none()) {
            Some(slot) => {
                *slot = Some((write, due));
                None
            }
            None => Some(write),
        }
    }

    /// Counts a call that reached the device. Writes that are delayed by a number of calls may become due with this
    /// call.
    fn pass(&mut self) {
        for (_, due) in self.0.iter_mut().flatten() {
            if let Due::After(calls) = due {
                *calls = calls.saturating_sub(1);
            }
        }
    }

    fn release(&mut self) {
        for (_, due) in self.0.iter_mut().flatten() {
            *due = Due::After(0);
        }
    }

    /// Removes and returns one write that is due; `None` if no write is due. `written` means that a write has just been
    /// delivered, which makes the writes due that are delayed until the next write.
    fn take(&mut self, written: bool) -> Option<Write> {
        let due = |slot: &&mut Option<(Write, Due)>| match slot {
            Some((_, Due::After(calls))) => *calls == 0,
            Some((_, Due::NextWrite)) => written,
            None => false,
        };
        let (write, _) = self.0.iter_mut().find(due)?.take()?;
        Some(write)
    }
}

/// Interval at which a blocked reading checks its switch.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// A controller whose readings block while its switch is on, regardless of their deadline, like a hanging driver or
/// system call. Writes do not block.
pub struct Hanging<C> {
    inner: C,
    switch: HangSwitch,
}

/// Switch of a [`Hanging`] controller, usable from any thread.
#[derive(Clone, Debug, Default)]
pub struct HangSwitch(Arc<AtomicBool>);

impl HangSwitch {
    pub fn set(&self, hangs: bool) {
        self.0.store(hangs, Ordering::Relaxed);
    }

    fn is_on(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl<C> Hanging<C> {
    /// Wraps a controller whose readings block while `switch` is on.
    pub fn new(inner: C, switch: &HangSwitch) -> Self {
        Self { inner, switch: switch.clone() }
    }
}

impl<C: Controller> Controller for Hanging<C> {
    fn description(&self) -> &Description {
        self.inner.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        while self.switch.is_on() {
            thread::sleep(LOOK_EVERY);
        }
        self.inner.read(deadline)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.inner.post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.inner.apply(corrections, deadline)
    }
}
