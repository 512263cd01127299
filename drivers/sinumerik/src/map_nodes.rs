/// Node ids (the string after `s=`) of the words of a map in the PLC. **None was tried on a real control.** Their array
/// notation follows the notation that the manuals show for other types (`/Plc/DB2.DBD0:REAL[10]`). Browse the server
/// and compare.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct MapNodes {
    /// Array of the 72 words of the mailbox, written in one request: `/Plc/DB100.DBW0:WORD[72]`.
    pub mailbox: String,
    /// Array of the 24 words of the report: `/Plc/DB100.DBW144:WORD[24]`.
    pub report: String,
    /// Pattern for an array of words in the two buffers. The second buffer follows the first. `{byte}` is the byte
    /// offset of the first word, `{count}` the number of words.
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

/// Maximum number of words of a buffer that are read as one array.
const PIECE: usize = 64;

impl MapNodes {
    /// Nodes of the first `count` words of buffer 0 or 1. Each buffer has `capacity` words. The nodes are arrays of 64
    /// words; the last array may be shorter.
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
