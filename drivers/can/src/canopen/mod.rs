//! A small CANopen consumer: starts nodes, monitors their heartbeat, reads and writes single objects, and reads temperatures (CiA 404) and digital
//! lines (CiA 401) from process data. Default identifiers (CiA 301).

mod digital;
mod nodes;
mod sdo;
mod telegrams;
mod thermometer;

pub use digital::CanopenDigital;
pub use sdo::SdoClient;
pub use telegrams::{
    NmtCommand, NodeState, SdoAnswer, Telegram, nmt, sdo_read, sdo_write, telegram,
};
pub use thermometer::{CanopenThermometer, Channel, Number};
