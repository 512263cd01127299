//! Converts the report of a cycle to the published state.

use std::{collections::BTreeMap, time::Duration};

use hdrhistogram::Histogram;
use volcomp_guard::{Reasons, Scheme};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_port::Description;
use volcomp_runtime::{Model, PathReport, Report, Timing, ToolError};
use volcomp_vocabulary::{AxisKind, AxisName, Coordinate, Displacement, PerAxis};

use crate::{
    config::GuardTable,
    devices::words_of,
    documents::{
        ByAxis, ControllerState, CorrectionLimits, CycleTimes, MachineState, PathState, ProvenName,
        SensorState, StateName, Status, StretchTimes, round,
    },
    simulate::{Demo, Truth},
};

pub(crate) struct Facts<'a> {
    pub model: &'a Model,
    /// The configured controllers, in order of preference.
    pub controllers: &'a [Description],
    pub sensors: &'a [String],
    /// True errors of the machine if it is simulated.
    pub truth: Option<&'a Truth>,
    /// The configured limits.
    pub guard: Option<&'a GuardTable>,
    pub auto_arm: bool,
    pub cycle: Duration,
}

pub(crate) fn status(facts: &Facts<'_>, report: &Report, times: &Times) -> Status {
    let model = facts.model;
    let mut axes = model.axes.clone();
    axes.sort_unstable();
    let mut status = Status {
        state: report.state.into(),
        reasons: reasons(facts, report),
        armed: report.state.is_armed(),
        auto_arm: facts.auto_arm,
        simulated: facts.truth.is_some(),
        machine: MachineState {
            name: model.name.clone(),
            hash: model.hash.clone(),
            structure: model.structure(),
            axes,
        },
        // The dashboard sets this field, because it has the tokens.
        operable: false,
        controller: facts.controllers.get(report.active).map(|controller| ControllerState {
            device: controller.device.clone(),
            channel: controller.channel.clone(),
            number: report.active,
        }),
        controllers: paths(facts, report),
        positions_mm: ByAxis::new(),
        positions_deg: ByAxis::new(),
        correction_known: report.correction_known,
        correction_um: ByAxis::new(),
        correction_urad: ByAxis::new(),
        sent_um: ByAxis::new(),
        sent_urad: ByAxis::new(),
        proven: proven(model, report),
        wanted_um: ByAxis::new(),
        wanted_urad: ByAxis::new(),
        error_um: None,
        error_urad: None,
        error_axis_urad: None,
        residual_um: None,
        residual_axis_urad: None,
        true_error_um: None,
        true_residual_um: None,
        temperatures: temperatures(facts, report),
        limits: facts.guard.map(|guard| limits(guard, report)),
        // The dashboard sets this field, because it has the simulation.
        demo: None,
        held_back: report.held_back,
        faults: report.faults,
        uptime_s: round(report.now.as_secs_f64()),
        age_ms: 0.0,
        cycle: cycle(facts, report, times),
        // The publisher sets this field, because it has the state of the fleet.
        fleet: None,
    };
    let known = |index: usize| report.known >> index & 1 == 1;
    let active = report.paths.get(report.active);
    let is_confirmed = active.is_some_and(|path| path.confirmed.is_some());
    let confirmed = |index: usize| is_confirmed && is_written(report, index);
    let sent = |index: usize| report.sent.is_some() && is_written(report, index);
    let micro = Displacement::um_or_urad;
    [status.positions_mm, status.positions_deg] =
        by_kind(model, &report.positions, known, Displacement::mm_or_deg);
    [status.correction_um, status.correction_urad] =
        by_kind(model, &report.correction, confirmed, micro);
    let last = report.sent.unwrap_or(PerAxis::ZERO);
    [status.sent_um, status.sent_urad] = by_kind(model, &last, sent, micro);
    // Without a known model error the correction by the model is unknown, not zero.
    let wanted = |index: usize| known(index) && report.error.is_some();
    [status.wanted_um, status.wanted_urad] = by_kind(model, &report.wanted, wanted, micro);
    errors(&mut status, facts, report);
    status
}

