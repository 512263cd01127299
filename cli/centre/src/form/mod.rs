//! A model by form: type numbers or a structure, travels and component errors, typed or from measurement files, become a machine
//! file with its formula and its map.

mod build;
mod error;
mod input;

pub use build::{Built, Described, build, described};
pub use error::FormError;
pub use input::{AxisForm, CurveForm, ErrorForm, Form, StructureForm, Upload};
