//! The main loop of the gateway: signals, reloads and notifications of the service manager.
//!
//! The loop never waits for the machine. A separate thread receives the signals, so that a stop takes effect
//! immediately, even if the service is busy.

use std::{
    fs::File,
    io::Write,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use rustix::{
    mm::{MlockAllFlags, mlockall},
    process::{Resource, Rlimit, getrlimit, setrlimit},
};
use sd_notify::NotifyState;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::{Handle, Signals},
};

use crate::{
    error::GatewayError,
    machine::{Machine, Phase, Slot},
    options::Options,
    service::Service,
};

const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Time after which the service manager is notified that the process is ready, even if devices are still being opened.
const READY_WITHIN: Duration = Duration::from_secs(10);
/// Watchdog timeout if no service manager sets one.
const DEFAULT_WATCHDOG: Duration = Duration::from_secs(4);

/// Runs the gateway of one machine until a signal stops it.
///
/// # Errors
/// The configuration is invalid, signals or the thread cannot be set up, or the service fails.
pub fn run(options: &Options) -> Result<(), GatewayError> {
    let machine = Machine { options: options.clone(), proven_within: proven_within() };
    let plan = machine.plan()?;
    let process = Process::prepare();
    for lacking in &process.lacking {
        tracing::warn!("{lacking}");
    }
    let slot = Arc::new(Slot::default());
    let stopped = Arc::clone(&slot);
    let signals = SignalReceiver::new(move || stopped.stop())?;
    let own = Arc::clone(&slot);
    thread::Builder::new()
        .name("volcomp-service".to_owned())
        .spawn(move || machine.run(plan, &own, &mut Service::poll))
        .map_err(|e| GatewayError::system("thread of the service", e))?;
    supervise(&slot, &signals)
}

fn supervise(slot: &Slot, signals: &SignalReceiver) -> Result<(), GatewayError> {
    let mut manager = Manager::new();
    let mut is_stopping = false;
    loop {
        match signals.next(POLL_INTERVAL) {
            // The signal thread has already passed the stop order to the machine.
            Some(Signal::Stop) => {
                is_stopping = true;
                manager.stopping();
            }
            Some(Signal::Reload) => slot.reload(),
            None => {}
        }
        if is_stopping {
            slot.give_up();
        }
        let phase = slot.phase();
        match phase {
            Phase::Ended => return Ok(()),
            Phase::Failed(failure) => return Err(GatewayError::Failed(failure)),
            _ => {}
        }
        manager.ready(!phase.is_starting(), READY_WITHIN);
        manager.feed(slot.life().proofs());
    }
}

struct Process {
    _awake: Option<File>,
    /// Settings that the operating system refused, one sentence each.
    lacking: Vec<String>,
}

impl Process {
    /// Locks the memory, forbids sleep states of the processors, and requests the maximum number of file descriptors.
    fn prepare() -> Self {
        let mut lacking = Vec::new();
        let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        if let Err(e) = mlockall(flags) {
            lacking.push(format!("memory is not locked: {e} (LimitMEMLOCK)"));
        }
        let maximum = getrlimit(Resource::Nofile).maximum;
        let all = Rlimit { current: maximum, maximum };
        if let Err(e) = setrlimit(Resource::Nofile, all) {
            lacking.push(format!("no more descriptors: {e} (LimitNOFILE)"));
        }
        let awake = std::fs::OpenOptions::new().write(true).open("/dev/cpu_dma_latency").and_then(
            |mut file| {
                file.write_all(&0_i32.to_ne_bytes())?;
                Ok(file)
            },
        );
        if let Err(e) = &awake {
            lacking.push(format!("processors may sleep: /dev/cpu_dma_latency: {e}"));
        }
        Self { _awake: awake.ok(), lacking }
    }
}

fn proven_within() -> Duration {
    sd_notify::watchdog_enabled().unwrap_or(DEFAULT_WATCHDOG)
}

/// The last notifications to the service manager. Without a service manager, notifications are dropped.
struct Manager {
    begun: Instant,
    is_ready: bool,
    is_stopping: bool,
    proofs: Option<u64>,
}

impl Manager {
    fn new() -> Self {
        Self { begun: Instant::now(), is_ready: false, is_stopping: false, proofs: None }
    }

    /// Reports readiness once: when the start is complete or has taken longer than `patience`.
    fn ready(&mut self, is_settled: bool, patience: Duration) {
        if !self.is_ready && (is_settled || self.begun.elapsed() > patience) {
            self.is_ready = true;
            tell(&NotifyState::Ready);
        }
    }

