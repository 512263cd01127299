//! Everything around the control thread that has no deadline: requests, the audit log, reloads, what others see.
//!
//! Nothing here waits for a disk: what is written goes to the [`Clerk`], what is read to the worker.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_guard::{Cause, Reasons, State};
use volcomp_port::{Clock, Description};
use volcomp_runtime::{DisarmSwitch, Handle, Model, Report, monotonic};
use volcomp_vocabulary::PerAxis;

use crate::{
    audit::{
        AuditLog, Entry, Found, boot_id,
        clerk::{Clerk, Receipt},
        utc_now,
    },
    config::Config,
    documents::{
        ByAxis, Details, Event, LastOutput, ModelEntry, ModelOutcome, Standing, Start, StateChange,
        StateName, Status, Stop,
    },
    error::GatewayError,
    models::ModelNotes,
    observe::{self, Facts},
    options::Options,
    published::Publisher,
    request::{Asked, Queue},
    simulate::Truth,
    times::Times,
};

mod arming;
mod lags;
mod reload;
mod requests;
pub(crate) mod standing;
mod step;
mod watchdog;
mod worker;

use lags::Lags;
use step::{Comparing, Underway};
pub use watchdog::Life;
use watchdog::Watchdog;
use worker::Worker;

/// How often states are published and changes written down.
const TICK: Duration = Duration::from_millis(50);
/// How often requests that are under way are looked at.
const STEP: Duration = Duration::from_millis(2);
/// How often the last output is written to disk.
const OUTPUT_EVERY: Duration = Duration::from_secs(10);
/// How long the end waits for a control thread that hangs, and as long again for the disk.
const END: Duration = Duration::from_secs(1);

/// The parts from which a service is built.
pub struct Parts {
    /// The control thread, running.
    pub handle: Handle,
    /// How the gateway was called.
    pub options: Options,
    /// The configuration that holds now.
    pub config: Config,
    /// The controllers, in order.
    pub controllers: Vec<Description>,
    /// The names of the temperatures.
    pub sensors: Vec<String>,
    /// A copy of the model that the cycle has.
    pub model: Arc<Model>,
    /// The true errors of the machine, where it is simulated.
    pub truth: Option<Truth>,
    /// What stands since before the start.
    pub standing: Standing,
    /// The reasons that forbid arming from the start.
    pub forbids: Reasons,
    /// Where it is proven that cycles come on time, several times within `proven_within`.
    pub life: Life,
    /// The time of the watchdog of the service manager.
    pub proven_within: Duration,
    /// Where it is told what became of a model.
    pub notes: ModelNotes,
}

/// The service. State: what runs, which requests are under way, and whether its log can be written.
pub struct Service {
    /// The clock of the cycle: whatever expires here does so by it.
    clock: Clock,
    parts: Parts,
    clerk: Clerk,
    worker: Worker,
    /// Whether what would correct must be confirmed, which is found out at the start.
    unconfirmed: Option<Comparing>,
    switch: DisarmSwitch,
    publisher: Publisher,
    asked: Queue,
    /// Requests to arm and to reload, one after the other.
    waiting: VecDeque<Asked>,
    underway: Vec<Underway>,
    times: Times,
    looked: Instant,
    last_state: State,
    standing: Standing,
    /// Tells when what stands was written down last, whether that failed, and when it was tried again.
    standing_kept: Option<Receipt>,
    standing_lost: bool,
    standing_tried: Instant,
    /// Why records of the log may be missing.
    trouble: Option<&'static str>,
    /// Reasons of the service itself, shown beside those of the guards: the last reload was refused, it is ending.
    tells: Reasons,
    /// Whether it was armed once, or a person took over.
    auto_arm_done: bool,
    /// Whether a person has armed, disarmed or acknowledged: from then on nothing else arms.
    person_decides: bool,
    auto_arm_after: Instant,
    output: LatestOutput,
    lags: Lags,
    watchdog: Watchdog,
}

/// The output that was handed over to be written last.
struct LatestOutput {
    at: Instant,
    correction: PerAxis<f64>,
    receipt: Option<Receipt>,
}

