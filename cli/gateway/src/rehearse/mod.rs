//! A commissioning test: runs the configured machine, limits, cycle and controllers on a simulated machine, under every
//! fault of a catalogue. No device is opened, and nothing is sent. Time is simulated, so that minutes of machine time
//! take seconds.
//!
//! Each controller is rehearsed alone on a separate machine: with the reference barrier, set to the configured limits,
//! if the configuration has one, else with plain values, with or without read-back. Each fault starts on a new machine,
//! so that it can be repeated alone.

mod faults;
mod judge;
mod machine;
mod protocol;
mod run;
mod text;

use std::time::Duration;

pub use faults::{CATALOGUE, Fault};
pub use machine::Rig;
pub use text::{COLUMNS, text};
use volcomp_runtime::PathPlan;

use crate::{
    documents::{RehearsalDocument, RehearsedFault, RehearsedPath, round},
    error::GatewayError,
    plan::Plan,
};
use faults::Act;
use judge::{Findings, Phase};
use run::Run;

/// Timeout for reaching compensation after the start, and again after a fault.
const PATIENCE: Duration = Duration::from_secs(30);
/// Duration of compensation before a fault, and of observation after it.
const CALM: Duration = Duration::from_millis(400);

/// Parameters of a rehearsal.
#[derive(Clone, Debug)]
pub struct Rehearsal {
    /// Seed of the random numbers.
    pub seed: u64,
    /// The faults to rehearse; empty: all of them.
    pub faults: Vec<&'static Fault>,
    /// Speed factor of the simulated control's barrier: 1, except in tests that need a failing rehearsal.
    pub barrier_rate: i16,
}

impl Default for Rehearsal {
    fn default() -> Self {
        Self {
            seed: 1,
            faults: Vec::new(),
            barrier_rate: 1,
        }
    }
}

impl Rehearsal {
    /// Selects faults by name; without names, all of them.
    ///
    /// # Errors
    /// A name is not in the catalogue.
    pub fn of(seed: u64, names: &[String]) -> Result<Self, GatewayError> {
        let find = |name: &String| {
            let found = CATALOGUE.iter().find(|fault| fault.name == name);
            found.ok_or_else(|| {
                let names: Vec<&str> = CATALOGUE.iter().map(|fault| fault.name).collect();
                GatewayError::invalid(format!(
                    "--fault: found {name:?}, expected one of {}",
                    names.join(", ")
                ))
            })
        };
        Ok(Self {
            seed,
            faults: names.iter().map(find).collect::<Result<_, _>>()?,
            ..Self::default()
        })
    }

    /// Rehearses the plan. No device is opened.
    ///
    /// # Errors
    /// The configuration has no limits, or no barrier can be set to them. A broken rule is not an error: the document
    /// reports it.
    pub fn run(&self, plan: &Plan) -> Result<RehearsalDocument, GatewayError> {
        if plan.config.guard.is_none() {
            return Err(GatewayError::invalid_in(
                &plan.config.file,
                "[guard] is missing, expected it: without limits nothing is corrected",
            ));
        }
        let head = protocol::Head::of(&plan.config.file)?;
        let mut simulated = Duration::ZERO;
        let paths = plan.paths().iter();
        let controllers = paths
            .map(|path| self.path(plan, path, &mut simulated))
            .collect::<Result<Vec<_>, _>>()?;
        let passed = controllers
            .iter()
            .all(|path| path.faults.iter().all(|fault| fault.passed));
        Ok(RehearsalDocument {
            passed,
            time: head.time,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            user: head.user,
            host: head.host,
            machine: plan.model.name.clone(),
            hash: plan.model.hash.clone(),
            config: plan.config.file.clone(),
            config_hash: head.config_hash,
            selection: (self.faults.iter())
                .map(|fault| fault.name.to_owned())
                .collect(),
            catalogue: CATALOGUE.len(),
            seed: self.seed,
            cycle_ms: plan.config.cycle_ms,
            simulated_s: round(simulated.as_secs_f64()),
            not_rehearsed: not_rehearsed(plan),
            controllers,
        })
    }

