use crate::plot::{Bars, Panel, bars, picture};

/// The picture of the effect of each error on the position (µm) and the orientation (µrad) of the tool: name, RMS and largest.
pub fn effects_picture(
    title: &str,
    lines: &[String],
    positions: Vec<(String, f64, f64)>,
    orientations: Vec<(String, f64, f64)>,
) -> String {
    let panel = |what: &str, unit: &str, rows| Panel {
        heading: what.to_owned(),
        svg: bars(&Bars {
            words: format!("effect on the {what}"),
            label: format!("{what}, {unit}"),
            legend: ["RMS".to_owned(), "largest".to_owned()],
            rows,
        }),
    };
    let panels =
        vec![panel("position", "µm", positions), panel("orientation", "µrad", orientations)];
    picture(title, lines, &[panels])
}
