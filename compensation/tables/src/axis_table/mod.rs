//! Tables that a control adds to the commands of its axes, as plain data: made from a machine, written for a control, read back, and
//! held against the model.

mod category;
mod curves;
mod error_table;
mod exchange;
mod facts;
mod format;
mod loss;
mod numbers;
mod refusal;
mod sampled;
mod table;
mod text;

mod csv;
mod fanuc;
mod heidenhain;
mod isg_csv;
mod linuxcnc;
mod siemens;

pub use category::Category;
pub use curves::{Curves, curves, to_toml};
pub use error_table::{ErrorTable, ErrorTables};
pub use exchange::{
    Content, ListedTable, ReadOptions, ReadTables, Warning, WriteOptions, Written, read, write,
};
pub use facts::{Facts, facts_file, is_facts_file};
pub use format::{Format, UnknownFormat};
pub use loss::{AxisLoss, CategoryLoss, Loss, loss};
pub use numbers::AxisNumbers;
pub use refusal::{ExchangeError, LineError};
pub use sampled::{TableOptions, sampled};
pub use table::AxisTable;
pub use text::TextFile;
