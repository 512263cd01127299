//! Structural codes of ISO 10791, and the type numbers of the generalised model.

use core::{fmt, str::FromStr};

use arrayvec::ArrayVec;

use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

/// Side of the chain, as seen from the bed `b`, on which an axis is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Side {
    /// Left of `b`: the axis carries the workpiece and is written with a prime.
    Workpiece,
    /// Right of `b`: the axis carries the tool.
    Tool,
}

/// Axes of a serial chain from the workpiece to the tool, for example `w C' X' b Y Z B t`.
///
/// ```
/// use volcomp_kinematics::{Structure};
/// let gantry: Structure = "w X b Y Z t".parse()?;
/// assert_eq!(gantry.to_string(), "w X' b Y Z t");
/// # Ok::<(), volcomp_kinematics::StructureError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Structure {
    axes: ArrayVec<AxisName, MAX_AXES>,
    workpiece_axes: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StructureError {
    /// A character other than an axis letter, `w`, `b`, `t` or a prime.
    #[error(
        "found `{found}` at character {position}, expected w, b, t, an axis X Y Z A B C U V W or a prime"
    )]
    UnknownCharacter {
        found: char,
        /// Position of the character in the code, counted from 1.
        position: usize,
    },
    /// `w`, `b` or `t` is missing, repeated or out of place.
    #[error(
        "found `{found}` at character {position}, expected {}the order: w, axes with a prime, b, axes, t",
        if *position == 1 { "the structure to begin at the workpiece, w, in " } else { "" }
    )]
    OutOfPlace {
        found: char,
        /// Position of the character in the code, counted from 1.
        position: usize,
    },
    /// The code ended before `t`.
    #[error("`{missing}` is missing, expected the order: w, axes with a prime, b, axes, t")]
    Missing {
        /// The letter expected at the end of the code.
        missing: char,
    },
    /// An axis appears twice in the code.
    #[error("axis {axis} appears twice in the structure, expected each letter once")]
    RepeatedAxis {
        /// First axis that appears a second time.
        axis: AxisName,
    },
    /// A prime on an axis right of `b`.
    #[error(
        "axis {axis} has a prime right of b, expected primes on the workpiece side only: left of b"
    )]
    PrimeOnToolSide {
        /// The axis with the prime.
        axis: AxisName,
    },
    /// A prime that follows no axis.
    #[error(
        "prime at character {position} follows no axis, expected it right behind an axis letter"
    )]
    StrayPrime {
        /// Position of the prime in the code, counted from 1.
        position: usize,
    },
    /// The code contains no axis.
    #[error("the structure has no axis, expected at least one between w and t")]
    NoAxes,
    /// A type number outside its range.
    #[error("{name} = {found}, expected 0, 1, 2 or 3")]
    TypeNumber {
        /// Name of the number: `translational` or `rotary`.
        name: &'static str,
        found: u8,
    },
    /// Number or letters of the rotary axes that do not match the rotary type.
    #[error(
        "rotary = {rotary} with {found} rotary axes, expected {expected} different letters of A B C"
    )]
    RotaryAxes {
        /// The given rotary type, 0 to 3.
        rotary: u8,
        /// Number of different rotary letters found.
        found: usize,
        /// Number of rotary axes of this type.
        expected: usize,
    },
}

/// Type numbers of the generalised model with 4 three-axis and 12 five-axis types (Xiang et al., DOI
/// 10.1177/0954405414564407).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TypeNumbers {
    /// Number of the axes X, Y, Z, in this order, that carry the workpiece, 0 to 3.
    pub translational: u8,
    /// Position of the rotary axes in the chain. 0: no rotary axes; 1: both before the linear axes (table); 2: both
    /// after the linear axes (spindle); 3: one before and one after the linear axes.
    pub rotary: u8,
    /// The rotary letters in the order of the chain, from `w` to `t`.
    pub rotary_axes: ArrayVec<AxisName, 2>,
}

impl Structure {
    /// Creates a structure from the axes on the workpiece side of the bed and the axes on the tool side, each in the
    /// order from `w` to `t`.
    ///
    /// # Errors
    /// [`StructureError::NoAxes`] and [`StructureError::RepeatedAxis`].
    pub fn new(workpiece: &[AxisName], tool: &[AxisName]) -> Result<Self, StructureError> {
        let mut axes = ArrayVec::new();
        for &axis in workpiece.iter().chain(tool) {
            if axes.contains(&axis) {
                return Err(StructureError::RepeatedAxis { axis });
            }
            axes.push(axis); // nine different letters exist, so nine places are enough
        }
        if axes.is_empty() {
            return Err(StructureError::NoAxes);
        }
        Ok(Self { axes, workpiece_axes: workpiece.len() })
    }

