//! The state machine of roll-outs: what it does in the plain case, and what it never does whatever happens.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use volcomp_centre::rollout::{Action, Event, Observation, Phase, Rollout, Rules, Step, Wish};
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
    let machines: Vec<(MachineId, bool)> = (0..machines)
        .map(|place| (name(place), canaries.contains(&place)))
        .collect();
    Rollout::new(1, "model", &machines, rules, "anna", 0.0)
}

fn issued(actions: &[Action]) -> Vec<MachineId> {
    let machines = actions.iter().filter_map(|action| match action {
        Action::Issue { machine, .. } => Some(machine.clone()),
        Action::Withdraw { .. } => None,
    });
    machines.collect()
}

/// What is taken back.
fn withdrawn(actions: &[Action]) -> Vec<MachineId> {
    let machines = actions.iter().filter_map(|action| match action {
        Action::Withdraw { machine } => Some(machine.clone()),
        Action::Issue { .. } => None,
    });
    machines.collect()
}

/// Looks, with these residuals of machines that run a version.
fn looked(elapsed_s: f64, seen: &[(usize, u64, f64)]) -> Event {
    let seen = seen.iter().map(|(place, version, residual)| {
        let seen = Observation {
            heard: true,
            version: *version,
            corrects: true,
            faulted: None,
            residual_um: Some(*residual),
        };
        (name(*place), seen)
    });
    Event::Looked {
        elapsed_s,
        seen: seen.collect(),
    }
}

/// A machine that runs the model and does not correct shows nothing of it: its soak stands still.
#[test]
fn a_machine_that_is_disarmed_is_not_watched() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions), [name(0)]);
    rollout.step(answered(0, 1, Outcome::Activated));
    for _ in 0..100 {
        let disarmed = Observation {
            heard: true,
            version: 1,
            residual_um: Some(90.0),
            ..Observation::default()
        };
        let event = Event::Looked {
            elapsed_s: 10.0,
            seen: BTreeMap::from([(name(0), disarmed)]),
        };
        assert_eq!(rollout.step(event), []);
        // An older version for a moment, which does not add up over moments.
        assert_eq!(rollout.step(looked(10.0, &[(0, 0, 4.0)])), []);
    }
    assert_eq!(rollout.phase, Phase::Running);
    let mut actions = Vec::new();
    for _ in 0..2 {
        actions = rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
}

/// A look at the first machine, whose guard has faulted.
fn faulted(version: u64, why: &str) -> Event {
    let seen = Observation {
        heard: true,
        version,
        faulted: Some(why.to_owned()),
        ..Observation::default()
    };
    Event::Looked {
        elapsed_s: 1.0,
        seen: BTreeMap::from([(name(0), seen)]),
    }
}

fn needs() -> Outcome {
    Outcome::NeedsConfirmation {
        hash: "abc".to_owned(),
        worst_um: "120.0".to_owned(),
        worst_urad: String::new(),
    }
}

fn wished(wish: Wish) -> Event {
    let by = "bert".to_owned();
    Event::Wished { wish, by }
}

fn confirm(hash: &str) -> Event {
    wished(Wish::Confirm {
        machine: name(0),
        hash: hash.to_owned(),
    })
}

fn stopped(rollout: &Rollout, words: &str) {
    let Phase::Stopped { why } = &rollout.phase else {
        panic!("{:?}", rollout.phase);
    };
    assert!(why.contains(words), "{why}");
}

fn answered(place: usize, version: u64, outcome: Outcome) -> Event {
    Event::Answered {
        machine: name(place),
        version,
        outcome,
    }
}

/// Issues what is asked, each machine with version 1 and a residual of 4 µm before.
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
    targets
        .find(|target| target.machine == name(place))
        .unwrap()
        .step
        .clone()
}

#[test]
fn canaries_then_waves_then_done() {
    let mut rollout = rollout(5, &[3], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions), [name(3)]);
    assert!(rollout.step(answered(3, 1, Outcome::Activated)).is_empty());
    // The soak: two looks of ten seconds.
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
    // An acknowledgement that was lost: the condition tells the version that is in force.
    let rest = [(2, 1, 4.0), (4, 1, 4.0)];
    for _ in 0..3 {
        rollout.step(looked(10.0, &rest));
    }
    assert_eq!(rollout.phase, Phase::Done);
}

