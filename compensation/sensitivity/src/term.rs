//! The single errors of a chain.

use core::fmt;

use volcomp_kinematics::Chain;
use volcomp_vocabulary::{AxisName, Component, ErrorName};

/// One error of a machine: an error motion, a location error, or an assembly error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ErrorTerm {
    /// An error motion `E?N` or a location error `E?0N`.
    Named(ErrorName),
    /// An assembly error, written `SXX … SCX` for the axis X.
    Assembly(Component, AxisName),
}

impl ErrorTerm {
    /// Component of the error along or about an axis of the machine coordinate system.
    pub fn component(self) -> Component {
        match self {
            Self::Named(name) => name.component,
            Self::Assembly(component, _) => component,
        }
    }

    /// Axis to which the error belongs: the `Y` of `EXY`.
    pub fn axis(self) -> AxisName {
        match self {
            Self::Named(name) => name.axis,
            Self::Assembly(_, axis) => axis,
        }
    }

    /// Name of the coefficient in a null combination: `EXC constant` for an error motion, whose curve has several coefficients; otherwise the name.
    pub fn coefficient(self) -> String {
        match self {
            Self::Named(name) if !name.location => format!("{name} constant"),
            _ => self.to_string(),
        }
    }
}

#[cfg(feature = "schema")]
impl serde::Serialize for ErrorTerm {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for ErrorTerm {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        String::schema_name()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        String::json_schema(generator)
    }
}

impl fmt::Display for ErrorTerm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named(name) => name.fmt(f),
            Self::Assembly(component, axis) => write!(f, "S{}{axis}", component.letter()),
        }
    }
}

/// Errors of a chain, axis by axis from the workpiece to the tool: six error motions, then the location errors that have an effect. With
/// `assembly`, the six assembly errors replace the location errors; only those in
/// `stated` remain.
pub fn terms(chain: &Chain, assembly: bool, stated: &[ErrorName]) -> Vec<ErrorTerm> {
    let mut terms = Vec::new();
    for joint in chain.joints() {
        for component in Component::ALL {
            terms.push(ErrorTerm::Named(ErrorName::motion(component, joint.name)));
        }
        for component in Component::ALL {
            let name = ErrorName::location(component, joint.name);
            let wanted = !assembly || stated.contains(&name);
            if wanted && joint.no_effect(component).is_none() {
                terms.push(ErrorTerm::Named(name));
            }
        }
        if assembly {
            let six = Component::ALL.map(|component| ErrorTerm::Assembly(component, joint.name));
            terms.extend(six);
        }
    }
    terms
}
