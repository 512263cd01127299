//! The map of the corrections over the work space, as words: its head, its values, and the look-up that a control does in it.

use volcomp_guard::protocol::{Layout, checksum};
use volcomp_vocabulary::{AxisName, Direction};

/// The most axes that a map goes over.
pub const GRID_AXES: usize = 5;
/// The most axes that a map corrects: one for each direction of space.
pub const OUTPUTS: usize = 3;
/// Words before the first value.
pub const HEADER_WORDS: usize = 68;
/// The most words of a map: places are numbers that every control has.
pub const MOST_WORDS: usize = 32767;
/// The most parts that an output step has, and the least.
pub const SCALES: [u16; 2] = [64, 1];
/// The furthest place of a line, in steps of the position.
pub(crate) const FURTHEST: i32 = 1_000_000_000;

const MAGIC: u16 = 0x564D;
const VERSION: u16 = 1;
const AXES_AT: usize = 11;
const AXIS_WORDS: usize = 7;
const REVERSAL_AT: usize = AXES_AT + AXIS_WORDS * GRID_AXES;
const STEPS_AT: usize = REVERSAL_AT + GRID_AXES * OUTPUTS;

/// The lines of the grid along one axis. From line to line it is `part`·`parts` steps of the position, and the control
/// interpolates between `parts` places there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Lines {
    /// Where the first line is, steps of the position.
    pub origin: i32,
    /// Steps of the position from one place to the next, 1 to 32767.
    pub part: u16,
    /// Places from line to line, 1 to 32767.
    pub parts: u16,
    /// How many lines there are, 2 to 32767.
    pub count: u16,
    /// A step of the position, millionths of a mm (nm) or of a deg.
    pub step_millionths: u32,
}

impl Lines {
    /// From line to line, steps of the position.
    #[must_use]
    pub fn pitch(&self) -> i32 {
        i32::from(self.part) * i32::from(self.parts)
    }

    /// Where a line is, mm or deg.
    #[must_use]
    pub fn at(&self, line: u16) -> f64 {
        self.coordinate(f64::from(self.origin) + f64::from(line) * f64::from(self.pitch()))
    }

    /// Steps of the position in mm or deg.
    pub(crate) fn coordinate(&self, steps: f64) -> f64 {
        steps * f64::from(self.step_millionths) * 1e-6
    }

    fn fits(&self) -> bool {
        let within = 1..=32767;
        within.contains(&self.part)
            && within.contains(&self.parts)
            && (2..=32767).contains(&self.count)
            && (-FURTHEST..=FURTHEST).contains(&self.origin)
            && i32::from(self.count) - 1 <= FURTHEST / self.pitch()
            && self.step_millionths > 0
    }
}

/// The head of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The number of this map, which tells it from those before; never 0.
    pub counter: u16,
    /// The first 32 bits of the checksum of the machine file that it was made from.
    pub model: u32,
    /// The axes that the map goes over, the slowest first.
    pub grid: Layout,
    /// The axes that it corrects.
    pub outputs: Layout,
    /// Parts of a value in one step of the output, 1 to 64.
    pub scale: u16,
    /// The lines along each axis of the grid.
    pub lines: [Lines; GRID_AXES],
    /// What is added to each output, in parts, where an axis of the grid came in the positive direction, and taken away where
    /// it came in the negative one: half of the reversal.
    pub reversal: [[i16; OUTPUTS]; GRID_AXES],
    /// A step of each output, nm.
    pub output_step_nm: [u32; OUTPUTS],
}

/// The axes of a layout in their order.
pub fn axes_of(layout: Layout) -> impl Iterator<Item = AxisName> {
    let (count, number) = (layout.count(), layout.number());
    (0..count).filter_map(move |place| {
        let digit = number / 10_u32.pow(u32::try_from(count - 1 - place).ok()?) % 10;
        AxisName::ALL
            .get(usize::try_from(digit).ok()?.checked_sub(1)?)
            .copied()
    })
}