#[test]
fn a_gap_in_the_watching_shortens_no_soak() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    rollout.step(answered(0, 1, Outcome::Activated));
    // The centre was away for a day, or its clock jumped; the machine was silent for an hour.
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
fn it_stops_for_what_speaks_against_the_model() {
    let start = || {
        let mut rollout = rollout(4, &[0], rules());
        let actions = rollout.step(looked(1.0, &[]));
        issue(&mut rollout, &actions);
        rollout
    };
    let mut refused = start();
    let why = "its serial number".to_owned();
    assert!(
        refused
            .step(answered(0, 1, Outcome::Refused { why }))
            .is_empty()
    );
    stopped(&refused, "m0: it has refused it: its serial number");

    let mut silent = start();
    for _ in 0..6 {
        assert!(silent.step(looked(10.0, &[])).is_empty());
    }
    assert_eq!(withdrawn(&silent.step(looked(10.0, &[]))), [name(0)]);
    stopped(&silent, "it has not answered");

    let mut broken = start();
    broken.step(answered(0, 1, Outcome::Activated));
    assert!(broken.step(faulted(1, "a write did not land")).is_empty());
    stopped(&broken, "a write did not land");

    let mut risen = start();
    risen.step(answered(0, 1, Outcome::Activated));
    assert!(risen.step(looked(10.0, &[(0, 1, 6.5)])).is_empty());
    stopped(&risen, "from 4.0 µm to 6.5 µm");
    // Half as much again, and 2 µm: either alone is not enough.
    for fine_um in [6.0, 5.9] {
        let mut fine = start();
        fine.step(answered(0, 1, Outcome::Activated));
        fine.step(looked(10.0, &[(0, 1, fine_um)]));
        assert_eq!(fine.phase, Phase::Running);
    }
}

#[test]
fn a_person_confirms_holds_and_lets_go_on() {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    assert!(rollout.step(answered(0, 1, needs())).is_empty());
    // It waits for the person, however long.
    for _ in 0..100 {
        assert!(rollout.step(looked(10.0, &[])).is_empty());
    }
    assert!(rollout.step(confirm("another")).is_empty());
    let actions = rollout.step(confirm("abc"));
    assert_eq!(
        actions,
        [Action::Issue {
            machine: name(0),
            confirm: Some("abc".to_owned())
        }]
    );
    rollout.step(Event::Issued {
        machine: name(0),
        version: 2,
        before_um: Some(99.0),
    });
    assert_eq!(rollout.targets[0].before_um, Some(4.0));
    // The answer to the first version comes again, late.
    let why = "its version".to_owned();
    rollout.step(answered(0, 1, Outcome::Refused { why: why.clone() }));
    assert_eq!(rollout.phase, Phase::Running);
    rollout.step(wished(Wish::Pause));
    rollout.step(answered(0, 2, Outcome::Activated));
    for _ in 0..2 {
        assert!(rollout.step(looked(10.0, &[(0, 2, 4.0)])).is_empty());
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { version: 2 }));
    let actions = rollout.step(wished(Wish::Resume));
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
    rollout.step(answered(1, 1, Outcome::Refused { why }));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    rollout.step(wished(Wish::Resume));
    assert_eq!(rollout.phase, Phase::Done, "the one that is out is let go");
}

#[test]
fn some_may_stay_out_behind_the_canaries() {
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
    Wish(u8, u8),
    Fails(u8),
}

fn happens() -> impl Strategy<Value = Happens> {
    prop_oneof![
        4 => (0_u16..20, proptest::collection::vec((any::<u8>(), 0_u8..4, any::<u8>()), 0..6))
            .prop_map(|(s, seen)| Happens::Look(s, seen)),
        4 => (any::<u8>(), 0_u8..4, any::<u8>()).prop_map(|(m, v, o)| Happens::Answer(m, v, o)),
        1 => (any::<u8>(), any::<u8>()).prop_map(|(w, m)| Happens::Wish(w, m)),
        1 => any::<u8>().prop_map(Happens::Fails),
    ]
}

