//! Possible structures for the axes of a control: proposals for the user, never a decision.
//!
//! A control reports the letters of its axes but not how they are stacked. The candidates are the types of the generalised model, the most common
//! designs first.

use serde::Serialize;
use volcomp_kinematics::Structure;
use volcomp_vocabulary::{AxisKind, AxisName};

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Proposal {
    /// The structure code, such as `w X' b Y Z t`.
    pub structure: String,
    /// Type number of the linear axes: number of X, Y and Z that carry the workpiece.
    pub translational: u8,
    /// Type number of the rotary axes: 0 none, 1 both carry the workpiece, 2 both carry the tool, 3
    /// one carries the workpiece and the other the tool.
    pub rotary: u8,
    /// Rotary axes from the workpiece to the tool.
    pub rotary_axes: Vec<AxisName>,
    pub design: String,
}

/// Number of linear axes that carry the workpiece, the most common design first: for milling machines a table that
/// moves in two directions or in one, then a gantry, then a knee.
const WORKPIECE_AXES_BY_FREQUENCY: [u8; 4] = [2, 1, 0, 3];

/// Possible structures for a control's axis letters; letters that name no axis are ignored. Empty unless X, Y and Z are
/// all present with no or two rotary axes: the type numbers cover no other machines, so the user must enter the
/// structure.
pub fn proposals(letters: &[char]) -> Vec<Proposal> {
    let mut axes: Vec<AxisName> = Vec::new();
    for axis in letters.iter().filter_map(|letter| axis_of(*letter)) {
        if !axes.contains(&axis) {
            axes.push(axis);
        }
    }
    let has_linear = [AxisName::X, AxisName::Y, AxisName::Z].iter().all(|axis| axes.contains(axis));
    let mut rotary: Vec<AxisName> =
        axes.into_iter().filter(|axis| axis.kind() == AxisKind::Rotary).collect();
    rotary.sort_unstable();
    if !has_linear {
        return Vec::new();
    }
    let orders = match rotary[..] {
        [] => vec![(0, Vec::new())],
        // The last letter names the axis that turns about the spindle direction: the rotary table on a tilting table,
        // or the carrier of a tilting head.
        [first, last] => vec![
            (1, vec![last, first]),
            (3, vec![last, first]),
            (2, vec![last, first]),
            (1, vec![first, last]),
            (2, vec![first, last]),
            (3, vec![first, last]),
        ],
        _ => Vec::new(),
    };
    let proposed = orders.iter().flat_map(|(number, order)| {
        WORKPIECE_AXES_BY_FREQUENCY
            .iter()
            .filter_map(move |translational| proposal(*translational, *number, order))
    });
    proposed.collect()
}

fn axis_of(letter: char) -> Option<AxisName> {
    AxisName::ALL.into_iter().find(|axis| axis.to_string() == letter.to_string())
}

fn proposal(translational: u8, rotary: u8, axes: &[AxisName]) -> Option<Proposal> {
    let structure = Structure::from_type(translational, rotary, axes).ok()?;
    let linear = match translational {
        0 => "the tool moves in X, Y and Z",
        1 => "the table moves in X",
        2 => "the table moves in X and Y",
        _ => "the table moves in X, Y and Z",
    };
    let list: Vec<String> = axes.iter().map(ToString::to_string).collect();
    let rotary_part = match rotary {
        0 => String::new(),
        1 => format!(", {} turn the workpiece", list.join(" and ")),
        2 => format!(", {} turn the tool", list.join(" and ")),
        _ => format!(", {} turns the workpiece and {} the tool", list.first()?, list.last()?),
    };
    Some(Proposal {
        structure: structure.to_string(),
        translational,
        rotary,
        rotary_axes: axes.to_vec(),
        design: format!("{linear}{rotary_part}"),
    })
}
