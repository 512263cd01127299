//! One machine of the process, in a thread of its own: started, kept running, ramped out at its end. A fault of the program
//! in it is caught here, and disturbs no other machine.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    thread,
    time::{Duration, Instant},
};

use crate::{
    error::GatewayError,
    options::Options,
    plan::Plan,
    request::{Ask, Asked},
    service::Service,
    slot::{Failure, Phase, Slot},
};

mod start;

use start::Started;

/// A machine that could not be started is tried again after so long, where its files are right.
const AGAIN: Duration = Duration::from_secs(10);
/// How often a machine that does not run looks whether it is to end or to start again.
const LOOK: Duration = Duration::from_millis(50);

/// A machine of the process.
#[derive(Clone, Debug)]
pub struct Machine {
    /// Its name; `None`: it is the only one.
    pub name: Option<String>,
    /// How a gateway of this machine alone would be called.
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

    /// Runs it until it is told to stop; where it is one of several, it is started again when that may help. `plan` is that of
    /// its files, as far as it was made already.
    pub fn run(&self, mut plan: Option<Result<Plan, GatewayError>>, slot: &Slot, turn: Turn<'_>) {
        let span = match &self.name {
            Some(name) => tracing::error_span!("machine", name),
            None => tracing::Span::none(),
        };
        let _entered = span.enter();
        loop {
            slot.set(Phase::Starting);
            let reloads = slot.reloads();
            let failure = match self.run_once(plan.take(), slot, turn) {
                Ok(()) => return slot.set(Phase::Ended),
                Err(failure) => failure,
            };
            if self.name.is_some() {
                tracing::error!("does not run: {}", failure.what);
            }
            let again = failure.again.then_some(AGAIN);
            slot.set(Phase::Failed(failure));
            if self.name.is_none() || !waited(slot, reloads, again) {
                return;
            }
        }
    }

    /// From its files to its end.
    fn run_once(
        &self,
        plan: Option<Result<Plan, GatewayError>>,
        slot: &Slot,
        turn: Turn<'_>,
    ) -> Result<(), Failure> {
        let start = || {
            let plan = plan.unwrap_or_else(|| self.plan())?;
            start::start(self, plan, slot)
        };
        let started = match catch_unwind(AssertUnwindSafe(start)) {
            Ok(Ok(Some(started))) => started,
            // Told to stop before anything could be written.
            Ok(Ok(None)) => return Ok(()),
            Ok(Err(error)) => return Err(Failure::of(&error)),
            Err(_) => return Err(Failure::panicked()),
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
            Err(Failure::without_control())
        } else if has_panicked {
            Err(Failure::panicked())
        } else {
            Ok(())
        }
    }
}

/// Waits until a machine that does not run is to be started again: `false` where it is to end. Where its control thread hangs
/// it is never started again.
fn waited(slot: &Slot, reloads: u32, by_itself: Option<Duration>) -> bool {
    let until = by_itself.map(|wait| Instant::now() + wait);
    while slot.stops() == 0 {
        let is_asked = slot.reloads() != reloads || until.is_some_and(|at| Instant::now() >= at);
        if is_asked && !slot.hangs() {
            return true;
        }
        thread::sleep(LOOK);
    }
    false
}

impl Failure {
    /// A machine that cannot be started. Devices may come, wrong files do not mend themselves.
    fn of(error: &GatewayError) -> Self {
        Self {
            what: error.to_string(),
            status: error.status(),
            again: error.status() == 1,
        }
    }

    /// A machine whose control thread has ended, so that what is applied stands until the control takes it out.
    fn without_control() -> Self {
        Self {
            what: "the control thread has ended by itself, why is written on standard error: what was applied stands until the control takes it out".to_owned(),
            status: 1,
            again: false,
        }
    }

    /// A machine in which the program has a fault, which would come again.
    fn panicked() -> Self {
        Self {
            what: "a fault of the program, written on standard error".to_owned(),
            status: 1,
            again: false,
        }
    }
}
