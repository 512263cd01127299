//! The datagram that the bridge sends in every servo cycle.

use std::{fmt, time::Duration};

use volcomp_port::{MOST_WORDS, Words};
use volcomp_vocabulary::{AxisName, MAX_AXES};

use crate::{
    DatagramError, Key, VERSION,
    datagram::{Reader, Writer, opened},
    key::MAC,
};

const MAGIC: [u8; 4] = *b"VCLS";
const HEADER_BYTES: usize = 36;
const BYTES_PER_AXIS: usize = 32;

/// Maximum size of a state, bytes.
pub const STATE_BYTES: usize = HEADER_BYTES + MAX_AXES * BYTES_PER_AXIS + 2 * MOST_WORDS + MAC;

/// Operating state of the control, as a bit mask of the constants of this type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u16);

impl Flags {
    pub const EMERGENCY_STOP: u16 = 1;
    /// The machine is on, that is, motion is enabled.
    pub const ENABLED: u16 = 1 << 1;
    /// Every joint is homed.
    pub const HOMED: u16 = 1 << 2;
    /// The control has limited an offset at a soft limit (`motion.eoffset-limited`).
    pub const LIMITED: u16 = 1 << 3;
    /// The control is probing. Probed positions contain the offset.
    pub const PROBING: u16 = 1 << 4;
    /// The control's offset differs from the bridge's request, because the control has absorbed the offset into its
    /// position, cleared it or frozen it. The bridge holds for a second, and then continues from the actual offset.
    pub const LOST: u16 = 1 << 5;

    /// All flags, in the order of the protocol's table.
    pub const ALL: [Flag; 6] = [
        Flag::new(Self::EMERGENCY_STOP, "EMERGENCY_STOP", "emergency stop", ""),
        Flag::new(Self::ENABLED, "ENABLED", "on", "off"),
        Flag::new(Self::HOMED, "HOMED", "homed", "not homed"),
        Flag::new(Self::LIMITED, "LIMITED", "offset cut at a soft limit", ""),
        Flag::new(Self::PROBING, "PROBING", "probing", ""),
        Flag::new(
            Self::LOST,
            "LOST",
            "an offset is lost, not reached, or does not move in this mode",
            "",
        ),
    ];

    /// Whether any of the flags in `flag` is set.
    #[must_use]
    pub fn has(self, flag: u16) -> bool {
        self.0 & flag != 0
    }
}

