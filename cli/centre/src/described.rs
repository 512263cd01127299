//! What a machine file states, in words and as a formula.

use serde::Serialize;
use volcomp_model::Machine;
use volcomp_sensitivity::{Expression, terms};
use volcomp_vocabulary::Mm;

use crate::map::ErrorMap;

/// What a machine file states.
#[derive(Clone, Debug, Serialize)]
pub struct Described {
    /// The machine file.
    pub text: String,
    /// The structure code.
    pub structure: String,
    /// The type numbers, linear and rotary; `None`: none of the sixteen types.
    pub type_numbers: Option<[u8; 2]>,
    /// The first-order volumetric error as a formula: displacement along X, Y, Z, rotation about them (mm, rad).
    pub formula: Vec<String>,
    /// The coordinates of the tool tip in the formula, mm.
    pub tool_mm: [f64; 3],
}

impl Described {
    /// Describes a machine, whose file has this text.
    pub fn new(machine: &Machine, text: &str) -> Self {
        let stated: Vec<_> = machine.locations().keys().copied().collect();
        let expression = Expression::of(machine.chain(), &terms(machine.chain(), false, &stated));
        let structure = machine.chain().structure();
        Self {
            text: text.to_owned(),
            structure: structure.to_string(),
            type_numbers: structure
                .type_numbers()
                .map(|numbers| [numbers.translational, numbers.rotary]),
            formula: expression.text().to_vec(),
            tool_mm: expression.tool_tip_mm(),
        }
    }
}

/// A note on a machine whose error is larger than any guard corrects: a unit is wrong, or a comma.
pub fn beyond_every_guard(map: &ErrorMap) -> Option<String> {
    let largest_mm = map.largest_um[0] / 1000.0;
    let Mm(most_mm) = volcomp_guard::ceiling::LIMIT;
    (largest_mm > most_mm).then(|| {
        format!(
            "The error is up to {largest_mm:.1} mm in the work space. No guard corrects an axis by more than {most_mm} mm, and machines have some hundredths: check the numbers and their units."
        )
    })
}
