//! Temperatures of a control's PLC, updated by a separate thread.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_port::{
    DeviceError, Published, Publisher, Reason, Temperature, Thermometer, published,
};

use super::{controller::start, failure_log::FailureLog, link::Link};
use crate::{error::SinumerikError, server::Server};

/// A temperature sensor of a control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sensor {
    /// Name of the sensor.
    pub name: String,
    /// The node id with the temperature in °C, such as `/Plc/DB5.DBD0:REAL`.
    pub node: String,
}

/// Temperatures of a control, read once per period of its server, at most once a second.
pub struct SinumerikThermometer {
    published: Published,
    ends: Arc<AtomicBool>,
}

impl SinumerikThermometer {
    /// Starts reading. A control that does not answer is retried, and its sensors are bad until then.
    ///
    /// # Errors
    /// An invalid server configuration, or the thread cannot be started.
    pub fn new(server: Server, sensors: &[Sensor]) -> Result<Self, DeviceError> {
        let device = server.url.clone();
        server.check().map_err(|error| error.of(&*device))?;
        let names = sensors.iter().map(|sensor| sensor.name.clone()).collect();
        let (publisher, published) = published(&*device, names);
        let ends = Arc::new(AtomicBool::new(false));
        let asker = SensorPoller {
            nodes: sensors.iter().map(|sensor| sensor.node.clone()).collect(),
            latest: vec![Temperature::NOT_READ; sensors.len()],
            server,
            publisher,
            ends: Arc::clone(&ends),
            opened: None,
        };
        start(&device, asker.run())?;
        Ok(Self { published, ends })
    }
}

impl Thermometer for SinumerikThermometer {
    fn device(&self) -> &str {
        self.published.device()
    }

    fn names(&self) -> &[String] {
        self.published.names()
    }

    fn latest(&mut self) -> &[Temperature] {
        self.published.latest()
    }
}

impl Drop for SinumerikThermometer {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
    }
}

struct SensorPoller {
    server: Server,
    nodes: Vec<String>,
    latest: Vec<Temperature>,
    publisher: Publisher,
    ends: Arc<AtomicBool>,
    opened: Option<Instant>,
}

impl SensorPoller {
    async fn run(mut self) {
        let mut pause = Duration::ZERO;
        let mut failures = FailureLog::default();
        while !self.ends.load(Ordering::Acquire) {
            let Err(error) = self.session().await else {
                return;
            };
            let lived = self.opened.take().map_or(Duration::ZERO, |at| at.elapsed());
            let text = error.of(&*self.server.url).to_string();
            if failures.is_new(&text, lived) {
                tracing::warn!("{text}");
            }
            let now = Instant::now();
            self.latest.fill(Temperature::bad(Reason::NoAnswer, now));
            self.publisher.publish(&self.latest);
            pause = self.server.backoff.next(pause, lived);
            self.sleep(pause).await;
        }
    }

    async fn sleep(&self, pause: Duration) {
        let end = Instant::now() + pause;
        while !self.ends.load(Ordering::Acquire) && Instant::now() < end {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    async fn session(&mut self) -> Result<(), SinumerikError> {
        let link = Link::open(&self.server).await?;
        self.opened = Some(Instant::now());
        let every = self.server.period.max(Duration::from_secs(1));
        while !self.ends.load(Ordering::Acquire) {
            let answer = link.read(&self.nodes).await?;
            let middle = answer.begun + answer.ended.saturating_duration_since(answer.begun) / 2;
            for (into, value) in self.latest.iter_mut().zip(answer.numbers()) {
                let age = value.age.filter(|_| self.server.source_timestamps);
                let taken = middle
                    .checked_sub(age.unwrap_or_default())
                    .unwrap_or(answer.begun);
                *into = match value.number {
                    Some(degc) => Temperature::good(degc, taken),
                    None => Temperature::bad(Reason::Reported, taken),
                };
            }
            self.publisher.publish(&self.latest);
            self.sleep(every).await;
        }
        link.close().await;
        Ok(())
    }
}
