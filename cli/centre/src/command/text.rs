use std::{collections::BTreeSet, fmt::Write};

use serde::Serialize;
use volcomp_fleet::largest_moves;

use crate::{
    clock::date,
    columns,
    models::Stage,
    one_line,
    records::{Alarm, AuditRecord, Live, Machine, Model, Origin, Version},
    rollout::{Phase, Rollout, Step, Target},
};

#[derive(Serialize)]
pub(super) struct MachineView {
    #[serde(flatten)]
    pub(super) machine: Machine,
    pub(super) live: Option<Live>,
    /// Age of the machine's last condition, s, from the clocks of this computer and of the server.
    pub(super) age_s: Option<f64>,
    pub(super) version: Option<Version>,
    pub(super) wanted: Option<MachineModel>,
    /// The active model; `None` if the machine has none or never reported one.
    pub(super) in_force: Option<MachineModel>,
}

/// A model of a machine: version, checksum and name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct MachineModel {
    pub(super) version: u64,
    pub(super) model: String,
    pub(super) name: String,
}

fn row(cells: &[&str]) -> Vec<String> {
    cells.iter().map(|cell| (*cell).to_owned()).collect()
}

/// Abbreviated checksum, long enough to be unique.
fn short(sha256: &str) -> &str {
    sha256.get(..12).unwrap_or(sha256)
}

/// Formats a number of machines: "1 machine", "2 machines".
pub(super) fn counted(machines: usize) -> String {
    let end = if machines == 1 { "" } else { "s" };
    format!("{machines} machine{end}")
}

fn age(age_s: f64) -> String {
    const UNITS: [(f64, &str); 4] = [(1.0, "s"), (60.0, "min"), (3600.0, "h"), (86_400.0, "d")];
    let mut units = UNITS.iter().rev();
    let fits = units.find(|(unit_s, _)| age_s >= 2.0 * unit_s);
    let (unit_s, unit) = fits.unwrap_or(&UNITS[0]);
    format!("{:.0} {unit}", (age_s / unit_s).floor())
}

pub(super) fn started(rollout: &Rollout, model: &Model) -> String {
    format!(
        "roll-out {} of {} {} to {} is started; the running centre advances it\n",
        rollout.id,
        short(&model.sha256),
        model.name,
        counted(rollout.targets.len())
    )
}

pub(super) fn machines(shown: &[MachineView]) -> String {
    let mut rows =
        vec![row(&["machine", "site", "state", "age", "residual", "corrects by", "shall have"])];
    for one in shown {
        let condition = one.live.as_ref().and_then(|live| live.condition.as_ref());
        // The last report of a silent machine is not its current state.
        let is_old = (one.age_s).is_none_or(|age_s| one.machine.is_silent(age_s));
        let state = match condition {
            None => "never connected".to_owned(),
            Some(condition) if is_old => format!("unknown, was {}", condition.state),
            Some(condition) => condition.state.clone(),
        };
        let residual = condition.and_then(|condition| condition.residual_um);
        let residual = residual.filter(|_| !is_old);
        let cell = |model: &Option<MachineModel>| {
            model.as_ref().map_or("-".to_owned(), |model| {
                let words = format!("{}: {} {}", model.version, short(&model.model), model.name);
                words.trim_end().to_owned()
            })
        };
        let shall_have = if one.wanted.is_some() && one.wanted == one.in_force {
            "the same".to_owned()
        } else {
            cell(&one.wanted)
        };
        // Version 0: no version of the centre is active on the machine.
        let corrects_by = match (&one.in_force, &one.live) {
            (None, Some(live)) if live.version == 0 => "its own file".to_owned(),
            (in_force, _) => cell(in_force),
        };
        rows.push(row(&[
            one.machine.identity.machine.as_str(),
            one.machine.identity.site.as_str(),
            &state,
            &one.age_s.map_or("-".to_owned(), age),
            &residual.map_or("-".to_owned(), |um| format!("{um:.1} µm")),
            &corrects_by,
            &shall_have,
        ]));
    }
    columns(&rows)
}

pub(super) fn models(models: &[Model]) -> String {
    let mut rows = vec![row(&["model", "name", "structure", "measured", "by"])];
    for model in models {
        rows.push(row(&[
            short(&model.sha256),
            &model.name,
            &model.structure,
            if model.measured.is_empty() { "-" } else { &model.measured },
            &model.by,
        ]));
    }
    columns(&rows)
}

