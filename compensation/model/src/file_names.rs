//! Names in files that accompany a machine file.

use volcomp_document::{InputError, Value};
use volcomp_vocabulary::{AxisName, ErrorName, UnknownErrorName};

use crate::machine::Machine;

impl Machine {
    /// Decodes an error name whose axis this machine has.
    ///
    /// # Errors
    /// Not an error name, or an axis that the machine does not have.
    pub fn decode_error(&self, value: &Value<'_>) -> Result<ErrorName, InputError> {
        let name: ErrorName = value
            .text()?
            .parse()
            .map_err(|error: UnknownErrorName| value.error(error.to_string()))?;
        if self.axis(name.axis).is_none() {
            return Err(value.error(self.lacks(name.axis)));
        }
        Ok(name)
    }

    /// The message for a file that names an axis that this machine does not have.
    pub(crate) fn lacks(&self, axis: AxisName) -> String {
        let structure = self.chain().structure();
        format!("the structure `{structure}` has no axis {axis}")
    }
}
