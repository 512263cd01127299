//! Everything around the control thread that is not in a hurry: requests, the audit log, reloads, what others see.

use std::{
    sync::{Arc, Mutex, PoisonError, mpsc::Receiver},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use tokio::sync::{oneshot, watch};
use volcomp_guard::{Reasons, Request, State};
use volcomp_port::Description;
use volcomp_vocabulary::PerAxis;

use crate::{
    audit::{AuditLog, boot_id, replace_file},
    config::{Config, GuardConfig},
    document::{Facts, document},
    model::Model,
    realtime::{Handle, Order},
    report::Report,
    run::Options,
    simulate::Truth,
    times::Times,
};

mod requests;

/// So often the rest of the world is looked at.
const TICK: Duration = Duration::from_millis(50);
/// The last output is written down so often.
const OUTPUT_EVERY: Duration = Duration::from_secs(10);

/// What somebody asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ask {
    /// Correct; with the hash of a model that a person confirms.
    Arm(Option<String>),
    /// Stop correcting.
    Disarm,
    /// The cause of a fault is mended.
    Acknowledge,
    /// Read configuration and machine file again; with the hash of a model that a person confirms.
    Reload(Option<String>),
}

/// A request and where its answer goes.
pub struct Asked {
    /// What.
    pub ask: Ask,
    /// Who: a token's name, `signal`, `auto_arm`.
    pub who: String,
    /// The answer.
    pub answer: Option<oneshot::Sender<Answer>>,
}

/// A status of HTTP and a document.
pub type Answer = (u16, Value);

/// What the dashboard reads.
#[derive(Clone)]
pub struct Published {
    /// The state, as JSON.
    pub state: watch::Receiver<Arc<str>>,
    /// Metrics as Prometheus text.
    pub metrics: Arc<Mutex<String>>,
    /// The model, for the error map.
    pub model: Arc<Mutex<Arc<Model>>>,
}

/// The side that writes [`Published`].
pub struct Publisher {
    state: watch::Sender<Arc<str>>,
    metrics: Arc<Mutex<String>>,
    model: Arc<Mutex<Arc<Model>>>,
}

/// Both sides of what is published.
pub fn published(model: Arc<Model>) -> (Publisher, Published) {
    let (state, read) = watch::channel("{}".into());
    let (metrics, model) = (Arc::default(), Arc::new(Mutex::new(model)));
    let reader = Published {
        state: read,
        metrics: Arc::clone(&metrics),
        model: Arc::clone(&model),
    };
    (
        Publisher {
            state,
            metrics,
            model,
        },
        reader,
    )
}

/// What a service is made of.
pub struct Parts {
    /// The control thread.
    pub handle: Handle,
    /// How it was called.
    pub options: Options,
    /// The configuration.
    pub config: Config,
    /// The controllers, in order.
    pub controllers: Vec<Description>,
    /// Names of the temperatures.
    pub sensors: Vec<String>,
    /// A copy of the model that the cycle has.
    pub model: Arc<Model>,
    /// What a simulated machine really misses.
    pub truth: Option<Truth>,
    /// The log.
    pub audit: AuditLog,
    /// What arming is forbidden by from the start.
    pub forbids: Reasons,
}

/// The service.
pub struct Service {
    parts: Parts,
    publisher: Publisher,
    asked: Receiver<Asked>,
    times: Times,
    last_state: State,
    audit_fails: bool,
    /// It was armed once, or a person took over.
    auto_arm_done: bool,
    auto_arm_after: Instant,
    output_written: (Instant, PerAxis<f64>),
    watchdog: Watchdog,
}

/// Fed only when the cycle counter has moved.
struct Watchdog {
    interval: Option<Duration>,
    fed: Instant,
    cycles: u64,
}

