//! Coordinates of a program and of the machine, mm and deg: work offsets, tool offsets and a rotation lie between them.

use volcomp_model::vocabulary::{AxisName, MAX_AXES};

/// A value for each axis a program can name: X Y Z A B C U V W.
pub(crate) type Axes<T = f64> = [T; MAX_AXES];

/// The letters of the axes, in their order.
pub(crate) const LETTERS: [u8; MAX_AXES] = *b"XYZABCUVW";

/// The place of the axis with this letter.
pub(crate) fn axis_of(letter: u8) -> Option<usize> {
    LETTERS.iter().position(|axis| *axis == letter)
}

/// The axis at a place.
pub(crate) fn name_of(axis: usize) -> Option<AxisName> {
    let letter = LETTERS.get(axis)?;
    AxisName::from_letter(char::from(*letter))
}

/// Whether the axis at a place turns: its coordinates are deg, whatever the unit of length is.
pub(crate) fn is_rotary(axis: usize) -> bool {
    (3..6).contains(&axis)
}

/// What lies between the coordinates of a program and those of the machine.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Frame {
    /// The work offset.
    pub(crate) work: Axes,
    /// The offset of G92 or G52.
    pub(crate) shift: Axes,
    /// The tool offset of G43.
    pub(crate) tool: Axes,
    /// The rotation about Z, deg, and the place about which it turns, X and Y.
    pub(crate) rotation_deg: f64,
    pub(crate) centre: [f64; 2],
}

impl Frame {
    /// A program's coordinates in those of the machine.
    pub(crate) fn to_machine(&self, program: &Axes) -> Axes {
        let mut at: Axes = std::array::from_fn(|i| program[i] + self.shift[i]);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] -= centre;
        }
        at = turned(&at, self.rotation_deg);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] += centre;
        }
        std::array::from_fn(|i| at[i] + self.work[i] + self.tool[i])
    }

    /// Coordinates of the machine in those of the program.
    pub(crate) fn to_program(&self, machine: &Axes) -> Axes {
        let mut at: Axes = std::array::from_fn(|i| machine[i] - self.work[i] - self.tool[i]);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] -= centre;
        }
        at = turned(&at, -self.rotation_deg);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] += centre;
        }
        std::array::from_fn(|i| at[i] - self.shift[i])
    }

    /// A way in the machine as a way in the program.
    pub(crate) fn way_to_program(&self, way: &Axes) -> Axes {
        turned(way, -self.rotation_deg)
    }

    /// A way in the program as a way in the machine.
    pub(crate) fn way_to_machine(&self, way: &Axes) -> Axes {
        turned(way, self.rotation_deg)
    }
}

/// X and Y turned about Z.
fn turned(at: &Axes, angle_deg: f64) -> Axes {
    if angle_deg == 0.0 {
        return *at;
    }
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let mut turned = *at;
    turned[0] = cos * at[0] - sin * at[1];
    turned[1] = sin * at[0] + cos * at[1];
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back() {
        let frame = Frame {
            work: [10.0, 20.0, 30.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            shift: [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            tool: [0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            rotation_deg: 90.0,
            centre: [5.0, 0.0],
        };
        let at = [1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let machine = frame.to_machine(&at);
        // (1 + 1 - 5, 2 + 2) = (-3, 4) turns to (-4, -3); the centre and the offset put it to (11, 17).
        assert!((machine[0] - 11.0).abs() < 1e-12 && (machine[1] - 17.0).abs() < 1e-12);
        assert_eq!(machine[2..4], [136.0, 5.0]);
        let back = frame.to_program(&machine);
        assert!((0..9).all(|i| (back[i] - at[i]).abs() < 1e-12));
    }
}
