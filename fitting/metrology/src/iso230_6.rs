//! ISO 230-6: positioning accuracy on body and face diagonals, from measured files.

use volcomp_vocabulary::ErrorName;

use crate::text::range;
use crate::{
    Iso230Part2, Measurement, MetrologyError, ReferenceLine, StandardQuantity,
    circular::CircularPlane, evaluate, opening,
};

/// A body or face diagonal, by the signs of motion of X, Y and Z in its forward direction; 0: the
/// axis does not move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(into = "&'static str")]
pub struct Diagonal([i8; 3]);

/// Names of all diagonals, body diagonals first.
pub const DIAGONAL_NAMES: [&str; 10] =
    ["PPP", "NPP", "PNP", "PPN", "PP0", "NP0", "P0P", "N0P", "0PP", "0NP"];

impl Diagonal {
    /// Diagonal with this name, case-insensitive; `None` for other texts. `PPP`, `NPP`, `PNP` and `PPN` are body
    /// diagonals; `PP0` and `NP0` are in the plane X–Y, `P0P` and `N0P` in X–Z, `0PP` and `0NP` in Y–Z.
    pub fn named(name: &str) -> Option<Self> {
        let upper = name.trim().to_ascii_uppercase();
        if !DIAGONAL_NAMES.contains(&upper.as_str()) {
            return None;
        }
        let mut signs = [0; 3];
        for (sign, letter) in signs.iter_mut().zip(upper.chars()) {
            *sign = match letter {
                'P' => 1,
                'N' => -1,
                _ => 0,
            };
        }
        Some(Self(signs))
    }

    /// Name of the diagonal, such as `PPN`.
    pub fn name(self) -> &'static str {
        let same = |name: &&&str| Self::named(name) == Some(self);
        DIAGONAL_NAMES.iter().find(same).copied().unwrap_or("")
    }

    /// Signs of the motion of X, Y and Z along the diagonal; 0 for an axis that does not move.
    pub fn signs(self) -> [i8; 3] {
        self.0
    }

    fn moving(self) -> [bool; 3] {
        self.0.map(|sign| sign != 0)
    }

    fn set(self) -> Vec<Self> {
        let all = DIAGONAL_NAMES.iter().filter_map(|name| Self::named(name));
        all.filter(|other| other.moving() == self.moving()).collect()
    }

    /// Diagonal named by a word of a text, such as `diagonal PPP` or `x-ppn.csv`; `None` if the text names no diagonal
    /// or different diagonals.
    pub fn in_text(text: &str) -> Option<Self> {
        let words = text.split(|c: char| !c.is_alphanumeric());
        let mut named = words.filter_map(Self::named);
        let first = named.next()?;
        named.all(|other| other == first).then_some(first)
    }
}

impl From<Diagonal> for &'static str {
    fn from(diagonal: Diagonal) -> Self {
        diagonal.name()
    }
}

impl std::fmt::Display for Diagonal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// One measured diagonal with its evaluation.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MeasuredDiagonal {
    /// Direction of the diagonal.
    pub diagonal: Diagonal,
    /// Path of the measurement file.
    pub file: String,
    /// Length between the first and the last target, mm.
    pub length_mm: f64,
    /// Evaluation of the readings by the formulas for an axis: E, E↑, E↓, B, M and the table by
    /// target.
    pub result: Iso230Part2,
    /// Growth of the diagonal over its length, µm: the least-squares slope of the means times the
    /// length.
    pub growth_um: f64,
}

/// A squareness error indicated by the diagonals.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SquarenessHint {
    /// Name of the error: `EC0Y`, `EA0Z` or `EB0Z`.
    pub error: ErrorName,
    /// Size of the error, µrad, under the assumption that the diagonals contain only squareness and
    /// equal scales.
    pub urad: f64,
}

/// The evaluation of a set of diagonals.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Iso230Part6 {
    /// The diagonals in the order of the standard.
    pub diagonals: Vec<MeasuredDiagonal>,
    /// Diagonal systematic deviation E_d: the largest E of the diagonals; `None` if a diagonal was
    /// run in one direction only.
    pub e_d_um: Option<f64>,
    /// Largest E↑ or E↓ of the diagonals.
    pub e_d_unidirectional_um: Option<f64>,
    /// Largest reversal value B of the diagonals.
    pub b_d_um: Option<f64>,
    /// Largest M of the diagonals.
    pub m_d_um: Option<f64>,
    /// Mean of the growths divided by their lengths, µm/m: the common part of all diagonals, caused
    /// by scale and temperature.
    pub scale_um_per_m: f64,
    /// Range of the growths, µm: the different part of the diagonals, mostly caused by squareness.
    pub spread_um: f64,
    /// Squareness errors indicated by the growths; only if the edges of the box are stated and all
    /// diagonals of the set measured.
    pub squareness: Vec<SquarenessHint>,
    /// Diagonals of the set that were not measured.
    pub lacking: Vec<Diagonal>,
}

