//! Plot of radial deviations over an angle.

use super::{
    scale::{Scale, short, ticks},
    svg::{Anchor, Svg, escaped, finite},
    thin::spaced,
    xy::Look,
};

const WIDTH: f64 = 680.0;
const HEIGHT: f64 = 560.0;
const CENTRE: [f64; 2] = [0.5 * WIDTH, 302.0];
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
    let mut svg = Svg::new("plot polar", (WIDTH, HEIGHT), &plot.words, &frame);
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
    svg.text("name", [WIDTH - 14.0, 14.0], Anchor::End, &unit);
    svg.finish()
}
