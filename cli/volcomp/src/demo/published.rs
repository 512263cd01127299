//! The demo beside the figures of the paper on such a gantry (10.1177/0954405416645985).

use std::path::Path;

use volcomp_fit::{Fit, FitError, FitOptions, fit_auto, fit_mls, fit_polynomial};
use volcomp_metrology::read_file;

use super::lines::LineResult;
use crate::{
    answers::simulate::{Published, PublishedLine, PublishedResidual},
    failure::Failure,
    table::{fixed, folded, table, table_text, to_the_left},
};

/// A line of the paper: the error, where our line of it runs (`""`: there is only one), µm before and, where it is printed, after.
const LINES: [(&str, &str, f64, Option<f64>); 9] = [
    ("EXX", "", 58.6, Some(3.5)),
    ("EYY", "Z=650", 68.0, Some(4.8)),
    ("EYY", "Z=1050", 42.0, Some(2.8)),
    ("EYY", "Z=1352", 23.0, None),
    ("EZZ", "", 36.6, Some(2.7)),
    ("EYX", "", 19.0, Some(3.5)),
    ("EZX", "", 33.0, Some(5.2)),
    ("EXY", "", 34.0, Some(4.6)),
    ("EZY", "", 50.0, Some(6.8)),
];

/// The positioning files of X, Y and Z.
const FILES: [(&str, &str); 3] = [("EXX", "exx.rtl"), ("EYY", "eyy.rtl"), ("EZZ", "ezz.rtl")];

/// What the paper prints as left by a method at the targets, µm.
fn printed(error: &str, method: &str) -> Option<[f64; 2]> {
    match (error, method) {
        ("EXX", "polynomial of order 6") => Some([-5.2, 5.0]),
        ("EXX", MLS) => Some([-1.4, 1.7]),
        ("EYY", MLS) => Some([-1.6, 1.5]),
        ("EZZ", MLS) => Some([-1.5, 1.2]),
        _ => None,
    }
}

const MLS: &str = "moving least squares";

/// Our figures beside those of the paper. `folder` has the measurement files.
pub(crate) fn published(lines: &[LineResult], folder: &Path) -> Result<Published, Failure> {
    let row = |&(error, at, paper_before_um, paper_after_um): &(&'static str, &str, f64, _)| {
        let own =
            |line: &&LineResult| line.error.to_string() == error && line.description.contains(at);
        let found = lines.iter().find(own);
        let found = found.ok_or_else(|| Failure::Work(format!("the demo measures no {error}")))?;
        Ok::<_, Failure>(PublishedLine {
            error,
            line: found.description.clone(),
            before_um: found.before_um,
            after_um: found.after_um,
            paper_before_um,
            paper_after_um,
        })
    };
    let mut residuals = Vec::new();
    for (error, file) in FILES {
        residuals.extend(left_at_targets(error, &folder.join(file))?);
    }
    Ok(Published {
        lines: LINES.iter().map(row).collect::<Result<_, _>>()?,
        residuals,
    })
}

/// What each method leaves of the mean reading at each target.
fn left_at_targets(error: &'static str, file: &Path) -> Result<Vec<PublishedResidual>, Failure> {
    let means = read_file(file).map_err(Failure::input)?.mean_curve();
    let (x, u): (Vec<f64>, Vec<f64>) = means.into_iter().unzip();
    let domain = [
        x.first().copied().unwrap_or_default(),
        x.last().copied().unwrap_or_default(),
    ];
    let mut fits: Vec<(String, Result<Fit, FitError>)> = Vec::new();
    for order in 6..=8 {
        let name = format!("polynomial of order {order}");
        fits.push((name, fit_polynomial(&x, &u, order, domain)));
    }
    fits.push((MLS.to_owned(), fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0)));
    let auto = fit_auto(&x, &u, &FitOptions::default());
    fits.push(("chosen".to_owned(), auto.map(|found| found.fit)));
    let row = |(method, fit): (String, Result<Fit, FitError>)| {
        let fit = fit.map_err(Failure::input)?;
        let paper = printed(error, &method);
        Ok(PublishedResidual {
            error,
            method,
            min_um: fit.min(),
            max_um: fit.max(),
            paper_min_um: paper.map(|[min, _]| min),
            paper_max_um: paper.map(|[_, max]| max),
        })
    };
    fits.into_iter().map(row).collect()
}

/// Both tables for people.
pub(crate) fn text(published: &Published) -> String {
    let mut lines = table(&["", "before", "paper", "after", "paper"]);
    for line in &published.lines {
        lines.add_row([
            format!("{} {}", line.error, line.line),
            fixed(line.before_um, 1),
            fixed(line.paper_before_um, 1),
            fixed(line.after_um, 1),
            line.paper_after_um
                .map_or("-".to_owned(), |after| fixed(after, 1)),
        ]);
    }
    let mut residuals = table(&["", "left by", "from", "to", "paper from", "to"]);
    to_the_left(&mut residuals, &[1]);
    for row in &published.residuals {
        let printed = |value: Option<f64>| value.map_or("-".to_owned(), |value| fixed(value, 1));
        residuals.add_row([
            row.error.to_owned(),
            row.method.clone(),
            fixed(row.min_um, 1),
            fixed(row.max_um, 1),
            printed(row.paper_min_um),
            printed(row.paper_max_um),
        ]);
    }
    format!(
        "Beside the published gantry (10.1177/0954405416645985), peak to peak, µm\n{}\n\
         Left of the mean readings at the 21 targets, µm\n{}\n{}\n",
        table_text(&lines),
        table_text(&residuals),
        folded(
            "The paper's figures are of a real machine, ours of a simulated one of the same travels and sizes, whose curves are made, not measured: they show that the way from files to correction adds less than was left there, not how that machine would do. The straightness of the paper after correction is that of machined parts, of a bed of 4800 mm and a worktable of 4000 mm. Moving least squares are those of the paper: order 4, a third of the range, shape 3.",
            ""
        )
    )
}
