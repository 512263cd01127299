//! The names of ISO 230-1: `EXX`, `EC0Y`.

use core::{fmt, str::FromStr};

use volcomp_kinematics::AxisName;

/// Which of the six components of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Component {
    /// Along X, µm.
    EX,
    /// Along Y, µm.
    EY,
    /// Along Z, µm.
    EZ,
    /// About X, µrad.
    EA,
    /// About Y, µrad.
    EB,
    /// About Z, µrad.
    EC,
}

impl Component {
    /// All six, in the order of ISO 230-1.
    pub const ALL: [Self; 6] = [Self::EX, Self::EY, Self::EZ, Self::EA, Self::EB, Self::EC];

    /// 0 to 5.
    pub fn index(self) -> usize {
        self as usize
    }

    /// About an axis (µrad) instead of along it (µm).
    pub fn is_angular(self) -> bool {
        self.index() >= 3
    }

    /// 0, 1, 2 for X, Y, Z: along or about which MCS axis.
    pub fn mcs_index(self) -> usize {
        self.index() % 3
    }

    /// `um` or `urad`.
    pub fn unit(self) -> &'static str {
        if self.is_angular() { "urad" } else { "um" }
    }

    fn letter(self) -> char {
        char::from(b"XYZABC"[self.index()])
    }
}

/// The name of one error of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ErrorName {
    /// Along or about what.
    pub component: Component,
    /// Whose error.
    pub axis: AxisName,
    /// A location error `E?0N` (a number) instead of an error motion `E?N` (a curve).
    pub location: bool,
}

/// A text that is no error name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{found}` is no error name, expected E, one of X Y Z A B C, 0 for a location error, and an axis: EXX, EC0Y"
)]
pub struct UnknownError {
    /// The text.
    pub found: String,
}

impl ErrorName {
    /// The error motion of `axis`.
    pub fn motion(component: Component, axis: AxisName) -> Self {
        Self {
            component,
            axis,
            location: false,
        }
    }

    /// The location error of `axis`.
    pub fn location(component: Component, axis: AxisName) -> Self {
        Self {
            component,
            axis,
            location: true,
        }
    }
}

impl FromStr for ErrorName {
    type Err = UnknownError;

    /// Reads `EXX`, `EC0Y` and the aliases `EC(0X)Y`, `EB(0X)Z`, `EA(0Y)Z`, `C0Y`, `X0C`.
    fn from_str(text: &str) -> Result<Self, UnknownError> {
        let unknown = || UnknownError {
            found: text.to_owned(),
        };
        let plain = match text {
            "EC(0X)Y" => "EC0Y".to_owned(),
            "EB(0X)Z" => "EB0Z".to_owned(),
            "EA(0Y)Z" => "EA0Z".to_owned(),
            _ if text.len() == 3 && text.as_bytes()[1] == b'0' => format!("E{text}"),
            _ => text.to_owned(),
        };
        let letters: Vec<char> = plain.chars().collect();
        let (component, axis, location) = match letters[..] {
            ['E', component, axis] => (component, axis, false),
            ['E', component, '0', axis] => (component, axis, true),
            _ => return Err(unknown()),
        };
        let component = Component::ALL.into_iter().find(|c| c.letter() == component);
        Ok(Self {
            component: component.ok_or_else(unknown)?,
            axis: AxisName::from_letter(axis).ok_or_else(unknown)?,
            location,
        })
    }
}

impl fmt::Display for ErrorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let zero = if self.location { "0" } else { "" };
        write!(f, "E{}{zero}{}", self.component.letter(), self.axis)
    }
}
