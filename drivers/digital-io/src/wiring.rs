use crate::words::{CorrectionWord, PositionWord, mask};

/// Assignment of bits to lines. The control's outputs carry the position: they are our inputs. The control's inputs
/// carry the correction: they are our outputs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wiring {
    /// Our inputs with the position bits. The first line is the lowest bit.
    pub position: Vec<u32>,
    /// Our input with the even parity bit over position, axis selection and the parity bit itself; `None` if there is
    /// no parity line.
    pub parity: Option<u32>,
    /// Our input that is 1 while the position word is stable; `None` if there is no such line.
    pub strobe: Option<u32>,
    /// Our inputs with the index of the selected axis. The first line is the lowest bit.
    pub select: Vec<u32>,
    /// Our outputs with the correction bits. The first line is the lowest bit.
    pub correction: Vec<u32>,
    /// Our outputs with the index of the corrected axis, as many lines as `select`. The first line is the lowest bit.
    /// The control accepts a correction only while this index equals that of the selected axis.
    pub echo: Vec<u32>,
    /// Our output that toggles one write after the correction; `None` if there is no latch. A control that samples the
    /// correction at both edges of this line never reads lines that have not settled.
    #[cfg_attr(feature = "serde", serde(default))]
    pub latch: Option<u32>,
    /// Bit mask of our inputs that are inverted.
    pub inverted_inputs: u64,
    /// Bit mask of our outputs that are inverted.
    pub inverted_outputs: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {found}, expected {expected}")]
pub struct WiringError {
    /// Invalid part of the wiring.
    pub what: &'static str,
    /// Value in the wiring.
    pub found: String,
    /// Value or condition that was expected.
    pub expected: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PositionInput {
    pub(crate) word: u32,
    pub(crate) axis: u32,
    pub(crate) valid: bool,
}

impl Wiring {
    /// The published wiring: 15 lines from the control with the position of one axis, and 8 lines to the control with
    /// the correction.
    pub fn published() -> Self {
        Self { position: (0..15).collect(), correction: (0..8).collect(), ..Self::default() }
    }

    /// Checks the wiring against a port and the words.
    ///
    /// # Errors
    /// A line that does not exist or is used twice, a number of lines that differs from the number of bits of the word,
    /// or too few selection lines for the axes.
    pub fn check(
        &self,
        inputs: u32,
        outputs: u32,
        axes: usize,
        words: &[(PositionWord, CorrectionWord)],
    ) -> Result<(), WiringError> {
        let ours: Vec<u32> = self.inputs().collect();
        check_each_once("inputs", &ours, inputs)?;
        check_each_once("outputs", &self.outputs().collect::<Vec<u32>>(), outputs)?;
        for (position, correction) in words {
            same("lines of the position", self.position.len(), position.bits, 1)?;
            same("lines of the correction", self.correction.len(), correction.bits, 2)?;
            for (what, count) in [
                ("step of the position", position.step.mm_or_rad()),
                ("step of the correction", correction.step.mm_or_rad()),
            ] {
                if !(count > 0.0 && count.is_finite()) {
                    return Err(wrong(what, &count, "a positive number"));
                }
            }
        }
        let selectable = 1_usize.checked_shl(u32::try_from(self.select.len()).unwrap_or(u32::MAX));
        if axes == 0 || selectable.is_some_and(|most| axes > most) {
            let expected = format!("1 to {} with this number of lines", selectable.unwrap_or(0));
            return Err(wrong("axes", &axes, &expected));
        }
        if self.echo.len() != self.select.len() {
            let expected = format!("{}: a correction must name its axis", self.select.len());
            return Err(wrong("lines of the echo", &self.echo.len(), &expected));
        }
        Ok(())
    }

    fn inputs(&self) -> impl Iterator<Item = u32> {
        let single = self.parity.iter().chain(&self.strobe);
        let words = self.position.iter().chain(&self.select);
        words.chain(single).copied()
    }

    fn outputs(&self) -> impl Iterator<Item = u32> {
        let words = self.correction.iter().chain(&self.echo);
        words.chain(&self.latch).copied()
    }

    pub(crate) fn used_outputs(&self) -> u64 {
        self.outputs().fold(0, |used, line| used | 1 << line)
    }

