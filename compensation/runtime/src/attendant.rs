//! A thread that reads the controller of a standby path, so that a slow or hanging one does not delay the cycle. State: the controller, while the
//! path is on standby.

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

/// Interval at which a standby path is read.
pub(crate) const STANDBY_EVERY: Duration = Duration::from_millis(100);
/// Capacity of the ring of answers; further ones are lost.
const ANSWERS: usize = 8;

/// The controller of a path, held by the cycle or by the thread that reads it on standby.
pub(crate) struct Device {
    controller: Option<Box<dyn Controller>>,
    attendant: Option<Attendant>,
}

/// The answer of a controller on standby.
pub(crate) struct Heard {
    /// When it was requested.
    pub(crate) asked: Instant,
    /// When it was received.
    pub(crate) answered: Instant,
    pub(crate) read: Result<Snapshot, Fault>,
}

/// A controller on its way to the thread, and the timeout of its exchanges.
struct Given {
    controller: Box<dyn Controller>,
    patience: Duration,
}

/// The cycle's end of the rings to and from the thread.
struct Attendant {
    shared: Arc<Shared>,
    given: Producer<Given>,
    back: Consumer<Box<dyn Controller>>,
    heard: Consumer<Heard>,
    thread: Thread,
}

#[derive(Default)]
struct Shared {
    /// The cycle has requested the controller.
    recalled: AtomicBool,
    ends: AtomicBool,
}

impl Device {
    pub(crate) fn new(controller: Box<dyn Controller>) -> Self {
        Self {
            controller: Some(controller),
            attendant: None,
        }
    }

    /// Starts the thread, which reads once per `every`. It is idle until [`hand_over`](Self::hand_over).
    pub(crate) fn attend(&mut self, name: &str, every: Duration) -> io::Result<()> {
        let (given_in, given) = RingBuffer::new(1);
        let (back_in, back) = RingBuffer::new(1);
        let (heard_in, heard) = RingBuffer::new(ANSWERS);
        let shared = Arc::new(Shared::default());
        let asks = Asks {
            shared: Arc::clone(&shared),
            given,
            back: back_in,
            heard: heard_in,
            every,
        };
        // The operating system truncates thread names to 15 characters.
        let name = name.chars().take(15).collect();
        let thread = thread::Builder::new()
            .name(name)
            .spawn(move || asks.run())?;
        self.attendant = Some(Attendant {
            shared,
            given: given_in,
            back,
            heard,
            thread: thread.thread().clone(),
        });
        Ok(())
    }

    /// Whether there is a thread that reads it on standby.
    pub(crate) fn is_attended(&self) -> bool {
        self.attendant.is_some()
    }

    /// Whether the cycle holds it.
    pub(crate) fn is_in_hand(&self) -> bool {
        self.controller.is_some()
    }

    /// The controller, if the cycle holds it.
    pub(crate) fn in_hand(&mut self) -> Option<&mut (dyn Controller + 'static)> {
        self.controller.as_deref_mut()
    }

    /// The next answer from the thread. Lock-free.
    pub(crate) fn heard(&mut self) -> Option<Heard> {
        self.attendant.as_mut()?.heard.pop().ok()
    }

    /// Requests the controller; [`take_back`](Self::take_back) receives it once the present exchange is over. Lock-free.
    pub(crate) fn recall(&mut self) {
        if let (None, Some(attendant)) = (&self.controller, &self.attendant)
            && !attendant.shared.recalled.swap(true, Ordering::AcqRel)
        {
            attendant.thread.unpark();
        }
    }

    /// Receives the controller if the thread has returned it. Lock-free.
    pub(crate) fn take_back(&mut self) {
        if let (None, Some(attendant)) = (&self.controller, &mut self.attendant) {
            self.controller = attendant.back.pop().ok();
        }
    }

    /// Passes the controller to the thread, or cancels its recall. Lock-free.
    pub(crate) fn hand_over(&mut self, patience: Duration) {
        let Some(attendant) = &mut self.attendant else {
            return;
        };
        attendant.shared.recalled.store(false, Ordering::Release);
        let Some(controller) = mem::take(&mut self.controller) else {
            return;
        };
        let given = Given {
            controller,
            patience,
        };
        match attendant.given.push(given) {
            Ok(()) => attendant.thread.unpark(),
            // There is one controller, so the ring has room; otherwise the next cycle would try again.
            Err(PushError::Full(given)) => self.controller = Some(given.controller),
        }
    }
}

impl Drop for Attendant {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        self.thread.unpark();
    }
}

/// The thread's end of the rings.
struct Asks {
    shared: Arc<Shared>,
    given: Consumer<Given>,
    back: Producer<Box<dyn Controller>>,
    heard: Producer<Heard>,
    every: Duration,
}

impl Asks {
    fn run(mut self) {
        while !self.shared.ends.load(Ordering::Acquire) {
            match self.given.pop() {
                Ok(given) => self.ask(given),
                Err(_) => thread::park(),
            }
        }
    }

    /// Reads the controller periodically, until it is recalled or the thread is to end.
    fn ask(&mut self, given: Given) {
        let Given {
            mut controller,
            patience,
        } = given;
        while !self.is_over() {
            let asked = Instant::now();
            let read = controller.read(asked + patience);
            // If the ring is full the cycle has not read it for long: this answer is lost.
            let _ = self.heard.push(Heard {
                asked,
                answered: Instant::now(),
                read,
            });
            self.rest(asked + self.every);
        }
        // There is one controller, so the ring has room.
        let _ = self.back.push(controller);
    }

    fn is_over(&self) -> bool {
        let Shared { recalled, ends } = &*self.shared;
        recalled.load(Ordering::Acquire) || ends.load(Ordering::Acquire)
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
