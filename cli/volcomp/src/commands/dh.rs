use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{DhConvention, DhTable, Pose};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::{Answer, fixed, table, table_text};
use crate::{arguments::GeometryArguments, failure::Failure, table::folded};

/// Show the Denavit–Hartenberg table of a machine at machine zero
///
/// distal: A = Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); proximal: A = Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d). The line
/// of a slide runs through the frame before it. The points at which errors are stated are not in the table.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp dh -m trunnion.toml
  volcomp dh -m five-axis.toml --convention proximal")]
pub(crate) struct DhArguments {
    #[command(flatten)]
    machine: GeometryArguments,
    /// Order of the motions in a row: distal (θ d a α) or proximal (α a θ d), also called modified
    #[arg(long, value_enum, default_value_t = Convention::Distal)]
    convention: Convention,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Convention {
    Distal,
    Proximal,
}

/// The document of `volcomp dh`: the Denavit–Hartenberg table of a machine at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Dh {
    /// Denavit–Hartenberg convention: `distal` or `proximal`.
    convention: String,
    /// Joint types from the workpiece to the tool: R for revolute, T for prismatic.
    joints: String,
    /// The frame before the first row, in the machine coordinate system.
    base: Frame,
    /// One row for each axis, from the workpiece to the tool.
    rows: Vec<Row>,
    /// The machine coordinate system in the last frame. The product of `base`, the rows and `tool`
    /// is the identity at machine zero.
    tool: Frame,
}

/// A frame by its origin and two of its axes.
#[derive(Debug, Serialize, JsonSchema)]
struct Frame {
    /// The origin, mm.
    point_mm: [f64; 3],
    /// Direction of the frame's x axis.
    x: [f64; 3],
    /// Direction of the frame's z axis.
    z: [f64; 3],
}

/// One row of the table at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
struct Row {
    /// The axis, whose coordinate adds to `theta_deg` (rotary) or `d_mm` (linear).
    axis: AxisName,
    /// `linear` or `rotary`.
    kind: AxisKind,
    /// Joint angle θ, deg.
    theta_deg: f64,
    /// Link offset d, mm.
    d_mm: f64,
    /// Link length a, mm.
    a_mm: f64,
    /// Link twist α, deg.
    alpha_deg: f64,
}

pub(crate) fn run(arguments: &DhArguments) -> Result<Answer, Failure> {
    let machine = arguments.machine.read()?;
    let (convention, word) = match arguments.convention {
        Convention::Distal => (DhConvention::Distal, "distal"),
        Convention::Proximal => (DhConvention::Proximal, "proximal"),
    };
    let structure = machine.chain().structure();
    let dh = DhTable::of_chain(machine.chain()).in_convention(convention);
    let letter = |kind| match kind {
        AxisKind::Linear => 'T',
        AxisKind::Rotary => 'R',
    };
    let rows = dh.rows.iter().zip(structure.axes());
    let document = Dh {
        convention: word.to_owned(),
        joints: structure.axes().iter().map(|axis| letter(axis.kind())).collect(),
        base: frame(&dh.base),
        rows: rows
            .map(|(row, &axis)| Row {
                axis,
                kind: axis.kind(),
                theta_deg: row.theta_rad.to_degrees(),
                d_mm: row.d_mm,
                a_mm: row.a_mm,
                alpha_deg: row.alpha_rad.to_degrees(),
            })
            .collect(),
        tool: frame(&dh.tool(structure)),
    };
    let text = text(&document);
    Answer::new(&document, text, Vec::new())
}

fn frame(pose: &Pose) -> Frame {
    let direction = |place: usize| -> [f64; 3] {
        let column = pose.rotation.column(place);
        [column[0], column[1], column[2]]
    };
    Frame { point_mm: pose.translation_mm.into(), x: direction(0), z: direction(2) }
}

fn text(document: &Dh) -> String {
    let proximal = document.convention == "proximal";
    let heads = if proximal {
        ["", "α deg", "a mm", "θ deg", "d mm"]
    } else {
        ["", "θ deg", "d mm", "a mm", "α deg"]
    };
    let mut table = table(&heads);
    for row in &document.rows {
        let coordinate = |value: f64, kind| {
            let number = fixed(value, 6);
            if row.kind == kind { format!("{number} + {}", row.axis) } else { number }
        };
        let (theta, d) =
            (coordinate(row.theta_deg, AxisKind::Rotary), coordinate(row.d_mm, AxisKind::Linear));
        let (a, alpha) = (fixed(row.a_mm, 6), fixed(row.alpha_deg, 6));
        let axis = row.axis.to_string();
        table.add_row(if proximal {
            [axis, alpha, a, theta, d]
        } else {
            [axis, theta, d, a, alpha]
        });
    }
    let vector = |v: &[f64; 3]| {
        // Six decimals without trailing zeros and without a negative zero.
        let rounded = |x: &f64| (x * 1e6).round() / 1e6 + 0.0;
        let numbers: Vec<String> = v.iter().map(|x| rounded(x).to_string()).collect();
        format!("[{}]", numbers.join(", "))
    };
    let line = |name: &str, frame: &Frame| {
        let (point, x, z) = (vector(&frame.point_mm), vector(&frame.x), vector(&frame.z));
        folded(&format!("{name}: point {point} mm, x {x}, z {z}"), "")
    };
    let mut text =
        folded(&format!("{} rows, {}, at machine zero", document.convention, document.joints), "");
    text += &table_text(&table);
    text.push('\n');
    text += &line("Base, in machine coordinates", &document.base);
    text += &line("Machine coordinates in the last frame", &document.tool);
    text
}
