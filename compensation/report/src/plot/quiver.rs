//! Error vectors in space: a static view for printing, and their coordinates for a script that rotates them.

use std::fmt::Write as _;

use super::{
    scale::{round_below, short},
    svg::{Anchor, Svg, finite},
};

const SIZE: [f64; 2] = [680.0, 460.0];
/// Length of the longest arrow as a fraction of the largest travel.
const LONGEST: f64 = 0.22;

/// One error vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrow {
    /// Position, mm.
    pub at_mm: [f64; 3],
    /// Error at the position, µm.
    pub error_um: [f64; 3],
    /// Whether the error is that after compensation.
    pub after: bool,
}

/// Error vectors over a working space.
#[derive(Clone, Debug, PartialEq)]
pub struct Quiver {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Ends of the travels of X, Y and Z, mm.
    pub travels_mm: [[f64; 2]; 3],
    /// Error vectors, before and after compensation.
    pub arrows: Vec<Arrow>,
    /// Label of the scale arrow.
    pub scale_word: String,
}

/// Rotation about the vertical axis, and tilt of the static view, rad.
const VIEW: [f64; 2] = [-0.62, 0.42];

/// Draws a quiver plot.
pub fn quiver(quiver: &Quiver) -> String {
    let [width, height] = SIZE;
    let range = |[low, high]: [f64; 2]| {
        if high > low && (high - low).is_finite() { high - low } else { 1.0 }
    };
    let largest = quiver.travels_mm.map(range).into_iter().fold(0.0, f64::max);
    let middle = quiver.travels_mm.map(|[low, high]| {
        let middle = f64::midpoint(low, high);
        if middle.is_finite() { middle } else { 0.0 }
    });
    // Scales to a box whose longest side is 1.
    let to_box = |at: [f64; 3]| [0, 1, 2].map(|axis| (at[axis] - middle[axis]) / largest);
    let length = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let finite_arrows: Vec<&Arrow> = quiver
        .arrows
        .iter()
        .filter(|arrow| arrow.at_mm.iter().chain(&arrow.error_um).all(|x| x.is_finite()))
        .collect();
    let longest_um = finite_arrows.iter().map(|a| length(&a.error_um)).fold(0.0, f64::max);
    let per_um = if longest_um > 0.0 { LONGEST / longest_um } else { 0.0 };
    let [x, y, z] = quiver.travels_mm;
    let corners = edges_of_box([x, y, z]).into_iter().flatten().map(to_box);
    let scale_px = fitting(corners);
    let more = format!(
        " tabindex=\"0\" data-view=\"{} {}\" data-size=\"{width} {height} {scale_px}\"",
        VIEW[0], VIEW[1]
    );
    let mut svg = Svg::new("plot quiver", (width, height), &quiver.words, &more);
    let edges = edges_of_box([x, y, z]).map(|edge| edge.map(to_box));
    put(&mut svg, "box", "", &edges, scale_px);
    for (after, class) in [(false, "b"), (true, "f")] {
        let arrows = || finite_arrows.iter().filter(|arrow| arrow.after == after);
        let tip = |arrow: &Arrow, from: [f64; 3]| {
            [0, 1, 2].map(|axis| from[axis] + arrow.error_um[axis] * per_um)
        };
        let lines = arrows().map(|arrow| {
            let from = to_box(arrow.at_mm);
            [from, tip(arrow, from)]
        });
        let lines: Vec<_> = lines.collect();
        if lines.is_empty() {
            continue;
        }
        let sizes = arrows().map(|arrow| finite(length(&arrow.error_um)).to_string());
        let sizes = format!(" data-v=\"{}\"", sizes.collect::<Vec<_>>().join(" "));
        put(&mut svg, &format!("vector {class}"), &sizes, &lines, scale_px);
        // A dot at the start of each arrow.
        let dots: Vec<_> = lines.iter().map(|[from, _]| [*from; 2]).collect();
        put(&mut svg, &format!("root {class}"), &sizes, &dots, scale_px);
    }
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        let mut at = [x[0], y[0], z[0]];
        at[axis] = [x, y, z][axis][1];
        let place = to_box(at).map(|share| 1.1 * share);
        let [left, top] = projected(place, VIEW, scale_px);
        let [p, q, r] = place.map(|x| finite(x * 100.0) / 100.0);
        svg.put(format_args!(
            "<text class=\"name\" data-p=\"{p} {q} {r}\" x=\"{}\" y=\"{}\" text-anchor=\"middle\">{name}</text>",
            finite(left), finite(top)
        ));
    }
    if longest_um > 0.0 {
        let round = round_below(longest_um);
        let pixels = round * per_um * scale_px;
        svg.line("rule", [24.0, height - 20.0], [24.0 + pixels, height - 20.0]);
        let decimals = if round < 1.0 { 3 } else { 0 };
        let text = format!("{} {} µm", quiver.scale_word, short(round, decimals));
        svg.text("key", [24.0, height - 28.0], Anchor::Start, &text);
    }
    svg.finish()
}

