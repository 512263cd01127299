//! Residual error of tables compared with the model.

use std::collections::BTreeMap;

use volcomp_curve::{ErrorCurve, Field};
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{Axis, Machine, Temperatures, Thermal};
use volcomp_vocabulary::{
    AxisKind, AxisName, CorrectionLimit, Direction, Displacement, MAX_AXES, PerAxis, brought_into,
};

use super::exchange::{read, write};
use super::firmware::{Firmware, LinearSettings, linear_settings};
use super::options::{ReadOptions, WriteOptions};
use super::sampled::{TableOptions, positions, sampled};
use super::table::{Content, curves, micro_unit, own_component};
use super::text::{ExchangeError, Format};

/// A kind of error whose residual is reported separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[cfg_attr(feature = "schema", serde(rename_all = "lowercase"))]
pub enum Category {
    /// Error motions of linear axes along their direction.
    Positioning,
    /// Error motions of linear axes across their direction.
    Straightness,
    /// Location and assembly errors of linear axes.
    Squareness,
    /// Angular error motions of linear axes, which act through levers (Abbe errors).
    Angular,
    /// Errors that depend on a second coordinate.
    #[cfg_attr(feature = "schema", serde(rename = "second coordinate"))]
    SecondCoordinate,
    /// Differences between the directions of motion.
    Reversal,
    /// Effect of 1 K at each sensor.
    #[cfg_attr(feature = "schema", serde(rename = "thermal, 1 K"))]
    Thermal,
    /// All errors of rotary axes.
    Rotary,
}

impl Category {
    /// All categories, in the order in which residuals are listed.
    pub const ALL: [Self; 8] = [
        Self::Positioning,
        Self::Straightness,
        Self::Squareness,
        Self::Angular,
        Self::SecondCoordinate,
        Self::Reversal,
        Self::Thermal,
        Self::Rotary,
    ];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Positioning => "positioning",
            Self::Straightness => "straightness",
            Self::Squareness => "squareness",
            Self::Angular => "angular",
            Self::SecondCoordinate => "second coordinate",
            Self::Reversal => "reversal",
            Self::Thermal => "thermal, 1 K",
            Self::Rotary => "rotary",
        }
    }
}

/// Machine with the errors of one category only; `None` if it has none.
fn with_only(machine: &Machine, category: Category) -> Result<Option<Machine>, ExchangeError> {
    let mut found = machine.clone();
    found.clear_errors();
    found.set_thermal(Thermal::default())?;
    let mut is_empty = true;
    for (name, curve) in machine.errors() {
        let own = own_component(name.axis);
        let is_grid = curve.fields().any(|field| matches!(field, Field::Grid(_)));
        let of = match (name.axis.kind(), is_grid) {
            (AxisKind::Rotary, _) => Category::Rotary,
            (AxisKind::Linear, true) => Category::SecondCoordinate,
            (AxisKind::Linear, false) if name.component.is_angular() => Category::Angular,
            (AxisKind::Linear, false) if name.component == own => Category::Positioning,
            (AxisKind::Linear, false) => Category::Straightness,
        };
        if of == category {
            found.set_error(name, curve.clone())?;
            is_empty = false;
        }
    }
    let kind = match category {
        Category::Squareness => AxisKind::Linear,
        Category::Rotary => AxisKind::Rotary,
        _ => return Ok((!is_empty).then_some(found)),
    };
    for (name, value) in machine.locations() {
        if name.axis.kind() == kind && *value != 0.0 {
            found.set_location(*name, *value)?;
            is_empty = false;
        }
    }
    for (index, axis) in machine.axes().iter().enumerate() {
        let six = machine.assembly(index);
        if axis.name.kind() == kind && six.iter().any(|value| *value != 0.0) {
            found.set_assembly(axis.name, six)?;
            is_empty = false;
        }
    }
    Ok((!is_empty).then_some(found))
}

const MAX_POSES: usize = 3000;
const MAX_POSITIONS_PER_AXIS: usize = 13;
/// Maximum number of poses per line, separately for midpoints between table positions and for nodes of the machine's curves.
const MAX_POSES_PER_LINE: usize = 400;
/// Golden ratio, whose multiples modulo 1 never repeat.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

/// Residual error on one axis after correction by tables.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct AxisLoss {
    /// Corrected axis.
    pub axis: AxisName,
    /// Unit of the numbers: `um` or `urad`.
    pub unit: &'static str,
    /// Maximum correction by the model.
    pub correction: f64,
    /// Maximum difference between the tables and the model.
    pub largest: f64,
    /// RMS difference over the travel of all axes.
    pub rms: f64,
    /// Position of the maximum, mm or deg.
    pub at: BTreeMap<AxisName, f64>,
    /// Direction of approach of the axes at the maximum; `None`: mean of both directions.
    pub direction: Option<Direction>,
}

