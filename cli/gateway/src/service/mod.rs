//! The service: the work around the control thread that has no deadline.
//!
//! This is requests, audit log, reloads, publication of the state, and proof of life for the service manager's
//! watchdog. The service never waits for a disk: the [`AuditWriter`] writes and the worker reads.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
        mpsc::{Receiver, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use volcomp_guard::{Cause, End, Phase, Reasons, Request, State};
use volcomp_port::{Clock, Description};
use volcomp_runtime::{DisarmSwitch, Handle, Model, Report, Timing, monotonic};
use volcomp_vocabulary::PerAxis;

use crate::{
    audit::{
        AuditLog, Entry, LogState, boot_id, output_file,
        writer::{AuditWriter, Receipt},
    },
    config::Config,
    documents::{
        Answer, ByAxis, Details, Event, LastOutput, ModelOutcome, ModelSource, Question, Settled,
        Standing, Start, StateChange, StateName, Status, Stop,
    },
    error::GatewayError,
    identity::Judgement,
    models::ModelReports,
    observe::{self, Facts, Times},
    options::Options,
    plan::Plan,
    published::Publisher,
    request::{ModelActivation, Reply, RequestQueue, ServiceRequest, refused},
    simulate::Truth,
};

mod reload;
mod requests;
pub(crate) mod standing;

/// Interval at which the state is published and changes are recorded.
const TICK: Duration = Duration::from_millis(50);
const STEP: Duration = Duration::from_millis(2);
/// Minimum intervals between records of sensors that are missing or back: the first, and the longest, to which it
/// doubles while a sensor comes and goes, so that the log is not filled.
const DEGRADED_EVERY: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(600)];
/// Timeout at shutdown for a control thread that hangs, and the same timeout again for the disk.
const END_TIMEOUT: Duration = Duration::from_secs(1);

/// The parts from which a service is built.
pub struct ServiceParts {
    pub handle: Handle,
    pub options: Options,
    pub config: Config,
    pub controllers: Vec<Description>,
    /// Sensor names, in the order of the configuration.
    pub sensors: Vec<String>,
    /// A copy of the cycle's model.
    pub model: Arc<Model>,
    /// True errors of the machine; `None` if the machine is not simulated.
    pub truth: Option<Truth>,
    /// State that survived the restart.
    pub standing: Standing,
    /// Reasons that forbid arming from the start.
    pub forbids: Reasons,
    /// Counter of the proofs that cycles are on time. It is incremented several times within `proven_within`.
    pub life: Life,
    /// Watchdog timeout of the service manager.
    pub proven_within: Duration,
    /// Channel to which the outcomes of models are sent.
    pub notes: ModelReports,
}

/// The service. State: the active parts, the pending requests, and the health of the audit log.
pub struct Service {
    clock: Clock,
    parts: ServiceParts,
    writer: AuditWriter,
    worker: Worker,
    /// Running check of the need for confirmation, after a start or a change of the model or limits.
    unconfirmed: Option<Comparison>,
    confirmed_model: Option<Arc<Model>>,
    switch: DisarmSwitch,
    publisher: Publisher,
    requests: RequestQueue,
    /// Queued requests to arm and to reload. They are executed one at a time.
    waiting: VecDeque<ServiceRequest>,
    pending: Vec<PendingRequest>,
    times: Times,
    published_at: Instant,
    last_state: State,
    standing: Standing,
    /// Receipt of the last write of the standing state.
    standing_receipt: Option<Receipt>,
    /// True if the standing state could not be written.
    standing_lost: bool,
    /// Time of the last retry of a failed write of the standing state.
    standing_tried: Instant,
    trouble: Option<&'static str>,
    /// Reasons of the service itself, shown with those of the guards, such as a required confirmation, a refused
    /// reload, or an unusable file of the centre.
    shown_reasons: Reasons,
    /// True once the gateway has armed, or an operator has taken over. Auto-arm is then off.
    auto_arm_done: bool,
    /// True once an operator has armed, disarmed or acknowledged. Auto-arm is off from then on.
    person_decides: bool,
    auto_arm_after: Instant,
    /// Number of disarm orders whose requests the service has received. The count of the switch is larger while such a
    /// request is queued or being created, and auto-arm then waits.
    received_disarms: u64,
    /// The last recorded reason `degraded`, with its sensors.
    degraded: Option<String>,
    degraded_at: Instant,
    degraded_pause: Duration,
    lags: Lags,
    watchdog: Watchdog,
}