fn event(happens: &Happens, machines: usize) -> Event {
    let machine = |place: u8| name(usize::from(place) % machines);
    match happens {
        Happens::Look(s, seen) => Event::Looked {
            elapsed_s: f64::from(*s),
            seen: (seen.iter())
                .map(|(place, version, odd)| {
                    let seen = Observation {
                        heard: odd % 8 > 0,
                        version: u64::from(*version),
                        corrects: odd % 5 > 0,
                        faulted: (odd % 16 == 9).then(|| "fault".to_owned()),
                        residual_um: (odd % 4 > 0).then(|| f64::from(*odd) / 10.0),
                    };
                    (machine(*place), seen)
                })
                .collect(),
        },
        Happens::Answer(place, version, odd) => Event::Answered {
            machine: machine(*place),
            version: u64::from(*version),
            outcome: match odd % 4 {
                0 => Outcome::Refused {
                    why: "no".to_owned(),
                },
                1 => Outcome::NeedsConfirmation {
                    hash: "h".to_owned(),
                    worst_um: String::new(),
                    worst_urad: String::new(),
                },
                _ => Outcome::Activated,
            },
        },
        Happens::Wish(wish, place) => Event::Wished {
            wish: match wish % 8 {
                0 => Wish::Pause,
                1 => Wish::Abort,
                2..5 => Wish::Resume,
                _ => Wish::Confirm {
                    machine: machine(*place),
                    hash: "h".to_owned(),
                },
            },
            by: "bert".to_owned(),
        },
        Happens::Fails(place) => Event::NotIssued {
            machine: machine(*place),
            why: "no such model".to_owned(),
        },
    }
}

proptest! {
    /// Whatever happens, in whatever order, with restarts between any two events.
    #[test]
    fn whatever_happens(
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
            // A centre that is started again goes on from what it has stored.
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
                    // Only what was sent is taken back, and only when it is broken off.
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
                    // Never while it is held or has stopped, and never twice.
                    prop_assert_eq!(&rollout.phase, &Phase::Running);
                    prop_assert!(sent.insert(machine.clone()), "{} twice", machine);
                    // Never before everything of the waves before is over.
                    for other in rollout.targets.iter().filter(|other| other.wave < target.wave) {
                        let over = matches!(other.step, Step::Done { .. } | Step::Out { .. });
                        prop_assert!(over, "{:?} before {:?}", target, other);
                        // A canary that is out was let go by a person.
                        if let Step::Out { excused, .. } = other.step {
                            prop_assert!(excused || other.wave > 0);
                        }
                    }
                    // Nothing that speaks against the model is passed over, nor more silent ones than may be.
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
        // Every machine is in it once.
        let names: BTreeSet<&MachineId> = rollout.targets.iter().map(|target| &target.machine).collect();
        prop_assert_eq!(names.len(), machines);
        prop_assert!(rollout.targets.iter().any(|target| target.wave == 0));
    }
}

/// A roll-out to two machines whose canary, m0, has version 1 in force.
fn with_a_canary_that_has_it() -> Rollout {
    let mut rollout = rollout(2, &[0], rules());
    let actions = rollout.step(looked(1.0, &[]));
    issue(&mut rollout, &actions);
    rollout.step(answered(0, 1, Outcome::Activated));
    rollout
}

/// docs/src/fleet.md: it stops by itself when "the guard of a machine that has it faults". The canary has it after its soak, too.
#[test]
fn a_canary_that_faults_after_its_soak_stops_the_roll_out() {
    let mut rollout = with_a_canary_that_has_it();
    let mut actions = Vec::new();
    for _ in 0..2 {
        actions = rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { .. }));
    assert_eq!(issue(&mut rollout, &actions), [name(1)]);
    // With another version it is not the model's.
    rollout.step(faulted(0, "thermal runaway"));
    assert_eq!(rollout.phase, Phase::Running);
    rollout.step(faulted(1, "thermal runaway"));
    stopped(&rollout, "m0: its guard has faulted: thermal runaway");
}

