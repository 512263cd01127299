//! Everything around the control thread that has no deadline: requests, the audit log, reloads, what others see.

use std::{
    sync::{Arc, mpsc::Receiver},
    time::{Duration, Instant},
};

use volcomp_guard::{Reasons, Request, State};
use volcomp_port::Description;
use volcomp_runtime::{Handle, Model, Order, Report};
use volcomp_vocabulary::PerAxis;

use crate::{
    audit::{AuditLog, Found, boot_id, replace_file},
    config::Config,
    documents::{Broken, Details, Event, LastOutput, Start, StateChange, Status, Stop},
    observe::{self, Facts},
    options::Options,
    published::Publisher,
    request::Asked,
    simulate::Truth,
    times::Times,
};

mod effect;
mod reload;
mod requests;

/// How often states are published and changes written down.
const TICK: Duration = Duration::from_millis(50);
/// How often the last output is written to disk.
const OUTPUT_EVERY: Duration = Duration::from_secs(10);

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
    /// The audit log, open.
    pub audit: AuditLog,
    /// The reasons that forbid arming from the start.
    pub forbids: Reasons,
}

/// The service. State: what runs, and whether its log can be written.
pub struct Service {
    parts: Parts,
    publisher: Publisher,
    asked: Receiver<Asked>,
    times: Times,
    last_state: State,
    audit_fails: bool,
    /// Reasons of the service itself, shown beside those of the guards: the last reload was refused, it is ending.
    tells: Reasons,
    /// Whether it was armed once, or a person took over.
    auto_arm_done: bool,
    auto_arm_after: Instant,
    output_written: (Instant, PerAxis<f64>),
    watchdog: Watchdog,
}

/// The watchdog of the service manager, fed only when the number of cycles has grown.
struct Watchdog {
    interval: Option<Duration>,
    fed: Instant,
    cycles: u64,
}

impl Service {
    /// Puts a service together around a control thread.
    pub fn new(parts: Parts, publisher: Publisher, asked: Receiver<Asked>) -> Self {
        let now = Instant::now();
        let mut service = Self {
            publisher,
            asked,
            times: Times::default(),
            last_state: State::Disarmed,
            audit_fails: false,
            tells: Reasons::NONE,
            auto_arm_done: false,
            auto_arm_after: now,
            output_written: (now, PerAxis::ZERO),
            watchdog: Watchdog {
                interval: sd_notify::watchdog_enabled().map(|time| time / 2),
                fed: now,
                cycles: 0,
            },
            parts,
        };
        service.tell_thread();
        service
    }

