//! A thread that asks the controller of a path which stands by, so that one that answers slowly, or hangs, costs the cycle
//! nothing. State: the controller, for as long as the path stands by.

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

/// The interval at which a standby path is read.
pub(crate) const STANDBY_EVERY: Duration = Duration::from_millis(100);
/// Answers that wait for the cycle; further ones are lost.
const ANSWERS: usize = 8;

/// The controller of a path: in the hands of the cycle, or of the thread that asks it meanwhile.
pub(crate) struct Device {
    controller: Option<Box<dyn Controller>>,
    attendant: Option<Attendant>,
}

/// What a controller answered while its path stood by.
pub(crate) struct Heard {
    /// When it was asked.
    pub(crate) asked: Instant,
    /// When it had answered.
    pub(crate) answered: Instant,
    pub(crate) read: Result<Snapshot, Fault>,
}

/// A controller on its way to the thread, and how long an exchange with it may take.
struct Given {
    controller: Box<dyn Controller>,
    patience: Duration,
}

/// The cycle's end of the rings between it and the thread.
struct Attendant {
    shared: Arc<Shared>,
    given: Producer<Given>,
    back: Consumer<Box<dyn Controller>>,
    heard: Consumer<Heard>,
    thread: Thread,
}

#[derive(Default)]
struct Shared {
    /// The cycle wants the controller back.
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

    /// Starts the thread. Until [`hand_over`](Self::hand_over) it asks nothing.
    /// It asks as often as `every`.
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
        // The operating system shows 15 letters.
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

    /// Whether a thread asks it while its path stands by.
    pub(crate) fn is_attended(&self) -> bool {
        self.attendant.is_some()
    }

    /// Whether the cycle has it.
    pub(crate) fn is_in_hand(&self) -> bool {
        self.controller.is_some()
    }

    /// The controller, where the cycle has it.
    pub(crate) fn in_hand(&mut self) -> Option<&mut (dyn Controller + 'static)> {
        self.controller.as_deref_mut()
    }

    /// The next answer that the cycle has not received yet. Takes no lock.
    pub(crate) fn heard(&mut self) -> Option<Heard> {
        self.attendant.as_mut()?.heard.pop().ok()
    }

    /// Asks for the controller; [`take_back`](Self::take_back) has it once the present exchange is over. Takes no lock.
    pub(crate) fn recall(&mut self) {
        if let (None, Some(attendant)) = (&self.controller, &self.attendant)
            && !attendant.shared.recalled.swap(true, Ordering::AcqRel)
        {
            attendant.thread.unpark();
        }
    }

    /// Takes the controller when the thread has given it back. Takes no lock.
    pub(crate) fn take_back(&mut self) {
        if let (None, Some(attendant)) = (&self.controller, &mut self.attendant) {
            self.controller = attendant.back.pop().ok();
        }
    }

    /// Gives the controller to the thread, or lets it have it if it was recalled. Takes no lock.
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
            // There is one controller, so there is room for it; if there were none, the next cycle would try again.
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

    /// Asks the controller again and again, until it is recalled or all ends.
    fn ask(&mut self, given: Given) {
        let Given {
            mut controller,
            patience,
        } = given;
        while !self.is_over() {
            let asked = Instant::now();
            let read = controller.read(asked + patience);
            // Where the ring is full the cycle has not listened for long: this answer is lost.
            let _ = self.heard.push(Heard {
                asked,
                answered: Instant::now(),
                read,
            });
            self.rest(asked + self.every);
        }
        // There is one controller, so there is room for it.
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
