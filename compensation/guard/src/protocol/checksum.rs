//! The checksum of frames and reports.

use super::Layout;

/// The two sums of a Fletcher checksum over 16-bit words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Checksum {
    /// The sum of the words.
    pub sum: u16,
    /// The sum of the sums, which tells words that changed places.
    pub of_sums: u16,
}

impl Checksum {
    /// The sum, and the sum of the sums.
    #[must_use]
    pub fn words(self) -> [u16; 2] {
        [self.sum, self.of_sums]
    }
}

/// Fletcher's checksum modulo 65535 of the words, started from the machine's number and the layout's, so that a frame for
/// another machine, for other axes or for another order of them does not fit. The words 0 and 65535 weigh the same: -1 and 0 counts
/// cannot be told apart by it, which is one step of an axis at the most.
#[must_use]
pub fn checksum(machine: u16, layout: Layout, words: &[u16]) -> Checksum {
    let reduced = |sum: u32| u16::try_from(sum % 65535).unwrap_or(0);
    let mut check = Checksum {
        sum: reduced(u32::from(machine) + layout.number() / 65535),
        of_sums: reduced(layout.number()),
    };
    for word in words {
        check.sum = reduced(u32::from(check.sum) + u32::from(*word));
        check.of_sums = reduced(u32::from(check.of_sums) + u32::from(check.sum));
    }
    check
}
