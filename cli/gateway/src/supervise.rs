//! The machines of a process from their start to their end, each in a thread of its own. What stops, reloads and is told to the
//! service manager goes through here; nothing here waits for a machine.

use std::{sync::Arc, thread, time::Duration};

use crate::{
    error::GatewayError,
    glance::Places,
    machine::Machine,
    plan::Plan,
    process::Manager,
    service::Service,
    signals::{Heard, Signal},
    slot::{Failure, Phase, Slot},
};

/// How often the machines are looked at.
const LOOK: Duration = Duration::from_millis(50);
/// The service manager hears that the process is ready after so long, though a machine is still opening its devices.
const READY_WITHIN: Duration = Duration::from_secs(10);

/// A machine to be started, and its place.
pub(crate) struct Member {
    pub(crate) machine: Machine,
    /// The plan of its files, or why there is none.
    pub(crate) plan: Result<Plan, GatewayError>,
    pub(crate) slot: Arc<Slot>,
}

/// Runs machines until all of them have ended. `reload` is called where a signal asks for one.
///
/// # Errors
/// The machines that do not run at the end although nobody has stopped them, and why.
pub(crate) fn supervise(
    members: Vec<Member>,
    signals: &Heard,
    mut reload: impl FnMut(),
) -> Result<(), GatewayError> {
    let is_alone = members.iter().all(|member| member.machine.name.is_none());
    let places: Places = members.iter().map(place).collect();
    let mut manager = Manager::new();
    for member in members {
        launch(member);
    }
    let phases = || -> Vec<Phase> { places.iter().map(|(_, slot)| slot.phase()).collect() };
    let mut is_stopping = false;
    loop {
        match signals.next(LOOK) {
            // The thread that heard it has ordered it.
            Some(Signal::Stop) => {
                is_stopping = true;
                manager.stopping();
            }
            Some(Signal::Reload) => {
                reload();
                for (_, slot) in &places {
                    slot.reload();
                }
            }
            None => {}
        }
        if is_stopping {
            for (_, slot) in &places {
                slot.give_up();
            }
        }
        let found = phases();
        let is_over = found.iter().all(Phase::is_over);
        if is_over {
            break;
        }
        let is_settled = !found.iter().any(Phase::is_starting);
        manager.ready(is_settled, READY_WITHIN);
        if !is_alone {
            manager.status(in_words(&places, &found));
        }
        manager.feed(
            places
                .iter()
                .map(|(_, slot)| slot.life().proofs())
                .collect(),
        );
    }
    // Those that wait to be started again: nobody is left whom the end of the process would disturb.
    let found = phases();
    for (_, slot) in &places {
        slot.stop();
    }
    outcome(&places, &found)
}

fn place(member: &Member) -> (String, Arc<Slot>) {
    let name = member.machine.name.clone().unwrap_or_default();
    (name, Arc::clone(&member.slot))
}

/// Starts the thread of a machine. Where there is none to be had the machine does not run.
fn launch(member: Member) {
    let Member {
        machine,
        plan,
        slot,
    } = member;
    let own = Arc::clone(&slot);
    let name = machine.name.as_deref().unwrap_or_default();
    let begun = thread::Builder::new()
        .name(format!("volcomp-service {name}").trim_end().to_owned())
        .spawn(move || machine.run(Some(plan), &own, &mut Service::turn));
    if let Err(e) = begun {
        slot.set(Phase::Failed(Failure {
            what: GatewayError::system("thread of the service", e).to_string(),
            status: 1,
            again: false,
        }));
    }
}

/// How the machines are, in one line.
fn in_words(places: &Places, phases: &[Phase]) -> String {
    let run = phases.iter().filter(|p| matches!(p, Phase::Running(_)));
    let mut text = format!("{} of {} machines run", run.count(), phases.len());
    for ((name, _), phase) in places.iter().zip(phases) {
        if matches!(phase, Phase::Failed(_)) {
            text.extend(["; ", name, " does not"]);
        }
    }
    text
}

/// What the process ends with.
fn outcome(places: &Places, phases: &[Phase]) -> Result<(), GatewayError> {
    let failed = places.iter().zip(phases).filter_map(|((name, _), phase)| {
        let Phase::Failed(failure) = phase else {
            return None;
        };
        Some(match name.as_str() {
            "" => (failure.what.clone(), failure.status),
            name => (format!("machine {name}: {}", failure.what), failure.status),
        })
    });
    let (what, statuses): (Vec<String>, Vec<u8>) = failed.unzip();
    match statuses.iter().max() {
        None => Ok(()),
        // Where some ran, the call was not wrong as a whole.
        Some(status) => Err(GatewayError::Failed {
            what: what.join("; "),
            status: if statuses.len() == phases.len() {
                *status
            } else {
                1
            },
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ended_with(found: &[(&str, Option<u8>)]) -> Option<(u8, String)> {
        let places = found
            .iter()
            .map(|(name, _)| ((*name).to_owned(), Arc::default()))
            .collect();
        let phases: Vec<Phase> = found
            .iter()
            .map(|(_, failed)| match failed {
                Some(status) => Phase::Failed(Failure {
                    what: "why".to_owned(),
                    status: *status,
                    again: false,
                }),
                None => Phase::Ended,
            })
            .collect();
        let error = outcome(&places, &phases).err()?;
        Some((error.status(), error.to_string()))
    }

    #[test]
    fn what_ended_by_itself_ends_the_process_with_a_status() {
        let told = |status, what: &str| Some((status, what.to_owned()));
        assert_eq!(ended_with(&[("", None)]), None);
        assert_eq!(ended_with(&[("", Some(1))]), told(1, "why"));
        assert_eq!(ended_with(&[("", Some(2))]), told(2, "why"));
        let (a, b) = ("mill-1", "mill-2");
        assert_eq!(ended_with(&[(a, None), (b, None)]), None);
        // One of two, whatever it ended for: the call was not wrong as a whole.
        for status in [1, 2] {
            let one = [(a, None), (b, Some(status))];
            assert_eq!(ended_with(&one), told(1, "machine mill-2: why"));
        }
        let both = [(a, Some(2)), (b, Some(2))];
        assert_eq!(
            ended_with(&both),
            told(2, "machine mill-1: why; machine mill-2: why")
        );
    }
}
