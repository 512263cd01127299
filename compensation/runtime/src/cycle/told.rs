//! The report of a cycle.

use std::time::Duration;

use volcomp_guard::{Output, Reasons};
use volcomp_vocabulary::{PerAxis, PerChannel};

use super::Cycle;
use crate::asked::Asked;

impl Cycle {
    pub(super) fn tell(&mut self, since_start: Duration, asked: &Asked, output: &Output) {
        let active = self.selector.active();
        let path = &self.paths[active];
        let report = &mut self.report;
        let confirmed = path.known().confirmed;
        let applied = confirmed.map_or(PerChannel::ZERO, |confirmed| confirmed.values);
        report.correction = path.in_machine(&applied);
        report.written = path.written().fold(0, |bits, axis| bits | 1 << axis);
        report.proven = PerAxis::default();
        let shown = &self.guard.verdict().axes;
        for (i, axis) in path.written().enumerate() {
            report.proven[axis] = path.corrects(i).then_some(shown[i]);
        }
        let hold = self.guard.limits().hold;
        report.correction_known =
            confirmed.is_some_and(|confirmed| since_start.saturating_sub(confirmed.at) <= hold);
        let errors = self
            .commanded
            .map(|state| self.model.errors(&state, &report.correction));
        report.error = errors.map(|[without, _]| without);
        report.residual = errors.map(|[_, with]| with);
        report.cycle += 1;
        report.now = since_start;
        report.state = output.state;
        report.active = active;
        report.held_back = output.held_back;
        report.reasons = output.reasons
            | asked.forbids
            | asked.notes
            | Reasons::DEGRADED.when(self.degraded)
            | Reasons::BEYOND_SEEN.when(self.model.is_beyond_seen());
        let paths = self.paths.iter().map(|path| path.report(since_start));
        let readers = self.readers.iter();
        let readers = readers.map(|reader| reader.report(since_start));
        for (place, told) in paths.chain(readers).enumerate().take(report.paths.len()) {
            report.paths[place] = told;
            report.paths[place].reasons |= self.interlocks.said_by(place);
        }
    }
}
