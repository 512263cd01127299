//! Positions of machine axes from Python: a dict axis → coordinates, or an array with the names of its columns.

use std::{
    iter::repeat_n,
    num::NonZero,
    panic::resume_unwind,
    sync::{Mutex, PoisonError},
    thread::{self, ScopedJoinHandle, available_parallelism},
};

use numpy::{
    PyArray1, PyReadonlyArray1, PyUntypedArrayMethods,
    ndarray::{ArrayView1, s},
};
use pyo3::{exceptions::PyTypeError, prelude::*, types::PyDict};
use volcomp_model::{
    Machine, Temperatures, axis_of_head,
    kinematics::State,
    vocabulary::{AxisKind, AxisName, Direction, PerAxis, bounds::PLAUSIBLE_DEGC},
};

use crate::{
    arrays::{column, float_array, readonly, shown},
    failure::Failure,
};

/// Number of positions that one thread evaluates at a time.
pub(crate) const PIECE: usize = 4096;

/// Largest coordinate, mm or deg, as in [`Machine::state`].
const MAX_COORDINATE: f64 = 1e9;

/// Coordinates of one axis as they were passed.
enum Given<'py> {
    Number(f64),
    Column(PyReadonlyArray1<'py, f64>),
}

/// The argument `positions`, checked for names and shapes.
pub(crate) struct PositionArguments<'py> {
    columns: Vec<(usize, AxisName, Given<'py>)>,
    count: usize,
}

impl<'py> PositionArguments<'py> {
    /// `positions` is a mapping from axis names to coordinates, or an array of shape (n, number of axes) whose columns
    /// `axes` names.
    pub(crate) fn new(
        machine: &Machine,
        positions: &Bound<'py, PyAny>,
        axes: Option<&Bound<'py, PyAny>>,
    ) -> Result<Self, Failure> {
        let mut found = Self { columns: Vec::new(), count: 1 };
        match (positions.hasattr("keys")?, axes) {
            (true, None) => found.mapping(machine, positions)?,
            (false, Some(axes)) => found.array(machine, positions, axes)?,
            (true, Some(_)) => {
                let message = "axes: found it together with a mapping, expected it with an array only: the keys of a mapping name the axes";
                return Err(Failure::argument(message));
            }
            (false, None) => {
                let letters: String =
                    machine.axes().iter().map(|axis| axis.name.letter()).collect();
                let message = format!(
                    "positions: found {} without axes, expected a dict axis -> array (mm, deg), or an array with axes=\"{letters}\": which column is which axis is never assumed",
                    positions.get_type().name()?
                );
                return Err(PyTypeError::new_err(message).into());
            }
        }
        Ok(found)
    }

    fn mapping(&mut self, machine: &Machine, positions: &Bound<'py, PyAny>) -> Result<(), Failure> {
        let mut length: Option<(AxisName, usize)> = None;
        for key in positions.call_method0("keys")?.try_iter()? {
            let key = key?;
            let axis = named(&key, "positions")?;
            let argument = format!("positions[{}]", key.repr()?);
            let value = float_array(&positions.get_item(&key)?, &argument)?;
            let given = if value.ndim() == 0 {
                Given::Number(value.call_method0("item")?.extract()?)
            } else {
                let values = column(&value, &format!("{argument} (or a number)"))?;
                let found = values.len();
                match length {
                    Some((first, expected)) if expected != found => {
                        return Err(Failure::argument(format_args!(
                            "{argument}: found shape ({found},), expected ({expected},) as for axis {first}, or a number"
                        )));
                    }
                    _ => length = Some((axis, found)),
                }
                Given::Column(values)
            };
            self.add(machine, axis, given)?;
        }
        if self.columns.is_empty() {
            let message = "positions: found no axis, expected coordinates of at least one";
            return Err(Failure::argument(message));
        }
        self.count = length.map_or(1, |(_, length)| length);
        Ok(())
    }

    fn array(
        &mut self,
        machine: &Machine,
        positions: &Bound<'py, PyAny>,
        axes: &Bound<'py, PyAny>,
    ) -> Result<(), Failure> {
        let array = float_array(positions, "positions")?;
        let names = axis_names(axes, "axes")?;
        let shape = array.shape();
        if names.is_empty() || shape.len() != 2 || shape[1] != names.len() {
            return Err(Failure::argument(format_args!(
                "positions: found shape {}, expected (n, {}): one column for each name in axes",
                shown(shape),
                names.len().max(1)
            )));
        }
        self.count = shape[0];
        let columns = array.getattr("T")?;
        for (index, axis) in names.into_iter().enumerate() {
            let column = columns.get_item(index)?.cast_into::<PyArray1<f64>>();
            let column = column.map_err(|error| Failure::Raised(error.into()))?;
            let values = Given::Column(readonly(&column, "positions")?);
            self.add(machine, axis, values)?;
        }
        Ok(())
    }

