//! The machine, in a thread of its own: started, kept running, ramped out at its end. A fault of the program in it is caught here.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use crate::{
    error::{Failure, GatewayError},
    options::Options,
    plan::Plan,
    request::{Ask, Asked},
    service::Service,
    slot::{Phase, Slot},
};

mod start;

use start::Started;

/// The machine of the process.
#[derive(Clone, Debug)]
pub struct Machine {
    /// How the gateway is called.
    pub options: Options,
    /// The time of the watchdog of the service manager.
    pub proven_within: Duration,
}

/// One turn of a service: [`Service::turn`].
pub type Turn<'t> = &'t mut dyn FnMut(&mut Service);

impl Machine {
    /// The plan of its files as they are now.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn plan(&self) -> Result<Plan, GatewayError> {
        Plan::new(self.options.configuration()?)
    }

    /// Runs it until it is told to stop.
    pub fn run(&self, plan: Plan, slot: &Slot, turn: Turn<'_>) {
        let whole = AssertUnwindSafe(|| self.run_to_its_end(plan, slot, turn));
        let ended = catch_unwind(whole).unwrap_or_else(|_| Err(panicked()));
        slot.set(ended.map_or_else(Phase::Failed, |()| Phase::Ended));
    }

    fn run_to_its_end(&self, plan: Plan, slot: &Slot, turn: Turn<'_>) -> Result<(), Failure> {
        let started = match start::start(self, plan, slot) {
            Ok(Some(started)) => started,
            // Told to stop before anything could be written.
            Ok(None) => return Ok(()),
            Err(error) => return Err(error.failure()),
        };
        let Started {
            mut service,
            asks,
            switch,
            runtime,
            locks,
            interop,
            #[cfg(feature = "fleet")]
            fleet,
        } = started;
        let mut hurry = || slot.stops() > 1;
        let mut is_lost = false;
        let turned = catch_unwind(AssertUnwindSafe(|| {
            let mut reloads = slot.reloads();
            while slot.stops() == 0 {
                if slot.reloads() != reloads {
                    reloads = slot.reloads();
                    let reload = Asked::new(Ask::Reload(None), "signal", None, &switch);
                    if asks.try_send(reload).is_err() {
                        tracing::warn!("reload: too many requests wait");
                    }
                }
                turn(&mut service);
                if service.is_without_control() {
                    tracing::error!("the control thread has ended by itself: nothing corrects");
                    is_lost = true;
                    break;
                }
            }
            service.stop(&mut hurry)
        }));
        let has_panicked = turned.is_err();
        let has_ended = turned.unwrap_or_else(|_| {
            tracing::error!("fault of the program in the service: the correction ramps to zero");
            switch.end();
            catch_unwind(AssertUnwindSafe(|| service.abandon(&mut hurry))).unwrap_or(false)
        });
        if !has_ended {
            slot.keep(locks);
        }
        // What was to be told last is sent or kept.
        #[cfg(feature = "fleet")]
        drop(fleet);
        drop(interop);
        runtime.shutdown_background();
        if is_lost {
            Err(without_control())
        } else if has_panicked {
            Err(panicked())
        } else {
            Ok(())
        }
    }
}

/// A machine whose control thread has ended, so that what is applied stands until the control takes it out.
fn without_control() -> Failure {
    Failure {
        what: "the control thread has ended by itself, why is written on standard error: what was applied stands until the control takes it out".to_owned(),
        status: 1,
    }
}

/// A machine in which the program has a fault.
fn panicked() -> Failure {
    Failure {
        what: "a fault of the program, written on standard error".to_owned(),
        status: 1,
    }
}
