//! The state machine of roll-outs: scenarios, and invariants over random sequences of events.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use volcomp_centre::rollout::{
    Action, Event, Observation, Phase, Rollout, Rules, Step, UserRequest,
};
use volcomp_fleet::{MachineId, Outcome};

fn name(place: usize) -> MachineId {
    format!("m{place}").parse().unwrap()
}

fn rules() -> Rules {
    Rules {
        waves: vec![50, 100],
        soak_s: 20.0,
        answer_s: 60.0,
        tolerate: 1,
        residual_ratio: 1.5,
        residual_um: 2.0,
    }
}

fn rollout(machines: usize, canaries: &[usize], rules: Rules) -> Rollout {
    let machines: Vec<(MachineId, bool)> =
        (0..machines).map(|place| (name(place), canaries.contains(&place))).collect();
    Rollout::new(1, "model", &machines, rules, "anna", 0.0)
}

fn issued(actions: &[Action]) -> Vec<MachineId> {
    let machines = actions.iter().filter_map(|action| match action {
        Action::Issue { machine, .. } => Some(machine.clone()),
        Action::Withdraw { .. } => None,
    });
    machines.collect()
}

fn withdrawn(actions: &[Action]) -> Vec<MachineId> {
    let machines = actions.iter().filter_map(|action| match action {
        Action::Withdraw { machine } => Some(machine.clone()),
        Action::Issue { .. } => None,
    });
    machines.collect()
}

/// A pass with these machines: index, version, and residual in µm.
fn looked(elapsed_s: f64, seen: &[(usize, u64, f64)]) -> Event {
    let seen = seen.iter().map(|(place, version, residual)| {
        let seen = Observation {
            reachable: true,
            version: *version,
            corrects: true,
            residual_um: Some(*residual),
            ..Observation::default()
        };
        (name(*place), seen)
    });
    Event::Pass { elapsed_s, seen: seen.collect() }
}

/// A machine that does not compensate reveals nothing about its model, so its soak time stops.
#[test]
fn a_disarmed_machine_does_not_soak() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions), [name(0)]);
    rollout.step(answered(0, 1, Outcome::Activated));
    for _ in 0..100 {
        let disarmed = Observation {
            reachable: true,
            version: 1,
            residual_um: Some(90.0),
            ..Observation::default()
        };
        let event = Event::Pass { elapsed_s: 10.0, seen: BTreeMap::from([(name(0), disarmed)]) };
        assert_eq!(rollout.step(event), []);
        // Single passes with an older version do not add up to a timeout.
        assert_eq!(rollout.step(looked(10.0, &[(0, 0, 4.0)])), []);
    }
    assert_eq!(rollout.phase, Phase::Running);
    let mut actions = Vec::new();
    for _ in 0..2 {
        actions = rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
}

/// A pass in which the first machine's guard is faulted.
fn faulted(version: u64, why: &str) -> Event {
    let seen = Observation {
        reachable: true,
        version,
        faulted: Some(why.to_owned()),
        ..Observation::default()
    };
    Event::Pass { elapsed_s: 1.0, seen: BTreeMap::from([(name(0), seen)]) }
}

fn needs() -> Outcome {
    Outcome::NeedsConfirmation {
        hash: "abc".to_owned(),
        worst_um: "120.0".to_owned(),
        worst_urad: String::new(),
        differences: Vec::new(),
    }
}

fn requested(request: UserRequest) -> Event {
    let by = "bert".to_owned();
    Event::Requested { request, by }
}

fn confirm(hash: &str) -> Event {
    requested(UserRequest::Confirm { machine: name(0), hash: hash.to_owned() })
}

fn stopped(rollout: &Rollout, words: &str) {
    let Phase::Stopped { why } = &rollout.phase else {
        panic!("{:?}", rollout.phase);
    };
    assert!(why.contains(words), "{why}");
}

fn answered(place: usize, version: u64, outcome: Outcome) -> Event {
    Event::Answered { machine: name(place), version, outcome }
}

/// Executes the issue actions, each with version 1 and a residual of 4 µm before the change.
fn issue(rollout: &mut Rollout, actions: &[Action]) -> Vec<MachineId> {
    let machines = issued(actions);
    for machine in &machines {
        let none = rollout.step(Event::Issued {
            machine: machine.clone(),
            version: 1,
            before_um: Some(4.0),
        });
        assert!(none.is_empty());
    }
    machines
}