impl Service {
    /// Builds a service around a control thread and an audit log.
    ///
    /// # Errors
    /// The operating system cannot create a thread.
    pub fn new(
        parts: ServiceParts,
        audit: AuditLog,
        publisher: Publisher,
        requests: RequestQueue,
    ) -> Result<Self, GatewayError> {
        let clock = parts.handle.clock().clone();
        let now = clock.now();
        let writer = AuditWriter::start(audit, clock.clone())
            .map_err(|e| GatewayError::system("audit log", e))?;
        let pulse = parts.handle.pulse();
        let mut service = Self {
            clock,
            writer,
            worker: Worker::default(),
            unconfirmed: None,
            confirmed_model: None,
            switch: parts.handle.disarm_switch(),
            publisher,
            requests,
            waiting: VecDeque::new(),
            pending: Vec::new(),
            times: Times::default(),
            published_at: now,
            last_state: State::Disarmed,
            standing_receipt: None,
            standing_lost: false,
            standing_tried: now,
            trouble: None,
            shown_reasons: Reasons::NONE,
            auto_arm_done: parts.standing.disarmed_by.is_some(),
            person_decides: parts.standing.disarmed_by.is_some(),
            auto_arm_after: now,
            received_disarms: 0,
            degraded: None,
            degraded_at: now,
            degraded_pause: DEGRADED_EVERY[0],
            lags: Lags::new(&parts.model, &parts.sensors),
            watchdog: Watchdog::new(
                parts.proven_within,
                parts.config.cycle(),
                pulse.patience(),
                now,
            ),
            standing: parts.standing.clone(),
            parts,
        };
        service.update_reasons();
        Ok(service)
    }

