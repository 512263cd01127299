//! Patterns of the node ids that are read and written.

use crate::error::SinumerikError;

/// Patterns of the node ids (the string after `s=`) of one control. `{axis}` is the number of an axis in the control,
/// from 1. `{db}` is the number of the axis's data block in the PLC, which is 30 plus the axis number.
///
/// The default pattern for positions is the node that SINUMERIK Operate shows as machine coordinates. The patterns for
/// machine and setting data are formed like the ids in the manuals. **None was tried on a real control.** Browse the
/// server and compare.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Nodes {
    /// Position of an axis in machine coordinates, mm or deg. Patterns for geometry axes are rejected, because work
    /// offsets, frames and transformations (`TRAORI`) change their positions.
    pub position: String,
    /// Name of an axis, which must begin with the letter of the axis. An empty pattern switches this check off.
    pub name: String,
    /// Setting data 43900 of an axis, which is the correction, mm or deg.
    pub setting: String,
    /// Machine data 32750 of an axis, which is the type of its temperature compensation.
    pub kind: String,
    /// Machine data 32760 of an axis: the fraction of its maximum velocity with which a correction may change. With an
    /// empty pattern it is not read.
    pub share: String,
    /// Machine data 32000 of an axis: its maximum velocity, mm/min or rev/min. With an empty pattern it is not read.
    pub speed: String,
    /// Emergency stop. It is pressed unless the value is 0 or false. `None`: it is not read.
    pub emergency_stop: Option<String>,
    /// Alarm. It is active unless the value is 0 or false. `None`: it is not read.
    pub alarm: Option<String>,
    /// Reference state of an axis. The axis is referenced unless the value is 0 or false. `None`: it is not read.
    pub referenced: Option<String>,
}

impl Default for Nodes {
    fn default() -> Self {
        let text = str::to_owned;
        Self {
            position: text("/Channel/MachineAxis/actToolBasePos[u1,{axis}]"),
            name: text("/Channel/MachineAxis/name[u1,{axis}]"),
            setting: text("/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u{axis}]"),
            kind: text("/NC/_N_AX_TEA_ACX/$MA_TEMP_COMP_TYPE[u{axis}]"),
            share: text("/NC/_N_AX_TEA_ACX/$MA_COMP_ADD_VELO_FACTOR[u{axis}]"),
            speed: text("/NC/_N_AX_TEA_ACX/$MA_MAX_AX_VELO[u{axis}]"),
            emergency_stop: None,
            alarm: None,
            referenced: None,
        }
    }
}

impl Nodes {
    /// Inserts the number of an axis in a pattern, and returns the node id.
    pub fn of_axis(pattern: &str, number: u16) -> String {
        pattern
            .replace("{axis}", &number.to_string())
            .replace("{db}", &(u32::from(number) + 30).to_string())
    }

    /// Checks that the patterns yield a different node for each axis.
    pub(crate) fn check(&self, axes: usize) -> Result<(), SinumerikError> {
        let needed =
            [("position", &self.position), ("setting", &self.setting), ("kind", &self.kind)];
        for (key, pattern) in needed {
            if pattern.is_empty() {
                return Err(SinumerikError::EmptyPattern { key });
            }
        }
        if self.position.contains("/GeometricAxis/") {
            return Err(SinumerikError::WorkpiecePosition(self.position.clone()));
        }
        let of_axes = needed.into_iter().chain([
            ("name", &self.name),
            ("share", &self.share),
            ("speed", &self.speed),
        ]);
        for (key, pattern) in of_axes.chain(self.referenced.iter().map(|p| ("referenced", p))) {
            let differs = pattern.contains("{axis}") || pattern.contains("{db}");
            if axes > 1 && !pattern.is_empty() && !differs {
                return Err(SinumerikError::OnePattern { key, found: pattern.clone() });
            }
        }
        Ok(())
    }
}

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
