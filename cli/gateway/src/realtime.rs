//! The control thread: absolute deadlines, real-time scheduling, rings to and from the rest.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rtrb::{Consumer, Producer, RingBuffer};
use rustix::{
    thread::{ClockId, CpuSet, clock_nanosleep_absolute, sched_setaffinity},
    time::{ClockId as TimeClock, Timespec, clock_gettime},
};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use volcomp_guard::{Limits, Reasons, Request, State};

use crate::{
    config::RealtimeConfig,
    cycle::{Asked, Cycle, Replacement},
    error::GatewayError,
    report::{Report, Timing},
};

/// Cycles whose times wait at the most; the times of more are lost.
const TIMINGS: usize = 8192;
/// Stack that is touched before the loop begins.
const STACK: usize = 256 * 1024;
/// Overruns are told for so long after the last.
const OVERRUN_TOLD: Duration = Duration::from_secs(2);

/// What the rest tells the control thread.
pub enum Order {
    /// Something that a guard is asked.
    Request(Request),
    /// Another model, through the ramp.
    Model(Box<Replacement>),
    /// Other limits for a path.
    Limits(usize, Box<Limits>),
}

/// The side of everybody else.
pub struct Handle {
    orders: Producer<Order>,
    retired: Consumer<Retired>,
    timings: Consumer<Timing>,
    changes: Consumer<Change>,
    reports: triple_buffer::Output<Report>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    start: Instant,
}

/// The state changed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// In which cycle.
    pub cycle: u64,
    /// To what.
    pub state: State,
    /// Why.
    pub reasons: Reasons,
    /// Which path corrects.
    pub active: usize,
}

/// What comes back to be freed.
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
}

impl Handle {
    /// Sends an order; `false`: the thread does not take any.
    pub fn send(&mut self, order: Order) -> bool {
        self.free_retired();
        self.orders.push(order).is_ok()
    }

    /// What forbids arming from now on.
    pub fn forbid(&self, reasons: Reasons) {
        self.shared.forbids.store(reasons.bits(), Ordering::Relaxed);
    }

    /// What is to be told besides.
    pub fn note(&self, reasons: Reasons) {
        self.shared.notes.store(reasons.bits(), Ordering::Relaxed);
    }

    /// What the latest cycle told.
    pub fn report(&mut self) -> &Report {
        self.reports.read()
    }

    /// The times of cycles since the last call.
    pub fn timings(&mut self) -> impl Iterator<Item = Timing> + '_ {
        std::iter::from_fn(|| self.timings.pop().ok())
    }

    /// The changes of state since the last call.
    pub fn changes(&mut self) -> Vec<Change> {
        std::iter::from_fn(|| self.changes.pop().ok()).collect()
    }

    /// Frees what the thread gave back.
    pub fn free_retired(&mut self) {
        while self.retired.pop().is_ok() {}
    }

    /// Cycles so far.
    pub fn cycles(&self) -> u64 {
        self.shared.cycles.load(Ordering::Relaxed)
    }

    /// When its clock began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Ends the thread.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was told on standard error already.
            let _ = thread.join();
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Starts the control thread. What of its scheduling could not be had comes first on the channel.
///
/// # Errors
/// No thread.
pub fn start(
    cycle: Cycle,
    period: Duration,
    config: RealtimeConfig,
) -> Result<(Handle, Vec<String>), GatewayError> {
    let (orders_in, orders) = RingBuffer::new(64);
    let (retired_in, retired) = RingBuffer::new(64);
    let (timings_in, timings) = RingBuffer::new(TIMINGS);
    let (changes_in, changes) = RingBuffer::new(1024);
    let (reports_in, reports) = triple_buffer::triple_buffer(&Report::default());
    let shared = Arc::new(Shared::default());
    let start = cycle.start();
    let (told, lacking) = std::sync::mpsc::channel();
    let control = Control {
        cycle,
        orders,
        retired: retired_in,
        timings: timings_in,
        changes: changes_in,
        reports: reports_in,
        shared: Arc::clone(&shared),
        period,
    };
    let thread = thread::Builder::new()
        .name("volcomp-control".to_owned())
        .stack_size(2 * STACK + 512 * 1024)
        .spawn(move || {
            let lacking = schedule(config);
            touch_stack();
            // Nobody may listen any more: then nobody needs it.
            let _ = told.send(lacking);
            control.run();
        })
        .map_err(|e| GatewayError::system("control thread", e))?;
    let lacking = lacking.recv().unwrap_or_default();
    Ok((
        Handle {
            orders: orders_in,
            retired,
            timings,
            changes,
            reports,
            shared,
            thread: Some(thread),
            start,
        },
        lacking,
    ))
}

/// SCHED_FIFO and the processor, for this thread. What could not be had, in words. (Nothing is forked here; the
/// unit sets reset-on-fork for what might be.)
pub fn schedule(config: RealtimeConfig) -> Vec<String> {
    let mut lacking = Vec::new();
    if let Some(cpu) = config.cpu {
        let mut set = CpuSet::new();
        if cpu < CpuSet::MAX_CPU {
            set.set(cpu);
        }
        if let Err(e) = sched_setaffinity(None, &set) {
            lacking.push(format!("control thread is not on processor {cpu}: {e}"));
        }
    }
    if config.priority > 0 {
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority =
            ThreadPriorityValue::try_from(config.priority).map(ThreadPriority::Crossplatform);
        let set = priority.and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), priority, policy)
                .map_err(|e| format!("{e:?}"))
        });
        if let Err(e) = set {
            lacking.push(format!(
                "control thread has no real-time priority: {e} (LimitRTPRIO)"
            ));
        }
    }
    lacking
}

