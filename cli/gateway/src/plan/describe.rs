//! A plan as a document: values in the user's units, and where each comes from.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use volcomp_guard::{Reasons, protocol::Layout};
use volcomp_model::ModelError;
use volcomp_port::Description;
use volcomp_runtime::{AxisSettings, GuardSettings, PathPlan};
use volcomp_vocabulary::{AxisName, Displacement};

use super::{
    Devices, Plan, interop,
    needs::{self, Needs},
    notes::notes,
};
use crate::{
    config::Config,
    devices::ControllerDevice,
    documents::{
        AuditPlan, AxisPlan, BarrierPlan, ControllerPlan, DashboardPlan, GuardPlan, MachinePlan,
        PlanDocument, SensorPlan, Source, Stated, ThermometerPlan, round,
    },
};

pub(super) fn document(plan: &Plan) -> Result<PlanDocument, ModelError> {
    let config = &plan.config;
    let controllers = controllers(plan, &needs::of_paths(plan)?);
    let sensors = sensors(plan);
    let mut axes = plan.model.axes.clone();
    axes.sort_unstable();
    let guard = config.guard.as_ref().map(|guard| of_guard(plan, guard));
    Ok(PlanDocument {
        notes: notes(plan, guard.as_ref(), &controllers, &sensors),
        machine: MachinePlan {
            file: config.machine.display().to_string(),
            name: plan.model.name.clone(),
            hash: plan.model.hash.clone(),
            structure: plan.machine.chain().structure().to_string(),
            axes,
        },
        cycle_ms: stated(config, "cycle_ms", round(config.cycle.as_secs_f64() * 1e3)),
        auto_arm: stated(config, "auto_arm", config.auto_arm),
        guard,
        controllers,
        thermometers: thermometers(plan),
        sensors,
        dashboard: DashboardPlan {
            listen: stated(
                config,
                "dashboard.listen",
                config.dashboard.listen.to_string(),
            ),
            tls: plan.tls.is_some(),
            reading_needs_token: config.dashboard.reading_needs_token(),
            tokens: plan.tokens.plan(),
        },
        audit: AuditPlan {
            dir: stated(config, "audit.dir", config.audit_dir.display().to_string()),
        },
        fleet: (plan.fleet.as_ref()).and_then(|fleet| fleet.document(config)),
        interop: interop::described(plan),
        online: None,
    })
}

/// A value that the configuration states or leaves to its default.
pub(super) fn stated<T>(config: &Config, key: &str, value: T) -> Stated<T> {
    let source = if config.states(key) {
        Source::Configuration
    } else {
        Source::Default
    };
    Stated::by(source, value)
}

fn of_guard(plan: &Plan, guard: &GuardSettings) -> GuardPlan {
    let config = &plan.config;
    let temperatures = &guard.temperatures;
    let ramp = ramp_taken(plan, guard);
    let seconds = |key: &str, time: std::time::Duration, factor: f64| {
        stated(
            config,
            &format!("guard.{key}"),
            round(time.as_secs_f64() * factor),
        )
    };
    GuardPlan {
        hold_ms: seconds("hold_ms", guard.hold, 1e3),
        zero_after_ms: seconds("zero_after_ms", guard.zero_after, 1e3),
        ramp_s: seconds("ramp_s", ramp, 1.0).instead_of(round(guard.ramp.as_secs_f64())),
        stop_s: seconds("stop_s", guard.stop, 1.0),
        rotary_step_um: stated(config, "guard.rotary_step_um", round(guard.rotary_step.0)),
        hand_back_s: seconds("hand_back_s", guard.hand_back, 1.0),
        rapid_m_per_min: stated(
            config,
            "guard.rapid_m_per_min",
            guard.rapid.linear_m_per_min,
        ),
        rapid_rpm: stated(config, "guard.rapid_rpm", guard.rapid.rotary_rpm),
        max_degc_per_min: stated(
            config,
            "guard.max_degc_per_min",
            temperatures.max_degc_per_min,
        ),
        range_degc: stated(config, "guard.range_degc", temperatures.range_degc),
        temperature_stale_s: seconds("temperature_stale_s", temperatures.stale, 1.0),
        temperature_stuck_s: seconds(
            "temperature_stuck_s",
            temperatures.stuck_after.unwrap_or_default(),
            1.0,
        ),
        temperature_neighbours_k: stated(
            config,
            "guard.temperature_neighbours_k",
            temperatures.neighbours_k,
        ),
        temperature_hold_s: stated(config, "guard.temperature_hold_s", guard.fading.hold_s),
        temperature_fade_s: stated(config, "guard.temperature_fade_s", guard.fading.fade_s),
    }
}

