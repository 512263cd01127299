//! Tables that a control adds to its axis commands: computed from a machine, written for a control, read back, and compared with the model.

mod exchange;
mod firmware;
mod loss;
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

pub use exchange::{ReadTables, read, read_mesh, write};
pub use firmware::{Firmware, LinearSettings, Skew, linear_settings, write_settings};
pub use loss::{AxisLoss, Category, CategoryLoss, Loss, firmware_loss, loss};
pub use options::{
    AxisNumbers, Facts, ReadOptions, WriteOptions, Written, facts_file, is_facts_file,
};
pub use sampled::{TableOptions, sampled};
pub use table::{
    AxisTable, Content, Curves, ErrorTable, ErrorTables, ListedTable, curves, to_toml,
};
pub use text::{ExchangeError, Format, LineError, TextFile, UnknownFormat, Warning};