fn step_of(rollout: &Rollout, place: usize) -> Step {
    let mut targets = rollout.targets.iter();
    targets.find(|target| target.machine == name(place)).unwrap().step.clone()
}

#[test]
fn canaries_then_waves_then_done() {
    let mut rollout = rollout(5, &[3], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions), [name(3)]);
    assert!(rollout.step(answered(3, 1, Outcome::Activated)).is_empty());
    // The soak time is two passes of ten seconds.
    assert!(rollout.step(looked(10.0, &[(3, 1, 4.0)])).is_empty());
    let actions = rollout.step(looked(10.0, &[(3, 1, 4.0)]));
    assert_eq!(issue(&mut rollout, &actions), [name(0), name(1)]);
    for place in [0, 1] {
        rollout.step(answered(place, 1, Outcome::Activated));
    }
    let both = [(0, 1, 4.0), (1, 1, 4.0)];
    assert!(rollout.step(looked(10.0, &both)).is_empty());
    let actions = rollout.step(looked(10.0, &both));
    assert_eq!(issue(&mut rollout, &actions), [name(2), name(4)]);
    // The acknowledgement was lost, but the condition reports the active version.
    let rest = [(2, 1, 4.0), (4, 1, 4.0)];
    for _ in 0..3 {
        rollout.step(looked(10.0, &rest));
    }
    assert_eq!(rollout.phase, Phase::Done);
}

#[test]
fn an_observation_gap_does_not_shorten_the_soak() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    rollout.step(answered(0, 1, Outcome::Activated));
    // The centre was down for a day, its clock jumped, or the machine was silent for an hour.
    for event in [
        looked(86_400.0, &[(0, 1, 4.0)]),
        looked(3600.0, &[]),
        looked(f64::NAN, &[(0, 1, 4.0)]),
        looked(-5.0, &[(0, 1, 4.0)]),
    ] {
        assert!(rollout.step(event).is_empty());
    }
    assert!(matches!(step_of(&rollout, 0), Step::Soaking { soaked_s, .. } if soaked_s == 10.0));
}

#[test]
fn rejection_timeout_fault_and_residual_stop_the_rollout() {
    let start = || {
        let mut rollout = rollout(4, &[0], rules());
        let actions = rollout.step(looked(1.0, &[]));
        issue(&mut rollout, &actions);
        rollout
    };
    let mut refused = start();
    let why = "its serial number".to_owned();
    assert!(refused.step(answered(0, 1, Outcome::Refused { why })).is_empty());
    stopped(&refused, "m0: it has rejected the model: its serial number");

    let mut silent = start();
    for _ in 0..6 {
        assert!(silent.step(looked(10.0, &[])).is_empty());
    }
    assert_eq!(withdrawn(&silent.step(looked(10.0, &[]))), [name(0)]);
    stopped(&silent, "no answer in time");

    let mut broken = start();
    broken.step(answered(0, 1, Outcome::Activated));
    assert!(broken.step(faulted(1, "a write did not land")).is_empty());
    stopped(&broken, "a write did not land");

    let mut risen = start();
    risen.step(answered(0, 1, Outcome::Activated));
    assert!(risen.step(looked(10.0, &[(0, 1, 6.5)])).is_empty());
    stopped(&risen, "from 4.0 µm to 6.5 µm");
    // The roll-out continues if the residual rises by 50 % only, or by 2 µm only.
    for fine_um in [6.0, 5.9] {
        let mut fine = start();
        fine.step(answered(0, 1, Outcome::Activated));
        fine.step(looked(10.0, &[(0, 1, fine_um)]));
        assert_eq!(fine.phase, Phase::Running);
    }
}

