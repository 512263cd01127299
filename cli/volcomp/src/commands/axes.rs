use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::State;
use volcomp_model::{Machine, Reached};
use volcomp_vocabulary::AxisName;

use super::{Answer, ByAxis, fixed, in_degrees, table, table_text};
use crate::{
    arguments::{GeometryArguments, three},
    failure::Failure,
    table::folded,
};

/// Show the axis positions of the ideal machine for a tool tip and direction: every solution within travel
///
/// One or two rotary axes, and one linear axis per direction, are solved in closed form. Of further rotary axes two move,
/// pair after pair; the others stay as near to 0 as possible. Of parallel linear axes the first moves, and the others
/// when it is at an end of its travel. At a singular pose one of infinitely many solutions is shown, with the free axes
/// and their ranges.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp axes -m trunnion.toml --tip 0,0,-50 --tool-axis 0,0.5,0.866
  volcomp --json axes -m five-axis.toml --tip 400,300,-300")]
pub(crate) struct AxesArguments {
    #[command(flatten)]
    machine: GeometryArguments,
    /// Tool tip in workpiece axes, from the workpiece origin, mm
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    tip: String,
    /// Direction of the tool axis in workpiece axes, from the tip to the spindle, of any length
    #[arg(long, value_name = "I,J,K", allow_hyphen_values = true, default_value = "0,0,1")]
    tool_axis: String,
}

/// The document of `volcomp axes`: axis coordinates for a tip position and a direction of the tool.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Axes {
    /// Every solution within the travels, mm and deg, sorted by the amount of rotation.
    solutions: Vec<ByAxis>,
    /// Whether the pose is singular: a rotary axis does not affect the direction of the tool, or
    /// linear axes are dependent.
    singular: bool,
    /// The rotary axes that do not affect the direction of the tool, and the dependent linear axes.
    free: Vec<AxisName>,
    /// For each axis of `free`: ranges of its coordinate (mm or deg; for a rotary axis within one turn) in which all
    /// other axes are within their travels. For each range of a rotary axis, `solutions` contains the solution with
    /// this axis nearest to 0. Empty for linear axes with several dependent moves.
    free_ranges: Vec<Vec<[f64; 2]>>,
    /// Moves of linear axes that do not move the tip, mm, scaled to a largest component of 1.
    dependent_moves: Vec<ByAxis>,
    /// Axes outside their travel in the other solutions.
    outside_travel: Vec<AxisName>,
    /// Why no solution exists even with unlimited travels; null if there is a solution, within or
    /// outside the travels.
    unreachable: Option<String>,
}

pub(crate) fn run(arguments: &AxesArguments) -> Result<Answer, Failure> {
    let machine = arguments.machine.read()?;
    let tip = three("--tip", &arguments.tip)?;
    let direction = three("--tool-axis", &arguments.tool_axis)?;
    if direction == [0.0; 3] {
        return Err(Failure::Input(format!(
            "--tool-axis: found `{}`, expected a direction of any length but zero",
            arguments.tool_axis
        )));
    }
    let reached = machine.axes_at(tip, direction)?;
    let by_axis = |state: &State| machine.coordinates(state);
    let document = Axes {
        solutions: reached.solutions.iter().map(by_axis).collect(),
        singular: reached.singular,
        free: reached.free.clone(),
        free_ranges: (reached.free.iter().zip(&reached.ranges))
            .map(|(free, ranges)| {
                let ends = |range: &[f64; 2]| range.map(|q| in_degrees(free.kind(), q));
                ranges.iter().map(ends).collect()
            })
            .collect(),
        dependent_moves: (reached.dependent.iter())
            .map(|moves| {
                let mut moves = by_axis(moves);
                moves.retain(|_, share| *share != 0.0);
                moves
            })
            .collect(),
        outside_travel: reached.outside.clone(),
        unreachable: reached
            .missed
            .filter(|_| reached.outside.is_empty())
            .map(|missed| missed.to_string()),
    };
    let text = text(&machine, &document);
    Answer::new(&document, text, notes(&reached))
}

fn text(machine: &Machine, document: &Axes) -> String {
    let Some(first) = document.solutions.first() else {
        let why = match &document.unreachable {
            Some(reason) => reason.clone(),
            None => format!("it lies beyond the travel of {}", listed(&document.outside_travel)),
        };
        return folded(&format!("No solution: {why}."), "");
    };
    let heads = first.keys().map(|&name| format!("{name} {}", name.kind().coordinate_unit()));
    let heads: Vec<String> = [String::new()].into_iter().chain(heads).collect();
    let mut table = table(&heads.iter().map(String::as_str).collect::<Vec<_>>());
    for (index, solution) in document.solutions.iter().enumerate() {
        let numbers = solution.values().map(|&q| fixed(q, 6));
        table.add_row([(index + 1).to_string()].into_iter().chain(numbers));
    }
    let mut text = table_text(&table);
    if document.singular {
        let turns = machine.axes().iter().filter(|axis| axis.name.is_rotary()).count();
        let pose = if turns > 1 { "Singular pose" } else { "The tool is along the axis" };
        let free = document.free.iter().zip(&document.free_ranges);
        for (free, ranges) in free.filter(|(free, _)| free.is_rotary()) {
            let ranges: Vec<String> = (ranges.iter())
                .map(|[from, to]| format!("from {} to {} deg", fixed(*from, 3), fixed(*to, 3)))
                .collect();
            text.push('\n');
            text += &folded(
                &format!(
                    "{pose}: {free} does not turn the tool axis here. The other axes are within their travels with {free} {}, and whole turns from there.",
                    ranges.join(", or ")
                ),
                "",
            );
        }
        text += &dependent(document);
    }
    text
}

/// Describes the linear axes that are dependent at this pose, with the limits of their common move.
fn dependent(document: &Axes) -> String {
    let mut text = String::new();
    for moves in &document.dependent_moves {
        let shares = moves.iter();
        let shares: Vec<String> =
            shares.map(|(name, &share)| format!("{name} by {}", fixed(share, 6))).collect();
        text.push('\n');
        text += &folded(
            &format!(
                "Singular pose: the linear axes {} are dependent here. The tip stays where they move together: {} mm, or any multiple of that.",
                listed(&moves.keys().copied().collect::<Vec<_>>()),
                shares.join(", ")
            ),
            "",
        );
    }
    let free = document.free.iter().zip(&document.free_ranges);
    for (free, ranges) in free.filter(|(free, ranges)| !free.is_rotary() && !ranges.is_empty()) {
        let ranges: Vec<String> = (ranges.iter())
            .map(|[from, to]| format!("from {} to {} mm", fixed(*from, 3), fixed(*to, 3)))
            .collect();
        text += &folded(
            &format!("All are within their travels with {free} {}.", ranges.join(", or ")),
            "",
        );
    }
    text
}

fn notes(reached: &Reached) -> Vec<String> {
    let beyond = !reached.solutions.is_empty() && !reached.outside.is_empty();
    let beyond = beyond.then(|| {
        let outside = listed(&reached.outside);
        format!("further solutions lie beyond the travel of {outside}")
    });
    beyond.into_iter().collect()
}

fn listed(names: &[AxisName]) -> String {
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    names.join(", ")
}