impl Header {
    /// How many values a map with this head has.
    #[must_use]
    pub fn values(&self) -> usize {
        let lines = self.lines.iter().take(self.grid.count());
        lines.fold(self.outputs.count(), |count, lines| {
            count.saturating_mul(lines.count.into())
        })
    }

    /// How many words the whole map has.
    #[must_use]
    pub fn words(&self) -> usize {
        self.values().saturating_add(HEADER_WORDS)
    }

    /// Whether a control can look up in a map with this head.
    ///
    /// # Errors
    /// What is beyond the reach of its arithmetic.
    pub fn check(&self) -> Result<(), NoMap> {
        let lines = self.lines.iter().take(self.grid.count());
        if self.grid.count() > GRID_AXES || self.outputs.count() > OUTPUTS {
            return Err(NoMap::Axes);
        }
        if self.counter == 0 {
            return Err(NoMap::Counter);
        }
        if !(SCALES[1]..=SCALES[0]).contains(&self.scale) {
            return Err(NoMap::Scale { found: self.scale });
        }
        for (axis, lines) in axes_of(self.grid).zip(lines) {
            if !lines.fits() {
                return Err(NoMap::Lines { axis });
            }
        }
        if self.words() > MOST_WORDS {
            return Err(NoMap::Words {
                found: self.words(),
            });
        }
        Ok(())
    }

    /// The words of the head.
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
        // At most 32767 where the head fits.
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

    /// Reads the words of a head.
    ///
    /// # Errors
    /// Words that are no head, and what [`check`](Self::check) refuses.
    pub fn decode(words: &[u16]) -> Result<Self, NoMap> {
        let words: &[u16; HEADER_WORDS] = words
            .first_chunk()
            .ok_or(NoMap::Short { found: words.len() })?;
        if words[0] != MAGIC {
            return Err(NoMap::Magic { found: words[0] });
        }
        if words[1] != VERSION {
            return Err(NoMap::Version { found: words[1] });
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
            return Err(NoMap::Count {
                found: words[10].into(),
                expected: header.words(),
            });
        }
        Ok(header)
    }
}

fn layout(number: u32) -> Result<Layout, NoMap> {
    let mut names = Vec::new();
    let mut rest = number;
    while rest > 0 {
        let digit = usize::try_from(rest % 10).unwrap_or(0);
        let name = digit.checked_sub(1).and_then(|at| AxisName::ALL.get(at));
        names.push(*name.ok_or(NoMap::Axes)?);
        rest /= 10;
    }
    names.reverse();
    Layout::of(names).map_err(|_| NoMap::Axes)
}

/// The low word first.
fn put(words: &mut [u16; HEADER_WORDS], at: usize, value: u32) {
    let [a, b, c, d] = value.to_le_bytes();
    words[at] = u16::from_le_bytes([a, b]);
    words[at + 1] = u16::from_le_bytes([c, d]);
}

fn long(words: &[u16; HEADER_WORDS], at: usize) -> u32 {
    u32::from(words[at]) | u32::from(words[at + 1]) << 16
}

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

/// Where a machine stands, as its control tells it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// The coordinate of each axis of the grid, in its steps.
    pub steps: [i32; GRID_AXES],
    /// The direction in which each axis came; `None`: not known, the mean of both holds.
    pub directions: [Option<Direction>; GRID_AXES],
}