/// The configured limits, reduced if the active path has no barrier.
fn limits(guard: &GuardTable, report: &Report) -> CorrectionLimits {
    let path = report.paths.get(report.active);
    let is_guarded = path.is_some_and(|path| path.scheme == Scheme::Barrier);
    let lowered = |limit: f64, without_barrier: f64| {
        if is_guarded { limit } else { limit.min(without_barrier) }
    };
    let limit_um = lowered(guard.limit_um, guard.limit_without_barrier_um);
    let limit_urad = guard.limit_urad;
    let limit_urad = limit_urad.map(|limit| lowered(limit, guard.limit_without_barrier_urad));
    let within = |warn: &f64, limit: Option<f64>| limit.is_some_and(|limit| *warn < limit);
    CorrectionLimits {
        limit_um,
        warn_um: guard.warn_um.filter(|warn| within(warn, Some(limit_um))),
        limit_urad,
        warn_urad: guard.warn_urad.filter(|warn| within(warn, limit_urad)),
        range_degc: Some(guard.range_degc),
    }
}

/// The reasons of the state. A rejected position is listed with its axis, a missing temperature with its sensor, and a
/// barrier misfit with its value.
fn reasons(facts: &Facts<'_>, report: &Report) -> Vec<String> {
    let model = facts.model;
    let controller = facts.controllers.get(report.active);
    let active = controller.zip(report.paths.get(report.active));
    let with_places = |text: &str, axes: u16| {
        let of = (0..model.axes.len()).filter(|index| axes >> index & 1 == 1);
        let places: Vec<String> = of
            .map(|index| {
                let axis = model.axes[index];
                if report.known >> index & 1 == 0 {
                    return axis.to_string();
                }
                let at = Displacement::new(axis.kind(), report.positions[index]);
                format!("{axis} {:.3}", Coordinate(at))
            })
            .collect();
        format!("{text}: {}", places.join(", "))
    };
    let texts = report.reasons.texts();
    texts
        .map(|text| match Reasons::with_text(text) {
            Some(Reasons::OUTSIDE_TRAVEL) => with_places(text, report.outside_travel),
            Some(Reasons::JUMPED) => with_places(text, report.jumped),
            Some(Reasons::DEGRADED) => with_sensors(text, facts, report),
            _ => match active {
                Some((controller, path)) => reason_of_path(text, controller, path),
                None => text.to_owned(),
            },
        })
        .collect()
}

/// The text of a reason with the sensors of the thermal terms that have no valid temperature.
fn with_sensors(text: &str, facts: &Facts<'_>, report: &Report) -> String {
    let is_missing = |name: &&str| {
        let place = facts.sensors.iter().position(|sensor| sensor == name);
        place.is_none_or(|place| report.sensors[place].degc.is_none())
    };
    let sensors = facts.model.sensors().iter().map(String::as_str);
    let missing: Vec<&str> = sensors.filter(is_missing).collect();
    if missing.is_empty() { text.to_owned() } else { format!("{text}: {}", missing.join(", ")) }
}

/// The text of a reason of a path. A barrier misfit is listed with the value found and the expected one.
fn reason_of_path(text: &str, controller: &Description, path: &PathReport) -> String {
    let unfit = Reasons::with_text(text) == Some(Reasons::BARRIER_UNFIT);
    match path.barrier_misfit.filter(|_| unfit) {
        Some(misfit) => {
            let axes: Vec<AxisName> = controller.axes.iter().map(|axis| axis.name).collect();
            format!("{text}: {}", words_of(misfit, &axes))
        }
        None => text.to_owned(),
    }
}

