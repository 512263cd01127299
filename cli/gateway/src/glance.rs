//! From the place of a machine in the process to what the overview shows of it.

use std::sync::Arc;

use crate::{
    documents::{ByAxis, Glance, Overview, PhaseName, StateName, round},
    slot::{Phase, Slot},
};

/// The machines of a process by their names.
pub type Places = Vec<(String, Arc<Slot>)>;

/// All machines at a glance.
pub fn overview(places: &Places) -> Overview {
    let machines = places
        .iter()
        .map(|(name, slot)| glance(name, &slot.phase()));
    Overview {
        machines: machines.collect(),
    }
}

fn glance(name: &str, phase: &Phase) -> Glance {
    let mut glance = Glance {
        name: name.to_owned(),
        phase: PhaseName::Starting,
        trouble: None,
        starts_again: false,
        dashboard: None,
        state: StateName::Unknown,
        reasons: Vec::new(),
        machine: None,
        simulated: false,
        age_ms: None,
        correction_known: false,
        correction_um: ByAxis::new(),
        correction_urad: ByAxis::new(),
    };
    match phase {
        Phase::Starting | Phase::Launching => {}
        Phase::Ended => glance.phase = PhaseName::Ended,
        Phase::Failed(failure) => {
            glance.phase = PhaseName::Failed;
            glance.trouble = Some(failure.what.clone());
            glance.starts_again = failure.again;
        }
        Phase::Running(live) => {
            let status = live.published.latest();
            glance.phase = PhaseName::Running;
            glance.dashboard = Some(live.url());
            glance.state = status.state;
            glance.reasons = status.reasons;
            glance.machine = Some(status.machine.name);
            glance.simulated = status.simulated;
            glance.age_ms = Some(round(status.age_ms));
            glance.correction_known = status.correction_known;
            glance.correction_um = status.correction_um;
            glance.correction_urad = status.correction_urad;
        }
    }
    glance
}
