//! Encoding of positions and corrections in words of a given number of bits.
//!
//! Values are f64 in mm, or rad for a rotary axis; the step of a word determines which.

use volcomp_vocabulary::{AxisKind, Displacement, Mm};

/// Code of the position bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum PositionCode {
    /// Plain binary: the count is unsigned.
    #[default]
    Binary,
    /// Reflected Gray code: one bit changes per count, so a word read during a change is one of two neighbours.
    Gray,
}

/// Position in a word of up to 32 bits. The quantisation error is at most half a step; the range is 2^bits steps from `zero`. The published scheme
/// has 15 bits of 1/32 mm, 1024 mm; its quantisation error of at most 15.6 µm causes 0.2 nm at an error slope of 10 µm/m.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PositionWord {
    /// Number of bits, one per line.
    pub bits: u32,
    /// Code of the bits.
    pub code: PositionCode,
    /// Travel of the axis per count: a length for a linear, an angle for a rotary axis.
    pub step: Displacement,
    /// Position of the axis at count 0, of the same quantity as the step.
    pub zero: Displacement,
}

/// Code of the correction bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum CorrectionCode {
    /// Two's complement: the word of a negative count is the count plus 2 to the power of `bits`.
    #[default]
    TwosComplement,
    /// The highest bit is the sign, the others are the magnitude.
    SignMagnitude,
}

/// Correction in a word of up to 32 bits. The quantisation error is at most half a step; the largest correction is 2^(bits−1) − 1 steps, because the
/// most negative number of two's complement is never sent. The published scheme has 8 bits of 1 µm, ±127 µm.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CorrectionWord {
    /// Number of bits, one per line.
    pub bits: u32,
    /// Code of the bits.
    pub code: CorrectionCode,
    /// Correction per count: a length for a linear, an angle for a rotary axis.
    pub step: Displacement,
}

/// An encoded correction.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    /// Bits of the word.
    pub word: u32,
    /// Correction after quantisation, mm or rad.
    pub sent: f64,
    /// Whether the requested correction was out of range or not a number.
    pub saturated: bool,
}

/// A decoded position.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coded {
    /// Centre of the interval that the word encodes, mm or rad.
    pub position: f64,
    /// Half-width of the interval that the word encodes, mm or rad.
    pub within: f64,
}

/// Error: a travel exceeds the range of a position word.
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

/// A number with the lowest `bits` bits set.
pub(crate) fn mask(bits: u32) -> u32 {
    u32::MAX.checked_shr(32 - bits.min(32)).unwrap_or(0)
}

fn sign_bit(bits: u32) -> u32 {
    1_u32.checked_shl(bits.saturating_sub(1)).unwrap_or(0)
}

impl PositionWord {
    /// Published scheme: 15 bits of 1/32 mm from 0 to 1024 mm, for a linear axis.
    pub const PUBLISHED: Self = Self {
        bits: 15,
        code: PositionCode::Binary,
        step: Displacement::Length(Mm(1.0 / 32.0)),
        zero: Displacement::Length(Mm(0.0)),
    };

    /// Whether step and zero have the quantity of this kind of axis.
    pub(crate) fn is_of(&self, kind: AxisKind) -> bool {
        self.step.kind() == kind && self.zero.kind() == kind
    }

    /// Number of positions that the word can encode.
    pub fn counts(&self) -> f64 {
        f64::from(mask(self.bits)) + 1.0
    }

    /// Width of the range, including the last count, mm or rad.
    pub fn range(&self) -> f64 {
        self.counts() * self.step.mm_or_rad()
    }

    /// First and last position in the range, mm or rad; each also encodes positions up to half a count beyond.
    pub fn ends(&self) -> [f64; 2] {
        [0.0, self.counts() - 1.0].map(|count| self.at(count).position)
    }

    /// Checks that the word can encode every position of a travel (mm or rad, lower end first). Positions beyond the range would alias.
    ///
    /// # Errors
    /// The travel exceeds the range by more than half a count.
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

    /// Count of a word, converted from Gray code if necessary.
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

    /// Decodes a word to a position.
    #[inline]
    pub fn decode(&self, word: u32) -> Coded {
        self.at(f64::from(self.count(word)))
    }

    pub(crate) fn at(&self, count: f64) -> Coded {
        let step = self.step.mm_or_rad();
        Coded { position: self.zero.mm_or_rad() + count * step, within: 0.5 * step }
    }

    /// Encodes a position (mm or rad), as a control does, to the nearest count; `None` outside the range.
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
    /// Published scheme: 8 bits of 1 µm in two's complement, for a linear axis.
    pub const PUBLISHED: Self = Self {
        bits: 8,
        code: CorrectionCode::TwosComplement,
        step: Displacement::Length(Mm(0.001)),
    };

    /// Largest correction in the range of the word, mm or rad.
    pub fn limit(&self) -> f64 {
        f64::from(mask(self.bits.saturating_sub(1))) * self.step.mm_or_rad()
    }

    /// Encodes a correction (mm or rad): the nearest count, clamped to the limit; NaN becomes 0.
    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "held within the range of the word")]
    pub fn encode(&self, correction: f64) -> Correction {
        let step = self.step.mm_or_rad();
        let most = f64::from(mask(self.bits.saturating_sub(1)));
        let counts = correction / step;
        // Rounds half away from zero, without libm.
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

    /// Decodes a word to a correction, mm or rad; `None` for the most negative number of two's complement, which is never sent, and for −0.
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

/// Maximum count, 2⁵²: far beyond the positions of a machine, and still exact in an `f64`.
const FARTHEST: f64 = 4_503_599_627_370_496.0;

/// Tracks a position of which only the low bits are reported; the axis must move less than half the range of the word between two words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unwrapper {
    word: PositionWord,
    count: i64,
    last: u32,
}

impl Unwrapper {
    /// Starts with a word and the known position of the axis (mm or rad) at that time, such as its reference position.
    #[expect(clippy::cast_possible_truncation, reason = "positions are counted in millions")]
    pub fn new(word: PositionWord, raw: u32, known: f64) -> Self {
        let range = i64::from(mask(word.bits)) + 1;
        let last = word.count(raw);
        let about = ((known - word.zero.mm_or_rad()) / word.step.mm_or_rad())
            .round()
            .clamp(-FARTHEST, FARTHEST) as i64;
        // The count with these low bits that is nearest to the known position.
        let ahead = (i64::from(last) - about).rem_euclid(range);
        let ahead = if ahead * 2 > range { ahead - range } else { ahead };
        Self { word, count: about + ahead, last }
    }

    /// Updates and returns the position from the next word.
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