impl Service {
    /// Puts a service together around a control thread, with the log to which it writes.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn new(
        parts: Parts,
        audit: AuditLog,
        publisher: Publisher,
        asked: Queue,
    ) -> Result<Self, GatewayError> {
        let clock = parts.handle.clock().clone();
        let now = clock.now();
        let clerk =
            Clerk::start(audit, clock.clone()).map_err(|e| GatewayError::system("audit log", e))?;
        let pulse = parts.handle.pulse();
        let mut service = Self {
            clock,
            clerk,
            worker: Worker::default(),
            unconfirmed: None,
            switch: parts.handle.disarm_switch(),
            publisher,
            asked,
            waiting: VecDeque::new(),
            underway: Vec::new(),
            times: Times::default(),
            looked: now,
            last_state: State::Disarmed,
            standing_kept: None,
            standing_lost: false,
            standing_tried: now,
            trouble: None,
            tells: Reasons::NONE,
            auto_arm_done: parts.standing.disarmed_by.is_some(),
            person_decides: parts.standing.disarmed_by.is_some(),
            auto_arm_after: now,
            output: LatestOutput {
                at: now,
                correction: PerAxis::ZERO,
                receipt: None,
            },
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
        service.tell_thread();
        Ok(service)
    }

    /// Writes the first record: what was found, and which version runs.
    pub fn started(&mut self, found: &Found) {
        let start = Start {
            records: found.records,
            cut_bytes: found.cut_bytes,
            broken: found.broken.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let _ = self.log("gateway", "started", Event::Start(start));
        // This takes the room for all that may have to be kept later; without it nothing arms.
        self.write_standing();
        // Nothing is armed yet, so that there is time for it; a disk that hangs delays the start no longer than this.
        self.clerk.settle(END);
        self.ask_whether_confirmed();
        let entry = ModelEntry {
            time: utc_now(),
            who: "gateway".to_owned(),
            hash: self.parts.model.hash.clone(),
            name: self.parts.model.name.clone(),
            from: self.parts.config.machine_from(),
            file: self.parts.config.machine.display().to_string(),
            outcome: ModelOutcome::InForce,
            why: None,
            worst_um: None,
            worst_urad: None,
        };
        let text = self.parts.model.text.clone();
        self.parts.notes.tell(entry, Some(text));
        // From now on what the run before has written down may no longer be so.
        let report = *self.parts.handle.report();
        self.write_output(&report, false);
        self.look();
    }

    /// One turn: takes a request, goes on with those under way, writes down what happened, publishes. Waits for a
    /// request up to 50 ms.
    pub fn turn(&mut self) {
        let rest = TICK.saturating_sub(self.since(self.looked));
        self.turn_within(if self.underway.is_empty() {
            rest
        } else {
            rest.min(STEP)
        });
    }

    /// One turn that waits for a request up to `rest`: not at all where a test counts the time.
    pub fn turn_within(&mut self, rest: Duration) {
        match self.asked.recv_timeout(rest) {
            Ok(asked) => self.take_on(asked),
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
            // Nobody can ask any more.
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => std::thread::sleep(rest),
        }
        self.go_on();
        if self.since(self.looked) >= TICK {
            self.look();
            self.auto_arm();
        }
    }

    /// Waits until the disk and the files that are read are done, for at most `patience` by the system's clock. Whether they
    /// are.
    pub fn settle(&self, patience: Duration) -> bool {
        self.clerk.settle(patience) && self.worker.settle(patience)
    }

    fn since(&self, then: Instant) -> Duration {
        self.clock.now().saturating_duration_since(then)
    }

    /// Ramps to zero for at most the configured time, then ends the control thread; `false`: it hangs. `hurry` tells to end
    /// it at once.
    pub fn stop(&mut self, hurry: &mut dyn FnMut() -> bool) -> bool {
        // Stopping waits for nothing: all else comes after the order.
        self.switch.end();
        self.tells |= Reasons::STOPPING;
        self.tell_thread();
        let state = self.parts.handle.report().state.into();
        let _ = self.log("signal", "stop", Event::Request { state });
        let has_ended = self.ramp_out(hurry, |service| {
            service.answer_last();
            service.look();
        });
        self.answer_last();
        self.write_end("signal", "stopped");
        has_ended
    }

    /// After a fault of the program in the service itself: ramps to zero, ends the control thread and writes that down. Nothing
    /// of the service is trusted any more but the control thread and the log. `false`: the control thread hangs.
    pub fn abandon(&mut self, hurry: &mut dyn FnMut() -> bool) -> bool {
        self.switch.end();
        let has_ended = self.ramp_out(hurry, |_| {});
        self.write_end("gateway", "failed");
        has_ended
    }

    /// Whether the control thread has ended, so that nothing corrects any more.
    pub fn is_without_control(&self) -> bool {
        self.parts.handle.has_ended()
    }

    /// Waits until nothing is applied any more, for at most the configured time or until `hurry`, then ends the control thread.
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
            // Two cycles: the order may have come in the middle of one.
            let seen = report.cycle > before + 2;
            // A correction beyond the limit waits for a person.
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
        let has_ended = self.parts.handle.stop_within(END);
        if !has_ended {
            tracing::error!("the control thread hangs: what is applied now is not known");
        }
        has_ended
    }

    /// Writes down what is left at the end.
    fn write_end(&mut self, who: &str, what: &str) {
        let report = *self.parts.handle.report();
        self.write_output(&report, true);
        self.write_standing();
        let [left_um, left_urad] = self.applied(&report);
        let stop = Stop {
            state: report.state.into(),
            left_um,
            left_urad,
        };
        let _ = self.log(who, what, Event::Stop(stop));
        if !self.clerk.settle(END) {
            tracing::error!("the disk of the audit log does not answer: the last records are lost");
        }
        tracing::info!(state = report.state.name(), "{what}");
    }

    /// Hands over a record. A log that cannot be written forbids arming.
    fn log(&mut self, who: &str, what: &str, event: Event) -> Receipt {
        let entry = self.entry(who, what, event);
        self.clerk.record(entry)
    }

    /// The correction that is applied, µm and µrad; empty where it is not known.
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
        let details = Details {
            model: self.parts.model.hash.clone(),
            output_um,
            output_urad,
            what: event,
        };
        Entry::new(who, what, details)
    }

    fn tell_thread(&mut self) {
        let audit = Reasons::AUDIT.when(self.trouble.is_some());
        let standing = self.standing_reasons();
        let handle = &self.parts.handle;
        handle.forbid(
            self.parts.forbids
                | audit
                | Reasons::FAULTED_BEFORE.when(self.is_faulted_from_before()),
        );
        handle.note(audit | self.tells | standing);
    }

    /// Whether the log is written as it should; where it was not, it is tried again.
    fn look_after_log(&mut self) {
        let lost = "what outlives a restart cannot be written down";
        let is_lost = self.look_after_standing();
        let trouble = self.clerk.trouble().or(is_lost.then_some(lost));
        if trouble != self.trouble {
            if let Some(trouble) = trouble {
                tracing::error!("{trouble}: no arming until it is written again");
            }
            self.trouble = trouble;
            self.tell_thread();
        }
        let again = self.entry("gateway", "audit log can be written again", Event::Nothing);
        self.clerk.try_again(|| again);
    }

    /// Changes since the last look go into the log, times into the histograms, and a state is published.
    fn look(&mut self) {
        let now = self.clock.now();
        self.looked = now;
        self.parts.handle.free_retired();
        for refusal in self.parts.handle.refusals() {
            // The plan of a reload has checked them, so this is a fault of the program.
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
            self.keep_fault(before, &reasons);
            let event = StateChange {
                state: change.state.into(),
                controller: change.active,
                reasons,
                cycle: change.cycle,
            };
            let _ = self.log("gateway", "state", Event::StateChange(event));
            self.auto_arm_done |= change.state == State::Compensating;
        }
        self.look_after_log();
        self.tell_whether_confirmed();
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
        self.keep_jumped(&report);
        let cycle_at = self.clock.start() + report.now;
        self.publisher.publish(self.status(&report), cycle_at);
        if self.since(self.output.at) > OUTPUT_EVERY && self.output.correction != report.correction
        {
            self.write_output(&report, false);
        }
    }

    /// The state at a report.
    fn status(&self, report: &Report) -> Status {
        let parts = &self.parts;
        let facts = Facts {
            model: &parts.model,
            controllers: &parts.controllers,
            sensors: &parts.sensors,
            truth: parts.truth.as_ref(),
            auto_arm: parts.config.auto_arm,
            cycle: parts.config.cycle(),
        };
        let mut status = observe::status(&facts, report, &self.times);
        if self.is_faulted_from_before() && report.state == State::Disarmed {
            status.state = StateName::Faulted;
            let reasons = self.standing.faulted.iter().flatten();
            for reason in reasons {
                if !status.reasons.contains(reason) {
                    status.reasons.push(reason.clone());
                }
            }
            // Those of an older version that have another text now come last.
            (status.reasons)
                .sort_by_key(|text| Reasons::with_text(text).map_or(u64::MAX, Reasons::bits));
        }
        status
    }

    /// Writes down the last output, for controllers that cannot be asked after a restart. One at a time.
    fn write_output(&mut self, report: &Report, ended: bool) {
        let waits = |receipt: &Receipt| receipt.written().is_none();
        if self.output.receipt.as_ref().is_some_and(waits) {
            return;
        }
        let (axes, controllers) =
            LastOutput::belongs_to(&self.parts.model, &self.parts.controllers);
        let output = LastOutput {
            axes,
            controllers,
            boot: boot_id(),
            // What was not known at the end is not known at the next start.
            ended: ended && report.correction_known,
            monotonic_s: monotonic().as_secs_f64(),
            correction: report.correction.to_vec(),
        };
        let path = self.parts.config.audit_dir().join("output.json");
        self.output = LatestOutput {
            at: self.clock.now(),
            correction: report.correction,
            receipt: (serde_json::to_string(&output).ok()).map(|text| self.clerk.keep(path, text)),
        };
    }
}
