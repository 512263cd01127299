//! A commissioning test: runs the configured machine, limits, cycle and controllers on a simulated machine under every
//! fault of a catalogue. Opens no device and sends nothing. Time is simulated, so minutes of machine time take seconds.
//!
//! Each controller is rehearsed alone on its own simulated machine. A controller with a barrier runs with the reference
//! barrier, set to the configured limits; other controllers receive plain values, with or without read-back. Each fault
//! starts on a new machine, so that it can be repeated alone. [`text`] formats the result.

use std::{env, fmt::Write, fs, time::Duration};

use sha2::{Digest, Sha256};
use volcomp_document::nearest;
use volcomp_guard::barrier::Settings;
use volcomp_runtime::PathPlan;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    audit::utc_now,
    documents::{
        AxisBounds, Excursion, RehearsalDocument, RehearsedBarrier, RehearsedFault,
        RehearsedLimits, RehearsedPath, round,
    },
    error::GatewayError,
    plan::Plan,
    rehearse::{
        machine::FaultAction,
        run::{FaultPhase, Findings, Run, in_shown_unit, unit},
    },
};

mod machine;
mod run;

pub use machine::{CATALOGUE, Fault, Rig};

/// Timeout for reaching the compensating state after the start, and again after a fault.
const PATIENCE: Duration = Duration::from_secs(30);
const CALM: Duration = Duration::from_millis(400);

/// Parameters of a rehearsal.
#[derive(Clone, Debug)]
pub struct Rehearsal {
    /// Seed of the random numbers.
    pub seed: u64,
    /// The faults to rehearse; empty: all of them.
    pub faults: Vec<&'static Fault>,
    /// Factor of the rate of the simulated control's barrier: 1, except in tests that need a failing rehearsal.
    pub barrier_rate: i16,
}

impl Default for Rehearsal {
    fn default() -> Self {
        Self { seed: 1, faults: Vec::new(), barrier_rate: 1 }
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
                // `estop` has a word of `emergency_stop`.
                let is_in = |word: &str| word.len() > 2 && name.contains(word);
                let shares = |known: &&&str| known.split('_').any(is_in);
                let alike: Vec<&str> = nearest(name, &names).map_or_else(
                    || names.iter().filter(shares).copied().collect(),
                    |one| vec![one],
                );
                let expected = match &alike[..] {
                    [] => format!("expected one of {}", names.join(", ")),
                    alike => format!("did you mean {}?", alike.join(", ")),
                };
                GatewayError::invalid(format!("--fault: found {name:?}, {expected}"))
            })
        };
        Ok(Self {
            seed,
            faults: names.iter().map(find).collect::<Result<_, _>>()?,
            ..Self::default()
        })
    }

    /// Rehearses a plan. No device is opened.
    ///
    /// # Errors
    /// The configuration has no limits, or the limits give no valid settings of a barrier. A broken rule is no error:
    /// the document reports it.
    pub fn run(&self, plan: &Plan) -> Result<RehearsalDocument, GatewayError> {
        if plan.config.guard.is_none() {
            return Err(GatewayError::invalid_in(
                &plan.config.file,
                "[guard] is missing, expected it: without limits nothing is corrected",
            ));
        }
        let (file, time) = (&plan.config.file, utc_now());
        let config =
            fs::read(file).map_err(|source| GatewayError::Read { file: file.clone(), source })?;
        let mut simulated = Duration::ZERO;
        let paths = plan.paths().iter();
        let controllers = paths
            .map(|path| self.path(plan, path, &mut simulated))
            .collect::<Result<Vec<_>, _>>()?;
        let passed = controllers.iter().all(|path| path.faults.iter().all(|fault| fault.passed));
        Ok(RehearsalDocument {
            passed,
            time,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            user: user(),
            host: host(),
            machine: plan.model.name.clone(),
            hash: plan.model.hash.clone(),
            config: file.clone(),
            config_hash: format!("sha256:{}", volcomp_model::hexadecimal(&Sha256::digest(&config))),
            selection: (self.faults.iter()).map(|fault| fault.name.to_owned()).collect(),
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
        let requested = self.faults.iter().copied();
        let all = CATALOGUE.iter().filter(|_| self.faults.is_empty());
        let (mut found, mut left_out) = (Vec::new(), Vec::new());
        for fault in requested.chain(all) {
            // Without sensors the faults of sensors are left out.
            let needs_sensor =
                matches!(fault.act, FaultAction::SensorJump | FaultAction::SensorCorrupt);
            if needs_sensor && plan.sensors.is_empty() {
                left_out.push(fault.name.to_owned());
                continue;
            }
            for phase in [FaultPhase::Compensating, FaultPhase::Ramping] {
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
            hold_ms: ms(path.limits.hold),
            zero_after_ms: ms(path.limits.zero_after),
            ramp_s: round(path.limits.ramp_taken().as_secs_f64()),
            barrier: barrier_document(path, barrier.as_ref()),
            limits: limits(path, barrier.as_ref()),
            faults: found,
            left_out,
        })
    }

    fn fault(
        &self,
        plan: &Plan,
        path: &PathPlan,
        fault: &Fault,
        phase: FaultPhase,
        simulated: &mut Duration,
    ) -> Result<RehearsedFault, GatewayError> {
        let mut run = Run::new(plan, path, self.seed, self.barrier_rate)?;
        // Move the axes before arming: the test shift proves nothing for a position that has not moved in the last 10 s.
        run.run(Duration::from_secs(1));
        let is_start = matches!(fault.act, FaultAction::Nothing);
        if is_start {
            run.reset_axis_log();
        }
        let ready = match phase {
            FaultPhase::Compensating => run.arm(PATIENCE, is_start),
            FaultPhase::Ramping => run.arm_half(PATIENCE),
        };
        if ready && phase == FaultPhase::Compensating {
            run.run(CALM);
        }
        if !is_start {
            run.reset_axis_log();
        }
        run.reset_worst_state();
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
            rejected_position: run.rejected_position(),
        };
        Ok(run::judge(fault, phase, path, &run.rig, findings))
    }
}

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
            "what the control behind {} does when writes stop",
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
    /// The number of faults that broke a rule. A fault counts once for each phase.
    pub fn verdict(&self) -> Result<(), GatewayError> {
        let faults = || self.controllers.iter().flat_map(|path| &path.faults);
        let broken = faults().filter(|fault| !fault.passed).count();
        if broken == 0 {
            return Ok(());
        }
        let count = faults().count();
        Err(GatewayError::failed(format!("rehearsal: {broken} of {count} faults broke a rule")))
    }
}

