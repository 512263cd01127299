//! Pictures of results, for the report and for the files that the commands draw.

mod curve;
mod iso230;
mod volume;

use volcomp_metrology::JudgedQuantity;

use crate::plot::{Look, Mark, Series, SquareSketch, XyPlot, round_below, short};

pub use curve::{curve_picture, effects_picture, residuals_picture};
pub(crate) use curve::{curve_plot, direction_word, residual_plot};
pub use iso230::{
    CirclePlot, SlopePlot, SquarenessPlot, StraightnessPlot, circles_picture, diagonals_picture,
    measured_diagonals_picture, positioning_picture, squareness_picture, straightness_picture,
};
pub(crate) use iso230::{diagonal_plots, positioning_plot};
pub(crate) use volume::{COLOURS, Maps, maps};
pub use volume::{ProgramFigures, ProgramPlace, map_picture, program_picture};

/// Lines of text, one per standard, with the values, limits and verdicts of its quantities. Quantities of a single direction are listed only if
/// they have a limit.
fn figures(quantities: &[JudgedQuantity]) -> Vec<String> {
    let of_standards = quantities.chunk_by(|a, b| a.standard == b.standard);
    let line = |of: &[JudgedQuantity]| {
        let is_of_both = |of: &JudgedQuantity| {
            !["forward", "backward", "unidirectional"].iter().any(|way| of.symbol.contains(way))
        };
        let shown = of.iter().filter(|of| of.limit.is_some() || is_of_both(of));
        let shown: Vec<String> = shown.filter_map(figure).collect();
        let standard = &of.first()?.standard;
        (!shown.is_empty()).then(|| format!("{standard}: {}", shown.join(", ")))
    };
    of_standards.filter_map(line).collect()
}

fn figure(of: &JudgedQuantity) -> Option<String> {
    let JudgedQuantity { symbol, unit, .. } = of;
    let value = if let Some(value) = of.value {
        format!("{} {unit}", short(value, 2))
    } else {
        of.limit?;
        "–".to_owned()
    };
    Some(match (of.limit, of.verdict) {
        (Some(limit), Some(verdict)) => {
            format!("{symbol} {value} (limit {}: {verdict})", short(limit, 2))
        }
        _ => format!("{symbol} {value}"),
    })
}

/// Draws the limits of a tolerance: two lines at a distance of `limit`, about the middle of `span`.
fn tolerance_lines(plot: &mut XyPlot, symbol: &str, unit: &str, span: [f64; 2], limit: f64) {
    let middle = f64::midpoint(span[0], span[1]);
    let [left, right] = plot.coordinate_range();
    for (side, name) in [(0.5, "upper"), (-0.5, "lower")] {
        let at = middle + side * limit;
        plot.series.push(Series {
            name: format!("{name} limit of {symbol}"),
            points: vec![(left, at), (right, at)],
            look: Look::Tolerance,
            mark: Mark::None,
            line: true,
        });
    }
    let text = format!("tolerance {symbol} {} {unit}", short(limit, 2));
    plot.legend.push((Look::Tolerance, Mark::None, text));
}

/// Smallest and largest finite value; `None` without any.
fn span(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |span: Option<[f64; 2]>, value| {
        let [low, high] = span.unwrap_or([value; 2]);
        Some([low.min(value), high.max(value)])
    })
}

/// Round factor by which angles are exaggerated so that the largest of them, µrad, is visible.
pub(crate) fn exaggeration(angles_urad: impl IntoIterator<Item = f64>) -> f64 {
    /// Drawn angle of the largest squareness error, rad.
    const DRAWN_RAD: f64 = 0.2;
    let angles = angles_urad.into_iter().map(f64::abs);
    let largest = angles.filter(|angle| angle.is_finite()).fold(0.0, f64::max);
    if largest > 0.0 { round_below(DRAWN_RAD / (largest * 1e-6)) } else { 1.0 }
}

/// Sketch of the angle between two axes; `angle_urad` is its deviation from 90°.
pub(crate) fn sketch(
    [first, second]: &[String; 2],
    angle_urad: f64,
    exaggeration: f64,
) -> SquareSketch {
    SquareSketch {
        words: format!("{first} {second}: {} µrad", short(angle_urad, 1)),
        first: first.clone(),
        second: second.clone(),
        angle_urad,
        exaggeration,
        label: format!("{first}{second}: 90° {} µrad", signed(angle_urad)),
    }
}

fn signed(value: f64) -> String {
    let sign = if value < 0.0 { "−" } else { "+" };
    format!("{sign} {}", short(value.abs(), 1))
}
