//! Faults on purpose, seeded: wrap a device in [`Faulty`] and see what the rest makes of it. What goes wrong comes by
//! chance ([`Faults`]) or when it is asked for ([`Injection`]), also from another thread ([`Remote`]).
//!
//! | fault | stands for |
//! | --- | --- |
//! | `delay`, `jitter` | a busy network, a control that serves its own screen first |
//! | `drop` | a lost answer; the request did not arrive either |
//! | `corrupt` | a bit that toppled, a position that is no number |
//! | `freeze` | a module that answers from its memory: the whole answer is the last one, with its old time |
//! | `disconnect` | a cable that is pulled, a control that reboots |
//! | `lie` | a read-back that is wrong: a torn word, rubbish in a register, the word of another axis |
//! | `constant` | a read-back or report that stays as it is: a copy in the ladder that is not executed any more |
//! | `late_write` | a write that lies in a queue or an old socket and arrives long after it was given up |
//! | `double_write` | a request that was repeated by the network, or by a library that tries again |
//! | `torn_write` | words that the control reads while they are being written |
//! | `reordered_write` | two writes on two ways, of which the first arrives last |
//! | `late_answer` | an answer that is late, but within the deadline: what it says is old already |
//! | `frozen_positions` | an interpolator that stands, or a position that is not updated, with a fresh time |
//! | `stop_after_read`, `stop_before_write` | a program that stands: a stopped process, a suspended virtual machine, swapped memory |
//! | `dropped_flag` | an interlock that is not shown any more: a wire that broke, another layout of a status word |
//! | `flicker` | a position that goes to and fro by one count at standstill |
//! | `lag` | positions that show a correction later than the read-back does |
//!
//! A reading that does not come back at all is that of a [`Hanging`] controller.

mod faults;
mod faulty;
mod hanging;
mod held;

pub use faults::{Faults, Injection, Lie};
pub use faulty::{Faulty, Remote};
pub use hanging::{HangSwitch, Hanging};