pub(super) fn model(model: &Model) -> String {
    let letters: Vec<String> = model.axes.iter().map(ToString::to_string).collect();
    let origin = match &model.origin {
        Origin::File { name } if name.is_empty() => "a text without a file name".to_owned(),
        Origin::File { name } => format!("the machine file {name}"),
        Origin::Calibration { path } => format!("the calibration {path}"),
    };
    let measured = if model.measured.is_empty() { "unknown" } else { &model.measured };
    let facts = [
        ("checksum", model.sha256.as_str()),
        ("in gateways", &model.checksum),
        ("name", &model.name),
        ("structure", &model.structure),
        ("axes", &letters.join(" ")),
        ("made from", &origin),
        ("measured", measured),
        ("added by", &model.by),
    ];
    let mut rows: Vec<Vec<String>> = facts.map(|(name, fact)| row(&[name, fact])).to_vec();
    rows.extend(model.notes.iter().map(|note| row(&["note", note])));
    columns(&rows)
}

pub(super) fn alarms(alarms: &[Alarm]) -> String {
    let mut text = String::new();
    for alarm in alarms {
        let of = (alarm.machine.as_ref()).map_or("centre", |machine| machine.as_str());
        let over = if alarm.until_s.is_some() { " (over)" } else { "" };
        let _ = writeln!(text, "{of}: {}{over}: {}", alarm.kind.name(), one_line(&alarm.text));
    }
    text
}

pub(super) fn audit(records: &[AuditRecord]) -> String {
    let mut rows = Vec::new();
    for record in records.iter().rev() {
        rows.push(row(&[
            &record.number.to_string(),
            &date(record.at_s),
            &record.by,
            &record.action,
            &record.object,
        ]));
    }
    columns(&rows)
}

fn phase(phase: &Phase) -> String {
    match phase {
        Phase::Running => "is running".to_owned(),
        Phase::Paused { by } => format!("is paused by {by}"),
        Phase::Stopped { why } => format!("has stopped: {}", one_line(why)),
        Phase::Aborted { by } => format!("was ended by {by}"),
        Phase::Done => "is done".to_owned(),
    }
}

fn step(step: &Step) -> String {
    match step {
        Step::Waiting => "waits for its wave".to_owned(),
        Step::Sent { version, waited_s } => {
            format!("version {version} is sent, no answer for {waited_s:.0} s")
        }
        Step::NeedsConfirmation { version, hash, worst_um, worst_urad, differences } => {
            format!(
                "version {version} moves its axes by up to {}: to be confirmed with {hash}",
                largest_moves(worst_um, worst_urad, differences)
            )
        }
        Step::Soaking { version, soaked_s, idle_s, .. } => {
            let waits = if *idle_s > 0.0 {
                format!("; it has not compensated for {idle_s:.0} s")
            } else {
                String::new()
            };
            format!("version {version} is active, observed for {soaked_s:.0} s{waits}")
        }
        Step::Done { version } => format!("version {version} is active"),
        Step::Out { why, excused, .. } => {
            let excused = if *excused { " (ignored by the user)" } else { "" };
            format!("out: {why}{excused}")
        }
    }
}

fn kept(target: &Target, step: String) -> String {
    match &target.kept_by {
        Some(by) => format!("{step}; kept by {by}"),
        None => step,
    }
}

pub(super) fn rollouts(rollouts: &[Rollout], whole: bool) -> String {
    let mut text = String::new();
    for rollout in rollouts {
        let done = (rollout.targets.iter())
            .filter(|target| matches!(target.step, Step::Done { .. }))
            .count();
        let _ = writeln!(
            text,
            "roll-out {} of {} by {}: {done} of {}; it {}",
            rollout.id,
            short(&rollout.model),
            rollout.by,
            counted(rollout.targets.len()),
            phase(&rollout.phase)
        );
        let rows = rollout.targets.iter().filter(|target| {
            whole || matches!(target.step, Step::NeedsConfirmation { .. } | Step::Out { .. })
        });
        let rows: Vec<Vec<String>> = rows
            .map(|target| {
                row(&[
                    "",
                    target.machine.as_str(),
                    &format!("wave {}", target.wave),
                    &kept(target, step(&target.step)),
                ])
            })
            .collect();
        text.push_str(&columns(&rows));
    }
    text
}

