//! Plots of a field over two coordinates: heat map and vectors.

use std::fmt::Write as _;

use super::svg::{Anchor, Scale, Svg, colour_at, escaped, finite, round_below, short, ticks};

const WIDTH: f64 = 330.0;
const LEFT: f64 = 50.0;
const TOP: f64 = 34.0;
/// Maximum length of the scale arrow below the map, in picture units.
const RULE: f64 = 40.0;

/// Values of a field over two coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Text alternative for a screen reader.
    pub words: String,
    pub title: String,
    /// Label of the first coordinate, with its unit.
    pub x_label: String,
    /// Label of the second coordinate, with its unit.
    pub y_label: String,
    /// Nodes of the first coordinate, ascending.
    pub x: Vec<f64>,
    /// Nodes of the second coordinate, ascending.
    pub y: Vec<f64>,
    /// Value at each node; the first coordinate varies fastest.
    pub values: Vec<f64>,
    /// Value of the last colour of the scale; the first colour is 0.
    pub most: f64,
    /// Unit of the values and of the arrows.
    pub unit: String,
    /// Position and vector of each arrow, the vector in `unit`.
    pub arrows: Vec<([f64; 2], [f64; 2])>,
    /// Length of a vector of 1 `unit`, in picture units.
    pub arrow_scale: f64,
}

/// Draws a heat map with one cell per node. Both coordinates have the same scale unless the map would be too elongated.
pub fn heat_map(map: &HeatMap) -> String {
    let right = WIDTH - 18.0;
    let range = |nodes: &[f64]| match (nodes.first(), nodes.last()) {
        (Some(first), Some(last)) if last > first => last - first,
        _ => 1.0,
    };
    let shape = (range(&map.y) / range(&map.x)).clamp(0.45, 1.25);
    let bottom = TOP + (right - LEFT) * if shape.is_finite() { shape } else { 1.0 };
    let frame = format!(
        " data-x=\"{} {}\" data-y=\"{} {}\" data-u=\"{}\"",
        escaped(&map.x_label),
        map.x.len(),
        escaped(&map.y_label),
        map.y.len(),
        escaped(&map.unit)
    );
    let mut svg = Svg::new("plot heat", (WIDTH, bottom + 40.0), &map.words, &frame);
    svg.text("head", [LEFT, 14.0], Anchor::Start, &map.title);
    let x_edges = edges(&map.x);
    let y_edges = edges(&map.y);
    let x = Scale::over(x_edges.iter().copied(), [LEFT, right], 0.0);
    let y = Scale::over(y_edges.iter().copied(), [bottom, TOP], 0.0);
    let most = if map.most > 0.0 && map.most.is_finite() { map.most } else { 1.0 };
    svg.raw("<g class=\"cells\">");
    for (row, (low, high)) in pairs(&y_edges).enumerate() {
        for (column, (from, to)) in pairs(&x_edges).enumerate() {
            let Some(value) = map.values.get(row * map.x.len() + column) else {
                continue;
            };
            let [left, right] = [x.at(from), x.at(to)].map(finite);
            let [upper, lower] = [y.at(high), y.at(low)].map(finite);
            // Cells overlap slightly so that the background does not show between them.
            let over = |is_last: bool| if is_last { 0.0 } else { 0.6 };
            let width = finite(right - left + over(column + 1 == map.x.len()));
            let height = finite(lower - upper + over(row == 0));
            let digits = if value.is_finite() { short(*value, 2) } else { short(f64::NAN, 0) };
            svg.put(format_args!(
                "<rect x=\"{left}\" y=\"{upper}\" width=\"{width}\" height=\"{height}\" fill=\"{}\" data-v=\"{digits}\"/>",
                colour_at(value / most)
            ));
        }
    }
    svg.raw("</g>");
    let (values, decimals) = ticks(y.values, 5);
    for value in values {
        svg.line("frame", [LEFT - 4.0, y.at(value)], [LEFT, y.at(value)]);
        svg.text("tick", [LEFT - 6.0, y.at(value) + 4.0], Anchor::End, &short(value, decimals));
    }
    let (values, decimals) = ticks(x.values, 4);
    for value in values {
        svg.line("frame", [x.at(value), bottom], [x.at(value), bottom + 4.0]);
        svg.text("tick", [x.at(value), bottom + 16.0], Anchor::Middle, &short(value, decimals));
    }
    arrows(&mut svg, map, (&x, &y), bottom);
    svg.text("name", [right, bottom + 32.0], Anchor::End, &map.x_label);
    svg.text("name", [6.0, TOP - 6.0], Anchor::Start, &map.y_label);
    svg.finish()
}