    fn add(&mut self, machine: &Machine, axis: AxisName, given: Given<'py>) -> Result<(), Failure> {
        let index = machine.index_of(axis)?;
        if self.columns.iter().any(|(_, known, _)| *known == axis) {
            return Err(Failure::argument(format_args!(
                "positions: found axis {axis} twice, expected each axis once"
            )));
        }
        self.columns.push((index, axis, given));
        Ok(())
    }

    /// A view of the positions that can be read without the interpreter.
    pub(crate) fn view(
        &self,
        machine: &Machine,
        approach: PerAxis<Option<Direction>>,
    ) -> Positions<'_> {
        let columns = self.columns.iter().map(|(index, axis, given)| {
            let column = match given {
                Given::Column(values) => Column::Values(values.as_array()),
                Given::Number(number) => Column::Number(*number),
            };
            (*index, *axis, column)
        });
        Positions {
            columns: columns.collect(),
            count: self.count,
            stride: machine.axes().len(),
            approach,
        }
    }
}

/// Parses axes from a text such as `"XYZ"` or a list of names.
pub(crate) fn axis_names(
    value: &Bound<'_, PyAny>,
    argument: &str,
) -> Result<Vec<AxisName>, Failure> {
    let Ok(names) = value.try_iter() else {
        let found = value.get_type().name()?;
        let message = format!("{argument}: found {found}, expected the names of axes: \"XYZ\"");
        return Err(PyTypeError::new_err(message).into());
    };
    names.map(|name| named(&name?, argument)).collect()
}

/// The axis of a key such as `"X"`, `"X_mm"` or `"C_deg"`.
pub(crate) fn named(key: &Bound<'_, PyAny>, argument: &str) -> Result<AxisName, Failure> {
    let text = key.extract::<String>().ok();
    text.as_deref().and_then(axis_of_head).ok_or_else(|| {
        let found = key.repr().map_or_else(|_| String::new(), |found| found.to_string());
        Failure::argument(format_args!(
            "{argument}: found {found}, expected the letter of an axis, alone or with its unit: \"X\", \"X_mm\", \"C_deg\""
        ))
    })
}

/// Coordinates of one axis, mm or deg.
pub(crate) enum Column<'a> {
    Number(f64),
    Values(ArrayView1<'a, f64>),
    /// Nodes of a grid. Each node is repeated for `repeated` consecutive positions. After the last node the sequence
    /// starts again.
    Nodes {
        nodes: &'a [f64],
        repeated: usize,
    },
}

/// Positions by axis; axes that are not named are at 0.
pub(crate) struct Positions<'a> {
    /// Index in the chain, name, coordinates.
    pub(crate) columns: Vec<(usize, AxisName, Column<'a>)>,
    pub(crate) count: usize,
    /// Number of axes of the machine.
    pub(crate) stride: usize,
    pub(crate) approach: PerAxis<Option<Direction>>,
}

/// Consecutive positions in chain order, mm and rad, position after position.
pub(crate) struct Piece {
    pub(crate) poses: Vec<f64>,
    pub(crate) count: usize,
    stride: usize,
    approach: PerAxis<Option<Direction>>,
    /// Smallest and largest coordinate of each axis, mm and rad.
    ends: [PerAxis<f64>; 2],
}

impl Positions<'_> {
    /// Index of the first position of each piece.
    pub(crate) fn starts(&self) -> impl Iterator<Item = usize> + use<> {
        (0..self.count).step_by(PIECE)
    }

    /// Piece that begins with the position of this index.
    pub(crate) fn piece(&self, start: usize) -> Result<Piece, Failure> {
        let count = self.count.saturating_sub(start).min(PIECE);
        let mut piece = Piece {
            poses: vec![0.0; count * self.stride],
            count,
            stride: self.stride,
            approach: self.approach,
            ends: [PerAxis::ZERO; 2],
        };
        for (index, axis, column) in &self.columns {
            let is_valid = match column {
                Column::Number(number) => piece.fill(*index, *axis, repeat_n(*number, count)),
                Column::Values(values) => {
                    let values = values.slice(s![start..start + count]);
                    // Contiguous memory is read faster than an array with strides.
                    match values.as_slice() {
                        Some(values) => piece.fill(*index, *axis, values.iter().copied()),
                        None => piece.fill(*index, *axis, values.iter().copied()),
                    }
                }
                Column::Nodes { nodes, repeated } => {
                    let node = |place: usize| nodes[place / repeated % nodes.len()];
                    piece.fill(*index, *axis, (start..start + count).map(node))
                }
            };
            if !is_valid {
                return Err(wrong(*axis, column, start));
            }
        }
        Ok(piece)
    }
}

