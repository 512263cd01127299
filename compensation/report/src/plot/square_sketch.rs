use super::{
    scale::short,
    svg::{Anchor, Svg},
};

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

const WIDTH: f64 = 210.0;
const FOOT: [f64; 2] = [52.0, 168.0];
const LONG: f64 = 128.0;

/// Draws the sketch as one `<svg>` element.
pub fn square_sketch(sketch: &SquareSketch) -> String {
    let mut svg = Svg::new("plot square", (WIDTH, 226.0), &sketch.words, "");
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
