//! Volumetric error over the working space, before and after compensation.

use std::collections::BTreeSet;

use volcomp_calibrate::Ensemble;
use volcomp_kinematics::{
    ErrorSource, Form, State as Pose, correct, nalgebra::Vector3, volumetric_error,
};
use volcomp_model::{
    DIAGONAL_TARGETS, ErrorField, Lengths, Machine, MapGrid, ModelError, RigidMotion, Temperatures,
    UNCERTAINTY_POSES, VolumetricError, corrected, diagonals, poses_of_all_axes, residual,
    volumetric,
};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::report::{
    Diagonal, Diagonals, Drawn, OfState, Report, Size, Slice, State, Vector, Volume, Warning,
    WarningKind,
};

const CELLS: usize = 25;
const VECTORS: usize = 5;
/// Error vectors along each axis of the view in three dimensions.
const VECTORS_IN_SPACE: usize = 11;

/// Error of a machine at a pose: position (mm), then rotation (rad), in workpiece axes.
pub type ErrorAt<'a> = &'a dyn Fn(&Pose) -> [f64; 6];

/// Evaluates the volumetric error of a machine in one or two states, before and after a compensation: its
/// size over poses of all axes, and maps over the working space with the other axes at `others` (mm
/// or deg). `judged` is the machine that has the errors of the last state. Each state has one error
/// field per tool, and their common [`volumetric`](volcomp_model::volumetric) error; the maps show the first field. `None` for a machine
/// that lacks two of the axes X, Y and Z.
///
/// # Errors
/// The errors of [`Machine::state`] for `others`.
pub fn volume(
    [machine, judged]: [&Machine; 2],
    others: &[(AxisName, f64)],
    before: (State, &[ErrorField<'_>], VolumetricError),
    after: Option<(State, &[ErrorField<'_>], VolumetricError)>,
) -> Result<Option<Volume>, ModelError> {
    let grid = MapGrid::over_travels(machine, [VECTORS_IN_SPACE; 3], others)?;
    let Some(first) = before.1.first().filter(|_| grid.axes.len() >= 2) else {
        return Ok(None);
    };
    let all_before = before.2;
    let of_after = match after {
        Some((state, fields, all)) => {
            let errors = fields.first().unwrap_or(first).errors;
            let rigid = all.alignment;
            let aligned = Beside { machine, errors, rigid };
            Some((state, size(&all), aligned))
        }
        None => None,
    };
    let beside_before = Beside { machine, errors: first.errors, rigid: all_before.alignment };
    let vectors_at = grid;
    let vectors = (0..vectors_at.len()).map(|index| {
        let (place, pose) = vectors_at.node(machine, index);
        Vector {
            at_mm: by_axis(&vectors_at, place),
            before_um: beside_before.left_um(&pose),
            after_um: of_after.as_ref().map(|(_, _, beside)| beside.left_um(&pose)),
        }
    });
    let travel = |name| machine.axis(name).map_or([0.0; 2], |axis| axis.travel);
    Ok(Some(Volume {
        before: OfState { state: before.0, found: size(&all_before) },
        after: of_after
            .as_ref()
            .map(|(state, size, _)| OfState { state: *state, found: size.clone() }),
        has_thermal: !machine.thermal().sensors().is_empty(),
        is_partly_measured: !judged.partly_measured().is_empty()
            || !judged.read_in_one_direction().is_empty(),
        undecided: (judged.provenance().undecided.iter()).map(ToString::to_string).collect(),
        knows_errors: judged.states_errors(),
        slices: slices(machine, others, &beside_before, of_after.as_ref().map(|of| &of.2))?,
        travels_mm: [AxisName::X, AxisName::Y, AxisName::Z].map(travel),
        vectors: vectors.collect(),
        poses: all_before.poses,
        standing: standing(machine, others),
    }))
}

/// Axes other than X, Y and Z, which do not move in the maps, with their coordinates.
fn standing(machine: &Machine, others: &[(AxisName, f64)]) -> Vec<(AxisName, f64)> {
    let moved = [AxisName::X, AxisName::Y, AxisName::Z];
    let stand = machine.axes().iter().filter(|axis| !moved.contains(&axis.name));
    stand
        .map(|axis| {
            let stated = others.iter().find(|(name, _)| *name == axis.name);
            let at = stated.map_or_else(|| axis.nearest_zero(), |(_, at)| *at);
            (axis.name, at)
        })
        .collect()
}

/// Coordinates of all axes at a pose, mm and deg.
fn standing_at(machine: &Machine, pose: &Pose) -> Vec<(AxisName, f64)> {
    let axes = machine.axes().iter().zip(&pose.q);
    axes.map(|(axis, q)| (axis.name, Displacement::new(axis.name.kind(), *q).mm_or_deg())).collect()
}

struct Beside<'a> {
    machine: &'a Machine,
    errors: ErrorAt<'a>,
    rigid: RigidMotion,
}

impl Beside<'_> {
    fn left_um(&self, pose: &Pose) -> [f64; 3] {
        let [x, y, z, ..] = (self.errors)(pose);
        let tip = self.machine.chain().ideal_tip_mm(pose);
        (self.rigid.left_mm(&tip, &Vector3::new(x, y, z)) * 1e3).into()
    }
}

/// Coordinates of a node in the order X, Y, Z; 0 for a missing axis.
fn by_axis(grid: &MapGrid, place: [f64; 3]) -> [f64; 3] {
    let mut at = [0.0; 3];
    for (name, coordinate) in grid.axes.iter().zip(place) {
        at[name.mcs_index()] = coordinate;
    }
    at
}

fn size(found: &VolumetricError) -> Size {
    Size {
        max_um: 1e3 * found.max_mm,
        rms_um: 1e3 * found.rms_mm,
        form_max_um: 1e3 * found.position.value,
        form_rms_um: 1e3 * found.position_rms_mm,
        tilt_urad: 1e6 * found.tilt.value,
        at: found.position.at.iter().map(|(name, at)| (*name, *at)).collect(),
        tool: found.position.tool.clone(),
    }
}

fn slices(
    machine: &Machine,
    others: &[(AxisName, f64)],
    before: &Beside<'_>,
    after: Option<&Beside<'_>>,
) -> Result<Vec<Slice>, ModelError> {
    let lengths = |of: &Beside<'_>, poses: &[Pose]| -> Vec<f64> {
        let left = poses.iter().map(|pose| of.left_um(pose));
        left.map(|left| Vector3::from(left).norm()).collect()
    };
    let mut found = Vec::new();
    for [across, up, held] in [
        [AxisName::X, AxisName::Y, AxisName::Z],
        [AxisName::X, AxisName::Z, AxisName::Y],
        [AxisName::Y, AxisName::Z, AxisName::X],
    ] {
        if machine.axis(across).is_none() || machine.axis(up).is_none() {
            continue;
        }
        let mut counts = [CELLS; 3];
        counts[held.mcs_index()] = 1;
        let grid = MapGrid::over_travels(machine, counts, others)?;
        let nodes = |name: AxisName| {
            let place = grid.axes.iter().position(|axis| *axis == name);
            place.map_or_else(Vec::new, |place| grid.nodes_mm[place].clone())
        };
        // X varies fastest, then Y, so `across` varies before `up`; the third axis has one node.
        let poses: Vec<Pose> = (0..grid.len()).map(|index| grid.node(machine, index).1).collect();
        found.push(Slice {
            across,
            up,
            held: nodes(held).first().map(|at| (held, *at)),
            x: nodes(across),
            y: nodes(up),
            before_um: lengths(before, &poses),
            after_um: after.map(|after| lengths(after, &poses)),
            vectors: (0..grid.len())
                .filter(|index| is_of_vector(index % CELLS) && is_of_vector(index / CELLS))
                .map(|index| {
                    let (place, pose) = grid.node(machine, index);
                    Vector {
                        at_mm: by_axis(&grid, place),
                        before_um: before.left_um(&pose),
                        after_um: after.map(|after| after.left_um(&pose)),
                    }
                })
                .collect(),
        });
    }
    let mut rotary = machine.axes().iter().filter(|axis| axis.name.is_rotary());
    if let (Some(across), Some(up)) = (rotary.next(), rotary.next()) {
        let [x, y] = [across, up].map(|axis| axis.nodes(CELLS));
        let mut middle = [AxisName::X, AxisName::Y, AxisName::Z].to_vec();
        middle.retain(|name| machine.axis(*name).is_some());
        let middle = middle.into_iter().filter_map(|name| {
            let at = machine.axis(name)?.nodes(1);
            Some((name, *at.first()?))
        });
        let still = others
            .iter()
            .copied()
            .filter(|(name, _)| *name != across.name && *name != up.name && !is_of_grid(*name));
        let fixed: Vec<(AxisName, f64)> = still.chain(middle).collect();
        let mut poses = Vec::new();
        for second in &y {
            for first in &x {
                let moved = [(across.name, *first), (up.name, *second)];
                poses.push(machine.state(&[&fixed[..], &moved].concat())?);
            }
        }
        found.push(Slice {
            across: across.name,
            up: up.name,
            held: None,
            before_um: lengths(before, &poses),
            after_um: after.map(|after| lengths(after, &poses)),
            vectors: Vec::new(),
            x,
            y,
        });
    }
    Ok(found)
}

/// Whether a node of a plane has an error vector: nodes are evenly spaced and away from the edges.
fn is_of_vector(node: usize) -> bool {
    let step = CELLS / VECTORS;
    node % step == step / 2
}

fn is_of_grid(name: AxisName) -> bool {
    matches!(name, AxisName::X | AxisName::Y | AxisName::Z)
}

/// The machine with each tool for which the volumetric error is evaluated, by name: first its current tool, used for the maps, then the
/// [extreme tools](Machine::extreme_tools).
///
/// # Errors
/// The tools of the machine file are invalid.
pub(crate) fn tools(machine: &Machine) -> Result<Vec<(&str, Machine)>, ModelError> {
    let mut tools = vec![("", Machine::clone(machine))];
    for name in machine.extreme_tools()? {
        let mut with_tool = Machine::clone(machine);
        with_tool.select_tool(name)?;
        tools.push((name, with_tool));
    }
    Ok(tools)
}

/// Standard uncertainty of the position error over poses of all axes and the extreme tools, from Monte Carlo
/// samples; `None` for a machine without any of the axes X, Y and Z.
///
/// # Errors
/// See [`Machine::state`].
pub fn uncertainty(
    machine: &Machine,
    ensemble: &Ensemble,
    (trials, seed): (u64, u64),
) -> Result<Option<Drawn>, ModelError> {
    let is_linear = |name| machine.axis(name).is_some();
    if ![AxisName::X, AxisName::Y, AxisName::Z].into_iter().any(is_linear) {
        return Ok(None);
    }
    let tools = tools(machine)?;
    let mut lengths = Lengths::default();
    let mut most: Option<(f64, Pose)> = None;
    for pose in poses_of_all_axes(machine)?.into_iter().take(UNCERTAINTY_POSES) {
        let own = machine.chain().ideal_tip_mm(&pose);
        for (_, with_tool) in &tools {
            // Lever arm about which the rotations of a sample move the tip of this tool.
            let lever_mm = with_tool.chain().ideal_tip_mm(&pose) - own;
            let error = Vector3::from(ensemble.uncertainty_of(|drawn| {
                let [x, y, z, a, b, c] = drawn.evaluate(&pose).into_six();
                (Vector3::new(x, y, z) + Vector3::new(a, b, c).cross(&lever_mm)).into()
            }));
            lengths.take(&error);
            if most.as_ref().is_none_or(|(before, _)| error.norm() > *before) {
                most = Some((error.norm(), pose));
            }
        }
    }
    Ok(most.map(|(max_mm, pose)| Drawn {
        trials,
        seed,
        rms_um: 1e3 * lengths.rms(),
        max_um: 1e3 * max_mm,
        at: standing_at(machine, &pose),
    }))
}

impl Report {
    /// Adds the body diagonals and the volumetric error of `machine`, over the tools of its file. In the diagonals and
    /// maps the axes other than X, Y and Z are at `others` (mm or deg). `before` and `truth` are machine files of the
    /// same geometry: `before` has the errors before a compensation, `truth` the true errors. With `truth`, the last
    /// state is the residual of the true errors after correction by `machine`.
    ///
    /// Returns the note on thermal terms, which are not included. Once `is_cancelled` returns true, the errors count as
    /// 0: the search ends soon, and the caller discards the report.
    ///
    /// # Errors
    /// A machine whose errors cannot be evaluated; the errors of [`Machine::state`] for `others`.
    pub fn add_working_space(
        &mut self,
        machine: &Machine,
        before: Option<&Machine>,
        truth: Option<&Machine>,
        others: &[(AxisName, f64)],
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<String>, ModelError> {
        let found = (State::Found, machine);
        let left = truth.map(|truth| (State::TruthCorrected, truth));
        let (first, second) = match (before, truth) {
            (Some(before), _) => ((State::GivenBefore, before), left.or(Some(found))),
            (None, Some(truth)) => ((State::Truth, truth), left),
            (None, None) => (found, None),
        };
        let tools = tools(machine)?;
        let with_tools = |(state, actual): (State, &Machine)| {
            let with_tool = |(_, model): &(&str, Machine)| {
                let mut actual = actual.clone();
                actual.use_tool_of(model)?;
                Ok(actual)
            };
            let actual = tools.iter().map(with_tool).collect::<Result<Vec<_>, ModelError>>()?;
            Ok::<_, ModelError>((state, actual))
        };
        let both = [Some(first), second].into_iter().flatten();
        let both = both.map(with_tools).collect::<Result<Vec<_>, ModelError>>()?;
        let along = |(state, actual): &(State, Vec<Machine>)| {
            let source = machine.source(&Temperatures::new());
            let command = |pose: &Pose| command(machine, &source, *state, pose);
            // The first tool is that of the machine.
            let actual = actual.first().unwrap_or(machine);
            let found = body_diagonals(machine, actual, others, command)?;
            Ok(found.map(|found| OfState { state: *state, found }))
        };
        let along = both.iter().map(along).collect::<Result<Vec<_>, ModelError>>()?;
        let mut along = along.into_iter().flatten();
        self.diagonals = along.next().map(|before| Diagonals { before, after: along.next() });
        let errors = both.iter().map(|(state, actual)| {
            let each = tools.iter().zip(actual);
            let each = each.map(|((_, model), actual)| errors(model, actual, *state, is_cancelled));
            each.collect::<Vec<_>>()
        });
        let errors: Vec<Vec<_>> = errors.collect();
        let fields = errors.iter().map(|errors| fields(&tools, &both, errors));
        let fields: Vec<Vec<ErrorField<'_>>> = fields.collect();
        let mut states = Vec::new();
        for ((state, _), fields) in both.iter().zip(&fields) {
            states.push((*state, &fields[..], volumetric(fields)?));
        }
        let mut states = states.into_iter();
        let judged = second.unwrap_or(first).1;
        self.volume = match states.next() {
            Some(first) => volume([machine, judged], others, first, states.next())?,
            None => None,
        };
        let machines = [Some(machine), before, truth].into_iter().flatten();
        Ok(self.leave_out_temperatures(machine.thermal().reference_degc, machines))
    }

    /// Records that the thermal terms of these machines are not included, so that a figure within its tolerance is undecided. Returns the
    /// note; `None` for machines without thermal terms.
    fn leave_out_temperatures<'a>(
        &mut self,
        reference_degc: f64,
        machines: impl IntoIterator<Item = &'a Machine>,
    ) -> Option<String> {
        let sensors: BTreeSet<&str> =
            machines.into_iter().flat_map(|of| of.thermal().sensors()).collect();
        if sensors.is_empty() {
            return None;
        }
        if let Some(volume) = &mut self.volume {
            volume.has_thermal = true;
        }
        let text = format!(
            "the figures computed from the model hold at {reference_degc} °C: thermal terms of {} are left out; `volcomp map --temperature` gives the volumetric error at others, `volcomp check` what each kelvin adds",
            sensors.into_iter().collect::<Vec<_>>().join(", ")
        );
        self.warnings.push(Warning { kind: WarningKind::Temperature, text: text.clone() });
        Some(text)
    }
}

/// The command for a target in this state: the target, or the target with the correction of the model, whose errors are `source`.
fn command(model: &Machine, source: &impl ErrorSource, state: State, target: &Pose) -> Pose {
    if state != State::TruthCorrected {
        return *target;
    }
    let found = correct(model.chain(), source, target, &model.correction_options());
    corrected(target, &found.delta)
}

/// Position (mm) and rotation (rad) of the error at a pose, in workpiece axes, at the reference temperature.
fn errors<'a>(
    model: &'a Machine,
    actual: &'a Machine,
    state: State,
    is_cancelled: &'a dyn Fn() -> bool,
) -> impl Fn(&Pose) -> [f64; 6] + 'a {
    let none = Temperatures::new();
    let of_model = (state == State::TruthCorrected).then(|| model.fine_source(&none));
    let of_actual = actual.fine_source(&none);
    move |pose| {
        if is_cancelled() {
            return [0.0; 6];
        }
        let (chain, source) = (actual.chain(), &&*of_actual);
        if let Some(of_model) = &of_model {
            return residual(chain, source, &command(model, &&**of_model, state, pose), pose);
        }
        let found = volumetric_error(chain, source, pose, Form::Exact);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    }
}