#[test]
fn confirm_pause_and_resume() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    assert!(rollout.step(answered(0, 1, needs())).is_empty());
    // The roll-out waits for the user without a timeout.
    for _ in 0..100 {
        assert!(rollout.step(looked(10.0, &[])).is_empty());
    }
    assert!(rollout.step(confirm("another")).is_empty());
    let actions = rollout.step(confirm("abc"));
    assert_eq!(actions, [Action::Issue { machine: name(0), confirm: Some("abc".to_owned()) }]);
    rollout.step(Event::Issued { machine: name(0), version: 2, before_um: Some(99.0) });
    assert_eq!(rollout.targets[0].before_um, Some(4.0));
    // A late duplicate of the first outcome.
    let why = "its version".to_owned();
    rollout.step(answered(0, 1, Outcome::Refused { why: why.clone() }));
    assert_eq!(rollout.phase, Phase::Running);
    rollout.step(requested(UserRequest::Pause));
    rollout.step(answered(0, 2, Outcome::Activated));
    for _ in 0..2 {
        assert!(rollout.step(looked(10.0, &[(0, 2, 4.0)])).is_empty());
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { version: 2 }));
    let actions = rollout.step(requested(UserRequest::Resume));
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
    rollout.step(answered(1, 1, Outcome::Refused { why }));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    rollout.step(requested(UserRequest::Resume));
    assert_eq!(rollout.phase, Phase::Done, "the dropout is excused");
}

#[test]
fn tolerated_dropouts_do_not_stop_the_rollout() {
    let mut rules = rules();
    rules.soak_s = 0.0;
    rules.waves = vec![100];
    let mut rollout = rollout(4, &[0], rules);
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    let actions = rollout.step(answered(0, 1, Outcome::Activated));
    assert_eq!(issue(&mut rollout, &actions).len(), 3);
    for place in [1, 2] {
        rollout.step(answered(place, 1, Outcome::Activated));
    }
    for _ in 0..7 {
        rollout.step(looked(10.0, &[]));
    }
    assert_eq!(rollout.phase, Phase::Done, "one may stay out");
}

#[derive(Clone, Debug)]
enum Happens {
    Look(u16, Vec<(u8, u8, u8)>),
    Answer(u8, u8, u8),
    UserRequest(u8, u8),
    Fails(u8),
}

fn happens() -> impl Strategy<Value = Happens> {
    prop_oneof![
        4 => (0_u16..20, proptest::collection::vec((any::<u8>(), 0_u8..4, any::<u8>()), 0..6))
            .prop_map(|(s, seen)| Happens::Look(s, seen)),
        4 => (any::<u8>(), 0_u8..4, any::<u8>()).prop_map(|(m, v, o)| Happens::Answer(m, v, o)),
        1 => (any::<u8>(), any::<u8>()).prop_map(|(w, m)| Happens::UserRequest(w, m)),
        1 => any::<u8>().prop_map(Happens::Fails),
    ]
}

fn event(happens: &Happens, machines: usize) -> Event {
    let machine = |place: u8| name(usize::from(place) % machines);
    match happens {
        Happens::Look(s, seen) => Event::Pass {
            elapsed_s: f64::from(*s),
            seen: (seen.iter())
                .map(|(place, version, odd)| {
                    let seen = Observation {
                        reachable: odd % 8 > 0,
                        version: u64::from(*version),
                        corrects: odd % 5 > 0,
                        faulted: (odd % 16 == 9).then(|| "fault".to_owned()),
                        residual_um: (odd % 4 > 0).then(|| f64::from(*odd) / 10.0),
                        ..Observation::default()
                    };
                    (machine(*place), seen)
                })
                .collect(),
        },
        Happens::Answer(place, version, odd) => Event::Answered {
            machine: machine(*place),
            version: u64::from(*version),
            outcome: match odd % 4 {
                0 => Outcome::Refused { why: "no".to_owned() },
                1 => Outcome::NeedsConfirmation {
                    hash: "h".to_owned(),
                    worst_um: String::new(),
                    worst_urad: String::new(),
                    differences: Vec::new(),
                },
                _ => Outcome::Activated,
            },
        },
        Happens::UserRequest(request, place) => Event::Requested {
            request: match request % 8 {
                0 => UserRequest::Pause,
                1 => UserRequest::Abort,
                2..5 => UserRequest::Resume,
                _ => UserRequest::Confirm { machine: machine(*place), hash: "h".to_owned() },
            },
            by: "bert".to_owned(),
        },
        Happens::Fails(place) => {
            Event::NotIssued { machine: machine(*place), why: "no such model".to_owned() }
        }
    }
}

