//! Plots in a plane of the machine: a path, a circular test, the angle of two axes.

use super::{
    svg::{Anchor, Mark, Scale, Svg, colour_at, escaped, finite, outline, short, spaced, ticks},
    xy::{Look, WIDTH},
};

/// Left, right, top and bottom margin, in picture units.
const MARGINS: [f64; 4] = [52.0, 12.0, 18.0, 40.0];
/// Number of colours of the deviated path.
const COLOURS: usize = 24;
/// Radius of the dot that marks a hole seen along its axis, in picture units. A motion shorter than this radius is
/// drawn as the same dot.
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

const POLAR_WIDTH: f64 = 680.0;
const HEIGHT: f64 = 560.0;
const CENTRE: [f64; 2] = [0.5 * POLAR_WIDTH, 302.0];
/// Radii at which the smallest and the largest value are drawn; the inner one keeps lobes apart.
const RADII: [f64; 2] = [70.0, 232.0];

/// Radial deviations of a circle.
#[derive(Clone, Debug, PartialEq)]
pub struct PolarPlot {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Names of the axes drawn to the right and upwards.
    pub axes: [String; 2],
    /// Unit of the deviations.
    pub unit: String,
    pub series: Vec<PolarSeries>,
}

/// Name, look, and points (angle in rad, deviation) in the order of travel.
pub type PolarSeries = (String, Look, Vec<(f64, f64)>);

/// Draws the plot as one `<svg>` element. Circles are lines of equal deviation; the darker one is zero.
pub fn polar(plot: &PolarPlot) -> String {
    let values = plot.series.iter().flat_map(|(_, _, points)| points);
    let values = values.map(|(_, value)| *value).chain([0.0]);
    let scale = Scale::over(values, RADII, 0.06);
    let [cx, cy] = CENTRE;
    let frame = format!(
        " data-c=\"{cx} {cy}\" data-r=\"{} {} {} {}\"",
        scale.places[0], scale.places[1], scale.values[0], scale.values[1]
    );
    let mut svg = Svg::new("plot polar", (POLAR_WIDTH, HEIGHT), &plot.words, &frame);
    let (values, decimals) = ticks(scale.values, 6);
    for value in &values {
        let class = if *value == 0.0 { "zero" } else { "grid" };
        svg.put(format_args!(
            "<circle class=\"{class}\" cx=\"{cx}\" cy=\"{cy}\" r=\"{}\"/>",
            finite(scale.at(*value))
        ));
    }
    let far = RADII[1] + 6.0;
    svg.line("grid", [cx - far, cy], [cx + far, cy]);
    svg.line("grid", [cx, cy - far], [cx, cy + far]);
    let [right, up] = &plot.axes;
    for (at, anchor, text) in [
        ([cx + far + 6.0, cy + 4.0], Anchor::Start, format!("+{right}")),
        ([cx - far - 6.0, cy + 4.0], Anchor::End, format!("−{right}")),
        ([cx, cy - far - 6.0], Anchor::Middle, format!("+{up}")),
        ([cx, cy + far + 15.0], Anchor::Middle, format!("−{up}")),
    ] {
        svg.text("name", at, anchor, &text);
    }
    let mut x = 58.0;
    for (name, look, points) in &plot.series {
        let class = look.class();
        svg.put(format_args!("<g class=\"s\" data-n=\"{}\">", escaped(name)));
        let places = points.iter().map(|(angle, value)| {
            let r = scale.at(*value);
            ([cx + r * angle.cos(), cy - r * angle.sin()], false)
        });
        let places: Vec<_> = places.collect();
        svg.polyline(class, spaced(&places, 0.4).map(|(at, _)| at));
        svg.raw("</g>");
        svg.line(class, [x, 10.0], [x + 26.0, 10.0]);
        svg.text("key", [x + 32.0, 14.0], Anchor::Start, name);
        x += 50.0 + 8.6 * name.chars().count() as f64;
    }
    // Labels are on the diagonal, where curves seldom have their peaks.
    for value in &values {
        let r = scale.at(*value) * std::f64::consts::FRAC_1_SQRT_2;
        let text = short(*value, decimals);
        svg.text("letter tick", [cx + r, cy - r + 4.0], Anchor::Middle, &text);
    }
    let unit = format!("radial deviation, {}", plot.unit);
    svg.text("name", [POLAR_WIDTH - 14.0, 14.0], Anchor::End, &unit);
    svg.finish()
}

/// Two axes of a machine, and the deviation of their angle from 90°.
#[derive(Clone, Debug, PartialEq)]
pub struct SquareSketch {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Name of the axis drawn to the right.
    pub first: String,
    /// Name of the axis drawn upwards.
    pub second: String,
    /// Angle from the first to the second axis minus 90°, µrad.
    pub angle_urad: f64,
    /// Factor by which the deviation is exaggerated in the sketch.
    pub exaggeration: f64,
    /// The label below the sketch, with the value.
    pub label: String,
}

const SKETCH_WIDTH: f64 = 210.0;
const FOOT: [f64; 2] = [52.0, 168.0];
const LONG: f64 = 128.0;

/// Draws the sketch as one `<svg>` element.
pub fn square_sketch(sketch: &SquareSketch) -> String {
    let mut svg = Svg::new("plot square", (SKETCH_WIDTH, 226.0), &sketch.words, "");
    let drawn = (sketch.angle_urad * 1e-6 * sketch.exaggeration).clamp(-0.6, 0.6);
    let drawn = if drawn.is_finite() { drawn } else { 0.0 };
    let [x, y] = FOOT;
    // An angle above 90° tilts the second axis away from the first.
    let (sin, cos) = drawn.sin_cos();
    let tip = [x - LONG * sin, y - LONG * cos];
    svg.line("ideal", FOOT, [x, y - LONG]);
    svg.line("axis", FOOT, [x + LONG, y]);
    svg.line("axis tilted", FOOT, tip);
    // The arc from the ideal to the actual second axis.
    let arc = (0..=12).map(|step| {
        let angle = drawn * f64::from(step) / 12.0;
        [x - 0.72 * LONG * angle.sin(), y - 0.72 * LONG * angle.cos()]
    });
    svg.polyline("arc", arc);
    svg.line("frame", [x + 14.0, y], [x + 14.0, y - 14.0]);
    svg.line("frame", [x, y - 14.0], [x + 14.0, y - 14.0]);
    svg.text("name", [x + LONG + 8.0, y + 4.0], Anchor::Start, &sketch.first);
    svg.text("name", [tip[0], tip[1] - 7.0], Anchor::Middle, &sketch.second);
    svg.text("letter", [6.0, 196.0], Anchor::Start, &sketch.label);
    let times = format!("× {}", short(sketch.exaggeration, 0));
    svg.text("tick", [6.0, 216.0], Anchor::Start, &times);
    svg.finish()
}