/// Residual error of one category.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct CategoryLoss {
    /// The kind of error.
    pub category: Category,
    /// Residual error of each corrected axis.
    pub axes: Vec<AxisLoss>,
}

/// Difference between tables and the model over the work space.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct Loss {
    /// Number of poses, each in both directions.
    pub poses: usize,
    /// All errors together, for each corrected axis.
    pub axes: Vec<AxisLoss>,
    /// Each category that the machine has, alone.
    pub categories: Vec<CategoryLoss>,
}

enum ControlModel {
    Content(Content),
    /// The control evaluates component errors like the model, so they are a machine.
    Machine(Box<Machine>),
    Firmware(Firmware, LinearSettings),
}

/// Data loaded into the control.
#[derive(Clone, Copy)]
enum Given<'a> {
    Tables(Format, &'a WriteOptions),
    Firmware(Firmware),
}

/// Inputs of the comparison between the control's correction and the model.
struct Comparison<'a> {
    temperatures: &'a Temperatures,
    options: &'a TableOptions,
    given: Given<'a>,
    correction: CorrectionOptions,
    outputs: Vec<usize>,
    spread: Vec<State>,
    /// Poses at which the residual error of tables is probably largest.
    likely: Vec<State>,
}

/// Compares the correction by tables of this format, as written to files, with the model, for all errors together and
/// for each category alone. The poses are spread over the travel of all axes; additional ones are, along each axis,
/// midpoints between table positions and nodes of the machine's curves. All errors together and the reversal are
/// evaluated with positive and with negative approach of all axes, the other categories with the mean of both.
///
/// # Errors
/// Same as [`sampled`], [`write`](super::write) and [`read`](super::read).
pub fn loss(
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
    format: Format,
    write: &WriteOptions,
) -> Result<Loss, ExchangeError> {
    loss_of(machine, temperatures, options, Given::Tables(format, write))
}

/// Like [`loss`], for the steps and skew of this firmware.
///
/// # Errors
/// Same as [`linear_settings`].
pub fn firmware_loss(
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
    firmware: Firmware,
) -> Result<Loss, ExchangeError> {
    loss_of(machine, temperatures, options, Given::Firmware(firmware))
}

fn loss_of(
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
    given: Given<'_>,
) -> Result<Loss, ExchangeError> {
    let format = match given {
        Given::Tables(format, _) => format,
        Given::Firmware(_) => Format::Csv,
    };
    // A single category may need larger corrections than all errors together, so the limit does not apply.
    let options = &TableOptions { limit: CorrectionLimit::LARGEST, ..options.clone() };
    let correction = machine.correction_options();
    let correctors = correction.correctors(machine.chain());
    let mut outputs: Vec<usize> =
        (0..machine.axes().len()).filter(|place| correctors.contains(*place)).collect();
    outputs.sort_by_key(|&place| machine.axes()[place].name.index());
    let comparison = Comparison {
        temperatures,
        options,
        given,
        correction,
        outputs,
        spread: spread_poses(machine),
        likely: worst_case_poses(machine, options, format)?,
    };
    let directions = Direction::BOTH.map(Some);
    let held_model = comparison.held_model(machine)?;
    let model = |state: &State| comparison.model(machine, temperatures, state);
    let control = |state: &State| comparison.control(machine, held_model.as_ref(), state);
    let axes = comparison.compare(machine, &directions, &model, &control);
    let mut categories = Vec::new();
    for category in Category::ALL {
        let axes = match category {
            Category::Reversal => {
                if !has_reversal(machine) {
                    continue;
                }
                // Difference between one direction and the mean of both.
                let added = |of: &dyn Fn(&State) -> PerAxis<f64>, state: &State| {
                    let (here, mean) = (of(state), of(&State { q: state.q, ..State::default() }));
                    PerAxis::from_fn(|place| here[place] - mean[place])
                };
                comparison.compare(machine, &directions, &|state| added(&model, state), &|state| {
                    added(&control, state)
                })
            }
            Category::Thermal => {
                let Some(warmer) = warmer(machine, temperatures) else {
                    continue;
                };
                let change = |state: &State| {
                    let (now, then) = (model(state), comparison.model(machine, &warmer, state));
                    PerAxis::from_fn(|place| then[place] - now[place])
                };
                comparison.compare(machine, &[None], &change, &|_| PerAxis::ZERO)
            }
            _ => {
                let Some(machine_of_category) = with_only(machine, category)? else {
                    continue;
                };
                let held_model = comparison.held_model(&machine_of_category)?;
                comparison.compare(
                    machine,
                    &[None],
                    &|state| comparison.model(&machine_of_category, temperatures, state),
                    &|state| comparison.control(&machine_of_category, held_model.as_ref(), state),
                )
            }
        };
        categories.push(CategoryLoss { category, axes });
    }
    Ok(Loss { poses: comparison.spread.len() + comparison.likely.len(), axes, categories })
}

