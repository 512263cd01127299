//! The section of each error: readings, curve and band, the residuals below, and figures.

use volcomp_fit::BandSource;
use volcomp_vocabulary::Direction;

use super::write::{Cell, Page};
use crate::{
    described::described,
    plot::{self, Look, Mark, Series, WIDTH, XyPlot, xy},
    report::{Branch, Curve, Report, Residual},
};

pub(super) fn curves(page: &mut Page, report: &Report) {
    let (measured, stated): (Vec<&Curve>, Vec<&Curve>) = report
        .curves
        .iter()
        .partition(|curve| !curve.lines.is_empty());
    if report.curves.is_empty() {
        page.paragraph("lead", "None.");
    }
    if !measured.is_empty() {
        page.paragraph("lead", "Readings are shown where their curve is: without what tilts add over their lever (Abbe), a straightness without its line, zero at the reference.");
    }
    let mut sources: Vec<BandSource> = Vec::new();
    for curve in &measured {
        one(page, curve);
        let bands = curve.branches.iter().filter_map(|b| b.band.as_ref());
        sources.extend(bands.map(|band| band.source));
    }
    if !measured.is_empty() {
        page.paragraph("note", "Residual: mean reading minus curve. Leave-one-out: root mean square of what the curve misses of readings that were left out of its fit one at a time.");
    }
    if !sources.is_empty() {
        page.paragraph("note", "The band holds the true curve with a probability of 95 % at each single place: the runs are drawn again as a whole (bootstrap), with Student's t for few of them, and what the curve misses of readings that are left out is added.");
    }
    if sources.contains(&BandSource::Residuals) {
        page.paragraph("note", "With one run its residuals are drawn again: what differs from run to run is not in the band.");
    }
    if !stated.is_empty() {
        page.heading(3, "the machine file", "");
        page.paragraph(
            "lead",
            "These curves are stated by the machine file; no readings belong to them here.",
        );
        for curve in stated {
            one(page, curve);
        }
    }
}

fn one(page: &mut Page, curve: &Curve) {
    page.put("<div class=\"keep curve\">");
    page.heading(3, &curve.error, &described(&curve.error));
    let files: Vec<&str> = curve
        .lines
        .iter()
        .filter_map(|line| line.file.as_deref())
        .collect();
    page.figure(&xy(&main_plot(curve)), &files.join(", "));
    if curve
        .branches
        .iter()
        .any(|branch| !branch.residuals.is_empty())
    {
        page.figure(&xy(&residual_plot(curve)), "");
    }
    numbers(page, curve);
    for line in &curve.lines {
        if line.file.is_none() {
            page.paragraph("note", "Found from several parallel lines of other errors.");
        } else if line.runs.is_empty() {
            page.paragraph(
                "note",
                "Tilts of a bridge, summed up: only means are shown.",
            );
        }
    }
    let has_readings = !curve.lines.is_empty();
    if has_readings && curve.branches.iter().all(|branch| branch.band.is_none()) {
        page.paragraph("note", "No band: the readings of this curve are no runs of their own (tilts of a bridge that are summed up, or lines of other errors), or too few to be drawn again.");
    }
    page.put("</div>");
}

fn numbers(page: &mut Page, curve: &Curve) {
    let fits: Vec<_> = curve
        .branches
        .iter()
        .filter_map(|branch| Some((branch.direction, branch.fit.as_ref()?)))
        .collect();
    if fits.is_empty() {
        return;
    }
    let unit = &curve.unit;
    let number = |name: &str| format!(">{name}");
    let columns = [
        format!("residual, {unit}"),
        "curve".to_owned(),
        number("readings"),
        number("smallest"),
        number("largest"),
        number("rms"),
        number("leave-one-out"),
        number("reversal"),
    ];
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let rows = fits.into_iter().map(|(direction, fit)| {
        let Residual { min, max, rms } = fit.residual;
        vec![
            Cell::text(direction_word(direction)),
            Cell::Fixed(fit.kind.clone()),
            Cell::number(fit.readings as f64, 0),
            Cell::number(min, 2),
            Cell::number(max, 2),
            Cell::number(rms, 2),
            Cell::Number(fit.leave_one_out, 2),
            Cell::Number(fit.reversal, 2),
        ]
    });
    page.table(&columns, rows);
}

pub(super) fn direction_word(direction: Option<Direction>) -> &'static str {
    match direction {
        Some(Direction::Positive) => "forward",
        Some(Direction::Negative) => "backward",
        None => "both",
    }
}

pub(super) fn look(direction: Option<Direction>) -> (Look, Mark) {
    match direction {
        Some(Direction::Positive) => (Look::Forward, Mark::Up),
        Some(Direction::Negative) => (Look::Backward, Mark::Down),
        None => (Look::Both, Mark::Dot),
    }
}

