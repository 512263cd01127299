//! `volcomp expression`: the first-order volumetric error as a formula.

use std::collections::BTreeMap;

use volcomp_sensitivity::{Expression, Grouped};

use super::{Answer, sensitivity::errors_of};
use crate::{
    answers::sensitivity as answers, failure::Failure, points::GeometryArguments, table::folded,
};

/// The first-order volumetric error as a formula: each error with its lever
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: GeometryArguments,
    /// Six assembly errors of each axis, too; location errors, which they comprise, only where the machine file states
    /// them
    #[arg(long)]
    assembly: bool,
    /// Print LaTeX: an `align` environment of amsmath
    #[arg(long)]
    latex: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let machine = arguments.machine.read()?;
    let errors = errors_of(&machine, arguments.assembly);
    let expression = Expression::of(machine.chain(), &errors);
    let (text, latex) = (expression.text(), expression.latex());
    let mut formulas = Vec::new();
    for ((text, latex), groups) in text.iter().zip(&latex).zip(expression.components()) {
        formulas.push(answers::Formula {
            name: text.chars().take_while(|c| *c != ' ').collect(),
            text: text.clone(),
            latex: latex.clone(),
            terms: groups.iter().map(term).collect(),
        });
    }
    let tool = expression.tool_tip_mm();
    let symbols = ["Xt", "Yt", "Zt"].into_iter().zip(tool);
    let symbols = symbols.filter(|(_, mm)| *mm != 0.0);
    let document = answers::Expression {
        formulas,
        tool_mm: symbols
            .map(|(name, mm)| (name.to_owned(), mm))
            .collect::<BTreeMap<_, _>>(),
    };
    let shown = if arguments.latex {
        // A break at a blank is a blank to LaTeX.
        let whole = latex.join(" \\\\\n");
        let lines: String = whole.lines().map(|line| folded(line, "")).collect();
        format!("\\begin{{align}}\n{lines}\\end{{align}}\n")
    } else {
        let said: Vec<String> = document
            .tool_mm
            .iter()
            .map(|(name, mm)| format!("{name} = {mm}"))
            .collect();
        let tool = if said.is_empty() {
            "the tool tip is at the origin".to_owned()
        } else {
            said.join(", ")
        };
        let formulas: String = text.iter().map(|formula| in_lines(formula)).collect();
        format!(
            "{formulas}\n{}",
            folded(&format!("Lengths in mm, angles in rad; {tool}."), "")
        )
    };
    Answer::new(&document, shown, Vec::new())
}

/// A formula in lines that Python reads: within parentheses where there are several.
fn in_lines(formula: &str) -> String {
    let lines = folded(formula, "");
    match formula.split_once(" = ") {
        Some((name, sum)) if lines.lines().count() > 1 => folded(&format!("{name} = ({sum})"), ""),
        _ => lines,
    }
}

fn term(group: &Grouped) -> answers::Term {
    let signed = |(term, negative): &(volcomp_sensitivity::ErrorTerm, bool)| {
        format!("{}{term}", if *negative { "-" } else { "" })
    };
    answers::Term {
        lever: group.lever.to_string(),
        errors: group.errors.iter().map(signed).collect(),
    }
}
