//! Tolerances of the quantities of standards, and the decision that takes the measurement uncertainty into account.

use crate::{DeviationUnit, MetrologyError};

#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct StandardQuantity {
    /// Symbol in plain letters, as in tolerances: `A`, `A_forward`, `mean_B`, `Ps_max`.
    pub symbol: &'static str,
    /// Name of the quantity in the standard, in words.
    pub name: &'static str,
    /// Value, in the unit of the evaluation; `None` if it cannot be evaluated.
    pub value: Option<f64>,
}

impl StandardQuantity {
    pub(crate) fn new(symbol: &'static str, name: &'static str, value: Option<f64>) -> Self {
        Self { symbol, name, value }
    }
}

#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tolerance {
    /// Symbol of the quantity, such as `A`, `E_forward`, `B`.
    pub symbol: String,
    /// Upper limit, in the unit of the evaluation.
    pub limit: f64,
}

/// Decision on one quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within the limit, even with the uncertainty added.
    Pass,
    /// Beyond the limit, even with the uncertainty subtracted.
    Fail,
    /// Nearer to the limit than the uncertainty: neither conformity nor non-conformity is proven (ISO 14253-1).
    Undecided,
    /// The quantity could not be evaluated.
    #[serde(rename = "not evaluated")]
    NotEvaluated,
}

impl Verdict {
    /// The verdict in words: `pass`, `fail`, `undecided` or `not evaluated`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Undecided => "undecided",
            Self::NotEvaluated => "not evaluated",
        }
    }

    /// Combined verdict: the first one that occurs of fail, not evaluated, undecided and pass; `Pass` for an empty
    /// list.
    pub fn of_all(verdicts: impl IntoIterator<Item = Self>) -> Self {
        let rank = |verdict: &Self| match verdict {
            Self::Fail => 3,
            Self::NotEvaluated => 2,
            Self::Undecided => 1,
            Self::Pass => 0,
        };
        let worst = verdicts.into_iter().max_by_key(rank);
        worst.unwrap_or(Self::Pass)
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

/// Decides on the magnitude of a value by ISO 14253-1. `u` is the expanded uncertainty (k = 2) of the value, at
/// least 0. If `u` is `None`, the value is compared with the limit directly.
pub fn decide(value: Option<f64>, limit: f64, u: Option<f64>) -> Verdict {
    let Some(size) = value.map(f64::abs) else {
        return Verdict::NotEvaluated;
    };
    let u = u.unwrap_or(0.0);
    if size + u <= limit {
        Verdict::Pass
    } else if size - u > limit {
        Verdict::Fail
    } else {
        Verdict::Undecided
    }
}

/// A quantity of a standard with its uncertainty and its tolerance.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JudgedQuantity {
    /// Name of the standard: `ISO 230-2:2014`, `VDI/DGQ 3441`, `ASME B5.54`, `ISO 230-4`, `ISO
    /// 230-6`.
    pub standard: String,
    /// Symbol in plain letters, as in a tolerance.
    pub symbol: &'static str,
    /// The name in the standard.
    pub name: &'static str,
    /// Value; `None` if it cannot be evaluated.
    pub value: Option<f64>,
    /// The unit of value, uncertainty and limit.
    pub unit: DeviationUnit,
    /// Expanded measurement uncertainty (k = 2); `None` if not stated.
    pub uncertainty: Option<f64>,
    /// The tolerance; `None` if not stated.
    pub limit: Option<f64>,
    /// The decision; `None` without a tolerance.
    pub verdict: Option<Verdict>,
}

/// Compares the quantities of a standard with their tolerances. `uncertainty` returns the expanded uncertainty for a
/// symbol; `None` if unknown.
pub fn judged(
    standard: &str,
    quantities: impl IntoIterator<Item = StandardQuantity>,
    unit: DeviationUnit,
    tolerances: &[Tolerance],
    uncertainty: impl Fn(&str) -> Option<f64>,
) -> Vec<JudgedQuantity> {
    let one = |quantity: StandardQuantity| {
        let tolerance = tolerances.iter().find(|t| t.symbol == quantity.symbol);
        let limit = tolerance.map(|t| t.limit);
        let u = uncertainty(quantity.symbol);
        JudgedQuantity {
            standard: standard.to_owned(),
            symbol: quantity.symbol,
            name: quantity.name,
            value: quantity.value,
            unit,
            uncertainty: u.filter(|_| quantity.value.is_some()),
            limit,
            verdict: limit.map(|limit| decide(quantity.value, limit, u)),
        }
    };
    quantities.into_iter().map(one).collect()
}

