use super::{
    colour::colour_at,
    scale::{Scale, round_below, short, ticks},
    svg::{Anchor, Svg, escaped, finite},
};

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
}