    /// Writes the first record: the state of the log and the version of the program.
    pub fn started(&mut self, found: &LogState) {
        let start = Start {
            records: found.records,
            cut_bytes: found.cut_bytes,
            broken: found.broken.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let _ = self.log("gateway", "started", Event::Start(start));
        // This write allocates the file for all later updates, which arming requires.
        self.write_standing();
        // The gateway is not armed yet, so it can wait. A disk that hangs delays the start by this timeout.
        self.writer.settle(END_TIMEOUT);
        self.begin_confirmation_check();
        let started = (&self.parts.config, &*self.parts.model);
        let (origin, worst) = (ModelOrigin::Configured, [None; 2]);
        self.record_model(&origin, "gateway", started, worst, ModelOutcome::InForce);
        // The output of the previous run may be outdated from now on.
        let _ = std::fs::remove_file(output_file(self.parts.config.audit_dir()));
        self.publish();
    }

    /// One iteration: receives a request, advances pending requests, records events and publishes the state. Waits at
    /// most 50 ms for a request.
    pub fn poll(&mut self) {
        let rest = TICK.saturating_sub(self.since(self.published_at));
        self.poll_within(if self.pending.is_empty() { rest } else { rest.min(STEP) });
    }

    /// One iteration that waits at most `rest` for a request. Tests with simulated time use zero.
    pub fn poll_within(&mut self, rest: Duration) {
        match self.requests.recv_timeout(rest) {
            Ok(request) => self.receive(request),
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
            // All senders were dropped.
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => std::thread::sleep(rest),
        }
        self.advance();
        if self.since(self.published_at) >= TICK {
            self.publish();
            self.auto_arm();
        }
    }

    /// Waits, at most `timeout` of system time, until disk writes and file reads are complete. Returns false after the
    /// timeout.
    pub fn settle(&self, timeout: Duration) -> bool {
        self.writer.settle(timeout) && self.worker.settle(timeout)
    }

    fn since(&self, then: Instant) -> Duration {
        self.clock.now().saturating_duration_since(then)
    }

    /// Ramps to zero within the configured time, then ends the control thread. Returns `false` if that thread hangs. If
    /// `hurry` returns true, the ramp is cut short.
    pub fn stop(&mut self, hurry: &mut dyn FnMut() -> bool) -> bool {
        // The stop order comes first, so that nothing delays it.
        self.switch.end();
        self.shown_reasons |= Reasons::STOPPING;
        self.update_reasons();
        let state = self.parts.handle.report().state.into();
        let _ = self.log("signal", "stop", Event::Request { state });
        let has_ended = self.ramp_out(hurry, |service| {
            service.answer_remaining();
            service.publish();
        });
        self.answer_remaining();
        self.write_end("signal", "stopped");
        has_ended
    }

    /// Stops after a panic in the service: ramps to zero, ends the control thread and records the failure. Uses only
    /// the control thread and the log of the service. Returns `false` if the control thread hangs.
    pub fn abandon(&mut self, hurry: &mut dyn FnMut() -> bool) -> bool {
        self.switch.end();
        let has_ended = self.ramp_out(hurry, |_| {});
        self.write_end("gateway", "failed");
        has_ended
    }

    /// True if the control thread has ended, so that nothing is corrected any more.
    pub fn is_without_control(&self) -> bool {
        self.parts.handle.has_ended()
    }

    fn ramp_out(
        &mut self,
        hurry: &mut dyn FnMut() -> bool,
        mut meanwhile: impl FnMut(&mut Self),
    ) -> bool {
        let guard = self.parts.config.guard_settings();
        let end = self.clock.now() + guard.map_or(Duration::ZERO, |guard| guard.stop);
        let before = self.parts.handle.report().cycle;
        while self.clock.now() < end && !hurry() && !self.is_without_control() {
            meanwhile(self);
            let report = self.parts.handle.report();
            // Wait two cycles, because the order may have arrived in the middle of the first one.
            let seen = report.cycle > before + 2;
            // A correction beyond the limit does not ramp out; an operator must act.
            let at_rest = match report.state {
                State::Disarmed | State::Faulted(Cause::BeyondLimit) => true,
                State::Faulted(_) => report.correction == PerAxis::ZERO,
                _ => false,
            };
            if seen && at_rest {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let has_ended = self.parts.handle.stop_within(END_TIMEOUT);
        if !has_ended {
            tracing::error!("the control thread hangs: the applied correction is unknown");
        }
        has_ended
    }

    fn write_end(&mut self, who: &str, what: &str) {
        let report = *self.parts.handle.report();
        // An output that is unknown at the end must be unknown at the next start.
        if report.correction_known {
            self.write_output(&report);
        }
        self.write_standing();
        let [left_um, left_urad] = self.applied(&report);
        let stop = Stop { state: report.state.into(), left_um, left_urad };
        let _ = self.log(who, what, Event::Stop(stop));
        if !self.writer.settle(END_TIMEOUT) {
            tracing::error!("the disk of the audit log does not answer: the last records are lost");
        }
        tracing::info!(state = report.state.name(), "{what}");
    }

    /// Queues an audit record. A log that cannot be written forbids arming.
    fn log(&mut self, who: &str, what: &str, event: Event) -> Receipt {
        let entry = self.entry(who, what, event);
        self.writer.record(entry)
    }

    /// The applied correction of linear axes in µm and of rotary axes in µrad; empty if it is unknown.
    fn applied(&self, report: &Report) -> [ByAxis; 2] {
        if report.cycle > 0 && report.correction_known {
            observe::correction(&self.parts.model, report)
        } else {
            Default::default()
        }
    }

    fn entry(&mut self, who: &str, what: &str, event: Event) -> Entry {
        let report = *self.parts.handle.report();
        let [output_um, output_urad] = self.applied(&report);
        let details =
            Details { model: self.parts.model.hash.clone(), output_um, output_urad, what: event };
        Entry::new(who, what, details)
    }

    fn update_reasons(&mut self) {
        let audit = Reasons::AUDIT.when(self.trouble.is_some());
        let standing = self.standing_reasons();
        let handle = &self.parts.handle;
        handle.forbid(
            self.parts.forbids
                | audit
                | Reasons::FAULTED_BEFORE.when(self.is_faulted_from_before()),
        );
        handle.note(audit | self.shown_reasons | standing);
    }

    fn check_log(&mut self) {
        let lost = "the standing state cannot be written";
        let is_lost = self.check_standing();
        let trouble = self.writer.trouble().or(is_lost.then_some(lost));
        if trouble != self.trouble {
            if let Some(trouble) = trouble {
                tracing::error!("{trouble}: no arming until it is written again");
            }
            self.trouble = trouble;
            self.update_reasons();
        }
        let again = self.entry("gateway", "audit log can be written again", Event::Nothing);
        self.writer.retry(|| again);
    }

    /// Records changes since the last call, adds the cycle times to the histograms, and publishes the state.
    fn publish(&mut self) {
        let now = self.clock.now();
        self.published_at = now;
        self.parts.handle.free_retired();
        for refusal in self.parts.handle.refusals() {
            // Planning a reload checks its orders, so a refusal is a bug.
            tracing::error!("{refusal}");
        }
        for change in self.parts.handle.changes() {
            let reasons: Vec<&str> = change.reasons.texts().collect();
            tracing::info!(
                state = change.state.name(),
                controller = change.active,
                reasons = reasons.join(", "),
                "state"
            );
            let reasons: Vec<String> = reasons.into_iter().map(str::to_owned).collect();
            let before = std::mem::replace(&mut self.last_state, change.state);
            self.save_fault(before, &reasons);
            // Some reasons apply only while disarmed.
            self.update_reasons();
            let event = StateChange {
                state: change.state.into(),
                controller: change.active,
                reasons,
                cycle: change.cycle,
                test_shift: change.state == State::Arming(Phase::Proving),
            };
            let _ = self.log("gateway", "state", Event::StateChange(event));
            self.auto_arm_done |= change.state == State::Compensating;
        }
        self.check_log();
        self.show_confirmation_need();
        for timing in self.parts.handle.timings() {
            self.times.add(&timing);
            self.watchdog.count(&timing, now);
        }
        let is_silent = self.parts.handle.pulse().silence().is_some();
        if self.watchdog.is_due(is_silent, now) {
            self.parts.life.prove();
        }
        let report = *self.parts.handle.report();
        self.lags.follow(&report);
        self.save_jumped(&report);
        self.save_interlocks(&report);
        let cycle_at = self.clock.start() + report.now;
        let status = self.status(&report);
        self.record_degraded(&status);
        self.publisher.publish(status, cycle_at);
    }

    /// Records which sensors the thermal terms lack, if that has changed.
    fn record_degraded(&mut self, status: &Status) {
        let is_degraded = |text: &&String| Reasons::with_text(text) == Some(Reasons::DEGRADED);
        let degraded = status.reasons.iter().find(is_degraded);
        let passed = self.since(self.degraded_at);
        if degraded == self.degraded.as_ref() || passed < self.degraded_pause {
            return;
        }
        let what = degraded.map_or("no longer degraded", String::as_str);
        let _ = self.log("gateway", what, Event::Nothing);
        (self.degraded, self.degraded_at) = (degraded.cloned(), self.clock.now());
        let [first, longest] = DEGRADED_EVERY;
        let doubled = (2 * self.degraded_pause).min(longest);
        self.degraded_pause = if passed > longest { first } else { doubled };
    }

    fn status(&self, report: &Report) -> Status {
        let parts = &self.parts;
        let facts = Facts {
            model: &parts.model,
            controllers: &parts.controllers,
            sensors: &parts.sensors,
            truth: parts.truth.as_ref(),
            guard: parts.config.guard.as_ref(),
            auto_arm: parts.config.auto_arm,
            cycle: parts.config.cycle(),
        };
        let mut report = *report;
        report.jumped |= self.jumped_axes();
        let mut status = observe::status(&facts, &report, &self.times);
        if self.is_faulted_from_before() && report.state == State::Disarmed {
            status.state = StateName::Faulted;
            let reasons = self.standing.faulted.iter().flatten();
            for reason in reasons {
                if !status.reasons.contains(reason) {
                    status.reasons.push(reason.clone());
                }
            }
            // An older version may have stored reasons with unknown texts; they come last.
            (status.reasons)
                .sort_by_key(|text| Reasons::with_text(text).map_or(u64::MAX, Reasons::bits));
        }
        status
    }

    /// Saves the output at the end, which a restart needs for controllers without read-back.
    fn write_output(&self, report: &Report) {
        let (axes, controllers) =
            LastOutput::belongs_to(&self.parts.model, &self.parts.controllers);
        let output = LastOutput {
            axes,
            controllers,
            boot: boot_id(),
            monotonic_s: monotonic().as_secs_f64(),
            correction: report.correction.to_vec(),
        };
        if let Ok(text) = serde_json::to_string(&output) {
            self.writer.keep(output_file(self.parts.config.audit_dir()), text);
        }
    }
}

const FILES_TIMEOUT: Duration = Duration::from_secs(8);

const AUTO_ARM: &str = "auto_arm";

struct PendingRequest {
    who: String,
    answer: Option<oneshot::Sender<Reply>>,
    disarms: u64,
    step: Step,
}

enum Step {
    /// Arming: the model armed last is read and compared with the present one.
    Comparison(Comparison),
    ArmingRecord(ArmingRecord),
    FileReading(FileReading),
    ReloadRecord(Box<ReloadRecord>),
    Effect(Effect),
}

#[derive(Clone, Copy)]
struct Effect {
    request: Request,
    /// Number of the last cycle before the order.
    cycle: u64,
    /// Deadline for the effect. Only disarming is executed after it.
    until: Instant,
}

enum Progress {
    Waits(Step),
    Next(Step),
    Done(Reply),
}

struct Compared {
    question: Option<Question>,
    last: Option<Model>,
}

/// `Err` holds the reason why the comparison failed.
type ComparisonResult = Result<Compared, String>;

struct Comparison {
    result: Receiver<ComparisonResult>,
    until: Instant,
}

struct ArmingRecord {
    receipts: [Receipt; 3],
    written: [bool; 3],
    until: Instant,
}

/// Result of planning a reload: the plan, its effect on the correction, and the question to confirm first.
type PlanResult = Result<(Box<Plan>, Judgement), GatewayError>;

#[derive(Clone, Debug, PartialEq, Eq)]
enum ModelOrigin {
    /// Machine file named in the configuration. The configuration is read again as well.
    Configured,
    /// The fleet's centre, with the hash confirmed there. Only the machine file changes.
    Centre(Option<String>),
    /// Selected by an operator. Only the machine file changes.
    Operator(Box<ModelActivation>),
}

impl ModelOrigin {
    /// Origin of a model, and the name of its file. `config` is the configuration to be applied.
    fn describe_origin(&self, config: &Config) -> (ModelSource, String) {
        match self {
            Self::Operator(activation) => (activation.from, activation.file.clone()),
            Self::Centre(_) => (ModelSource::Centre, "centre".to_owned()),
            Self::Configured => (config.machine_from(), config.machine.display().to_string()),
        }
    }
}

struct FileReading {
    origin: ModelOrigin,
    result: Receiver<PlanResult>,
    until: Instant,
}

struct ReloadRecord {
    who: String,
    origin: ModelOrigin,
    plan: Box<Plan>,
    /// The judged change of the correction, without an open question.
    judged: Judgement,
    receipts: Vec<Receipt>,
    until: Instant,
}

fn is_reached(request: Request, state: State) -> bool {
    match request {
        Request::Arm | Request::TakeOver | Request::Switched => state.is_armed(),
        Request::Disarm | Request::End => !state.is_armed(),
        Request::Acknowledge => !matches!(state, State::Faulted(_)),
    }
}

/// Why a request has not taken effect. The reasons of the state give the cause.
fn refusal(request: Request, state: State) -> &'static str {
    match (request, state) {
        (Request::Acknowledge, _) => {
            "still faulted: a fault ends when no interlock is active and the applied correction is known"
        }
        (Request::Disarm | Request::End, _) => "not disarmed yet",
        (_, State::Faulted(_)) => "not armed: acknowledge the fault first",
        (_, State::RampingOut(End::Disarmed)) => {
            "not armed: the correction still ramps to zero, and the reasons of the state prevent arming"
        }
        _ => "not armed: the reasons of the state prevent it",
    }
}

fn finish(who: &str, answer: Option<oneshot::Sender<Reply>>, reply: Reply) {
    match answer {
        // The receiver may have been dropped.
        Some(to) => drop(to.send(reply)),
        None if who == AUTO_ARM => {}
        None => tracing::info!("{who}: {}", describe(&reply.answer)),
    }
}

fn control_unavailable() -> Reply {
    refused(503, "the control thread accepts no orders")
}

fn log_unavailable(state: State, why: Option<&str>) -> Reply {
    let why = why.unwrap_or("the audit log cannot be written");
    settled(409, state, Reasons::AUDIT, Some(why))
}

fn settled(status: u16, state: State, reasons: Reasons, error: Option<&str>) -> Reply {
    Reply {
        status,
        answer: Answer::Settled(Settled {
            state: state.into(),
            reasons: reasons.texts().map(str::to_owned).collect(),
            error: error.map(str::to_owned),
        }),
    }
}

fn describe(answer: &Answer) -> String {
    match answer {
        Answer::Question(question) => {
            let size = |size: Option<f64>| {
                size.map_or("an unknown number of".to_owned(), |size| format!("{size:.1}"))
            };
            let limits: Vec<&str> = question.limits.keys().map(String::as_str).collect();
            let limits = if limits.is_empty() {
                String::new()
            } else {
                format!("; {} changed", limits.join(", "))
            };
            // Without limits for rotary axes no rotary axis is corrected.
            let rotary = question.confirm_urad.map_or(String::new(), |_| {
                format!(" and {} µrad", size(question.worst_corner_urad))
            });
            let differences: Vec<&str> = question
                .differences
                .iter()
                .map(|difference| difference.trim_end_matches('.'))
                .collect();
            let differences = if differences.is_empty() {
                String::new()
            } else {
                format!("; {}", differences.join("; "))
            };
            format!(
                "{} must be confirmed: it moves a point of the work space by {} µm{rotary}{limits}{differences}",
                question.model,
                size(question.worst_corner_um)
            )
        }
        Answer::Settled(settled) => {
            let why = settled.error.iter().chain(&settled.reasons);
            let words: Vec<&str> = why.map(String::as_str).collect();
            let state = settled.state.name();
            if words.is_empty() {
                state.to_owned()
            } else {
                format!("{state}: {}", words.join(", "))
            }
        }
        Answer::Reloaded(reloaded) if reloaded.unchanged => {
            format!("model {}, nothing has changed", reloaded.model)
        }
        Answer::Reloaded(reloaded) => format!("model {}", reloaded.model),
        Answer::Refusal(refusal) => refusal.error.clone(),
    }
}

fn disk_timeout() -> Reply {
    refused(503, "the disk with the files does not answer: try again")
}

/// Maximum time between two reports for which the reported temperatures are used. Beyond it, the lags are stepped
/// without temperatures.
const MAX_REPORT_GAP: Duration = Duration::from_secs(1);

struct Lags {
    model: Model,
    /// Index of each sensor of the model among the temperatures; `None` if no thermometer measures it.
    indices: Vec<Option<usize>>,
    at: Duration,
}

impl Lags {
    fn new(model: &Model, names: &[String]) -> Self {
        let place = |wanted: &String| names.iter().position(|name| name == wanted);
        Self {
            indices: model.sensors().iter().map(place).collect(),
            model: model.clone(),
            at: Duration::ZERO,
        }
    }

    fn replace(&mut self, model: &Model, names: &[String]) {
        let mut next = Self::new(model, names);
        next.model.carry_over(&self.model);
        next.at = self.at;
        *self = next;
    }

    fn follow(&mut self, report: &Report) {
        let passed = report.now.saturating_sub(self.at);
        self.at = report.now;
        let seen = passed.min(MAX_REPORT_GAP);
        let sensor = |place: &Option<usize>| report.sensors.get((*place)?)?.degc;
        let degc: Vec<Option<f64>> = self.indices.iter().map(sensor).collect();
        self.model.stand(passed.saturating_sub(seen).as_secs_f64());
        self.model.step(seen.as_secs_f64(), &degc);
    }

    fn model(&self) -> &Model {
        &self.model
    }
}

/// Counter of the proofs that cycles are on time.
#[derive(Clone, Debug, Default)]
pub struct Life(Arc<AtomicU64>);

impl Life {
    /// The number of proofs so far.
    pub fn proofs(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    fn prove(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// Checks that cycles are on time: no gap is longer than `timeout`, and at least a third of the expected cycles have
/// run.
struct Watchdog {
    interval: Duration,
    period: Duration,
    timeout: Duration,
    since: Instant,
    cycles: u64,
}

impl Watchdog {
    /// `time` is the watchdog timeout of the service manager; `timeout` is the longest permitted gap between cycles.
    fn new(time: Duration, period: Duration, timeout: Duration, now: Instant) -> Self {
        Self {
            // A missed proof delays the next one by a further interval, and that proof must still be in time.
            interval: (time / 4).min(Duration::from_secs(1)),
            period,
            timeout,
            since: now,
            cycles: 0,
        }
    }

    fn count(&mut self, timing: &Timing, now: Instant) {
        self.cycles += 1;
        if self.period.saturating_mul(timing.missed.saturating_add(1)) > self.timeout {
            self.begin(now);
        }
    }

    /// True if a proof is due now. `is_silent`: the control thread has run no cycle for too long.
    fn is_due(&mut self, is_silent: bool, now: Instant) -> bool {
        if is_silent {
            self.begin(now);
            return false;
        }
        let passed = now.saturating_duration_since(self.since);
        if passed < self.interval {
            return false;
        }
        let expected = passed.as_secs_f64() / self.period.as_secs_f64();
        let is_on_time = self.cycles as f64 * 3.0 >= expected;
        self.begin(now);
        is_on_time
    }

    fn begin(&mut self, now: Instant) {
        self.since = now;
        self.cycles = 0;
    }
}

#[derive(Default)]
struct Worker {
    /// Cleared before the result is sent, so that the receiver of the result can begin the next task.
    busy: Arc<AtomicBool>,
    /// Number of tasks whose result has not been sent.
    open: Arc<AtomicUsize>,
}

impl Worker {
    /// Waits at most `timeout` until the results of all tasks can be received. Returns false after the timeout.
    fn settle(&self, timeout: Duration) -> bool {
        let end = Instant::now() + timeout;
        while self.open.load(Ordering::Acquire) > 0 {
            if Instant::now() > end {
                return false;
            }
            thread::sleep(Duration::from_micros(100));
        }
        true
    }

    /// Starts a task and returns the receiver of its result. `None`: the last task is still running, or no thread can
    /// be created.
    fn begin<T: Send + 'static>(
        &mut self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<Receiver<T>> {
        if self.busy.swap(true, Ordering::AcqRel) {
            return None;
        }
        let (tell, result) = sync_channel(1);
        let (busy, open) = (Arc::clone(&self.busy), Arc::clone(&self.open));
        open.fetch_add(1, Ordering::AcqRel);
        // The thread logs under the span of the machine that starts it.
        let span = tracing::Span::current();
        let begun = thread::Builder::new().name("volcomp-files".to_owned()).spawn(move || {
            let result = span.in_scope(work);
            busy.store(false, Ordering::Release);
            // The receiver may have been dropped.
            let _ = tell.send(result);
            open.fetch_sub(1, Ordering::AcqRel);
        });
        if begun.is_err() {
            self.busy.store(false, Ordering::Release);
            self.open.fetch_sub(1, Ordering::AcqRel);
        }
        begun.is_ok().then_some(result)
    }
}

#[cfg(test)]
mod tests {
    use volcomp_guard::{Cause, End, Hold, Phase, Request, State};

    use super::*;

    #[test]
    fn every_state_and_every_request() {
        let [arm, disarm, acknowledge] = [Request::Arm, Request::Disarm, Request::Acknowledge];
        // State, then the expected results of arming, disarming and acknowledging.
        let table = [
            (State::Disarmed, [false, true, true]),
            (State::Arming(Phase::Proving), [true, false, true]),
            (State::Arming(Phase::Ramping), [true, false, true]),
            (State::Compensating, [true, false, true]),
            (State::Holding(Hold::Stale), [true, false, true]),
            (State::Holding(Hold::Lost), [true, false, true]),
            (State::Holding(Hold::Interlocked), [true, false, true]),
            (State::Holding(Hold::Unconfirmed), [true, false, true]),
            (State::RampingOut(End::Disarmed), [false, true, true]),
            // The guard resumes automatically when positions return.
            (State::RampingOut(End::Lost), [true, false, true]),
            (State::Faulted(Cause::DoesNotStick), [false, true, false]),
            (State::Faulted(Cause::Contradiction), [false, true, false]),
            (State::Faulted(Cause::BeyondLimit), [false, true, false]),
            (State::Faulted(Cause::OtherGateway), [false, true, false]),
        ];
        for (state, expected) in table {
            let found = [arm, disarm, acknowledge].map(|request| is_reached(request, state));
            assert_eq!(found, expected, "{state:?}");
        }
    }

    const MS: Duration = Duration::from_millis(1);

    /// Number of proofs within ten seconds. The watchdog timeout is 400 ms. A cycle of 4 ms runs only every `every` ms,
    /// and no cycle runs for `gap_ms` after 5 s.
    fn fed(every: u32, gap_ms: u32) -> u32 {
        let begun = Instant::now();
        let mut dog = Watchdog::new(400 * MS, 4 * MS, 100 * MS, begun);
        let (mut fed, mut last) = (0, 0);
        for ms in 1..10_000_u32 {
            let now = begun + ms * MS;
            let in_gap = ms > 5000 && ms < 5000 + gap_ms;
            if ms.is_multiple_of(every) && !in_gap {
                let missed = (ms - last) / 4 - 1;
                last = ms;
                let timing = Timing { missed, ..Timing::default() };
                dog.count(&timing, now);
            }
            if ms.is_multiple_of(50) {
                fed += u32::from(dog.is_due(ms - last > 100, now));
            }
        }
        fed
    }

    /// At least every third cycle must run.
    #[test]
    fn cycles_must_come_on_time() {
        assert!(fed(4, 0) >= 95, "each cycle");
        assert!(fed(8, 0) >= 95, "a slow control, every other cycle");
        assert_eq!(fed(16, 0), 0, "a quarter of the cycles");
        assert_eq!(fed(1000, 0), 0, "one a second");
        let with_gap = fed(4, 2000);
        assert!((72..=80).contains(&with_gap), "{with_gap}: none for two seconds");
    }
}
