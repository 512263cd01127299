//! Which bytes of the PMC's memory a configuration uses, and which of them must lie apart.

use std::fmt;

use crate::{
    config::{FocasConfig, Shift},
    error::FocasError,
    pmc::{PmcAddress, Width},
};

/// Where frames and reports of a barrier lie in the memory of the PMC. Both are words of two bytes, one after the other,
/// the low byte first, as the PMC keeps numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BarrierArea {
    /// The first byte of the frame, which the driver writes and the ladder reads.
    pub frame: PmcAddress,
    /// The first byte of the report, which the ladder writes and the driver reads.
    pub report: PmcAddress,
}

impl BarrierArea {
    /// The number of words of a frame for so many axes: epoch, tick, sequence, owner, a value for each axis, two of a checksum.
    pub const fn frame_words(axes: usize) -> usize {
        4 + axes + 2
    }

    /// The number of words of a report for so many axes: a head of eight, three for each axis, two of a checksum.
    pub const fn report_words(axes: usize) -> usize {
        8 + 3 * axes + 2
    }
}

/// Bytes of the PMC's memory that belong together, and what they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// The key of a configuration that says where they are: `area.first`, `heartbeat`, `sequence`, `referenced`,
    /// `barrier.frame` or `barrier.report`. Empty where the control says it.
    pub key: &'static str,
    /// What the bytes are for, in words.
    pub what: &'static str,
    /// The first byte.
    pub first: PmcAddress,
    /// The last byte.
    pub last: PmcAddress,
}

impl Block {
    /// The first byte that both have; `None` where they lie apart.
    pub fn shared(&self, other: &Self) -> Option<PmcAddress> {
        let at = self.first.at.max(other.first.at);
        let is_in_both =
            self.first.area == other.first.area && at <= self.last.at && at <= other.last.at;
        is_in_both.then_some(PmcAddress { at, ..self.first })
    }
}

impl fmt::Display for Block {
    /// What it is and where it lies: `the words of the shifts R100 to R105`, `the heartbeat R120`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.what, self.first)?;
        if self.last != self.first {
            write!(f, " to {}", self.last)?;
        }
        Ok(())
    }
}

/// A block of a configuration.
#[derive(Clone, Copy)]
struct Used {
    block: Block,
    /// Whether this driver writes it.
    written: bool,
}

/// The words of the shifts.
const SHIFTS: &str = "the words of the shifts";
/// The words of the frame.
const FRAME: &str = "the words of the frame";
/// The words of the report.
const REPORT: &str = "the words of the report";

/// The blocks of a configuration whose shift words belong to so many axes of the control. Where frames go to a
/// barrier, the words of the shifts belong to the ladder, and there is neither a heartbeat nor a sequence byte.
fn used(config: &FocasConfig, slots: usize) -> Result<Vec<Used>, FocasError> {
    let axes = config.axes.len();
    let plain = config.barrier.is_none();
    let mut found = Vec::new();
    let mut take = |key, what, at: Option<PmcAddress>, points: usize, width: Width, written| {
        let Some(first) = at else { return Ok(()) };
        // The report is written by the ladder.
        if (written || what == REPORT) && !first.area.is_of_ladder() {
            return Err(FocasError::NotWritable { key, at: first });
        }
        let bytes = u16::try_from(points)
            .unwrap_or(u16::MAX)
            .saturating_mul(width.bytes());
        let last = first.at.checked_add(bytes.saturating_sub(1));
        let last = last.ok_or(FocasError::BeyondEnd {
            key,
            first,
            points,
            bytes: width.bytes(),
        })?;
        let last = PmcAddress { at: last, ..first };
        let block = Block {
            key,
            what,
            first,
            last,
        };
        found.push(Used { block, written });
        Ok(())
    };
    if let Some(BarrierArea { frame, report }) = config.barrier {
        let [frame_words, report_words] = [
            BarrierArea::frame_words(axes),
            BarrierArea::report_words(axes),
        ];
        take(
            "barrier.frame",
            FRAME,
            Some(frame),
            frame_words,
            Width::Word,
            true,
        )?;
        take(
            "barrier.report",
            REPORT,
            Some(report),
            report_words,
            Width::Word,
            false,
        )?;
    }
    if plain {
        let (heartbeat, sequence) = (config.heartbeat, config.sequence);
        take(
            "heartbeat",
            "the heartbeat",
            heartbeat,
            1,
            Width::Byte,
            true,
        )?;
        take(
            "sequence",
            "the sequence byte",
            sequence,
            1,
            Width::Byte,
            true,
        )?;
    }
    let referenced = config.referenced;
    let what = "the byte of the referenced axes";
    take("referenced", what, referenced, 1, Width::Byte, false)?;
    let Shift { first, width, .. } = config.shift;
    let first = (axes > 0).then_some(first);
    take("area.first", SHIFTS, first, slots, width, plain)?;
    Ok(found)
}

/// Checks the words of a control's first `slots` axes, frame and report, and the bytes with a meaning of their own: what
/// is written may be written and exists, and none lies within another.
pub(crate) fn check(config: &FocasConfig, slots: usize) -> Result<(), FocasError> {
    match overlap(&used(config, slots)?) {
        Some([one, other]) => Err(FocasError::Overlap { one, other }),
        None => Ok(()),
    }
}

/// The first two blocks of a configuration that share a byte.
pub(crate) fn overlap_within(config: &FocasConfig) -> Option<[Block; 2]> {
    overlap(&used(config, config.axes.len()).ok()?)
}

fn overlap(blocks: &[Used]) -> Option<[Block; 2]> {
    let pairs = (blocks.iter().enumerate())
        .flat_map(|(index, one)| blocks[index + 1..].iter().map(move |other| [one, other]));
    let mut pairs = pairs.map(|pair| pair.map(|used| used.block));
    pairs.find(|[one, other]| one.shared(other).is_some())
}

/// Refuses two blocks that share a byte.
pub(crate) fn apart(one: &Block, other: &Block) -> Result<(), FocasError> {
    one.shared(other).map_or(Ok(()), |_| {
        Err(FocasError::Overlap {
            one: *one,
            other: *other,
        })
    })
}

/// The blocks of a configuration that the control must not take for shifts of its axes: where a ladder stands between
/// them, all but those words of a barrier's ladder that are only known from the control.
pub(crate) fn without_axis_words(
    config: &FocasConfig,
    slots: usize,
) -> Result<Vec<Block>, FocasError> {
    let of_ladder = |block: &Block| config.barrier.is_some() && block.what == SHIFTS;
    let blocks = used(config, slots)?.into_iter().map(|used| used.block);
    Ok(blocks.filter(|block| !of_ladder(block)).collect())
}

/// The first block of each of two configurations that share a byte which one of them writes; `None` where they leave each
/// other alone.
pub(crate) fn overlap_between(one: &FocasConfig, other: &FocasConfig) -> Option<[Block; 2]> {
    let blocks = |config: &FocasConfig| used(config, config.axes.len()).unwrap_or_default();
    let (ours, theirs) = (blocks(one), blocks(other));
    let pairs = ours
        .iter()
        .flat_map(|one| theirs.iter().map(move |other| [one, other]));
    let mut written = pairs.filter(|pair| pair.iter().any(|used| used.written));
    let found = written.find(|[one, other]| one.block.shared(&other.block).is_some())?;
    Some(found.map(|used| used.block))
}