impl Piece {
    /// Sets the coordinates of one axis, given in mm or deg; false if a coordinate is not finite or exceeds [`MAX_COORDINATE`].
    fn fill(
        &mut self,
        index: usize,
        axis: AxisName,
        coordinates: impl Iterator<Item = f64>,
    ) -> bool {
        let factor = match axis.kind() {
            AxisKind::Linear => 1.0,
            AxisKind::Rotary => 1_f64.to_radians(),
        };
        let (mut low, mut high, mut is_valid) = (f64::INFINITY, f64::NEG_INFINITY, true);
        for (pose, coordinate) in self.poses.chunks_exact_mut(self.stride).zip(coordinates) {
            // The comparison is also false for NaN.
            is_valid &= coordinate.abs() <= MAX_COORDINATE;
            let value = coordinate * factor;
            low = if value < low { value } else { low };
            high = if value > high { value } else { high };
            pose[index] = value;
        }
        self.ends[0][index] = low;
        self.ends[1][index] = high;
        is_valid
    }

    pub(crate) fn states(&self) -> impl Iterator<Item = State> {
        self.poses.chunks_exact(self.stride).map(|pose| self.state(pose))
    }

    /// The smallest and the largest coordinate of every axis, each as a state.
    pub(crate) fn ends(&self) -> [State; 2] {
        self.ends.map(|end| self.state(&end[..self.stride]))
    }

    fn state(&self, pose: &[f64]) -> State {
        let mut state = State { approach: self.approach, ..State::default() };
        state.q[..self.stride].copy_from_slice(pose);
        state
    }
}

fn wrong(axis: AxisName, column: &Column<'_>, start: usize) -> Failure {
    let unit = axis.kind().coordinate_unit();
    let is_wrong = |value: f64| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(&value);
    let (place, found) = match column {
        Column::Number(number) => (String::new(), *number),
        Column::Values(values) => {
            let mut values = values.iter().copied().enumerate().skip(start);
            let wrong = values.find(|(_, value)| is_wrong(*value));
            wrong.map_or((String::new(), f64::NAN), |(index, value)| (format!("[{index}]"), value))
        }
        Column::Nodes { .. } => (String::new(), f64::NAN),
    };
    Failure::argument(format_args!(
        "positions: axis {axis}{place}: found {found}, expected a finite number from -1e9 to 1e9 {unit}"
    ))
}
/// Direction of the last motion of each axis, from a mapping axis → `"+"` or `"-"`.
pub(crate) fn approach(
    machine: &Machine,
    given: Option<&Bound<'_, PyDict>>,
) -> Result<PerAxis<Option<Direction>>, Failure> {
    let mut approach = PerAxis::default();
    for (key, sign) in given.into_iter().flatten() {
        let axis = named(&key, "approach")?;
        let text = sign.extract::<String>().ok();
        let direction = match text.as_deref() {
            Some("+") => Direction::Positive,
            Some("-") => Direction::Negative,
            _ => {
                return Err(Failure::argument(format_args!(
                    "approach[{}]: found {}, expected \"+\" or \"-\"",
                    key.repr()?,
                    sign.repr()?
                )));
            }
        };
        approach[machine.index_of(axis)?] = Some(direction);
    }
    Ok(approach)
}

/// Steady temperatures of sensors, from a mapping name → °C.
pub(crate) fn temperatures(
    machine: &Machine,
    given: Option<Temperatures>,
) -> Result<Temperatures, Failure> {
    let given = given.unwrap_or_default();
    let sensors = machine.thermal().sensors();
    for (name, degc) in &given {
        if !sensors.contains(&name.as_str()) {
            let expected = match sensors.len() {
                0 => "none: the machine file has no thermal terms".to_owned(),
                _ => format!("one of: {}", sensors.join(", ")),
            };
            return Err(Failure::argument(format_args!(
                "temperatures_degc: found sensor {name:?}, expected {expected}"
            )));
        }
        if !PLAUSIBLE_DEGC.contains(degc) {
            return Err(Failure::argument(format_args!(
                "temperatures_degc[{name:?}]: found {degc}, expected {} to {} °C",
                PLAUSIBLE_DEGC.start(),
                PLAUSIBLE_DEGC.end()
            )));
        }
    }
    Ok(given)
}

/// Runs `work` on every item, on as many threads as there are processors, and returns the results in the order of the items.
///
/// The threads end with the call: a process that Python forks later would wait for ever for the threads of a pool.
pub(crate) fn in_parallel<T: Send, R: Send>(
    items: Vec<T>,
    work: impl Fn(T) -> Result<R, Failure> + Sync,
) -> Result<Vec<R>, Failure> {
    let processors = available_parallelism().map_or(1, NonZero::get);
    let threads = processors.min(items.len());
    if threads <= 1 {
        return items.into_iter().map(work).collect();
    }
    let queue = Mutex::new(items.into_iter().enumerate());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let one_thread = || {
        let mut done = Vec::new();
        while let Some((place, item)) = next() {
            done.push((place, work(item)));
        }
        done
    };
    let mut done = thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(one_thread)).collect();
        let joined = threads.into_iter().map(ScopedJoinHandle::join);
        joined
            .flat_map(|done| done.unwrap_or_else(|panic| resume_unwind(panic)))
            .collect::<Vec<_>>()
    });
    done.sort_unstable_by_key(|(place, _)| *place);
    done.into_iter().map(|(_, result)| result).collect()
}
