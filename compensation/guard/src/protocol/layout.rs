//! Which axes the words of frames and reports belong to, in their order.

use volcomp_vocabulary::{AxisName, MAX_AXES};

/// Why axes make no layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// There is no axis.
    #[error("number of axes: found 0, expected 1 to {MAX_AXES}")]
    NoAxes,
    /// An axis that is named more than once.
    #[error("axis {axis}: found twice, expected once")]
    Twice {
        /// The axis that was found again.
        axis: AxisName,
    },
}

/// The corrected axes in the order of its words. Its number starts the checksum together with the machine's, so that
/// frames and reports for other axes, or for the same axes in another order, do not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Layout {
    count: u8,
    number: u32,
}

impl Layout {
    /// The layout of these axes in this order.
    ///
    /// # Errors
    /// No axis, or one that is named twice.
    pub fn of(axes: impl IntoIterator<Item = AxisName>) -> Result<Self, LayoutError> {
        let mut layout = Self {
            count: 0,
            number: 0,
        };
        let mut seen = [false; MAX_AXES];
        for axis in axes {
            if core::mem::replace(&mut seen[axis.index()], true) {
                return Err(LayoutError::Twice { axis });
            }
            layout.count += 1;
            layout.number = 10 * layout.number + digit(axis);
        }
        if layout.count == 0 {
            return Err(LayoutError::NoAxes);
        }
        Ok(layout)
    }

    /// How many axes there are, 1 to [`MAX_AXES`].
    #[must_use]
    pub fn count(self) -> usize {
        self.count.into()
    }

    /// One decimal digit for each axis, in their order: X 1, Y 2, Z 3, A 4, B 5, C 6, U 7, V 8, W 9. The number of
    /// X Y Z is 123, that of X Y Z A C is 12346.
    #[must_use]
    pub fn number(self) -> u32 {
        self.number
    }
}

fn digit(name: AxisName) -> u32 {
    match name {
        AxisName::X => 1,
        AxisName::Y => 2,
        AxisName::Z => 3,
        AxisName::A => 4,
        AxisName::B => 5,
        AxisName::C => 6,
        AxisName::U => 7,
        AxisName::V => 8,
        AxisName::W => 9,
    }
}
