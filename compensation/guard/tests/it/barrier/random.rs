//! Long random runs with all faults of a channel, a control and two senders. The axes are checked in every scan.

use std::collections::HashMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    barrier::{Barrier, Report, Settings},
    protocol::{Counts, ReportStatus, Session},
    vocabulary::PerChannel,
};

use super::{settings, words};

const AXES: usize = 3;
/// Maximum change of a sender's output per scan, counts: half of the barrier's rate.
const SLEW: i16 = 1;

/// A sender that moves its output from the confirmed to the requested value at its own slew.
struct Sender {
    session: Session,
    output: Option<Counts>,
    requested: Counts,
}

/// Words in transit, and the scan of their arrival.
struct Late {
    at: u32,
    words: Vec<u16>,
}

/// Probability of each fault per scan.
#[derive(Clone, Copy, Default)]
struct Faults {
    lost: f64,
    late: f64,
    doubled: f64,
    torn: f64,
    old_report: f64,
    rare: f64,
}

struct World {
    rng: ChaCha8Rng,
    settings: Settings,
    barrier: Barrier,
    now: u32,
    epochs: u32,
    /// The current report, and the scan in which it was published.
    published: (Report, u32),
    in_transit: Vec<Late>,
    mailbox: Vec<u16>,
    /// For every frame: the scan of the report that it answers, and the epoch in which it was sent.
    sent: HashMap<Vec<u16>, (u32, u32)>,
    senders: Vec<Sender>,
    cut_until: u32,
    holds_until: u32,
    first_owner: Option<u16>,
    taken: u32,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let settings = Settings { hold_scans: 8, time_out_scans: 30, ..settings(AXES) };
        // About half of the worlds start with counters close to their wrap.
        let near = |rng: &mut ChaCha8Rng| rng.random_range(0..80_u16).wrapping_sub(40);
        let barrier = Barrier::start(settings, near(&mut rng), near(&mut rng), &Counts::default())
            .expect("valid");
        let published = (barrier.report(), 0);
        Self {
            rng,
            settings,
            barrier,
            now: 0,
            epochs: 0,
            published,
            in_transit: Vec::new(),
            mailbox: Vec::new(),
            sent: HashMap::new(),
            senders: Vec::new(),
            cut_until: 0,
            holds_until: 0,
            first_owner: None,
            taken: 0,
        }
    }

    fn requested(&mut self) -> Counts {
        let limit = self.settings.limit[0];
        let some: [i16; AXES] = core::array::from_fn(|_| self.rng.random_range(-limit..=limit));
        PerChannel::leading(some)
    }

    fn start_sender(&mut self) {
        let (owner, requested) = (self.rng.random(), self.requested());
        self.senders.push(Sender { session: Session::new(owner), output: None, requested });
    }

    fn step(&mut self, faults: &Faults) {
        self.now += 1;
        self.rare(faults);
        for at in 0..self.senders.len() {
            self.send(at, faults);
        }
        let torn = self.arrive(faults);
        self.scan();
        if let Some(words) = torn {
            self.mailbox = words;
        }
    }

    fn rare(&mut self, faults: &Faults) {
        if !self.rng.random_bool(faults.rare) {
            return;
        }
        let seconds = self.rng.random_range(5..120);
        match self.rng.random_range(0..6) {
            0 => self.cut_until = self.now + seconds,
            1 => self.holds_until = self.now + seconds,
            2 => {
                self.senders.pop();
            }
            3 if self.senders.len() < 2 => self.start_sender(),
            4 => {
                // A power cycle: the axes keep their corrections, and the tick restarts.
                let before = self.barrier.memory();
                let tick = self.rng.random();
                self.barrier =
                    Barrier::start(self.settings, before.link.epoch, tick, &before.applied)
                        .expect("valid");
                self.epoch_began();
            }
            _ => {
                for at in 0..self.senders.len() {
                    self.senders[at].requested = self.requested();
                }
            }
        }
    }

    fn epoch_began(&mut self) {
        self.epochs += 1;
        self.first_owner = None;
    }

    fn send(&mut self, at: usize, faults: &Faults) {
        let cut = self.now < self.cut_until;
        if !cut && !self.rng.random_bool(faults.old_report) {
            self.published = (self.barrier.report(), self.now);
        }
        if cut {
            return;
        }
        let (report, made) = self.published;
        let sender = &mut self.senders[at];
        let begins = match sender.session.read(report.head()) {
            ReportStatus::Old => return,
            ReportStatus::Held { owner } => {
                assert_ne!(
                    owner, sender.session.owner,
                    "it takes its own frame for that of another"
                );
                sender.output = None;
                return;
            }
            ReportStatus::Confirmed { epoch_began, .. } => epoch_began,
        };
        let from = match sender.output {
            Some(output) if !begins => output,
            _ => report.applied,
        };
        let output = PerChannel::from_fn(|axis| {
            from[axis] + (sender.requested[axis] - from[axis]).clamp(-SLEW, SLEW)
        });
        sender.output = Some(output);
        let Some(frame) = sender.session.frame(&output) else {
            return;
        };
        let words = words(&self.settings, &frame);
        self.sent.insert(words.clone(), (made, self.epochs));
        let mut late = Late { at: self.now, words };
        if self.rng.random_bool(faults.lost) {
            return;
        }
        if self.rng.random_bool(faults.late) {
            late.at += self.rng.random_range(0..400);
        }
        if self.rng.random_bool(faults.doubled) {
            let again = self.now + self.rng.random_range(0..400);
            self.in_transit.push(Late { at: again, words: late.words.clone() });
        }
        self.in_transit.push(late);
    }

    /// Delivers arriving frames to the mailbox. The last words of a torn frame arrive after the scan.
    fn arrive(&mut self, faults: &Faults) -> Option<Vec<u16>> {
        let now = self.now;
        let (mut arrived, in_transit) = std::mem::take(&mut self.in_transit)
            .into_iter()
            .partition::<Vec<_>, _>(|late| late.at <= now);
        self.in_transit = in_transit;
        let mut rest = None;
        while !arrived.is_empty() {
            let late = arrived.swap_remove(self.rng.random_range(0..arrived.len()));
            rest = None;
            if self.mailbox.len() == late.words.len() && self.rng.random_bool(faults.torn) {
                let cut = self.rng.random_range(1..late.words.len());
                let (here, there) =
                    if self.rng.random_bool(0.5) { (0, cut) } else { (cut, late.words.len()) };
                self.mailbox[here..there].copy_from_slice(&late.words[here..there]);
                rest = Some(late.words);
            } else {
                self.mailbox = late.words;
            }
        }
        rest
    }

    fn scan(&mut self) {
        let before = self.barrier.memory();
        let holds = self.now < self.holds_until;
        let report = self.barrier.scan(&[&self.mailbox], holds);
        let after = self.barrier.memory();
        for axis in 0..AXES {
            let moved = (after.applied[axis] - before.applied[axis]).abs();
            assert!(moved <= if holds { 0 } else { self.settings.rate[axis] });
            assert!(after.applied[axis].abs() <= self.settings.limit[axis]);
        }
        if after.link.silent == 0 {
            self.taken += 1;
            let (made, epochs) = self.sent[&self.mailbox];
            assert_eq!(epochs, self.epochs, "taken across an epoch");
            assert!(self.now - made <= u32::from(self.settings.hold_scans), "taken too late");
            let first = *self.first_owner.get_or_insert(report.owner);
            assert_eq!(first, report.owner, "two senders in one epoch");
        }
        if after.link.epoch != before.link.epoch {
            self.epoch_began();
        }
    }
}

