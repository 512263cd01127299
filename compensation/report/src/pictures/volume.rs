//! Pictures of the error of the tool: maps of the working space, and the path of an NC program with and without compensation.

use volcomp_vocabulary::AxisName;

use super::{iso230::in_pairs, span};
use crate::{
    plot::{
        HeatMap, Panel, PathPlot, PathPoint, colour_bar, heat_map, path_plot, picture, round_below,
        short,
    },
    report::{Slice, Vector, Volume},
};

/// Length of the longest arrow of a map, in picture units: about the distance from its position to the frame.
const LONGEST: f64 = 32.0;

/// Maps of both states, with a common colour scale and a common scale of the arrows.
pub(crate) struct Maps {
    /// Maps before compensation, or of the only state.
    pub(crate) before: Vec<HeatMap>,
    /// Maps after compensation; empty if there is no such state.
    pub(crate) after: Vec<HeatMap>,
    /// Error shown by the last colour, µm.
    pub(crate) most_um: f64,
}

pub(crate) fn maps(volume: &Volume) -> Maps {
    let all = volume.slices.iter().flat_map(|slice| {
        let after = slice.after_um.iter().flatten();
        slice.before_um.iter().chain(after)
    });
    let most_um = all.copied().filter(|um| um.is_finite()).fold(0.0, f64::max);
    let arrows = |after: bool| {
        let of = |slice| arrows(slice, after);
        volume.slices.iter().map(of).collect::<Vec<_>>()
    };
    let arrows = [arrows(false), arrows(true)];
    let lengths = arrows.iter().flatten().flatten();
    let longest = lengths.map(|(_, [u, v])| u.hypot(*v));
    let longest = longest.filter(|um| um.is_finite()).fold(0.0, f64::max);
    let arrow_scale = if longest > 0.0 { LONGEST / longest } else { 0.0 };
    let map = |slice: &Slice, word: &str, values: &[f64], arrows: &[([f64; 2], [f64; 2])]| {
        let held = match slice.held {
            Some((axis, at)) => format!(", {axis} = {} mm", short(at, 0)),
            None if slice.across.is_rotary() => ", X, Y, Z in the middle".to_owned(),
            None => String::new(),
        };
        let title = format!("{}{}{held}", slice.across, slice.up);
        HeatMap {
            words: format!("plane {title} {word}"),
            title: format!("{title}{}{word}", if word.is_empty() { "" } else { ", " }),
            x_label: label(slice.across),
            y_label: label(slice.up),
            x: slice.x.clone(),
            y: slice.y.clone(),
            values: values.to_vec(),
            most: most_um,
            unit: "µm".to_owned(),
            arrows: arrows.to_vec(),
            arrow_scale,
        }
    };
    let word = if volume.after.is_some() { "before" } else { "" };
    let [arrows_before, arrows_after] = arrows;
    let slices = || volume.slices.iter();
    let before = slices()
        .zip(&arrows_before)
        .map(|(slice, arrows)| map(slice, word, &slice.before_um, arrows));
    let after = slices()
        .zip(&arrows_after)
        .filter_map(|(slice, arrows)| Some(map(slice, "after", slice.after_um.as_ref()?, arrows)));
    Maps { before: before.collect(), after: after.collect(), most_um }
}

fn label(axis: AxisName) -> String {
    format!("{axis}, {}", axis.kind().coordinate_unit())
}

/// Positions and error vectors of a plane, projected onto it.
fn arrows(slice: &Slice, after: bool) -> Vec<([f64; 2], [f64; 2])> {
    let (across, up) = (slice.across.mcs_index(), slice.up.mcs_index());
    let arrow = |vector: &Vector| {
        let error = if after { vector.after_um? } else { vector.before_um };
        let in_plane = |of: [f64; 3]| [of[across], of[up]];
        Some((in_plane(vector.at_mm), in_plane(error)))
    };
    slice.vectors.iter().filter_map(arrow).collect()
}

/// Draws the volumetric error: maps over planes with the error vectors in them, a map over two rotary axes, and one colour scale.
pub fn map_picture(title: &str, lines: &[String], volume: &Volume) -> String {
    let maps = maps(volume);
    let panel = |map: &HeatMap| Panel { heading: String::new(), svg: heat_map(map) };
    let panels: Vec<Panel> = maps.before.iter().chain(&maps.after).map(panel).collect();
    let mut rows = in_pairs(&panels);
    rows.push(vec![Panel { heading: String::new(), svg: colour_bar(COLOURS, maps.most_um) }]);
    picture(title, lines, &rows)
}

/// Label of the colour scale of the maps.
pub(crate) const COLOURS: &str = "length of the error, µm";

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