/// Marks the state as unknown after `silence` without a cycle, including positions and applied correction.
pub(crate) fn silence(status: &mut Status, silence: Duration) {
    status.state = StateName::Unknown;
    status.reasons = vec![format!("no cycle for {:.0} ms", silence.as_secs_f64() * 1e3)];
    status.correction_known = false;
    status.proven.clear();
    for path in &mut status.controllers {
        path.holds_correction = None;
        path.reasons.clear();
    }
    for values in [
        &mut status.positions_mm,
        &mut status.positions_deg,
        &mut status.correction_um,
        &mut status.correction_urad,
        &mut status.sent_um,
        &mut status.sent_urad,
        &mut status.wanted_um,
        &mut status.wanted_urad,
    ] {
        values.clear();
    }
    for errors in [
        &mut status.error_um,
        &mut status.error_urad,
        &mut status.error_axis_urad,
        &mut status.residual_um,
        &mut status.residual_axis_urad,
        &mut status.true_error_um,
        &mut status.true_residual_um,
    ] {
        *errors = None;
    }
    for sensor in &mut status.temperatures {
        sensor.degc = None;
        "bad".clone_into(&mut sensor.quality);
        sensor.reason = Some("no cycle".to_owned());
    }
}

pub(crate) fn age(status: &mut Status, age: Duration) {
    let age_ms = age.as_secs_f64() * 1e3;
    status.age_ms = round(age_ms);
    for path in &mut status.controllers {
        let ages = [&mut path.answered_ms, &mut path.positions_ms, &mut path.confirmed_ms];
        for ms in ages.into_iter().flatten() {
            *ms = round(*ms + age_ms);
        }
    }
}

/// Age after which a confirmed output is unknown, because the control may have released it. For a control without
/// read-back the outputs remain known until the guard withdraws them.
const KNOWN_FOR: Duration = Duration::from_secs(2);

fn paths(facts: &Facts<'_>, report: &Report) -> Vec<PathState> {
    let ms = |age: Option<Duration>| age.map(|age| round(age.as_secs_f64() * 1e3));
    let pairs = facts.controllers.iter().zip(&report.paths).enumerate();
    pairs
        .map(|(number, (controller, path))| PathState {
            device: controller.device.clone(),
            number,
            active: number == report.active,
            scheme: path.scheme.into(),
            answered_ms: ms(path.answered),
            positions_ms: ms(path.positions),
            confirmed_ms: ms(path.confirmed),
            holds_correction: (path.confirmed)
                .filter(|age| *age <= KNOWN_FOR || path.scheme == Scheme::NoReadBack)
                .map(|_| path.holds),
            reasons: (path.reasons.texts())
                .map(|text| reason_of_path(text, controller, path))
                .collect(),
        })
        .collect()
}

fn proven(model: &Model, report: &Report) -> BTreeMap<AxisName, ProvenName> {
    let axes = model.axes.iter().zip(&report.proven);
    axes.filter_map(|(name, proven)| Some((*name, (*proven)?.into()))).collect()
}

/// True if the active path writes an axis. The output of other axes is unknown.
fn is_written(report: &Report, index: usize) -> bool {
    report.written >> index & 1 == 1
}

/// The applied correction: linear axes in µm, rotary axes in µrad.
pub(crate) fn correction(model: &Model, report: &Report) -> [ByAxis; 2] {
    by_kind(model, &report.correction, |index| is_written(report, index), Displacement::um_or_urad)
}

fn by_kind(
    model: &Model,
    values: &PerAxis<f64>,
    known: impl Fn(usize) -> bool,
    shown: impl Fn(Displacement) -> f64,
) -> [ByAxis; 2] {
    [AxisKind::Linear, AxisKind::Rotary].map(|kind| {
        let axes = model.axes.iter().zip(values).enumerate();
        axes.filter(|(index, (name, _))| name.kind() == kind && known(*index))
            .map(|(_, (name, value))| (*name, round(shown(Displacement::new(kind, *value)))))
            .collect()
    })
}

