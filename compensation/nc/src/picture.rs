//! SVG picture of a verified program: its path, and the tool deviation before and after compensation.

use std::fmt::Write as _;

use crate::verify::{Place, Verification};

const ENLARGED: f64 = 1000.0;

/// Larger side of the drawing and its margin, in SVG units.
const SIZE: f64 = 720.0;

const MARGIN: f64 = 60.0;

const HOLE: f64 = 3.0;

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// A curve of the picture: colour, name, and the deviation from the path that it shows, µm.
type Kind = (&'static str, &'static str, fn(&Place) -> [f64; 3]);

/// A self-contained SVG document: the path (grey) in the plane of its largest extent, and its deviations magnified 1000 times, with the
/// original program (red) and the compensated one (blue).
#[must_use]
pub fn picture(of: &Verification) -> String {
    let plane = plane_of(&of.path);
    let at = |place: &Place, deviation_um: &[f64; 3]| -> [f64; 2] {
        plane.map(|i| place.tip_mm[i] + 1e-3 * ENLARGED * deviation_um[i])
    };
    let kinds: [Kind; 3] = [
        ("#9aa0a6", "programmed path", |_| [0.0; 3]),
        ("#c5221f", "without compensation", |place| place.before_um),
        ("#1a73e8", "with compensation", |place| place.after_um),
    ];
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for place in &of.path {
        for (_, _, deviation) in &kinds {
            for (i, at) in at(place, &deviation(place)).into_iter().enumerate() {
                low[i] = low[i].min(at);
                high[i] = high[i].max(at);
            }
        }
    }
    let is_empty = of.path.is_empty();
    if is_empty {
        (low, high) = ([0.0; 2], [1.0; 2]);
    }
    let extent = (high[0] - low[0]).max(high[1] - low[1]).max(1e-6);
    let scale = SIZE / extent;
    let [width, height] = [0, 1].map(|i| (high[i] - low[i]) * scale + 2.0 * MARGIN);
    let (width, height) = (width.max(480.0), height + 70.0);
    let on_page = |[x, y]: [f64; 2]| {
        [
            MARGIN + (x - low[0]) * scale,
            height - MARGIN - 50.0 - (y - low[1]) * scale,
        ]
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <title>Deviation from the programmed path, {ENLARGED:.0} times enlarged</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (colour, _, deviation) in &kinds {
        let mut path = String::new();
        let mut holes = String::new();
        let mut before = [f64::INFINITY; 2];
        for (i, place) in of.path.iter().enumerate() {
            let [x, y] = on_page(at(place, &deviation(place)));
            let verb = if i == 0 || place.begins { 'M' } else { 'L' };
            // Writing to a string cannot fail.
            let _ = write!(path, "{verb}{x:.1} {y:.1}");
            let begins = i > 0 && of.path[i - 1].begins && !place.begins;
            if begins && (x - before[0]).hypot(y - before[1]) < HOLE {
                // A hole seen along its axis is a line of zero length.
                let _ = write!(
                    holes,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{HOLE}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\"/>"
                );
            }
            before = [x, y];
        }
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\"/>{holes}"
        );
    }
    let deviations = [(&of.before, kinds[1].0), (&of.after, kinds[2].0)];
    for (deviation, colour) in deviations {
        if !of.path.is_empty() {
            let tip = deviation.tip_mm;
            let [x, y] = on_page(plane.map(|axis| tip[axis]));
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"none\" stroke=\"{colour}\"><title>the worst place: line {}, {:.1} µm</title></circle>",
                deviation.line, deviation.max_um
            );
        }
    }
    legend(&mut svg, of, &kinds.map(|(colour, name, _)| (colour, name)));
    let bar = round_below(0.3 * extent);
    let (y, to) = (height - 42.0, MARGIN + bar * scale);
    let _ = writeln!(
        svg,
        "<path d=\"M{MARGIN:.1} {y:.1}H{to:.1}\" stroke=\"black\" stroke-width=\"2\"/>\n\
         <text x=\"{MARGIN:.1}\" y=\"{:.1}\">{bar} mm of the path, {bar} µm of a deviation; {} to the right, {} up</text>\n</svg>",
        height - 22.0,
        AXES[plane[0]],
        AXES[plane[1]],
    );
    svg
}

fn legend(svg: &mut String, of: &Verification, kinds: &[(&str, &str); 3]) {
    let numbers = [None, Some(&of.before), Some(&of.after)];
    for (i, ((colour, name), deviation)) in kinds.iter().zip(numbers).enumerate() {
        let y = 20.0 + 16.0 * i as f64;
        let text = deviation.map_or(String::new(), |deviation| {
            format!(
                ": at most {:.1} µm (line {}), RMS {:.1} µm",
                deviation.max_um, deviation.line, deviation.rms_um
            )
        });
        let _ = writeln!(
            svg,
            "<path d=\"M16 {:.0}H40\" stroke=\"{colour}\" stroke-width=\"3\"/><text x=\"48\" y=\"{y:.0}\">{name}{text}</text>",
            y - 4.0
        );
    }
}

/// The two axes of the largest extent of the path, in axis order. End points of rapid motions are not drawn; they are used only if
/// there are no other points.
fn plane_of(path: &[Place]) -> [usize; 2] {
    let has_drawn = path.iter().any(|place| !place.begins);
    let extent = |i: usize| {
        let drawn = path.iter().filter(|place| !(has_drawn && place.begins));
        let along = drawn.map(|place| place.tip_mm[i]);
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        });
        high - low
    };
    let shortest = (0..3)
        .rev()
        .min_by(|a, b| extent(*a).total_cmp(&extent(*b)));
    match shortest {
        Some(0) => [1, 2],
        Some(1) => [0, 2],
        _ => [0, 1],
    }
}

fn round_below(length: f64) -> f64 {
    let power = 10.0_f64.powf(length.log10().floor());
    let digit = [5.0, 2.0, 1.0]
        .into_iter()
        .find(|digit| digit * power <= length);
    digit.unwrap_or(1.0) * power
}
