//! The two words: a position in so many bits, a correction in so many.

/// How the bits of a position count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PositionCode {
    /// Plain binary.
    #[default]
    Binary,
    /// Reflected Gray code: one bit changes from count to count, so that a word read while it changes is one
    /// of its neighbours.
    Gray,
}

/// A position in up to 32 bits. Quantising loses up to half of `mm_per_count`; the range is
/// 2^bits · `mm_per_count` from `zero_mm` on. Published: 15 bits of 1/32 mm, 1024 mm, a loss of 15.6 µm at the
/// most, of which an error of 10 µm/m makes 0.2 nm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionWord {
    /// Lines of the word.
    pub bits: u32,
    /// Their code.
    pub code: PositionCode,
    /// What one count is, mm; for a rotary axis rad.
    pub mm_per_count: f64,
    /// The position of count 0.
    pub zero_mm: f64,
}

/// How the bits of a correction count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CorrectionCode {
    /// Two's complement.
    #[default]
    TwosComplement,
    /// The highest bit is the sign, the others are the size.
    SignMagnitude,
}

/// A correction in up to 32 bits. Quantising loses up to half of `mm_per_count`; the largest correction is
/// (2^(bits−1) − 1) · `mm_per_count`: the most negative number of two's complement is never sent. Published: 8
/// bits of 1 µm, ±127 µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionWord {
    /// Lines of the word.
    pub bits: u32,
    /// Their code.
    pub code: CorrectionCode,
    /// What one count is, mm; for a rotary axis rad.
    pub mm_per_count: f64,
}

/// A correction as it is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// The bits of the word, lowest first.
    pub word: u32,
    /// What it stands for, mm.
    pub sent_mm: f64,
    /// The wanted correction was larger than the word can say, or no number.
    pub saturated: bool,
}

/// A position that a word stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coded {
    /// The middle of what the word stands for, mm.
    pub mm: f64,
    /// How far the position may be from that, mm.
    pub within_mm: f64,
}

/// So many ones.
pub(crate) fn mask(bits: u32) -> u32 {
    u32::MAX.checked_shr(32 - bits.min(32)).unwrap_or(0)
}

impl PositionWord {
    /// Counts that the word can say.
    pub fn counts(&self) -> f64 {
        f64::from(mask(self.bits)) + 1.0
    }

    /// From the first to the end of the last count, mm.
    pub fn range_mm(&self) -> f64 {
        self.counts() * self.mm_per_count
    }

    /// The count of a word: Gray code undone.
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

    /// The position of a word.
    #[inline]
    pub fn decode(&self, word: u32) -> Coded {
        self.position(f64::from(self.count(word)))
    }

    pub(crate) fn position(&self, count: f64) -> Coded {
        Coded {
            mm: self.zero_mm + count * self.mm_per_count,
            within_mm: 0.5 * self.mm_per_count,
        }
    }

    /// The word that a control shows at a position: the nearest count, `None` outside the range.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the range of the word"
    )]
    pub fn encode(&self, mm: f64) -> Option<u32> {
        let count = ((mm - self.zero_mm) / self.mm_per_count).round();
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
    /// The largest correction, mm.
    pub fn limit_mm(&self) -> f64 {
        f64::from(mask(self.bits - 1)) * self.mm_per_count
    }

    /// The word for a correction: the nearest count, held within the limit; what is no number is 0.
    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "held within the range of the word"
    )]
    pub fn encode(&self, correction_mm: f64) -> Correction {
        let most = f64::from(mask(self.bits - 1));
        let wanted = correction_mm / self.mm_per_count;
        // Rounding half away from zero, without a call.
        let half = if wanted < 0.0 { -0.5 } else { 0.5 };
        let held = (wanted + half).clamp(-most, most) as i32;
        let size = held.unsigned_abs();
        let word = match (self.code, held < 0) {
            (_, false) => size,
            (CorrectionCode::TwosComplement, true) => held.cast_unsigned() & mask(self.bits),
            (CorrectionCode::SignMagnitude, true) => size | 1 << (self.bits - 1),
        };
        Correction {
            word,
            sent_mm: f64::from(held) * self.mm_per_count,
            saturated: wanted.abs() >= most + 0.5 || wanted.is_nan(),
        }
    }

    /// What a word stands for, mm; `None` for the most negative number of two's complement, which is never
    /// sent, and for −0.
    pub fn decode(&self, word: u32) -> Option<f64> {
        let word = word & mask(self.bits);
        let sign = 1 << (self.bits - 1);
        if word == sign {
            return None;
        }
        let negative = word & sign != 0;
        let size = match (self.code, negative) {
            (_, false) => word,
            (CorrectionCode::TwosComplement, true) => (!word & mask(self.bits)) + 1,
            (CorrectionCode::SignMagnitude, true) => word & !sign,
        };
        let mm = f64::from(size) * self.mm_per_count;
        Some(if negative { -mm } else { mm })
    }
}

/// Follows a position of which only the low bits are shown: the axis must move less than half of what the
/// word can say between two words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unwrapper {
    word: PositionWord,
    count: i64,
    last: u32,
}

impl Unwrapper {
    /// From a word and the position the axis is known to be at then, such as its reference.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "positions are counted in millions"
    )]
    pub fn new(word: PositionWord, shown: u32, known_mm: f64) -> Self {
        let range = i64::from(mask(word.bits)) + 1;
        let last = word.count(shown);
        let about = ((known_mm - word.zero_mm) / word.mm_per_count).round() as i64;
        // The count with these low bits that is nearest to the known position.
        let ahead = (i64::from(last) - about).rem_euclid(range);
        let ahead = if ahead * 2 > range {
            ahead - range
        } else {
            ahead
        };
        Self {
            word,
            count: about + ahead,
            last,
        }
    }

    /// The position after the next word.
    pub fn follow(&mut self, shown: u32) -> Coded {
        let now = self.word.count(shown);
        let range = i64::from(mask(self.word.bits)) + 1;
        let ahead = (i64::from(now) - i64::from(self.last)).rem_euclid(range);
        self.count += if ahead * 2 > range {
            ahead - range
        } else {
            ahead
        };
        self.last = now;
        #[expect(
            clippy::cast_precision_loss,
            reason = "positions are counted in millions"
        )]
        self.word.position(self.count as f64)
    }
}
