use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_sensitivity::{ErrorTerm, Expression, Grouped};

use super::{Answer, sensitivity::errors_of};
use crate::{arguments::GeometryArguments, failure::Failure, table::folded};

/// Print the first-order volumetric error as a formula: each error with its lever
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp expression -m mill.toml
  volcomp expression -m first.toml --assembly --latex")]
pub(crate) struct ExpressionArguments {
    #[command(flatten)]
    machine: GeometryArguments,
    /// Include six assembly errors per axis, and location errors only if the machine file states them
    #[arg(long)]
    assembly: bool,
    /// Print LaTeX: an `align` environment of amsmath
    #[arg(long)]
    latex: bool,
}

/// The document of `volcomp expression`: the first-order volumetric error, lengths in mm and angles in rad.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Formulas {
    /// Displacement of the tool tip along X, Y and Z (`dX dY dZ`), then rotation of the tool about them (`dA dB dC`).
    formulas: Vec<Formula>,
    /// Coordinates of the tool tip at machine zero that occur in the formulas, mm.
    tool_mm: BTreeMap<String, f64>,
}

/// One component of the volumetric error.
#[derive(Debug, Serialize, JsonSchema)]
struct Formula {
    /// Left side of the formula.
    name: String,
    /// The whole formula in a syntax valid in Python and spreadsheets.
    text: String,
    /// The whole formula in LaTeX, for an `align` environment.
    latex: String,
    /// Errors grouped by lever.
    terms: Vec<Term>,
}

/// Errors with the same lever.
#[derive(Debug, Serialize, JsonSchema)]
struct Term {
    /// Lever, mm, or a number without unit.
    lever: String,
    /// Names of the errors; a minus sign marks negative terms.
    errors: Vec<String>,
}

pub(crate) fn run(arguments: &ExpressionArguments) -> Result<Answer, Failure> {
    let machine = arguments.machine.read()?;
    let errors = errors_of(&machine, arguments.assembly);
    let expression = Expression::of(machine.chain(), &errors);
    let (text, latex) = (expression.text(), expression.latex());
    let mut formulas = Vec::new();
    for ((text, latex), groups) in text.iter().zip(&latex).zip(expression.components()) {
        formulas.push(Formula {
            name: text.chars().take_while(|c| *c != ' ').collect(),
            text: text.clone(),
            latex: latex.clone(),
            terms: groups.iter().map(term).collect(),
        });
    }
    let tool = expression.tool_tip_mm();
    let symbols = ["Xt", "Yt", "Zt"].into_iter().zip(tool);
    let symbols = symbols.filter(|(_, mm)| *mm != 0.0);
    let document = Formulas {
        formulas,
        tool_mm: symbols.map(|(name, mm)| (name.to_owned(), mm)).collect::<BTreeMap<_, _>>(),
    };
    let shown = if arguments.latex {
        // LaTeX treats a line break as a blank.
        let whole = latex.join(" \\\\\n");
        let lines: String = whole.lines().map(|line| folded(line, "")).collect();
        format!("\\begin{{align}}\n{lines}\\end{{align}}\n")
    } else {
        let said: Vec<String> =
            document.tool_mm.iter().map(|(name, mm)| format!("{name} = {mm}")).collect();
        let tool = if said.is_empty() {
            "the tool tip is at the origin".to_owned()
        } else {
            said.join(", ")
        };
        let formulas: String = text.iter().map(|formula| in_lines(formula)).collect();
        format!("{formulas}\n{}", folded(&format!("Lengths in mm, angles in rad; {tool}."), ""))
    };
    Answer::new(&document, shown, Vec::new())
}

/// A formula in lines that are valid in Python. Several lines are in parentheses.
fn in_lines(formula: &str) -> String {
    let lines = folded(formula, "");
    match formula.split_once(" = ") {
        Some((name, sum)) if lines.lines().count() > 1 => folded(&format!("{name} = ({sum})"), ""),
        _ => lines,
    }
}

fn term(group: &Grouped) -> Term {
    let signed = |(term, negative): &(ErrorTerm, bool)| {
        format!("{}{term}", if *negative { "-" } else { "" })
    };
    Term { lever: group.lever.to_string(), errors: group.errors.iter().map(signed).collect() }
}