/// Draws lines of the box as one path, which a browser redraws faster than a path for each line.
fn put(svg: &mut Svg, class: &str, more: &str, lines: &[[[f64; 3]; 2]], scale_px: f64) {
    let (mut places, mut path) = (Vec::new(), String::new());
    for line in lines {
        let [[x, y], [u, v]] = line.map(|at| projected(at, VIEW, scale_px).map(finite));
        let _ = write!(path, "M{x} {y}L{u} {v}");
        let rounded = line.as_flattened().iter().map(|x| finite(x * 100.0) / 100.0);
        places.extend(rounded.map(|x| x.to_string()));
    }
    let places = places.join(" ");
    svg.put(format_args!("<path class=\"{class}\"{more} data-p=\"{places}\" d=\"{path}\"/>"));
}

/// Pixels per unit of the box at which the box fits the static view.
fn fitting(corners: impl Iterator<Item = [f64; 3]>) -> f64 {
    /// Fraction of the picture that the box fills; arrows extend beyond it.
    const FILLED: f64 = 0.76;
    let halves = corners.fold([0.0_f64; 2], |[across, up], corner| {
        let [x, y] = projected(corner, VIEW, 1.0);
        [across.max((x - 0.5 * SIZE[0]).abs()), up.max((y - 0.5 * SIZE[1]).abs())]
    });
    let [across, up] = [0, 1].map(|axis| 0.5 * FILLED * SIZE[axis] / halves[axis].max(1e-3));
    finite(across.min(up).min(1e4))
}

/// Projects a point of the box onto the picture, by the formula of the script.
fn projected([x, y, z]: [f64; 3], [turn, tilt]: [f64; 2], scale_px: f64) -> [f64; 2] {
    let (sin, cos) = turn.sin_cos();
    let (across, away) = (x * cos - y * sin, x * sin + y * cos);
    let (sin, cos) = tilt.sin_cos();
    let up = z * cos + away * sin;
    [0.5 * SIZE[0] + across * scale_px, 0.5 * SIZE[1] - up * scale_px]
}

fn edges_of_box([x, y, z]: [[f64; 2]; 3]) -> [[[f64; 3]; 2]; 12] {
    let corner = |i: usize| [x[i & 1], y[i >> 1 & 1], z[i >> 2 & 1]];
    let ends = [0, 1, 2, 3, 4, 5, 6, 7].into_iter().flat_map(|from| {
        [1, 2, 4].into_iter().filter(move |bit| from & bit == 0).map(move |bit| [from, from | bit])
    });
    let mut edges = [[[0.0; 3]; 2]; 12];
    for (edge, ends) in edges.iter_mut().zip(ends) {
        *edge = ends.map(corner);
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(arrows: Vec<Arrow>) -> Quiver {
        Quiver {
            words: "vectors".to_owned(),
            travels_mm: [[0.0, 100.0]; 3],
            arrows,
            scale_word: "arrow".to_owned(),
        }
    }

    /// Seen from above (tilt 90°) X points right and Y up; from the front (tilt 0) Z points up.
    #[test]
    fn the_view_is_turned_about_the_vertical_and_tilted() {
        let [x, y] = projected([0.5, 0.0, 0.0], [0.0, core::f64::consts::FRAC_PI_2], 200.0);
        assert!((x - 340.0 - 100.0).abs() < 1e-9 && (y - 230.0).abs() < 1e-9);
        let [x, y] = projected([0.0, 0.5, 0.0], [0.0, core::f64::consts::FRAC_PI_2], 200.0);
        assert!((x - 340.0).abs() < 1e-9 && (y - 230.0 + 100.0).abs() < 1e-9);
        let [x, y] = projected([0.0, 0.0, 0.5], [0.0, 0.0], 200.0);
        assert!((x - 340.0).abs() < 1e-9 && (y - 230.0 + 100.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_infinite_is_drawn() {
        let arrow = |x: f64| Arrow { at_mm: [0.0; 3], error_um: [x, 0.0, 0.0], after: false };
        let svg = quiver(&cube(vec![arrow(1.0), arrow(f64::NAN), arrow(f64::INFINITY)]));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert!(svg.contains("class=\"vector b\" data-v=\"1\""), "one arrow");
        let nothing = quiver(&Quiver { travels_mm: [[f64::NAN, 0.0]; 3], ..cube(Vec::new()) });
        assert!(!nothing.contains("NaN"));
    }
}
