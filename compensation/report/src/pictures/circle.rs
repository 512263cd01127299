//! The picture of a circular test.

use volcomp_metrology::{
    JudgedQuantity,
    circular::{CircularPlane, CircularTrace, Sense},
};

use super::figures;
use crate::plot::{Look, Panel, PolarPlot, picture, polar, short};

/// Data of the picture of a circular test.
pub struct CirclePlot {
    pub file: String,
    pub plane: CircularPlane,
    /// Measured points of the circle.
    pub trace: CircularTrace,
    /// Least-squares centre of all points along the two axes, µm, which the picture subtracts.
    pub centre_um: [f64; 2],
    /// Results by ISO 230-4.
    pub quantities: Vec<JudgedQuantity>,
}

/// Draws one or several circular tests.
pub fn circles_picture(tests: &[CirclePlot]) -> String {
    let title = match tests {
        [one] => format!(
            "Circular test to ISO 230-4, plane {}{}, radius {} mm",
            one.plane.axes()[0],
            one.plane.axes()[1],
            short(one.trace.radius_mm, 3)
        ),
        _ => format!("Circular tests to ISO 230-4, {} files", tests.len()),
    };
    let lines = match tests {
        [one] => [vec![one.file.clone()], figures(&one.quantities)].concat(),
        _ => Vec::new(),
    };
    let rows: Vec<Vec<Panel>> = tests
        .iter()
        .map(|of| {
            vec![Panel {
                heading: if tests.len() > 1 { of.file.clone() } else { String::new() },
                svg: polar(&plot(of)),
            }]
        })
        .collect();
    picture(&title, &lines, &rows)
}

/// Radial deviations about the centre of all points, whose range is G(b).
fn plot(of: &CirclePlot) -> PolarPlot {
    let [x, y] = of.centre_um;
    let series = Sense::BOTH.into_iter().filter_map(|sense| {
        let points = of.trace.points.iter().filter(|point| point.sense == sense);
        let points: Vec<(f64, f64)> = points
            .map(|point| {
                let (sin, cos) = point.angle_rad.sin_cos();
                (point.angle_rad, point.deviation_um - x * cos - y * sin)
            })
            .collect();
        let (name, look) = match sense {
            Sense::CounterClockwise => ("counter-clockwise", Look::Forward),
            Sense::Clockwise => ("clockwise", Look::Backward),
        };
        (!points.is_empty()).then(|| (name.to_owned(), look, points))
    });
    PolarPlot {
        words: format!("circular test: {}", of.file),
        axes: of.plane.axes().map(|axis| axis.to_string()),
        unit: "µm".to_owned(),
        series: series.collect(),
    }
}