fn errors(status: &mut Status, facts: &Facts<'_>, report: &Report) {
    let um = |mm: [f64; 3]| mm.map(|mm| round(mm * 1e3));
    let urad = |rad: [f64; 3]| rad.map(|rad| round(rad * 1e6));
    let has_axis = facts.model.has_rotary_axes();
    let axis = |error: ToolError| has_axis.then(|| urad(error.axis_rad));
    status.error_um = report.error.map(|error| um(error.position_mm));
    status.error_urad = report.error.map(|error| urad(error.rotation_rad));
    status.error_axis_urad = report.error.and_then(axis);
    // The residual is known only if the correction is known.
    let residual = report.residual.filter(|_| report.correction_known);
    status.residual_um = residual.map(|error| um(error.position_mm));
    status.residual_axis_urad = residual.and_then(axis);
    if let Some(truth) = facts.truth.filter(|_| report.error.is_some()) {
        let sensors = report.sensors.iter().take(facts.sensors.len());
        let degc: Vec<f64> = sensors.map(|sensor| sensor.degc.unwrap_or(20.0)).collect();
        // A frozen position or a heated sensor makes the gateway's values wrong, so take the errors from the simulated
        // machine.
        let mut sensors = report.sensors.iter().take(facts.sensors.len());
        let is_rejected = sensors.any(|sensor| sensor.degc.is_none());
        let deceives = |demo: &&Demo| is_rejected || !demo.active().is_empty();
        let [residual, error] = match truth.demo().filter(deceives) {
            Some(machine) => machine.residual_and_error().map(Vector3::from),
            None => [
                truth.residual(&report.positions, &report.correction, &degc),
                truth.error(&report.positions, &degc),
            ],
        };
        let um = |v: Vector3<f64>| um(v.into());
        status.true_error_um = Some(um(error));
        status.true_residual_um = report.correction_known.then_some(um(residual));
    }
}

fn temperatures(facts: &Facts<'_>, report: &Report) -> Vec<SensorState> {
    let pairs = facts.sensors.iter().zip(&report.sensors);
    pairs
        .map(|(name, sensor)| {
            let (degc, reason) = (sensor.degc, sensor.flaw.map(|flaw| flaw.to_string()));
            let quality = match (degc, &reason) {
                (None, _) => "bad",
                (Some(_), Some(_)) => "uncertain",
                (Some(_), None) => "good",
            };
            SensorState {
                name: name.clone(),
                degc: degc.map(round),
                quality: quality.to_owned(),
                reason,
            }
        })
        .collect()
}

fn cycle(facts: &Facts<'_>, report: &Report, times: &Times) -> CycleTimes {
    let histogram = |histogram: &IntervalHistogram| {
        let [p50_us, p99_us, max_us] = [0.5, 0.99, 1.0].map(|q| round(histogram.quantile_us(q)));
        StretchTimes { p50_us, p99_us, max_us }
    };
    let whole = histogram(&times.whole);
    CycleTimes {
        count: report.cycle,
        period_us: round(facts.cycle.as_secs_f64() * 1e6),
        p50_us: whole.p50_us,
        p99_us: whole.p99_us,
        max_us: whole.max_us,
        overruns: report.overruns,
        own: histogram(&times.own),
        reference: (!times.reference.is_empty()).then(|| histogram(&times.reference)),
        wake: histogram(&times.wake),
        exchange: histogram(&times.exchange),
        histogram_us: times.whole.bins_us(),
    }
}

/// Number of cycles in an interval. Histograms of the last complete and of the current interval are kept.
const CYCLES_PER_INTERVAL: u64 = 4096;

pub(crate) struct IntervalHistogram {
    current: Histogram<u64>,
    before: Histogram<u64>,
}