fn user() -> String {
    let mut names = ["USER", "LOGNAME"].into_iter();
    let user = names.find_map(|name| env::var(name).ok());
    user.unwrap_or_else(|| format!("uid {}", rustix::process::getuid().as_raw()))
}

fn host() -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    host.trim().to_owned()
}

fn ms(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}

fn barrier_document(path: &PathPlan, settings: Option<&Settings>) -> Option<RehearsedBarrier> {
    let (settings, scan) = (settings?, path.barrier?.scan);
    Some(RehearsedBarrier {
        machine: settings.machine,
        scan_ms: ms(scan),
        hold_ms: ms(scan * u32::from(settings.hold_scans)),
        time_out_ms: ms(scan * u32::from(settings.time_out_scans)),
    })
}

/// The active limits, in display units.
fn limits(path: &PathPlan, barrier: Option<&Settings>) -> Vec<RehearsedLimits> {
    let step_s = |settings: &Settings| {
        let scan = path.barrier.map(|barrier| barrier.scan);
        scan.unwrap_or_default().as_secs_f64() * f64::from(settings.step_scans)
    };
    let axes = path.description.axes.iter().zip(&path.limits.axes);
    let of_axis = |(place, (axis, limits)): (usize, (&volcomp_port::Axis, &_))| {
        let limits: &volcomp_guard::AxisLimits = limits;
        let shown = |value: f64| round(value * in_shown_unit(axis.kind()));
        let rate = barrier
            .map(|settings| f64::from(settings.rate[place]) * limits.resolution / step_s(settings));
        let bounds = AxisBounds {
            limit: shown(limits.reachable()),
            slew_per_s: shown(limits.slew_per_s),
            accel_per_s2: limits.accel_per_s2.is_finite().then(|| shown(limits.accel_per_s2)),
            step: shown(limits.resolution),
            barrier_per_s: rate.map(shown),
        };
        let is_linear = axis.kind() == AxisKind::Linear;
        RehearsedLimits {
            axis: axis.name,
            um: is_linear.then_some(bounds),
            urad: (!is_linear).then_some(bounds),
        }
    };
    axes.enumerate().map(of_axis).collect()
}

/// Maximum line length of a filed report, columns.
pub const COLUMNS: usize = 60;
/// Minimum line width, columns.
const NARROWEST: usize = 40;

