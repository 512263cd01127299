//! `volcomp check`: a machine file as it is understood.

mod provenance;
mod sizes;
mod text;

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{Form, MotionFrame, Side, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, CorrectionLimit, ErrorName};

use self::{
    provenance::Provenance,
    sizes::sizes,
    text::{motion, signs, sketch},
};
use super::{Answer, ByAxis, in_degrees, machine_notes, micrometres, microradians, rotary_note};
use crate::{failure::Failure, points::SpindleArguments};

/// The machine as it is understood: axes, errors, tool, and the error at home and at the corners
///
/// For each axis it says what a positive motion does in the workshop. Compare that with the machine: a wrong sign or a
/// missing prime shows here.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The machine file (TOML) to check
    machine: PathBuf,
    #[command(flatten)]
    spindle: SpindleArguments,
    /// Folder in which the measurement files that the machine file names are looked for, to compare their hashes [default: that
    /// of the machine file]
    #[arg(long, value_name = "DIR")]
    files: Option<PathBuf>,
}

/// The document of `volcomp check`: the machine as it is understood.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Check {
    /// The path of the machine file.
    file: String,
    /// Name of the machine.
    name: String,
    /// Structure code from the workpiece to the tool.
    structure: String,
    /// The chain as a drawing in text.
    sketch: String,
    /// The axes, in the order X Y Z A B C U V W.
    axes: Vec<Axis>,
    /// The tool that is in the spindle.
    tool: Tool,
    /// Names of the tools that can be put into the spindle with `--tool`.
    tools: Vec<String>,
    /// Workpiece origin at machine zero, mm in MCS.
    workpiece_origin_mm: [f64; 3],
    /// The errors that are there and not zero, axis by axis.
    errors: Vec<Size>,
    /// Errors that the machine file states as zero.
    zero: Vec<ErrorName>,
    /// Errors that the machine file does not state: they count as zero.
    not_stated: Vec<ErrorName>,
    /// Axes with assembly errors that are not zero.
    assembly: Vec<Assembly>,
    /// The thermal terms; null where there are none.
    thermal: Option<Thermal>,
    /// Where the errors come from; not there where the machine file does not tell it.
    #[serde(skip_serializing_if = "Option::is_none")]
    provenance: Option<Provenance>,
    /// The error at machine zero.
    home: Place,
    /// The error at every corner of the travels of X, Y and Z, other axes at 0.
    corners: Vec<Place>,
}

/// One axis of the machine.
#[derive(Debug, Serialize, JsonSchema)]
struct Axis {
    /// The letter of the axis.
    name: AxisName,
    /// The kind of the axis: `linear` or `rotary`.
    kind: &'static str,
    /// The side that the axis carries: `workpiece` or `tool`.
    carries: &'static str,
    /// Unit of `travel` and `modulo`: `mm` or `deg`.
    unit: &'static str,
    /// Lower and upper end of travel, mm or deg.
    travel: [f64; 2],
    /// Period that brings the coordinate into travel before curves are looked up, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    modulo: Option<f64>,
    /// Unit direction in MCS.
    direction: [f64; 3],
    /// Point at machine zero, mm in MCS: on the line of a rotary axis; where a linear axis's errors are stated.
    point_mm: [f64; 3],
    /// Where the error motions of a rotary axis stay: `fixed` or `turning`.
    #[serde(skip_serializing_if = "Option::is_none")]
    motion_frame: Option<&'static str>,
    /// The effect of a positive motion, in words.
    motion: String,
    /// A warning where the axis does not count along its letter's direction: a positive deviation is then a negative
    /// error, or several errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    signs: Option<String>,
}

/// The tool at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
struct Tool {
    /// The tool of `--tool`; null: the tool of `[tool]`.
    name: Option<String>,
    /// Tool tip, mm in MCS.
    tip_mm: [f64; 3],
    /// Unit direction from the tip to the spindle, in MCS.
    axis: [f64; 3],
}

/// One error and its size.
#[derive(Debug, Serialize, JsonSchema)]
struct Size {
    /// Its name after ISO 230-1.
    name: ErrorName,
    /// Its name in words.
    meaning: String,
    /// The unit of the values: `um` (µm) or `urad` (µrad).
    unit: &'static str,
    /// Smallest value over travel, in `unit`; a location error has the same smallest and largest value.
    smallest: f64,
    /// Largest value over travel, in `unit`.
    largest: f64,
    /// Where the value with the largest size stands, mm or deg; not there for a location error.
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<ByAxis>,
}

/// The six assembly errors of an axis.
#[derive(Debug, Serialize, JsonSchema)]
struct Assembly {
    /// The letter of the axis.
    axis: AxisName,
    /// Displacements along X, Y and Z, µm.
    position_um: [f64; 3],
    /// Rotations about X, Y and Z, µrad.
    rotation_urad: [f64; 3],
}

