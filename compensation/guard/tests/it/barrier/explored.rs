//! Every world within bounds: two senders that may die and start again at any scan, read and send at any scan (also long
//! after they read), frames that are lost, late, doubled and reordered, power-ups at any scan. The barrier and the senders are
//! the real ones. What is equal up to the numbers that counters happen to have is visited once.
//!
//! Taking away one of the three things that make a frame belong to now (owner, age, epoch kept over power-off) has to be found.

use std::collections::{HashSet, VecDeque};

use volcomp_guard::barrier::{
    Answered, Barrier, Counts, Frame, Memory, Refusal, Report, Seen, Session, Settings,
};
use volcomp_guard::vocabulary::PerChannel;

use super::words;

/// What the channel holds of a frame, and what only an observer knows of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
struct Flying {
    frame: Frame,
    /// Scans since the report that it answers was published, up to a bound.
    age: u8,
    /// The control has started anew or timed out since.
    stale: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Sender {
    session: Session,
    /// As of [`Flying`], of the report that it read last; `None`: none that it may answer.
    knows: Option<(u8, bool)>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct World {
    barrier: Memory,
    /// The first sender of which a frame was taken in this epoch; 0: none.
    first: u16,
    senders: [Option<Sender>; 2],
    air: Vec<Flying>,
    mailbox: Option<Flying>,
}

/// What is left out of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Without {
    Nothing,
    Owner,
    Age,
    KeptEpoch,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Violation {
    /// A frame from before a power-up or time-out was taken.
    Stale,
    /// A frame was taken that answers a report older than the bound.
    Old,
    /// Frames of two senders were taken in one epoch.
    TwoOwners,
    /// An axis moved by more than its rate, or stands beyond its limit.
    Step,
}

struct Bounds {
    settings: Settings,
    /// Frames in the channel at once.
    air: usize,
    without: Without,
    most_worlds: usize,
}

/// One of the things that a sender does between two scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Does {
    Nothing,
    Dies,
    Starts,
    Reads,
    Sends,
    ReadsAndSends,
}

/// What each sender wants, counts.
const WANTS: [i16; 2] = [2, -2];

fn explore(bounds: &Bounds) -> (usize, bool, Vec<Violation>) {
    let settings = bounds.settings;
    let begin = World {
        barrier: Barrier::start(settings, 0, 0, &Counts::default())
            .expect("settings that make sense")
            .memory(),
        first: 0,
        senders: [None; 2],
        air: Vec::new(),
        mailbox: None,
    };
    let begin = canonical(begin, &settings);
    let mut seen = HashSet::from([begin.clone()]);
    let mut queue = VecDeque::from([begin]);
    let mut found = HashSet::new();
    let mut complete = true;
    while let Some(world) = queue.pop_front() {
        successors(&world, bounds, &mut |next, violation| {
            found.extend(violation);
            let next = canonical(next, &settings);
            if !seen.contains(&next) {
                seen.insert(next.clone());
                queue.push_back(next);
            }
        });
        if seen.len() > bounds.most_worlds {
            complete = false;
            break;
        }
        if bounds.without != Without::Nothing && !found.is_empty() {
            break;
        }
    }
    let mut found: Vec<_> = found.into_iter().collect();
    found.sort_unstable();
    (seen.len(), complete, found)
}

fn successors(world: &World, bounds: &Bounds, tell: &mut impl FnMut(World, Option<Violation>)) {
    use Does::{Dies, Nothing, Reads, ReadsAndSends, Sends, Starts};
    let choices = |place: usize| match &world.senders[place] {
        None => &[Nothing, Starts][..],
        Some(Sender { knows: None, .. }) => &[Nothing, Dies, Reads, ReadsAndSends][..],
        Some(_) => &[Nothing, Dies, Reads, Sends, ReadsAndSends][..],
    };
    for one in choices(0) {
        for two in choices(1) {
            for power_up in [None, Some(0), Some(-1_i16), Some(9)] {
                let mut next = world.clone();
                if let Some(tick) = power_up {
                    start_anew(&mut next, tick, bounds);
                }
                act(&mut next, 0, *one, bounds);
                act(&mut next, 1, *two, bounds);
                next.air.sort_unstable();
                next.air.dedup();
                if next.air.len() > bounds.air {
                    continue;
                }
                deliver(&next, bounds, tell);
            }
        }
    }
}

/// The control starts anew; the tick that it begins with may be any: that which makes frames look young is the worst.
fn start_anew(world: &mut World, tick: i16, bounds: &Bounds) {
    let before = world.barrier;
    let kept = match bounds.without {
        Without::KeptEpoch => before.epoch.wrapping_sub(1),
        _ => before.epoch,
    };
    let tick = before.tick.wrapping_add_signed(tick);
    world.barrier = Barrier::start(bounds.settings, kept, tick, &before.applied)
        .expect("settings that make sense")
        .memory();
    epoch_began(world);
}

fn epoch_began(world: &mut World) {
    world.first = 0;
    for flying in world.air.iter_mut().chain(&mut world.mailbox) {
        flying.stale = true;
    }
    for (_, stale) in world
        .senders
        .iter_mut()
        .flatten()
        .filter_map(|s| s.knows.as_mut())
    {
        *stale = true;
    }
}

fn act(world: &mut World, place: usize, does: Does, bounds: &Bounds) {
    let owners = owners(world);
    let sender = &mut world.senders[place];
    match does {
        Does::Nothing => {}
        Does::Dies => *sender = None,
        Does::Starts => {
            let drawn = (1..u16::MAX)
                .find(|n| !owners.contains(n))
                .expect("few are in use");
            *sender = Some(Sender {
                session: Session::new(drawn),
                knows: None,
            });
        }
        Does::Reads | Does::Sends | Does::ReadsAndSends => {
            let Some(sender) = sender else { return };
            if does != Does::Sends {
                let report = Barrier::resume(bounds.settings, world.barrier)
                    .expect("settings that make sense")
                    .report();
                let report = Report {
                    owner: if bounds.without == Without::Owner {
                        0
                    } else {
                        report.owner
                    },
                    ..report
                };
                match sender.session.read(&report) {
                    Seen::Confirmed { .. } => sender.knows = Some((0, false)),
                    Seen::Held { .. } => sender.knows = None,
                    Seen::Old => {}
                }
            }
            if does != Does::Reads
                && let Some((age, stale)) = sender.knows
            {
                let values = PerChannel::leading([WANTS[place]]);
                if let Some(frame) = sender.session.frame(&values) {
                    world.air.push(Flying { frame, age, stale });
                }
            }
        }
    }
}

fn owners(world: &World) -> HashSet<u16> {
    let flying = world
        .air
        .iter()
        .chain(&world.mailbox)
        .map(|f| f.frame.owner);
    let senders = world.senders.iter().flatten().map(|s| s.session.owner);
    flying
        .chain(senders)
        .chain([world.barrier.owner, world.first])
        .collect()
}

/// At most one frame reaches the mailbox, and stays in the channel or not; or one is lost.
fn deliver(world: &World, bounds: &Bounds, tell: &mut impl FnMut(World, Option<Violation>)) {
    scan(world.clone(), bounds, tell);
    for at in 0..world.air.len() {
        let mut next = world.clone();
        next.mailbox = Some(next.air[at]);
        scan(next.clone(), bounds, tell);
        next.air.remove(at);
        scan(next.clone(), bounds, tell);
        next.mailbox = world.mailbox;
        scan(next, bounds, tell);
    }
}

fn scan(mut world: World, bounds: &Bounds, tell: &mut impl FnMut(World, Option<Violation>)) {
    let settings = &bounds.settings;
    let mut before = world.barrier;
    if bounds.without == Without::Owner {
        before.owner = 0;
    }
    let mut barrier = Barrier::resume(*settings, before).expect("settings that make sense");
    let held = world.mailbox.map(|flying| {
        let tick = before.tick.wrapping_add(1);
        let frame = match bounds.without {
            Without::Age => Frame {
                tick,
                ..flying.frame
            },
            _ => flying.frame,
        };
        words(settings, &frame)
    });
    match &held {
        Some(words) => barrier.scan(&[words], false),
        None => barrier.scan(&[], false),
    };
    let after = barrier.memory();
    let mut violation = None;
    for (axis, limit) in settings.limit.iter().enumerate().take(settings.axes) {
        let moved = (after.applied[axis] - before.applied[axis]).abs();
        if moved > settings.rate[axis] || after.applied[axis].abs() > *limit {
            violation = Some(Violation::Step);
        }
    }
    if after.silent == 0
        && let Some(taken) = world.mailbox
    {
        let owner = taken.frame.owner;
        if taken.stale {
            violation = Some(Violation::Stale);
        } else if u16::from(taken.age) > settings.hold_scans {
            violation = Some(Violation::Old);
        } else if world.first != 0 && world.first != owner {
            violation = Some(Violation::TwoOwners);
        }
        world.first = owner;
    }
    world.barrier = after;
    if after.epoch != before.epoch {
        epoch_began(&mut world);
    }
    for flying in world.air.iter_mut().chain(&mut world.mailbox) {
        flying.age = flying.age.saturating_add(1);
    }
    for (age, _) in world
        .senders
        .iter_mut()
        .flatten()
        .filter_map(|s| s.knows.as_mut())
    {
        *age = age.saturating_add(1);
    }
    tell(world, violation);
}

/// The same world with other numbers on its counters: relative to the barrier's, and cut off where they make no difference.
fn canonical(mut world: World, settings: &Settings) -> World {
    let Memory {
        epoch,
        tick,
        sequence,
        ..
    } = world.barrier;
    let oldest = settings.hold_scans.cast_signed() + 2;
    let epochs = |e: u16| if e == epoch { 100 } else { 99 };
    let ticks = |t: u16| {
        let age = tick.wrapping_sub(t).cast_signed();
        1000_u16.wrapping_add_signed(-age.clamp(-12, oldest))
    };
    let sequences = |s: u16| {
        let ahead = s.wrapping_sub(sequence).cast_signed();
        1000_u16.wrapping_add_signed(ahead.clamp(-3, 3))
    };
    let bound = u8::try_from(oldest).expect("small bounds");
    for flying in world.air.iter_mut().chain(&mut world.mailbox) {
        let frame = &mut flying.frame;
        frame.epoch = epochs(frame.epoch);
        frame.tick = ticks(frame.tick);
        frame.sequence = sequences(frame.sequence);
        flying.age = flying.age.min(bound);
    }
    for sender in world.senders.iter_mut().flatten() {
        sender.session.sent = None;
        if let Some((age, _)) = &mut sender.knows {
            *age = (*age).min(bound);
        }
        sender.session.last = sender.session.last.map(|last| Answered {
            epoch: epochs(last.epoch),
            tick: ticks(last.tick),
            sequence: sequences(last.sequence),
        });
    }
    let barrier = &mut world.barrier;
    (barrier.epoch, barrier.tick, barrier.sequence) = (100, 1000, 1000);
    barrier.refusal = Refusal::None;
    if barrier.done >= barrier.steps {
        (barrier.from, barrier.steps, barrier.done) = (barrier.applied, 0, 0);
    }
    renumber_owners(&mut world);
    world.air.sort_unstable();
    world.air.dedup();
    world
}

/// Owners are names: in the order in which they are met.
fn renumber_owners(world: &mut World) {
    let mut met = vec![0];
    let mut rename = |owner: &mut u16| {
        let place = met.iter().position(|m| m == owner).unwrap_or_else(|| {
            met.push(*owner);
            met.len() - 1
        });
        *owner = u16::try_from(place).expect("few owners");
    };
    rename(&mut world.barrier.owner);
    rename(&mut world.first);
    for sender in world.senders.iter_mut().flatten() {
        rename(&mut sender.session.owner);
    }
    if let Some(flying) = &mut world.mailbox {
        rename(&mut flying.frame.owner);
    }
    // Sorted by what is no name, so that the names do not depend on the names before.
    world.air.sort_by_key(|f| {
        (
            f.age,
            f.stale,
            Frame {
                owner: 0,
                ..f.frame
            },
        )
    });
    for flying in &mut world.air {
        rename(&mut flying.frame.owner);
    }
}

fn small(hold_scans: u16, time_out_scans: u16) -> Settings {
    Settings {
        axes: 1,
        machine: 4711,
        limit: PerChannel::leading([2]),
        rate: PerChannel::leading([1]),
        step_scans: 1,
        hold_scans,
        time_out_scans,
    }
}

#[test]
fn no_world_within_bounds_takes_a_stale_or_foreign_frame() {
    let bounds = Bounds {
        settings: small(1, 2),
        air: 1,
        without: Without::Nothing,
        most_worlds: 3_000_000,
    };
    let (worlds, complete, found) = explore(&bounds);
    eprintln!("{worlds} worlds");
    assert_eq!(found, []);
    assert!(complete, "bound of worlds reached");
}

#[test]
fn each_part_of_the_protocol_is_needed() {
    for (without, expected) in [
        (Without::Owner, Violation::TwoOwners),
        (Without::Age, Violation::Old),
        (Without::KeptEpoch, Violation::Stale),
    ] {
        let bounds = Bounds {
            settings: small(1, 2),
            air: 1,
            without,
            most_worlds: 1_000_000,
        };
        let (worlds, _, found) = explore(&bounds);
        assert!(
            found.contains(&expected),
            "{without:?}: {found:?} in {worlds} worlds"
        );
    }
}