/// Poses over the travel of all axes. The spacing is uneven, because even spacing would coincide with table positions and with the zeros of
/// a periodic error.
fn spread_poses(machine: &Machine) -> Vec<State> {
    let axes = machine.axes();
    let count = (1..=MAX_POSITIONS_PER_AXIS).rev().find(|count| {
        let power = u32::try_from(axes.len()).unwrap_or(u32::MAX);
        count.checked_pow(power).is_some_and(|poses| poses <= MAX_POSES)
    });
    let count = count.unwrap_or(1);
    let mut poses = vec![State::default()];
    for (index, axis) in axes.iter().enumerate() {
        let mut nodes = axis.nodes(count);
        if let [first, second, ..] = nodes[..] {
            let step = second - first;
            let last = count - 1;
            for (place, node) in nodes.iter_mut().enumerate().take(last).skip(1) {
                *node += step * ((place as f64 * GOLDEN).fract() - 0.5);
            }
        }
        poses = poses
            .iter()
            .flat_map(|pose| nodes.iter().map(move |at| with_coordinate(pose, axis, index, *at)))
            .collect();
    }
    poses
}

/// Poses along each axis, with the other axes at the reference position of the tables and at the farther end of their travel: midpoints
/// between table positions, and nodes of the machine's curves.
fn worst_case_poses(
    machine: &Machine,
    options: &TableOptions,
    format: Format,
) -> Result<Vec<State>, ExchangeError> {
    let reference = options.reference(machine)?;
    let stand = machine.state(&reference)?;
    let far = machine.axes().iter().zip(&reference).enumerate();
    let far = far.fold(stand, |state, (index, (axis, (_, at)))| {
        let [low, high] = axis.travel;
        let farther = if at - low > high - at { low } else { high };
        with_coordinate(&state, axis, index, farther)
    });
    let tables = positions(machine, options, format)?;
    let curves = machine.places();
    let mut poses = Vec::new();
    for (index, (axis, (nodes, places))) in
        (machine.axes().iter().zip(tables.iter().zip(&curves))).enumerate()
    {
        // Nodes over a turn may be outside the travel; the equivalent position is within it.
        let wrapped = |at: f64| match axis.modulo {
            Some(period) => brought_into(axis.travel, period, at),
            None => at,
        };
        let middles = nodes
            .windows(2)
            .map(|pair| wrapped(f64::midpoint(pair[0], pair[1])))
            .filter(|at| axis.contains(*at));
        let middles: Vec<f64> = middles.collect();
        for at in thinned(&middles).chain(thinned(places)) {
            poses.extend([stand, far].map(|state| with_coordinate(&state, axis, index, at)));
        }
    }
    Ok(poses)
}

fn with_coordinate(pose: &State, axis: &Axis, index: usize, at: f64) -> State {
    let mut pose = *pose;
    pose.q[index] = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
    pose
}

/// Keeps at most `MAX_POSES_PER_LINE` positions. The stride is odd, so that a period of a power of two is not aliased.
fn thinned(places: &[f64]) -> impl Iterator<Item = f64> + '_ {
    let step = places.len().div_ceil(MAX_POSES_PER_LINE).max(1) | 1;
    places.iter().copied().step_by(step)
}

fn has_reversal(machine: &Machine) -> bool {
    machine.errors().any(|(_, curve)| !matches!(curve, ErrorCurve::Single(_)))
}

/// Temperatures with every sensor warmer by 1 K; `None` without thermal terms.
fn warmer(machine: &Machine, temperatures: &Temperatures) -> Option<Temperatures> {
    let thermal = machine.thermal();
    let sensors = thermal.sensors();
    let warmer = sensors.iter().map(|name| {
        let now = temperatures.get(*name).copied().unwrap_or(thermal.reference_degc);
        ((*name).to_owned(), now + 1.0)
    });
    (!sensors.is_empty()).then(|| warmer.collect())
}