/// The thermal terms in short.
#[derive(Debug, Serialize, JsonSchema)]
struct Thermal {
    /// Temperature at which the curves hold, °C.
    reference_degc: f64,
    /// Names of the sensors.
    sensors: Vec<String>,
    /// Errors with an expansion term.
    expansion: Vec<ErrorName>,
    /// Errors with a drift term.
    drift: Vec<ErrorName>,
}

/// The tool and its error at one position.
#[derive(Debug, Serialize, JsonSchema)]
struct Place {
    /// Where the axes stand, mm or deg.
    at: ByAxis,
    /// Ideal tool tip from the workpiece origin, in workpiece axes, mm.
    tip_mm: [f64; 3],
    /// Actual minus ideal tool tip, in workpiece axes, µm.
    position_um: [f64; 3],
    /// Rotation of the tool, in workpiece axes, µrad.
    rotation_urad: [f64; 3],
    /// Axes that stand outside their travel there.
    outside_travel: Vec<AxisName>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.spindle.read(&arguments.machine)?;
    let document = document(arguments, &machine, &temperatures);
    let text = text::text(&document);
    let mut notes = machine_notes(&machine, &temperatures);
    notes.extend(rotary_note(&machine));
    notes.extend(no_point_note(&machine));
    notes.extend(limit_notes(&machine, &temperatures)?);
    notes.extend(machine.provenance().note());
    notes.extend(document.provenance.iter().flat_map(Provenance::notes));
    Answer::new(&document, text, notes)
}

fn document(arguments: &Arguments, machine: &Machine, temperatures: &Temperatures) -> Check {
    let chain = machine.chain();
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let sizes = sizes(machine, &names);
    let place = |state: &State| place(machine, temperatures, state);
    Check {
        file: arguments.machine.display().to_string(),
        name: machine.name.clone(),
        structure: chain.structure().to_string(),
        sketch: sketch(chain),
        axes: axes(machine),
        tool: Tool {
            name: arguments.spindle.tool.clone(),
            tip_mm: chain.tool_tip_mm().into(),
            axis: chain.tool_axis().into(),
        },
        tools: machine.tools().keys().cloned().collect(),
        workpiece_origin_mm: chain.workpiece_origin_mm().into(),
        errors: sizes.there,
        zero: sizes.zero,
        not_stated: sizes.not_stated,
        assembly: assembly(machine),
        thermal: thermal(machine),
        provenance: Provenance::of(machine, &folder(arguments)),
        home: place(&State::default()),
        corners: corners(machine).iter().map(place).collect(),
    }
}

/// Warns of corrections that `nc` and `export` refuse, at the temperatures or some kelvins from the reference.
fn limit_notes(machine: &Machine, temperatures: &Temperatures) -> Result<Vec<String>, Failure> {
    let usual = CorrectionLimit::default();
    let largest = machine.largest_corrections(temperatures)?;
    // Where rotary axes correct, nc bounds what all axes together do at the tool.
    let (who, but) = if largest.iter().any(|(axis, _)| axis.is_rotary()) {
        (
            "export allows",
            " (nc bounds by it what the corrections of all axes move the tool by)",
        )
    } else {
        ("nc and export allow", "")
    };
    let beyond = largest.iter().filter(|(_, most)| !usual.allows(*most));
    let mut notes: Vec<String> = beyond
        .map(|(axis, most)| {
            let kind = axis.kind();
            let (limit, ceiling) = (usual.of(kind), CorrectionLimit::LARGEST.of(kind));
            if CorrectionLimit::LARGEST.allows(*most) {
                format!(
                    "WARNING: the correction of {axis} reaches {most:.1} within the travels, more than the {limit} that {who} without --limit-um{but}: check the units of the errors"
                )
            } else {
                format!(
                    "WARNING: the correction of {axis} reaches {most:.1} within the travels, more than the {ceiling} that no command and no gateway applies: check the units of the errors"
                )
            }
        })
        .collect();
    let reference_degc = machine.thermal().reference_degc;
    let per_k = machine.largest_corrections_per_k()?;
    if per_k.is_empty() {
        return Ok(notes);
    }
    let at_reference = machine.largest_corrections(&Temperatures::new())?;
    for ((axis, per_k), (_, most)) in per_k.into_iter().zip(at_reference) {
        let limit = usual.of(axis.kind());
        let left_k = (limit.um_or_urad() - most.um_or_urad()) / per_k.um_or_urad();
        // Less than is printed is nothing.
        if per_k.um_or_urad() >= 0.05 && left_k >= 0.0 {
            notes.push(format!(
                "the correction of {axis} changes by up to {per_k:.1} with each kelvin of the sensors: {:.1} K from {reference_degc} °C it may reach the {limit} that {who} without --limit-um{but}",
                (10.0 * left_k).floor() / 10.0
            ));
        }
    }
    Ok(notes)
}