#[test]
fn no_channel_fault_makes_an_axis_step_and_a_live_sender_succeeds() {
    let (mut taken, mut reached) = (0, 0);
    for seed in 0..2000_usize {
        let mut world = World::new(seed as u64);
        world.start_sender();
        let often = [0.0, 0.01, 0.05, 0.2][seed % 4];
        let some = |world: &mut World| {
            if world.rng.random_bool(0.5) { often } else { 0.0 }
        };
        let faults = Faults {
            lost: some(&mut world),
            late: some(&mut world),
            doubled: some(&mut world),
            torn: some(&mut world),
            old_report: some(&mut world),
            rare: [0.0, 0.004, 0.02][seed % 3],
        };
        for _ in 0..500 {
            world.step(&faults);
        }
        world.cut_until = 0;
        world.holds_until = 0;
        if seed % 2 == 0 {
            // All senders stop: the axes must be at zero after maximum frame age + timeout + ramp.
            world.senders.clear();
            let furthest =
                world.barrier.report().applied.iter().map(|a| a.abs()).max().unwrap_or(0);
            // A frame in transit may still be accepted, and may first move the axis away from zero.
            let way = i32::midpoint(i32::from(furthest), 2 * 20);
            let bound = i32::from(world.settings.hold_scans + world.settings.time_out_scans) + way;
            for _ in 0..bound {
                world.step(&Faults::default());
            }
            for _ in 0..500 {
                assert_eq!(world.barrier.report().applied, Counts::default(), "seed {seed}");
                world.step(&Faults::default());
            }
        } else {
            world.senders.truncate(1);
            if world.senders.is_empty() {
                world.start_sender();
            }
            for _ in 0..200 {
                world.step(&Faults::default());
            }
            assert_eq!(world.barrier.report().applied, world.senders[0].requested, "seed {seed}");
            reached += 1;
        }
        taken += world.taken;
    }
    eprintln!("{taken} frames taken");
    assert!(taken > 200_000 && reached == 1000);
}
