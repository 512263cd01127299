//! Map of the corrections over the work space, in 16-bit words: its header, its values, and the control's look-up.

use volcomp_guard::protocol::{Layout, checksum};
use volcomp_vocabulary::{AxisName, Direction};

/// Maximum number of input axes of a map.
pub const GRID_AXES: usize = 5;
/// Maximum number of corrected axes, one per direction in space.
pub const OUTPUTS: usize = 3;
/// Number of header words, which precede the values.
pub const HEADER_WORDS: usize = 68;
/// Maximum number of words of a map: indices are 15-bit numbers, which every control supports.
pub const MAX_WORDS: usize = 32767;
/// Maximum and minimum number of parts into which an output step is divided.
pub const SCALES: [u16; 2] = [64, 1];
/// Maximum magnitude of a line position, position steps.
pub(crate) const MAX_POSITION_STEPS: i32 = 1_000_000_000;

const MAGIC: u16 = 0x564D;
const VERSION: u16 = 1;
const AXES_AT: usize = 11;
const AXIS_WORDS: usize = 7;
const REVERSAL_AT: usize = AXES_AT + AXIS_WORDS * GRID_AXES;
const STEPS_AT: usize = REVERSAL_AT + GRID_AXES * OUTPUTS;

/// Grid lines along one axis. Adjacent lines are `part`·`parts` position steps apart; the control interpolates at `parts` places between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Lines {
    /// Position of the first line, position steps.
    pub origin: i32,
    /// Position steps per place of interpolation, 1 to 32767.
    pub part: u16,
    /// Number of places of interpolation per pitch, 1 to 32767.
    pub parts: u16,
    /// Number of lines, 2 to 32767.
    pub count: u16,
    /// Position step, millionths of a mm (nm) or of a deg.
    pub step_millionths: u32,
}

impl Lines {
    /// Distance between lines, position steps.
    #[must_use]
    pub fn pitch(&self) -> i32 {
        i32::from(self.part) * i32::from(self.parts)
    }

    /// Position of a line, mm or deg.
    #[must_use]
    pub fn at(&self, line: u16) -> f64 {
        self.coordinate(f64::from(self.origin) + f64::from(line) * f64::from(self.pitch()))
    }

    /// Converts position steps to mm or deg.
    pub(crate) fn coordinate(&self, steps: f64) -> f64 {
        steps * f64::from(self.step_millionths) * 1e-6
    }

    fn fits(&self) -> bool {
        let within = 1..=32767;
        within.contains(&self.part)
            && within.contains(&self.parts)
            && (2..=32767).contains(&self.count)
            && (-MAX_POSITION_STEPS..=MAX_POSITION_STEPS).contains(&self.origin)
            && i32::from(self.count) - 1 <= MAX_POSITION_STEPS / self.pitch()
            && self.step_millionths > 0
    }
}

/// Axes, grid lines, reversal values and steps of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Number that distinguishes the map from others; never 0.
    pub counter: u16,
    /// First 32 bits of the checksum of the machine file.
    pub model: u32,
    /// Input axes; the first varies slowest in the values.
    pub grid: Layout,
    /// Corrected axes.
    pub outputs: Layout,
    /// Number of parts per output step, 1 to 64.
    pub scale: u16,
    /// Lines along each input axis.
    pub lines: [Lines; GRID_AXES],
    /// Half the reversal value, in parts: added to each output after positive motion of an input axis, subtracted after negative motion.
    pub reversal: [[i16; OUTPUTS]; GRID_AXES],
    /// Step of each output, nm.
    pub output_step_nm: [u32; OUTPUTS],
}

/// Axes of a layout, in order.
pub fn axes_of(layout: Layout) -> impl Iterator<Item = AxisName> {
    let (count, number) = (layout.count(), layout.number());
    (0..count).filter_map(move |place| {
        let digit = number / 10_u32.pow(u32::try_from(count - 1 - place).ok()?) % 10;
        AxisName::ALL.get(usize::try_from(digit).ok()?.checked_sub(1)?).copied()
    })
}

impl Header {
    /// Number of values of the map.
    #[must_use]
    pub fn values(&self) -> usize {
        let lines = self.lines.iter().take(self.grid.count());
        lines.fold(self.outputs.count(), |count, lines| count.saturating_mul(lines.count.into()))
    }

