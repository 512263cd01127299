//! The words of a map in a control, as its sender exchanges them.

use volcomp_devices::map::{MapError, MapWords};
use volcomp_tables::{
    Exchange,
    control::{FRAME_WORDS, REPORT_WORDS},
};

/// An open session to a control.
pub(super) struct Words(pub(super) Box<dyn MapWords>);

impl Exchange for Words {
    type Error = MapError;

    fn report(&mut self) -> Result<Vec<u16>, MapError> {
        self.0.report(REPORT_WORDS)
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), MapError> {
        self.0.write(frame)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError> {
        self.0.buffer(buffer, count)
    }
}
