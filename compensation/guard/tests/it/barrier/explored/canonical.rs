//! Canonical form of a world: worlds that differ only in counter offsets have the same hash.

use std::hash::{Hash, Hasher};

use volcomp_guard::{
    barrier::{Frame, Settings},
    protocol::{Head, Link, Refusal},
};

use super::{Flying, Turn, World};

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

pub(super) fn print_of(turn: Turn, world: &World) -> u128 {
    let mut print = Print(0x1234_5678_9abc_def1);
    (turn, world).hash(&mut print);
    print.0
}

/// The same world with counters relative to those of the barrier. Counters saturate at values beyond which a difference
/// has no effect.
pub(super) fn canonical(mut world: World, settings: &Settings) -> World {
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
