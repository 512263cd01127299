//! The class `Machine`: volumetric error and correction of many positions.

use std::{io::Write as _, path::PathBuf};

use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::{
    exceptions::PyTypeError,
    prelude::*,
    types::{PyDict, PyList},
};
use volcomp_model::{
    MapGrid, Temperatures, Tolerance,
    kinematics::{Correction, CorrectionOptions, Form, correct, volumetric_error},
    vocabulary::{AxisKind, AxisName, Displacement},
};

use crate::{
    arrays::{shaped, zeros},
    failure::Failure,
    flags::Ranges,
    output::write_file,
    positions::{
        Column, PIECE, Piece, PositionArguments, Positions, approach, axis_names, in_parallel,
        named, temperatures,
    },
};

/// A machine tool with its measured errors.
///
/// Positions are a dict axis -> array of shape (n,) or number, such as {"X": x_mm, "C": c_deg}, or an array of shape
/// (n, number of names) with axes="XYZ". Linear axes are in mm, rotary axes in deg; axes that are not named are at 0. Positions outside travel or
/// outside the range of a curve are computed with the value at its end, and flagged.
#[pyclass(frozen, module = "volcomp")]
#[derive(Debug)]
pub(crate) struct Machine {
    pub(crate) machine: volcomp_model::Machine,
}

/// Largest number of nodes of a map. The errors of one node take 48 bytes.
const MOST_NODES: usize = 100_000_000;

/// A form of the model: exact, htm, twist or compiled.
#[derive(Clone, Copy)]
enum Model {
    Form(Form),
    Compiled,
}

impl Model {
    fn named(name: &str) -> Result<Self, Failure> {
        if name == "compiled" {
            return Ok(Self::Compiled);
        }
        name.parse().map(Self::Form).map_err(|_| {
            Failure::argument(format_args!(
                "model: found {name:?}, expected \"exact\", \"htm\", \"twist\" or \"compiled\""
            ))
        })
    }
}

/// Output arrays for the errors of many positions: three numbers per position, µm and µrad.
struct Targets<'a> {
    position_um: &'a mut [f64],
    rotation_urad: &'a mut [f64],
}

#[pymethods]
impl Machine {
    /// Read a machine file (TOML).
    ///
    /// path: str or path. tool: a tool of the table [tools], else that of [tool].
    /// Raises OSError if the file cannot be read, InputError (with file, line, key) if it is invalid.
    #[staticmethod]
    #[pyo3(signature = (path, tool=None))]
    fn load(py: Python<'_>, path: PathBuf, tool: Option<&str>) -> PyResult<Self> {
        py.detach(|| {
            let mut machine = volcomp_model::Machine::read(&path)?;
            if let Some(tool) = tool {
                machine.select_tool(tool)?;
            }
            Ok::<_, Failure>(Self { machine })
        })
        .map_err(PyErr::from)
    }