const PREAMBLE: &str = "No device was opened and nothing was sent: a simulated machine took the place of the configured \
devices. Each fault begins once while compensating, once in the middle of the ramp.";
const LEGEND: [(&str, &str); 5] = [
    ("state", "the worst state until it compensated again"),
    ("again", "how long after the end of the fault that was; -: before its end"),
    (
        "held",
        "how many scans (without a barrier: writes) moved an axis in emergency stop, alarm or unreferenced",
    ),
    (
        "change",
        "the largest change of the correction from one scan (without a barrier: from one write) to the next",
    ),
    ("furthest", "the largest correction"),
];
const BOUNDED: (&str, &str) =
    ("*", "without a barrier this cannot be detected; only the limit bounds the step");
const HIDDEN: (&str, &str) = (
    "+",
    "the gateway is not shown that the machine must stand; without a barrier the axes may move then",
);

struct Page {
    text: String,
    columns: usize,
}

/// Formats the rehearsal report; `columns` is clamped to 40 to 60.
pub fn text(document: &RehearsalDocument, columns: usize) -> String {
    let mut page = Page { text: String::new(), columns: columns.clamp(NARROWEST, COLUMNS) };
    page.head(document);
    page.wrapped("\n", PREAMBLE);
    let faults = || document.controllers.iter().flat_map(|path| &path.faults);
    let bounded = faults().any(|fault| fault.bounded_by_limit);
    let hidden = faults().any(|fault| fault.interlock_hidden);
    let marks = [bounded.then_some(BOUNDED), hidden.then_some(HIDDEN)];
    for (label, meaning) in LEGEND.into_iter().chain(marks.into_iter().flatten()) {
        page.wrapped(&format!("{label:<10}"), meaning);
    }
    for path in &document.controllers {
        page.controller(path);
    }
    page.wrapped("\n", "Not rehearsed:");
    for what in &document.not_rehearsed {
        page.wrapped("- ", what);
    }
    let count = faults().count();
    let broken = faults().filter(|fault| !fault.passed).count();
    let verdict = match broken {
        0 => format!("passed: {count} of {count} broke no rule"),
        _ => format!("failed: {broken} of {count} broke a rule"),
    };
    let selection = match document.selection.len() {
        0 => String::new(),
        some => format!(" (a selection: {some} of {} faults)", document.catalogue),
    };
    page.wrapped("\n", &(verdict + &selection));
    page.text
}

impl Page {
    fn is_narrow(&self) -> bool {
        self.columns < COLUMNS
    }

    fn head(&mut self, document: &RehearsalDocument) {
        let start = |hash: &str| hash.chars().take(23).collect::<String>() + "…";
        // Omit the fraction of a second.
        let time = document.time.get(..19).unwrap_or(&document.time);
        let faults = match document.selection.len() {
            0 => format!("all {}", document.catalogue),
            some => format!("a selection: {some} of {}", document.catalogue),
        };
        for (label, value) in [
            ("rehearsed", format!("{} UTC", time.replace('T', " "))),
            ("by", format!("{} on {}", document.user, document.host)),
            ("program", format!("volcomp-gateway {}", document.version)),
            ("machine", document.machine.clone()),
            ("checksum", start(&document.hash)),
            ("configuration", document.config.clone()),
            ("checksum", start(&document.config_hash)),
            ("cycle", format!("{} ms", document.cycle_ms)),
            ("faults", faults),
            ("seed", document.seed.to_string()),
            ("simulated", format!("{:.0} s", document.simulated_s)),
        ] {
            self.wrapped(&format!("{label:<14}"), &value);
        }
    }

    fn controller(&mut self, path: &RehearsedPath) {
        let scheme = match path.scheme.as_str() {
            "barrier" => "with the reference barrier in its control",
            "plain" => "plain values that can be read back, no barrier",
            _ => "plain values that cannot be read back, no barrier",
        };
        self.wrapped("\n", &path.url);
        self.wrapped("  ", &format!("simulated: {scheme}"));
        self.wrapped(
            "  ",
            &format!(
                "positions: held when {} ms old, zeroed when {} ms old; ramp {} s",
                path.hold_ms, path.zero_after_ms, path.ramp_s
            ),
        );
        if let Some(barrier) = &path.barrier {
            self.wrapped(
                "  ",
                &format!(
                    "barrier: machine {}, scan {} ms, hold {} ms, time-out {} ms",
                    barrier.machine, barrier.scan_ms, barrier.hold_ms, barrier.time_out_ms
                ),
            );
        }
        for limits in &path.limits {
            self.limits(limits);
        }
        if self.is_narrow() {
            self.text.push('\n');
        } else {
            self.line(format_args!(
                "\n  {:<14}{:<14}{:>9}{:>6}  verdict",
                "while", "state", "again", "held"
            ));
        }
        self.columns_of("axis", ["change", "allowed", "furthest", "limit"]);
        for phases in path.faults.chunk_by(|a, b| a.fault == b.fault) {
            self.fault(phases);
        }
        if !path.left_out.is_empty() {
            let names = path.left_out.join(", ");
            let why = "left out, since no thermometer is configured";
            self.wrapped("", &format!("{why}: {names}"));
        }
    }

