//! Exchange between the process and its machine: orders go in, the phase comes out. State: the counts of orders, and
//! the phase. A stop order waits for no lock.

use std::{
    net::SocketAddr,
    sync::{
        Mutex,
        atomic::{AtomicU32, Ordering},
    },
};

use volcomp_runtime::DisarmSwitch;

use crate::{error::Failure, locked, published::Published, service::Life};

/// Orders to a machine, and its phase.
#[derive(Default)]
pub struct Slot {
    stops: AtomicU32,
    reloads: AtomicU32,
    /// `None` until the control thread is started.
    switch: Mutex<Option<DisarmSwitch>>,
    phase: Mutex<Phase>,
    life: Life,
}

#[derive(Clone, Default)]
pub enum Phase {
    /// Files are being read and devices opened; nothing can be written yet.
    #[default]
    Starting,
    /// The control thread is being started.
    Launching,
    /// The control thread runs.
    Running(Live),
    /// The machine ended with this failure.
    Failed(Failure),
    /// The machine was stopped.
    Ended,
}

/// Public handles of a running machine.
#[derive(Clone)]
pub struct Live {
    /// Latest state of the machine, as served by dashboard and interfaces.
    pub published: Published,
    /// Listening address of the dashboard.
    pub address: SocketAddr,
    /// True if the dashboard uses TLS.
    pub tls: bool,
}

impl Live {
    /// URL of the dashboard.
    pub fn url(&self) -> String {
        let scheme = if self.tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }
}

impl Slot {
    /// Orders a stop: the correction ramps out from the next cycle on. A second order ends the machine immediately.
    pub fn stop(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
        // The lock is held only while the switch is being set. `launched` checks the orders afterwards.
        if let Ok(switch) = self.switch.try_lock()
            && let Some(switch) = &*switch
        {
            switch.end();
        }
    }

    pub fn stops(&self) -> u32 {
        self.stops.load(Ordering::SeqCst)
    }

    /// Orders a reload of configuration and machine file.
    pub fn reload(&self) {
        self.reloads.fetch_add(1, Ordering::Relaxed);
    }

    pub fn reloads(&self) -> u32 {
        self.reloads.load(Ordering::Relaxed)
    }

    pub fn phase(&self) -> Phase {
        locked(&self.phase).clone()
    }

    /// Proof that cycles are on time.
    pub fn life(&self) -> &Life {
        &self.life
    }

    pub(crate) fn set(&self, phase: Phase) {
        *locked(&self.phase) = phase;
    }

    /// Marks the start of the control thread. `false` if the machine was stopped meanwhile and must not start.
    pub(crate) fn launch(&self) -> bool {
        let mut phase = locked(&self.phase);
        let may = matches!(*phase, Phase::Starting) && self.stops() == 0;
        *phase = if may { Phase::Launching } else { Phase::Ended };
        may
    }

    /// Abandons a machine whose devices are still being opened.
    pub(crate) fn give_up(&self) {
        let mut phase = locked(&self.phase);
        if matches!(*phase, Phase::Starting) {
            *phase = Phase::Ended;
        }
    }

    /// Sets the switch of the started control thread. A stop ordered meanwhile takes effect now.
    pub(crate) fn launched(&self, switch: &DisarmSwitch) {
        *locked(&self.switch) = Some(switch.clone());
        if self.stops() > 0 {
            switch.end();
        }
    }
}

impl Phase {
    pub(crate) fn is_starting(&self) -> bool {
        matches!(self, Self::Starting | Self::Launching)
    }
}
