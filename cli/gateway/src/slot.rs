//! Between the process and its machine: what is ordered goes in, how it is comes out. State: the orders so far, and the phase. An order to stop waits for no lock.

use std::{
    net::SocketAddr,
    sync::{
        Mutex,
        atomic::{AtomicU32, Ordering},
    },
};

use volcomp_runtime::DisarmSwitch;

use crate::{error::Failure, locked, published::Published, service::Life};

/// Orders to a machine, and how it is.
#[derive(Default)]
pub struct Slot {
    /// How often stopping was ordered.
    stops: AtomicU32,
    /// How often reading everything again was ordered.
    reloads: AtomicU32,
    /// The order to disarm, as soon as there is a control thread.
    switch: Mutex<Option<DisarmSwitch>>,
    phase: Mutex<Phase>,
    life: Life,
}

/// How far a machine is.
#[derive(Clone, Default)]
pub enum Phase {
    /// Files are read and devices opened; nothing can be written yet.
    #[default]
    Starting,
    /// The control thread is being started.
    Launching,
    /// It runs.
    Running(Live),
    /// It does not run.
    Failed(Failure),
    /// It was told to stop, and has.
    Ended,
}

/// What others reach of a machine that runs.
#[derive(Clone)]
pub struct Live {
    /// Its state.
    pub published: Published,
    /// Where its dashboard listens.
    pub address: SocketAddr,
    /// Whether its dashboard speaks TLS.
    pub tls: bool,
}

impl Live {
    /// The URL of its dashboard.
    pub fn url(&self) -> String {
        let scheme = if self.tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }
}

impl Slot {
    /// Orders to stop: the correction goes out from the next cycle on. A second order ends the machine at once.
    pub fn stop(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
        // Whoever holds the lock puts a switch in, and looks at the order afterwards.
        if let Ok(switch) = self.switch.try_lock()
            && let Some(switch) = &*switch
        {
            switch.end();
        }
    }

    /// How often stopping was ordered.
    pub fn stops(&self) -> u32 {
        self.stops.load(Ordering::SeqCst)
    }

    /// Orders to read configuration and machine file again.
    pub fn reload(&self) {
        self.reloads.fetch_add(1, Ordering::Relaxed);
    }

    /// How often that was ordered.
    pub fn reloads(&self) -> u32 {
        self.reloads.load(Ordering::Relaxed)
    }

    /// How far it is.
    pub fn phase(&self) -> Phase {
        locked(&self.phase).clone()
    }

    /// The proof that its cycles come on time.
    pub fn life(&self) -> &Life {
        &self.life
    }

    /// It is on its way to another phase.
    pub(crate) fn set(&self, phase: Phase) {
        *locked(&self.phase) = phase;
    }

    /// Asked before the control thread is started: `false` where it has been given up, and must not be.
    pub(crate) fn launch(&self) -> bool {
        let mut phase = locked(&self.phase);
        let may = matches!(*phase, Phase::Starting) && self.stops() == 0;
        *phase = if may { Phase::Launching } else { Phase::Ended };
        may
    }

    /// Gives up a machine whose devices are still being opened.
    pub(crate) fn give_up(&self) {
        let mut phase = locked(&self.phase);
        if matches!(*phase, Phase::Starting) {
            *phase = Phase::Ended;
        }
    }

    /// The control thread was started: an order to stop that came meanwhile acts now.
    pub(crate) fn launched(&self, switch: &DisarmSwitch) {
        *locked(&self.switch) = Some(switch.clone());
        if self.stops() > 0 {
            switch.end();
        }
    }
}

impl Phase {
    /// Whether it is still on its way.
    pub(crate) fn is_starting(&self) -> bool {
        matches!(self, Self::Starting | Self::Launching)
    }
}