    /// Number of words of the whole map.
    #[must_use]
    pub fn words(&self) -> usize {
        self.values().saturating_add(HEADER_WORDS)
    }

    /// Checks that a control can use a map with this header.
    ///
    /// # Errors
    /// A number is out of the range of the control's arithmetic.
    pub fn check(&self) -> Result<(), MapError> {
        let lines = self.lines.iter().take(self.grid.count());
        if self.grid.count() > GRID_AXES || self.outputs.count() > OUTPUTS {
            return Err(MapError::Axes);
        }
        if self.counter == 0 {
            return Err(MapError::Counter);
        }
        if !(SCALES[1]..=SCALES[0]).contains(&self.scale) {
            return Err(MapError::Scale { found: self.scale });
        }
        for (axis, lines) in axes_of(self.grid).zip(lines) {
            if !lines.fits() {
                return Err(MapError::Lines { axis });
            }
        }
        if self.words() > MAX_WORDS {
            return Err(MapError::Words { found: self.words() });
        }
        Ok(())
    }

    /// Encodes the header as the first words of the map.
    #[must_use]
    pub fn encode(&self) -> [u16; HEADER_WORDS] {
        let mut words = [0; HEADER_WORDS];
        words[0] = MAGIC;
        words[1] = VERSION;
        words[2] = self.counter;
        put(&mut words, 3, self.model);
        put(&mut words, 5, self.grid.number());
        put(&mut words, 7, self.outputs.number());
        words[9] = self.scale;
        words[10] = u16::try_from(self.words()).unwrap_or(u16::MAX);
        for (axis, lines) in self.lines.iter().enumerate() {
            let at = AXES_AT + AXIS_WORDS * axis;
            put(&mut words, at, lines.origin.cast_unsigned());
            words[at + 2] = lines.part;
            words[at + 3] = lines.parts;
            words[at + 4] = lines.count;
            put(&mut words, at + 5, lines.step_millionths);
        }
        for (at, value) in self.reversal.iter().flatten().enumerate() {
            words[REVERSAL_AT + at] = value.cast_unsigned();
        }
        for (output, &step) in self.output_step_nm.iter().enumerate() {
            put(&mut words, STEPS_AT + 2 * output, step);
        }
        words
    }

    /// Decodes a header.
    ///
    /// # Errors
    /// The words are not a header, or [`check`](Self::check) rejects it.
    pub fn decode(words: &[u16]) -> Result<Self, MapError> {
        let words: &[u16; HEADER_WORDS] =
            words.first_chunk().ok_or(MapError::Short { found: words.len() })?;
        if words[0] != MAGIC {
            return Err(MapError::Magic { found: words[0] });
        }
        if words[1] != VERSION {
            return Err(MapError::Version { found: words[1] });
        }
        let header = Self {
            counter: words[2],
            model: long(words, 3),
            grid: layout(long(words, 5))?,
            outputs: layout(long(words, 7))?,
            scale: words[9],
            lines: core::array::from_fn(|axis| {
                let at = AXES_AT + AXIS_WORDS * axis;
                Lines {
                    origin: long(words, at).cast_signed(),
                    part: words[at + 2],
                    parts: words[at + 3],
                    count: words[at + 4],
                    step_millionths: long(words, at + 5),
                }
            }),
            reversal: core::array::from_fn(|axis| {
                core::array::from_fn(|output| {
                    words[REVERSAL_AT + OUTPUTS * axis + output].cast_signed()
                })
            }),
            output_step_nm: core::array::from_fn(|output| long(words, STEPS_AT + 2 * output)),
        };
        header.check()?;
        if usize::from(words[10]) != header.words() {
            return Err(MapError::Count { found: words[10].into(), expected: header.words() });
        }
        Ok(header)
    }
}

fn layout(number: u32) -> Result<Layout, MapError> {
    let mut names = Vec::new();
    let mut rest = number;
    while rest > 0 {
        let digit = usize::try_from(rest % 10).unwrap_or(0);
        let name = digit.checked_sub(1).and_then(|at| AxisName::ALL.get(at));
        names.push(*name.ok_or(MapError::Axes)?);
        rest /= 10;
    }
    names.reverse();
    Layout::of(names).map_err(|_| MapError::Axes)
}

