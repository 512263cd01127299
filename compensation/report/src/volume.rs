//! Volumetric error over the working space, before and after compensation.

use volcomp_calibrate::Ensemble;
use volcomp_kinematics::{State as Pose, nalgebra::Vector3};
use volcomp_model::{
    ErrorField, Lengths, Machine, MapGrid, ModelError, RigidMotion, UNCERTAINTY_POSES,
    VolumetricError, poses_of_all_axes,
};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::report::{Drawn, OfState, Size, Slice, Standing, State, Vector, Volume};

const CELLS: usize = 25;
const VECTORS: usize = 5;

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
    let grid = MapGrid::over_travels(machine, [VECTORS; 3], others)?;
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
fn standing(machine: &Machine, others: &[(AxisName, f64)]) -> Vec<Standing> {
    let moved = [AxisName::X, AxisName::Y, AxisName::Z];
    let stand = machine.axes().iter().filter(|axis| !moved.contains(&axis.name));
    stand
        .map(|axis| {
            let stated = others.iter().find(|(name, _)| *name == axis.name);
            let at = stated.map_or_else(|| axis.nearest_zero(), |(_, at)| *at);
            Standing { axis: axis.name.to_string(), at }
        })
        .collect()
}

/// Coordinates of all axes at a pose, mm and deg.
fn standing_at(machine: &Machine, pose: &Pose) -> Vec<Standing> {
    let axes = machine.axes().iter().zip(&pose.q);
    axes.map(|(axis, q)| Standing {
        axis: axis.name.to_string(),
        at: Displacement::new(axis.name.kind(), *q).mm_or_deg(),
    })
    .collect()
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
    let stands =
        found.position.at.iter().map(|(name, at)| Standing { axis: name.to_string(), at: *at });
    Size {
        max_um: 1e3 * found.max_mm,
        rms_um: 1e3 * found.rms_mm,
        form_max_um: 1e3 * found.position.value,
        form_rms_um: 1e3 * found.position_rms_mm,
        tilt_urad: 1e6 * found.tilt.value,
        at: stands.collect(),
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
            across: across.to_string(),
            up: up.to_string(),
            held: nodes(held).first().map(|at| Standing { axis: held.to_string(), at: *at }),
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
            across: across.name.to_string(),
            up: up.name.to_string(),
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
