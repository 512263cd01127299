#![doc = include_str!("../README.md")]

pub mod axis_table;
mod build;
pub mod control;
mod machine;
mod map;
mod sender;

pub use build::{Field, GridAxis, Misfit, Output, Request, Table, TablesError, build};
pub use machine::{MachineMap, MapOptions, Sensitivity, Transfer, refresh_s};
pub use map::{
    ByteOrder, GRID_AXES, HEADER_WORDS, Header, Lines, MAX_WORDS, Map, MapError, OUTPUTS, Position,
    SCALES, axes_of, to_bytes,
};
pub use sender::{
    Exchange, LimitError, NextAction, ReadBackResult, SendError, Sender, SenderLimits, Step,
    next_write, writes,
};
pub use volcomp_guard::{barrier, protocol, protocol::Layout};
pub use volcomp_model as model;
pub use volcomp_vocabulary as vocabulary;
