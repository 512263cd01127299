//! The words that lead the axes to a place with its correction, and what of the correction they carry.

use crate::{
    coordinates::Axes,
    number::{half_step, of_steps, steps, write_steps},
};

/// How coordinates are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decimals {
    /// Decimals of lengths in mm.
    pub mm: u8,
    /// Decimals of lengths in inch.
    pub inch: u8,
    /// Decimals of angles in deg.
    pub deg: u8,
}

impl Default for Decimals {
    /// What most controls take: 1 µm, 0.0001 inch and 0.001 deg.
    fn default() -> Self {
        Self {
            mm: 3,
            inch: 4,
            deg: 3,
        }
    }
}

impl Decimals {
    #[inline]
    pub(crate) fn of(self, axis: usize, unit_mm: f64) -> u8 {
        match axis {
            3..6 => self.deg,
            _ if unit_mm == 1.0 => self.mm,
            _ => self.inch,
        }
    }
}

/// A word as it stands in the program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Written {
    /// The decimals of a plain number.
    pub(crate) decimals: u8,
    /// It must be written anew even where nothing changes: the motion is split.
    pub(crate) anew: bool,
}

/// A number as it is written: so many steps of the last decimal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Number {
    steps: i64,
    decimals: u8,
    form: Form,
}

/// How a number is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// With a point where it has decimals.
    Plain,
    /// With a point in any case.
    Point,
    /// As the number of its steps, which are least increments.
    Increments,
}

impl Number {
    /// The nearest number with so many decimals; `None` where it is too large to be exact.
    #[inline]
    pub(crate) fn nearest(value: f64, decimals: u8) -> Option<Self> {
        Some(Self {
            steps: steps(value, decimals)?,
            decimals,
            form: Form::Plain,
        })
    }

    /// The nearest number with so many decimals at the most, without zeros at its end.
    pub(crate) fn shortest(value: f64, most: u8) -> Option<Self> {
        Self::shortest_of(value, 0, most)
    }

    /// The same with so many decimals at least.
    pub(crate) fn shortest_of(value: f64, least: u8, most: u8) -> Option<Self> {
        let mut number = Self::nearest(value, most)?;
        while number.decimals > least && number.steps % 10 == 0 {
            number.steps /= 10;
            number.decimals -= 1;
        }
        Some(number)
    }

    /// The same number in another form.
    pub(crate) fn form(self, form: Form) -> Self {
        Self { form, ..self }
    }

    /// The same place of an axis that turns, from 0 to less than 360.
    pub(crate) fn in_one_turn(self) -> Option<Self> {
        let turn = steps(360.0, self.decimals)?;
        Some(Self {
            steps: self.steps.rem_euclid(turn),
            ..self
        })
    }

    pub(crate) fn is_negative(self) -> bool {
        self.steps < 0
    }

    pub(crate) fn value(self) -> f64 {
        of_steps(self.steps, self.decimals)
    }

    pub(crate) fn write(self, to: &mut Vec<u8>) {
        let decimals = match self.form {
            Form::Increments => 0,
            Form::Plain | Form::Point => self.decimals,
        };
        write_steps(to, self.steps, decimals);
        if self.form == Form::Point && decimals == 0 {
            to.push(b'.');
        }
    }
}

/// How the coordinates of a word are written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numerals {
    pub(crate) decimals: u8,
    pub(crate) form: Form,
}

impl Numerals {
    /// The nearest number, with so many decimals at least; `None` where it is too large to be exact.
    #[inline]
    pub(crate) fn nearest(self, value: f64, least: u8) -> Option<Number> {
        Some(Number::nearest(value, self.decimals.max(least))?.form(self.form))
    }
}

/// One axis on its way: all in the coordinates of the program, mm or deg.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnItsWay {
    /// Where it is without a correction, before and after.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// The correction that belongs to the end.
    pub(crate) delta: f64,
    /// The correction that is in it before.
    pub(crate) carried: f64,
    /// mm or deg for each unit of a word.
    pub(crate) scale: f64,
    pub(crate) numerals: Numerals,
    pub(crate) incremental: bool,
    /// Its word is a place within one turn.
    pub(crate) in_one_turn: bool,
    pub(crate) written: Option<Written>,
    /// A word may be added for it.
    pub(crate) may_be_added: bool,
}

impl OnItsWay {
    /// The number to be written, if any, and the correction that is in the axis then.
    #[inline]
    pub(crate) fn word(&self) -> (Option<Number>, f64) {
        let nominal = if self.incremental {
            self.to - self.from
        } else {
            self.to
        };
        let base = if self.incremental {
            self.from + self.carried
        } else {
            0.0
        };
        let wanted = self.to + self.delta - base;
        let half = half_step(self.numerals.decimals);
        let carried_by = |value: f64| base + value * self.scale - self.to;
        let Some(written) = self.written else {
            // The axis stays where it is, with what is in it.
            let needed = (self.to + self.delta) - (self.from + self.carried);
            if !self.may_be_added || (needed / self.scale).abs() < half {
                return (None, self.carried + self.from - self.to);
            }
            let number = self.numerals.nearest(wanted / self.scale, 0);
            let carried = number.map_or(self.carried, |number| carried_by(number.value()));
            return (number, carried);
        };
        let changes = ((wanted - nominal) / self.scale).abs() >= half;
        if !changes && !written.anew {
            let kept = if self.incremental { self.carried } else { 0.0 };
            return (None, kept);
        }
        let number = (self.numerals).nearest(wanted / self.scale, written.decimals);
        let carried = number.map_or(self.carried, |number| carried_by(number.value()));
        let number = match number {
            Some(number) if self.in_one_turn => number.in_one_turn(),
            _ => number,
        };
        (number, carried)
    }
}

/// The place at a share of a straight way.
pub(crate) fn between(from: &Axes, to: &Axes, share: f64) -> Axes {
    each(|axis| from[axis] + share * (to[axis] - from[axis]))
}

/// A value for each axis, made one by one.
pub(crate) fn each<T>(value: impl FnMut(usize) -> T) -> Axes<T> {
    std::array::from_fn(value)
}
