//! The daemon from its start to its end: what stops it, reloads it and is told to the service manager goes through here; nothing
//! here waits for the machine.

use std::{
    fs::File,
    io::Write,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use rustix::{
    mm::{MlockAllFlags, mlockall},
    process::{Resource, Rlimit, getrlimit, setrlimit},
};
use sd_notify::NotifyState;

use crate::{
    error::GatewayError,
    machine::Machine,
    options::Options,
    service::Service,
    signals::{Heard, Signal},
    slot::{Phase, Slot},
};

/// How often the machine is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// The service manager hears that the process is ready after so long, though devices are still being opened.
const READY_WITHIN: Duration = Duration::from_secs(10);
/// Life is proven as often without a service manager that waits for it.
const NOBODY_WAITS: Duration = Duration::from_secs(4);

/// Runs until it is told to stop.
///
/// # Errors
/// Why it does not start, or that it has ended by itself.
pub fn run(options: &Options) -> Result<(), GatewayError> {
    let machine = Machine {
        options: options.clone(),
        proven_within: proven_within(),
    };
    let plan = machine.plan()?;
    let process = Process::prepare();
    for lacking in &process.lacking {
        tracing::warn!("{lacking}");
    }
    let slot = Arc::new(Slot::default());
    let stopped = Arc::clone(&slot);
    let signals = Heard::new(move || stopped.stop())?;
    let own = Arc::clone(&slot);
    thread::Builder::new()
        .name("volcomp-service".to_owned())
        .spawn(move || machine.run(plan, &own, &mut Service::turn))
        .map_err(|e| GatewayError::system("thread of the service", e))?;
    supervise(&slot, &signals)
}

fn supervise(slot: &Slot, signals: &Heard) -> Result<(), GatewayError> {
    let mut manager = Manager::new();
    let mut is_stopping = false;
    loop {
        match signals.next(LOOK) {
            // The thread that heard it has ordered it.
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

/// Memory that stays locked and processors that stay awake, for the whole process and as long as this lives.
struct Process {
    _awake: Option<File>,
    /// The requests that the operating system refused, in words.
    lacking: Vec<String>,
}

impl Process {
    /// Asks the operating system for both, and for as many descriptors as it may have.
    fn prepare() -> Self {
        let mut lacking = Vec::new();
        let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        if let Err(e) = mlockall(flags) {
            lacking.push(format!("memory is not locked: {e} (LimitMEMLOCK)"));
        }
        let maximum = getrlimit(Resource::Nofile).maximum;
        let all = Rlimit {
            current: maximum,
            maximum,
        };
        if let Err(e) = setrlimit(Resource::Nofile, all) {
            lacking.push(format!("no more descriptors: {e} (LimitNOFILE)"));
        }
        let awake = std::fs::OpenOptions::new()
            .write(true)
            .open("/dev/cpu_dma_latency")
            .and_then(|mut file| {
                file.write_all(&0_i32.to_ne_bytes())?;
                Ok(file)
            });
        if let Err(e) = &awake {
            lacking.push(format!("processors may sleep: /dev/cpu_dma_latency: {e}"));
        }
        Self {
            _awake: awake.ok(),
            lacking,
        }
    }
}

/// The time within which the service manager must hear that the process lives.
fn proven_within() -> Duration {
    sd_notify::watchdog_enabled().unwrap_or(NOBODY_WAITS)
}

/// What the service manager was told last. Where there is none nobody hears it.
struct Manager {
    begun: Instant,
    is_ready: bool,
    is_stopping: bool,
    /// The proofs of life so far.
    proofs: Option<u64>,
}

impl Manager {
    /// Nothing was told yet.
    fn new() -> Self {
        Self {
            begun: Instant::now(),
            is_ready: false,
            is_stopping: false,
            proofs: None,
        }
    }

    /// It is ready: once, and as soon as everything is on its way no more, or has been for `patience`.
    fn ready(&mut self, is_settled: bool, patience: Duration) {
        if !self.is_ready && (is_settled || self.begun.elapsed() > patience) {
            self.is_ready = true;
            tell(&NotifyState::Ready);
        }
    }

    /// It begins to stop: told once.
    fn stopping(&mut self) {
        if !self.is_stopping {
            self.is_stopping = true;
            tell(&NotifyState::Stopping);
        }
    }

    /// Feeds the watchdog where the machine has proven since the last call that it lives.
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

/// The socket to the service manager takes what is told without waiting.
fn tell(state: &NotifyState<'_>) {
    let _ = sd_notify::notify(std::slice::from_ref(state));
}

#[cfg(test)]
mod tests {
    use super::Manager;

    #[test]
    fn the_watchdog_is_fed_while_the_machine_proves_that_it_lives() {
        let mut manager = Manager::new();
        assert!(!manager.lives(0), "nothing is proven yet");
        assert!(manager.lives(1));
        assert!(!manager.lives(1), "it hangs");
        assert!(manager.lives(2), "it is back");
    }
}
