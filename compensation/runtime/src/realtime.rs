//! The control thread, which owns the cycle, and its lock-free queues to other threads.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rtrb::{Consumer, Producer, RingBuffer};
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use volcomp_guard::{Limits, Reasons, Request, State};
use volcomp_port::Clock;

use crate::{
    clock::{Deadlines, monotonic, thread_time},
    cycle::{Cycle, CycleDurations},
    error::{OrderRefusal, StartError},
    model::Replacement,
    report::{Change, CycleInput, Report, Timing},
    settings::Realtime,
};

/// Capacity of the queue of cycle times; further times are lost.
const TIMINGS: usize = 8192;
const OVERRUN_REPORTED_FOR: Duration = Duration::from_secs(2);
/// Time after which a request that the thread has not received expires.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(1);

/// Size of the stack that is touched before the loop begins, so that no page fault occurs later, bytes.
const STACK: usize = 256 * 1024;

const DEGREE: usize = 511;

/// Order to the control thread.
pub enum Order {
    /// Passes a request to the guard, such as arming.
    Request(Request),
    /// Replaces the model; the correction ramps to the new one.
    Model(Box<Replacement>),
    /// Replaces the limits of the path at this index.
    Limits(usize, Box<Limits>),
}

struct QueuedOrder {
    order: Order,
    until: Instant,
    /// Number of disarm orders when the request was made: a request to arm is dropped if a disarm order followed it.
    disarms: u64,
}

/// Access to the control thread. Only [`stop`](Self::stop) and [`stop_within`](Self::stop_within) wait for the thread.
pub struct Handle {
    orders: Producer<QueuedOrder>,
    retired: Consumer<Retired>,
    timings: Consumer<Timing>,
    changes: Consumer<Change>,
    refusals: Consumer<OrderRefusal>,
    reports: triple_buffer::Output<Report>,
    shared: Arc<Shared>,
    pulse: Pulse,
    /// `None` if the thread was joined, or if a test runs the cycles.
    thread: Option<JoinHandle<()>>,
    is_manual: bool,
}

