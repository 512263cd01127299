//! Shifts as whole numbers of counts in one, two or four bytes, as the PMC takes them over the wire.

use crate::pmc::Width;

/// The count at the start of `bytes`; `None` where they are too few.
pub(crate) fn count(bytes: &[u8], width: Width) -> Option<f64> {
    match width {
        Width::Byte => bytes.first().map(|b| f64::from(b.cast_signed())),
        Width::Word => bytes
            .first_chunk()
            .map(|b| f64::from(i16::from_be_bytes(*b))),
        Width::Long => bytes
            .first_chunk()
            .map(|b| f64::from(i32::from_be_bytes(*b))),
    }
}

/// Writes the nearest count that the width can hold at the start of `into`; what is no number becomes 0.
#[expect(clippy::cast_possible_truncation, reason = "a cast of f64 saturates")]
pub(crate) fn put(into: &mut [u8], width: Width, count: f64) {
    let count = count.round();
    let bytes = match width {
        Width::Byte => {
            let [byte] = (count as i8).to_be_bytes();
            [byte, 0, 0, 0]
        }
        Width::Word => {
            let [a, b] = (count as i16).to_be_bytes();
            [a, b, 0, 0]
        }
        Width::Long => (count as i32).to_be_bytes(),
    };
    let length = usize::from(width.bytes());
    if let Some(into) = into.get_mut(..length) {
        into.copy_from_slice(&bytes[..length]);
    }
}