/// The time that a ramp takes in every guard of the plan.
fn ramp_taken(plan: &Plan, guard: &GuardSettings) -> Duration {
    let taken = plan.paths.iter().map(|path| path.limits.ramp_taken());
    taken.max().unwrap_or(guard.ramp)
}

fn controllers(plan: &Plan, needs: &[Needs]) -> Vec<ControllerPlan> {
    let config = &plan.config;
    let paths = plan.paths.iter().zip(needs);
    let Devices::Configured { controllers, .. } = &plan.devices else {
        return paths
            .map(|(path, needs)| {
                let channel = Stated::by(Source::Device, path.description.channel.clone());
                let source = |_, _: &str| Source::Device;
                of_controller(plan, (path, needs), channel, BTreeMap::new(), source)
            })
            .collect();
    };
    let all = paths.zip(&config.controllers).zip(controllers);
    let writers = all
        .enumerate()
        .map(|(index, (((path, needs), controller), device))| {
            let key = |key: &str| format!("controller.{index}.{key}");
            let channel = stated(config, &key("channel"), path.description.channel.clone());
            let source =
                |name: AxisName, what: &str| source_of(config, device, &key(&of_kind(name, what)));
            ControllerPlan {
                pmc: device.pmc(),
                opc_ua: device.opc_ua(),
                ..of_controller(
                    plan,
                    (path, needs),
                    channel,
                    controller.fixed.clone(),
                    source,
                )
            }
        });
    let devices = controllers.iter().skip(plan.paths.len());
    let readers = plan.readers.iter().zip(devices);
    let readers = readers.map(|(reader, device)| of_reader(&reader.description, device));
    writers.chain(readers).collect()
}

/// A controller that is only read.
fn of_reader(description: &Description, device: &ControllerDevice) -> ControllerPlan {
    let mut reads: Vec<AxisName> = description.shown_axes().collect();
    reads.sort_unstable();
    ControllerPlan {
        url: description.device.clone(),
        channel: Stated::by(Source::Device, description.channel.clone()),
        watched: false,
        sees_other_gateways: false,
        shortest_cycle_ms: round(description.shortest_cycle.as_secs_f64() * 1e3),
        only_thermal: false,
        hold_ms: None,
        barrier: None,
        pmc: device.pmc(),
        opc_ua: device.opc_ua(),
        axes: Vec::new(),
        needs: BTreeMap::new(),
        needs_per_k: BTreeMap::new(),
        held: Vec::new(),
        reads,
        fixed: BTreeMap::new(),
    }
}

/// The key of a value of one axis in a `[[controller]]`.
fn of_kind(name: AxisName, what: &str) -> String {
    match what {
        "resolution" if name.is_rotary() => "resolution_urad".to_owned(),
        "resolution" => "resolution_um".to_owned(),
        other => other.to_owned(),
    }
}

fn source_of(config: &Config, device: &ControllerDevice, key: &str) -> Source {
    let is_resolution = key.contains(".resolution_");
    if is_resolution && device.tells_resolution() {
        Source::Device
    } else {
        stated(config, key, ()).source
    }
}