/// Pages of the stack are there before they are needed.
#[inline(never)]
#[expect(clippy::large_stack_arrays, reason = "that is the point")]
fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for page in stack.chunks_mut(4096) {
        page[0] = 1;
    }
    std::hint::black_box(&mut stack);
}

struct Control {
    cycle: Cycle,
    orders: Consumer<Order>,
    retired: Producer<Retired>,
    timings: Producer<Timing>,
    changes: Producer<Change>,
    reports: triple_buffer::Input<Report>,
    shared: Arc<Shared>,
    period: Duration,
}

impl Control {
    fn run(mut self) {
        let mut next = monotonic() + self.period;
        let mut overran: Option<Duration> = None;
        let mut last = (State::Disarmed, 0);
        while !self.shared.stop.load(Ordering::Relaxed) {
            // A signal wakes early: sleep on.
            while clock_nanosleep_absolute(ClockId::Monotonic, &timespec(next)).is_err() {}
            let woke = monotonic();
            let asked =
                self.asked(overran.is_some_and(|then| woke.saturating_sub(then) < OVERRUN_TOLD));
            let spent = self.cycle.run(Instant::now(), &asked, &mut thread_time);
            self.tell_change(&mut last);
            self.reports
                .input_buffer_mut()
                .clone_from(self.cycle.report());
            self.reports.publish();
            self.shared.cycles.fetch_add(1, Ordering::Relaxed);
            let done = monotonic();
            let deadline = next;
            next += self.period;
            let missed = missed(done, &mut next, self.period);
            if missed > 0 {
                overran = Some(done);
                self.cycle.count_overruns(u64::from(missed));
            }
            let timing = Timing {
                wake_ns: nanos(woke.saturating_sub(deadline)),
                whole_ns: nanos(done.saturating_sub(woke)),
                exchange_ns: nanos(spent.exchange),
                own_ns: nanos(spent.own),
                missed,
            };
            // Nobody took the last ones: these are lost.
            let _ = self.timings.push(timing);
        }
    }

    fn tell_change(&mut self, last: &mut (State, usize)) {
        let report = self.cycle.report();
        let now = (report.state, report.active);
        if now != *last {
            *last = now;
            let change = Change {
                cycle: report.cycle,
                state: report.state,
                reasons: report.reasons,
                active: report.active,
            };
            // A thousand changes that nobody wrote down: the log has other troubles then.
            let _ = self.changes.push(change);
        }
    }

    /// Takes the orders: one request a cycle.
    fn asked(&mut self, overrunning: bool) -> Asked {
        let mut asked = Asked {
            request: None,
            forbids: Reasons::from_bits(self.shared.forbids.load(Ordering::Relaxed)),
            notes: Reasons::from_bits(self.shared.notes.load(Ordering::Relaxed))
                | Reasons::OVERRUNS.when(overrunning),
        };
        while asked.request.is_none() && self.retired.slots() > 0 {
            match self.orders.pop() {
                Ok(Order::Request(request)) => asked.request = Some(request),
                Ok(Order::Model(mut replacement)) => {
                    self.cycle.swap_model(&mut replacement);
                    asked.request = Some(Request::Switched);
                    // There is room: looked at above.
                    let _ = self.retired.push(Retired::Model(replacement));
                }
                Ok(Order::Limits(path, limits)) => {
                    self.cycle.set_limits(path, &limits);
                    let _ = self.retired.push(Retired::Limits(limits));
                }
                Err(_) => break,
            }
        }
        asked
    }
}

/// Wakes at the same deadlines as a control thread and does nothing but tell the time, how late it woke and how many
/// periods were missed: what the machine itself adds to every cycle.
pub fn tick(period: Duration, during: Duration, told: &mut dyn FnMut(Duration, Duration, u32)) {
    let begun = monotonic();
    let mut next = begun + period;
    while monotonic().saturating_sub(begun) < during {
        while clock_nanosleep_absolute(ClockId::Monotonic, &timespec(next)).is_err() {}
        let woke = monotonic();
        let wake = woke.saturating_sub(next);
        next += period;
        let missed = missed(woke, &mut next, period);
        told(woke, wake, missed);
    }
}

/// Periods that have passed already are left out: no burst to catch up. `next` becomes the next deadline to come.
fn missed(now: Duration, next: &mut Duration, period: Duration) -> u32 {
    if now <= *next {
        return 0;
    }
    let late = now.saturating_sub(*next).as_nanos() / period.as_nanos().max(1);
    let missed = u32::try_from(late + 1).unwrap_or(u32::MAX);
    *next += period * missed;
    missed
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

pub(crate) fn monotonic() -> Duration {
    duration(clock_gettime(TimeClock::Monotonic))
}

/// CPU time of this thread.
pub fn thread_time() -> Duration {
    duration(clock_gettime(TimeClock::ThreadCPUTime))
}

fn duration(time: Timespec) -> Duration {
    Duration::new(
        u64::try_from(time.tv_sec).unwrap_or(0),
        u32::try_from(time.tv_nsec).unwrap_or(0),
    )
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(time.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(time.subsec_nanos()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deadlines that have passed are skipped, and the grid is kept.
    #[test]
    fn an_overrun_skips_to_the_next_period() {
        let ms = Duration::from_millis;
        let period = ms(4);
        for (now, expected, skipped) in [
            (10, 12, 0),
            (12, 12, 0),
            (13, 16, 1),
            (16, 20, 2),
            (31, 32, 5),
        ] {
            let mut next = ms(12);
            assert_eq!(missed(ms(now), &mut next, period), skipped);
            assert_eq!(next, ms(expected));
        }
    }
}