/// Where measurement files are looked for.
fn folder(arguments: &Arguments) -> PathBuf {
    match (&arguments.files, arguments.machine.parent()) {
        (Some(folder), _) => folder.clone(),
        (None, Some(folder)) => folder.to_owned(),
        (None, None) => PathBuf::new(),
    }
}

/// Names the rotary axes whose centre line is not stated: it is taken to run through the origin.
fn no_point_note(machine: &Machine) -> Option<String> {
    let axes = machine.axes().iter();
    let without = axes.filter(|axis| axis.name.is_rotary() && axis.point_mm.is_none());
    let mut names: Vec<AxisName> = without.map(|axis| axis.name).collect();
    names.sort_unstable();
    (!names.is_empty()).then(|| {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        format!(
            "no `point` is stated for {}: the centre line is taken to run through the origin [0, 0, 0] of the machine",
            names.join(", ")
        )
    })
}

fn axes(machine: &Machine) -> Vec<Axis> {
    let stated = machine.axes().iter().zip(machine.chain().joints());
    let mut axes: Vec<Axis> = stated
        .map(|(axis, joint)| Axis {
            name: axis.name,
            kind: joint.kind.name(),
            carries: match joint.side {
                Side::Workpiece => "workpiece",
                Side::Tool => "tool",
            },
            unit: joint.kind.coordinate_unit(),
            travel: axis.travel,
            modulo: axis.modulo,
            direction: joint.direction.into(),
            point_mm: joint.point_mm.into(),
            motion_frame: axis.name.is_rotary().then_some(match joint.motion_frame {
                MotionFrame::Fixed => "fixed",
                MotionFrame::Turning => "turning",
            }),
            motion: motion(joint),
            signs: signs(joint),
        })
        .collect();
    axes.sort_unstable_by_key(|axis| axis.name);
    axes
}

fn assembly(machine: &Machine) -> Vec<Assembly> {
    let stated = machine.axes().iter().enumerate();
    let mut assembly: Vec<Assembly> = stated
        .filter_map(|(index, axis)| {
            let [x, y, z, a, b, c] = machine.assembly(index);
            let found = Assembly {
                axis: axis.name,
                position_um: [x, y, z],
                rotation_urad: [a, b, c],
            };
            (machine.assembly(index) != [0.0; 6]).then_some(found)
        })
        .collect();
    assembly.sort_unstable_by_key(|assembly| assembly.axis);
    assembly
}

fn thermal(machine: &Machine) -> Option<Thermal> {
    let thermal = machine.thermal();
    let sensors = thermal.sensors();
    (!sensors.is_empty()).then(|| Thermal {
        reference_degc: thermal.reference_degc,
        sensors: sensors.into_iter().map(str::to_owned).collect(),
        expansion: thermal.expansion.iter().map(|term| term.error).collect(),
        drift: thermal.drift.iter().map(|term| term.error).collect(),
    })
}

/// Every corner of the travels of X, Y and Z that the machine has, X fastest; other axes stand at 0.
fn corners(machine: &Machine) -> Vec<State> {
    let linear = [AxisName::X, AxisName::Y, AxisName::Z];
    let linear = linear.into_iter().filter_map(|name| machine.axis(name));
    let mut corners = vec![Vec::new()];
    for axis in linear {
        corners = axis
            .travel
            .into_iter()
            .zip([&corners, &corners])
            .flat_map(|(end, corners)| {
                let extended = corners
                    .iter()
                    .map(move |corner: &Vec<_>| [&[(axis.name, end)], corner.as_slice()].concat());
                extended.collect::<Vec<_>>()
            })
            .collect();
    }
    // Ends of travel are finite and belong to axes that are there.
    let states = corners
        .iter()
        .filter_map(|corner| machine.state(corner).ok());
    states.collect()
}

fn place(machine: &Machine, temperatures: &Temperatures, state: &State) -> Place {
    let error = machine.error_at(state, Form::Exact, temperatures);
    let joints = machine.chain().joints().iter().zip(&state.q);
    let mut outside_travel = machine.outside_travel(state);
    outside_travel.sort_unstable();
    Place {
        at: joints
            .map(|(joint, &q)| (joint.name, in_degrees(joint.kind, q)))
            .collect(),
        tip_mm: machine.chain().ideal_tip_mm(state).into(),
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside_travel,
    }
}