/// Writes a 32-bit value into two words, low word first.
fn put(words: &mut [u16; HEADER_WORDS], at: usize, value: u32) {
    let [a, b, c, d] = value.to_le_bytes();
    words[at] = u16::from_le_bytes([a, b]);
    words[at + 1] = u16::from_le_bytes([c, d]);
}

fn long(words: &[u16; HEADER_WORDS], at: usize) -> u32 {
    u32::from(words[at]) | u32::from(words[at + 1]) << 16
}

/// Reasons why words or bytes are not a valid map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    #[error("a map has at least 69 words, found {found}")]
    Short { found: usize },
    #[error("{found} bytes are no whole words")]
    OddBytes { found: usize },
    #[error("the first word is {found:#06x}, expected 0x564d (VM): this is not a volcomp map")]
    Magic { found: u16 },
    #[error("layout version {found}, expected 1")]
    Version { found: u16 },
    #[error("expected one to five different axes of the grid, and one to three that are corrected")]
    Axes,
    #[error("the counter of the map is 0, expected 1 to 65535")]
    Counter,
    #[error("an output step has {found} parts, expected 1 to 64")]
    Scale { found: u16 },
    #[error("axis {axis}: lines of the grid are out of range")]
    Lines { axis: AxisName },
    #[error("the map has {found} words, expected at most 32767")]
    Words { found: usize },
    #[error("found {found} words, expected {expected}")]
    Count { found: usize, expected: usize },
    #[error("the checksum does not fit: the map is damaged, or for the machine of another number")]
    Checksum,
}

/// Position of the machine as reported by its control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// Coordinate of each input axis, in position steps of that axis.
    pub steps: [i32; GRID_AXES],
    /// Direction of approach of each input axis; `None`: unknown, so the mean of both applies.
    pub directions: [Option<Direction>; GRID_AXES],
}

/// Interpolates a map at a position, in parts of the output steps: linear between the lines, constant outside the grid. `words` is the whole
/// map, header included; missing words count as 0.
pub(crate) fn look_up(header: &Header, words: &[u16], position: &Position) -> [i32; OUTPUTS] {
    let axes = header.grid.count().min(GRID_AXES);
    let outputs = header.outputs.count().min(OUTPUTS);
    let (mut cell, mut rest) = ([0_usize; GRID_AXES], [0_i32; GRID_AXES]);
    for axis in 0..axes {
        let lines = &header.lines[axis];
        let steps = position.steps[axis].clamp(-MAX_POSITION_STEPS, MAX_POSITION_STEPS);
        let last = i32::from(lines.count) - 2;
        let beyond = (steps - lines.origin).max(0);
        let at = (beyond / lines.pitch()).min(last);
        let part = i32::from(lines.part);
        let within = (beyond - at * lines.pitch() + part / 2) / part;
        cell[axis] = usize::try_from(at).unwrap_or(0);
        rest[axis] = within.min(i32::from(lines.parts));
    }
    let mut values = [0; OUTPUTS];
    for (output, value) in values.iter_mut().enumerate().take(outputs) {
        let mut corner = [0_i32; 1 << GRID_AXES];
        for (number, corner) in corner.iter_mut().enumerate().take(1 << axes) {
            let mut node = 0;
            for (axis, cell) in cell.iter().enumerate().take(axes) {
                node = node * usize::from(header.lines[axis].count) + cell + (number >> axis & 1);
            }
            let word = words.get(HEADER_WORDS + node * outputs + output);
            // Shifted to positive values, because controls divide negative numbers differently.
            *corner = i32::from(word.copied().unwrap_or(0).cast_signed()) + 32768;
        }
        for (axis, rest) in rest.iter().enumerate().take(axes) {
            let parts = i32::from(header.lines[axis].parts);
            for number in 0..1 << (axes - 1 - axis) {
                let [low, high] = [corner[2 * number], corner[2 * number + 1]];
                let sum = low * (parts - rest) + high * rest;
                corner[number] = (sum + parts / 2) / parts;
            }
        }
        *value = corner[0] - 32768;
        for axis in 0..axes {
            let half = i32::from(header.reversal[axis][output]);
            *value += match position.directions[axis] {
                Some(Direction::Positive) => half,
                Some(Direction::Negative) => -half,
                None => 0,
            };
        }
    }
    values
}

