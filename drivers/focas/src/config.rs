//! How a control is reached and corrected.

use std::time::Duration;

use volcomp_port::{Axis, Backoff, Description, Heartbeat, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, Rad};

use crate::{
    answers::PositionKind,
    error::FocasError,
    pmc::{BarrierArea, Block, PmcAddress, PmcArea, Width},
};

/// Positions have so many mm or deg in their last digit at least.
const THIRD_DECIMAL: f64 = 0.001;

/// Where the machine zero point shift of each axis is written.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shift {
    /// Where the number of the control's first axis stands; those of its other axes follow.
    pub first: PmcAddress,
    /// The number of bytes of each number.
    pub width: Width,
    /// How far one count moves a linear axis.
    pub count_linear: Mm,
    /// How far one count moves a rotary axis.
    pub count_rotary: Rad,
}

impl Shift {
    /// How far one count moves an axis of this kind.
    pub fn count(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => Displacement::Length(self.count_linear),
            AxisKind::Rotary => Displacement::Angle(self.count_rotary),
        }
    }

    /// The same shifts in words of two bytes, as frames to a barrier have them.
    pub(crate) fn in_words(self) -> Self {
        Self {
            width: Width::Word,
            ..self
        }
    }

    /// The largest shift of an axis of this kind, in either direction, that the width can hold.
    pub fn largest(&self, kind: AxisKind) -> Displacement {
        let count = self.count(kind).mm_or_rad();
        Displacement::new(kind, count * f64::from(self.width.largest()))
    }
}

/// How a control is reached and corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct FocasConfig {
    /// The name or address of the control.
    pub host: String,
    /// The port of the control, 8193 as delivered.
    pub port: u16,
    /// The path of the control whose axes are corrected, from 1.
    pub path: u16,
    /// The name of the channel by which corrections get in.
    pub channel: String,
    /// The axes to correct, in channel order.
    pub axes: Vec<AxisName>,
    /// Axes of which only the positions are read. Without `axes` nothing of the PMC is used but `referenced`.
    pub reads: Vec<AxisName>,
    /// Where corrections are written.
    pub shift: Shift,
    /// The byte that every correction moves on, for the ladder to watch; `None` where nobody watches.
    pub heartbeat: Option<PmcAddress>,
    /// The byte that is written last in every correction and counts up: where a ladder copies the shifts on, it
    /// does so when this byte has changed, and so takes all axes together.
    pub sequence: Option<PmcAddress>,
    /// Where frames go to a barrier in the ladder and its reports come from. Corrections are then handed over by
    /// `post` and not by `apply`; heartbeat and sequence byte are not used, and the words of `shift` belong to the
    /// ladder: the driver never writes them.
    pub barrier: Option<BarrierArea>,
    /// Whether a ladder copies the words of `shift` on to others, from which the control takes the shift; otherwise the
    /// control takes it from those words themselves, and its parameters must say so.
    pub copied: bool,
    /// In which coordinates positions are read.
    pub positions: PositionKind,
    /// Whether the positions that the control tells contain the shift.
    pub includes_correction: bool,
    /// The byte whose bits say which axes are referenced, the control's first axis lowest; `None` where
    /// they are taken to be referenced.
    pub referenced: Option<PmcAddress>,
    /// The longest time for making a connection, and for each question before the first cycle.
    pub at_most: Duration,
    /// The time between two tries to connect.
    pub backoff: Backoff,
}

impl FocasConfig {
    /// Shifts in words of 1 µm and 0.001 deg from R100 on, a heartbeat at R120, referenced axes in F120.
    ///
    /// The addresses are examples; that a shift from R memory is enabled (parameters 1203#0 and 1280) and
    /// that F120 tells the referenced axes is not proven: read the control's manual.
    pub fn new(host: impl Into<String>, axes: &[AxisName]) -> Self {
        let address = |area, at| PmcAddress { area, at };
        Self {
            host: host.into(),
            port: 8193,
            path: 1,
            channel: "emzps".to_owned(),
            axes: axes.to_vec(),
            reads: Vec::new(),
            shift: Shift {
                first: address(PmcArea::R, 100),
                width: Width::Word,
                count_linear: Mm(0.001),
                count_rotary: Deg(0.001).to_rad(),
            },
            heartbeat: Some(address(PmcArea::R, 120)),
            sequence: None,
            barrier: None,
            copied: false,
            positions: PositionKind::Machine,
            includes_correction: false,
            referenced: Some(address(PmcArea::F, 120)),
            at_most: Duration::from_secs(2),
            backoff: Backoff::default(),
        }
    }

    /// The smallest step of the positions that the control tells of an axis: the third decimal of mm and deg, or the count
    /// of its corrections, where that is coarser.
    pub fn position_step(&self, name: AxisName) -> Displacement {
        let decimal = match name.kind() {
            AxisKind::Linear => THIRD_DECIMAL,
            AxisKind::Rotary => Deg(THIRD_DECIMAL).to_rad().0,
        };
        let count = self.shift.count(name.kind()).mm_or_rad();
        Displacement::new(name.kind(), decimal.max(count))
    }

