//! The numbers that a control gives its axes.

use volcomp_vocabulary::AxisName;

/// Which axis has which number in the control, from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AxisNumbers(Vec<(AxisName, u16)>);

impl AxisNumbers {
    /// The numbers as they are stated; `None` where an axis or a number stands twice.
    pub fn stated(numbers: Vec<(AxisName, u16)>) -> Option<Self> {
        let twice = numbers.iter().enumerate().any(|(place, (name, number))| {
            let before = &numbers[..place];
            before.iter().any(|(a, b)| a == name || b == number)
        });
        (!twice).then_some(Self(numbers))
    }

    /// 1, 2, 3 … for axes in the order X Y Z A B C U V W.
    pub fn counted(axes: impl IntoIterator<Item = AxisName>) -> Self {
        let mut names: Vec<AxisName> = axes.into_iter().collect();
        names.sort_unstable_by_key(|name| name.index());
        names.dedup();
        Self(names.into_iter().zip(1..).collect())
    }

    /// The number of an axis.
    pub fn number(&self, axis: AxisName) -> Option<u16> {
        let found = self.0.iter().find(|(name, _)| *name == axis);
        found.map(|(_, number)| *number)
    }

    /// The axis of a number.
    pub fn axis(&self, number: u16) -> Option<AxisName> {
        let found = self.0.iter().find(|(_, known)| *known == number);
        found.map(|(name, _)| *name)
    }

    /// The axes with their numbers.
    pub fn iter(&self) -> impl Iterator<Item = (AxisName, u16)> {
        self.0.iter().copied()
    }
}
