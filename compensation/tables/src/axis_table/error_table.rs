//! Tables of the component errors themselves, for controls that know the machine's structure.

use volcomp_vocabulary::{AxisName, Displacement, ErrorName};

/// One error motion at positions of its axis, in the sign of the machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorTable {
    /// Which error.
    pub name: ErrorName,
    /// Positions of its axis, rising, mm or rad.
    pub positions: Vec<f64>,
    /// The error at each, mm or rad.
    pub values: Vec<f64>,
}

impl ErrorTable {
    /// A position as files state it: mm or deg.
    pub(crate) fn at_edge(&self, position: f64) -> f64 {
        Displacement::new(self.name.axis.kind(), position).mm_or_deg()
    }

    pub(crate) fn from_edge(axis: AxisName, mm_or_deg: f64) -> f64 {
        Displacement::from_coordinate(axis.kind(), mm_or_deg).mm_or_rad()
    }

    /// Why these numbers are no table; `None` where they are one.
    pub fn refusal(&self) -> Option<String> {
        let name = self.name;
        let nodes = self.positions.len();
        if nodes < 2 || self.values.len() != nodes {
            return Some(format!(
                "{name}: found {nodes} positions and {} values, expected as many of both, 2 at the least",
                self.values.len()
            ));
        }
        if let Some(pair) = self.positions.windows(2).find(|pair| pair[0] >= pair[1]) {
            let [a, b] = [pair[0], pair[1]].map(|at| self.at_edge(at));
            return Some(format!(
                "{name}: found the positions {a} and {b}, expected rising ones"
            ));
        }
        let mut all = self.positions.iter().chain(&self.values);
        (!all.all(|x| x.is_finite())).then(|| format!("{name}: expected finite numbers"))
    }
}

/// The component errors of a machine as tables and numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorTables {
    /// Error motions.
    pub curves: Vec<ErrorTable>,
    /// Location errors, mm or rad.
    pub locations: Vec<(ErrorName, f64)>,
}
