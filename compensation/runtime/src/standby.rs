//! A thread that reads the controller of a standby path, so that a slow or hanging exchange does not delay the cycle. State: the
//! controller, while the path is on standby.

use std::{
    io, mem,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, Thread},
    time::{Duration, Instant},
};

use rtrb::{Consumer, Producer, PushError, RingBuffer};
use volcomp_port::{Controller, Fault, Snapshot};

pub(crate) const STANDBY_INTERVAL: Duration = Duration::from_millis(100);
/// Capacity of the queue of answers; further ones are lost.
const ANSWERS: usize = 8;

/// Slot for the controller of a path, which is held by the cycle or by its standby thread.
///
/// Invariants:
/// - The controller is in exactly one place: here, in a queue, or with the thread.
pub(crate) struct ControllerSlot {
    controller: Option<Box<dyn Controller>>,
    thread: Option<StandbyThread>,
}

pub(crate) struct StandbyReading {
    pub(crate) requested: Instant,
    pub(crate) received: Instant,
    pub(crate) read: Result<Snapshot, Fault>,
}

struct ReadJob {
    controller: Box<dyn Controller>,
    time_out: Duration,
}

struct StandbyThread {
    shared: Arc<Shared>,
    jobs: Producer<ReadJob>,
    back: Consumer<Box<dyn Controller>>,
    readings: Consumer<StandbyReading>,
    thread: Thread,
}

#[derive(Default)]
struct Shared {
    is_recalled: AtomicBool,
    ends: AtomicBool,
}

impl ControllerSlot {
    pub(crate) fn new(controller: Box<dyn Controller>) -> Self {
        Self { controller: Some(controller), thread: None }
    }

    /// Starts the thread, which reads once per `every`, and is idle until [`hand_over`](Self::hand_over).
    pub(crate) fn start_thread(&mut self, name: &str, every: Duration) -> io::Result<()> {
        let (jobs_in, jobs) = RingBuffer::new(1);
        let (back_in, back) = RingBuffer::new(1);
        let (readings_in, readings) = RingBuffer::new(ANSWERS);
        let shared = Arc::new(Shared::default());
        let reader = StandbyReader {
            shared: Arc::clone(&shared),
            jobs,
            back: back_in,
            readings: readings_in,
            every,
        };
        // The operating system truncates thread names to 15 characters.
        let name = name.chars().take(15).collect();
        let thread = thread::Builder::new().name(name).spawn(move || reader.run())?;
        self.thread = Some(StandbyThread {
            shared,
            jobs: jobs_in,
            back,
            readings,
            thread: thread.thread().clone(),
        });
        Ok(())
    }

    pub(crate) fn has_thread(&self) -> bool {
        self.thread.is_some()
    }

    pub(crate) fn is_held(&self) -> bool {
        self.controller.is_some()
    }

    pub(crate) fn held_controller(&mut self) -> Option<&mut (dyn Controller + 'static)> {
        self.controller.as_deref_mut()
    }

    /// Takes the next answer of the thread from the queue. Lock-free.
    pub(crate) fn next_reading(&mut self) -> Option<StandbyReading> {
        self.thread.as_mut()?.readings.pop().ok()
    }

    /// Requests the controller, which [`take_back`](Self::take_back) receives after the present exchange. Lock-free.
    pub(crate) fn recall(&mut self) {
        if let (None, Some(thread)) = (&self.controller, &self.thread)
            && !thread.shared.is_recalled.swap(true, Ordering::AcqRel)
        {
            thread.thread.unpark();
        }
    }

    /// Receives the controller if the thread has returned it. Lock-free.
    pub(crate) fn take_back(&mut self) {
        if let (None, Some(thread)) = (&self.controller, &mut self.thread) {
            self.controller = thread.back.pop().ok();
        }
    }

    /// Passes the controller to the thread, or cancels its recall. Lock-free.
    pub(crate) fn hand_over(&mut self, time_out: Duration) {
        let Some(thread) = &mut self.thread else {
            return;
        };
        thread.shared.is_recalled.store(false, Ordering::Release);
        let Some(controller) = mem::take(&mut self.controller) else {
            return;
        };
        let jobs = ReadJob { controller, time_out };
        match thread.jobs.push(jobs) {
            Ok(()) => thread.thread.unpark(),
            // There is one controller, so the queue has room; otherwise the next cycle tries again.
            Err(PushError::Full(jobs)) => self.controller = Some(jobs.controller),
        }
    }
}

impl Drop for StandbyThread {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        self.thread.unpark();
    }
}

struct StandbyReader {
    shared: Arc<Shared>,
    jobs: Consumer<ReadJob>,
    back: Producer<Box<dyn Controller>>,
    readings: Producer<StandbyReading>,
    every: Duration,
}

impl StandbyReader {
    fn run(mut self) {
        while !self.shared.ends.load(Ordering::Acquire) {
            match self.jobs.pop() {
                Ok(jobs) => self.read_until_recalled(jobs),
                Err(_) => thread::park(),
            }
        }
    }

    fn read_until_recalled(&mut self, jobs: ReadJob) {
        let ReadJob { mut controller, time_out } = jobs;
        while !self.is_over() {
            let requested = Instant::now();
            let read = controller.read(requested + time_out);
            // If the queue is full because the cycle has not read it for long, this answer is lost.
            let _ =
                self.readings.push(StandbyReading { requested, received: Instant::now(), read });
            self.rest(requested + self.every);
        }
        // There is one controller, so the queue has room.
        let _ = self.back.push(controller);
    }

    fn is_over(&self) -> bool {
        let Shared { is_recalled, ends } = &*self.shared;
        is_recalled.load(Ordering::Acquire) || ends.load(Ordering::Acquire)
    }

    fn rest(&self, end: Instant) {
        while !self.is_over() {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            thread::park_timeout(left);
        }
    }
}