/// A map: header and values. Invariant: every index that a look-up reads is within `words`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    header: Header,
    words: Vec<u16>,
}

impl Map {
    /// Creates a map from its values, in parts of the output steps: all outputs of one node, then all
    /// outputs of the next node along the last axis.
    ///
    /// # Errors
    /// The header is unusable for a control, or the number of values differs from that in the
    /// header.
    pub fn new(header: Header, values: &[i16]) -> Result<Self, MapError> {
        header.check()?;
        if values.len() != header.values() {
            return Err(MapError::Count {
                found: values.len() + HEADER_WORDS,
                expected: header.words(),
            });
        }
        let mut words = header.encode().to_vec();
        words.extend(values.iter().map(|value| value.cast_unsigned()));
        Ok(Self { header, words })
    }

    /// Decodes a map.
    ///
    /// # Errors
    /// The words are not a valid map.
    pub fn from_words(words: &[u16]) -> Result<Self, MapError> {
        let header = Header::decode(words)?;
        if words.len() != header.words() {
            return Err(MapError::Count { found: words.len(), expected: header.words() });
        }
        let words = words.to_vec();
        Ok(Self { header, words })
    }

    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// All words of the map: header and values.
    #[must_use]
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// Two checksum words, seeded with the machine number and the corrected axes.
    #[must_use]
    pub fn checksum(&self, machine: u16) -> [u16; 2] {
        let check = checksum(machine, self.header.outputs, &self.words);
        [check.sum, check.of_sums]
    }

    /// Correction of each output at a position, in parts of its step.
    #[must_use]
    pub fn parts(&self, position: &Position) -> [i32; OUTPUTS] {
        look_up(&self.header, &self.words, position)
    }

    /// Correction of each output at a position, mm.
    #[must_use]
    pub fn correction_mm(&self, position: &Position) -> [f64; OUTPUTS] {
        let parts = self.parts(position);
        core::array::from_fn(|output| {
            let step_mm = f64::from(self.header.output_step_nm[output]) * 1e-6;
            f64::from(parts[output]) * step_mm / f64::from(self.header.scale)
        })
    }

    /// Encodes the map as bytes: header, values, checksum.
    #[must_use]
    pub fn image(&self, machine: u16, order: ByteOrder) -> Vec<u8> {
        let mut words = self.words.clone();
        words.extend(self.checksum(machine));
        to_bytes(&words, order)
    }

    /// Decodes the bytes of [`image`](Self::image) in either byte order.
    ///
    /// # Errors
    /// The bytes are not a map, are damaged, or belong to another machine.
    pub fn from_image(bytes: &[u8], machine: u16) -> Result<Self, MapError> {
        if !bytes.len().is_multiple_of(2) {
            return Err(MapError::OddBytes { found: bytes.len() });
        }
        let order = match bytes.first() {
            Some(b'V') => ByteOrder::HighFirst,
            _ => ByteOrder::LowFirst,
        };
        let words = bytes.chunks_exact(2).map(|pair| order.word([pair[0], pair[1]]));
        let words: Vec<u16> = words.collect();
        let (words, check) =
            words.split_last_chunk::<2>().ok_or(MapError::Short { found: words.len() })?;
        let map = Self::from_words(words)?;
        if map.checksum(machine) != *check {
            return Err(MapError::Checksum);
        }
        Ok(map)
    }
}

/// Byte order of words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// Low byte first, as in the memory of a FANUC PMC.
    LowFirst,
    /// High byte first, as in a data block of a Siemens control.
    HighFirst,
}

impl ByteOrder {
    pub(crate) fn word(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::LowFirst => u16::from_le_bytes(bytes),
            Self::HighFirst => u16::from_be_bytes(bytes),
        }
    }
}

/// Encodes words as bytes, two each.
pub fn to_bytes(words: &[u16], order: ByteOrder) -> Vec<u8> {
    let bytes = words.iter().flat_map(|word| match order {
        ByteOrder::LowFirst => word.to_le_bytes(),
        ByteOrder::HighFirst => word.to_be_bytes(),
    });
    bytes.collect()
}