    /// Writes the first record: what was found, and which version runs.
    pub fn started(&mut self, found: &Found) {
        let broken = found.broken.as_ref().map(|(line, aside)| Broken {
            line: *line,
            aside: aside.display().to_string(),
        });
        let start = Start {
            records: found.records,
            cut_bytes: found.cut_bytes,
            broken,
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        self.log("gateway", "started", Event::Start(start));
        self.look();
    }

    /// One turn: answers a request, writes down what happened, publishes. Waits for a request up to 50 ms.
    pub fn turn(&mut self) {
        match self.asked.recv_timeout(TICK) {
            Ok(asked) => self.answer(asked),
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
            // Nobody can ask any more.
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => std::thread::sleep(TICK),
        }
        self.look();
        self.auto_arm();
    }

    /// Ramps to zero for at most the configured time, then ends the control thread. `hurry` tells to end it at once.
    pub fn stop(&mut self, hurry: &mut dyn FnMut() -> bool) {
        let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
        self.tells |= Reasons::STOPPING;
        self.tell_thread();
        let state = self.parts.handle.report().state.into();
        // Stopping waits for no disk: the record comes after the order.
        let mut ordered = self.parts.handle.send(Order::Request(Request::Disarm));
        self.log("signal", "stop", Event::Request { state });
        let guard = self.parts.config.guard.as_ref();
        let end = Instant::now() + guard.map_or(Duration::ZERO, |guard| guard.stop);
        std::thread::sleep(self.parts.config.cycle * 2);
        while Instant::now() < end && !hurry() {
            // Where other orders were in the way it is said again.
            ordered = ordered || self.parts.handle.send(Order::Request(Request::Disarm));
            self.look();
            let report = self.parts.handle.report();
            let at_rest = report.state == State::Disarmed
                || matches!(report.state, State::Faulted(_)) && report.correction == PerAxis::ZERO;
            if ordered && at_rest {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.parts.handle.stop();
        let report = *self.parts.handle.report();
        self.write_output(&report);
        let [left_um, left_urad] = observe::correction(&self.parts.model, &report);
        let stop = Stop {
            state: report.state.into(),
            left_um,
            left_urad,
        };
        self.log("signal", "stopped", Event::Stop(stop));
        tracing::info!(state = report.state.name(), "stopped");
    }

    /// Writes a record. A log that cannot be written forbids arming.
    fn log(&mut self, who: &str, what: &str, event: Event) -> bool {
        let details = Details {
            model: self.parts.model.hash.clone(),
            what: event,
        };
        let written = self.parts.audit.append(who, what, details);
        if let Err(e) = &written
            && !self.audit_fails
        {
            tracing::error!("audit log: {e}: no arming until it can be written");
        }
        if self.audit_fails != written.is_err() {
            self.audit_fails = written.is_err();
            self.tell_thread();
        }
        written.is_ok()
    }

    fn tell_thread(&mut self) {
        let audit = Reasons::AUDIT.when(self.audit_fails);
        self.parts.handle.forbid(self.parts.forbids | audit);
        self.parts
            .handle
            .note(audit | Reasons::DEGRADED.when(self.audit_fails) | self.tells);
    }

    /// Changes since the last look go into the log, times into the histograms, and a state is published.
    fn look(&mut self) {
        self.parts.handle.free_retired();
        for refusal in self.parts.handle.refusals() {
            // The plan of a reload has checked them, so this is a fault of the program.
            tracing::error!("{refusal}");
        }
        for change in self.parts.handle.changes() {
            let mut reasons: Vec<&str> = change.reasons.texts().collect();
            reasons.sort_unstable();
            tracing::info!(
                state = change.state.name(),
                controller = change.active,
                reasons = reasons.join(", "),
                "state"
            );
            let event = StateChange {
                state: change.state.into(),
                controller: change.active,
                reasons: reasons.into_iter().map(str::to_owned).collect(),
                cycle: change.cycle,
            };
            self.log("gateway", "state", Event::StateChange(event));
            self.last_state = change.state;
            self.auto_arm_done |= change.state == State::Compensating;
        }
        if self.audit_fails {
            // Once it can be written again arming is allowed again.
            self.log("gateway", "audit log can be written again", Event::Nothing);
        }
        for timing in self.parts.handle.timings() {
            self.times.add(&timing);
        }
        self.feed_watchdog();
        let report = *self.parts.handle.report();
        self.publisher.publish(self.status(&report));
        if self.output_written.0.elapsed() > OUTPUT_EVERY
            && self.output_written.1 != report.correction
        {
            self.write_output(&report);
        }
    }

    /// The state at a report, as old as it is now.
    fn status(&self, report: &Report) -> Status {
        let parts = &self.parts;
        let facts = Facts {
            model: &parts.model,
            controllers: &parts.controllers,
            sensors: &parts.sensors,
            truth: parts.truth.as_ref(),
            auto_arm: parts.config.auto_arm,
            cycle: parts.config.cycle,
        };
        let age = parts.handle.start().elapsed().saturating_sub(report.now);
        observe::status(&facts, report, &self.times, age)
    }

    /// Writes down the last output, for controllers that cannot be asked after a restart.
    fn write_output(&mut self, report: &Report) {
        let output = LastOutput {
            boot: boot_id(),
            correction: report.correction.to_vec(),
        };
        let path = self.parts.config.audit_dir.join("output.json");
        let written = serde_json::to_string(&output)
            .map_err(std::io::Error::from)
            .and_then(|text| replace_file(&path, &text));
        if let Err(e) = written {
            tracing::warn!("last output: {e}");
        }
        self.output_written = (Instant::now(), report.correction);
    }

    fn feed_watchdog(&mut self) {
        let Some(interval) = self.watchdog.interval else {
            return;
        };
        let cycles = self.parts.handle.cycles();
        if self.watchdog.fed.elapsed() >= interval.min(Duration::from_secs(1))
            && cycles != self.watchdog.cycles
        {
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
            self.watchdog.fed = Instant::now();
            self.watchdog.cycles = cycles;
        }
    }
}
