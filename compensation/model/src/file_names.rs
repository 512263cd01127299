//! Names that stand in files beside a machine file.

use volcomp_document::{InputError, Value};
use volcomp_vocabulary::{AxisName, ErrorName, UnknownErrorName};

use crate::machine::Machine;

impl Machine {
    /// The error that a file names, of an axis that this machine has.
    ///
    /// # Errors
    /// A text that is no error name, an axis that the machine does not have.
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

    /// The message that a file names an axis that this machine does not have.
    pub(crate) fn lacks(&self, axis: AxisName) -> String {
        let structure = self.chain().structure();
        format!("the structure `{structure}` has no axis {axis}")
    }
}