fn of_controller(
    plan: &Plan,
    (path, needs): (&PathPlan, &Needs),
    channel: Stated<String>,
    fixed: BTreeMap<AxisName, f64>,
    source: impl Fn(AxisName, &str) -> Source,
) -> ControllerPlan {
    let description: &Description = &path.description;
    let mut axes: Vec<AxisPlan> = description
        .axes
        .iter()
        .enumerate()
        .filter(|(place, _)| path.corrects(*place))
        .filter_map(|(place, axis)| {
            let settings = plan.guard.of(axis.name)?;
            let resolution = Stated::by(
                source(axis.name, "resolution"),
                round(axis.resolution.um_or_urad()),
            );
            let includes_correction = Stated::by(
                source(axis.name, "includes_correction"),
                axis.includes_correction,
            );
            let micro = |value| round(Displacement::new(axis.kind(), value).um_or_urad());
            Some(AxisPlan {
                resolution,
                includes_correction,
                test_shift: micro(path.limits.test_shift[place]),
                ..of_axis(
                    &plan.config,
                    axis.name,
                    &settings,
                    micro(path.limits.axes[place].reachable()),
                )
            })
        })
        .collect();
    axes.sort_unstable_by_key(|axis| axis.name);
    let names = description.axes.iter().map(|axis| axis.name);
    let held = names
        .enumerate()
        .filter(|(place, _)| !path.corrects(*place));
    let mut held: Vec<AxisName> = held.map(|(_, name)| name).collect();
    held.sort_unstable();
    let mut reads = description.reads.clone();
    reads.sort_unstable();
    ControllerPlan {
        url: description.device.clone(),
        channel,
        watched: !path.notes.contains(Reasons::UNWATCHED),
        sees_other_gateways: description.sees_other_gateways,
        shortest_cycle_ms: round(description.shortest_cycle.as_secs_f64() * 1e3),
        only_thermal: path.only_thermal,
        hold_ms: (path.limits.hold != plan.guard.hold)
            .then(|| round(path.limits.hold.as_secs_f64() * 1e3)),
        barrier: barrier(path),
        pmc: None,
        opc_ua: None,
        axes,
        needs: needs.up_to.clone(),
        needs_per_k: needs.per_k.clone(),
        held,
        reads,
        fixed,
    }
}

/// The barrier of a path, as it was configured.
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

/// The limits of one axis, of which corrections up to `reachable` (µm, µrad) are written; step and test shift are those
/// of its controller and not yet known here.
fn of_axis(
    config: &Config,
    name: AxisName,
    settings: &AxisSettings<Displacement>,
    reachable: f64,
) -> AxisPlan {
    let unit = if name.is_rotary() { "urad" } else { "um" };
    let value = |value: Displacement| round(value.um_or_urad());
    let from = |key: &str| format!("guard.{key}");
    let accel = settings.accel_per_s2.um_or_urad();
    // No correction above the largest one is written, so the warning comes there at the latest.
    let asked = value(settings.warn);
    let mut warn = stated(config, &from(&format!("warn_{unit}")), asked.min(reachable));
    if warn.source == Source::Configuration {
        warn = warn.instead_of(asked);
    }
    AxisPlan {
        name,
        kind: name.kind().name().to_owned(),
        unit: AxisPlan::unit_of(name.kind()).to_owned(),
        limit: stated(config, &from(&format!("limit_{unit}")), reachable)
            .instead_of(value(settings.limit)),
        warn,
        slew_per_s: stated(
            config,
            &from(&format!("slew_{unit}_per_s")),
            value(settings.slew_per_s),
        ),
        accel_per_s2: stated(
            config,
            &from(&format!("accel_{unit}_per_s2")),
            accel.is_finite().then(|| round(accel)),
        ),
        confirm: stated(
            config,
            &from(&format!("confirm_{unit}")),
            value(settings.confirm),
        ),
        resolution: Stated::by(Source::Device, 0.0),
        test_shift: 0.0,
        includes_correction: Stated::by(Source::Default, false),
    }
}

fn thermometers(plan: &Plan) -> Vec<ThermometerPlan> {
    let Devices::Configured { thermometers, .. } = &plan.devices else {
        return vec![ThermometerPlan {
            url: "simulated".to_owned(),
            sensors: plan.sensors.clone(),
        }];
    };
    let both = thermometers.iter().zip(&plan.config.thermometers);
    both.map(|(device, config)| ThermometerPlan {
        url: config.url.clone(),
        sensors: device.names().to_vec(),
    })
    .collect()
}

/// The sensors that the machine's terms name, and those that only a thermometer has.
fn sensors(plan: &Plan) -> Vec<SensorPlan> {
    let thermometers = thermometers(plan);
    let measured_by = |name: &str| {
        let has = |thermometer: &&ThermometerPlan| thermometer.sensors.iter().any(|s| s == name);
        thermometers.iter().find(has).map(|t| t.url.clone())
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