    fn stopping(&mut self) {
        if !self.is_stopping {
            self.is_stopping = true;
            tell(&NotifyState::Stopping);
        }
    }

    /// Notifies the watchdog if the number of proofs of life has grown since the last call.
    fn feed(&mut self, proofs: u64) {
        if self.lives(proofs) {
            tell(&NotifyState::Watchdog);
        }
    }

    fn lives(&mut self, proofs: u64) -> bool {
        let before = self.proofs.replace(proofs);
        before.is_some_and(|before| before != proofs)
    }
}

fn tell(state: &NotifyState<'_>) {
    let _ = sd_notify::notify(std::slice::from_ref(state));
}

/// The action requested by a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// SIGTERM or SIGINT: ramp the correction out and exit.
    Stop,
    /// SIGHUP: reload the configuration and the machine file.
    Reload,
}

/// Ends the program on SIGINT and SIGTERM, with status 130 like a shell.
///
/// # Errors
/// The operating system cannot deliver signals or create a thread.
pub fn exit_when_interrupted() -> Result<(), GatewayError> {
    let failed = |e| GatewayError::system("signals", e);
    let mut signals = Signals::new([SIGTERM, SIGINT]).map_err(failed)?;
    let wait = move || {
        if signals.forever().next().is_some() {
            // `eprintln!` would panic if standard error cannot be written, and the program would not end.
            let _ = writeln!(std::io::stderr(), "interrupted");
            std::process::exit(130);
        }
    };
    let thread = thread::Builder::new().name("interrupts".to_owned()).spawn(wait);
    thread.map(drop).map_err(failed)
}

/// Receiver of signals, in the order of their arrival.
pub struct SignalReceiver {
    receiver: Receiver<Signal>,
    handle: Handle,
}

impl SignalReceiver {
    /// Starts receiving signals. Every stop signal calls `stop` immediately, on the receiving thread.
    ///
    /// # Errors
    /// The operating system cannot deliver signals or create a thread.
    pub fn new(stop: impl Fn() + Send + 'static) -> Result<Self, GatewayError> {
        let failed = |e| GatewayError::system("signals", e);
        let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP]).map_err(failed)?;
        let handle = signals.handle();
        let (tell, receiver) = channel();
        thread::Builder::new()
            .name("volcomp-signals".to_owned())
            .stack_size(64 * 1024)
            .spawn(move || {
                for signal in signals.forever() {
                    let signal = if signal == SIGHUP {
                        Signal::Reload
                    } else {
                        stop();
                        Signal::Stop
                    };
                    if tell.send(signal).is_err() {
                        return;
                    }
                }
            })
            .map_err(failed)?;
        Ok(Self { receiver, handle })
    }

    /// Waits at most `wait` for the next signal; `None` if none arrived.
    pub fn next(&self, wait: Duration) -> Option<Signal> {
        match self.receiver.recv_timeout(wait) {
            Ok(signal) => Some(signal),
            Err(RecvTimeoutError::Timeout) => None,
            // The receiving thread has ended, so no more signals arrive.
            Err(RecvTimeoutError::Disconnected) => {
                thread::sleep(wait);
                None
            }
        }
    }
}

impl Drop for SignalReceiver {
    fn drop(&mut self) {
        self.handle.close();
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc, time::Duration};

    use super::*;

    #[test]
    fn the_watchdog_is_fed_while_cycles_are_on_time() {
        let mut manager = Manager::new();
        assert!(!manager.lives(0), "nothing is proven yet");
        assert!(manager.lives(1));
        assert!(!manager.lives(1), "it hangs");
        assert!(manager.lives(2), "it is back");
    }

    /// A stop signal takes effect immediately, not at the next iteration of the service, which may be 50 ms later.
    #[test]
    fn a_stop_acts_without_a_reader() {
        let patience = Duration::from_secs(10);
        let (acted, acts) = mpsc::channel();
        let signals = SignalReceiver::new(move || {
            // The test may be over.
            let _ = acted.send(());
        })
        .expect("signals");
        for (number, signal) in
            [(SIGTERM, Signal::Stop), (SIGINT, Signal::Stop), (SIGHUP, Signal::Reload)]
        {
            signal_hook::low_level::raise(number).expect("a signal");
            if signal == Signal::Stop {
                acts.recv_timeout(patience).expect("it acts at once");
            }
            let receiver = signals.receiver.recv_timeout(patience);
            assert_eq!(receiver.expect("a signal"), signal);
        }
        assert!(acts.try_recv().is_err(), "a reload does not stop");
    }
}
