//! Editions of ISO 230-2: their names for the same quantities, and which of them have an annex on uncertainty.

use crate::{Iso230Part2, StandardQuantity};

/// Edition of ISO 230-2. All three editions evaluate with limits of 2 s and the estimator s with n − 1. The edition of
/// 1988, with 3 s, is not supported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Edition {
    /// Second edition, 1997.
    Iso1997,
    /// Third edition, 2006. It adds an annex on the measurement uncertainty.
    Iso2006,
    /// Fourth edition, 2014. It replaces "deviation" and "value" by "error".
    #[default]
    Iso2014,
}

/// Symbol of a quantity, its name in 1997 and 2006, and its name in 2014.
type Names = (&'static str, [&'static str; 2]);

const NAMES: [Names; 12] = [
    ("A", ["bidirectional accuracy of positioning", "bidirectional positioning accuracy"]),
    (
        "A_forward",
        [
            "unidirectional accuracy of positioning, forward",
            "unidirectional positioning accuracy, forward",
        ],
    ),
    (
        "A_backward",
        [
            "unidirectional accuracy of positioning, backward",
            "unidirectional positioning accuracy, backward",
        ],
    ),
    (
        "R",
        ["bidirectional repeatability of positioning", "bidirectional positioning repeatability"],
    ),
    (
        "R_forward",
        [
            "unidirectional repeatability of positioning, forward",
            "unidirectional positioning repeatability, forward",
        ],
    ),
    (
        "R_backward",
        [
            "unidirectional repeatability of positioning, backward",
            "unidirectional positioning repeatability, backward",
        ],
    ),
    (
        "E",
        [
            "bidirectional systematic deviation of positioning",
            "bidirectional systematic positioning error",
        ],
    ),
    (
        "E_forward",
        [
            "unidirectional systematic deviation of positioning, forward",
            "unidirectional systematic positioning error, forward",
        ],
    ),
    (
        "E_backward",
        [
            "unidirectional systematic deviation of positioning, backward",
            "unidirectional systematic positioning error, backward",
        ],
    ),
    (
        "M",
        [
            "range of the mean bidirectional positional deviation",
            "range of the mean bidirectional positioning error",
        ],
    ),
    ("B", ["reversal value", "reversal error"]),
    ("mean_B", ["mean reversal value", "mean reversal error"]),
];

impl Edition {
    pub fn year(self) -> u16 {
        match self {
            Self::Iso1997 => 1997,
            Self::Iso2006 => 2006,
            Self::Iso2014 => 2014,
        }
    }

    /// Edition published in this year; `None` if the year has no supported edition.
    pub fn of_year(year: u16) -> Option<Self> {
        let all = [Self::Iso1997, Self::Iso2006, Self::Iso2014];
        all.into_iter().find(|edition| edition.year() == year)
    }

    /// Whether the edition has an annex on the measurement uncertainty, as the editions from 2006 on do.
    pub fn states_uncertainty(self) -> bool {
        self != Self::Iso1997
    }

    /// Symbols of the quantities, in their order. They are the same in every edition.
    pub fn symbols() -> [&'static str; 12] {
        NAMES.map(|(symbol, _)| symbol)
    }

    /// Quantities of an evaluation, with their names in this edition.
    pub fn quantities(self, result: &Iso230Part2) -> Vec<StandardQuantity> {
        let values = [
            result.a,
            result.a_forward,
            result.a_backward,
            result.r,
            result.r_forward,
            result.r_backward,
            result.e,
            result.e_forward,
            result.e_backward,
            result.m,
            result.b,
            result.mean_b,
        ];
        let names = usize::from(self == Self::Iso2014);
        (NAMES.iter().zip(values))
            .map(|((symbol, name), value)| StandardQuantity::new(symbol, name[names], value))
            .collect()
    }
}