    /// Creates a structure from its type numbers; see [`TypeNumbers`]. `rotary_axes` are in the order of the chain.
    ///
    /// # Errors
    /// A type number is above 3, or the rotary letters do not match the rotary type.
    pub fn from_type(
        translational: u8,
        rotary: u8,
        rotary_axes: &[AxisName],
    ) -> Result<Self, StructureError> {
        for (name, found) in [("translational", translational), ("rotary", rotary)] {
            if found > 3 {
                return Err(StructureError::TypeNumber { name, found });
            }
        }
        let expected = if rotary == 0 { 0 } else { 2 };
        let different = AxisName::ALL
            .into_iter()
            .filter(|a| a.kind() == AxisKind::Rotary && rotary_axes.contains(a))
            .count();
        if different != expected || rotary_axes.len() != expected {
            return Err(StructureError::RotaryAxes { rotary, found: different, expected });
        }
        let before = match rotary {
            1 => 2,
            3 => 1,
            _ => 0,
        };
        let (rotary_before, rotary_after) = rotary_axes.split_at(before);
        let linear = [AxisName::X, AxisName::Y, AxisName::Z];
        let (left, right) = linear.split_at(usize::from(translational));
        let join = |a: &[AxisName], b: &[AxisName]| -> ArrayVec<AxisName, 5> {
            a.iter().chain(b).copied().collect()
        };
        Self::new(&join(rotary_before, left), &join(right, rotary_after))
    }

    /// The type numbers of this structure; `None` if it has none of the 16 types.
    pub fn type_numbers(&self) -> Option<TypeNumbers> {
        let rotary_axes: ArrayVec<AxisName, MAX_AXES> =
            self.axes.iter().copied().filter(|a| a.kind() == AxisKind::Rotary).collect();
        let numbers = (0..=3).flat_map(|t| (0..=3).map(move |r| (t, r)));
        numbers
            .into_iter()
            .find(|&(t, r)| Self::from_type(t, r, &rotary_axes).as_ref() == Ok(self))
            .map(|(translational, rotary)| TypeNumbers {
                translational,
                rotary,
                rotary_axes: rotary_axes.iter().copied().collect(),
            })
    }

    /// The axes in chain order from the workpiece to the tool.
    pub fn axes(&self) -> &[AxisName] {
        &self.axes
    }

    /// Chain index of an axis; `None` if the chain does not contain it.
    pub fn index_of(&self, axis: AxisName) -> Option<usize> {
        self.axes.iter().position(|&a| a == axis)
    }

    /// Side of the bed of the axis at this chain index.
    pub fn side(&self, index: usize) -> Side {
        if index < self.workpiece_axes { Side::Workpiece } else { Side::Tool }
    }
}

impl fmt::Display for Structure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (workpiece, tool) = self.axes.split_at(self.workpiece_axes);
        write!(f, "w")?;
        for axis in workpiece {
            write!(f, " {axis}'")?;
        }
        write!(f, " b")?;
        for axis in tool {
            write!(f, " {axis}")?;
        }
        write!(f, " t")
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Start,
    Workpiece,
    Tool,
    End,
}

impl FromStr for Structure {
    type Err = StructureError;

    /// Parses a structural code. Blanks are ignored. Primes on the workpiece side are optional; `'`, `’` and `′` count
    /// as primes.
    fn from_str(code: &str) -> Result<Self, StructureError> {
        let mut stage = Stage::Start;
        let mut sides: [ArrayVec<AxisName, MAX_AXES>; 2] = Default::default();
        let mut last_axis = None;
        for (index, found) in code.chars().enumerate() {
            let position = index + 1;
            let behind = last_axis.take();
            let letter = AxisName::from_letter(found);
            stage = match (stage, found, letter) {
                (stage, c, _) if c.is_whitespace() => stage,
                (Stage::Start, 'w', _) => Stage::Workpiece,
                (Stage::Workpiece, 'b', _) => Stage::Tool,
                (Stage::Tool, 't', _) => Stage::End,
                (stage, '\'' | '’' | '′', _) => match (behind, stage) {
                    (Some(_), Stage::Workpiece) => stage,
                    (Some(axis), _) => return Err(StructureError::PrimeOnToolSide { axis }),
                    (None, _) => return Err(StructureError::StrayPrime { position }),
                },
                (stage @ (Stage::Workpiece | Stage::Tool), _, Some(axis)) => {
                    if sides.iter().any(|side| side.contains(&axis)) {
                        return Err(StructureError::RepeatedAxis { axis });
                    }
                    sides[usize::from(stage == Stage::Tool)].push(axis);
                    last_axis = letter;
                    stage
                }
                (Stage::Start, 'b' | 't', _) | (Stage::Start, _, Some(_)) => {
                    return Err(StructureError::Missing { missing: 'w' });
                }
                (Stage::Workpiece, 't', _) => {
                    return Err(StructureError::Missing { missing: 'b' });
                }
                (_, 'w' | 'b' | 't', _) | (_, _, Some(_)) => {
                    return Err(StructureError::OutOfPlace { found, position });
                }
                _ => return Err(StructureError::UnknownCharacter { found, position }),
            };
        }
        let missing = match stage {
            Stage::Start => 'w',
            Stage::Workpiece => 'b',
            Stage::Tool => 't',
            Stage::End => return Self::new(&sides[0], &sides[1]),
        };
        Err(StructureError::Missing { missing })
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Structure {
    /// Writes the structural code, such as `w X' b Y Z t`.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Structure {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Code;
        impl serde::de::Visitor<'_> for Code {
            type Value = Structure;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a structural code such as w X' b Y Z t")
            }

            fn visit_str<E: serde::de::Error>(self, code: &str) -> Result<Structure, E> {
                code.parse().map_err(E::custom)
            }
        }
        deserializer.deserialize_str(Code)
    }
}
