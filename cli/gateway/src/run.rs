//! The daemon from its start to its end: what stops it, reloads it and is told to the service manager goes through here; nothing
//! here waits for the machine.

use std::{sync::Arc, thread, time::Duration};

use crate::{
    error::GatewayError,
    machine::Machine,
    options::Options,
    process::{Manager, Process, proven_within},
    service::Service,
    signals::{Heard, Signal},
    slot::{Phase, Slot},
};

/// How often the machine is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// The service manager hears that the process is ready after so long, though devices are still being opened.
const READY_WITHIN: Duration = Duration::from_secs(10);

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