pub(super) fn drift(stages: &[Stage]) -> String {
    let parameters: BTreeSet<_> = stages.iter().flat_map(|stage| stage.parameters.keys()).collect();
    let mut head = vec!["error".to_owned()];
    head.extend(stages.iter().map(|stage| short(&stage.sha256).to_owned()));
    let mut rows = vec![head];
    for parameter in parameters {
        let mut cells = vec![parameter.to_string()];
        for stage in stages {
            let value = stage.parameters.get(parameter);
            cells.push(value.map_or("-".to_owned(), |value| format!("{value:.1}")));
        }
        rows.push(cells);
    }
    columns(&rows)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::records::{AlarmKind, Severity};

    #[test]
    fn a_machine_is_listed_with_its_active_and_desired_model() {
        let identity = volcomp_fleet::Identity {
            site: "berlin".parse().expect("a name"),
            machine: "mill-1".parse().expect("a name"),
        };
        let machine = Machine::new(identity.clone(), "1".into(), "w X' b t".into(), Vec::new());
        let named = |version: u64, model: &str, name: &str| {
            Some(MachineModel { version, model: model.repeat(64), name: name.to_owned() })
        };
        let mut shown = MachineView {
            live: Some(Live::new(identity.machine, 0.0, 3)),
            age_s: None,
            version: None,
            wanted: named(4, "b", "of autumn"),
            in_force: named(3, "a", "of spring"),
            machine,
        };
        let line = |shown: &MachineView| {
            let text = machines(std::slice::from_ref(shown));
            text.lines().last().unwrap_or_default().to_owned()
        };
        let both = line(&shown);
        assert!(both.ends_with("3: aaaaaaaaaaaa of spring  4: bbbbbbbbbbbb of autumn"), "{both}");
        shown.wanted.clone_from(&shown.in_force);
        let same = line(&shown);
        assert!(same.ends_with("3: aaaaaaaaaaaa of spring  the same"), "{same}");
        shown.in_force = None;
        if let Some(live) = &mut shown.live {
            live.version = 0;
        }
        let own = line(&shown);
        assert!(own.ends_with("its own file  3: aaaaaaaaaaaa of spring"), "{own}");
        shown.live = None;
        let never = line(&shown);
        assert!(!never.contains("its own file"), "{never}");
        assert!(never.ends_with(" 3: aaaaaaaaaaaa of spring"), "{never}");
    }

    /// A stolen nkey of a machine permits any text in its messages.
    #[test]
    fn texts_of_a_machine_neither_act_on_the_terminal_nor_begin_a_line() {
        let hostile = "a\u{1b}[2J\u{9b}2J\nmill-2: silent";
        let name: volcomp_fleet::MachineId = "mill-1".parse().expect("a name");
        let site = "berlin".parse().expect("a name");
        let identity = volcomp_fleet::Identity { site, machine: name.clone() };
        let mut live = Live::new(name.clone(), 0.0, 0);
        live.condition = Some(volcomp_fleet::Condition {
            state: hostile.to_owned(),
            reasons: Vec::new(),
            armed: false,
            correction_um: BTreeMap::new(),
            correction_urad: BTreeMap::new(),
            residual_um: None,
            temperatures_degc: BTreeMap::new(),
            cycle_p99_us: 0.0,
            overruns: 0,
            faults: 0,
        });
        let machine = Machine::new(identity, "1".into(), "w X' b t".into(), Vec::new());
        let shown = MachineView {
            machine,
            live: Some(live),
            age_s: Some(0.0),
            version: None,
            wanted: None,
            in_force: None,
        };
        let alarm = Alarm {
            id: 1,
            machine: Some(name),
            kind: AlarmKind::Faulted,
            severity: Severity::Warning,
            text: hostile.to_owned(),
            since_s: 0.0,
            until_s: None,
            seen_by: None,
        };
        let stopped = phase(&Phase::Stopped { why: hostile.to_owned() });
        for (text, lines) in [(machines(&[shown]), 2), (alarms(&[alarm]), 1), (stopped, 1)] {
            assert_eq!(text.lines().count(), lines, "{text:?}");
            assert!(!text.contains(|c: char| c.is_control() && c != '\n'), "{text:?}");
            assert!(text.contains("mill-2: silent"), "{text:?}");
        }
    }
}