/// Object that the control thread returns to be freed, because it must not free memory itself.
enum Retired {
    Model(#[expect(dead_code, reason = "kept to be dropped")] Box<Replacement>),
    Limits(#[expect(dead_code, reason = "kept to be dropped")] Box<Limits>),
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    forbids: AtomicU64,
    notes: AtomicU64,
    cycles: AtomicU64,
    disarms: AtomicU64,
    /// Whether disarming was ordered because the program ends.
    ends: AtomicBool,
    /// End of the last cycle, ns on the clock of the cycle; before the first cycle, the start of the thread.
    cycle_done_ns: AtomicU64,
}

/// Orders disarming without waiting: it needs no queue, no lock, and no thread other than the control thread. Clones can be used on any
/// thread.
#[derive(Clone)]
pub struct DisarmSwitch(Arc<Shared>);

impl DisarmSwitch {
    /// Disarms from the next cycle on. Earlier requests to arm are dropped.
    pub fn disarm(&self) {
        self.0.disarms.fetch_add(1, Ordering::Relaxed);
    }

    /// Disarms from the next cycle on because the program ends. A correction that was found at the start and never written is left
    /// unchanged.
    pub fn end(&self) {
        self.0.ends.store(true, Ordering::Relaxed);
        // Release ordering: a thread that reads the new count also reads `ends`.
        self.0.disarms.fetch_add(1, Ordering::Release);
    }

    /// Number of disarm orders so far.
    pub fn count(&self) -> u64 {
        self.0.disarms.load(Ordering::Relaxed)
    }
}

/// Heartbeat of the control thread, which shows other threads that it runs.
#[derive(Clone)]
pub struct Pulse {
    shared: Arc<Shared>,
    clock: Clock,
    period: Duration,
}

impl Pulse {
    /// Minimum of [`patience`](Self::patience), however short the period is: schedulers and exchanges with
    /// controllers occasionally take that long.
    pub const JITTER: Duration = Duration::from_millis(100);

    /// Time since the end of the last cycle, or since the start of the thread before the first one.
    pub fn age(&self) -> Duration {
        // Before the time of the cycle: if this thread is suspended in between, cycles go on, and none is missing.
        let now = self.clock.elapsed();
        now.saturating_sub(Duration::from_nanos(self.shared.cycle_done_ns.load(Ordering::Relaxed)))
    }

    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Maximum time between cycles up to which the last report counts as valid: three periods, at least [`JITTER`](Self::JITTER).
    pub fn patience(&self) -> Duration {
        (self.period * 3).max(Self::JITTER)
    }

    /// Time since the last cycle if it exceeds [`patience`](Self::patience), otherwise `None`.
    pub fn silence(&self) -> Option<Duration> {
        Some(self.age()).filter(|age| *age > self.patience())
    }
}

impl Handle {
    /// Sends an order. A request expires after a second; a request to arm is also dropped if disarming is ordered
    /// meanwhile. Returns `false`, and drops the order, if the queue is full.
    #[must_use = "report a rejected order to its sender"]
    pub fn send(&mut self, order: Order) -> bool {
        let disarms = self.shared.disarms.load(Ordering::Relaxed);
        self.send_by(order, self.clock().now() + REQUEST_TIMEOUT, disarms)
    }

    /// Sends an order. A request expires at `until`; a request to arm is dropped if more than `disarms` disarm orders were given. Returns
    /// `false` like [`send`](Self::send).
    #[must_use = "report a rejected order to its sender"]
    pub fn send_by(&mut self, order: Order, until: Instant, disarms: u64) -> bool {
        self.free_retired();
        let sent = QueuedOrder { order, until, disarms };
        self.orders.push(sent).is_ok()
    }

    /// Creates a switch that disarms from any thread.
    pub fn disarm_switch(&self) -> DisarmSwitch {
        DisarmSwitch(Arc::clone(&self.shared))
    }

    /// Heartbeat of the thread.
    pub fn pulse(&self) -> Pulse {
        self.pulse.clone()
    }

    /// Number of orders that fit into the queue now.
    pub fn room(&self) -> usize {
        self.orders.slots()
    }

    /// Sets the reasons that forbid arming from now on; an empty set permits it.
    pub fn forbid(&self, reasons: Reasons) {
        self.shared.forbids.store(reasons.bits(), Ordering::Relaxed);
    }

    /// Sets additional reasons to report from now on.
    pub fn note(&self, reasons: Reasons) {
        self.shared.notes.store(reasons.bits(), Ordering::Relaxed);
    }

    /// Report of the latest cycle.
    pub fn report(&mut self) -> &Report {
        self.reports.read()
    }

    /// Cycle times since the last call.
    pub fn timings(&mut self) -> impl Iterator<Item = Timing> + '_ {
        std::iter::from_fn(|| self.timings.pop().ok())
    }

    /// State changes since the last call.
    pub fn changes(&mut self) -> Vec<Change> {
        std::iter::from_fn(|| self.changes.pop().ok()).collect()
    }

    /// Models and limits rejected since the last call; the previous ones stay active.
    pub fn refusals(&mut self) -> impl Iterator<Item = OrderRefusal> + '_ {
        std::iter::from_fn(|| self.refusals.pop().ok())
    }

    /// Frees the objects that the thread has returned.
    pub fn free_retired(&mut self) {
        while self.retired.pop().is_ok() {}
    }

    /// Number of cycles so far.
    pub fn cycles(&self) -> u64 {
        self.shared.cycles.load(Ordering::Relaxed)
    }

    /// Clock of the cycle, by which requests expire.
    pub fn clock(&self) -> &Clock {
        self.pulse.clock()
    }

