//! The picture of an NC program: its path, and the deviation of the tool with and without compensation.

use super::span;
use crate::plot::{Panel, PathPlot, PathPoint, colour_bar, path_plot, picture, round_below, short};

/// Commanded position of an NC program, with its deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProgramPlace {
    /// Programmed position of the tip, mm.
    pub tip_mm: [f64; 3],
    /// Deviation of the tip with the original program, µm.
    pub before_um: [f64; 3],
    /// Deviation of the tip with the compensated program, µm.
    pub after_um: [f64; 3],
    /// Whether a path begins here, without a connection to the previous position.
    pub begins: bool,
}

/// Figures of the deviation along one program, original or compensated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProgramFigures {
    /// Largest deviation, µm.
    pub max_um: f64,
    /// Root mean square of the deviation, µm.
    pub rms_um: f64,
    /// Line number in the program of the largest deviation, from 1.
    pub line: usize,
    /// Programmed position of the tip at the largest deviation, mm.
    pub tip_mm: [f64; 3],
}

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Maximum size of the largest deviation in the picture, as a share of its width.
const DRAWN: f64 = 0.08;

/// Draws a path in the plane of its largest extent, without and with compensation, at the same scale. The deviations are magnified by the
/// largest round factor at which they stay small relative to the path.
pub fn program_picture(
    files: &[String],
    path: &[ProgramPlace],
    [before, after]: [ProgramFigures; 2],
) -> String {
    let plane = plane_of(path);
    let along = |axis: usize| {
        let of = span(path.iter().map(|place| place.tip_mm[plane[axis]]));
        of.unwrap_or([0.0, 1.0])
    };
    let extent = [along(0), along(1)].map(|[low, high]| high - low);
    let extent = extent[0].max(extent[1]).max(1e-3);
    let sizes = path.iter().flat_map(|place| {
        let sizes = [place.before_um, place.after_um];
        sizes.map(|um| um.iter().map(|x| x * x).sum::<f64>().sqrt())
    });
    let most_um = sizes.filter(|um| um.is_finite()).fold(0.0, f64::max);
    let magnification =
        if most_um > 0.0 { round_below(DRAWN * extent / (1e-3 * most_um)).max(1.0) } else { 1.0 };
    let points = |after: bool| {
        let point = move |place: &ProgramPlace| {
            let um = if after { place.after_um } else { place.before_um };
            PathPoint {
                at_mm: plane.map(|axis| place.tip_mm[axis]),
                deviation_um: plane.map(|axis| um[axis]),
                size_um: um.iter().map(|x| x * x).sum::<f64>().sqrt(),
                begins: place.begins,
            }
        };
        path.iter().map(point).collect::<Vec<_>>()
    };
    let states = [points(false), points(true)];
    let range_mm = [0, 1].map(|axis| {
        let all = states.iter().flatten().flat_map(|point| {
            let at = point.at_mm[axis];
            [at, at + 1e-3 * magnification * point.deviation_um[axis]]
        });
        let [low, high] = span(all).unwrap_or([0.0, 1.0]);
        let room = 0.03 * extent;
        [low - room, high + room]
    });
    let [across, up] = range_mm.map(|[low, high]| high - low);
    let beside = across < 1.6 * up;
    let plot = |words: &str, points: &[PathPoint], figures: ProgramFigures| PathPlot {
        words: words.to_owned(),
        labels: plane.map(|axis| format!("{}, mm", AXES[axis])),
        range_mm,
        width: if beside { 340.0 } else { 680.0 },
        magnification,
        most_um,
        points: points.to_vec(),
        worst: worst(plane, points, figures),
    };
    let panel = |name: &str, points: &[PathPoint], of: ProgramFigures| Panel {
        heading: format!(
            "{name}: at most {} µm (line {}), RMS {} µm",
            short(of.max_um, 1),
            of.line,
            short(of.rms_um, 1)
        ),
        svg: path_plot(&plot(name, points, of)),
    };
    let mut panels =
        vec![panel("original", &states[0], before), panel("compensated", &states[1], after)];
    let mut rows: Vec<Vec<Panel>> =
        if beside { vec![panels] } else { panels.drain(..).map(|panel| vec![panel]).collect() };
    rows.push(vec![Panel {
        heading: String::new(),
        svg: colour_bar("length of the deviation of the tool, µm", most_um),
    }]);
    let title = format!(
        "Tool deviation from the programmed path, {} times magnified",
        short(magnification, 0)
    );
    picture(&title, files, &rows)
}

/// Point at the largest deviation, with the other data of the nearest stored point, and its label; `None` without points.
fn worst(
    plane: [usize; 2],
    points: &[PathPoint],
    of: ProgramFigures,
) -> Option<(PathPoint, String)> {
    let at = plane.map(|axis| of.tip_mm[axis]);
    let far = |point: &PathPoint| (point.at_mm[0] - at[0]).hypot(point.at_mm[1] - at[1]);
    let nearest = points.iter().min_by(|a, b| far(a).total_cmp(&far(b)))?;
    let point = PathPoint { at_mm: at, ..*nearest };
    Some((point, format!("{} µm", short(of.max_um, 1))))
}

/// Indices of the two axes of the largest extent of the path, in axis order. End points of rapid motions count only if there are no other points.
fn plane_of(path: &[ProgramPlace]) -> [usize; 2] {
    let has_drawn = path.iter().any(|place| !place.begins);
    let extent = |i: usize| {
        let drawn = path.iter().filter(|place| !(has_drawn && place.begins));
        let [low, high] = span(drawn.map(|place| place.tip_mm[i])).unwrap_or([0.0; 2]);
        high - low
    };
    let shortest = (0..3).rev().min_by(|a, b| extent(*a).total_cmp(&extent(*b)));
    match shortest {
        Some(0) => [1, 2],
        Some(1) => [0, 2],
        _ => [0, 1],
    }
}
