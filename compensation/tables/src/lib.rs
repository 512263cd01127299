#![doc = include_str!("../README.md")]

pub mod axis_table;
mod build;
pub mod control;
mod machine;
mod map;
mod sender;

pub use build::{Field, GridAxis, Misfit, Output, Request, Table, TablesError, build};
pub use machine::{MapOfMachine, MapOptions, Sensitivity, Transfer, refresh_s};
pub use map::{
    ByteOrder, GRID_AXES, HEADER_WORDS, Header, Lines, MOST_WORDS, Map, NoMap, OUTPUTS, Position,
    SCALES, axes_of, to_bytes,
};
pub use sender::{
    Allowed, Exchange, Loaded, Next, SendError, Sender, Step, Unfit, next_write, writes,
};
pub use volcomp_guard::{barrier, protocol, protocol::Layout};
pub use volcomp_model as model;
pub use volcomp_vocabulary as vocabulary;