    /// The device as messages name it.
    pub fn device(&self) -> String {
        format!("focas://{}:{}", self.host, self.port)
    }

    /// The description of the controller that this configuration makes, without connecting.
    ///
    /// # Errors
    /// No axis, an axis that stands twice, a count that moves an axis by no positive distance; bytes that cannot be
    /// written, lie beyond the end of the PMC's memory, or within one another.
    pub fn describe(&self) -> Result<Description, FocasError> {
        let axis = |&name: &AxisName| Axis {
            name,
            includes_correction: self.includes_correction,
            resolution: self.shift.count(name.kind()),
            largest: Some(match self.barrier {
                None => self.shift.largest(name.kind()),
                Some(_) => self.shift.in_words().largest(name.kind()),
            }),
        };
        let description = Description {
            device: self.device(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            reads: self.reads.clone(),
            heartbeat: if self.barrier.is_some() || self.heartbeat.is_some() {
                Heartbeat::Watched
            } else {
                Heartbeat::Unwatched
            },
            barrier: self.barrier.is_some(),
            tells_applied: !self.axes.is_empty(),
            shown: ShownStates {
                referenced: self.referenced.is_some(),
                ..ShownStates::ALL
            },
            sees_other_gateways: self.barrier.is_some() || self.heartbeat.is_some(),
            shortest_cycle: Duration::from_millis(1),
        };
        description.check()?;
        let is_direct = self.barrier.is_none() && !self.copied;
        if is_direct && self.shift.width != Width::Word {
            return Err(FocasError::Width(self.shift.width));
        }
        check(self, self.axes.len())?;
        Ok(description)
    }

    /// Two blocks of the control's memory that this configuration uses and that share a byte; `None` where all lie apart, or
    /// the configuration is wrong otherwise.
    pub fn overlap(&self) -> Option<[Block; 2]> {
        overlap_within(self)
    }

    /// A block of this configuration and one of another for the same control that share a byte which one of them writes;
    /// `None` where they leave each other's bytes alone, or are of different controls.
    pub fn overlap_with(&self, other: &Self) -> Option<[Block; 2]> {
        let is_same = self.host.eq_ignore_ascii_case(&other.host) && self.port == other.port;
        is_same.then(|| overlap_between(self, other)).flatten()
    }
}

#[derive(Clone, Copy)]
struct Used {
    block: Block,
    /// Whether this driver writes it.
    written: bool,
}

const SHIFTS: &str = "the words of the shifts";
const FRAME: &str = "the words of the frame";
const REPORT: &str = "the words of the report";
const REFERENCED: &str = "the byte of the referenced axes";

/// The blocks of a configuration whose shift words belong to so many axes of the control. Where frames go to a
/// barrier, the words of the shifts belong to the ladder, and there is neither a heartbeat nor a sequence byte.
fn used(config: &FocasConfig, slots: usize) -> Result<Vec<Used>, FocasError> {
    let axes = config.axes.len();
    let plain = config.barrier.is_none();
    let [frame_words, report_words] = [
        BarrierArea::frame_words(axes),
        BarrierArea::report_words(axes),
    ];
    let (frame, report) = (
        config.barrier.map(|it| it.frame),
        config.barrier.map(|it| it.report),
    );
    let [heartbeat, sequence] = [config.heartbeat, config.sequence].map(|at| at.filter(|_| plain));
    let Shift { first, width, .. } = config.shift;
    let shifts = (axes > 0).then_some(first);
    let (byte, word) = (Width::Byte, Width::Word);
    let mut found = Vec::new();
    // Key, what it is, first byte, words and their width, whether this driver writes them.
    for (key, what, at, points, width, written) in [
        ("barrier.frame", FRAME, frame, frame_words, word, true),
        ("barrier.report", REPORT, report, report_words, word, false),
        ("heartbeat", "the heartbeat", heartbeat, 1, byte, true),
        ("sequence", "the sequence byte", sequence, 1, byte, true),
        ("referenced", REFERENCED, config.referenced, 1, byte, false),
        ("area.first", SHIFTS, shifts, slots, width, plain),
    ] {
        let Some(first) = at else { continue };
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
        let block = Block {
            key,
            what,
            first,
            last: PmcAddress { at: last, ..first },
        };
        found.push(Used { block, written });
    }
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
fn overlap_within(config: &FocasConfig) -> Option<[Block; 2]> {
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
fn overlap_between(one: &FocasConfig, other: &FocasConfig) -> Option<[Block; 2]> {
    let blocks = |config: &FocasConfig| used(config, config.axes.len()).unwrap_or_default();
    let (ours, theirs) = (blocks(one), blocks(other));
    let pairs = ours
        .iter()
        .flat_map(|one| theirs.iter().map(move |other| [one, other]));
    let mut written = pairs.filter(|pair| pair.iter().any(|used| used.written));
    let found = written.find(|[one, other]| one.block.shared(&other.block).is_some())?;
    Some(found.map(|used| used.block))
}
