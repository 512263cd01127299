//! Encoding of positions and corrections in words of a given number of bits.
//!
//! Values are f64 in mm for a linear axis and in rad for a rotary axis. The quantity of the word's step (length or
//! angle) determines which.

use volcomp_vocabulary::{AxisKind, Displacement, Mm};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum PositionCode {
    /// Plain binary; the count is unsigned.
    #[default]
    Binary,
    /// Reflected Gray code. One bit changes per count, so a word read during a change is one of the two neighbours.
    Gray,
}

/// Position in a word of up to 32 bits. The quantisation error is at most half a step, and the range is 2^bits steps
/// from `zero`. The published word has 15 bits of 1/32 mm, which is a range of 1024 mm. Its quantisation error of at
/// most 15.6 µm changes the correction by 0.2 nm at an error slope of 10 µm/m.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PositionWord {
    /// Number of bits, one per line.
    pub bits: u32,
    pub code: PositionCode,
    /// Travel of the axis per count: a length for a linear axis, an angle for a rotary axis.
    pub step: Displacement,
    /// Position of the axis at count 0, of the same quantity as `step`.
    pub zero: Displacement,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum CorrectionCode {
    /// Two's complement: a negative count is encoded as the count plus 2^bits.
    #[default]
    TwosComplement,
    /// The highest bit is the sign, the other bits are the magnitude.
    SignMagnitude,
}

/// Correction in a word of up to 32 bits. The quantisation error is at most half a step. The largest correction is
/// 2^(bits−1) − 1 steps, because the most negative number of two's complement is never sent. The published word has 8
/// bits of 1 µm, which is ±127 µm.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CorrectionWord {
    /// Number of bits, one per line.
    pub bits: u32,
    pub code: CorrectionCode,
    /// Correction per count: a length for a linear axis, an angle for a rotary axis.
    pub step: Displacement,
}

/// Word that encodes a correction, and the correction that it represents.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    pub word: u32,
    /// Correction after quantisation, mm or rad.
    pub sent: f64,
    /// Whether the requested correction was out of range or not a number.
    pub saturated: bool,
}

/// Interval of positions that a word represents.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coded {
    /// Centre of the interval that the word encodes, mm or rad.
    pub position: f64,
    /// Half-width of the interval that the word encodes, mm or rad.
    pub within: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "found a travel from {} to {} {unit}, expected one within {} to {} {unit}, which {bits} bits of this step can represent",
    travel[0].mm_or_deg(), travel[1].mm_or_deg(), word[0].mm_or_deg(), word[1].mm_or_deg(),
    unit = travel[0].kind().coordinate_unit()
)]
pub struct BeyondWord {
    /// Lower and upper end of the travel.
    pub travel: [Displacement; 2],
    /// First and last position in the range of the word.
    pub word: [Displacement; 2],
    /// Number of bits of the word.
    pub bits: u32,
}

pub(crate) fn mask(bits: u32) -> u32 {
    u32::MAX.checked_shr(32 - bits.min(32)).unwrap_or(0)
}

fn sign_bit(bits: u32) -> u32 {
    1_u32.checked_shl(bits.saturating_sub(1)).unwrap_or(0)
}

impl PositionWord {
    /// The published word: 15 bits of 1/32 mm from 0 to 1024 mm, for a linear axis.
    pub const PUBLISHED: Self = Self {
        bits: 15,
        code: PositionCode::Binary,
        step: Displacement::Length(Mm(1.0 / 32.0)),
        zero: Displacement::Length(Mm(0.0)),
    };

    /// Whether step and zero have the quantity (length or angle) of this kind of axis.
    pub(crate) fn is_of(&self, kind: AxisKind) -> bool {
        self.step.kind() == kind && self.zero.kind() == kind
    }

    pub fn counts(&self) -> f64 {
        f64::from(mask(self.bits)) + 1.0
    }

    /// Number of counts times the step, mm or rad.
    pub fn range(&self) -> f64 {
        self.counts() * self.step.mm_or_rad()
    }

    /// Positions of the first and the last count, mm or rad. Each of these counts also encodes positions up to half a
    /// step beyond.
    pub fn ends(&self) -> [f64; 2] {
        [0.0, self.counts() - 1.0].map(|count| self.at(count).position)
    }

    /// Checks that the word can encode every position of a travel (mm or rad, lower end first). Positions outside the
    /// range would have the word of another position.
    ///
    /// # Errors
    /// The travel exceeds the range by more than half a step.
    pub fn check_travel(&self, travel: [f64; 2]) -> Result<(), BeyondWord> {
        let half = 0.5 * self.step.mm_or_rad();
        let ends = self.ends();
        if ends[0] - half <= travel[0] && travel[1] <= ends[1] + half {
            return Ok(());
        }
        let kind = self.step.kind();
        let of_kind = |ends: [f64; 2]| ends.map(|at| Displacement::new(kind, at));
        Err(BeyondWord { travel: of_kind(travel), word: of_kind(ends), bits: self.bits })
    }