proptest! {
    #[test]
    fn invariants_hold_for_any_event_sequence(
        machines in 1_usize..8,
        canaries in proptest::collection::vec(0_usize..8, 0..3),
        waves in proptest::collection::vec(1_u32..=100, 0..4),
        tolerate in 0_u32..3,
        soak_s in prop_oneof![Just(0.0), Just(15.0)],
        story in proptest::collection::vec(happens(), 0..120),
    ) {
        let mut waves = waves;
        waves.sort_unstable();
        let mut rollout = rollout(machines, &canaries, Rules { waves, tolerate, soak_s, ..rules() });
        let mut sent: BTreeSet<MachineId> = BTreeSet::new();
        let mut version = 0;
        for happens in &story {
            let before = rollout.clone();
            // A restarted centre continues from the stored state.
            let text = serde_json::to_string(&rollout).unwrap();
            rollout = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(&rollout.phase, &before.phase);
            for (one, other) in rollout.targets.iter().zip(&before.targets) {
                let same = std::mem::discriminant(&one.step) == std::mem::discriminant(&other.step);
                prop_assert!(same && one.machine == other.machine && one.wave == other.wave);
            }
            let actions = rollout.step(event(happens, machines));
            for action in actions {
                let (machine, confirm) = match action {
                    Action::Issue { machine, confirm } => (machine, confirm),
                    // Only sent versions are withdrawn, when the roll-out stops or is aborted.
                    Action::Withdraw { machine } => {
                        prop_assert!(rollout.phase.is_broken_off());
                        prop_assert!(rollout.phase.is_over() || !before.phase.is_broken_off());
                        prop_assert!(sent.contains(&machine));
                        let mut targets = rollout.targets.iter();
                        let target = targets.find(|target| target.machine == machine).unwrap();
                        let has_it = matches!(target.step, Step::Sent { .. } | Step::Done { .. });
                        prop_assert!(!has_it, "{:?}", target);
                        if target.step == Step::Waiting {
                            sent.remove(&machine);
                        }
                        continue;
                    }
                };
                prop_assert!(!rollout.phase.is_over());
                let target = rollout.targets.iter().find(|target| target.machine == machine).unwrap();
                if confirm.is_none() {
                    prop_assert_eq!(&rollout.phase, &Phase::Running);
                    prop_assert!(sent.insert(machine.clone()), "{} twice", machine);
                    // A version is sent only after all machines of earlier waves are done or have dropped out.
                    for other in rollout.targets.iter().filter(|other| other.wave < target.wave) {
                        let over = matches!(other.step, Step::Done { .. } | Step::Out { .. });
                        prop_assert!(over, "{:?} before {:?}", target, other);
                        // The user excused a canary that dropped out.
                        if let Step::Out { excused, .. } = other.step {
                            prop_assert!(excused || other.wave > 0);
                        }
                    }
                    // No machine on which the model failed is ignored, and the number of dropouts is within the limit.
                    let out: Vec<bool> = rollout.targets.iter().filter_map(|target| match target.step {
                        Step::Out { against, excused: false, .. } => Some(against),
                        _ => None,
                    }).collect();
                    prop_assert!(!out.contains(&true));
                    prop_assert!(out.len() <= tolerate as usize);
                } else {
                    prop_assert!(sent.contains(&machine), "only what was sent is confirmed");
                }
                version += 1;
                rollout.step(Event::Issued { machine, version: version.min(3), before_um: Some(4.0) });
            }
            if before.phase.is_over() {
                prop_assert_eq!(&rollout.phase, &before.phase, "what is over stays as it is");
            }
            if rollout.phase == Phase::Done {
                let all = rollout.targets.iter().all(|target| matches!(target.step, Step::Done { .. } | Step::Out { .. }));
                prop_assert!(all);
            }
        }
        let names: BTreeSet<&MachineId> = rollout.targets.iter().map(|target| &target.machine).collect();
        prop_assert_eq!(names.len(), machines);
        prop_assert!(rollout.targets.iter().any(|target| target.wave == 0));
    }
}

/// A roll-out to two machines whose canary, m0, has activated version 1.
fn with_a_canary_that_has_it() -> Rollout {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    rollout.step(answered(0, 1, Outcome::Activated));
    rollout
}

