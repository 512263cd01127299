use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_identify::{
    Figures, Identification, Kind, Next, Observations, Parameter, identify, unit_symbol,
};
use volcomp_report::residuals_picture;

use super::{Answer, fixed, refuse_overwriting, table, table_text};
use crate::{
    failure::Failure,
    output::{self, OutputFile, PlotArguments},
    table::folded,
};

/// Identify errors from trackers, spheres, ballbars, ball rows and diagonals
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp identify identification/observations.toml -o found.toml
  volcomp --json identify identification/observations.toml -o found.toml")]
pub(crate) struct IdentifyArguments {
    /// Observations file (TOML), which names the machine file and the row files
    observations: PathBuf,
    /// Machine file to write
    #[arg(long, short)]
    output: PathBuf,
    #[command(flatten)]
    plot: PlotArguments,
}

/// Identified parameters and the written machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Identified {
    /// Path of the written machine file.
    file: String,
    #[serde(flatten)]
    found: Identification,
}

pub(crate) fn run(arguments: &IdentifyArguments) -> Result<Answer, Failure> {
    let observations = Observations::read(&arguments.observations)?;
    refuse_overwriting(&observations.files, &arguments.output, "identification")?;
    let files = observations.files.iter();
    let mut others: Vec<(&Path, &str)> = files.map(|file| (file.as_path(), "the input")).collect();
    others.push((&arguments.output, "--output"));
    let plot = arguments.plot.open(&others)?;
    let output = OutputFile::open(&arguments.output)?;
    let found = find(&observations)?;
    output.write_whole(found.machine.to_toml())?;
    if let Some(plot) = plot {
        let Figures { rms_um, max_um, rows } = found.residual;
        let [rms, max] = [rms_um, max_um].map(|um| fixed(um, 2));
        let file = arguments.observations.display().to_string();
        let figures = format!("{rows} fitted rows: RMS {rms} µm, largest {max} µm");
        plot.write(&residuals_picture(&[file, figures], &found.residuals))?;
    }
    let text = text(&found, &arguments.output);
    let notes = found.warnings.iter().map(ToString::to_string).collect();
    let document = Identified { file: arguments.output.display().to_string(), found };
    Answer::new(&document, text, notes)
}

pub(super) fn find(observations: &Observations) -> Result<Identification, Failure> {
    let work = |told: &mut dyn FnMut(usize, usize)| identify(observations, told);
    Ok(output::with_bar("fits", work)?)
}

fn text(found: &Identification, output: &Path) -> String {
    let mut text = found_text(found);
    let _ = writeln!(text, "wrote {}", output.display());
    text + EXPLAINED
}

pub(super) const EXPLAINED: &str = "
Uncertainty: standard (k = 1). Rows left out: predicted from the others, pose by
pose. Score: 1 is best; an unknown may be 1/score times as uncertain as it would
be if all others were known: below 0.01 some can hardly be told apart. Rank: how
many unknowns are determined, of how many that are counted.
";

/// Minimum factor by which a recommended pose must reduce the uncertainty of the least certain unknown.
const LITTLE: f64 = 1.05;

fn next_text(next: &Next) -> String {
    let pose: Vec<String> = next.pose.iter().map(|(axis, at)| format!("{axis}={at}")).collect();
    let tool = next.tool.as_ref().map(|tool| format!("tool {tool}"));
    let with: String = [next.target.clone(), tool]
        .into_iter()
        .flatten()
        .fold(String::new(), |all, what| all + ", " + &what);
    let pose = pose.join(",");
    let text = format!("measure next: {pose} ({}{with})\n", next.file);
    let what = match next.improvement {
        Some(improvement) if improvement < LITTLE => format!(
            "one pose more changes little: the uncertainty of {} stays at {:.0} % of what it is now{}",
            next.parameter,
            100.0 / improvement,
            sphere_helps(next)
        ),
        Some(improvement) => format!(
            "the uncertainty of {} falls to {:.0} % of what it is now",
            next.parameter,
            100.0 / improvement
        ),
        None => format!("it helps to determine {}, which is not determined yet", next.parameter),
    };
    text + &folded(&what, "  ")
}

