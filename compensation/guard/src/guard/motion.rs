//! How the output moves in a cycle, and how far it may be from what may be applied.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::Guard;
use crate::{
    Confirmed, Inputs, Limits, Reasons, Scheme, Vector,
    state::{Phase, State},
    step::{ROUNDING, ROUNDING_STEPS},
};

/// Shares of a cycle's motion that are tried until the output is as near to what is confirmed as it must be.
const SHARES: [f64; 5] = [1.0, 0.5, 0.2, 0.1, 0.0];

impl Guard {
    /// Moves the output for `dt_s`, as far as it stays near to everything that may be applied. Whether it is to be sent.
    pub(super) fn advance(&mut self, inputs: &Inputs, dt_s: f64, reasons: &mut Reasons) -> bool {
        let Some(Confirmed { values, .. }) = inputs.known.confirmed else {
            return false;
        };
        let is_barrier = inputs.known.scheme == Scheme::Barrier;
        let reach = self.reach(inputs.known.scheme);
        let [lowest, highest] = inputs.known.between;
        let sent = self.before.output();
        for share in SHARES {
            self.vector = self.before;
            let moved = self.move_by(inputs, dt_s * share);
            let output = self.output();
            let is_near = |i: usize| {
                // What is a whole number of steps but for a rounding goes to the next one.
                let rounding = ROUNDING_STEPS * self.limits.axes[i].resolution;
                let reach = reach[i] * ROUNDING + rounding;
                let (mut least, mut largest) = (highest[i] - reach, lowest[i] + reach);
                // What comes in from beyond a limit begins where it may stand.
                let mut stood = lowest[i].abs().max(highest[i].abs());
                if is_barrier {
                    // The word that was sent last is on its way, and may be sent again, however far it is from what is confirmed.
                    (least, largest) = (least.min(sent[i]), largest.max(sent[i]));
                    stood = stood.max(sent[i].abs());
                }
                let most = stood.max(self.limits.axes[i].reachable());
                (least..=largest).contains(&output[i])
                    && output[i].abs() <= most * ROUNDING
                    && self.corridor.contains(i, output[i], &self.limits)
            };
            if self.all(is_near) {
                // What is not confirmed yet holds the output back as its own slew does.
                let moved = moved | Reasons::SLEWING.when(share < 1.0);
                self.held_back += u64::from(moved.contains(Reasons::SLEWING));
                *reasons |= moved;
                self.corridor.narrow(&output, &self.limits);
                self.allowed.send(&output, &self.limits);
                self.sent_to_barrier = is_barrier.then_some(inputs.now);
                return true;
            }
        }
        if is_barrier {
            // A frame whose sending failed may have landed all the same: from there to the word before it the rate allows
            // nothing yet.
            self.vector = self.before;
            self.vector.stop();
        } else {
            // What was sent last is too far from what is confirmed to be sent again: it goes on from there.
            self.vector = Vector::at(&values);
            self.stood = true;
        }
        self.held_back += 1;
        *reasons |= Reasons::SLEWING;
        false
    }

    /// How far the output of each axis may be from what may be applied, mm and rad: what the guard slews in the delay of a
    /// path with a barrier, or slewed while what is on its way was sent, else one slew or one step, whichever is larger.
    fn reach(&self, scheme: Scheme) -> PerChannel<f64> {
        let period_s = self.limits.period.as_secs_f64();
        let delay_s = self.limits.delay().as_secs_f64();
        PerChannel::from_fn(|i| {
            let axis = &self.limits.axes[i];
            match scheme {
                Scheme::Barrier => {
                    let slew_per_s = axis.slew_per_s.max(self.allowed.slew_per_s(i));
                    slew_per_s * (delay_s + period_s) + axis.resolution
                }
                Scheme::Plain | Scheme::NoReadBack => {
                    (axis.slew_per_s * period_s).max(axis.resolution)
                }
            }
        })
    }

    /// Moves the vector by what the state asks for. Gives what is to be told of it.
    fn move_by(&mut self, inputs: &Inputs, dt_s: f64) -> Reasons {
        let limits = self.limits;
        if !inputs.interlocks.is_empty() {
            match self.held {
                Some(held) => self.move_to_held(&held, dt_s),
                None => self.vector.stop(),
            }
            return Reasons::NONE;
        }
        match self.state {
            State::Arming(Phase::Proving) => {
                self.move_to(&self.proof.goal(&self.from, &limits), &limits, dt_s);
                Reasons::NONE
            }
            State::Arming(Phase::Ramping) | State::Compensating => {
                let Some(wanted) = &inputs.wanted else {
                    return Reasons::NONE;
                };
                let followed = self.vector.follow(wanted, &limits, dt_s);
                Reasons::SLEWING.when(followed.slewing)
                    | Reasons::LIMITED.when(followed.limited)
                    | Reasons::WARN.when(followed.warned)
            }
            State::RampingOut(_) | State::Faulted(_) => {
                let mut limits = limits;
                if inputs.let_go {
                    limits.ramp = Duration::ZERO;
                }
                self.vector.advance_line(&limits, dt_s);
                Reasons::NONE
            }
            State::Disarmed | State::Holding(_) => {
                self.vector.stop();
                Reasons::NONE
            }
        }
    }

    /// Moves the vector to where the control holds by itself, also beyond a limit that was lowered meanwhile: it is led in after
    /// the stop, in which nothing moves.
    fn move_to_held(&mut self, held: &PerChannel<f64>, dt_s: f64) {
        let (stands, mut limits) = (self.vector.smooth(), self.limits);
        for (i, axis) in limits.axes.iter_mut().enumerate() {
            axis.limit = axis.limit.max(held[i].abs()).max(stands[i].abs());
        }
        limits.ramp = Duration::ZERO;
        self.move_on_line(held, &limits, dt_s);
    }

    /// Moves the vector on a line to a goal that is some steps away: it takes the fewest cycles, not those of the ramp of a
    /// correction. What a lowered limit left outside comes in by a ramp.
    fn move_to(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        let (smooth, mut limits) = (self.vector.smooth(), *limits);
        let is_within = |i: usize| smooth[i].abs() <= limits.axes[i].reachable() * ROUNDING;
        if self.all(is_within) {
            limits.ramp = Duration::ZERO;
        }
        self.move_on_line(goal, &limits, dt_s);
    }

    fn move_on_line(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        // Also anew where a write was not sent, and the vector is as it was before.
        if !self.vector.leads_to(goal) {
            self.vector.begin_line(goal);
        }
        self.vector.advance_line(limits, dt_s);
    }
}