/// docs/src/fleet.md: the roll-out stops when "the guard of a machine that has it faults". This includes the canary after its soak time.
#[test]
fn a_canary_fault_after_its_soak_stops_the_rollout() {
    let mut rollout = with_a_canary_that_has_it();
    let mut actions = Vec::new();
    for _ in 0..2 {
        actions = rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { .. }));
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
    // A fault under another active version is not caused by the model.
    rollout.step(faulted(0, "thermal runaway"));
    assert_eq!(rollout.phase, Phase::Running);
    rollout.step(faulted(1, "thermal runaway"));
    stopped(&rollout, "m0: its guard has faulted: thermal runaway");
}

/// A machine that reports an older active version (restored folder, replaced gateway) does not soak. It drops out at
/// the answer timeout.
#[test]
fn a_machine_with_another_version_does_not_soak() {
    let mut rollout = with_a_canary_that_has_it();
    for _ in 0..6 {
        rollout.step(looked(10.0, &[(0, 0, 4.0)]));
        assert!(matches!(step_of(&rollout, 0), Step::Soaking { soaked_s, .. } if soaked_s == 0.0));
    }
    // At the answer timeout the canary drops out, which stops the roll-out.
    rollout.step(looked(10.0, &[(0, 0, 4.0)]));
    stopped(&rollout, "m0: its model is not active any more");
    // The condition with the new version may arrive after the acknowledgement.
    let mut rollout = with_a_canary_that_has_it();
    rollout.step(looked(10.0, &[(0, 0, 4.0)]));
    for _ in 0..2 {
        rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { .. }));
}

/// A stop withdraws versions that were sent but are not active; a resume sends them again. A machine that did not answer in time stays
/// out, and its key keeps the previous model.
#[test]
fn inactive_versions_are_withdrawn_when_the_rollout_stops() {
    let mut rollout = rollout(4, &[0, 1, 2], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions).len(), 3);
    rollout.step(answered(0, 1, Outcome::Activated));
    rollout.step(answered(1, 1, needs()));
    // The first machine has activated the version, the second waits for confirmation, and the third was offline.
    let actions = rollout.step(looked(10.0, &[(0, 1, 40.0)]));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert_eq!(withdrawn(&actions), [name(2)]);
    assert_eq!(step_of(&rollout, 2), Step::Waiting);
    assert!(rollout.step(looked(10.0, &[])).is_empty(), "once");
    let mut ended = rollout.clone();
    let actions = ended.step(requested(UserRequest::Abort));
    // The first machine dropped out because of its residual. Its outcome shows whether the version is active.
    assert_eq!(withdrawn(&actions), [name(0), name(1)]);
    let actions = rollout.step(requested(UserRequest::Resume));
    assert_eq!(issue(&mut rollout, &actions), [name(2)]);
    let mut last = Vec::new();
    for _ in 0..7 {
        last = rollout.step(looked(10.0, &[]));
    }
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert_eq!(withdrawn(&last), [name(2)]);
    let actions = rollout.step(requested(UserRequest::Resume));
    assert!(actions.is_empty(), "it stays out: {actions:?}");
    assert!(rollout.step(looked(10.0, &[(2, 1, 4.0)])).is_empty());
    assert!(matches!(step_of(&rollout, 2), Step::Out { version: None, .. }));
}

/// A stopped roll-out ignores confirmations. A paused or resumed roll-out sends the confirmed changes. A resume resets
/// decisions to keep the model.
#[test]
fn a_stopped_rollout_ignores_confirmations() {
    let mut rollout = rollout(2, &[0, 1], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions).len(), 2);
    rollout.step(answered(0, 1, needs()));
    let confirm = || confirm("abc");
    let sent = [Action::Issue { machine: name(0), confirm: Some("abc".to_owned()) }];
    let mut held = rollout.clone();
    held.step(requested(UserRequest::Pause));
    assert_eq!(held.step(confirm()), sent);
    let why = "its axes".to_owned();
    rollout.step(answered(1, 1, Outcome::Refused { why }));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert!(rollout.step(confirm()).is_empty());
    rollout.targets[0].kept_by = Some("anna".to_owned());
    rollout.step(requested(UserRequest::Resume));
    assert_eq!(rollout.targets[0].kept_by, None);
    assert_eq!(rollout.step(confirm()), sent);
}
