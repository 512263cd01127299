use super::{
    scale::{Scale, short, ticks},
    svg::{Anchor, Svg, escaped, finite},
};

const WIDTH: f64 = 340.0;
const LEFT: f64 = 64.0;
const TOP: f64 = 44.0;
const ROW: f64 = 16.0;

/// Horizontal bars, one below the other, each with a mark at a second value.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Label of the value axis, with the unit.
    pub label: String,
    /// Legend of the bars and of the marks.
    pub legend: [String; 2],
    /// Name, value of the bar, value of the mark.
    pub rows: Vec<(String, f64, f64)>,
}

/// Draws bars from zero, at a common scale.
pub fn bars(bars: &Bars) -> String {
    let right = WIDTH - 14.0;
    let bottom = TOP + ROW * bars.rows.len() as f64;
    let values = bars.rows.iter().flat_map(|row| [row.1, row.2]);
    let x = Scale::over(values.chain([0.0]), [LEFT, right], 0.0);
    let frame =
        format!(" data-x=\"{} {} {} {}\"", x.places[0], x.places[1], x.values[0], x.values[1]);
    let mut svg = Svg::new("plot bars", (WIDTH, bottom + 42.0), &bars.words, &frame);
    let [of_bar, of_mark] = &bars.legend;
    svg.put(format_args!("<rect class=\"bar\" x=\"{LEFT}\" y=\"8\" width=\"20\" height=\"10\"/>"));
    svg.text("key", [LEFT + 26.0, 17.0], Anchor::Start, of_bar);
    svg.line("mean b", [LEFT + 146.0, 6.0], [LEFT + 146.0, 20.0]);
    svg.text("key", [LEFT + 154.0, 17.0], Anchor::Start, of_mark);
    let (values, decimals) = ticks(x.values, 5);
    for value in values {
        let at = x.at(value);
        let class = if value == 0.0 { "zero" } else { "grid" };
        svg.line(class, [at, TOP - 6.0], [at, bottom]);
        let text = short(value, decimals);
        svg.text("tick", [at, bottom + 15.0], Anchor::Middle, &text);
    }
    for (place, (name, value, mark)) in bars.rows.iter().enumerate() {
        let y = TOP + ROW * place as f64;
        svg.text("tick", [LEFT - 6.0, y + 11.0], Anchor::End, name);
        let [from, to] = [x.at(0.0), x.at(*value)].map(finite);
        if value.is_finite() {
            svg.put(format_args!(
                "<rect class=\"bar\" data-n=\"{}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
                escaped(name),
                from.min(to),
                finite(y + 2.0),
                finite((to - from).abs()),
                ROW - 5.0
            ));
        }
        if mark.is_finite() {
            let at = x.at(*mark);
            svg.line("mean b", [at, y + 1.0], [at, y + ROW - 2.0]);
        }
    }
    svg.text("name", [right, bottom + 32.0], Anchor::End, &bars.label);
    svg.finish()
}