/// Draws the arrows, each with a light edge that separates it from any colour, and below the map a scale arrow of a round length.
fn arrows(svg: &mut Svg, map: &HeatMap, (x, y): (&Scale, &Scale), bottom: f64) {
    for ([at_x, at_y], [u, v]) in &map.arrows {
        let from = [x.at(*at_x), y.at(*at_y)];
        let to = [from[0] + u * map.arrow_scale, from[1] - v * map.arrow_scale];
        if ![from, to].as_flattened().iter().all(|at| at.is_finite()) {
            continue;
        }
        let turned = |sign: f64| {
            let (sin, cos) = (sign * 0.45_f64).sin_cos();
            let back = [from[0] - to[0], from[1] - to[1]];
            let length = back[0].hypot(back[1]).max(1e-9);
            let head = 6.0_f64.min(0.5 * length) / length;
            [
                to[0] + head * (back[0] * cos - back[1] * sin),
                to[1] + head * (back[0] * sin + back[1] * cos),
            ]
        };
        let [[a, b], [c, d], [e, f], [g, h]] =
            [from, to, turned(1.0), turned(-1.0)].map(|at| at.map(finite));
        for class in ["halo", "arrow"] {
            svg.put(format_args!(
                "<path class=\"{class}\" d=\"M{a} {b}L{c} {d}M{e} {f}L{c} {d}L{g} {h}\"/>"
            ));
        }
    }
    if !map.arrows.is_empty() && map.arrow_scale > 0.0 {
        // Maps with the same scale show the same length.
        let round = round_below(RULE / map.arrow_scale);
        let end = LEFT + round * map.arrow_scale;
        svg.line("rule", [LEFT, bottom + 28.0], [end, bottom + 28.0]);
        let decimals = if round < 1.0 { 4 } else { 0 };
        let text = short(round, decimals);
        let text = if decimals > 0 { text.trim_end_matches('0') } else { &text };
        let text = format!("{text} {}", map.unit);
        svg.text("tick", [end + 6.0, bottom + 32.0], Anchor::Start, &text);
    }
}

/// Edges of the cells around nodes: midpoints between nodes; the outermost cells are symmetric.
fn edges(nodes: &[f64]) -> Vec<f64> {
    match nodes {
        [] => Vec::new(),
        [only] => vec![only - 0.5, only + 0.5],
        [first, .., last] => {
            let between = nodes.windows(2).map(|pair| f64::midpoint(pair[0], pair[1]));
            let mut all: Vec<f64> = between.collect();
            let outer = [2.0 * first - all[0], 2.0 * last - all[all.len() - 1]];
            all.insert(0, outer[0]);
            all.push(outer[1]);
            all
        }
    }
}

fn pairs(edges: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    edges.iter().copied().zip(edges.iter().copied().skip(1))
}

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
    let edges: Vec<_> = edges_of_box([x, y, z]).into_iter().map(|edge| edge.map(to_box)).collect();
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
        let dots = lines.iter().map(|[from, _]| {
            let [x, y] = projected(*from, VIEW, scale_px).map(finite);
            format!("M{x} {y}h0")
        });
        let dots = dots.collect::<Vec<_>>().concat();
        svg.put(format_args!("<path class=\"root {class}\" d=\"{dots}\"/>"));
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

fn edges_of_box([x, y, z]: [[f64; 2]; 3]) -> Vec<[[f64; 3]; 2]> {
    let corner = |i: usize| [x[i & 1], y[i >> 1 & 1], z[i >> 2 & 1]];
    let mut edges = Vec::new();
    for from in 0..8_usize {
        for bit in [1, 2, 4] {
            if from & bit == 0 {
                edges.push([corner(from), corner(from | bit)]);
            }
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: Vec<f64>) -> HeatMap {
        HeatMap {
            words: "a field".to_owned(),
            title: "XY".to_owned(),
            x_label: "X, mm".to_owned(),
            y_label: "Y, mm".to_owned(),
            x: vec![0.0, 100.0, 200.0],
            y: vec![0.0, 50.0],
            values,
            most: 5.0,
            unit: "µm".to_owned(),
            arrows: Vec::new(),
            arrow_scale: 1.0,
        }
    }

    #[test]
    fn each_node_has_a_cell_of_the_colour_of_its_value() {
        let svg = heat_map(&map(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));
        assert_eq!(svg.matches("<rect").count(), 6);
        assert!(svg.contains(&colour_at(0.0)) && svg.contains(&colour_at(1.0)));
    }

    #[test]
    fn what_is_no_number_is_grey_and_too_few_values_are_no_trouble() {
        let svg = heat_map(&map(vec![f64::NAN, f64::INFINITY, 1.0]));
        assert!(svg.contains("#808080"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

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
