//! One way to a simulated machine.

use std::time::{Duration, Instant};

use volcomp_vocabulary::PerChannel;

use super::Plant;
use crate::{Controller, Description, Fault, Heartbeat, ShownStates, Snapshot, Words};

/// The shortest cycle of a machine whose control runs no program.
const SHORTEST_CYCLE: Duration = Duration::from_micros(10);

/// The controller of a simulated machine. The machine goes on without it.
pub struct SimulatedController {
    description: Description,
    plant: Plant,
    /// Which mailbox its frames go to.
    way: usize,
    barrier: bool,
}

impl SimulatedController {
    pub(super) fn first(plant: Plant) -> Self {
        Self::on(plant, 0)
    }

    fn on(plant: Plant, way: usize) -> Self {
        let (axes, scan) = plant.shape();
        Self {
            description: Description {
                device: "simulated".to_owned(),
                channel: "simulated".to_owned(),
                axes,
                reads: Vec::new(),
                heartbeat: Heartbeat::Watched,
                barrier: scan.is_some(),
                tells_applied: true,
                shown: ShownStates::ALL,
                // Nobody else can reach it.
                sees_other_gateways: true,
                shortest_cycle: scan.unwrap_or(SHORTEST_CYCLE),
            },
            plant,
            way,
            barrier: scan.is_some(),
        }
    }

    /// Another controller of the same machine, with a mailbox of its own where the control runs a program: as a second
    /// gateway has, or a second bus. `None` when [`MOST_WAYS`](super::MOST_WAYS) lead there already.
    pub fn another(&self) -> Option<Self> {
        let way = self.plant.another_way()?;
        Some(Self::on(self.plant.clone(), way))
    }

    /// The machine, to be looked at while others hold the controller.
    pub fn plant(&self) -> Plant {
        self.plant.clone()
    }

    /// Where the program is now, without correction.
    pub fn commanded(&self) -> PerChannel<f64> {
        self.plant.commanded()
    }

    /// The error of the tool now with the applied correction, and without: mm and rad for each axis.
    pub fn residual_and_error(&self) -> [PerChannel<f64>; 2] {
        self.plant.residual_and_error()
    }

    fn connected(&self) -> Result<&Plant, Fault> {
        if self.plant.is_disconnected() {
            return Err(Fault::NotConnected);
        }
        Ok(&self.plant)
    }
}

impl Controller for SimulatedController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _deadline: Instant) -> Result<Snapshot, Fault> {
        Ok(self.connected()?.snapshot())
    }

    fn post(&mut self, frame: &Words, _deadline: Instant) -> Result<(), Fault> {
        if !self.barrier {
            return Err(Fault::Unsupported(
                "frames, since the control has no barrier",
            ));
        }
        self.connected()?.post(self.way, frame);
        Ok(())
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _deadline: Instant) -> Result<(), Fault> {
        if self.barrier {
            return Err(Fault::Unsupported(
                "plain values, since the control has a barrier",
            ));
        }
        self.connected()?.apply(corrections);
        Ok(())
    }
}
