//! Coordinates of a program and of the axes of the machine, mm and deg: work offsets, tool offsets, a rotation, and the
//! kinematics of the control lie between them.

use volcomp_model::{
    Machine,
    kinematics::State,
    vocabulary::{AxisName, MAX_AXES, PerAxis},
};

use crate::tip::TipFrame;

/// A value for each axis a program can name: X Y Z A B C U V W.
pub(crate) type Axes<T = f64> = [T; MAX_AXES];

/// The letters of the axes, in their order.
pub(crate) const LETTERS: [u8; MAX_AXES] = *b"XYZABCUVW";

/// The place of the axis with this letter.
#[inline]
pub(crate) fn axis_of(letter: u8) -> Option<usize> {
    match letter {
        b'X'..=b'Z' => Some(usize::from(letter - b'X')),
        b'A'..=b'C' => Some(3 + usize::from(letter - b'A')),
        b'U'..=b'W' => Some(6 + usize::from(letter - b'U')),
        _ => None,
    }
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

/// Where each axis that a program can name stands in the chain of a machine.
#[derive(Clone, Debug)]
pub(crate) struct AxisPlaces {
    places: Axes<Option<usize>>,
    /// Those of the axes that the machine has, and how many it has.
    present: Axes<Present>,
    count: usize,
}

/// An axis that a machine has.
#[derive(Clone, Copy, Debug, Default)]
struct Present {
    axis: usize,
    /// Its place in the chain.
    place: usize,
}

impl AxisPlaces {
    pub(crate) fn of(machine: &Machine) -> Self {
        let places = std::array::from_fn(|axis| machine.index_of(name_of(axis)?).ok());
        let mut present = [Present::default(); MAX_AXES];
        let of_machine = (0..MAX_AXES).filter_map(|axis| Some((axis, places[axis]?)));
        let mut count = 0;
        for (present, (axis, place)) in present.iter_mut().zip(of_machine) {
            *present = Present { axis, place };
            count += 1;
        }
        Self {
            places,
            present,
            count,
        }
    }

    fn present(&self) -> &[Present] {
        &self.present[..self.count]
    }

    /// The axes that the machine has.
    pub(crate) fn axes_of_machine(&self) -> impl Iterator<Item = usize> {
        self.present().iter().map(|present| present.axis)
    }

    /// `None` for an axis that the machine lacks.
    pub(crate) fn of_axis(&self, axis: usize) -> Option<usize> {
        self.places[axis]
    }

    /// Coordinates in mm and deg as the model takes them.
    #[inline]
    pub(crate) fn state(&self, axes: &Axes) -> State {
        let mut state = State::default();
        for &Present { axis, place } in self.present() {
            state.q[place] = if is_rotary(axis) {
                axes[axis].to_radians()
            } else {
                axes[axis]
            };
        }
        state
    }

    /// What the model gives for each axis (mm, rad) in mm and deg; zero for axes that the machine lacks.
    #[inline]
    pub(crate) fn axes(&self, of_chain: &PerAxis<f64>) -> Axes {
        let mut axes = [0.0; MAX_AXES];
        for &Present { axis, place } in self.present() {
            axes[axis] = if is_rotary(axis) {
                of_chain[place].to_degrees()
            } else {
                of_chain[place]
            };
        }
        axes
    }

    /// The same of the linear axes, times a factor.
    pub(crate) fn linear_axes(&self, of_chain: &PerAxis<f64>, factor: f64) -> Axes {
        let mut axes = [0.0; MAX_AXES];
        let linear = self
            .present()
            .iter()
            .filter(|present| !is_rotary(present.axis));
        for &Present { axis, place } in linear {
            axes[axis] = of_chain[place] * factor;
        }
        axes
    }
}

/// What lies between the coordinates of a program and those of the axes of the machine.
#[derive(Clone, Debug, Default)]
pub(crate) struct Frame {
    /// The work offset, and what is programmed on top of it.
    pub(crate) work: Axes,
    /// The work offset alone.
    pub(crate) offset: Axes,
    /// The offset of G92 or G52.
    pub(crate) shift: Axes,
    /// The tool offset of G43.
    pub(crate) tool: Axes,
    /// The rotation about Z, deg, and the place about which it turns, X and Y.
    pub(crate) rotation_deg: f64,
    pub(crate) centre: [f64; 2],
    /// Where the coordinates are those of the tool's centre point: the kinematics with which the control makes axes of them.
    pub(crate) tip: Option<TipFrame>,
}

impl Frame {
    /// A program's coordinates as those of the axes of the machine.
    #[inline]
    pub(crate) fn to_machine(&self, program: &Axes) -> Axes {
        let mut at: Axes = std::array::from_fn(|i| program[i] + self.shift[i]);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] -= centre;
        }
        at = turned(&at, self.rotation_deg);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] += centre;
        }
        let at = std::array::from_fn(|i| at[i] + self.work[i] + self.tool[i]);
        self.tip.as_ref().map_or(at, |tip| tip.to_axes(&at))
    }

    /// The frame of the work offset and the tool alone, without shifts and rotations.
    pub(crate) fn of_offset(&self) -> Self {
        Self {
            work: self.offset,
            tool: self.tool,
            tip: self.tip.clone(),
            ..Self::default()
        }
    }

    /// Coordinates of the axes of the machine as those of the program.
    #[inline]
    pub(crate) fn to_program(&self, machine: &Axes) -> Axes {
        let control = self.tip.as_ref().map(|tip| tip.of_axes(machine));
        let control = control.as_ref().unwrap_or(machine);
        let mut at: Axes = std::array::from_fn(|i| control[i] - self.work[i] - self.tool[i]);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] -= centre;
        }
        at = turned(&at, -self.rotation_deg);
        for (i, centre) in self.centre.into_iter().enumerate() {
            at[i] += centre;
        }
        std::array::from_fn(|i| at[i] - self.shift[i])
    }

    /// What the axes move by from a place of theirs, as it is in the coordinates of the program.
    #[inline]
    pub(crate) fn moved_in_program(&self, machine: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, -self.rotation_deg);
        }
        let moved = self.to_program(&std::array::from_fn(|i| machine[i] + by[i]));
        let at = self.to_program(machine);
        std::array::from_fn(|i| moved[i] - at[i])
    }

    /// The same of the axes besides X, Y and Z, whose coordinates no kinematics change; those of X, Y and Z are 0.
    pub(crate) fn others_moved_in_program(&self, machine: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            let mut moved = *by;
            moved[..3].fill(0.0);
            return moved;
        }
        std::array::from_fn(|i| {
            let in_program = |at: f64| at - self.work[i] - self.tool[i] - self.shift[i];
            if i < 3 {
                0.0
            } else {
                in_program(machine[i] + by[i]) - in_program(machine[i])
            }
        })
    }

    /// What the coordinates of the program change by from a place of theirs, as it is in the axes.
    #[inline]
    pub(crate) fn moved_in_machine(&self, program: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, self.rotation_deg);
        }
        let moved = self.to_machine(&std::array::from_fn(|i| program[i] + by[i]));
        let at = self.to_machine(program);
        std::array::from_fn(|i| moved[i] - at[i])
    }

    /// A way in the coordinates of the program as a way in those that work offsets are stated in.
    pub(crate) fn way_of_offset(&self, way: &Axes) -> Axes {
        turned(way, self.rotation_deg)
    }
}

/// X and Y turned about Z.
#[inline]
pub(crate) fn turned(at: &Axes, angle_deg: f64) -> Axes {
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
            offset: [0.0; MAX_AXES],
            work: [10.0, 20.0, 30.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            shift: [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            tool: [0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            rotation_deg: 90.0,
            centre: [5.0, 0.0],
            tip: None,
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
