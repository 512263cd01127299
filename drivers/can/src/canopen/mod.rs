//! A small CANopen consumer with the default identifiers of CiA 301. It starts nodes, supervises their heartbeat, reads
//! and writes single objects, and receives temperatures (CiA 404) and digital lines (CiA 401) as process data.

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
