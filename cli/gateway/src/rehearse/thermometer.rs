//! The thermometer of a rehearsal, which outlives a restart of the gateway.

use std::sync::{Arc, Mutex};

use volcomp_port::{Temperature, Thermometer, inject::Faulty, simulated::SimulatedThermometer};

use super::machine::lock;

/// The thermometer with its faults, shared by the runs of a gateway and the rehearsal.
pub(super) type Shared = Arc<Mutex<Faulty<SimulatedThermometer>>>;

/// The thermometer as a cycle holds it.
pub(super) struct HeldThermometer {
    device: String,
    names: Vec<String>,
    shared: Shared,
    latest: Vec<Temperature>,
}

impl HeldThermometer {
    pub(super) fn new(shared: &Shared) -> Self {
        let (device, names) = {
            let faulty = lock(shared);
            (faulty.device().to_owned(), faulty.names().to_vec())
        };
        Self {
            device,
            latest: vec![Temperature::NOT_READ; names.len()],
            names,
            shared: Arc::clone(shared),
        }
    }
}

impl Thermometer for HeldThermometer {
    fn device(&self) -> &str {
        &self.device
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        self.latest.clear();
        self.latest.extend_from_slice(lock(&self.shared).latest());
        &self.latest
    }
}
