use std::time::Duration;

use volcomp_port::{Axis, Backoff, Description, Heartbeat, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, Rad};

use crate::{
    answers::PositionKind,
    error::FocasError,
    pmc::{BarrierArea, Block, PmcAddress, PmcArea, Width},
};

/// Assumed resolution of the positions that a control reports, mm or deg.
const POSITION_STEP: f64 = 0.001;

/// PMC words to which the machine zero point shifts of the axes are written.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shift {
    /// First byte of the word for the control's first axis; the words of its other axes follow.
    pub first: PmcAddress,
    pub width: Width,
    pub count_linear: Mm,
    pub count_rotary: Rad,
}

impl Shift {
    /// Displacement by one count for this kind of axis.
    pub fn count(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => Displacement::Length(self.count_linear),
            AxisKind::Rotary => Displacement::Angle(self.count_rotary),
        }
    }

    /// The same shifts in two-byte words, the width in frames to a barrier.
    pub(crate) fn in_words(self) -> Self {
        Self { width: Width::Word, ..self }
    }

    /// Largest shift, in either direction, of an axis of this kind that a word of this width holds.
    pub fn largest(&self, kind: AxisKind) -> Displacement {
        let count = self.count(kind).mm_or_rad();
        Displacement::new(kind, count * f64::from(self.width.largest()))
    }
}

/// Configuration of a control: its connection, the axes, and the memory through which corrections are written.
#[derive(Clone, Debug, PartialEq)]
pub struct FocasConfig {
    pub host: String,
    /// TCP port of the control, 8193 by default.
    pub port: u16,
    /// Path of the control whose axes are corrected, from 1.
    pub path: u16,
    pub channel: String,
    /// The axes to correct, in channel order.
    pub axes: Vec<AxisName>,
    /// Axes whose positions are only read. If `axes` is empty, `referenced` is the only PMC memory that the driver accesses.
    pub reads: Vec<AxisName>,
    pub shift: Shift,
    /// Byte that every correction increments and the ladder monitors; `None`: the ladder monitors nothing.
    pub heartbeat: Option<PmcAddress>,
    /// Byte that each correction increments after the shifts are written. A ladder that copies the shifts when this byte changes gives
    /// all axes their shifts in the same scan. `None`: no such byte.
    pub sequence: Option<PmcAddress>,
    /// Memory of a barrier in the ladder: its frames and reports. If set, corrections are sent by `post`, not by `apply`; heartbeat and
    /// sequence byte are unused, and the driver never writes the words of `shift`, which belong to the ladder.
    pub barrier: Option<BarrierArea>,
    /// Whether a ladder copies the words of `shift` to those from which the control takes the shift. If not, the control takes the shift from
    /// the words of `shift`, and its parameters must agree.
    pub copied: bool,
    /// Coordinate system in which positions are read.
    pub positions: PositionKind,
    /// Whether reported positions contain the shift.
    pub includes_correction: bool,
    /// Byte with one bit for each referenced axis, the lowest for the control's first axis; `None`: all axes are assumed to be referenced.
    pub referenced: Option<PmcAddress>,
    /// Timeout for connecting, and for each request until the first cycle.
    pub at_most: Duration,
    /// Delay between two connection attempts.
    pub backoff: Backoff,
}

impl FocasConfig {
    /// A configuration for these axes: shifts in two-byte words of 1 µm and 0.001 deg from R100, a heartbeat at R120, referenced axes in F120.
    ///
    /// The addresses are examples. It is unverified that a shift from R memory is enabled (parameters 1203#0 and 1280) and that F120
    /// reports the referenced axes: see the control's manual.
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

    /// Resolution of the reported positions of an axis: 0.001 mm or 0.001 deg, or one count of its shift if that is coarser.
    pub fn position_step(&self, name: AxisName) -> Displacement {
        let decimal = match name.kind() {
            AxisKind::Linear => POSITION_STEP,
            AxisKind::Rotary => Deg(POSITION_STEP).to_rad().0,
        };
        let count = self.shift.count(name.kind()).mm_or_rad();
        Displacement::new(name.kind(), decimal.max(count))
    }

    /// Name of the device in messages.
    pub fn device(&self) -> String {
        format!("focas://{}:{}", self.host, self.port)
    }

    /// Describes the controller with this configuration, without connecting.
    ///
    /// # Errors
    /// No axis, a duplicate axis, a count that is not positive; bytes that are not writable, exceed the PMC's memory, or overlap.
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
            shown: ShownStates { referenced: self.referenced.is_some(), ..ShownStates::ALL },
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

    /// The first two overlapping memory blocks of this configuration; `None` if no blocks overlap, or if the configuration has another
    /// error.
    pub fn overlap(&self) -> Option<[Block; 2]> {
        overlap_within(self)
    }

