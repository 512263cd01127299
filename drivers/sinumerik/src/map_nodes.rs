//! Where a map of corrections lies in the PLC: the nodes of its mailbox, its report and its buffers.

/// The node ids (the string after `s=`) of the words of a map in the PLC. **None was tried on a real control**: arrays are
/// written as manuals write those of other kinds (`/Plc/DB2.DBD0:REAL[10]`); browse the server and compare.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct MapNodes {
    /// The 72 words of the mailbox, an array that is written whole: `/Plc/DB100.DBW0:WORD[72]`.
    pub mailbox: String,
    /// The 24 words of the report, an array: `/Plc/DB100.DBW144:WORD[24]`.
    pub report: String,
    /// The pattern of an array of words of the buffers, of which the second lies behind the first: `{byte}` stands for the
    /// place of the first word in bytes, `{count}` for how many words there are.
    pub buffers: String,
}

impl Default for MapNodes {
    fn default() -> Self {
        let text = str::to_owned;
        Self {
            mailbox: text("/Plc/DB100.DBW0:WORD[72]"),
            report: text("/Plc/DB100.DBW144:WORD[24]"),
            buffers: text("/Plc/DB101.DBW{byte}:WORD[{count}]"),
        }
    }
}

/// Words of a buffer that are read as one array.
const PIECE: usize = 64;

impl MapNodes {
    /// The nodes that hold the first `count` words of a buffer, 0 or 1, where each has `capacity` words: pieces of 64
    /// words, and what is left of the buffer in the last.
    #[must_use]
    pub fn of_buffer(&self, buffer: u16, count: usize, capacity: usize) -> Vec<String> {
        let first = usize::from(buffer) * capacity;
        let pieces = (0..count.min(capacity)).step_by(PIECE);
        let node = |place: usize| {
            let words = PIECE.min(capacity - place);
            self.buffers
                .replace("{byte}", &(2 * (first + place)).to_string())
                .replace("{count}", &words.to_string())
        };
        pieces.map(node).collect()
    }
}