/// A machine that tells that an older version is in force (its folder was restored, its gateway exchanged) is not watched with
/// the model, and it stays out where it goes on so.
#[test]
fn a_machine_that_runs_another_version_is_not_soaked() {
    let mut rollout = with_a_canary_that_has_it();
    for _ in 0..6 {
        rollout.step(looked(10.0, &[(0, 0, 4.0)]));
        assert!(matches!(step_of(&rollout, 0), Step::Soaking { soaked_s, .. } if soaked_s == 0.0));
    }
    // It has been told for an answer's time: a canary that stays out stops it.
    rollout.step(looked(10.0, &[(0, 0, 4.0)]));
    stopped(&rollout, "m0: it has version 0 in force again");
    // The condition with the version may come after the answer.
    let mut rollout = with_a_canary_that_has_it();
    rollout.step(looked(10.0, &[(0, 0, 4.0)]));
    for _ in 0..2 {
        rollout.step(looked(10.0, &[(0, 1, 4.0)]));
    }
    assert!(matches!(step_of(&rollout, 0), Step::Done { .. }));
}

/// What was sent and is not in force when a roll-out stops is taken back, and sent again when a person lets it go on. One that
/// has not answered in time stays out: its model of before stands under its key.
#[test]
fn what_is_not_in_force_is_taken_back_when_it_stops() {
    let mut rollout = rollout(4, &[0, 1, 2], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions).len(), 3);
    rollout.step(answered(0, 1, Outcome::Activated));
    rollout.step(answered(1, 1, needs()));
    // The first has it, the second waits for a person, the third was away.
    let actions = rollout.step(looked(10.0, &[(0, 1, 40.0)]));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert_eq!(withdrawn(&actions), [name(2)]);
    assert_eq!(step_of(&rollout, 2), Step::Waiting);
    assert!(rollout.step(looked(10.0, &[])).is_empty(), "once");
    let mut ended = rollout.clone();
    let actions = ended.step(wished(Wish::Abort));
    // The first is out for its residual: whether it has it in force is seen by its answer.
    assert_eq!(withdrawn(&actions), [name(0), name(1)]);
    let actions = rollout.step(wished(Wish::Resume));
    assert_eq!(issue(&mut rollout, &actions), [name(2)]);
    let mut last = Vec::new();
    for _ in 0..7 {
        last = rollout.step(looked(10.0, &[]));
    }
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert_eq!(withdrawn(&last), [name(2)]);
    let actions = rollout.step(wished(Wish::Resume));
    assert!(actions.is_empty(), "it stays out: {actions:?}");
    assert!(rollout.step(looked(10.0, &[(2, 1, 4.0)])).is_empty());
    assert!(matches!(
        step_of(&rollout, 2),
        Step::Out { version: None, .. }
    ));
}

/// A roll-out that has stopped sends nothing, although a person confirms a change; held, or let go on, it does. What a person
/// has kept is to be decided anew when it goes on.
#[test]
fn a_stopped_roll_out_takes_no_confirmation() {
    let mut rollout = rollout(2, &[0, 1], rules());
    let actions = rollout.step(looked(1.0, &[]));
    assert_eq!(issue(&mut rollout, &actions).len(), 2);
    rollout.step(answered(0, 1, needs()));
    let confirm = || confirm("abc");
    let sent = [Action::Issue {
        machine: name(0),
        confirm: Some("abc".to_owned()),
    }];
    let mut held = rollout.clone();
    held.step(wished(Wish::Pause));
    assert_eq!(held.step(confirm()), sent);
    let why = "its axes".to_owned();
    rollout.step(answered(1, 1, Outcome::Refused { why }));
    assert!(matches!(rollout.phase, Phase::Stopped { .. }));
    assert!(rollout.step(confirm()).is_empty());
    rollout.targets[0].kept_by = Some("anna".to_owned());
    rollout.step(wished(Wish::Resume));
    assert_eq!(rollout.targets[0].kept_by, None);
    assert_eq!(rollout.step(confirm()), sent);
}
