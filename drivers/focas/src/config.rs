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

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shift {
    /// First byte of the shift word of the control's first axis. The shift words of its other axes follow.
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

    /// This area with two-byte words, which is the width of the words in frames to a barrier.
    pub(crate) fn in_words(self) -> Self {
        Self { width: Width::Word, ..self }
    }

    /// Largest shift in either direction that a word of this width can represent, for this kind of axis.
    pub fn largest(&self, kind: AxisKind) -> Displacement {
        let count = self.count(kind).mm_or_rad();
        Displacement::new(kind, count * f64::from(self.width.largest()))
    }
}

/// Configuration of the connection to a control: the address, the axes, and the memory through which corrections are
/// written.
#[derive(Clone, Debug, PartialEq)]
pub struct FocasConfig {
    pub host: String,
    /// TCP port of the control [default: 8193].
    pub port: u16,
    /// Path of the control whose axes are corrected, counted from 1.
    pub path: u16,
    pub channel: String,
    pub axes: Vec<AxisName>,
    /// Axes whose positions are only read. If `axes` is empty, the driver accesses no PMC memory except `referenced`.
    pub reads: Vec<AxisName>,
    pub shift: Shift,
    /// Byte that every correction increments, so that the ladder can detect a stopped gateway; `None` if the ladder
    /// monitors no byte.
    pub heartbeat: Option<PmcAddress>,
    /// Byte that each correction increments after the shifts are written; `None` if there is no such byte. A ladder
    /// that copies the shifts when this byte changes gives all axes their shifts in the same scan.
    pub sequence: Option<PmcAddress>,
    /// Memory of a barrier in the ladder, with its frames and reports. If set, corrections are sent by `post` instead
    /// of `apply`. Heartbeat and sequence byte are then unused, and the driver never writes the words of `shift`, which
    /// belong to the ladder.
    pub barrier: Option<BarrierArea>,
    /// Whether a ladder copies the words of `shift` to the words from which the control takes the shift. If `false`,
    /// the control takes the shift directly from the words of `shift`, and its parameters must name these words.
    pub copied: bool,
    pub positions: PositionKind,
    /// Whether reported positions contain the shift.
    pub includes_correction: bool,
    /// Byte with one bit for each referenced axis. The lowest bit is the control's first axis. `None`: all axes are
    /// assumed to be referenced.
    pub referenced: Option<PmcAddress>,
    /// Timeout for connecting, and for each request before the first cycle.
    pub at_most: Duration,
    /// Delay between two connection attempts.
    pub backoff: Backoff,
}

impl FocasConfig {
    /// Creates a configuration for these axes: shifts in two-byte words of 1 µm and 0.001 deg from R100, a heartbeat at
    /// R120, referenced axes in F120.
    ///
    /// The addresses are examples. Check in the control's manual that a shift from R memory is enabled (parameters
    /// 1203#0 and 1280) and that F120 reports the referenced axes. Both are unverified.
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

    /// Resolution of the reported positions of an axis: 0.001 mm or 0.001 deg, or one count of its shift if that is
    /// coarser.
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
    /// No axis, a duplicate axis, a count that is not positive; or bytes that are not writable, exceed the PMC's
    /// memory, or overlap.
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

    /// The first two overlapping memory blocks of this configuration. `None` if no blocks overlap, or if the
    /// configuration has another error.
    pub fn overlap(&self) -> Option<[Block; 2]> {
        overlap_within(self)
    }

    /// Two overlapping memory blocks, one of each configuration, of which at least one is written. `None` if no such
    /// blocks overlap, or if the configurations are for different controls.
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

/// Memory blocks that the driver uses. `slots` is the number of axes of the control that have a shift word. With a
/// barrier, the ladder writes the shift words, and heartbeat and sequence byte are unused.
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
    // Each entry: key, description, first byte, number of words, bytes per word, whether this driver writes the words.
    for (key, what, at, points, width, written) in [
        ("barrier.frame", FRAME, frame, frame_words, word, true),
        ("barrier.report", REPORT, report, report_words, word, false),
        ("heartbeat", "the heartbeat", heartbeat, 1, byte, true),
        ("sequence", "the sequence byte", sequence, 1, byte, true),
        ("referenced", REFERENCED, config.referenced, 1, byte, false),
        ("area.first", SHIFTS, shifts, slots, width, plain),
    ] {
        let Some(first) = at else { continue };
        // The ladder writes the report, so the report must be in the ladder's memory too.
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

/// Checks the memory blocks. `slots` is the number of axes of the control that have a shift word. The addresses must
/// exist, written bytes must be writable, and no blocks may overlap.
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

/// Memory blocks of a configuration that must not overlap the words from which the control takes its shifts. `slots` is
/// the number of axes of the control that have a shift word. With a barrier the shift words are excluded, because only
/// the control reports where they are.
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
