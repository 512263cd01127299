//! Data published by the service and read by the dashboard.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use volcomp_port::Clock;
use volcomp_runtime::{Model, Pulse};

use crate::{
    documents::{FleetState, History, HistoryPoint, StateName, Status, round},
    history::{self, Recorder, point_of, without_idle_residual},
    locked, observe,
};

/// Maximum interval between two publications. A state older than this plus [`Pulse::patience`] is stale, whether the
/// control thread or the service is late.
const PUBLISHED_EVERY: Duration = Duration::from_millis(150);
/// Length of the history of single states, s.
const SPAN_S: u32 = 120;
/// Minimum interval between two points of the history of single states, s.
const STEP_S: f64 = 0.25;

/// The published state for its readers, such as the dashboard.
#[derive(Clone)]
pub struct Published {
    shared: Arc<Shared>,
    pulse: Pulse,
}

/// Publishes the state; used by the service.
pub struct Publisher {
    shared: Arc<Shared>,
    pulse: Pulse,
}

struct Shared {
    model: Mutex<Arc<Model>>,
    trend: Mutex<Trend>,
    /// The latest state, with the time of its cycle.
    latest: Mutex<(Arc<Status>, Instant)>,
    /// State of the fleet connection; `None`: not part of a fleet.
    fleet: Mutex<Option<FleetState>>,
}

/// Creates the publisher and the published state from an initial state. `pulse` shows whether the control thread is
/// alive.
pub(crate) fn published(
    first: Status,
    model: Arc<Model>,
    pulse: Pulse,
    recorder: Recorder,
) -> (Publisher, Published) {
    let shared = Arc::new(Shared {
        model: Mutex::new(model),
        trend: Mutex::new(Trend { points: VecDeque::new(), recorder }),
        latest: Mutex::new((Arc::new(first), pulse.clock().now())),
        fleet: Mutex::default(),
    });
    let reader = Published { shared: Arc::clone(&shared), pulse: pulse.clone() };
    (Publisher { shared, pulse }, reader)
}

impl Publisher {
    /// Publishes the state of a cycle and adds it to the history.
    pub fn publish(&self, status: Status, cycle_at: Instant) {
        // The last report of a control thread that hangs is not the current state.
        let point = if self.pulse.silence().is_some() {
            HistoryPoint {
                at_s: status.uptime_s,
                state: Some(StateName::Unknown),
                ..HistoryPoint::default()
            }
        } else {
            point_of(&status)
        };
        locked(&self.shared.trend).add(point);
        *locked(&self.shared.latest) = (Arc::new(status), cycle_at);
    }

    /// Publishes a new model, for the error map.
    pub fn set_model(&self, model: Arc<Model>) {
        *locked(&self.shared.model) = model;
    }
}

impl Published {
    /// The clock of the cycle.
    pub fn clock(&self) -> &Clock {
        self.pulse.clock()
    }

    /// The current state with its age: the state of the last cycle, or `unknown` if no cycle has run for three periods
    /// ([`Pulse::patience`]).
    pub fn latest(&self) -> Status {
        // Before the state: if this thread is suspended in between, cycles go on, and none is missing.
        let now = self.pulse.clock().now();
        let (status, cycle_at) = {
            let latest = locked(&self.shared.latest);
            (Arc::clone(&latest.0), latest.1)
        };
        let mut status = Status::clone(&status);
        let age = now.saturating_duration_since(cycle_at);
        observe::age(&mut status, age);
        let stale = Some(age).filter(|age| *age > self.pulse.patience() + PUBLISHED_EVERY);
        if let Some(silence) = self.pulse.silence().or(stale) {
            observe::silence(&mut status, silence);
        }
        status.fleet.clone_from(&locked(&self.shared.fleet));
        status
    }

    /// Publishes the state of the fleet connection.
    pub fn set_fleet(&self, state: FleetState) {
        *locked(&self.shared.fleet) = Some(state);
    }

    /// Changes the published state of the fleet connection.
    pub fn update_fleet(&self, change: impl FnOnce(&mut FleetState)) {
        if let Some(state) = locked(&self.shared.fleet).as_mut() {
            change(state);
        }
    }

    /// The active model, without its temperatures.
    pub fn model(&self) -> Arc<Model> {
        Arc::clone(&locked(&self.shared.model))
    }

    /// Errors of the tool tip and the tool axis over the last two minutes, without and with the correction.
    pub fn history(&self) -> History {
        let points = locked(&self.shared.trend).points.clone();
        let errors = points.into_iter().map(|point| HistoryPoint {
            at_s: point.at_s,
            error_um: point.error_um,
            residual_um: point.residual_um,
            error_axis_urad: point.error_axis_urad,
            residual_axis_urad: point.residual_axis_urad,
            ..HistoryPoint::default()
        });
        History { span_s: SPAN_S.into(), points: errors.collect(), ..History::default() }
    }

    /// The history of the last `span_s` seconds. Up to two minutes each point is one published state; beyond that, it
    /// holds the means and maxima of a period.
    pub fn history_over(&self, span_s: u32) -> History {
        let uptime_s = self.pulse.clock().elapsed().as_secs_f64();
        let now_s = unix_s();
        let start_s = now_s - uptime_s;
        let (step, points) = if span_s <= SPAN_S {
            let points = locked(&self.shared.trend).points.clone();
            let from = uptime_s - f64::from(span_s);
            let points = points.into_iter().filter(|point| point.at_s >= from);
            (0, points.map(without_idle_residual).collect())
        } else {
            let (columns, minutes, current) = locked(&self.shared.trend).recorder.parts();
            let times = [now_s, start_s];
            history::over(&columns, &minutes, current.as_ref(), span_s, times)
        };
        History {
            span_s: span_s.into(),
            start_s: Some(round(start_s)),
            step_s: Some(step as f64),
            points,
        }
    }
}

/// The current time, s since 1970; 0 before 1970.
fn unix_s() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}

struct Trend {
    points: VecDeque<HistoryPoint>,
    recorder: Recorder,
}

impl Trend {
    /// Adds a point to the current minute. Also adds it to the last two minutes, unless their newest point is too
    /// recent.
    fn add(&mut self, point: HistoryPoint) {
        let now = point.at_s;
        let idle = without_idle_residual(point.clone());
        self.recorder.add(unix_s(), &idle);
        if let Some(last) = self.points.back() {
            if now < last.at_s {
                // The uptime started again at zero.
                self.points.clear();
            } else if now - last.at_s < STEP_S {
                return;
            }
        }
        while self.points.front().is_some_and(|first| now - first.at_s > SPAN_S.into()) {
            self.points.pop_front();
        }
        self.points.push_back(point);
    }
}
