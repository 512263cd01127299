//! `volcomp error`: the volumetric error at positions.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{Form, State, volumetric_error};
use volcomp_model::{Machine, MachineErrors};

use super::{Answer, ByAxis, fixed, machine_notes, micrometres, microradians};
use crate::{
    arguments::{ApproachArguments, MachineArguments, PointArguments},
    failure::Failure,
    listing::{Listing, Outside, Row, outside, outside_note},
};

/// Show the volumetric error at a position: actual minus ideal, in workpiece axes
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp error -m gantry.toml --at X=1000,Y=500,Z=-50
  volcomp error -m gantry.toml --points points.csv --temperature scale_x=22.5")]
pub(crate) struct ErrorArguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    points: PointArguments,
    #[command(flatten)]
    approach: ApproachArguments,
    /// Form of the model: exact (rigid transforms), htm (small-angle matrices) or twist (first order)
    #[arg(long, default_value_t = Form::Exact)]
    model: Form,
}

/// The volumetric error at one position, in workpiece axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ErrorAt {
    /// The position, mm and deg.
    at: ByAxis,
    /// Actual minus ideal tool tip along X, Y and Z, µm.
    position_um: [f64; 3],
    /// Rotation of the tool about X, Y and Z, µrad.
    rotation_urad: [f64; 3],
    #[serde(flatten)]
    outside: Outside,
}

pub(crate) fn run(arguments: &ErrorArguments, json: bool) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let mut positions = arguments.points.positions(&machine, &arguments.approach)?;
    let source = machine.source(&temperatures);
    let row = |state: &State| evaluate(&machine, &source, state, arguments.model);
    let header = ["X µm", "Y µm", "Z µm", "A µrad", "B µrad", "C µrad"];
    let header = header.map(str::to_owned).to_vec();
    let mut listing = Listing::new(json, positions.head().is_some(), header);
    loop {
        let states = positions.next_batch(&machine)?.states;
        if states.is_empty() {
            break;
        }
        let rows: Vec<ErrorAt> = states.par_iter().map(row).collect();
        listing.extend(&rows, |row| row.outside.words())?;
    }
    let notes = [positions.note(listing.rows()), outside_note(listing.outside())];
    let mut notes: Vec<String> = notes.into_iter().flatten().collect();
    notes.extend(machine_notes(&machine, &temperatures));
    Ok(Answer::listed(listing, String::new(), notes))
}

fn evaluate(machine: &Machine, source: &MachineErrors<'_>, state: &State, form: Form) -> ErrorAt {
    let error = volumetric_error(machine.chain(), source, state, form);
    ErrorAt {
        at: machine.coordinates(state),
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside: outside(machine, state),
    }
}

impl Row for ErrorAt {
    fn cells(&self) -> Vec<String> {
        let numbers = self.position_um.iter().chain(&self.rotation_urad);
        numbers.map(|value| fixed(*value, 3)).collect()
    }

    fn outside(&self) -> &Outside {
        &self.outside
    }
}