/// Maximum relative difference of the length of a diagonal from the lengths of the other diagonals, and from the length
/// by the edges of the box.
const LENGTHS_WITHIN: f64 = 0.01;

/// Evaluates measured diagonals. `edges_mm` are the edges of the box along X, Y and Z, mm.
///
/// # Errors
///
/// No diagonal, a repeated diagonal, body and face diagonals together, face diagonals of different planes, lengths that
/// differ from each other or from the edges by more than 1 %, angles in place of lengths, or an error of [`evaluate`].
pub fn evaluate_diagonals(
    measured: &[(Diagonal, &Measurement)],
    edges_mm: Option<[f64; 3]>,
) -> Result<Iso230Part6, MetrologyError> {
    let mut diagonals: Vec<MeasuredDiagonal> = Vec::new();
    for &(diagonal, measurement) in measured {
        let one = one_diagonal(diagonal, measurement)?;
        if let Some(first) = diagonals.first() {
            check_beside(first, &one, measurement)?;
        }
        if diagonals.iter().any(|other| other.diagonal == diagonal) {
            let found = format!("{diagonal} a second time");
            return Err(refuse(measurement, "diagonal", found, "each diagonal once"));
        }
        diagonals.push(one);
    }
    let Some(first) = diagonals.first() else {
        return Err(MetrologyError::readings(
            "diagonals",
            "files",
            "none",
            "at least one measured diagonal",
        ));
    };
    let set = first.diagonal.set();
    let lacking: Vec<Diagonal> =
        set.iter().filter(|d| !diagonals.iter().any(|m| m.diagonal == **d)).copied().collect();
    let order = |m: &MeasuredDiagonal| set.iter().position(|d| *d == m.diagonal);
    diagonals.sort_by_key(order);
    if let Some(edges) = edges_mm {
        check_edges(&diagonals[0], edges)?;
    }
    let squareness = match edges_mm {
        Some(edges) if lacking.is_empty() => squareness_hints(&diagonals, edges),
        _ => Vec::new(),
    };
    let largest = |of: &dyn Fn(&Iso230Part2) -> Option<f64>| -> Option<f64> {
        let all: Option<Vec<f64>> = diagonals.iter().map(|m| of(&m.result)).collect();
        all?.into_iter().reduce(f64::max)
    };
    let growths = || diagonals.iter().map(|m| m.growth_um);
    let [lowest, highest] = range(growths());
    let length_mm: f64 = diagonals.iter().map(|m| m.length_mm).sum();
    Ok(Iso230Part6 {
        e_d_um: largest(&|r| r.e),
        e_d_unidirectional_um: largest(&|r| {
            let one_way = [r.e_forward, r.e_backward].into_iter().flatten();
            one_way.reduce(f64::max)
        }),
        b_d_um: largest(&|r| r.b),
        m_d_um: largest(&|r| r.m),
        scale_um_per_m: growths().sum::<f64>() / length_mm * 1e3,
        spread_um: highest - lowest,
        squareness,
        lacking,
        diagonals,
    })
}

impl Iso230Part6 {
    pub fn quantities(&self) -> Vec<StandardQuantity> {
        [
            ("E_d", "diagonal systematic deviation", self.e_d_um),
            (
                "E_d_unidirectional",
                "diagonal systematic deviation, one direction",
                self.e_d_unidirectional_um,
            ),
            ("B_d", "diagonal reversal value", self.b_d_um),
            ("M_d", "diagonal mean deviation", self.m_d_um),
            ("spread", "range of the growths of the diagonals", Some(self.spread_um)),
        ]
        .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, value))
        .to_vec()
    }
}

