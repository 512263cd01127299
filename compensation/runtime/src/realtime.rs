//! The control thread, and the rings by which the rest of a program speaks with it. State: the cycle.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rtrb::{Consumer, Producer, RingBuffer};
use volcomp_guard::{Limits, Reasons, Request, State};

use crate::{
    asked::Asked,
    clock::{Deadlines, monotonic, thread_time},
    cycle::Cycle,
    error::{LimitsRefusal, StartError},
    replacement::Replacement,
    report::{Change, Report, Timing},
    schedule::{STACK, schedule, touch_stack},
    settings::Realtime,
};

/// The largest number of cycles whose times wait to be taken; the times of further cycles are lost.
const TIMINGS: usize = 8192;
/// Overruns are reported for so long after the last one.
const OVERRUN_TOLD: Duration = Duration::from_secs(2);

/// An order from the rest of a program to the control thread.
pub enum Order {
    /// A request to the guards, such as arming.
    Request(Request),
    /// Another model; the correction ramps to it.
    Model(Box<Replacement>),
    /// Other limits for the path at this place.
    Limits(usize, Box<Limits>),
}

/// The control thread as the rest of a program sees it. No call waits for the thread but [`stop`](Self::stop).
pub struct Handle {
    orders: Producer<Order>,
    retired: Consumer<Retired>,
    timings: Consumer<Timing>,
    changes: Consumer<Change>,
    refusals: Consumer<LimitsRefusal>,
    reports: triple_buffer::Output<Report>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    start: Instant,
}

/// An object that the control thread gives back to be freed elsewhere, since it must not free memory itself.
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
    /// Sends an order. `false`: too many wait, or the thread has ended; the order is dropped.
    #[must_use = "an order that is not taken must be told to whoever asked"]
    pub fn send(&mut self, order: Order) -> bool {
        self.free_retired();
        self.orders.push(order).is_ok()
    }

    /// How many orders can be sent before the thread has taken one.
    pub fn room(&self) -> usize {
        self.orders.slots()
    }

    /// Forbids arming for these reasons from now on; none: arming is allowed.
    pub fn forbid(&self, reasons: Reasons) {
        self.shared.forbids.store(reasons.bits(), Ordering::Relaxed);
    }

    /// Reports these reasons besides from now on.
    pub fn note(&self, reasons: Reasons) {
        self.shared.notes.store(reasons.bits(), Ordering::Relaxed);
    }

    /// The report of the latest cycle.
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

    /// The orders of other limits that were refused since the last call: the old limits hold on.
    pub fn refusals(&mut self) -> impl Iterator<Item = LimitsRefusal> + '_ {
        std::iter::from_fn(|| self.refusals.pop().ok())
    }

    /// Frees what the thread has given back.
    pub fn free_retired(&mut self) {
        while self.retired.pop().is_ok() {}
    }

    /// The number of cycles so far.
    pub fn cycles(&self) -> u64 {
        self.shared.cycles.load(Ordering::Relaxed)
    }

    /// When the clock of the cycle began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Ends the thread and waits until it has ended.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed when it happened.
            let _ = thread.join();
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Starts the control thread: a cycle every period of the cycle. Gives in words what of the scheduling was refused.
///
/// # Errors
/// The operating system gives no thread.
pub fn start(cycle: Cycle, realtime: Realtime) -> Result<(Handle, Vec<String>), StartError> {
    let (orders_in, orders) = RingBuffer::new(64);
    let (retired_in, retired) = RingBuffer::new(64);
    let (timings_in, timings) = RingBuffer::new(TIMINGS);
    let (changes_in, changes) = RingBuffer::new(1024);
    let (refusals_in, refusals) = RingBuffer::new(64);
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
        refusals: refusals_in,
        reports: reports_in,
        shared: Arc::clone(&shared),
    };
    let thread = thread::Builder::new()
        .name("volcomp-control".to_owned())
        .stack_size(2 * STACK + 512 * 1024)
        .spawn(move || {
            let lacking = schedule(realtime);
            touch_stack();
            // `start` waits for it until the thread ends.
            let _ = told.send(lacking);
            control.run();
        })?;
    let lacking = lacking.recv().unwrap_or_default();
    Ok((
        Handle {
            orders: orders_in,
            retired,
            timings,
            changes,
            refusals,
            reports,
            shared,
            thread: Some(thread),
            start,
        },
        lacking,
    ))
}

struct Control {
    cycle: Cycle,
    orders: Consumer<Order>,
    retired: Producer<Retired>,
    timings: Producer<Timing>,
    changes: Producer<Change>,
    refusals: Producer<LimitsRefusal>,
    reports: triple_buffer::Input<Report>,
    shared: Arc<Shared>,
}

impl Control {
    fn run(mut self) {
        let mut deadlines = Deadlines::new(self.cycle.period());
        let mut overran: Option<Duration> = None;
        let mut last = (State::Disarmed, 0);
        while !self.shared.stop.load(Ordering::Relaxed) {
            let deadline = deadlines.wait();
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
                missed,
            };
            // Where the ring is full the times of this cycle are lost.
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
            // Where the ring is full nobody has written down a thousand changes: this one is lost, too.
            let _ = self.changes.push(change);
        }
    }

    /// Takes the orders that wait, up to one request to the guards for each cycle.
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
                    // There is room: the loop looked for it.
                    let _ = self.retired.push(Retired::Model(replacement));
                }
                Ok(Order::Limits(path, limits)) => {
                    if let Err(refusal) = self.cycle.set_limits(path, &limits) {
                        // Where the ring is full, sixty-three others tell the same.
                        let _ = self.refusals.push(refusal);
                    }
                    let _ = self.retired.push(Retired::Limits(limits));
                }
                Err(_) => break,
            }
        }
        asked
    }
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