/// Error fields of each tool. The curves of all machines determine the sampled poses, so that all states are evaluated at the same ones.
fn fields<'a>(
    tools: &'a [(&'a str, Machine)],
    states: &'a [(State, Vec<Machine>)],
    errors: &'a [impl Fn(&Pose) -> [f64; 6]],
) -> Vec<ErrorField<'a>> {
    let all = tools.iter().zip(errors).enumerate();
    all.map(|(place, ((tool, machine), errors))| {
        let actual = states.iter().filter_map(|(_, actual)| actual.get(place));
        ErrorField { tool, machine, curves: [machine].into_iter().chain(actual).collect(), errors }
    })
    .collect()
}

/// Evaluates the body diagonals of a machine with the errors of `actual`, other axes at `others` (mm or deg). `command` returns the commanded
/// pose of a target. `None` for a machine that lacks one of the axes X, Y and Z.
///
/// # Errors
/// The errors of [`Machine::state`] for `others`.
fn body_diagonals(
    machine: &Machine,
    actual: &Machine,
    others: &[(AxisName, f64)],
    command: impl Fn(&Pose) -> Pose,
) -> Result<Option<Vec<Diagonal>>, ModelError> {
    let mut linear = [AxisName::X, AxisName::Y, AxisName::Z].into_iter();
    if !linear.all(|name| machine.axis(name).is_some()) {
        return Ok(None);
    }
    let points = DIAGONAL_TARGETS as usize;
    let none = Temperatures::new();
    let along = diagonals(actual, &actual.source(&none), points, others, command)?;
    Ok(Some(along.iter().map(|found| Diagonal::of(machine, found)).collect()))
}

impl Diagonal {
    /// The deviations of `found` by the distance of the ideal tool tip of `machine` from the first target.
    pub fn of(machine: &Machine, found: &volcomp_model::Diagonal) -> Self {
        let tips = found.at.iter().map(|at| {
            let at: Vec<(AxisName, f64)> = at.iter().map(|(axis, at)| (*axis, *at)).collect();
            // The targets are poses of this machine, so this cannot fail.
            machine.chain().ideal_tip_mm(&machine.state(&at).unwrap_or_default())
        });
        let tips: Vec<_> = tips.collect();
        let places = tips.iter().map(|tip| (tip - tips[0]).norm());
        Self {
            name: found.name.to_owned(),
            points: places.zip(found.deviation_um.iter().copied()).collect(),
            range_um: found.range_um,
        }
    }
}
