//! Reads temperatures from the PLC of a control in a separate thread.

use std::time::{Duration, Instant};

use volcomp_port::{DeviceError, Published, Publisher, Reason, Temperature, published};

use crate::opc_ua::{
    link::Link,
    worker::{FailureLog, start},
};
use crate::{config::Server, error::SinumerikError};

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sensor {
    pub name: String,
    /// Node id with the temperature in °C, such as `/Plc/DB5.DBD0:REAL`.
    pub node: String,
}

/// Starts reading temperatures of a control in a separate thread, once per period of its server but at most once a
/// second. The thread ends when the returned thermometer is dropped. If the control does not answer, all sensors are
/// bad and reading is retried.
///
/// # Errors
/// An invalid server configuration, or the thread cannot be started.
pub fn poll_temperatures(server: Server, sensors: &[Sensor]) -> Result<Published, DeviceError> {
    let device = server.url.clone();
    server.check().map_err(|error| error.of(&*device))?;
    let names = sensors.iter().map(|sensor| sensor.name.clone()).collect();
    let (publisher, published) = published(&*device, names);
    let poller = SensorPoller {
        nodes: sensors.iter().map(|sensor| sensor.node.clone()).collect(),
        latest: vec![Temperature::NOT_READ; sensors.len()],
        server,
        publisher,
        opened: None,
    };
    start(&device, poller.run())?;
    Ok(published)
}

struct SensorPoller {
    server: Server,
    nodes: Vec<String>,
    latest: Vec<Temperature>,
    publisher: Publisher,
    opened: Option<Instant>,
}

impl SensorPoller {
    async fn run(mut self) {
        let mut pause = Duration::ZERO;
        let mut failures = FailureLog::default();
        while self.publisher.has_reader() {
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
        while self.publisher.has_reader() && Instant::now() < end {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    async fn session(&mut self) -> Result<(), SinumerikError> {
        let link = Link::open(&self.server).await?;
        self.opened = Some(Instant::now());
        let every = self.server.period.max(Duration::from_secs(1));
        while self.publisher.has_reader() {
            let answer = link.read(&self.nodes).await?;
            let middle = answer.begun + answer.ended.saturating_duration_since(answer.begun) / 2;
            for (into, value) in self.latest.iter_mut().zip(answer.numbers()) {
                let age = value.age.filter(|_| self.server.source_timestamps);
                let taken = middle.checked_sub(age.unwrap_or_default()).unwrap_or(answer.begun);
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