    fn path(
        &self,
        plan: &Plan,
        path: &PathPlan,
        simulated: &mut Duration,
    ) -> Result<RehearsedPath, GatewayError> {
        let asked = self.faults.iter().copied();
        let all = CATALOGUE.iter().filter(|_| self.faults.is_empty());
        let (mut found, mut left_out) = (Vec::new(), Vec::new());
        for fault in asked.chain(all) {
            // Faults of a sensor are skipped if there is none.
            let needs_sensor = matches!(fault.act, Act::SensorJump | Act::SensorCorrupt);
            if needs_sensor && plan.sensors.is_empty() {
                left_out.push(fault.name.to_owned());
                continue;
            }
            for phase in [Phase::Compensating, Phase::Ramping] {
                found.push(self.fault(plan, path, fault, phase, simulated)?);
            }
        }
        let scheme = match (path.barrier.is_some(), path.no_read_back) {
            (true, _) => "barrier",
            (false, false) => "plain",
            (false, true) => "no-read-back",
        };
        let barrier = machine::barrier(path)?;
        Ok(RehearsedPath {
            url: path.description.device.clone(),
            scheme: scheme.to_owned(),
            hold_ms: protocol::ms(path.limits.hold),
            zero_after_ms: protocol::ms(path.limits.zero_after),
            ramp_s: round(path.limits.ramp_taken().as_secs_f64()),
            barrier: protocol::barrier(path, barrier.as_ref()),
            limits: protocol::limits(path, barrier.as_ref()),
            faults: found,
            left_out,
        })
    }

    fn fault(
        &self,
        plan: &Plan,
        path: &PathPlan,
        fault: &Fault,
        phase: Phase,
        simulated: &mut Duration,
    ) -> Result<RehearsedFault, GatewayError> {
        let mut run = Run::new(plan, path, self.seed, self.barrier_rate)?;
        // Move the axes before arming: otherwise the test shift proves nothing.
        run.run(Duration::from_secs(1));
        let is_start = matches!(fault.act, Act::Nothing);
        if is_start {
            run.look();
        }
        let ready = match phase {
            Phase::Compensating => run.arm(PATIENCE, is_start),
            Phase::Ramping => run.arm_half(PATIENCE),
        };
        if ready && phase == Phase::Compensating {
            run.run(CALM);
        }
        if !is_start {
            run.look();
        }
        run.look_at_state();
        let (mut again, mut needed) = (None, Vec::new());
        if ready {
            run.disturb(fault.act)?;
            (again, needed) = run.recover(PATIENCE);
            run.run(CALM);
        }
        *simulated += run.elapsed();
        let findings = Findings {
            ready,
            again,
            needed,
            reasons: run.reasons(),
            worst: run.worst(),
            disbelieved: run.disbelieved(),
        };
        Ok(judge::judge(fault, phase, path, &run.rig, findings))
    }
}

/// The parts that a rehearsal of this plan cannot cover.
fn not_rehearsed(plan: &Plan) -> Vec<String> {
    let mut texts = vec![
        "the devices themselves, their wiring and the network: a simulated machine took their place".to_owned(),
        "whether the machine file is right: that needs a measurement".to_owned(),
        "this computer: how it keeps its time, its disk, the dashboard".to_owned(),
    ];
    let paths = plan.paths();
    if paths.iter().any(|path| path.barrier.is_some()) {
        texts.push(
            "the barrier in the real control: the simulated one is the reference, so the real one must be compared with it"
                .to_owned(),
        );
    }
    for path in paths.iter().filter(|path| path.barrier.is_none()) {
        texts.push(format!(
            "what the control behind {} does when nobody writes any more",
            path.description.device
        ));
    }
    if paths.len() > 1 {
        texts
            .push("the change from one controller to another: each was rehearsed alone".to_owned());
    }
    for path in paths {
        let stood: Vec<String> = (plan.model.axes.iter())
            .filter(|axis| path.description.index_of(**axis).is_none())
            .map(ToString::to_string)
            .collect();
        if !stood.is_empty() {
            texts.push(format!(
                "motion of {} on {}: they stood still",
                stood.join(", "),
                path.description.device
            ));
        }
    }
    if plan.sensors.is_empty() {
        texts.push("temperatures: no thermometer is configured".to_owned());
    }
    texts
}

impl RehearsalDocument {
    /// Fails if a rule was broken.
    ///
    /// # Errors
    /// The number of faults that broke a rule; each phase counts.
    pub fn verdict(&self) -> Result<(), GatewayError> {
        let faults = || self.controllers.iter().flat_map(|path| &path.faults);
        let broken = faults().filter(|fault| !fault.passed).count();
        if broken == 0 {
            return Ok(());
        }
        let count = faults().count();
        Err(GatewayError::failed(format!(
            "rehearsal: {broken} of {count} faults broke a rule"
        )))
    }
}