    /// Count that a word encodes, converted from Gray code if necessary.
    #[inline]
    pub fn count(&self, word: u32) -> u32 {
        let word = word & mask(self.bits);
        match self.code {
            PositionCode::Binary => word,
            PositionCode::Gray => {
                let mut count = word;
                for shift in [16, 8, 4, 2, 1] {
                    count ^= count >> shift;
                }
                count
            }
        }
    }

    /// Position that a word of the lines represents.
    #[inline]
    pub fn decode(&self, word: u32) -> Coded {
        self.at(f64::from(self.count(word)))
    }

    pub(crate) fn at(&self, count: f64) -> Coded {
        let step = self.step.mm_or_rad();
        Coded { position: self.zero.mm_or_rad() + count * step, within: 0.5 * step }
    }

    /// Encodes a position (mm or rad) as the nearest count, as a control does; `None` if the position is outside the
    /// range.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the range of the word"
    )]
    pub fn encode(&self, position: f64) -> Option<u32> {
        let count = ((position - self.zero.mm_or_rad()) / self.step.mm_or_rad()).round();
        if !(0.0..self.counts()).contains(&count) {
            return None;
        }
        let count = count as u32;
        Some(match self.code {
            PositionCode::Binary => count,
            PositionCode::Gray => count ^ (count >> 1),
        })
    }
}

impl CorrectionWord {
    /// The published word: 8 bits of 1 µm in two's complement, for a linear axis.
    pub const PUBLISHED: Self = Self {
        bits: 8,
        code: CorrectionCode::TwosComplement,
        step: Displacement::Length(Mm(0.001)),
    };

    /// Largest correction that the word can encode with either sign, mm or rad.
    pub fn limit(&self) -> f64 {
        f64::from(mask(self.bits.saturating_sub(1))) * self.step.mm_or_rad()
    }

    /// Encodes a correction (mm or rad) as the nearest count, clamped to the limit. NaN becomes 0.
    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "held within the range of the word")]
    pub fn encode(&self, correction: f64) -> Correction {
        let step = self.step.mm_or_rad();
        let most = f64::from(mask(self.bits.saturating_sub(1)));
        let counts = correction / step;
        // Rounds half away from zero, without `libm`.
        let half = if counts < 0.0 { -0.5 } else { 0.5 };
        let held = (counts + half).clamp(-most, most) as i32;
        let size = held.unsigned_abs();
        let word = match (self.code, held < 0) {
            (_, false) => size,
            (CorrectionCode::TwosComplement, true) => held.cast_unsigned() & mask(self.bits),
            (CorrectionCode::SignMagnitude, true) => size | sign_bit(self.bits),
        };
        Correction {
            word,
            sent: f64::from(held) * step,
            saturated: counts.abs() >= most + 0.5 || counts.is_nan(),
        }
    }

    /// Decodes a word to a correction, mm or rad. Returns `None` for the most negative number of two's complement,
    /// which is never sent, and for −0 of sign and magnitude.
    pub fn decode(&self, word: u32) -> Option<f64> {
        let word = word & mask(self.bits);
        let sign = sign_bit(self.bits);
        if word == sign {
            return None;
        }
        let negative = word & sign != 0;
        let size = match (self.code, negative) {
            (_, false) => word,
            (CorrectionCode::TwosComplement, true) => (!word & mask(self.bits)) + 1,
            (CorrectionCode::SignMagnitude, true) => word & !sign,
        };
        let size = f64::from(size) * self.step.mm_or_rad();
        Some(if negative { -size } else { size })
    }
}

/// Maximum magnitude of a count, 2⁵². It is far beyond the positions of a machine, and exact in an `f64`.
const FARTHEST: f64 = 4_503_599_627_370_496.0;

/// Tracks a position whose word has only the low bits. The axis must move less than half the range of the word between
/// two words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unwrapper {
    word: PositionWord,
    count: i64,
    last: u32,
}

impl Unwrapper {
    /// Starts with a word and the position of the axis (mm or rad) that is known at that time, such as its reference
    /// position.
    #[expect(clippy::cast_possible_truncation, reason = "positions are counted in millions")]
    pub fn new(word: PositionWord, raw: u32, known: f64) -> Self {
        let range = i64::from(mask(word.bits)) + 1;
        let last = word.count(raw);
        let about = ((known - word.zero.mm_or_rad()) / word.step.mm_or_rad())
            .round()
            .clamp(-FARTHEST, FARTHEST) as i64;
        // The position is the count nearest to the known position, among all counts with these low bits.
        let ahead = (i64::from(last) - about).rem_euclid(range);
        let ahead = if ahead * 2 > range { ahead - range } else { ahead };
        Self { word, count: about + ahead, last }
    }

    pub fn follow(&mut self, raw: u32) -> Coded {
        let now = self.word.count(raw);
        let range = i64::from(mask(self.word.bits)) + 1;
        let ahead = (i64::from(now) - i64::from(self.last)).rem_euclid(range);
        let moved = if ahead * 2 > range { ahead - range } else { ahead };
        self.count = self.count.saturating_add(moved);
        self.last = now;
        #[expect(clippy::cast_precision_loss, reason = "positions are counted in millions")]
        self.word.at(self.count as f64)
    }
}