    /// Write the machine file (TOML); it appears by rename.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| {
            write_file(&path, |file| {
                let written = file.write_all(self.machine.to_toml().as_bytes());
                written.map_err(|error| Failure::system(&path, error))
            })
        })
        .map_err(PyErr::from)
    }

    /// The machine file as text.
    fn to_toml(&self) -> String {
        self.machine.to_toml()
    }

    /// Name of the machine.
    #[getter]
    fn name(&self) -> &str {
        &self.machine.name
    }

    /// Axes between workpiece (w), bed (b) and tool (t), such as "w C' X' b Y Z t".
    #[getter]
    fn structure(&self) -> String {
        self.machine.chain().structure().to_string()
    }

    /// Travel of each axis: dict axis -> (low, high), mm or deg, in the order of the chain.
    #[getter]
    fn travels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let travels = PyDict::new(py);
        for axis in self.machine.axes() {
            let [low, high] = axis.travel;
            travels.set_item(axis.name.to_string(), (low, high))?;
        }
        Ok(travels)
    }

    /// Names of the errors that the machine file states, such as EXX and EC0Y, sorted.
    #[getter]
    fn errors(&self) -> Vec<String> {
        let motions = self.machine.errors().map(|(name, _)| name.to_string());
        let locations = self.machine.locations().keys().map(ToString::to_string);
        let mut names: Vec<String> = motions.chain(locations).collect();
        names.sort_unstable();
        names
    }

    /// Names of the temperature sensors of the thermal terms. Terms whose sensor has no temperature in a call are left out.
    #[getter]
    fn sensors(&self) -> Vec<&str> {
        self.machine.thermal().sensors()
    }

    /// Notes on the machine file: what its errors do not cover.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.machine.notes()
    }

    fn __repr__(&self) -> String {
        format!("<Machine {:?}: {}>", self.machine.name, self.structure())
    }

    /// Volumetric error at n positions: actual minus ideal, in workpiece axes.
    ///
    /// positions, axes: see Machine. approach: dict axis -> "+" or "-", the direction of the last motion, for curves with reversal; without it the
    /// mean of both. temperatures_degc: dict sensor -> degC, steady. model: "exact" (rigid transforms), "htm" (small-angle matrices), "twist" (first
    /// order) or "compiled" (first order, curves within 1 nm; 5 to 30 times faster).
    ///
    /// Returns a dict: position_um (n, 3) along X, Y, Z; rotation_urad (n, 3) about them; outside_range, dict error -> (n,) bool of curves evaluated
    /// outside their range; outside_travel, dict axis -> (n,) bool.
    #[pyo3(signature = (positions, axes=None, *, approach=None, temperatures_degc=None, model="exact"))]
    fn error<'py>(
        &self,
        py: Python<'py>,
        positions: &Bound<'py, PyAny>,
        axes: Option<&Bound<'py, PyAny>>,
        approach: Option<&Bound<'py, PyDict>>,
        temperatures_degc: Option<Temperatures>,
        model: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let model = Model::named(model)?;
        let temperatures = temperatures(&self.machine, temperatures_degc)?;
        let arguments = PositionArguments::new(&self.machine, positions, axes)?;
        let approach = self::approach(&self.machine, approach)?;
        let positions = arguments.view(&self.machine, approach);
        let shape = [positions.count, 3];
        self.errors_at(py, &positions, &temperatures, model, &shape)
    }

    /// Correction of n commands, to be added to them.
    ///
    /// positions, axes, approach, temperatures_degc: see error. correct: axes that may move, such as "XYZ"; default: `correct` in the machine file,
    /// else one linear axis of each direction and all rotary axes.
    ///
    /// Returns a dict: correction, dict axis -> (n,) in um of linear and urad of rotary axes; corrected, dict axis -> (n,) command plus
    /// correction, mm and deg; residual_um (n, 3) of the tip and residual_axis_urad (n, 3) of the tool axis that remain, in workpiece axes;
    /// iterations (n,); converged, singular, near_singular (n,) bool; outside_range and outside_travel as in error.
    #[pyo3(signature = (positions, axes=None, *, correct=None, approach=None, temperatures_degc=None))]
    fn correct<'py>(
        &self,
        py: Python<'py>,
        positions: &Bound<'py, PyAny>,
        axes: Option<&Bound<'py, PyAny>>,
        correct: Option<&Bound<'py, PyAny>>,
        approach: Option<&Bound<'py, PyDict>>,
        temperatures_degc: Option<Temperatures>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = self.options(correct)?;
        let temperatures = temperatures(&self.machine, temperatures_degc)?;
        let arguments = PositionArguments::new(&self.machine, positions, axes)?;
        let approach = self::approach(&self.machine, approach)?;
        let positions = arguments.view(&self.machine, approach);
        let ranges = Ranges::new(&self.machine);
        let pieces = py.detach(|| {
            let (chain, source) = (self.machine.chain(), self.machine.source(&temperatures));
            in_parallel(positions.starts().collect(), |start| {
                let piece = positions.piece(start)?;
                let one = |state| {
                    let found = self::correct(chain, &source, &state, &options);
                    (state.q, found)
                };
                let found: Vec<_> = piece.states().map(one).collect();
                Ok((found, ranges.flags(&piece)))
            })
        })?;
        let (found, flags): (Vec<_>, Vec<_>) = pieces.into_iter().unzip();
        let found: Vec<_> = found.into_iter().flatten().collect();
        let result = self.correction_columns(py, &found)?;
        ranges.add_to(&result, found.len(), &flags)?;
        Ok(result)
    }

    /// Volumetric error on a grid over the travels of X, Y and Z, both ends included.
    ///
    /// counts: nodes along X, Y and Z (1: the middle of the travel). at: dict axis -> coordinate of the other axes, mm or deg, default 0.
    /// approach, temperatures_degc, model: see error.
    ///
    /// Returns a dict: axes, the names of the grid's axes; nodes_mm, dict axis -> (count,); position_um and rotation_urad of shape
    /// (count of the first axis, ..., 3), in the order of axes; outside_range and outside_travel over all nodes in the same order.
    #[pyo3(
        signature = (counts=(11, 11, 11), *, at=None, approach=None, temperatures_degc=None, model="exact"),
        text_signature = "($self, counts=(11, 11, 11), *, at=None, approach=None, temperatures_degc=None, model='exact')"
    )]
    fn map<'py>(
        &self,
        py: Python<'py>,
        counts: (usize, usize, usize),
        at: Option<&Bound<'py, PyDict>>,
        approach: Option<&Bound<'py, PyDict>>,
        temperatures_degc: Option<Temperatures>,
        model: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let model = Model::named(model)?;
        let temperatures = temperatures(&self.machine, temperatures_degc)?;
        let approach = self::approach(&self.machine, approach)?;
        let others = self::others(at)?;
        let counts = [counts.0, counts.1, counts.2];
        let grid = MapGrid::over_travels(&self.machine, counts, &others).map_err(Failure::from)?;
        let positions = self.grid_positions(&grid, approach)?;
        let mut shape: Vec<usize> = grid.nodes_mm.iter().map(Vec::len).collect();
        shape.push(3);
        let result = self.errors_at(py, &positions, &temperatures, model, &shape)?;
        let names: Vec<String> = grid.axes.iter().map(ToString::to_string).collect();
        let nodes_mm = PyDict::new(py);
        for (name, nodes) in names.iter().zip(&grid.nodes_mm) {
            nodes_mm.set_item(name, nodes.clone().into_pyarray(py))?;
        }
        result.set_item("axes", PyList::new(py, names)?)?;
        result.set_item("nodes_mm", nodes_mm)?;
        Ok(result)
    }
}

