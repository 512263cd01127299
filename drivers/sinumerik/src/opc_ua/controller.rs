//! The controller of a correction: the latest reading, and an order to write, without a wait.

use std::{
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use triple_buffer::{Input, Output, triple_buffer};
use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use super::{
    inspection::Inspection,
    worker::{Latest, Order, Shared, Worker},
};
use crate::{config::SinumerikConfig, reading::Reading};

/// A control that is corrected by its temperature compensation. A thread of its own reads and writes; the calls of a cycle
/// only take its latest reading and leave an order, so that no cycle waits for the control.
///
/// Whether a correction has landed tell the next readings: [`Controller::apply`] answers before it is sent, and answers
/// [`Fault::Refused`] while the control refuses what is written.
pub struct SinumerikController {
    description: Description,
    orders: Input<Order>,
    latest: Output<Latest>,
    number: u64,
    shared: Arc<Shared>,
}

impl SinumerikController {
    /// Begins to connect. Why there is no connection is logged as a warning (`tracing`).
    ///
    /// # Errors
    /// A configuration that makes no sense, or there is no thread.
    pub fn new(config: SinumerikConfig) -> Result<Self, DeviceError> {
        let device = config.server.url.clone();
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let (orders, ordered) = triple_buffer(&Order::default());
        let (read, latest) = triple_buffer(&Latest::default());
        let shared = Arc::new(Shared::default());
        let worker = Worker {
            reading: Reading::new(&config),
            config,
            orders: ordered,
            latest: read,
            shared: Arc::clone(&shared),
            opened: None,
            noted: Vec::new(),
        };
        start(&device, worker.run())?;
        Ok(Self {
            description,
            orders,
            latest,
            number: 0,
            shared,
        })
    }

    /// Waits for the first reading: for programs that are not in a hurry.
    ///
    /// # Errors
    /// Why there is none.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        let end = Instant::now() + at_most;
        while !self.latest.read().connected {
            if Instant::now() >= end {
                return Err(self.last_error().unwrap_or_else(|| {
                    let found = format!("no reading within {} ms", at_most.as_millis());
                    let expected = "check the address and the cable";
                    DeviceError::no_answer(&*self.description.device, found, expected)
                }));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Why there is no connection. Takes a lock: not for a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.shared.last_error()
    }

    /// What the control told when the present session was opened; `None` where there is none. Takes a lock: not for a
    /// cycle.
    pub fn inspection(&self) -> Option<Inspection> {
        self.shared.found()
    }

    /// How often a session was opened.
    pub fn sessions(&self) -> u64 {
        self.shared.opened.load(Ordering::Relaxed)
    }

    /// How many writes were answered, and how many were too late to be sent.
    pub fn writes(&self) -> [u64; 2] {
        [&self.shared.written, &self.shared.missed].map(|count| count.load(Ordering::Relaxed))
    }
}

impl Controller for SinumerikController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _deadline: Instant) -> Result<Snapshot, Fault> {
        let latest = self.latest.read();
        if !latest.connected {
            return Err(Fault::NotConnected);
        }
        latest
            .snapshot
            .ok_or(Fault::Protocol("a node without a good number"))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if self.description.axes.is_empty() {
            return Err(Fault::Unsupported(
                "corrections of a control that is only read",
            ));
        }
        if !self.latest.read().connected {
            return Err(Fault::NotConnected);
        }
        self.number += 1;
        self.orders.write(Order {
            number: self.number,
            corrections: *corrections,
            deadline: Some(deadline),
        });
        match self.shared.refused.load(Ordering::Acquire) {
            0 => Ok(()),
            // The status code, as its bits.
            code => Err(Fault::Refused {
                code: code.cast_signed(),
                what: "SD43900 cannot be written: see the user's rights at the control",
            }),
        }
    }
}

impl Drop for SinumerikController {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
    }
}

/// Runs work of a control on a thread of its own.
pub(super) fn start(
    device: &str,
    work: impl Future<Output = ()> + Send + 'static,
) -> Result<(), DeviceError> {
    let no_thread = |error: std::io::Error| {
        let found = format!("no thread for its connection: {error}");
        let remedy = "check the limits on threads and memory of this process";
        DeviceError::open(device, found, remedy).caused_by(error)
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(no_thread)?;
    std::thread::Builder::new()
        .name("sinumerik".to_owned())
        .spawn(move || runtime.block_on(work))
        .map_err(no_thread)?;
    Ok(())
}
