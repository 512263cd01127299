//! The controller. It returns the latest reading and queues writes, without waiting for the control.

use std::{
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use triple_buffer::{Input, Output, triple_buffer};
use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use super::{
    inspection::Inspection,
    link::DECODING_STACK_BYTES,
    worker::{Latest, Shared, Worker, WriteRequest},
};
use crate::{config::SinumerikConfig, reading::Reading};

/// A control that is corrected through its temperature compensation. A separate thread reads and writes. The calls of a
/// cycle only return the latest reading and queue a write, so that no cycle waits for the control.
///
/// [`Controller::apply`] returns before the correction is sent; later readings show whether the correction was applied.
/// While the control rejects writes, `apply` returns [`Fault::Refused`].
pub struct SinumerikController {
    description: Description,
    requests: Input<WriteRequest>,
    latest: Output<Latest>,
    number: u64,
    shared: Arc<Shared>,
}

impl SinumerikController {
    /// Starts a thread that connects to the control. Connection failures are logged as warnings (`tracing`).
    ///
    /// # Errors
    /// An invalid configuration, or the thread cannot be started.
    pub fn new(config: SinumerikConfig) -> Result<Self, DeviceError> {
        let device = config.server.url.clone();
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let (requests, ordered) = triple_buffer(&WriteRequest::default());
        let (read, latest) = triple_buffer(&Latest::default());
        let shared = Arc::new(Shared::default());
        let worker = Worker {
            reading: Reading::new(&config),
            config,
            requests: ordered,
            latest: read,
            shared: Arc::clone(&shared),
            opened: None,
            noted: Vec::new(),
        };
        start(&device, worker.run())?;
        Ok(Self { description, requests, latest, number: 0, shared })
    }

    /// Waits until a session is open and has tried its first reading. Do not call this on a real-time thread.
    ///
    /// # Errors
    /// No session was opened within `at_most`. The error is the last failure.
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

    /// Reason why no session is open; `None` if one is open. Takes a lock, so do not call this in a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.shared.last_error()
    }

    /// Properties that the control reported when the present session was opened; `None` without a session. Takes a
    /// lock, so do not call this in a cycle.
    pub fn inspection(&self) -> Option<Inspection> {
        self.shared.found()
    }

    pub fn sessions(&self) -> u64 {
        self.shared.opened.load(Ordering::Relaxed)
    }

    /// Two counts: writes that the control accepted or rejected, and writes that were dropped because their deadline
    /// had passed.
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
        latest.snapshot.ok_or(Fault::Protocol("a node without a valid number"))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if self.description.axes.is_empty() {
            return Err(Fault::Unsupported("corrections, where positions are only read"));
        }
        if !self.latest.read().connected {
            return Err(Fault::NotConnected);
        }
        self.number += 1;
        self.requests.write(WriteRequest {
            number: self.number,
            corrections: *corrections,
            deadline: Some(deadline),
        });
        match self.shared.refused.load(Ordering::Acquire) {
            0 => Ok(()),
            // The bits of the OPC UA status code.
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

pub(super) fn start(
    device: &str,
    work: impl Future<Output = ()> + Send + 'static,
) -> Result<(), DeviceError> {
    let no_thread = |error: std::io::Error| {
        let found = format!("no thread for its connection: {error}");
        let remedy = "check the limits on threads and memory of this process";
        DeviceError::open(device, found, remedy).caused_by(error)
    };
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(no_thread)?;
    std::thread::Builder::new()
        .name("sinumerik".to_owned())
        .stack_size(DECODING_STACK_BYTES)
        .spawn(move || runtime.block_on(work))
        .map_err(no_thread)?;
    Ok(())
}
