use crate::plot::{Bars, Panel, bars, picture};

/// Draws the effect of each error on the position (µm) and on the orientation (µrad) of the tool. Each entry has the name of the error, the RMS
/// and the largest effect.
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
