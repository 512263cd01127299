//! The plan as a document: the effective configuration and what follows from it.

use std::collections::BTreeSet;

use volcomp_devices::{ControlMemory, ThermometerDevice};
use volcomp_guard::{Reasons, protocol::Layout};
use volcomp_kinematics::State;
use volcomp_model::ModelError;
use volcomp_port::Description;
use volcomp_runtime::{PathPlan, ReaderPlan};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use super::{Plan, notes::notes};
use crate::documents::{
    AxisPlan, BarrierPlan, ByAxis, ControllerPlan, MachinePlan, PlanDocument, SensorPlan, round,
};

pub(super) fn document(plan: &Plan) -> Result<PlanDocument, ModelError> {
    let config = &plan.config;
    let controllers = controllers(plan, &needs(plan)?);
    let sensors = sensors(plan);
    Ok(PlanDocument {
        notes: notes(plan, &controllers, &sensors),
        configuration: config.effective(),
        defaults: config.defaults(),
        machine: MachinePlan {
            file: config.machine.display().to_string(),
            name: plan.model.name.clone(),
            hash: plan.model.hash.clone(),
            structure: plan.machine.chain().structure().to_string(),
            axes: sorted(plan.model.axes.clone()),
        },
        controllers,
        sensors,
        tokens: plan.tokens.plan(),
        fleet: plan.fleet.as_ref().map(|fleet| fleet.document.clone()),
        online: None,
    })
}

fn sorted(mut axes: Vec<AxisName>) -> Vec<AxisName> {
    axes.sort_unstable();
    axes
}

fn controllers(plan: &Plan, needs: &[Needs]) -> Vec<ControllerPlan> {
    let paths = plan.paths.iter().zip(needs);
    let writers = paths.map(|(path, needs)| of_controller(plan, path, needs));
    let all = writers.chain(plan.readers.iter().map(of_reader));
    let with_memory = |(index, controller): (usize, ControllerPlan)| {
        let device = plan.devices.controllers.get(index);
        ControllerPlan {
            memory: device.map(|device| device.memory()).unwrap_or_default(),
            ..controller
        }
    };
    all.enumerate().map(with_memory).collect()
}

/// Describes a controller from its driver's description.
fn of_driver(description: &Description) -> ControllerPlan {
    ControllerPlan {
        url: description.device.clone(),
        channel: description.channel.clone(),
        watched: false,
        sees_other_gateways: description.sees_other_gateways,
        shortest_cycle_ms: round(description.shortest_cycle.as_secs_f64() * 1e3),
        axes: Vec::new(),
        held: Vec::new(),
        needs: ByAxis::new(),
        needs_per_k: ByAxis::new(),
        barrier: None,
        memory: ControlMemory::default(),
    }
}

/// Describes a controller that is only read.
fn of_reader(reader: &ReaderPlan) -> ControllerPlan {
    ControllerPlan {
        sees_other_gateways: false,
        ..of_driver(&reader.description)
    }
}

fn of_controller(plan: &Plan, path: &PathPlan, needs: &Needs) -> ControllerPlan {
    let axes = path.description.axes.iter().enumerate();
    let axes =
        axes.filter(|(place, axis)| path.corrects(*place) && plan.guard.of(axis.name).is_some());
    let axes = axes.map(|(place, axis)| {
        let micro = |value| round(Displacement::new(axis.kind(), value).um_or_urad());
        AxisPlan {
            name: axis.name,
            unit: AxisPlan::unit_of(axis.kind()).to_owned(),
            limit: micro(path.limits.axes[place].reachable()),
            resolution: round(axis.resolution.um_or_urad()),
            test_shift: micro(path.limits.test_shift[place]),
        }
    });
    let mut axes: Vec<AxisPlan> = axes.collect();
    axes.sort_unstable_by_key(|axis| axis.name);
    let names = path.description.axes.iter().map(|axis| axis.name);
    let held = names.enumerate();
    let held = held.filter(|(place, _)| !path.corrects(*place));
    ControllerPlan {
        watched: !path.notes.contains(Reasons::UNWATCHED),
        axes,
        held: sorted(held.map(|(_, name)| name).collect()),
        needs: needs.up_to.clone(),
        needs_per_k: needs.per_k.clone(),
        barrier: barrier(path),
        ..of_driver(&path.description)
    }
}

/// The configured barrier of a path.
fn barrier(path: &PathPlan) -> Option<BarrierPlan> {
    let settings = path.barrier?;
    let names = path.description.axes.iter().map(|axis| axis.name);
    let axes: Vec<AxisName> = names.collect();
    Some(BarrierPlan {
        machine: settings.machine,
        layout: Layout::of(axes.iter().copied()).ok()?.number(),
        axes,
        scan_ms: round(settings.scan.as_secs_f64() * 1e3),
    })
}

/// The sensors used by thermal terms, and those that only a thermometer provides.
fn sensors(plan: &Plan) -> Vec<SensorPlan> {
    let measured_by = |name: &String| {
        if plan.devices.simulation.is_some() {
            return Some("simulated".to_owned());
        }
        let has = |device: &ThermometerDevice| device.names.contains(name);
        let index = plan.devices.thermometers.iter().position(has)?;
        Some(plan.config.thermometers.get(index)?.url.clone())
    };
    let names: BTreeSet<&String> = plan.model.sensors().iter().chain(&plan.sensors).collect();
    names
        .into_iter()
        .map(|name| SensorPlan {
            name: name.clone(),
            feeds: feeds(plan, name),
            thermometer: measured_by(name),
        })
        .collect()
}

fn feeds(plan: &Plan, sensor: &str) -> Vec<String> {
    let expansion = plan.machine.thermal().expansion.iter();
    let expansion = expansion
        .filter(|term| term.sensor == sensor)
        .map(|term| format!("expansion {}", term.error));
    let drift = plan.machine.thermal().drift.iter();
    let drift = drift
        .filter(|term| term.sensors.contains_key(sensor))
        .map(|term| format!("drift {}", term.error));
    expansion.chain(drift).collect()
}

/// Correction that the machine file requires of a path within the travels, µm and µrad.
struct Needs {
    /// Largest correction of each correcting axis, without thermal effects.
    up_to: ByAxis,
    /// Additional correction per kelvin of sensor temperature; empty without thermal terms.
    per_k: ByAxis,
}

/// Required corrections of all paths.
fn needs(plan: &Plan) -> Result<Vec<Needs>, ModelError> {
    let kelvin = plan.machine.each_kelvin()?;
    let largest = |path: &PathPlan, of: &dyn Fn(&State) -> PerAxis<f64>| -> ByAxis {
        let all = plan
            .machine
            .largest_within_travels(&path.correctors, &path.fixed, of);
        all.into_iter().map(micro).collect()
    };
    let of_path = |path: &PathPlan| {
        let correction = |state: &State| plan.model.correction_of(state, &path.correctors).delta;
        let mut needs = Needs {
            up_to: if path.only_thermal {
                ByAxis::new()
            } else {
                largest(path, &correction)
            },
            per_k: kelvin.as_ref().map_or_else(ByAxis::new, |kelvin| {
                largest(path, &|state| kelvin.change(state, &path.correctors))
            }),
        };
        needs.per_k.retain(|_, most| *most > 0.0);
        needs
    };
    Ok(plan.paths.iter().map(of_path).collect())
}

fn micro((name, most): (AxisName, Displacement)) -> (AxisName, f64) {
    (name, round((most.um_or_urad() * 10.0).ceil() / 10.0))
}