impl Machine {
    /// Computes the errors at all positions. `shape` is the shape of each of the two returned error arrays.
    fn errors_at<'py>(
        &self,
        py: Python<'py>,
        positions: &Positions<'_>,
        temperatures: &Temperatures,
        model: Model,
        shape: &[usize],
    ) -> PyResult<Bound<'py, PyDict>> {
        let ranges = Ranges::new(&self.machine);
        let position_um = zeros(py, shape)?;
        let rotation_urad = zeros(py, shape)?;
        let (mut um, mut urad) = (position_um.readwrite(), rotation_urad.readwrite());
        let targets =
            Targets { position_um: um.as_slice_mut()?, rotation_urad: urad.as_slice_mut()? };
        let flags = py.detach(|| self.fill(positions, &ranges, temperatures, model, targets))?;
        let result = PyDict::new(py);
        result.set_item("position_um", &position_um)?;
        result.set_item("rotation_urad", &rotation_urad)?;
        ranges.add_to(&result, positions.count, &flags)?;
        Ok(result)
    }

    fn fill(
        &self,
        positions: &Positions<'_>,
        ranges: &Ranges<'_>,
        temperatures: &Temperatures,
        model: Model,
        targets: Targets<'_>,
    ) -> Result<Vec<Option<Vec<u64>>>, Failure> {
        let chain = self.machine.chain();
        match model {
            Model::Form(form) => {
                let source = self.machine.source(temperatures);
                fill_by(positions, ranges, targets, |piece, errors| {
                    for (state, error) in piece.states().zip(errors) {
                        let found = volumetric_error(chain, &source, &state, form);
                        let ([x, y, z], [a, b, c]) =
                            (found.position_mm.into(), found.rotation_rad.into());
                        *error = [x, y, z, a, b, c];
                    }
                    Ok(())
                })
            }
            Model::Compiled => {
                let compiled = self.machine.compile_at(Tolerance::default(), temperatures)?;
                let axes = chain.structure().axes();
                fill_by(positions, ranges, targets, |piece, errors| {
                    let poses = &piece.poses;
                    (compiled.evaluate_batch(axes, poses, positions.approach, errors))
                        .map_err(Failure::argument)
                })
            }
        }
    }

    /// Options of a correction: `correct` if given, otherwise those of the machine file. An unknown or repeated axis is
    /// an error.
    fn options(&self, correct: Option<&Bound<'_, PyAny>>) -> Result<CorrectionOptions, Failure> {
        let mut options = self.machine.correction_options();
        let Some(correct) = correct else {
            return Ok(options);
        };
        let names = axis_names(correct, "correct")?;
        for (place, &axis) in names.iter().enumerate() {
            self.machine.index_of(axis)?;
            if names[..place].contains(&axis) {
                return Err(Failure::argument(format_args!(
                    "correct: found axis {axis} twice, expected each axis once"
                )));
            }
        }
        // The list has room for all names, because each axis occurs once.
        options.correct = Some(names.into_iter().collect());
        Ok(options)
    }

    /// The nodes of a grid, the last axis fastest.
    fn grid_positions<'a>(
        &self,
        grid: &'a MapGrid,
        approach: volcomp_model::vocabulary::PerAxis<Option<volcomp_model::vocabulary::Direction>>,
    ) -> Result<Positions<'a>, Failure> {
        if grid.axes.is_empty() {
            return Err(Failure::argument(format_args!(
                "map: found a machine with the structure `{}`, expected one of the axes X, Y and Z; for other axes: error",
                self.structure()
            )));
        }
        if grid.is_empty() || grid.len() > MOST_NODES {
            return Err(Failure::argument(format_args!(
                "counts: found a grid of {} nodes, expected 1 to {MOST_NODES}",
                grid.len()
            )));
        }
        let mut columns = Vec::new();
        let mut repeated = grid.len();
        for (&axis, nodes) in grid.axes.iter().zip(&grid.nodes_mm) {
            repeated /= nodes.len();
            let column = Column::Nodes { nodes, repeated };
            columns.push((self.machine.index_of(axis)?, axis, column));
        }
        for &(axis, at) in &grid.others {
            columns.push((self.machine.index_of(axis)?, axis, Column::Number(at)));
        }
        Ok(Positions { columns, count: grid.len(), stride: self.machine.axes().len(), approach })
    }

    fn correction_columns<'py>(
        &self,
        py: Python<'py>,
        found: &[(volcomp_model::vocabulary::PerAxis<f64>, Correction)],
    ) -> PyResult<Bound<'py, PyDict>> {
        let (correction, corrected) = (PyDict::new(py), PyDict::new(py));
        for (index, axis) in self.machine.axes().iter().enumerate() {
            let kind: AxisKind = axis.name.kind();
            let micro =
                |found: &Correction| Displacement::new(kind, found.delta[index]).um_or_urad();
            let micro: Vec<f64> = found.iter().map(|(_, found)| micro(found)).collect();
            let sum = found.iter().map(|(at, found)| at[index] + found.delta[index]);
            let sum: Vec<f64> = sum.map(|q| Displacement::new(kind, q).mm_or_deg()).collect();
            correction.set_item(axis.name.to_string(), micro.into_pyarray(py))?;
            corrected.set_item(axis.name.to_string(), sum.into_pyarray(py))?;
        }
        let three = |of: &dyn Fn(&Correction) -> [f64; 3], factor: f64| -> Vec<f64> {
            let vectors = found.iter().map(|(_, found)| of(found));
            vectors.flatten().map(|value| factor * value).collect()
        };
        let residual_um = three(&|of| of.residual_mm.into(), 1e3);
        let residual_axis_urad = three(&|of| of.residual_axis.into(), 1e6);
        let truth = |of: &dyn Fn(&Correction) -> bool| -> Vec<bool> {
            found.iter().map(|(_, found)| of(found)).collect()
        };
        let iterations: Vec<u64> = found.iter().map(|(_, of)| of.iterations as u64).collect();
        let result = PyDict::new(py);
        let shape = [found.len(), 3];
        result.set_item("correction", correction)?;
        result.set_item("corrected", corrected)?;
        result.set_item("residual_um", shaped(py, residual_um, shape)?)?;
        result.set_item("residual_axis_urad", shaped(py, residual_axis_urad, shape)?)?;
        result.set_item("iterations", iterations.into_pyarray(py))?;
        result.set_item("converged", truth(&|of| of.converged).into_pyarray(py))?;
        result.set_item("singular", truth(&|of| of.tool_axis_partial).into_pyarray(py))?;
        result.set_item("near_singular", truth(&|of| of.near_singular).into_pyarray(py))?;
        Ok(result)
    }
}