/// The values of a map at a position, in parts of the output's steps: linear between the lines, the value at the end of the
/// grid beyond it. `words` are those of the whole map, head and all; a map that is too short gives 0.
pub(crate) fn look_up(header: &Header, words: &[u16], position: &Position) -> [i32; OUTPUTS] {
    let axes = header.grid.count().min(GRID_AXES);
    let outputs = header.outputs.count().min(OUTPUTS);
    let (mut cell, mut rest) = ([0_usize; GRID_AXES], [0_i32; GRID_AXES]);
    for axis in 0..axes {
        let lines = &header.lines[axis];
        let steps = position.steps[axis].clamp(-FURTHEST, FURTHEST);
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
            // Above zero, since controls do not agree on how they divide what is below.
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

/// A map: its head and its values. It holds together: every place that a look-up reads is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    header: Header,
    words: Vec<u16>,
}

impl Map {
    /// A map of these values in parts of the output's steps: all outputs of a node, then the next node along the last axis.
    ///
    /// # Errors
    /// A head that no control can use, or another number of values than it says.
    pub fn new(header: Header, values: &[i16]) -> Result<Self, NoMap> {
        header.check()?;
        if values.len() != header.values() {
            return Err(NoMap::Count {
                found: values.len() + HEADER_WORDS,
                expected: header.words(),
            });
        }
        let mut words = header.encode().to_vec();
        words.extend(values.iter().map(|value| value.cast_unsigned()));
        Ok(Self { header, words })
    }

    /// A map from its words.
    ///
    /// # Errors
    /// Words that are no map.
    pub fn from_words(words: &[u16]) -> Result<Self, NoMap> {
        let header = Header::decode(words)?;
        if words.len() != header.words() {
            return Err(NoMap::Count {
                found: words.len(),
                expected: header.words(),
            });
        }
        let words = words.to_vec();
        Ok(Self { header, words })
    }

    /// The head.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The words of head and values.
    #[must_use]
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// The two words of the checksum, started from the number of the machine and the axes that are corrected.
    #[must_use]
    pub fn checksum(&self, machine: u16) -> [u16; 2] {
        let check = checksum(machine, self.header.outputs, &self.words);
        [check.sum, check.of_sums]
    }

    /// The correction of each output at a position, in parts of its step.
    #[must_use]
    pub fn parts(&self, position: &Position) -> [i32; OUTPUTS] {
        look_up(&self.header, &self.words, position)
    }

    /// The correction of each output at a position, mm.
    #[must_use]
    pub fn correction_mm(&self, position: &Position) -> [f64; OUTPUTS] {
        let parts = self.parts(position);
        core::array::from_fn(|output| {
            let step_mm = f64::from(self.header.output_step_nm[output]) * 1e-6;
            f64::from(parts[output]) * step_mm / f64::from(self.header.scale)
        })
    }

    /// The image: head, values, checksum.
    #[must_use]
    pub fn image(&self, machine: u16, order: ByteOrder) -> Vec<u8> {
        let mut words = self.words.clone();
        words.extend(self.checksum(machine));
        to_bytes(&words, order)
    }

    /// Reads an image in either order of bytes.
    ///
    /// # Errors
    /// Bytes that are no map, are damaged, or are for another machine.
    pub fn from_image(bytes: &[u8], machine: u16) -> Result<Self, NoMap> {
        if !bytes.len().is_multiple_of(2) {
            return Err(NoMap::OddBytes { found: bytes.len() });
        }
        let order = match bytes.first() {
            Some(b'V') => ByteOrder::HighFirst,
            _ => ByteOrder::LowFirst,
        };
        let words = bytes
            .chunks_exact(2)
            .map(|pair| order.word([pair[0], pair[1]]));
        let words: Vec<u16> = words.collect();
        let (words, check) = words
            .split_last_chunk::<2>()
            .ok_or(NoMap::Short { found: words.len() })?;
        let map = Self::from_words(words)?;
        if map.checksum(machine) != *check {
            return Err(NoMap::Checksum);
        }
        Ok(map)
    }
}

/// In which order the two bytes of a word stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The low byte first, as in the memory of a FANUC PMC.
    LowFirst,
    /// The high byte first, as in a data block of a Siemens control.
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

/// The bytes of words, two for each.
pub fn to_bytes(words: &[u16], order: ByteOrder) -> Vec<u8> {
    let bytes = words.iter().flat_map(|word| match order {
        ByteOrder::LowFirst => word.to_le_bytes(),
        ByteOrder::HighFirst => word.to_be_bytes(),
    });
    bytes.collect()
}
