//! The requests that a service carries out: arming, disarming, acknowledging. Reloading has a file of its own.

use std::{
    io::ErrorKind,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_document::ReadError;
use volcomp_guard::{Reasons, Request, State};
use volcomp_model::{Machine, ModelError};
use volcomp_port::Description;
use volcomp_runtime::{Model, Order};
use volcomp_vocabulary::AxisName;

use super::{Service, effect};
use crate::{
    audit::replace_file,
    documents::{Answer, Event, Question, Refusal, Settled},
    request::{Ask, Asked, Reply},
};

/// A request has taken effect after so long, or it has none.
const EFFECT: Duration = Duration::from_millis(300);

impl Service {
    pub(super) fn auto_arm(&mut self) {
        if !self.parts.config.auto_arm || self.auto_arm_done || Instant::now() < self.auto_arm_after
        {
            return;
        }
        self.auto_arm_after = Instant::now() + Duration::from_secs(1);
        let report = self.parts.handle.report();
        let against = report.reasons.without(Reasons::DOES_NOT_FORBID);
        if report.cycle > 1
            && report.state == State::Disarmed
            && against.is_empty()
            && self.parts.forbids.is_empty()
            && !self.audit_fails
        {
            let reply = self.arm("auto_arm", None);
            if reply.status != 200 {
                tracing::warn!("auto_arm: {}", in_words(&reply.answer));
                // A model that must be confirmed is for a person.
                self.auto_arm_done = matches!(reply.answer, Answer::Question(_));
            }
        }
    }

    pub(super) fn answer(&mut self, asked: Asked) {
        let who = &asked.who;
        // From here on a person decides.
        self.auto_arm_done |= !matches!(asked.ask, Ask::Reload(_));
        let reply = match asked.ask {
            Ask::Arm(confirm) => self.arm(who, confirm.as_deref()),
            Ask::Disarm => self.request(who, "disarm", Request::Disarm),
            Ask::Acknowledge => self.request(who, "acknowledge", Request::Acknowledge),
            Ask::Reload(confirm) => self.reload(who, confirm.as_deref()),
        };
        if let Some(to) = asked.answer {
            // Whoever asked may have gone.
            let _ = to.send(reply);
        } else {
            tracing::info!("{who}: {}", in_words(&reply.answer));
        }
    }

    /// Sends a request, writes it down, and waits for its effect.
    fn request(&mut self, who: &str, what: &str, request: Request) -> Reply {
        let before = *self.parts.handle.report();
        let state = before.state.into();
        let end = Instant::now() + EFFECT.max(self.parts.config.cycle * 5);
        // A full disk forbids arming, never disarming, and disarming waits for no disk.
        if request == Request::Arm && !self.log(who, what, Event::Request { state }) {
            return no_log(before.state);
        }
        let sent = self.send_until(request, end);
        if request != Request::Arm {
            self.log(who, what, Event::Request { state });
        }
        if !sent {
            return refused(503, "the control thread takes no orders");
        }
        loop {
            let report = *self.parts.handle.report();
            // Two cycles: the order may have come in the middle of one.
            let seen = report.cycle > before.cycle + 2;
            let taken = effect::has_taken(request, report.state);
            if seen && taken {
                return settled(200, report.state, report.reasons | self.parts.forbids, None);
            }
            if Instant::now() > end && !seen {
                return refused(
                    503,
                    "the control thread runs no cycles: what is applied now is not known, and the request waits for it",
                );
            }
            if Instant::now() > end {
                let why = effect::refusal(request, report.state);
                let reasons = report.reasons | self.parts.forbids;
                return settled(409, report.state, reasons, Some(why));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Sends a request, again while too many orders wait. Whether it was taken.
    fn send_until(&mut self, request: Request, end: Instant) -> bool {
        while !self.parts.handle.send(Order::Request(request)) {
            if Instant::now() > end {
                return false;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        true
    }

    pub(super) fn confirmed_path(&self) -> PathBuf {
        self.parts.config.audit_dir.join("confirmed-machine.toml")
    }

    /// The question that a person must confirm before `new` takes the place of `old`; `None` where there is none, or
    /// it is confirmed. The change of the correction is judged at the reference temperature and at the present
    /// temperatures.
    pub(super) fn question(
        &mut self,
        old: &Model,
        new: &Model,
        confirm: Option<&str>,
    ) -> Option<Question> {
        let report = *self.parts.handle.report();
        let guard = self.parts.config.guard.as_ref()?;
        let degc = |name: &str| {
            let mut sensors = self.parts.sensors.iter();
            let place = sensors.position(|sensor| sensor == name)?;
            report.sensors.get(place)?.degc
        };
        let names = |controller: &Description| -> Vec<AxisName> {
            controller.axes.iter().map(|axis| axis.name).collect()
        };
        let written: Vec<Vec<AxisName>> = self.parts.controllers.iter().map(names).collect();
        let written = || written.iter().map(Vec::as_slice);
        let cold = old.worst_corner(new, written());
        let warm = old.warmed(degc).worst_corner(&new.warmed(degc), written());
        let worst = cold.max(warm);
        let (worst_um, worst_urad) = (worst.linear.to_um().0, worst.rotary.to_urad().0);
        let confirm_um = guard.linear.confirm.0;
        let confirm_urad = guard.rotary.as_ref().map(|rotary| rotary.confirm.0);
        let moves = worst_um > confirm_um || worst_urad > confirm_urad.unwrap_or(f64::INFINITY);
        if !moves || confirm == Some(new.hash.as_str()) {
            return None;
        }
        // A machine with other axes moves infinitely far, which is no number in JSON.
        let finite = |x: f64| x.is_finite().then_some(x);
        Some(Question {
            model: new.hash.clone(),
            worst_corner_um: finite(worst_um),
            worst_corner_urad: finite(worst_urad),
            confirm_um,
            confirm_urad,
        })
    }

    fn arm(&mut self, who: &str, confirm: Option<&str>) -> Reply {
        let guard = self.parts.config.guard.as_ref();
        let fading = guard.map(|guard| guard.fading).unwrap_or_default();
        let path = self.confirmed_path();
        let armed_last = Machine::read(&path).and_then(|machine| Model::new(&machine, fading));
        let armed_last = match armed_last {
            Ok(old) => Some(old),
            // Where no model was armed before, there is nothing to compare with.
            Err(ModelError::Read(ReadError::System { ref source, .. }))
                if source.kind() == ErrorKind::NotFound =>
            {
                None
            }
            // A record that cannot be read is no proof that this model was confirmed.
            Err(error) => {
                tracing::error!("{}: {error}", path.display());
                let what = format!(
                    "the model that was armed last cannot be read ({error}): look at it, and remove {} if it is damaged",
                    path.display()
                );
                return refused(409, what);
            }
        };
        if let Some(old) = armed_last
            && old.hash != self.parts.model.hash
            && let Some(question) = self.question(&old, &Arc::clone(&self.parts.model), confirm)
        {
            return Reply {
                status: 409,
                answer: Answer::Question(question),
            };
        }
        if let Err(e) = replace_file(&path, &self.parts.model.text) {
            tracing::error!("{}: {e}", path.display());
            return no_log(self.last_state);
        }
        self.request(who, "arm", Request::Arm)
    }
}

/// The answer when the audit log cannot be written.
pub(super) fn no_log(state: State) -> Reply {
    let why = "the audit log cannot be written";
    settled(409, state, Reasons::AUDIT, Some(why))
}

/// A refusal in words.
pub(super) fn refused(status: u16, why: impl Into<String>) -> Reply {
    Reply {
        status,
        answer: Answer::Refusal(Refusal::new(why)),
    }
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

/// An answer for the log of the program.
fn in_words(answer: &Answer) -> String {
    match answer {
        Answer::Question(question) => {
            let size = |size: Option<f64>| {
                size.map_or("an unknown number of".to_owned(), |size| {
                    format!("{size:.1}")
                })
            };
            format!(
                "model {} must be confirmed: it moves a corner of the work space by {} µm and {} µrad",
                question.model,
                size(question.worst_corner_um),
                size(question.worst_corner_urad)
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
        Answer::Reloaded(reloaded) => format!("model {}", reloaded.model),
        Answer::Refusal(refusal) => refusal.error.clone(),
    }
}
