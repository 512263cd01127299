//! Exhaustive search, within bounds, for violations of the protocol between the real barrier and its senders.
//!
//! Two senders may crash, restart, read and send at any scan, and may send long after a read. Frames are lost, late,
//! duplicated and reordered; the control may restart at any scan. Worlds that differ only in counter offsets are
//! visited once. The control has one or two mailboxes, and any frame may arrive in any of them.
//!
//! If the check of a frame's owner, its age or the stored epoch is omitted, the search must find a violation.

use std::{
    collections::{HashSet, VecDeque},
    hash::{Hash, Hasher},
};

use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, Frame, Memory, Report, Settings},
    protocol::{Counts, Head, Link, Refusal, ReportStatus, Session},
    vocabulary::PerChannel,
};

/// A frame in transit, with properties that only the test knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
struct Flying {
    frame: Frame,
    /// Scans since publication of the report that this frame answers; saturates.
    age: u8,
    /// The control has restarted or timed out since that report.
    stale: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Sender {
    session: Session,
    /// Age and `stale` flag, as in [`Flying`], of the last report read; `None` without a report to answer.
    knows: Option<(u8, bool)>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct World {
    barrier: Memory,
    /// The sender whose frame was accepted first in this epoch; 0 if none.
    first: u16,
    senders: [Option<Sender>; 2],
    in_transit: Vec<Flying>,
    /// The frame in each mailbox; with a single path, only the first mailbox is used.
    mailboxes: [Option<Flying>; 2],
}

/// A check that is omitted from the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Without {
    Nothing,
    Owner,
    Age,
    KeptEpoch,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Violation {
    /// A frame from before a restart or timeout was accepted.
    Stale,
    /// An accepted frame answers a report older than the bound.
    Old,
    /// Frames of two senders were accepted in one epoch.
    TwoOwners,
    /// An axis moved by more than its rate, or beyond its limit.
    Step,
    /// A sender attributed its own frame to another sender.
    OwnForOther,
}

struct Bounds {
    settings: Settings,
    /// Maximum number of frames in transit.
    in_transit: usize,
    ways: usize,
    without: Without,
    most_worlds: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Does {
    Nothing,
    Dies,
    Starts,
    Reads,
    Sends,
    ReadsAndSends,
}

/// Requested correction of each sender, counts.
const WANTS: [i16; 2] = [2, -2];

fn explore(bounds: &Bounds) -> (usize, bool, Vec<Violation>) {
    let settings = bounds.settings;
    let begin = World {
        barrier: Barrier::start(settings, 0, 0, &Counts::default()).expect("valid").memory(),
        first: 0,
        senders: [None; 2],
        in_transit: Vec::new(),
        mailboxes: [None; 2],
    };
    let begin = canonical(begin, &settings);
    let mut seen = HashSet::from([print_of(Turn::Control, &begin)]);
    let mut queue = VecDeque::from([(Turn::Control, begin)]);
    let mut found = HashSet::new();
    let (mut complete, mut worlds) = (true, 1);
    while let Some((turn, world)) = queue.pop_front() {
        let then = turn.next();
        successors(turn, &world, bounds, &mut |next, violation| {
            found.extend(violation);
            let next = canonical(next, &settings);
            if seen.insert(print_of(then, &next)) {
                worlds += usize::from(then == Turn::Control);
                queue.push_back((then, next));
            }
        });
        if worlds > bounds.most_worlds {
            complete = false;
            break;
        }
        if bounds.without != Without::Nothing && !found.is_empty() {
            break;
        }
    }
    let mut found: Vec<_> = found.into_iter().collect();
    found.sort_unstable();
    (worlds, complete, found)
}

/// Turns of the actors: a fixed order, so that equivalent interleavings are explored once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Turn {
    Control,
    One,
    Other,
    /// The channel delivers, then the control scans.
    Channel,
}

impl Turn {
    fn next(self) -> Self {
        match self {
            Self::Control => Self::One,
            Self::One => Self::Other,
            Self::Other => Self::Channel,
            Self::Channel => Self::Control,
        }
    }
}

fn successors(
    turn: Turn,
    world: &World,
    bounds: &Bounds,
    tell: &mut impl FnMut(World, Option<Violation>),
) {
    match turn {
        Turn::Control => {
            tell(world.clone(), None);
            for tick in [0, -1, 9] {
                let mut next = world.clone();
                start_anew(&mut next, tick, bounds);
                tell(next, None);
            }
        }
        Turn::One => acts(0, world, bounds, tell),
        Turn::Other => acts(1, world, bounds, tell),
        Turn::Channel => deliver(world, bounds, tell),
    }
}

fn acts(
    place: usize,
    world: &World,
    bounds: &Bounds,
    tell: &mut impl FnMut(World, Option<Violation>),
) {
    use Does::{Dies, Nothing, Reads, ReadsAndSends, Sends, Starts};
    let choices = match &world.senders[place] {
        None => &[Nothing, Starts][..],
        Some(Sender { knows: None, .. }) => &[Nothing, Dies, Reads, ReadsAndSends][..],
        Some(_) => &[Nothing, Dies, Reads, Sends, ReadsAndSends][..],
    };
    for does in choices {
        let mut next = world.clone();
        let violation = act(&mut next, place, *does, bounds);
        next.in_transit.sort_unstable();
        next.in_transit.dedup();
        if next.in_transit.len() <= bounds.in_transit {
            tell(next, violation);
        }
    }
}

/// Restarts the control at this tick; in the worst case old frames look recent.
fn start_anew(world: &mut World, tick: i16, bounds: &Bounds) {
    let before = world.barrier;
    let kept = match bounds.without {
        Without::KeptEpoch => before.link.epoch.wrapping_sub(1),
        _ => before.link.epoch,
    };
    let tick = before.link.tick.wrapping_add_signed(tick);
    world.barrier =
        Barrier::start(bounds.settings, kept, tick, &before.applied).expect("valid").memory();
    epoch_began(world);
}

fn epoch_began(world: &mut World) {
    world.first = 0;
    for flying in world.in_transit.iter_mut().chain(world.mailboxes.iter_mut().flatten()) {
        flying.stale = true;
    }
    for (_, stale) in world.senders.iter_mut().flatten().filter_map(|s| s.knows.as_mut()) {
        *stale = true;
    }
}

fn act(world: &mut World, place: usize, does: Does, bounds: &Bounds) -> Option<Violation> {
    let mut violation = None;
    let owners = owners(world);
    let sender = &mut world.senders[place];
    match does {
        Does::Nothing => {}
        Does::Dies => *sender = None,
        Does::Starts => {
            let drawn = (1..u16::MAX).find(|n| !owners.contains(n)).expect("few are in use");
            *sender = Some(Sender { session: Session::new(drawn), knows: None });
        }
        Does::Reads | Does::Sends | Does::ReadsAndSends => {
            let sender = sender.as_mut()?;
            if does != Does::Sends {
                let report =
                    Barrier::resume(bounds.settings, world.barrier).expect("valid").report();
                let report = Report {
                    owner: if bounds.without == Without::Owner { 0 } else { report.owner },
                    ..report
                };
                match sender.session.read(report.head()) {
                    ReportStatus::Confirmed { .. } => sender.knows = Some((0, false)),
                    ReportStatus::Held { owner } => {
                        sender.knows = None;
                        violation =
                            (owner == sender.session.owner).then_some(Violation::OwnForOther);
                    }
                    ReportStatus::Old => {}
                }
            }
            if does != Does::Reads
                && let Some((age, stale)) = sender.knows
            {
                let values = PerChannel::leading([WANTS[place]]);
                if let Some(frame) = sender.session.frame(&values) {
                    world.in_transit.push(Flying { frame, age, stale });
                }
            }
        }
    }
    violation
}

fn owners(world: &World) -> HashSet<u16> {
    let flying =
        world.in_transit.iter().chain(world.mailboxes.iter().flatten()).map(|f| f.frame.head.owner);
    let senders = world.senders.iter().flatten().map(|s| s.session.owner);
    flying.chain(senders).chain([world.barrier.link.owner, world.first]).collect()
}

/// Delivers at most one frame to the mailbox, and keeps the frame in the channel or removes it; or loses one frame.
fn deliver(world: &World, bounds: &Bounds, tell: &mut impl FnMut(World, Option<Violation>)) {
    scan(world.clone(), bounds, tell);
    for at in 0..world.in_transit.len() {
        let mut without = world.clone();
        let arrives = without.in_transit.remove(at);
        for way in 0..bounds.ways {
            let mut next = world.clone();
            next.mailboxes[way] = Some(arrives);
            scan(next, bounds, tell);
            let mut next = without.clone();
            next.mailboxes[way] = Some(arrives);
            scan(next, bounds, tell);
        }
        scan(without, bounds, tell);
    }
}

fn scan(mut world: World, bounds: &Bounds, tell: &mut impl FnMut(World, Option<Violation>)) {
    let settings = &bounds.settings;
    let mut before = world.barrier;
    if bounds.without == Without::Owner {
        before.link.owner = 0;
    }
    let start = || Barrier::resume(*settings, before).expect("valid");
    let held = world.mailboxes.map(|place| {
        place.map(|flying| {
            let tick = before.link.tick.wrapping_add(1);
            let frame = match bounds.without {
                Without::Age => Frame { head: Head { tick, ..flying.frame.head }, ..flying.frame },
                _ => flying.frame,
            };
            let mut words = [0; FRAME_WORDS];
            let count = frame.encode(settings, &mut words);
            (words, count)
        })
    });
    let mailboxes = held
        .each_ref()
        .map(|held| held.as_ref().map_or(&[][..], |(words, count)| &words[..*count]));
    let mut barrier = start();
    barrier.scan(&mailboxes[..bounds.ways], false);
    let after = barrier.memory();
    // Shows which frames were accepted: the second frame may be accepted in addition to the first.
    let mut first_alone = start();
    first_alone.scan(&mailboxes[..1], false);
    let first_alone = first_alone.memory();
    let one = first_alone.link.silent == 0;
    let again = one
        && (after.link.owner, after.link.sequence)
            == (first_alone.link.owner, first_alone.link.sequence);
    let two = after.link.silent == 0 && !again;
    let mut violation = None;
    for (axis, limit) in settings.limit.iter().enumerate().take(settings.axes.count()) {
        let moved = (after.applied[axis] - before.applied[axis]).abs();
        if moved > settings.rate[axis] || after.applied[axis].abs() > *limit {
            violation = Some(Violation::Step);
        }
    }
    for (taken, is_taken) in world.mailboxes.iter().zip([one, two]) {
        let Some(taken) = taken.filter(|_| is_taken) else {
            continue;
        };
        let owner = taken.frame.head.owner;
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
    if after.link.epoch != before.link.epoch {
        epoch_began(&mut world);
    }
    for flying in world.in_transit.iter_mut().chain(world.mailboxes.iter_mut().flatten()) {
        flying.age = flying.age.saturating_add(1);
    }
    for (age, _) in world.senders.iter_mut().flatten().filter_map(|s| s.knows.as_mut()) {
        *age = age.saturating_add(1);
    }
    tell(world, violation);
}

fn small(hold_scans: u16, time_out_scans: u16) -> Settings {
    Settings {
        axes: super::layout(1),
        machine: 4711,
        limit: PerChannel::leading([2]),
        rate: PerChannel::leading([1]),
        step_scans: 1,
        hold_scans,
        time_out_scans,
    }
}

/// Hold and timeout in scans, maximum number of frames in transit, number of mailboxes.
type Size = (u16, u16, usize, usize);

const SIZES: [Size; 6] =
    [(1, 2, 1, 1), (2, 4, 1, 1), (1, 2, 2, 1), (1, 2, 1, 2), (2, 4, 2, 1), (2, 4, 1, 2)];

#[test]
fn no_state_within_bounds_accepts_a_stale_or_foreign_frame() {
    for size @ (hold, time_out, in_transit, ways) in SIZES {
        let bounds = Bounds {
            settings: small(hold, time_out),
            in_transit,
            ways,
            without: Without::Nothing,
            most_worlds: 3_000_000,
        };
        let (worlds, complete, found) = explore(&bounds);
        eprintln!("{size:?}: {worlds} worlds");
        assert_eq!(found, []);
        assert!(complete, "bound of worlds reached");
    }
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
            in_transit: 1,
            ways: 1,
            without,
            most_worlds: 1_000_000,
        };
        let (worlds, _, found) = explore(&bounds);
        assert!(found.contains(&expected), "{without:?}: {found:?} in {worlds} worlds");
    }
}

/// 128-bit hash of a world, so that millions of worlds fit into memory. Among ten million the collision probability is 1e-25.
struct Print(u128);

impl Hasher for Print {
    fn write(&mut self, bytes: &[u8]) {
        for eight in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..eight.len()].copy_from_slice(eight);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u8(&mut self, number: u8) {
        self.write_u64(number.into());
    }

