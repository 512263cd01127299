//! Tables that a control adds to its axis commands: computed from a machine, written for a control, read back, and compared with the model.

mod curves;
mod exchange;
mod firmware;
mod format;
mod loss;
mod mesh;
mod options;
mod sampled;
mod table;
mod text;

mod csv;
mod fanuc;
mod heidenhain;
mod isg_csv;
mod linuxcnc;
mod siemens;

pub use curves::{Curves, curves, to_toml};
pub use exchange::{ReadTables, read, write};
pub use firmware::{Firmware, LinearSettings, Skew, linear_settings, write_settings};
pub use format::{Format, UnknownFormat};
pub use loss::{AxisLoss, Category, CategoryLoss, Loss, firmware_loss, loss};
pub use mesh::read_mesh;
pub use options::{
    AxisNumbers, Facts, ReadOptions, WriteOptions, Written, facts_file, is_facts_file,
};
pub use sampled::{TableOptions, sampled};
pub use table::{AxisTable, Content, ErrorTable, ErrorTables, ListedTable};
pub use text::{ExchangeError, LineError, TextFile, Warning};
