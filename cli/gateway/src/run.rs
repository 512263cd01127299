//! From a call to running machines, and to their end.

use std::{io::Write, path::Path, sync::Arc};

use crate::{
    config::{ConfigFile, MachineEntry, Several},
    error::GatewayError,
    glance::Places,
    http::{self, Door, Overviewed},
    machine::Machine,
    options::Options,
    plan,
    process::{Process, proven_within},
    signals::Heard,
    slot::Slot,
    supervise::{Member, supervise},
    together,
};

/// Runs until it is told to stop.
///
/// # Errors
/// Why it does not start. Once it runs, troubles are states and log lines; at its end, the machines that did not run.
pub fn run(options: &Options) -> Result<(), GatewayError> {
    if let Some(path) = &options.config
        && let ConfigFile::Several(several) = ConfigFile::read(path)?
    {
        return run_several(path, &several, options);
    }
    let machine = Machine {
        name: None,
        options: options.clone(),
        proven_within: proven_within(),
    };
    let member = Member {
        plan: Ok(machine.plan()?),
        machine,
        slot: Arc::default(),
    };
    let _process = prepare();
    let signals = heard(std::slice::from_ref(&member))?;
    supervise(vec![member], &signals, || {})
}

fn run_several(path: &Path, several: &Several, options: &Options) -> Result<(), GatewayError> {
    let members = members(several, options);
    let mut several = several.clone();
    if let Some(listen) = options.listen {
        several.dashboard.listen = listen;
    }
    if let Some(file) = &options.token_file {
        several.dashboard.token_file = Some(file.clone());
    }
    together(&several, &members)?;
    let (tokens, tls) = plan::dashboard(&several.dashboard)?;
    let _process = prepare();
    let listener = http::listen(several.dashboard.listen)?;
    let address = listener
        .local_addr()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let scheme = if tls.is_some() { "https" } else { "http" };
    let places: Places = members
        .iter()
        .map(|m| {
            (
                m.machine.name.clone().unwrap_or_default(),
                Arc::clone(&m.slot),
            )
        })
        .collect();
    let overviewed = Overviewed {
        places,
        door: Arc::new(Door::new(&several.dashboard, tokens)),
    };
    let signals = heard(&members)?;
    let runtime = http::runtime(listener, |listener| {
        http::serve_overview(listener, tls, Arc::new(overviewed))
    })?;
    // Nobody may be reading.
    let _ = writeln!(std::io::stdout(), "listening on {scheme}://{address}");
    let ended = supervise(members, &signals, || tell_other_machines(path, &several));
    runtime.shutdown_background();
    ended
}

/// The machines of a file, each with the plan of its configuration.
pub(crate) fn members(several: &Several, options: &Options) -> Vec<Member> {
    let member = |entry: &MachineEntry| {
        let machine = Machine {
            name: Some(entry.name.clone()),
            options: Options {
                config: Some(entry.config.clone()),
                audit_dir: options.audit_dir.as_ref().map(|dir| dir.join(&entry.name)),
                ..Options::default()
            },
            proven_within: proven_within(),
        };
        Member {
            plan: machine.plan(),
            machine,
            slot: Arc::new(Slot::default()),
        }
    };
    several.machines.iter().map(member).collect()
}

/// Refuses what two machines have in common, as far as their configurations are right.
pub(crate) fn together(several: &Several, members: &[Member]) -> Result<(), GatewayError> {
    let entries = several.machines.iter().zip(members);
    let planned = entries.filter_map(|(entry, member)| {
        let config = &member.plan.as_ref().ok()?.config;
        Some((entry.name.as_str(), entry.config.as_path(), config))
    });
    together::check(several, &planned.collect::<Vec<_>>())
}

/// The signals, of which one to stop acts on every machine at once.
fn heard(members: &[Member]) -> Result<Heard, GatewayError> {
    let slots: Vec<Arc<Slot>> = members.iter().map(|m| Arc::clone(&m.slot)).collect();
    Heard::new(move || slots.iter().for_each(|slot| slot.stop()))
}

fn prepare() -> Process {
    let process = Process::prepare();
    for lacking in &process.lacking {
        tracing::warn!("{lacking}");
    }
    process
}

/// Says that machines which were added to the file, or taken out of it, need a restart.
fn tell_other_machines(path: &Path, running: &Several) {
    match ConfigFile::read(path) {
        Ok(ConfigFile::Several(now)) if now.machines == running.machines => {}
        Ok(_) => tracing::warn!(
            "{}: [[machine]] changed: restart the gateway for that",
            running.file
        ),
        Err(e) => tracing::warn!("reload: {e}"),
    }
}
