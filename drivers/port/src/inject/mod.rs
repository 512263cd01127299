//! Seeded fault injection. Wrap a device in [`Faulty`] to test the code that uses it. Faults occur with set
//! probabilities ([`Faults`]) or on request ([`Injection`]), also from another thread ([`Remote`]).
//!
//! | fault | models |
//! | --- | --- |
//! | `delay`, `jitter` | a busy network, a control that serves its own screen first |
//! | `drop` | a lost answer; the request did not arrive either |
//! | `corrupt` | a flipped bit, a position that is not a number |
//! | `freeze` | a module that answers from a cache: the whole answer is the last one, with its old time |
//! | `disconnect` | an unplugged cable, a control that reboots |
//! | `lie` | a wrong read-back: a torn word, garbage in a register, the word of another axis |
//! | `constant` | a read-back or report that never changes: a copy in the ladder that is no longer executed |
//! | `late_write` | a write that stays in a queue or an old socket and arrives long after it was abandoned |
//! | `double_write` | a request repeated by the network, or by a library that retries |
//! | `torn_write` | words that the control reads while they are being written |
//! | `reordered_write` | two writes on two paths, of which the first arrives last |
//! | `late_answer` | an answer that is late, but within the deadline: its content is already old |
//! | `frozen_positions` | an interpolator that has stopped, or a position that is not updated, with a fresh time |
//! | `stop_after_read`, `stop_before_write` | a paused program: a stopped process, a suspended virtual machine, swapped memory |
//! | `dropped_flag` | an interlock that is no longer reported: a broken wire, another layout of a status word |
//! | `flicker` | a position that toggles by one count at standstill |
//! | `lag` | positions that show a correction later than the read-back does |
//!
//! For a reading that never returns, use a [`Hanging`] controller.

mod delayed_writes;
mod faults;
mod faulty;
mod hanging;

pub use faults::{Faults, Injection, Lie};
pub use faulty::{Faulty, Remote};
pub use hanging::{HangSwitch, Hanging};
