//! Notes of a plan that an operator should read before the first start.

use volcomp_runtime::{PathPlan, UncorrectedAxis, UncorrectedReason};
use volcomp_vocabulary::Displacement;

use super::{Plan, checks};
use crate::documents::{AxisPlan, ControllerPlan, SensorPlan, round};

/// All notes of a plan, in whole sentences.
pub(super) fn notes(
    plan: &Plan,
    controllers: &[ControllerPlan],
    sensors: &[SensorPlan],
) -> Vec<String> {
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
    for controller in controllers
        .iter()
        .filter(writes)
        .filter(|controller| !controller.watched)
    {
        notes.push(format!(
            "{}: nothing at the control ramps the correction out when the gateway stops",
            controller.url
        ));
    }
    for path in plan.paths() {
        notes.extend(
            path.uncorrected
                .iter()
                .map(|uncorrected| of_left_out(path, *uncorrected)),
        );
        notes.extend(linear_near_singular(plan, path));
    }
    for controller in &plan.config.controllers {
        let unseen = checks::by_name(controller.unseen()).into_iter();
        let names: Vec<&str> = unseen
            .filter_map(|(name, is_unseen)| is_unseen.then_some(name))
            .collect();
        if !names.is_empty() {
            notes.push(format!(
                "{}: it does not show {}: nothing holds the correction by that",
                controller.url,
                names.join(", ")
            ));
        }
    }
    for sensor in sensors.iter().filter(|sensor| sensor.thermometer.is_none()) {
        notes.push(format!(
            "no thermometer has the sensor {}: its thermal terms ({}) are left out",
            sensor.name,
            sensor.feeds.join(", ")
        ));
    }
    if plan.tokens.is_empty() {
        notes.push(if plan.config.auto_arm {
            "warning: no token: it arms itself, and only this computer can disarm it: state [dashboard] token_file".to_owned()
        } else {
            "no token: nobody can arm over HTTP: state [dashboard] token_file, start with --token-file FILE, or state auto_arm = true above the first table".to_owned()
        });
    }
    let shdr = plan.config.shdr.as_ref().map(|own| ("shdr", own.listen));
    let opc_ua = plan.config.opc_ua.as_ref();
    let opc_ua = opc_ua.map(|own| ("opc_ua", own.listen));
    for (table, listen) in shdr.into_iter().chain(opc_ua) {
        if !listen.ip().is_loopback() {
            notes.push(format!(
                "[{table}] {listen}: everybody who reaches this address reads the state, without a token and without TLS"
            ));
        }
    }
    notes
}

fn of_fleet(plan: &Plan) -> Vec<String> {
    let (Some(config), Some(found)) = (&plan.config.fleet, &plan.fleet) else {
        return Vec::new();
    };
    let clear = volcomp_fleet::in_the_clear(&config.url).next().map(|server| {
        format!(
            "[fleet] url: {server} is reached in the clear: others on the way can read machine files and states, though they cannot change what is taken; tls:// closes that"
        )
    });
    let damage = found.damage.as_ref().map(|damage| {
        format!(
            "[fleet] dir: {damage}: the configured machine file corrects until the centre sends one again"
        )
    });
    clear.into_iter().chain(damage).collect()
}

/// A rotary axis that could correct but does not.
fn of_left_out(path: &PathPlan, UncorrectedAxis { axis, why }: UncorrectedAxis) -> String {
    let device = &path.description.device;
    match why {
        UncorrectedReason::Uncatchable => format!(
            "{device}: axis {axis} is not corrected: the linear axes that correct do not reach every direction, so they could not take back what {axis} moves the tool tip"
        ),
        UncorrectedReason::Coarse(error) => format!(
            "{device}: axis {axis} is not corrected: half a step of it moves the tool tip by up to {} µm in the work space, and {} µm are allowed (rotary_step_um); a finer step (resolution_urad) corrects it",
            round(error.to_um().0),
            round(path.rotary_step.to_um().0)
        ),
    }
}

/// Linear axes that rotary axes turn into nearly the same direction at some pose.
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

/// A ramp that takes longer than configured.
fn ramp(plan: &Plan) -> Option<String> {
    let asked = plan.guard.ramp;
    let taken = plan.paths.iter().map(|path| path.limits.ramp_taken());
    let taken = taken.max().filter(|taken| *taken != asked)?;
    Some(format!(
        "ramp_s: {} s are asked for, and a ramp takes {} s: at least 20 cycles, and a cycle takes {} ms",
        round(asked.as_secs_f64()),
        round(taken.as_secs_f64()),
        plan.config.cycle_ms
    ))
}

/// Merges equal notes about the axes of a controller.
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

/// A limit that is reduced because there is no barrier, or that is not a whole number of steps.
fn limit(plan: &Plan, axis: &AxisPlan) -> Option<String> {
    let asked = round(plan.guard.of(axis.name)?.limit.um_or_urad());
    // An axis limited to 0 does not correct; another note covers it.
    if asked == axis.limit || axis.limit == 0.0 {
        return None;
    }
    if asked - axis.limit >= axis.resolution {
        return Some(format!(
            "without a barrier in the control corrections go up to {} {unit}, not {asked} {unit}: a late write or a wrong reading may make a step as large as that (limit_without_barrier_{})",
            axis.limit,
            if axis.unit == "µm" { "um" } else { "urad" },
            unit = axis.unit
        ));
    }
    Some(format!(
        "the limit {asked} {unit} is no whole number of steps of {} {unit}: corrections go up to {} {unit}",
        axis.resolution,
        axis.limit,
        unit = axis.unit
    ))
}

/// A limit below the largest correction of the machine file.
fn beyond_limit(controller: &ControllerPlan, axis: &AxisPlan) -> Option<String> {
    let (needs, unit) = (*controller.needs.get(&axis.name)?, &axis.unit);
    (needs > axis.limit + axis.resolution).then(|| {
        format!(
            "the machine file asks for up to {needs} {unit} within the travels, and the limit is {} {unit}: beyond it the error is corrected only in part",
            axis.limit
        )
    })
}

/// A test shift that is larger than configured, or cannot be made.
fn test_shift(plan: &Plan, index: usize, axis: &AxisPlan) -> Option<String> {
    let device = plan.devices.controllers.get(index);
    let is_coarse = device.is_some_and(|device| device.settings().is_coarse);
    let stated = plan
        .config
        .controllers
        .get(index)
        .and_then(|own| own.test_shift);
    let proves = stated.unwrap_or(!is_coarse);
    let asked = round(plan.guard.of(axis.name)?.test_shift.um_or_urad());
    if !proves || asked == 0.0 || asked == axis.test_shift {
        return None;
    }
    let unit = &axis.unit;
    Some(if axis.test_shift == 0.0 {
        "the test shift is not made: four steps of the correction or of the position are more than the limit".to_owned()
    } else {
        format!(
            "the test shift is {} {unit} instead of {asked} {unit}: at least four steps of the correction and of the position",
            axis.test_shift
        )
    })
}
