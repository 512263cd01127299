//! S7 communication with the PLC (data blocks) and the NCK (variables) of a control, on TCP port 102: a codec, a plain client
//! with deadlines, and, with the feature `simulator`, a control that answers.
//!
//! **Unproven on hardware.** Frames are those of published captures and of Wireshark's dissector; the byte order of NCK
//! values (least significant first) and the slot of the NCK (4) are from memory of others' code. Try reads first, and write
//! to a data block that nothing uses.
//!
//! ```text
//! TPKT    03 00 LENGTH
//! COTP    11 e0 ... connect, 11 d0 ... connected, 02 f0 80 data
//! S7      32 KIND 00 00 REFERENCE PARAMETERS DATA [ERROR], parameters, data
//! item    12 0a 10 02 COUNT DB 84 BIT           COUNT bytes of a data block from BIT / 8 on
//!         12 08 82 AREA<<5|UNIT COLUMN LINE MODULE LINES    a variable of the NCK
//! ```

mod client;
mod codec;
mod error;
mod item;
#[cfg(feature = "simulator")]
mod simulator;

pub use client::{Client, Target};
pub use codec::{
    Cotp, Message, Write, confirm_frame, connect_frame, frame_length, frame_of, parse_frame,
};
pub use error::{ReturnCode, S7Error};
pub use item::{Area, Item, LONGEST_BLOCK, MOST_ITEMS, NckVariable};
#[cfg(feature = "simulator")]
pub use simulator::{Memory, Simulator};
