//! The plan as a document: the effective configuration and the settings derived from it.

use std::collections::BTreeSet;

use volcomp_devices::{ControlMemory, ThermometerDevice};
use volcomp_guard::{Reasons, protocol::Layout};
use volcomp_kinematics::State;
use volcomp_model::ModelError;
use volcomp_port::Description;
use volcomp_runtime::{PathPlan, ReaderPlan, UncorrectedAxis, UncorrectedReason};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use crate::{
    documents::{
        AxisPlan, BarrierPlan, ByAxis, ControllerPlan, MachinePlan, PlanDocument, SensorPlan, round,
    },
    plan::{self, Plan},
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

fn of_reader(reader: &ReaderPlan) -> ControllerPlan {
    ControllerPlan { sees_other_gateways: false, ..of_driver(&reader.description) }
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

/// The sensors that thermal terms use, and further sensors of thermometers.
pub(super) fn sensors(plan: &Plan) -> Vec<SensorPlan> {
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
    let mut feeds: Vec<String> = expansion.chain(drift).collect();
    // Several terms of one error may use the sensor.
    let mut known = BTreeSet::new();
    feeds.retain(|term| known.insert(term.clone()));
    feeds
}

/// Correction within the travels that the machine file requires of a path, µm or µrad by axis.
struct Needs {
    /// Largest correction of each corrected axis, without thermal effects.
    up_to: ByAxis,
    /// Additional correction per kelvin of sensor temperature; empty without thermal terms.
    per_k: ByAxis,
}

fn needs(plan: &Plan) -> Result<Vec<Needs>, ModelError> {
    let kelvin = plan.machine.each_kelvin()?;
    let largest = |path: &PathPlan, of: &dyn Fn(&State) -> PerAxis<f64>| -> ByAxis {
        let all = plan.machine.largest_within_travels(&path.correctors, &path.fixed, of);
        all.into_iter().map(micro).collect()
    };
    let of_path = |path: &PathPlan| {
        let correction = |state: &State| plan.model.correction_of(state, &path.correctors).delta;
        let mut needs = Needs {
            up_to: if path.only_thermal { ByAxis::new() } else { largest(path, &correction) },
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

fn notes(plan: &Plan, controllers: &[ControllerPlan], sensors: &[SensorPlan]) -> Vec<String> {
    let mut notes = plan.machine.notes();
    notes.extend(of_fleet(plan));
    if plan.config.guard.is_none() {
        notes.push("[guard] is missing: it will not arm".to_owned());
    } else {
        notes.extend(ramp(plan));
        for (index, controller) in controllers.iter().enumerate() {
            notes.extend(by_axes(controller, |axis| limit(plan, axis)));
            notes.extend(by_axes(controller, |axis| beyond_limit(controller, axis)));
            notes.extend(by_axes(controller, |axis| test_shift(plan, index, axis)));
        }
    }
    let writes =
        |controller: &&ControllerPlan| !(controller.axes.is_empty() && controller.held.is_empty());
    for controller in controllers.iter().filter(writes).filter(|controller| !controller.watched) {
        notes.push(format!(
            "{}: nothing at the control ramps the correction out when the gateway stops",
            controller.url
        ));
    }
    for path in plan.paths() {
        notes.extend(path.uncorrected.iter().map(|axis| of_uncorrected(path, *axis)));
        notes.extend(linear_near_singular(plan, path));
    }
    for controller in &plan.config.controllers {
        let unseen = plan::by_name(controller.unseen()).into_iter();
        let names: Vec<&str> =
            unseen.filter_map(|(name, is_unseen)| is_unseen.then_some(name)).collect();
        if !names.is_empty() {
            notes.push(format!(
                "{}: it does not show {}: nothing holds the correction by that",
                controller.url,
                names.join(", ")
            ));
        }
    }
    notes.extend(of_sensors(plan, sensors));
    if plan.tokens.is_empty() {
        notes.push(if plan.config.auto_arm {
            "warning: auto-arm is on, and the configuration has no token: only this computer can disarm; state [dashboard] token_file or start with --token-file FILE".to_owned()
        } else {
            "the configuration has no token: to arm over HTTP state [dashboard] token_file or start with --token-file FILE; or state auto_arm = true above the first table".to_owned()
        });
    }
    let shdr = plan.config.shdr.as_ref().map(|own| ("shdr", own.listen));
    let opc_ua = plan.config.opc_ua.as_ref();
    let opc_ua = opc_ua.map(|own| ("opc_ua", own.listen));
    for (table, listen) in shdr.into_iter().chain(opc_ua) {
        if !listen.ip().is_loopback() {
            notes.push(format!(
                "[{table}] {listen}: every client that reaches this address can read the state, without a token and without TLS"
            ));
        }
    }
    notes
}

/// Notes on sensors that only the machine file or only the configuration names: a misspelt name is in both.
pub(super) fn of_sensors(plan: &Plan, sensors: &[SensorPlan]) -> Vec<String> {
    let note = |sensor: &SensorPlan| match sensor.thermometer {
        None => Some(format!(
            "no thermometer has the sensor {}: its thermal terms ({}) are left out",
            sensor.name,
            sensor.feeds.join(", ")
        )),
        // The sensors of the built-in simulation are not configured.
        Some(_) if sensor.feeds.is_empty() && plan.devices.simulation.is_none() => {
            Some(format!("sensor {} is used by no thermal term of the machine", sensor.name))
        }
        Some(_) => None,
    };
    sensors.iter().filter_map(note).collect()
}

fn of_fleet(plan: &Plan) -> Vec<String> {
    let (Some(config), Some(found)) = (&plan.config.fleet, &plan.fleet) else {
        return Vec::new();
    };
    let clear = volcomp_fleet::in_the_clear(&config.url).next().map(|server| {
        format!(
            "[fleet] url: the connection to {server} is not encrypted: third parties can read machine files and states, but not change the accepted ones; use tls://"
        )
    });
    let damage = found.damage.as_ref().map(|damage| {
        format!(
            "[fleet] dir: {damage}: the configured machine file corrects until the centre sends one again"
        )
    });
    clear.into_iter().chain(damage).collect()
}

fn of_uncorrected(path: &PathPlan, UncorrectedAxis { axis, why }: UncorrectedAxis) -> String {
    let device = &path.description.device;
    match why {
        UncorrectedReason::Uncatchable => format!(
            "{device}: axis {axis} is not corrected: the linear axes that correct do not reach every direction, so they cannot compensate the motion of the tool tip by {axis}"
        ),
        UncorrectedReason::Coarse(error) => format!(
            "{device}: axis {axis} is not corrected: half a step of it moves the tool tip by up to {} µm in the work space, and {} µm are allowed (rotary_step_um); a finer step (resolution_urad) corrects it",
            round(error.to_um().0),
            round(path.rotary_step.to_um().0)
        ),
    }
}

/// Note about linear axes that the rotary axes turn into nearly the same direction at a pose.
fn linear_near_singular(plan: &Plan, path: &PathPlan) -> Option<String> {
    let pose = plan.model.linear_near_singular(&path.correctors)?;
    let axes = plan.model.axes.iter().zip(&pose);
    let at: Vec<String> = axes
        .filter(|(name, _)| name.is_rotary())
        .map(|(name, at)| {
            let at = Displacement::new(name.kind(), *at).mm_or_deg();
            format!("{name} = {} deg", round(at))
        })
        .collect();
    Some(format!(
        "{}: at {} the linear axes that correct lie nearly in one direction: there they take more than ten times the error, and are limited together",
        path.description.device,
        at.join(", ")
    ))
}

fn ramp(plan: &Plan) -> Option<String> {
    let configured = plan.guard.ramp;
    let taken = plan.paths.iter().map(|path| path.limits.ramp_taken());
    let taken = taken.max().filter(|taken| *taken != configured)?;
    Some(format!(
        "ramp_s: {} s are configured, and a ramp takes {} s: at least 20 cycles, and a cycle takes {} ms",
        round(configured.as_secs_f64()),
        round(taken.as_secs_f64()),
        plan.config.cycle_ms
    ))
}

fn by_axes(
    controller: &ControllerPlan,
    of_axis: impl Fn(&AxisPlan) -> Option<String>,
) -> impl Iterator<Item = String> {
    let mut notes: Vec<(Vec<String>, String)> = Vec::new();
    for axis in &controller.axes {
        let Some(note) = of_axis(axis) else { continue };
        match notes.iter_mut().find(|(_, known)| *known == note) {
            Some((letters, _)) => letters.push(axis.name.to_string()),
            None => notes.push((vec![axis.name.to_string()], note)),
        }
    }
    let url = controller.url.clone();
    notes.into_iter().map(move |(letters, note)| {
        let axes = if letters.len() > 1 { "axes" } else { "axis" };
        format!("{url}: {axes} {}: {note}", letters.join(", "))
    })
}

/// Note about a limit that is reduced because the control has no barrier, or that is not a whole number of steps.
fn limit(plan: &Plan, axis: &AxisPlan) -> Option<String> {
    let configured = round(plan.guard.of(axis.name)?.limit.um_or_urad());
    // An axis with the limit 0 is not corrected; another note covers this case.
    if configured == axis.limit || axis.limit == 0.0 {
        return None;
    }
    if configured - axis.limit >= axis.resolution {
        return Some(format!(
            "without a barrier in the control corrections go up to {} {unit}, not {configured} {unit}: a late write or a wrong reading may make a step as large as that (limit_without_barrier_{})",
            axis.limit,
            if axis.unit == "µm" { "um" } else { "urad" },
            unit = axis.unit
        ));
    }
    Some(format!(
        "the limit {configured} {unit} is not a multiple of the step {} {unit}: corrections go up to {} {unit}",
        axis.resolution,
        axis.limit,
        unit = axis.unit
    ))
}

fn beyond_limit(controller: &ControllerPlan, axis: &AxisPlan) -> Option<String> {
    let (needs, unit) = (*controller.needs.get(&axis.name)?, &axis.unit);
    (needs > axis.limit + axis.resolution).then(|| {
        format!(
            "the machine file needs up to {needs} {unit} within the travels, and the limit is {} {unit}: beyond it the error is corrected only in part",
            axis.limit
        )
    })
}

fn test_shift(plan: &Plan, index: usize, axis: &AxisPlan) -> Option<String> {
    let device = plan.devices.controllers.get(index);
    let is_coarse = device.is_some_and(|device| device.settings().is_coarse);
    let stated = plan.config.controllers.get(index).and_then(|own| own.test_shift);
    let proves = stated.unwrap_or(!is_coarse);
    let configured = round(plan.guard.of(axis.name)?.test_shift.um_or_urad());
    if !proves || configured == 0.0 || configured == axis.test_shift {
        return None;
    }
    let unit = &axis.unit;
    Some(if axis.test_shift == 0.0 {
        "no test shift: four steps of the correction or of the position exceed the limit".to_owned()
    } else {
        format!(
            "the test shift is {} {unit} instead of {configured} {unit}: at least four steps of the correction and of the position",
            axis.test_shift
        )
    })
}