    /// Two overlapping memory blocks, one of each configuration, at least one of them written; `None` if no blocks overlap, or if the
    /// configurations are for different controls.
    pub fn overlap_with(&self, other: &Self) -> Option<[Block; 2]> {
        let is_same = self.host.eq_ignore_ascii_case(&other.host) && self.port == other.port;
        is_same.then(|| overlap_between(self, other)).flatten()
    }
}

#[derive(Clone, Copy)]
struct MemoryUse {
    block: Block,
    written: bool,
}

const SHIFTS: &str = "the words of the shifts";
const FRAME: &str = "the words of the frame";
const REPORT: &str = "the words of the report";
const REFERENCED: &str = "the byte of the referenced axes";

/// Memory blocks that the driver uses, with shift words for `slots` axes of the control. With a barrier, the ladder writes the shift
/// words, and heartbeat and sequence byte are unused.
fn used(config: &FocasConfig, slots: usize) -> Result<Vec<MemoryUse>, FocasError> {
    let axes = config.axes.len();
    let plain = config.barrier.is_none();
    let [frame_words, report_words] =
        [BarrierArea::frame_words(axes), BarrierArea::report_words(axes)];
    let (frame, report) = (config.barrier.map(|it| it.frame), config.barrier.map(|it| it.report));
    let [heartbeat, sequence] = [config.heartbeat, config.sequence].map(|at| at.filter(|_| plain));
    let Shift { first, width, .. } = config.shift;
    let shifts = (axes > 0).then_some(first);
    let (byte, word) = (Width::Byte, Width::Word);
    let mut found = Vec::new();
    // Key, description, first byte, number of words, their width in bytes, whether this driver writes them.
    for (key, what, at, points, width, written) in [
        ("barrier.frame", FRAME, frame, frame_words, word, true),
        ("barrier.report", REPORT, report, report_words, word, false),
        ("heartbeat", "the heartbeat", heartbeat, 1, byte, true),
        ("sequence", "the sequence byte", sequence, 1, byte, true),
        ("referenced", REFERENCED, config.referenced, 1, byte, false),
        ("area.first", SHIFTS, shifts, slots, width, plain),
    ] {
        let Some(first) = at else { continue };
        // The ladder writes the report.
        if (written || what == REPORT) && !first.area.is_of_ladder() {
            return Err(FocasError::NotWritable { key, at: first });
        }
        let bytes = u16::try_from(points).unwrap_or(u16::MAX).saturating_mul(width.bytes());
        let last = first.at.checked_add(bytes.saturating_sub(1));
        let last =
            last.ok_or(FocasError::BeyondEnd { key, first, points, bytes: width.bytes() })?;
        let block = Block { key, what, first, last: PmcAddress { at: last, ..first } };
        found.push(MemoryUse { block, written });
    }
    Ok(found)
}

/// Checks the memory blocks, with shift words for `slots` axes of the control: the addresses must exist, written bytes must be writable, and
/// no blocks may overlap.
pub(crate) fn check(config: &FocasConfig, slots: usize) -> Result<(), FocasError> {
    match overlap(&used(config, slots)?) {
        Some([one, other]) => Err(FocasError::Overlap { one, other }),
        None => Ok(()),
    }
}

fn overlap_within(config: &FocasConfig) -> Option<[Block; 2]> {
    overlap(&used(config, config.axes.len()).ok()?)
}

fn overlap(blocks: &[MemoryUse]) -> Option<[Block; 2]> {
    let pairs = (blocks.iter().enumerate())
        .flat_map(|(index, one)| blocks[index + 1..].iter().map(move |other| [one, other]));
    let mut pairs = pairs.map(|pair| pair.map(|used| used.block));
    pairs.find(|[one, other]| one.shared(other).is_some())
}

pub(crate) fn check_disjoint(one: &Block, other: &Block) -> Result<(), FocasError> {
    one.shared(other).map_or(Ok(()), |_| Err(FocasError::Overlap { one: *one, other: *other }))
}

/// Memory blocks of a configuration, with shift words for `slots` axes: the control must not be set
/// to read its shifts there if a ladder copies them. With a barrier the shift words are excluded,
/// because only the control reports where they are.
pub(crate) fn without_axis_words(
    config: &FocasConfig,
    slots: usize,
) -> Result<Vec<Block>, FocasError> {
    let of_ladder = |block: &Block| config.barrier.is_some() && block.what == SHIFTS;
    let blocks = used(config, slots)?.into_iter().map(|used| used.block);
    Ok(blocks.filter(|block| !of_ladder(block)).collect())
}

fn overlap_between(one: &FocasConfig, other: &FocasConfig) -> Option<[Block; 2]> {
    let blocks = |config: &FocasConfig| used(config, config.axes.len()).unwrap_or_default();
    let (ours, theirs) = (blocks(one), blocks(other));
    let pairs = ours.iter().flat_map(|one| theirs.iter().map(move |other| [one, other]));
    let mut written = pairs.filter(|pair| pair.iter().any(|used| used.written));
    let found = written.find(|[one, other]| one.block.shared(&other.block).is_some())?;
    Some(found.map(|used| used.block))
}