    /// Whether the thread has ended. Unless it was stopped, it has panicked and printed the cause.
    pub fn has_ended(&self) -> bool {
        if self.is_manual {
            return self.shared.stop.load(Ordering::Relaxed);
        }
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends the thread and waits for it.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was already printed.
            let _ = thread.join();
        }
    }

    /// Ends the thread and waits at most `patience` for it. Returns whether it has ended; a thread that hangs in an exchange with a
    /// controller is abandoned.
    pub fn stop_within(&mut self, patience: Duration) -> bool {
        self.shared.stop.store(true, Ordering::Relaxed);
        let end = Instant::now() + patience;
        while let Some(thread) = &self.thread {
            if thread.is_finished() {
                self.stop();
                break;
            }
            if Instant::now() > end {
                self.thread = None;
                return false;
            }
            thread::sleep(Duration::from_millis(1));
        }
        true
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Starts the control thread, which runs one cycle per period, and the threads that read standby paths ([`Cycle::start_standby_threads`]).
/// Returns descriptions of the scheduling settings that the system rejected.
///
/// # Errors
/// The operating system cannot create a thread.
pub fn start(mut cycle: Cycle, realtime: Realtime) -> Result<(Handle, Vec<String>), StartError> {
    cycle.start_standby_threads()?;
    let (lacking_in, lacking) = std::sync::mpsc::channel();
    let (mut handle, control) = control(cycle, realtime.reference);
    let thread = thread::Builder::new()
        .name("volcomp-control".to_owned())
        .stack_size(2 * STACK + 512 * 1024)
        .spawn(move || {
            let lacking = schedule(realtime);
            touch_stack();
            // `start` waits for this message, or for the end of the thread.
            let _ = lacking_in.send(lacking);
            control.run();
        })?;
    handle.thread = Some(thread);
    let lacking = lacking.recv().unwrap_or_default();
    Ok((handle, lacking))
}

/// Creates a control loop without a thread, for tests that set its time ([`Cycle::with_clock`]) and run its cycles.
pub fn start_manual(cycle: Cycle) -> (Handle, ManualCycles) {
    let (mut handle, control) = control(cycle, false);
    handle.is_manual = true;
    (handle, ManualCycles(control))
}

/// Runs the cycles of [`start_manual`].
pub struct ManualCycles(Control);

impl ManualCycles {
    /// Runs one cycle, unless the loop was stopped.
    pub fn cycle(&mut self) {
        if !self.0.shared.stop.load(Ordering::Relaxed) {
            self.0.run_cycle(false);
            // If the queue is full, the times of this cycle are lost.
            let _ = self.0.timings.push(Timing::default());
        }
    }
}

fn control(cycle: Cycle, reference: bool) -> (Handle, Control) {
    let (orders_in, orders) = RingBuffer::new(64);
    let (retired_in, retired) = RingBuffer::new(64);
    let (timings_in, timings) = RingBuffer::new(TIMINGS);
    let (changes_in, changes) = RingBuffer::new(1024);
    let (refusals_in, refusals) = RingBuffer::new(64);
    let (reports_in, reports) = triple_buffer::triple_buffer(&Report::default());
    let shared = Arc::new(Shared::default());
    let clock = cycle.clock();
    shared.cycle_done_ns.store(nanos(clock.elapsed()), Ordering::Relaxed);
    let pulse = Pulse { shared: Arc::clone(&shared), clock: clock.clone(), period: cycle.period() };
    let control = Control {
        cycle,
        reference,
        orders,
        retired: retired_in,
        timings: timings_in,
        changes: changes_in,
        refusals: refusals_in,
        reports: reports_in,
        shared: Arc::clone(&shared),
        clock,
        disarms: 0,
        last: (State::Disarmed, 0),
    };
    let handle = Handle {
        orders: orders_in,
        retired,
        timings,
        changes,
        refusals,
        reports,
        shared,
        pulse,
        thread: None,
        is_manual: false,
    };
    (handle, control)
}

/// Duration of the reference computation on the CPU clock of this thread, ns.
fn reference_ns() -> u64 {
    let begun = thread_time();
    // The result must be used, or the computation would be optimised away.
    std::hint::black_box(reference_work(std::hint::black_box(0.5)));
    nanos(thread_time().saturating_sub(begun))
}

/// The control loop on its thread.
///
/// Invariants:
/// - An order is executed only if the queue of retired objects has room, because nothing may be freed here.
/// - `disarms` never exceeds the number of disarm orders given.
/// - `last` is the state and path that were published last.
struct Control {
    cycle: Cycle,
    reference: bool,
    orders: Consumer<QueuedOrder>,
    retired: Producer<Retired>,
    timings: Producer<Timing>,
    changes: Producer<Change>,
    refusals: Producer<OrderRefusal>,
    reports: triple_buffer::Input<Report>,
    shared: Arc<Shared>,
    clock: Clock,
    disarms: u64,
    last: (State, usize),
}

impl Control {
    fn run(mut self) {
        let mut deadlines = Deadlines::new(self.cycle.period());
        let mut overran: Option<Duration> = None;
        while !self.shared.stop.load(Ordering::Relaxed) {
            let deadline = deadlines.wait();
            let woke = monotonic();
            let overruns =
                overran.is_some_and(|then| woke.saturating_sub(then) < OVERRUN_REPORTED_FOR);
            let spent = self.run_cycle(overruns);
            let done = monotonic();
            let missed = deadlines.done(done);
            if missed > 0 {
                overran = Some(done);
                self.cycle.count_overruns(u64::from(missed));
            }
            let timing = Timing {
                wake_ns: nanos(woke.saturating_sub(deadline)),
                whole_ns: nanos(done.saturating_sub(woke)),
                exchange_ns: nanos(spent.exchange),
                own_ns: nanos(spent.own),
                reference_ns: if self.reference { reference_ns() } else { 0 },
                missed,
            };
            // If the queue is full, the times of this cycle are lost.
            let _ = self.timings.push(timing);
        }
    }

    fn run_cycle(&mut self, overruns: bool) -> CycleDurations {
        let input = self.next_input(overruns);
        let spent = self.cycle.run(self.clock.now(), &input, &mut thread_time);
        self.push_change();
        self.reports.input_buffer_mut().clone_from(self.cycle.report());
        self.reports.publish();
        self.shared.cycles.fetch_add(1, Ordering::Relaxed);
        let done = nanos(self.clock.elapsed());
        self.shared.cycle_done_ns.store(done, Ordering::Relaxed);
        spent
    }

    fn push_change(&mut self) {
        let report = self.cycle.report();
        let now = (report.state, report.active);
        if now != self.last {
            self.last = now;
            let change = Change {
                cycle: report.cycle,
                state: report.state,
                reasons: report.reasons,
                active: report.active,
            };
            // If the queue is full, a thousand changes are unread, and this one is lost.
            let _ = self.changes.push(change);
        }
    }

    /// Executes the queued orders up to the first request to the guard, and returns the inputs of the cycle.
    fn next_input(&mut self, overrunning: bool) -> CycleInput {
        let mut input = CycleInput {
            request: None,
            forbids: Reasons::from_bits(self.shared.forbids.load(Ordering::Relaxed)),
            notes: Reasons::from_bits(self.shared.notes.load(Ordering::Relaxed))
                | Reasons::OVERRUNS.when(overrunning),
        };
        let disarms = self.shared.disarms.load(Ordering::Acquire);
        if disarms != self.disarms {
            self.disarms = disarms;
            input.request = Some(if self.shared.ends.load(Ordering::Relaxed) {
                Request::End
            } else {
                Request::Disarm
            });
        }
        let now = self.clock.now();
        while input.request.is_none() && self.retired.slots() > 0 {
            let Ok(sent) = self.orders.pop() else {
                break;
            };
            match sent.order {
                Order::Request(request) => {
                    input.request = Some(request).filter(|_| sent.is_valid(request, now, disarms));
                }
                Order::Model(mut replacement) => {
                    match self.cycle.swap_model(&mut replacement) {
                        Ok(()) => input.request = Some(Request::Switched),
                        // If the queue is full, 64 other refusals are unread.
                        Err(refusal) => drop(self.refusals.push(refusal)),
                    }
                    // The loop has checked that there is room.
                    let _ = self.retired.push(Retired::Model(replacement));
                }
                Order::Limits(path, limits) => {
                    match self.cycle.set_limits(path, &limits) {
                        // A ramp leads to the correction within the new limits, as after a change of the model.
                        Ok(()) => input.request = Some(Request::Switched),
                        Err(refusal) => drop(self.refusals.push(refusal)),
                    }
                    let _ = self.retired.push(Retired::Limits(limits));
                }
            }
        }
        input
    }
}

impl QueuedOrder {
    /// Whether a request is still valid at `now`, given the number of disarm orders so far. Requests to disarm never expire.
    fn is_valid(&self, request: Request, now: Instant, disarms: u64) -> bool {
        match request {
            Request::Disarm | Request::End => true,
            Request::Arm | Request::TakeOver => now <= self.until && self.disarms == disarms,
            Request::Acknowledge | Request::Switched => now <= self.until,
        }
    }
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// Requests SCHED_FIFO and a processor for this thread. Returns descriptions of the settings that the system rejected.
pub fn schedule(wanted: Realtime) -> Vec<String> {
    let mut lacking = Vec::new();
    if let Some(cpu) = wanted.cpu {
        let mut set = CpuSet::new();
        if cpu < CpuSet::MAX_CPU {
            set.set(cpu);
        }
        if let Err(e) = sched_setaffinity(None, &set) {
            lacking.push(format!("control thread is not on processor {cpu}: {e}"));
        }
    }
    if wanted.priority > 0 {
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority =
            ThreadPriorityValue::try_from(wanted.priority).map(ThreadPriority::Crossplatform);
        let set = priority.and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), priority, policy)
                .map_err(|e| format!("{e:?}"))
        });
        if let Err(e) = set {
            lacking.push(format!("control thread has no real-time priority: {e} (LimitRTPRIO)"));
        }
    }
    lacking
}

