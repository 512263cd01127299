//! The trend of the error over the last minutes: a ring of fixed length.

use std::collections::VecDeque;

use crate::documents::{History, HistoryPoint, Status, round};

/// How long the history reaches back, s.
const SPAN_S: f64 = 120.0;
/// A point is kept so often, s.
const STEP_S: f64 = 0.25;

/// The points of the last minutes. State: the points, oldest first.
#[derive(Debug, Default)]
pub struct Trend {
    points: VecDeque<HistoryPoint>,
}

impl Trend {
    /// Keeps a state as a point, unless the last point is too young. Points that are too old are dropped.
    pub fn add(&mut self, status: &Status) {
        let now = status.uptime_s;
        if let Some(last) = self.points.back() {
            if now < last.at_s {
                // The clock began again.
                self.points.clear();
            } else if now - last.at_s < STEP_S {
                return;
            }
        }
        while self
            .points
            .front()
            .is_some_and(|first| now - first.at_s > SPAN_S)
        {
            self.points.pop_front();
        }
        let length =
            |v: Option<[f64; 3]>| v.map(|v| round(v.iter().map(|x| x * x).sum::<f64>().sqrt()));
        self.points.push_back(HistoryPoint {
            at_s: now,
            error_um: length(status.true_error_um.or(status.error_um)),
            residual_um: length(status.true_residual_um.or(status.residual_um)),
            error_axis_urad: length(status.error_axis_urad),
            residual_axis_urad: length(status.residual_axis_urad),
        });
    }

    /// The points as a document.
    pub fn history(&self) -> History {
        History {
            span_s: SPAN_S,
            points: self.points.iter().copied().collect(),
        }
    }
}
