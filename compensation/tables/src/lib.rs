#![doc = include_str!("../README.md")]

pub mod axis_table;
mod bytes;
mod choice;
pub mod control;
mod error;
mod header;
mod interpolation;
mod machine;
mod map;
mod misfit;
mod refresh;
mod request;
mod sample;
mod sender;
mod wanted;
mod writer;

pub use bytes::{ByteOrder, to_bytes};
pub use choice::build;
pub use error::{NoMap, TablesError};
pub use header::{GRID_AXES, HEADER_WORDS, Header, Lines, MOST_WORDS, OUTPUTS, SCALES, axes_of};
pub use interpolation::Position;
pub use machine::{MapOfMachine, MapOptions};
pub use map::Map;
pub use misfit::Misfit;
pub use refresh::{Sensitivity, Transfer, refresh_s};
pub use request::{Field, GridAxis, Output, Request, Table};
pub use sender::{Allowed, Exchange, SendError, Sender, Step, Unfit};
pub use volcomp_guard::{barrier, protocol, protocol::Layout};
pub use volcomp_model as model;
pub use volcomp_vocabulary as vocabulary;
pub use writer::{Loaded, Next, next_write, writes};