/// Evaluates all positions piece by piece; `evaluate` fills in ΔP (mm) and ρ (rad) of each position of a piece. Returns
/// the flags of each piece.
fn fill_by(
    positions: &Positions<'_>,
    ranges: &Ranges<'_>,
    targets: Targets<'_>,
    evaluate: impl Fn(&Piece, &mut [[f64; 6]]) -> Result<(), Failure> + Sync,
) -> Result<Vec<Option<Vec<u64>>>, Failure> {
    let pieces: Vec<_> = (positions.starts())
        .zip(targets.position_um.chunks_mut(3 * PIECE))
        .zip(targets.rotation_urad.chunks_mut(3 * PIECE))
        .collect();
    in_parallel(pieces, |((start, position_um), rotation_urad)| {
        let piece = positions.piece(start)?;
        let mut errors = vec![[0.0; 6]; piece.count];
        evaluate(&piece, &mut errors)?;
        let (position_um, _) = position_um.as_chunks_mut::<3>();
        let (rotation_urad, _) = rotation_urad.as_chunks_mut::<3>();
        for (([x, y, z, a, b, c], um), urad) in errors.iter().zip(position_um).zip(rotation_urad) {
            *um = [1e3 * x, 1e3 * y, 1e3 * z];
            *urad = [1e6 * a, 1e6 * b, 1e6 * c];
        }
        Ok(ranges.flags(&piece))
    })
}

/// Coordinates of the axes that are fixed in a map, mm or deg.
fn others(at: Option<&Bound<'_, PyDict>>) -> Result<Vec<(AxisName, f64)>, Failure> {
    let mut others = Vec::new();
    for (key, value) in at.into_iter().flatten() {
        let axis = named(&key, "at")?;
        if matches!(axis, AxisName::X | AxisName::Y | AxisName::Z) {
            return Err(Failure::argument(format_args!(
                "at: found {axis}, expected other axes than X, Y and Z, which go over their travel"
            )));
        }
        let coordinate = value.extract::<f64>().map_err(|_| {
            let found = value.get_type();
            PyTypeError::new_err(format!("at[\"{axis}\"]: found {found}, expected a number"))
        })?;
        others.push((axis, coordinate));
    }
    Ok(others)
}
