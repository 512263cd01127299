//! The head of a map: what the control has to know before it reads a value.

use volcomp_guard::protocol::Layout;
use volcomp_vocabulary::AxisName;

use crate::NoMap;

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