pub(super) fn run_series(runs: &[crate::report::Run], line: bool) -> Vec<Series> {
    let series = runs.iter().map(|run| Series {
        name: format!(
            "run {}, {}",
            run.number,
            direction_word(Some(run.direction))
        ),
        points: run.points.clone(),
        look: match run.direction {
            Direction::Positive => Look::RunForward,
            Direction::Negative => Look::RunBackward,
        },
        mark: look(Some(run.direction)).1,
        line,
    });
    series.collect()
}

fn main_plot(curve: &Curve) -> XyPlot {
    let mut series = Vec::new();
    for line in &curve.lines {
        series.extend(run_series(&line.runs, false));
    }
    // With a single run the reading is the mean.
    let has_runs = curve.lines.iter().any(|line| line.runs.len() > 2);
    for line in &curve.lines {
        for direction in Direction::BOTH {
            let means = &line.means[direction as usize];
            if means.is_empty() || (!has_runs && !line.runs.is_empty()) {
                continue;
            }
            let (of, mark) = look(Some(direction));
            series.push(Series {
                name: format!("mean, {}", direction_word(Some(direction))),
                points: means.clone(),
                look: of,
                mark,
                line: false,
            });
        }
    }
    let mut band_label = "";
    let mut bands = Vec::new();
    for branch in &curve.branches {
        let (of, _) = look(branch.direction);
        let words = match branch.direction {
            Some(direction) => format!("curve, {}", direction_word(Some(direction))),
            None => "curve".to_owned(),
        };
        series.push(Series {
            name: words.clone(),
            points: branch.points.clone(),
            look: of,
            mark: Mark::None,
            line: true,
        });
        if let Some(band) = &branch.band {
            band_label = match band.source {
                BandSource::Runs => "95 % of the curve",
                BandSource::Residuals => "95 % of the curve, from one run",
            };
            bands.push(plot::Band {
                x: band.x.clone(),
                low: band.low.clone(),
                high: band.high.clone(),
                look: of,
            });
        }
    }
    XyPlot {
        words: format!("{}: {}", curve.error, described(&curve.error)),
        x_label: coordinate(curve),
        // The residual plot below has the label of the coordinate.
        x_named: curve
            .branches
            .iter()
            .all(|branch| branch.residuals.is_empty()),
        y_label: format!("{}, {}", curve.error, curve.unit),
        x_range: Some(curve.travel),
        width: WIDTH,
        height: 150.0,
        series,
        bands,
        brackets: Vec::new(),
        legend: legend(curve),
        band_label: band_label.to_owned(),
    }
}

fn coordinate(curve: &Curve) -> String {
    format!("{}, {}", curve.axis, curve.x_unit)
}

fn legend(curve: &Curve) -> Vec<(Look, Mark, String)> {
    let mut entries = Vec::new();
    for direction in Direction::BOTH {
        let (of, mark) = look(Some(direction));
        let word = direction_word(Some(direction));
        let mut lines = curve.lines.iter();
        let read = lines.any(|line| !line.means[direction as usize].is_empty());
        let mut branches = curve.branches.iter();
        let own = branches.any(|branch| branch.direction == Some(direction));
        let (mark, words) = match (read, own) {
            (true, true) => (mark, "readings, curve".to_owned()),
            (true, false) => (mark, "readings".to_owned()),
            (false, true) => (Mark::None, "curve".to_owned()),
            (false, false) => continue,
        };
        entries.push((of, mark, format!("{word}: {words}")));
    }
    if curve
        .branches
        .iter()
        .any(|branch| branch.direction.is_none())
    {
        entries.push((Look::Both, Mark::None, "curve".to_owned()));
    }
    entries
}

fn residual_plot(curve: &Curve) -> XyPlot {
    let branches = curve
        .branches
        .iter()
        .filter(|branch| !branch.residuals.is_empty());
    let series = branches.map(|branch: &Branch| {
        let (of, mark) = look(branch.direction);
        Series {
            name: format!("residual, {}", direction_word(branch.direction)),
            points: branch.residuals.clone(),
            look: of,
            mark,
            line: branch
                .residuals
                .windows(2)
                .all(|pair| pair[0].0 < pair[1].0),
        }
    });
    XyPlot {
        words: format!("{}: residuals: mean reading minus curve", curve.error),
        x_label: coordinate(curve),
        x_named: true,
        y_label: format!("residual, {}", curve.unit),
        x_range: Some(curve.travel),
        width: WIDTH,
        height: 60.0,
        series: series.collect(),
        bands: Vec::new(),
        brackets: Vec::new(),
        legend: Vec::new(),
        band_label: String::new(),
    }
}