fn one_diagonal(
    diagonal: Diagonal,
    measurement: &Measurement,
) -> Result<MeasuredDiagonal, MetrologyError> {
    if measurement.unit == Some(crate::DeviationUnit::Urad) {
        let found = "deviations in µrad".to_owned();
        return Err(refuse(measurement, "readings", found, "lengths, µm"));
    }
    let result = evaluate(measurement)?;
    let line = ReferenceLine::least_squares(&measurement.mean_curve()).map_err(|_| {
        let found = "a single target".to_owned();
        refuse(measurement, "targets", found, "at least two on a diagonal")
    })?;
    // The line was fitted to the targets, so there are at least two.
    let targets = measurement.targets();
    let length_mm = targets.last().zip(targets.first()).map_or(0.0, |(b, a)| b - a);
    Ok(MeasuredDiagonal {
        diagonal,
        file: measurement.name.clone(),
        length_mm,
        result,
        growth_um: line.slope_um_per_mm * length_mm,
    })
}

fn check_beside(
    first: &MeasuredDiagonal,
    one: &MeasuredDiagonal,
    measurement: &Measurement,
) -> Result<(), MetrologyError> {
    if first.diagonal.moving() != one.diagonal.moving() {
        let found = format!("{} beside {}", one.diagonal, first.diagonal);
        let expected = "diagonals of one body, or of one plane";
        return Err(refuse(measurement, "diagonal", found, expected));
    }
    if (one.length_mm - first.length_mm).abs() > LENGTHS_WITHIN * first.length_mm {
        let found = format!(
            "{} mm of {} beside {} mm of {}",
            one.length_mm, one.diagonal, first.length_mm, first.diagonal
        );
        let expected = "diagonals of one box, equal within 1 %";
        return Err(refuse(measurement, "length", found, expected));
    }
    Ok(())
}

fn check_edges(first: &MeasuredDiagonal, edges_mm: [f64; 3]) -> Result<(), MetrologyError> {
    let refuse = |found: String, expected: String| {
        MetrologyError::readings("diagonals", "edges of the box", found, expected)
    };
    let [a, b, c] = edges_mm;
    let moving = first.diagonal.moving();
    let unsound =
        |(edge, moves): (f64, bool)| !edge.is_finite() || edge < 0.0 || (moves && edge == 0.0);
    if edges_mm.into_iter().zip(moving).any(unsound) {
        let expected = "finite lengths above zero along the axes that move".to_owned();
        return Err(refuse(format!("{a} × {b} × {c} mm"), expected));
    }
    let squares = edges_mm.into_iter().zip(moving).filter(|(_, moves)| *moves);
    let length = squares.map(|(edge, _)| edge * edge).sum::<f64>().sqrt();
    if (length - first.length_mm).abs() > LENGTHS_WITHIN * first.length_mm {
        let found = format!("{a} × {b} × {c} mm, with a diagonal of {length:.1} mm");
        let expected = format!("{:.1} mm within 1 %, as the targets have it", first.length_mm);
        return Err(refuse(found, expected));
    }
    Ok(())
}

/// Squareness errors from the growths of the diagonals. A squareness that opens the angle moves the tool at (x, y, z)
/// by EC0Y (−y, 0, 0) or EA0Z (0, −z, 0); a squareness that closes the angle moves it by EB0Z (z, 0, 0). For a diagonal
/// of length D in a box with the edges a, b, …, the component of EC0Y along the diagonal is ∓ ab/D, and similar for the
/// others. So sums with the signs of the diagonals isolate one squareness each.
fn squareness_hints(diagonals: &[MeasuredDiagonal], edges_mm: [f64; 3]) -> Vec<SquarenessHint> {
    const URAD_PER_UM_PER_MM: f64 = 1e3;
    let parts = [(CircularPlane::Xy, 0, 1), (CircularPlane::Yz, 1, 2), (CircularPlane::Zx, 0, 2)];
    let both = |(_, i, j): &(CircularPlane, usize, usize)| {
        let moving = diagonals.first().map(|m| m.diagonal.moving());
        moving.is_some_and(|moving| moving[*i] && moving[*j])
    };
    let hint = |(plane, i, j): (CircularPlane, usize, usize)| {
        let error = plane.squareness();
        let sum: f64 = (diagonals.iter())
            .map(|m| {
                let signs = m.diagonal.signs();
                f64::from(signs[i] * signs[j]) * m.growth_um * m.length_mm
            })
            .sum();
        let count = diagonals.len() as f64;
        let area = edges_mm[i] * edges_mm[j];
        SquarenessHint {
            error,
            // The sign says whether the squareness opens or closes the angle.
            urad: -opening(error).unwrap_or(1.0) * sum / (count * area) * URAD_PER_UM_PER_MM,
        }
    };
    parts.into_iter().filter(both).map(hint).collect()
}

fn refuse(measurement: &Measurement, what: &str, found: String, expected: &str) -> MetrologyError {
    MetrologyError::readings(measurement.name.clone(), what, found, expected)
}