pub(super) fn found_text(document: &Identification) -> String {
    let mut found = table(&["unknown", "value", "uncertainty", ""]);
    let mut given_zero: Vec<&str> = Vec::new();
    for parameter in &document.parameters {
        for name in &parameter.given_zero {
            if !given_zero.contains(&name.as_str()) {
                given_zero.push(name);
            }
        }
        let mark = if parameter.given_zero.is_empty() { "" } else { " *" };
        found.add_row([
            parameter.name.clone(),
            shown(parameter, parameter.value),
            match parameter.uncertainty {
                Some(uncertainty) => shown(parameter, uncertainty),
                None => "not found".to_owned(),
            },
            format!("{}{mark}", unit_symbol(parameter.unit)),
        ]);
    }
    let mut text = table_text(&found);
    if !given_zero.is_empty() {
        let names = given_zero.join(", ");
        let told =
            format!("* holds if the unknowns that cannot be separated from it are zero: {names}");
        text.push('\n');
        text += &folded(&told, "");
    }
    let mut figures = table(&["what is left, µm", "rms", "max", ""]);
    let mut add = |what: &str, left: Figures, of: String| {
        let [rms, max] = [left.rms_um, left.max_um].map(|um| fixed(um, 2));
        figures.add_row([what.to_owned(), rms, max, of]);
    };
    add("fitted rows", document.residual, String::new());
    if let Some(left) = &document.left_out {
        let parts = format!("in {} parts", left.folds);
        add("rows left out", left.figures, parts);
    }
    if let Some(judged) = document.judged {
        add("judged rows", judged, format!("{} rows", judged.rows));
    }
    text.push('\n');
    text += &table_text(&figures);
    let _ = writeln!(
        text,
        "\nrank {} of {}, score of what is determined alone {:.1e}",
        document.rank,
        document.parameters.len() - document.redundant.len(),
        document.score_of_determined
    );
    if !document.redundant.is_empty() {
        let names = document.redundant.join(", ");
        text += &folded(
            &format!(
                "Not counted, since they move the tool like location errors, other constants or the set-up, and are zero by convention: {names}"
            ),
            "",
        );
    }
    if let Some(next) = &document.next {
        text += &next_text(next);
    }
    text
}

/// Advice to observe another sphere, which may help more than a pose; empty without spheres.
fn sphere_helps(next: &Next) -> &'static str {
    if next.kind == Kind::Sphere {
        "; another sphere, far from the rotary axes and at another height, may help more"
    } else {
        ""
    }
}

/// Formats a value. Angles in deg and lengths in mm get more decimals than values in µrad and µm.
fn shown(parameter: &Parameter, number: f64) -> String {
    let digits = match parameter.unit {
        "mm" => 4,
        "deg" => 6,
        _ => 2,
    };
    fixed(number, digits)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn another_sphere_is_advised_where_spheres_are_observed() {
        let text = |kind: Kind, target: &str| {
            let next = Next {
                pose: BTreeMap::new(),
                file: "a.csv".to_owned(),
                kind,
                target: Some(target.to_owned()),
                tool: None,
                parameter: "EB0C".to_owned(),
                improvement: Some(1.02),
            };
            let folded = next_text(&next);
            folded.split_whitespace().collect::<Vec<_>>().join(" ")
        };
        let helps = "another sphere, far from";
        let sphere = text(Kind::Sphere, "ball of the corner");
        assert!(sphere.contains(helps), "{sphere}");
        assert!(sphere.contains("stays at 98 % of what it is now"), "{sphere}");
        let target = text(Kind::Points, "spherical mirror");
        assert!(!target.contains(helps), "{target}");
    }
}