    fn write_u16(&mut self, number: u16) {
        self.write_u64(number.into());
    }

    fn write_u32(&mut self, number: u32) {
        self.write_u64(number.into());
    }

    fn write_u64(&mut self, number: u64) {
        let mixed =
            (self.0 ^ u128::from(number)).wrapping_mul(0x2d35_8dcc_aa6c_78a5_8bb8_4b93_962e_acc9);
        self.0 = mixed ^ (mixed >> 71) ^ 0x9e37_79b9_7f4a_7c15;
    }

    fn finish(&self) -> u64 {
        let low = self.0 & u128::from(u64::MAX);
        u64::try_from(low ^ (self.0 >> 64)).expect("the upper half is gone")
    }
}

fn print_of(turn: Turn, world: &World) -> u128 {
    let mut print = Print(0x1234_5678_9abc_def1);
    (turn, world).hash(&mut print);
    print.0
}

/// The same world with counters relative to those of the barrier. Counters saturate at values beyond which a difference
/// has no effect.
fn canonical(mut world: World, settings: &Settings) -> World {
    let Link { epoch, tick, sequence, .. } = world.barrier.link;
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
    // Whether the barrier has already checked the frame in this mailbox.
    let numbers =
        |place: &Option<Flying>| place.map(|f| (f.frame.head.tick, f.frame.head.sequence));
    let judged = [0, 1].map(|way| {
        let found = world.barrier.found[way];
        found.is_some() && found == numbers(&world.mailboxes[way])
    });
    // Epochs do not recur, so frames of other epochs are equivalent: each is replaced by a frame that differs from an
    // acceptable frame only in its epoch.
    let owner = world.barrier.link.owner;
    let dead = Flying {
        frame: Frame {
            head: Head {
                epoch: epoch.wrapping_sub(1),
                tick,
                sequence: sequence.wrapping_add(1),
                owner: if owner == 0 { u16::MAX } else { owner },
            },
            values: [1; 9],
        },
        age: bound,
        stale: true,
    };
    for flying in world.in_transit.iter_mut().chain(world.mailboxes.iter_mut().flatten()) {
        if flying.frame.head.epoch != epoch {
            *flying = dead;
        }
        let frame = &mut flying.frame;
        frame.head.epoch = epochs(frame.head.epoch);
        frame.head.tick = ticks(frame.head.tick);
        frame.head.sequence = sequences(frame.head.sequence);
        flying.age = flying.age.min(bound);
    }
    for sender in world.senders.iter_mut().flatten() {
        sender.session.sent = None;
        // Frames sent in another epoch have no effect, because the first frame of this epoch is accepted before it is
        // reported.
        for own in &mut sender.session.own {
            *own = own
                .filter(|(of, _)| *of == epoch)
                .map(|(of, newest)| (epochs(of), sequences(newest)));
        }
        sender.session.own.sort_unstable();
        if let Some((age, _)) = &mut sender.knows {
            *age = (*age).min(bound);
        }
        if let Some(last) = &mut sender.session.last {
            if last.epoch != epoch {
                (last.tick, last.sequence) = (tick, sequence);
                sender.knows = sender.knows.map(|_| (bound, true));
            }
            *last = Head {
                epoch: epochs(last.epoch),
                tick: ticks(last.tick),
                sequence: sequences(last.sequence),
                owner: 0,
            };
        }
    }
    for (way, judged) in judged.into_iter().enumerate() {
        let found = &mut world.barrier.found[way];
        *found = if judged {
            numbers(&world.mailboxes[way])
        } else {
            found.map(|(t, s)| (ticks(t), sequences(s)))
        };
    }
    let barrier = &mut world.barrier;
    (barrier.link.epoch, barrier.link.tick, barrier.link.sequence) = (100, 1000, 1000);
    barrier.refusal = Refusal::None;
    if barrier.done >= barrier.steps {
        (barrier.from, barrier.steps, barrier.done) = (barrier.applied, 0, 0);
    }
    renumber_owners(&mut world);
    world.in_transit.sort_unstable();
    world.in_transit.dedup();
    world
}

fn renumber_owners(world: &mut World) {
    let mut met = vec![0];
    let mut rename = |owner: &mut u16| {
        let place = met.iter().position(|m| m == owner).unwrap_or_else(|| {
            met.push(*owner);
            met.len() - 1
        });
        *owner = u16::try_from(place).expect("few owners");
    };
    rename(&mut world.barrier.link.owner);
    rename(&mut world.first);
    for sender in world.senders.iter_mut().flatten() {
        rename(&mut sender.session.owner);
    }
    for flying in world.mailboxes.iter_mut().flatten() {
        rename(&mut flying.frame.head.owner);
    }
    // Sorted without owner numbers, so that the new numbers do not depend on the old ones.
    world.in_transit.sort_by_key(|f| {
        let head = Head { owner: 0, ..f.frame.head };
        (f.age, f.stale, head, f.frame.values)
    });
    for flying in &mut world.in_transit {
        rename(&mut flying.frame.head.owner);
    }
}
