//! Why there is no map.

use volcomp_model::ModelError;
use volcomp_vocabulary::AxisName;

/// Why words or bytes are no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoMap {
    /// Fewer words than a head has.
    #[error("a map has at least 69 words, found {found}")]
    Short {
        /// How many words there are.
        found: usize,
    },
    /// An odd number of bytes.
    #[error("{found} bytes are no whole words")]
    OddBytes {
        /// How many bytes there are.
        found: usize,
    },
    /// It does not begin as a map does.
    #[error("the first word is {found:#06x}, expected 0x564d (VM): this is no map of volcomp")]
    Magic {
        /// The first word.
        found: u16,
    },
    /// A layout of words that this version does not know.
    #[error("layout version {found}, expected 1")]
    Version {
        /// The version that is stated.
        found: u16,
    },
    /// Axes that make no sense.
    #[error("expected one to five different axes of the grid, and one to three that are corrected")]
    Axes,
    /// The number of the map is 0.
    #[error("the counter of the map is 0, expected 1 to 65535")]
    Counter,
    /// The scale of the values is out of range.
    #[error("an output step has {found} parts, expected 1 to 64")]
    Scale {
        /// The scale that is stated.
        found: u16,
    },
    /// Lines that are out of range.
    #[error("axis {axis}: lines of the grid are out of range")]
    Lines {
        /// The axis.
        axis: AxisName,
    },
    /// More words than a control can count.
    #[error("the map has {found} words, expected 32767 at the most")]
    Words {
        /// How many words it would have.
        found: usize,
    },
    /// Another number of words than the head says.
    #[error("found {found} words, expected {expected}")]
    Count {
        /// How many words there are.
        found: usize,
        /// How many there have to be.
        expected: usize,
    },
    /// The checksum does not fit the words.
    #[error("the checksum does not fit: the map is damaged, or for the machine of another number")]
    Checksum,
}

/// Why a map cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TablesError {
    /// The model cannot answer.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The lines and values make no map.
    #[error(transparent)]
    Map(#[from] NoMap),
    /// A rotary axis among the corrected ones.
    #[error("axis {axis} is rotary: a map corrects linear axes only")]
    Rotary {
        /// The axis.
        axis: AxisName,
    },
    /// An axis of the grid that rolls over.
    #[error(
        "axis {axis} has a modulo: outside its travel of {lower} to {upper} a map holds the value of its end, where the machine \
         has that of the turned position; expected an axis that does not roll over, or a machine file without the modulo where \
         the control tells positions within the travel only"
    )]
    RollsOver {
        /// The axis.
        axis: AxisName,
        /// The lower end of its travel, mm or deg.
        lower: f64,
        /// The upper end of its travel, mm or deg.
        upper: f64,
    },
    /// A step or a bound that is no number above zero, or cannot be told in millionths.
    #[error("{what} is {found}, expected {expected}")]
    Number {
        /// What it is, with the axis where there is one.
        what: String,
        /// The value that was given.
        found: f64,
        /// What was expected, in words.
        expected: &'static str,
    },
    /// A correction beyond what the axis may be given.
    #[error(
        "the correction of {axis} is {found_um:.1} µm {at}, expected {limit_um} µm at the most"
    )]
    BeyondLimit {
        /// The corrected axis.
        axis: AxisName,
        /// The correction.
        found_um: f64,
        /// The limit.
        limit_um: f64,
        /// Where it is, in words.
        at: String,
    },
    /// The bound is finer than what any grid can reach.
    #[error(
        "no grid keeps {within_um} µm: the steps of the values alone leave {rounding_um:.3} µm, and a reversal that is not the same \
         everywhere {reversal_um:.3} µm"
    )]
    Unreachable {
        /// The bound that was asked for.
        within_um: f64,
        /// What rounding the values leaves at the most.
        rounding_um: f64,
        /// What of the reversals is not constant.
        reversal_um: f64,
    },
    /// The bound needs more memory.
    #[error(
        "{within_um} µm need {} ({lines}), expected at most the {words} that there are{}",
        needed.map_or_else(|| "more words than a map can have, 32767".to_owned(), |needed| format!("{needed} words for a map")),
        reached_um.map_or_else(String::new, |um| format!(": with these the error is {um:.3} µm"))
    )]
    Memory {
        /// The bound that was asked for.
        within_um: f64,
        /// The words of one map that the bound needs; `None`: more than 32767.
        needed: Option<usize>,
        /// The lines that it needs, in words.
        lines: String,
        /// The words that there are for one map.
        words: usize,
        /// The error of the best map that the words have room for; `None` where there is room for none.
        reached_um: Option<f64>,
    },
}
