//! Plot of a path in a plane with its magnified deviations, coloured by their size.

use super::{
    colour::colour_at,
    marks::{Mark, outline},
    scale::{short, ticks},
    svg::{Anchor, Svg, finite},
    thin::spaced,
    xy::WIDTH,
};

/// Left, right, top and bottom margin, in picture units.
const MARGINS: [f64; 4] = [52.0, 12.0, 18.0, 40.0];
/// Number of colours of the deviated path.
const COLOURS: usize = 24;
/// Radius of the dot that marks a hole seen along its axis, in picture units; a motion shorter than that is drawn as such a dot.
const HOLE: f64 = 3.0;

/// Position on a path, with its deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Programmed position in the plane, mm.
    pub at_mm: [f64; 2],
    /// Deviation in the plane, µm.
    pub deviation_um: [f64; 2],
    /// Magnitude of the deviation in space, µm, which the colour shows.
    pub size_um: f64,
    /// Whether a line begins here, without a connection to the previous point.
    pub begins: bool,
}

/// A path and its deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct PathPlot {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Labels of the horizontal and the vertical axis, with their unit.
    pub labels: [String; 2],
    /// Drawn range of both axes, mm.
    pub range_mm: [[f64; 2]; 2],
    /// Width of the picture, in its own units.
    pub width: f64,
    /// Magnification of the deviations relative to the path.
    pub magnification: f64,
    /// Deviation shown by the last colour, µm; the first colour is 0.
    pub most_um: f64,
    /// Points of the path, in the order of travel.
    pub points: Vec<PathPoint>,
    /// Point of the largest deviation, and its label; `None`: not marked.
    pub worst: Option<(PathPoint, String)>,
}

/// Draws a path plot with the same scale for both axes.
pub fn path_plot(plot: &PathPlot) -> String {
    let [left, right, top, bottom] = MARGINS;
    let width = if plot.width.is_finite() { plot.width.clamp(200.0, 2000.0) } else { WIDTH };
    let range_mm = plot.range_mm.map(drawn_range);
    let times = if plot.magnification.is_finite() { plot.magnification } else { 1.0 };
    let [across, up] = range_mm.map(|[low, high]| high - low);
    // A minimum height leaves room for the labels of a long thin path.
    let scale = ((width - left - right) / across).min(1.3 * width / up);
    let height = (up * scale).max(60.0);
    let (foot, middle) = (top + height, 0.5 * (height - up * scale));
    let [[x_low, _], [y_low, _]] = range_mm;
    let on_page =
        |[x, y]: [f64; 2]| [left + (x - x_low) * scale, foot - middle - (y - y_low) * scale];
    let frame = format!(
        " data-x=\"{left} {x_low} {scale}\" data-y=\"{} {y_low} {scale}\" data-times=\"{times}\"",
        foot - middle
    );
    let end = width - right;
    let mut svg = Svg::new("plot path", (width, foot + bottom), &plot.words, &frame);
    axes(&mut svg, plot, range_mm, ([left, end], [top, foot]), &on_page);
    let drawn = |magnification: f64| {
        plot.points.iter().map(move |point| {
            let at = [0, 1].map(|i| point.at_mm[i] + 1e-3 * magnification * point.deviation_um[i]);
            (on_page(at), point)
        })
    };
    let mut path = String::new();
    let all: Vec<_> = drawn(0.0).map(|(at, point)| (at, point.begins)).collect();
    for (at, begins) in spaced(&all, 0.5) {
        let verb = if begins || path.is_empty() { 'M' } else { 'L' };
        step(&mut path, verb, at);
    }
    svg.put(format_args!("<path class=\"ideal\" d=\"{path}\"/>"));
    coloured(&mut svg, plot, drawn(times));
    if let Some((point, label)) = &plot.worst {
        let at = [0, 1].map(|i| point.at_mm[i] + 1e-3 * times * point.deviation_um[i]);
        let [x, y] = on_page(at).map(finite);
        svg.put(format_args!("<circle class=\"worst\" cx=\"{x}\" cy=\"{y}\" r=\"5\"/>"));
        let (dx, anchor) = if x > 0.6 * width { (-9.0, Anchor::End) } else { (9.0, Anchor::Start) };
        svg.text("letter", [x + dx, y - 7.0], anchor, label);
    }
    svg.finish()
}