impl Comparison<'_> {
    /// Correction model of the control, from the files read back; `None` if the format can represent no error of this machine.
    fn held_model(&self, machine: &Machine) -> Result<Option<ControlModel>, ExchangeError> {
        let (format, to_write) = match self.given {
            Given::Tables(format, write) => (format, write),
            Given::Firmware(firmware) => {
                let settings = linear_settings(machine, self.temperatures, self.options)?;
                return Ok(Some(ControlModel::Firmware(firmware, settings)));
            }
        };
        let content = sampled(machine, self.temperatures, self.options, format)?;
        let files = match write(format, &content, to_write) {
            Ok(written) => written.files,
            // The format represents none of these errors, so nothing is corrected.
            Err(ExchangeError::NotRepresentable { what, .. }) if what == "tables" => {
                return Ok(None);
            }
            Err(other) => return Err(other),
        };
        let options = ReadOptions {
            axes: to_write.axes.clone(),
            encoder: Some(to_write.encoder),
            detection_unit: to_write.detection_unit,
        };
        let content = read(format, &files, &options)?.content;
        let Content::Errors(_) = &content else {
            return Ok(Some(ControlModel::Content(content)));
        };
        let mut copy = machine.clone();
        copy.clear_errors();
        copy.set_thermal(Thermal::default())?;
        let curves = curves(&content)?;
        for (name, curve) in curves.motions {
            copy.set_error(name, curve)?;
        }
        for (name, value) in curves.locations {
            copy.set_location(name, value)?;
        }
        Ok(Some(ControlModel::Machine(Box::new(copy))))
    }

    fn model(&self, machine: &Machine, temperatures: &Temperatures, state: &State) -> PerAxis<f64> {
        machine.correction_at(state, temperatures, &self.correction).delta
    }

    fn control(
        &self,
        machine: &Machine,
        held_model: Option<&ControlModel>,
        state: &State,
    ) -> PerAxis<f64> {
        let axes = machine.axes();
        let index =
            |name: AxisName| axes.iter().position(|axis| axis.name == name).unwrap_or(MAX_AXES);
        let mut sum = PerAxis::ZERO;
        let mut add = |axis: AxisName, deviation: f64| {
            if let Some(place) = sum.0.get_mut(index(axis)) {
                *place -= deviation;
            }
        };
        match held_model {
            None | Some(ControlModel::Content(Content::Errors(_))) => {}
            Some(ControlModel::Firmware(firmware, settings)) => {
                return settings.correction(*firmware, machine, state);
            }
            Some(ControlModel::Machine(machine)) => {
                return self.model(machine, &Temperatures::new(), state);
            }
            Some(ControlModel::Content(Content::Axes(tables))) => {
                for table in tables {
                    let place = index(table.input);
                    let at = state.q.0.get(place).copied().unwrap_or(0.0);
                    let approach = state.approach.0.get(place).copied().flatten();
                    add(table.output, table.deviation(at, approach));
                }
            }
        }
        sum
    }

    fn compare(
        &self,
        machine: &Machine,
        directions: &[Option<Direction>],
        model: &dyn Fn(&State) -> PerAxis<f64>,
        control: &dyn Fn(&State) -> PerAxis<f64>,
    ) -> Vec<AxisLoss> {
        let axes = machine.axes();
        let mut found: Vec<AxisLoss> = self
            .outputs
            .iter()
            .map(|&place| AxisLoss {
                axis: axes[place].name,
                unit: micro_unit(axes[place].name.kind()),
                correction: 0.0,
                largest: 0.0,
                rms: 0.0,
                at: BTreeMap::new(),
                direction: None,
            })
            .collect();
        let spread = self.spread.iter().map(|pose| (pose, 1.0));
        let likely = self.likely.iter().map(|pose| (pose, 0.0));
        for (pose, counts) in spread.chain(likely) {
            for &direction in directions {
                let state = State { q: pose.q, approach: PerAxis([direction; MAX_AXES]) };
                let (expected, applied) = (model(&state), control(&state));
                for (found, &place) in found.iter_mut().zip(&self.outputs) {
                    let kind = found.axis.kind();
                    let micro = |of: f64| Displacement::new(kind, of).um_or_urad().abs();
                    let difference = micro(expected[place] - applied[place]);
                    found.correction = found.correction.max(micro(expected[place]));
                    found.rms += counts * difference * difference;
                    if difference > found.largest || found.at.is_empty() {
                        found.largest = difference;
                        found.direction = direction;
                        found.at = axes
                            .iter()
                            .zip(state.q.iter())
                            .map(|(axis, q)| {
                                (axis.name, Displacement::new(axis.name.kind(), *q).mm_or_deg())
                            })
                            .collect();
                    }
                }
            }
        }
        let evaluations = (self.spread.len() * directions.len()).max(1) as f64;
        for found in &mut found {
            found.rms = (found.rms / evaluations).sqrt();
        }
        found
    }
}