impl Default for IntervalHistogram {
    fn default() -> Self {
        // 100 ns to 100 s with 2 significant digits, within the bounds of the histogram.
        let empty = || Histogram::new_with_bounds(100, 100_000_000_000, 2).expect("valid bounds");
        Self { current: empty(), before: empty() }
    }
}

impl IntervalHistogram {
    fn add(&mut self, ns: u64) {
        self.current.saturating_record(ns);
    }

    fn rotate(&mut self) {
        std::mem::swap(&mut self.current, &mut self.before);
        self.current.reset();
    }

    /// Histogram of the last complete interval, or of the current one if none is complete.
    fn latest(&self) -> &Histogram<u64> {
        if self.before.is_empty() { &self.current } else { &self.before }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.latest().is_empty()
    }

    pub(crate) fn quantile_us(&self, quantile: f64) -> f64 {
        self.latest().value_at_quantile(quantile) as f64 * 1e-3
    }

    /// Counts in bins that double in width: upper edge of each bin (µs) and count.
    pub(crate) fn bins_us(&self) -> Vec<(f64, u64)> {
        let edges = (0..20).map(|power| 500_u64 << power);
        edges
            .map(|low| ((2 * low) as f64 * 1e-3, self.latest().count_between(low, 2 * low - 1)))
            .collect()
    }
}

#[derive(Default)]
pub(crate) struct Times {
    /// The complete cycle, from wake-up to completion.
    pub whole: IntervalHistogram,
    /// Compute time of the gateway by the CPU clock.
    pub own: IntervalHistogram,
    /// Time of the reference computation by the CPU clock; empty without a reference computation.
    pub reference: IntervalHistogram,
    /// Wake-up latency after the deadline.
    pub wake: IntervalHistogram,
    /// Time of the exchanges with controllers.
    pub exchange: IntervalHistogram,
    pub count: u64,
    pub overruns: u64,
}

impl Times {
    pub(crate) fn add(&mut self, timing: &Timing) {
        self.whole.add(timing.whole_ns);
        self.own.add(timing.own_ns);
        if timing.reference_ns > 0 {
            self.reference.add(timing.reference_ns);
        }
        self.wake.add(timing.wake_ns);
        self.exchange.add(timing.exchange_ns);
        self.count += 1;
        self.overruns += u64::from(timing.missed);
        if self.count.is_multiple_of(CYCLES_PER_INTERVAL) {
            for histogram in [
                &mut self.whole,
                &mut self.own,
                &mut self.reference,
                &mut self.wake,
                &mut self.exchange,
            ] {
                histogram.rotate();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use volcomp_guard::BarrierMisfit;
    use volcomp_port::{Axis, Heartbeat, ShownStates};

    #[test]
    fn a_barrier_that_does_not_fit_is_listed_with_its_value() {
        let axis = |name: AxisName| Axis {
            name,
            includes_correction: false,
            resolution: Displacement::from_micro(name.kind(), 1.0),
            largest: None,
        };
        let control = Description {
            device: "control".to_owned(),
            channel: "one".to_owned(),
            axes: [AxisName::X, AxisName::A].map(axis).to_vec(),
            reads: Vec::new(),
            heartbeat: Heartbeat::Watched,
            barrier: true,
            tells_applied: true,
            shown: ShownStates::ALL,
            sees_other_gateways: true,
            shortest_cycle: Duration::from_millis(1),
        };
        let path = PathReport {
            barrier_misfit: Some(BarrierMisfit::Limit { axis: 1, found: 150e-6, expected: 200e-6 }),
            ..PathReport::default()
        };
        let text = |reasons: Reasons| {
            let mut texts = reasons.texts();
            reason_of_path(texts.next().expect("one"), &control, &path)
        };
        assert_eq!(
            text(Reasons::BARRIER_UNFIT),
            "the control's barrier does not fit the limits: axis A: guard.limit_urad is 200 µrad, and the barrier permits 150 µrad"
        );
        assert_eq!(text(Reasons::NO_BARRIER), "no barrier");
    }
}