/// Formats the texts of all flags, separated by commas: `on, homed, probing`.
impl fmt::Display for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words =
            Self::ALL.iter().map(|flag| if self.has(flag.bit) { flag.set } else { flag.unset });
        for (at, word) in words.filter(|word| !word.is_empty()).enumerate() {
            let before = if at == 0 { "" } else { ", " };
            write!(f, "{before}{word}")?;
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flag {
    /// Mask with the bit of the flag.
    pub bit: u16,
    /// Name in the protocol.
    pub name: &'static str,
    /// Text to show if the flag is set.
    pub set: &'static str,
    /// Text to show if the flag is not set; empty for no text.
    pub unset: &'static str,
}

impl Flag {
    const fn new(bit: u16, name: &'static str, set: &'static str, unset: &'static str) -> Self {
        Self { bit, name, set, unset }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisState {
    pub name: AxisName,
    /// Size of one count of the barrier, nm or millionths of a degree.
    pub step: u32,
    /// Commanded position without the offset (`axis.L.pos-cmd`), mm or deg.
    pub position: f64,
    /// Commanded velocity, mm/s or deg/s.
    pub velocity: f64,
    /// Offset that the control's planner has reached (`axis.L.eoffset`), nm or millionths of a degree.
    pub offset: i64,
}

/// A state of the control, as the bridge reports it in every servo cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    pub machine: u16,
    /// Random number that the bridge draws when it starts.
    pub run: u32,
    /// Number of the state since the start of the bridge. It wraps.
    pub sequence: u32,
    pub flags: Flags,
    /// Time on the monotonic clock of the bridge's computer at which the positions were sampled.
    pub time: Duration,
    /// Scan period of the barrier.
    pub scan: Duration,
    /// The first elements are the axes; the rest is `None`.
    axes: [Option<AxisState>; MAX_AXES],
    /// Report of the barrier. It has its own checksum.
    pub report: Words,
}

impl State {
    /// Creates a state with these axes and zeros elsewhere; `None` if there are more than [`MAX_AXES`].
    #[must_use]
    pub fn of(axes: &[AxisState]) -> Option<Self> {
        let mut room = [None; MAX_AXES];
        for (place, axis) in room.get_mut(..axes.len())?.iter_mut().zip(axes) {
            *place = Some(*axis);
        }
        Some(Self {
            machine: 0,
            run: 0,
            sequence: 0,
            flags: Flags::default(),
            time: Duration::ZERO,
            scan: Duration::ZERO,
            axes: room,
            report: Words::EMPTY,
        })
    }

    /// The axes in the order of the report's words.
    pub fn axes(&self) -> impl Iterator<Item = &AxisState> {
        self.axes.iter().map_while(Option::as_ref)
    }

    /// Decodes a state from a datagram.
    ///
    /// # Errors
    /// A datagram that is not a state of this version and key.
    pub fn decode(bytes: &[u8], key: &Key) -> Result<Self, DatagramError> {
        let body = opened(bytes, MAGIC, HEADER_BYTES, key)?;
        let mut reader = Reader(&body[5..]);
        let count = usize::from(reader.u8());
        let machine = reader.u16();
        let (run, sequence) = (reader.u32(), reader.u32());
        let flags = Flags(reader.u16());
        let words = usize::from(reader.u16());
        let nanos = u64::from_le_bytes(reader.take());
        let scan = Duration::from_nanos(reader.u32().into());
        // These bytes are reserved for later versions of the protocol.
        reader.take::<4>();
        if count > MAX_AXES {
            return Err(DatagramError::Axes { found: count });
        }
        if words > MOST_WORDS {
            return Err(DatagramError::Words { found: words });
        }
        let expected = HEADER_BYTES + count * BYTES_PER_AXIS + 2 * words + MAC;
        if bytes.len() != expected {
            let found = bytes.len();
            return Err(DatagramError::Length { found, expected });
        }
        let mut axes = [None; MAX_AXES];
        for index in 0..count {
            let axis = axis(&mut reader)?;
            let twice = axes[..index].iter().flatten();
            if twice.map(|before: &AxisState| before.name).any(|name| name == axis.name) {
                let found = u8::try_from(axis.name.letter()).unwrap_or(0);
                return Err(DatagramError::Letter { found });
            }
            axes[index] = Some(axis);
        }
        let mut report = [0; MOST_WORDS];
        for word in &mut report[..words] {
            *word = reader.u16();
        }
        Ok(Self {
            machine,
            run,
            sequence,
            flags,
            time: Duration::from_nanos(nanos),
            scan,
            axes,
            // The length was checked above, so the words fit.
            report: Words::new(&report[..words]).unwrap_or_default(),
        })
    }

    /// Encodes the state in `bytes`, with its authentication code, and returns the length of the datagram in bytes.
    pub fn encode(&self, key: &Key, bytes: &mut [u8; STATE_BYTES]) -> usize {
        let words = self.report.as_slice();
        // Both numbers fit, because their maxima are small.
        let count = u8::try_from(self.axes().count()).unwrap_or(0);
        let length = u16::try_from(words.len()).unwrap_or(0);
        let mut writer = Writer::new(bytes);
        writer.put(&MAGIC);
        writer.put(&[VERSION, count]);
        writer.put(&self.machine.to_le_bytes());
        writer.put(&self.run.to_le_bytes());
        writer.put(&self.sequence.to_le_bytes());
        writer.put(&self.flags.0.to_le_bytes());
        writer.put(&length.to_le_bytes());
        let nanos = u64::try_from(self.time.as_nanos()).unwrap_or(u64::MAX);
        writer.put(&nanos.to_le_bytes());
        let scan = u32::try_from(self.scan.as_nanos()).unwrap_or(u32::MAX);
        writer.put(&scan.to_le_bytes());
        writer.put(&[0; 4]);
        for axis in self.axes() {
            let letter = u8::try_from(axis.name.letter()).unwrap_or(0);
            writer.put(&[letter, 0, 0, 0]);
            writer.put(&axis.step.to_le_bytes());
            writer.put(&axis.position.to_le_bytes());
            writer.put(&axis.velocity.to_le_bytes());
            writer.put(&axis.offset.to_le_bytes());
        }
        for word in words {
            writer.put(&word.to_le_bytes());
        }
        writer.seal(key)
    }
}

fn axis(reader: &mut Reader<'_>) -> Result<AxisState, DatagramError> {
    let found = reader.u8();
    reader.take::<3>();
    let name = AxisName::from_letter(char::from(found)).ok_or(DatagramError::Letter { found })?;
    let axis = AxisState {
        name,
        step: reader.u32(),
        position: f64::from_le_bytes(reader.take()),
        velocity: f64::from_le_bytes(reader.take()),
        offset: i64::from_le_bytes(reader.take()),
    };
    let sensible = axis.step > 0 && axis.position.is_finite() && axis.velocity.is_finite();
    sensible.then_some(axis).ok_or(DatagramError::Number { axis: name })
}