/// The decision over all tolerances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Decision {
    /// Combined verdict of the quantities.
    pub verdict: Verdict,
    /// Whether every quantity with a tolerance passes.
    pub pass: bool,
    /// Decision rule: `ISO 14253-1` if every quantity with a limit has an uncertainty, `simple` if
    /// none has, `mixed` otherwise.
    pub rule: &'static str,
}

impl Decision {
    /// Decides over all tolerances; `None` without tolerances.
    pub fn over(quantities: &[JudgedQuantity]) -> Option<Self> {
        let judged = || quantities.iter().filter(|q| q.verdict.is_some());
        let uncertain = judged().filter(|q| q.uncertainty.is_some()).count();
        let verdict = Verdict::of_all(judged().filter_map(|q| q.verdict));
        (judged().count() > 0).then(|| Self {
            verdict,
            pass: verdict == Verdict::Pass,
            rule: match uncertain {
                0 => "simple",
                all if all == judged().count() => "ISO 14253-1",
                _ => "mixed",
            },
        })
    }
}

/// Parses a text such as `A=10,E=8,B=2`. `known` lists the valid symbols. Symbols may be in upper or lower case.
///
/// # Errors
/// A symbol that is unknown or repeated, a limit that is not a finite number of at least 0, or no tolerance.
pub fn parse_tolerances(text: &str, known: &[&str]) -> Result<Vec<Tolerance>, MetrologyError> {
    // `U_max` and `u_MAX` are the same symbol. If two known symbols differ only in case, an exact match has priority.
    let named = |symbol: &str| {
        let exact = known.iter().find(|name| **name == symbol);
        let named = exact.or_else(|| known.iter().find(|name| name.eq_ignore_ascii_case(symbol)));
        named.map(|name| (*name).to_owned())
    };
    parse_tolerances_of(text, named, &format!("one of {}", known.join(", ")))
}

/// Parses tolerances like [`parse_tolerances`], for symbols that cannot be listed, such as `EXX.A`. `named` returns the
/// spelling of a symbol, or `None` for an unknown symbol. `expected` describes the valid symbols in messages.
///
/// # Errors
/// The errors of [`parse_tolerances`].
pub fn parse_tolerances_of(
    text: &str,
    named: impl Fn(&str) -> Option<String>,
    expected: &str,
) -> Result<Vec<Tolerance>, MetrologyError> {
    let refuse = |what: String, found: &str, expected: String| {
        MetrologyError::readings("tolerance", what, volcomp_document::quoted(found), expected)
    };
    let mut tolerances: Vec<Tolerance> = Vec::new();
    for part in text.split(',') {
        let part = part.trim();
        let Some((symbol, limit)) = part.split_once('=') else {
            let expected = "a symbol and its limit, `A=10,E=8,B=2`".to_owned();
            return Err(refuse("part".into(), part, expected));
        };
        let (symbol, limit) = (symbol.trim(), limit.trim());
        let Some(named) = named(symbol) else {
            return Err(refuse("symbol".into(), symbol, expected.to_owned()));
        };
        let value: Option<f64> = limit.parse().ok();
        let Some(value) = value.filter(|value| (0.0..=crate::text::LARGEST).contains(value)) else {
            let expected = "a number of at least 0, without its unit".to_owned();
            return Err(refuse(format!("limit of {named}"), limit, expected));
        };
        if tolerances.iter().any(|other| other.symbol == named) {
            let expected = "each symbol once".to_owned();
            return Err(refuse("symbol".into(), symbol, expected));
        }
        tolerances.push(Tolerance { symbol: named, limit: value });
    }
    Ok(tolerances)
}
