//! One value per axis, in machine order or in channel order.

use core::ops::{Deref, DerefMut};

use crate::axis::MAX_AXES;

macro_rules! in_order {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        #[repr(transparent)]
        pub struct $name<T>(pub [T; MAX_AXES]);

        impl<T> $name<T> {
            /// Creates the array from a function of the index, 0 to [`MAX_AXES`] − 1.
            #[inline]
            pub fn from_fn(value: impl FnMut(usize) -> T) -> Self {
                Self(core::array::from_fn(value))
            }

            /// Iterates over all values in order.
            #[inline]
            pub fn iter(&self) -> core::slice::Iter<'_, T> {
                self.0.iter()
            }

            /// Iterates mutably over all values in order.
            #[inline]
            pub fn iter_mut(&mut self) -> core::slice::IterMut<'_, T> {
                self.0.iter_mut()
            }

            /// These values, followed by default values. A call with more than [`MAX_AXES`] values does not compile.
            #[inline]
            pub fn leading<const N: usize>(values: [T; N]) -> Self
            where
                T: Default,
            {
                const { assert!(N <= MAX_AXES, "more values than a machine has axes") };
                let mut values = values.into_iter();
                Self::from_fn(|_| values.next().unwrap_or_default())
            }

            /// Applies a function to each value.
            #[inline]
            pub fn map<U>(self, value: impl FnMut(T) -> U) -> $name<U> {
                $name(self.0.map(value))
            }
        }

        impl $name<f64> {
            /// Zero at every index.
            pub const ZERO: Self = Self([0.0; MAX_AXES]);
        }

        impl<T> Deref for $name<T> {
            type Target = [T; MAX_AXES];
            #[inline]
            fn deref(&self) -> &Self::Target {
                &self.0
            }
        }

        impl<T> DerefMut for $name<T> {
            #[inline]
            fn deref_mut(&mut self) -> &mut Self::Target {
                &mut self.0
            }
        }

        impl<T> From<[T; MAX_AXES]> for $name<T> {
            #[inline]
            fn from(values: [T; MAX_AXES]) -> Self {
                Self(values)
            }
        }

        impl<T> IntoIterator for $name<T> {
            type Item = T;
            type IntoIter = core::array::IntoIter<T, MAX_AXES>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.into_iter()
            }
        }

        impl<'a, T> IntoIterator for &'a $name<T> {
            type Item = &'a T;
            type IntoIter = core::slice::Iter<'a, T>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.iter()
            }
        }

        impl<'a, T> IntoIterator for &'a mut $name<T> {
            type Item = &'a mut T;
            type IntoIter = core::slice::IterMut<'a, T>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.iter_mut()
            }
        }
    };
}

in_order! {
    /// One value for each axis of a machine, in *machine order*: the order of the kinematic chain from the workpiece to
    /// the tool. Coordinates and corrections are in mm for linear and in rad for rotary axes. Entries beyond the last
    /// axis hold the default value.
    PerAxis
}

in_order! {
    /// One value for each axis that a controller writes, in *channel order*: the order of the axes in the controller's
    /// description. Positions and corrections are in mm for linear and in rad for rotary axes. Entries beyond the last
    /// axis hold the default value. The type differs from [`PerAxis`], so that the two orders cannot be confused.
    PerChannel
}