    fn limits(&mut self, limits: &RehearsedLimits) {
        let (bounds, unit) = match (&limits.um, &limits.urad) {
            (Some(bounds), _) => (bounds, unit(AxisKind::Linear)),
            (None, Some(bounds)) => (bounds, unit(AxisKind::Rotary)),
            (None, None) => return,
        };
        let mut words =
            format!("limit {} {unit}, slew {} {unit}/s", bounds.limit, bounds.slew_per_s);
        // Writing to a string never fails.
        if let Some(accel) = bounds.accel_per_s2 {
            let _ = write!(words, ", {accel} {unit}/s²");
        }
        let _ = write!(words, ", step {} {unit}", bounds.step);
        if let Some(rate) = bounds.barrier_per_s {
            let _ = write!(words, ", barrier {rate} {unit}/s");
        }
        self.wrapped(&format!("  {}: ", limits.axis), &words);
    }

    fn fault(&mut self, phases: &[RehearsedFault]) {
        let Some(first) = phases.first() else {
            return;
        };
        let star = if first.bounded_by_limit { "*" } else { "" };
        let plus = if first.interlock_hidden { "+" } else { "" };
        let title = format!("{}{star}{plus}: {}", first.fault, first.meaning);
        self.wrapped("", &title);
        for phase in phases {
            self.phase(phase);
        }
        for (place, axis) in first.axes.iter().enumerate() {
            let found = phases.iter().filter_map(|phase| {
                let axis = phase.axes.get(place)?;
                axis.excursion().copied()
            });
            let kind = if axis.um.is_some() { AxisKind::Linear } else { AxisKind::Rotary };
            if let Some(found) = found.reduce(larger) {
                self.row(axis.axis, kind, &found);
            }
        }
    }

    fn phase(&mut self, phase: &RehearsedFault) {
        let again = match phase.compensating_after_s {
            None => "never".to_owned(),
            Some(s) if s <= 0.0 => "-".to_owned(),
            Some(s) => format!("{s:.2} s"),
        };
        let verdict = if phase.passed { "pass" } else { "FAIL" };
        let (name, state, held) = (&phase.phase, &phase.state, phase.moved_while_held);
        if self.is_narrow() {
            let words = format!("{name}: {state}, again {again}, held {held}, {verdict}");
            self.wrapped("  ", &words);
        } else {
            self.line(format_args!("  {name:<14}{state:<14}{again:>9}{held:>6}  {verdict}"));
        }
        if !phase.needed.is_empty() {
            self.wrapped("    by hand: ", &phase.needed.join(", "));
        }
        for rule in &phase.broken {
            self.wrapped("    broken: ", rule);
        }
    }

    fn row(&mut self, axis: AxisName, kind: AxisKind, found: &Excursion) {
        let numbers = [found.largest_change, found.allowed_change, found.furthest, found.limit];
        let label = format!("{axis} {}", unit(kind));
        self.columns_of(&label, numbers.map(|number| format!("{number:.2}")));
    }

    fn columns_of(&mut self, label: &str, [a, b, c, d]: [impl AsRef<str>; 4]) {
        let [a, b, c, d] = [a.as_ref(), b.as_ref(), c.as_ref(), d.as_ref()];
        if self.is_narrow() {
            self.line(format_args!(" {label:<6}{a:>8}{b:>8}{c:>9}{d:>8}"));
        } else {
            self.line(format_args!("    {label:<8}{a:>9}{b:>9}{c:>10}{d:>10}"));
        }
    }

    fn line(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "{line}");
    }

    /// Appends wrapped words after a head. Continuation lines are aligned with the first word.
    fn wrapped(&mut self, head: &str, words: &str) {
        let indent = head.trim_start_matches('\n').chars().count();
        let mut column = indent;
        self.text.push_str(head);
        for (index, word) in words.split(' ').enumerate() {
            let length = word.chars().count();
            if index > 0 && column + 1 + length > self.columns {
                self.text.push('\n');
                self.text.extend(std::iter::repeat_n(' ', indent));
                column = indent;
            } else if index > 0 {
                self.text.push(' ');
                column += 1;
            }
            self.text.push_str(word);
            column += length;
        }
        self.text.push('\n');
    }
}

fn larger(a: Excursion, b: Excursion) -> Excursion {
    Excursion {
        largest_change: a.largest_change.max(b.largest_change),
        furthest: a.furthest.max(b.furthest),
        ..a
    }
}