    /// Bit of the latch line in the output levels; 0 without a latch.
    pub(crate) fn latch_bit(&self) -> u64 {
        self.latch.map_or(0, |line| 1 << line)
    }

    /// Whether the wiring leaves any of `outputs` outputs unused.
    pub(crate) fn leaves_outputs(&self, outputs: u32) -> bool {
        let available = u64::MAX.checked_shr(64 - outputs.min(64)).unwrap_or(0);
        available & !self.used_outputs() != 0
    }

    /// Bit mask of the inputs that must be equal in two readings.
    pub(crate) fn used_inputs(&self) -> u64 {
        self.inputs().fold(0, |used, line| used | 1 << line)
    }

    #[inline]
    pub(crate) fn position_input(&self, levels: u64) -> PositionInput {
        let levels = levels ^ self.inverted_inputs;
        let (word, axis) = (gather(levels, &self.position), gather(levels, &self.select));
        let bit = |line: u32| u32::from(levels >> line & 1 == 1);
        let ones = word.count_ones() + axis.count_ones();
        let parity_is_right = self.parity.is_none_or(|line| (ones + bit(line)) % 2 == 0);
        let holds_still = self.strobe.is_none_or(|line| bit(line) == 1);
        PositionInput { word, axis, valid: parity_is_right && holds_still }
    }

    /// Position word on the inputs; `None` if the parity is wrong or the word is not stable.
    #[inline]
    pub fn position_word(&self, levels: u64) -> Option<u32> {
        let input = self.position_input(levels);
        input.valid.then_some(input.word)
    }

    /// Output levels for a correction word of the axis with this index. The latch is at 0.
    #[inline]
    pub fn levels(&self, word: u32, axis: u32) -> u64 {
        let bits = scatter(word, &self.correction) | scatter(axis, &self.echo);
        (bits ^ self.inverted_outputs) & !self.latch_bit()
    }

    /// Levels of a control's outputs that report a position word of the axis with this index; for simulated controls
    /// and tests.
    pub fn control_outputs(&self, word: u32, axis: u32, strobe: bool) -> u64 {
        let ones = (word & mask(self.position.len().try_into().unwrap_or(32))).count_ones();
        let ones = ones + axis.count_ones();
        let mut levels = scatter(word, &self.position) | scatter(axis, &self.select);
        levels |= self.parity.map_or(0, |line| u64::from(ones % 2) << line);
        levels |= self.strobe.map_or(0, |line| u64::from(strobe) << line);
        levels ^ self.inverted_inputs
    }

    /// Correction word and axis index on a control's inputs.
    pub fn control_inputs(&self, levels: u64) -> (u32, u32) {
        let levels = levels ^ self.inverted_outputs;
        (gather(levels, &self.correction), gather(levels, &self.echo))
    }
}

/// Collects the bits of these lines into a word. The first line is the lowest bit.
#[inline]
fn gather(levels: u64, lines: &[u32]) -> u32 {
    let mut word = 0;
    for (bit, line) in lines.iter().enumerate() {
        word |= u32::from(levels >> (line & 63) & 1 == 1) << bit;
    }
    word
}

#[inline]
fn scatter(word: u32, lines: &[u32]) -> u64 {
    let mut levels = 0;
    for (bit, line) in lines.iter().enumerate() {
        levels |= u64::from(word >> bit & 1) << (line & 63);
    }
    levels
}

fn wrong(what: &'static str, found: &dyn std::fmt::Display, expected: &str) -> WiringError {
    WiringError { what, found: format!("found {found}"), expected: expected.to_owned() }
}

fn same(what: &'static str, found: usize, bits: u32, least: u32) -> Result<(), WiringError> {
    if !(least..=32).contains(&bits) {
        return Err(wrong(what, &bits, &format!("{least} to 32 bits")));
    }
    if usize::try_from(bits).ok() == Some(found) {
        return Ok(());
    }
    Err(wrong(what, &found, &format!("{bits}, the bits of the word")))
}

fn check_each_once(what: &'static str, lines: &[u32], available: u32) -> Result<(), WiringError> {
    for (index, line) in lines.iter().enumerate() {
        if *line >= available.min(64) {
            return Err(wrong(what, line, &format!("a line below {}", available.min(64))));
        }
        if lines[..index].contains(line) {
            return Err(wrong(what, line, "each line once"));
        }
    }
    Ok(())
}
