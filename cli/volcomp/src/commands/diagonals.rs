//! `volcomp diagonals`: the body diagonals of ISO 230-6 on the model.

use volcomp_kinematics::State;
use volcomp_model::{BODY_DIAGONALS, ModelError, diagonals};
use volcomp_vocabulary::AxisName;

use super::{Answer, fixed, machine_notes, table, table_text};
use crate::{
    answers::diagonals::{Diagonal, Diagonals},
    compensation::{Compensation, CompensationArguments},
    failure::Failure,
    points::{MachineArguments, OthersArguments},
};

const LINEAR: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// The body diagonals of ISO 230-6: deviation along each, zero at its first target
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    compensation: CompensationArguments,
    /// Targets on a diagonal, both ends included
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    points: u32,
    #[command(flatten)]
    others: OthersArguments,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let compensation = Compensation::new(&arguments.compensation, &machine, &temperatures)?;
    let actual = compensation.actual();
    let source = actual.source(&temperatures);
    let points = arguments.points as usize;
    let mut notes = machine_notes(&machine, &temperatures);
    let others = arguments.others.read(&machine, &mut notes)?;
    let command = |state: &State| compensation.command(state);
    let found =
        diagonals(actual, &source, points, &others, command).map_err(|error| match error {
            ModelError::NoSuchAxis { axis, .. } if LINEAR.contains(&axis) => Failure::in_file(
                &arguments.machine.machine,
                format_args!(
                    "structure `{}`, expected the axes X, Y and Z for body diagonals",
                    machine.chain().structure()
                ),
            ),
            other => other.into(),
        })?;
    let mut table = table(&["diagonal", "range µm", "at the end µm"]);
    for diagonal in &found {
        let last = diagonal.deviation_um.last().copied().unwrap_or(0.0);
        table.add_row([
            diagonal.name.to_owned(),
            fixed(diagonal.range_um, 3),
            fixed(last, 3),
        ]);
    }
    let [ppp, npp, pnp, ppn] = BODY_DIAGONALS.map(|name| {
        let named = found.iter().find(|diagonal| diagonal.name == name);
        // The model gives all four.
        named.map_or_else(Diagonal::default, |diagonal| Diagonal {
            deviation_um: diagonal.deviation_um.clone(),
            range_um: diagonal.range_um,
        })
    });
    let document = Diagonals {
        ppp,
        npp,
        pnp,
        ppn,
        compensated: compensation.document(),
    };
    Answer::new(&document, table_text(&table) + &compensation.words(), notes)
}
