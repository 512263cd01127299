use core::{fmt, ops::Neg, str::FromStr};

use crate::units::{Deg, Mm};

/// Default travel in the opposite direction after which a linear axis counts as reversed.
pub const TURNED_AFTER: Mm = Mm(0.005);
/// Default travel in the opposite direction after which a rotary axis counts as reversed.
pub const TURNED_AFTER_ROTARY: Deg = Deg(5e-4);

/// Direction of the current or last travel of an axis. The direction selects the branch of a bidirectional curve; in
/// ISO 230-2 it is the direction of approach to a target (↑ or ↓). Where the direction is an `Option`, `None` is an
/// unknown direction, for which the mean of both branches applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// Towards larger coordinates: `+` in files, ↑ in the standard.
    Positive,
    /// Towards smaller coordinates: `-` in files, ↓ in the standard.
    Negative,
}

/// A text that is not a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected + or -")]
pub struct UnknownDirection;

impl Direction {
    /// Both directions, the positive one first.
    pub const BOTH: [Self; 2] = [Self::Positive, Self::Negative];

    /// Name in keys of files and responses: `forward` or `backward`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Positive => "forward",
            Self::Negative => "backward",
        }
    }

    /// Sign of travel: +1 or −1.
    pub fn sign(self) -> f64 {
        match self {
            Self::Positive => 1.0,
            Self::Negative => -1.0,
        }
    }

    /// Direction of travel for this change of coordinate (mm, rad or deg); `None` for zero and NaN.
    pub fn of(displacement: f64) -> Option<Self> {
        if displacement > 0.0 {
            Some(Self::Positive)
        } else if displacement < 0.0 {
            Some(Self::Negative)
        } else {
            None
        }
    }
}

impl Neg for Direction {
    type Output = Self;

    fn neg(self) -> Self {
        match self {
            Self::Positive => Self::Negative,
            Self::Negative => Self::Positive,
        }
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Positive => "+",
            Self::Negative => "-",
        })
    }
}

impl FromStr for Direction {
    type Err = UnknownDirection;

    fn from_str(text: &str) -> Result<Self, UnknownDirection> {
        match text {
            "+" => Ok(Self::Positive),
            "-" => Ok(Self::Negative),
            _ => Err(UnknownDirection),
        }
    }
}