impl Service {
    /// Puts it together.
    pub fn new(parts: Parts, publisher: Publisher, asked: Receiver<Asked>) -> Self {
        let now = Instant::now();
        let mut service = Self {
            publisher,
            asked,
            times: Times::default(),
            last_state: State::Disarmed,
            audit_fails: false,
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

    /// The first record: what was found, what runs.
    pub fn started(&mut self, found: &crate::audit::Found) {
        let broken = found
            .broken
            .as_ref()
            .map(|(line, aside)| json!({ "line": line, "aside": aside.display().to_string() }));
        let details = json!({ "records": found.records, "cut_bytes": found.cut_bytes, "broken": broken, "version": env!("CARGO_PKG_VERSION") });
        self.log("gateway", "started", &details);
        self.look();
    }

    /// One turn: takes what was asked, writes down what happened, publishes. Waits for a request up to 50 ms.
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

    /// Ramps to zero for at most the configured time, then leaves the rest. `hurry` says to leave at once.
    pub fn stop(&mut self, hurry: &mut dyn FnMut() -> bool) {
        let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
        let report = *self.parts.handle.report();
        self.log("signal", "stop", &json!({ "state": report.state.name() }));
        self.parts.handle.note(Reasons::STOPPING);
        self.parts.handle.send(Order::Request(Request::Disarm));
        let end = Instant::now()
            + self
                .parts
                .config
                .guard
                .as_ref()
                .map_or(Duration::ZERO, |guard| guard.stop);
        std::thread::sleep(self.parts.config.cycle * 2);
        while Instant::now() < end && !hurry() {
            self.look();
            let report = self.parts.handle.report();
            let at_rest = report.state == State::Disarmed
                || matches!(report.state, State::Faulted(_)) && report.correction == PerAxis::ZERO;
            if at_rest {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.parts.handle.stop();
        let report = *self.parts.handle.report();
        self.write_output(&report);
        let left = self.correction_json(&report);
        self.log(
            "signal",
            "stopped",
            &json!({ "state": report.state.name(), "left": left }),
        );
        tracing::info!(state = report.state.name(), "stopped");
    }

    fn correction_json(&self, report: &Report) -> Value {
        document(&self.facts(), report, &self.times)["correction_um"].clone()
    }

    fn facts(&self) -> Facts<'_> {
        Facts {
            model: &self.parts.model,
            controllers: &self.parts.controllers,
            sensors: &self.parts.sensors,
            truth: self.parts.truth.as_ref(),
            auto_arm: self.parts.config.auto_arm,
            cycle: self.parts.config.cycle,
        }
    }

    /// A record in the log. A log that cannot be written forbids arming.
    fn log(&mut self, who: &str, what: &str, details: &Value) -> bool {
        let details = json!({ "model": self.parts.model.hash, "what": details });
        let written = self.parts.audit.append(who, what, &details);
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
            .note(audit | Reasons::DEGRADED.when(self.audit_fails));
    }

    /// What happened since the last look: changes into the log, times into the histograms, all of it published.
    fn look(&mut self) {
        self.parts.handle.free_retired();
        for change in self.parts.handle.changes() {
            let mut reasons: Vec<&str> = change.reasons.texts().collect();
            reasons.sort_unstable();
            tracing::info!(
                state = change.state.name(),
                controller = change.active,
                reasons = reasons.join(", "),
                "state"
            );
            let details = json!({ "state": change.state.name(), "controller": change.active, "reasons": reasons, "cycle": change.cycle });
            self.log("gateway", "state", &details);
            self.last_state = change.state;
            self.auto_arm_done |= change.state == State::Compensating;
        }
        if self.audit_fails {
            // Once it can be written again arming is allowed again.
            self.log("gateway", "audit log can be written again", &Value::Null);
        }
        for timing in self.parts.handle.timings() {
            self.times.add(&timing);
        }
        let report = *self.parts.handle.report();
        self.feed_watchdog();
        let document = document(&self.facts(), &report, &self.times);
        let metrics =
            crate::metrics::text(&document, &report, &self.times, &self.parts.controllers);
        *self
            .publisher
            .metrics
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = metrics;
        self.publisher
            .state
            .send_replace(document.to_string().into());
        if self.output_written.0.elapsed() > OUTPUT_EVERY
            && self.output_written.1 != report.correction
        {
            self.write_output(&report);
        }
    }

    /// The last output, for controllers that cannot be asked after a restart.
    fn write_output(&mut self, report: &Report) {
        let text = json!({ "boot": boot_id(), "correction": report.correction.0 }).to_string();
        if let Err(e) = replace_file(&self.parts.config.audit_dir.join("output.json"), &text) {
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

/// Limits that hold nothing up while arming is forbidden for want of real ones.
pub fn no_limits() -> GuardConfig {
    crate::simulate::guard()
}
