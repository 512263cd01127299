//! The picture of the residuals of an identification.

use volcomp_identify::FileResiduals;

use super::span;
use crate::plot::{Look, Mark, Panel, Series, WIDTH, XyPlot, picture, xy};

/// Draws the residuals of the rows of each file and their stated uncertainty, at the same scale.
pub fn residuals_picture(lines: &[String], files: &[FileResiduals]) -> String {
    let mut plots: Vec<XyPlot> = files.iter().map(plot).collect();
    let range = span(plots.iter().flat_map(XyPlot::value_range));
    for plot in &mut plots {
        plot.y_range = range;
    }
    let rows: Vec<Vec<Panel>> = files
        .iter()
        .zip(&plots)
        .map(|(of, plot)| vec![Panel { heading: of.file.clone(), svg: xy(plot) }])
        .collect();
    let title = "Residuals of the identification: distance of each row from the model";
    picture(title, lines, &rows)
}

fn plot(of: &FileResiduals) -> XyPlot {
    let column = |index: usize| -> Vec<(f64, f64)> {
        let rows = of.rows.iter().enumerate();
        rows.map(|(place, row)| (place as f64 + 1.0, row[index])).collect()
    };
    let series = |name: &str, index, look, mark, line| Series {
        name: name.to_owned(),
        points: column(index),
        look,
        mark,
        line,
    };
    let name = "stated standard uncertainty";
    XyPlot {
        words: format!("residuals: {}", of.file),
        x_label: "row of the file".to_owned(),
        x_named: true,
        y_label: "residual, µm".to_owned(),
        x_range: Some([0.0, 1.0]),
        y_range: None,
        width: WIDTH,
        height: 130.0,
        series: vec![
            series("residual", 0, Look::Forward, Mark::Dot, false),
            series(name, 1, Look::Tolerance, Mark::None, true),
        ],
        bands: Vec::new(),
        brackets: Vec::new(),
        legend: vec![
            (Look::Forward, Mark::Dot, "residual".to_owned()),
            (Look::Tolerance, Mark::None, name.to_owned()),
        ],
        band_label: String::new(),
    }
}