/// Range to draw, mm; 0 to 1 mm if the range is invalid or has no extent.
fn drawn_range([low, high]: [f64; 2]) -> [f64; 2] {
    /// Maximum magnitude of a drawn coordinate, mm.
    const MOST: f64 = 1e9;
    if high - low > 1e-9 && low.abs().max(high.abs()) <= MOST { [low, high] } else { [0.0, 1.0] }
}

/// Draws the deviated path in steps of at least half a pixel, as one element per colour.
fn coloured<'a>(
    svg: &mut Svg,
    plot: &PathPlot,
    points: impl Iterator<Item = ([f64; 2], &'a PathPoint)>,
) {
    let (mut under, mut paths) = (String::new(), vec![String::new(); COLOURS]);
    let mut before: Option<([f64; 2], usize, bool)> = None;
    for (at, point) in points {
        if !(at[0].is_finite() && at[1].is_finite()) {
            continue;
        }
        let colour = colour_of(point.size_um, plot.most_um);
        if let Some((from, of, began)) = before
            && !point.begins
        {
            let far = (at[0] - from[0]).hypot(at[1] - from[1]);
            let path = &mut paths[colour];
            if began && far < HOLE {
                // A hole seen along its axis is a line without length.
                outline(path, Mark::Dot, at, HOLE);
                outline(&mut under, Mark::Dot, at, HOLE);
                before = Some((at, colour, false));
                continue;
            }
            if far < 0.5 && of == colour {
                continue;
            }
            for path in [path, &mut under] {
                step(path, 'M', from);
                step(path, 'L', at);
            }
        }
        before = Some((at, colour, point.begins));
    }
    svg.put(format_args!("<path class=\"under\" d=\"{under}\"/>"));
    for (colour, path) in paths.iter().enumerate() {
        if !path.is_empty() {
            let share = (colour as f64 + 0.5) / COLOURS as f64;
            let colour = colour_at(share);
            svg.put(format_args!(
                "<path class=\"deviated\" style=\"stroke:{colour}\" d=\"{path}\"/>"
            ));
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "held between 0 and the number of colours"
)]
fn colour_of(size_um: f64, most_um: f64) -> usize {
    let share = if most_um > 0.0 { size_um / most_um } else { 0.0 };
    (share.clamp(0.0, 1.0) * COLOURS as f64).min(COLOURS as f64 - 1.0) as usize
}

/// Appends a step to a path; positions are rounded to tenths of a pixel.
fn step(path: &mut String, verb: char, [x, y]: [f64; 2]) {
    use std::fmt::Write as _;
    let _ = write!(path, "{verb}{} {}", tenths(x), tenths(y));
}

fn tenths(x: f64) -> f64 {
    finite((x * 10.0).round() / 10.0)
}

fn axes(
    svg: &mut Svg,
    plot: &PathPlot,
    [x, y]: [[f64; 2]; 2],
    ([left, right], [top, foot]): ([f64; 2], [f64; 2]),
    on_page: &dyn Fn([f64; 2]) -> [f64; 2],
) {
    let count = if plot.width > 400.0 { 8 } else { 4 };
    let (values, decimals) = ticks(x, count);
    for value in values {
        let at = on_page([value, 0.0])[0];
        svg.line("grid", [at, top], [at, foot]);
        let text = short(value, decimals);
        svg.text("tick", [at, foot + 15.0], Anchor::Middle, &text);
    }
    let (values, decimals) = ticks(y, 5);
    for value in values {
        let at = on_page([0.0, value])[1];
        svg.line("grid", [left, at], [right, at]);
        let text = short(value, decimals);
        svg.text("tick", [left - 6.0, at + 4.0], Anchor::End, &text);
    }
    svg.line("frame", [left, top], [left, foot]);
    svg.line("frame", [left, foot], [right, foot]);
    let [across, up] = &plot.labels;
    svg.text("name", [right, foot + 31.0], Anchor::End, across);
    svg.text("name", [6.0, top - 6.0], Anchor::Start, up);
}