#[inline(never)]
#[expect(clippy::large_stack_arrays, reason = "the array is there to touch the stack")]
fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for page in stack.chunks_mut(4096) {
        page[0] = 1;
    }
    std::hint::black_box(&mut stack);
}

/// Coefficients 1 / (k + 1), 4 KB, read from memory like the tables of the model.
static COEFFICIENTS: [f64; DEGREE + 1] = {
    let mut coefficients = [0.0; DEGREE + 1];
    let mut power = 0;
    while power <= DEGREE {
        // At most 512, so the conversion is exact.
        coefficients[power] = 1.0 / (power + 1) as f64;
        power += 1;
    }
    coefficients
};

/// A fixed computation that measures the speed of a computer, so that compute times of cycles on two computers can be
/// compared. It evaluates the polynomial of degree 511 with the coefficients 1 / (k + 1) by Horner's rule: 512
/// multiplications and additions, each depending on the previous result. It must never change, so that results stay
/// comparable.
#[must_use]
pub fn reference_work(x: f64) -> f64 {
    let powers = COEFFICIENTS.iter().rev();
    powers.fold(0.0, |sum, coefficient| sum * x + coefficient)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The polynomial approximates -ln(1 - x) / x.
    #[test]
    fn the_reference_is_the_series_of_the_logarithm() {
        for x in [-0.9_f64, -0.5, 0.25, 0.5, 0.9] {
            let expected = -(1.0 - x).ln() / x;
            assert!((reference_work(x) - expected).abs() < 1e-14 * expected, "{x}");
        }
    }
}
