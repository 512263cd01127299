//! The Python module `volcomp`: machines, measurements, calibration and identification on NumPy arrays.
//!
//! Arrays are checked and converted here; the library crates read files and compute results. Lengths are mm, rotary
//! coordinates deg, errors µm and µrad, as in the files and in the `--json` output of the command line.
#![expect(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments of Python functions over by value"
)]

mod arrays;
mod failure;
mod flags;
mod identification;
mod machine;
mod output;
mod positions;
mod program;
mod readings;

use pyo3::prelude::*;

/// Volumetric error of machine tools: measure, model, correct.
#[pymodule]
mod volcomp {
    #[pymodule_export]
    use crate::{
        failure::InputError,
        identification::{calibrate, identify},
        machine::Machine,
        program::compensate_nc,
        readings::{fit, iso230_2, read_measurements},
    };
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        crate::failure::set_defaults(module.py())
    }
}

/// Converts a serializable value to dicts, lists and numbers of Python, with the keys of the JSON documents.
fn to_python<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    Ok(pythonize::pythonize(py, value)?)
}
