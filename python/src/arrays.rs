//! Converts Python arguments to arrays of float64, copied only if necessary, and results to NumPy arrays.

use numpy::{
    IntoPyArray, PyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray1,
    PyUntypedArrayMethods, ndarray::Dimension, ndarray::IntoDimension,
};
use pyo3::{exceptions::PyTypeError, prelude::*, types::PyTuple};

use crate::failure::Failure;

/// Converts the argument to an aligned array of float64. Such an array is not copied. Other arrays of real numbers are
/// converted to a copy.
pub(crate) fn float_array<'py>(
    value: &Bound<'py, PyAny>,
    argument: &str,
) -> Result<Bound<'py, PyArrayDyn<f64>>, Failure> {
    let py = value.py();
    let array = py.import("numpy")?.call_method1("asarray", (value,)).map_err(|error| {
        Failure::argument(format_args!(
            "{argument}: found no array ({}), expected real numbers (float64)",
            error.value(py)
        ))
    })?;
    let is_masked = py.import("numpy.ma")?.call_method1("is_masked", (value,))?;
    if is_masked.extract()? {
        return Err(Failure::argument(format_args!(
            "{argument}: found masked values, expected a number everywhere"
        )));
    }
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        let message = format!("{argument}: found dtype {dtype}, expected real numbers (float64)");
        return Err(PyTypeError::new_err(message).into());
    }
    // A field of packed records is not aligned, so it is copied as well.
    let array = py.import("numpy")?.call_method1("require", (array, "float64", "A"))?;
    array.cast_into::<PyArrayDyn<f64>>().map_err(|error| Failure::Raised(error.into()))
}

/// Converts the argument to an array of shape (n,); any other shape is an error.
pub(crate) fn column<'py>(
    value: &Bound<'py, PyAny>,
    argument: &str,
) -> Result<PyReadonlyArray1<'py, f64>, Failure> {
    let array = float_array(value, argument)?;
    let shape = array.shape().to_vec();
    let array = array.cast_into::<PyArray1<f64>>().map_err(|_| {
        Failure::argument(format_args!("{argument}: found shape {}, expected (n,)", shown(&shape)))
    })?;
    readonly(&array, argument)
}

pub(crate) fn readonly<'py>(
    array: &Bound<'py, PyArray1<f64>>,
    argument: &str,
) -> Result<PyReadonlyArray1<'py, f64>, Failure> {
    array.try_readonly().map_err(|_| {
        Failure::argument(format_args!(
            "{argument}: found an array that is being written to, expected one that only this call uses"
        ))
    })
}

/// Converts the argument, an array of shape (n,), to a list of finite numbers.
pub(crate) fn finite_column(value: &Bound<'_, PyAny>, argument: &str) -> Result<Vec<f64>, Failure> {
    let array = column(value, argument)?;
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(Failure::argument(format_args!(
            "{argument}[{index}]: found {}, expected a finite number",
            values[index]
        ))),
        None => Ok(values),
    }
}

/// A new array of zeros; `MemoryError` if there is no memory for it.
pub(crate) fn zeros<'py>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("zeros", (PyTuple::new(py, shape)?,))?;
    Ok(array.cast_into()?)
}

/// Formats a shape as Python does.
pub(crate) fn shown(shape: &[usize]) -> String {
    if let [only] = shape {
        return format!("({only},)");
    }
    let lengths: Vec<String> = shape.iter().map(usize::to_string).collect();
    format!("({})", lengths.join(", "))
}

/// Creates an array that takes ownership of the list.
pub(crate) fn shaped<T: numpy::Element, D: IntoDimension>(
    py: Python<'_>,
    values: Vec<T>,
    shape: D,
) -> PyResult<Bound<'_, PyArray<T, D::Dim>>>
where
    D::Dim: Dimension,
{
    values.into_pyarray(py).reshape(shape)
}
