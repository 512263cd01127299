//! The error of the tool over the working space, before and after.

use volcomp_kinematics::{State as Pose, nalgebra::Vector3};
use volcomp_model::{Ensemble, Lengths, Machine, MapGrid, ModelError, RigidMotion, RigidSums};
use volcomp_vocabulary::AxisName;

use crate::report::{Drawn, OfState, Size, Slice, Standing, State, Vector, Volume};

/// Nodes along an axis over which the largest error and the root of the mean square are taken.
const SIZES: usize = 9;
/// Nodes along an axis of a plane that is drawn.
const CELLS: usize = 25;
/// Error vectors along an axis.
const VECTORS: usize = 5;
/// Nodes along an axis at which the uncertainty is evaluated, once for each machine that is drawn.
const UNCERTAIN: usize = 5;

/// What gives the error at a pose: position (mm) and rotation (rad) in workpiece axes.
pub type ErrorAt<'a> = &'a dyn Fn(&Pose) -> [f64; 6];

/// The error of one or of two states of a machine over its working space, other axes where `others` says (mm or deg);
/// `None` of a machine without two of the axes X, Y and Z.
///
/// # Errors
/// What [`Machine::state`] refuses of `others`.
pub fn volume(
    machine: &Machine,
    others: &[(AxisName, f64)],
    before: (State, ErrorAt<'_>),
    after: Option<(State, ErrorAt<'_>)>,
) -> Result<Option<Volume>, ModelError> {
    let grid = MapGrid::over_travels(machine, [SIZES; 3], others)?;
    if grid.axes.len() < 2 {
        return Ok(None);
    }
    let sized = |errors: ErrorAt<'_>| size(machine, &grid, errors);
    let (size_before, rigid_before) = sized(before.1);
    let of_after = after.map(|(state, errors)| {
        let (size, rigid) = sized(errors);
        (
            state,
            size,
            Beside {
                machine,
                errors,
                rigid,
            },
        )
    });
    let beside_before = Beside {
        machine,
        errors: before.1,
        rigid: rigid_before,
    };
    let vectors_at = MapGrid::over_travels(machine, [VECTORS; 3], others)?;
    let vectors = (0..vectors_at.len()).map(|index| {
        let (place, pose) = vectors_at.node(machine, index);
        Vector {
            at_mm: by_axis(&vectors_at, place),
            before_um: beside_before.left_um(&pose),
            after_um: of_after
                .as_ref()
                .map(|(_, _, beside)| beside.left_um(&pose)),
        }
    });
    let travel = |name| machine.axis(name).map_or([0.0; 2], |axis| axis.travel);
    Ok(Some(Volume {
        before: OfState {
            state: before.0,
            found: size_before,
        },
        after: of_after.as_ref().map(|(state, size, _)| OfState {
            state: *state,
            found: *size,
        }),
        slices: slices(
            machine,
            others,
            &beside_before,
            of_after.as_ref().map(|of| &of.2),
        )?,
        travels_mm: [AxisName::X, AxisName::Y, AxisName::Z].map(travel),
        vectors: vectors.collect(),
        nodes: grid.len(),
        standing: standing(machine, others),
    }))
}

/// The axes that are not moved over the working space, and where they stand.
fn standing(machine: &Machine, others: &[(AxisName, f64)]) -> Vec<Standing> {
    let moved = [AxisName::X, AxisName::Y, AxisName::Z];
    let stand = machine
        .axes()
        .iter()
        .filter(|axis| !moved.contains(&axis.name));
    stand
        .map(|axis| {
            let stated = others.iter().find(|(name, _)| *name == axis.name);
            let at = stated.map_or_else(|| axis.nearest_zero(), |(_, at)| *at);
            Standing {
                axis: axis.name.to_string(),
                at,
            }
        })
        .collect()
}

/// What the errors of a machine are beside the best rigid motion of the workpiece: where it lies is no error of the machine.
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

/// The coordinates of a node at the places of X, Y and Z.
fn by_axis(grid: &MapGrid, place: [f64; 3]) -> [f64; 3] {
    let mut at = [0.0; 3];
    for (name, coordinate) in grid.axes.iter().zip(place) {
        at[name.mcs_index()] = coordinate;
    }
    at
}

fn size(machine: &Machine, grid: &MapGrid, errors: ErrorAt<'_>) -> (Size, RigidMotion) {
    let (mut sums, mut lengths) = (RigidSums::default(), Lengths::default());
    let mut all = Vec::with_capacity(grid.len());
    for index in 0..grid.len() {
        let (place, pose) = grid.node(machine, index);
        let [x, y, z, ..] = errors(&pose);
        let error = Vector3::new(x, y, z);
        let tip = machine.chain().ideal_tip_mm(&pose);
        sums.take(&tip, &error);
        lengths.take(&error);
        all.push((by_axis(grid, place), tip, error));
    }
    let motion = sums.motion();
    let mut left = Lengths::default();
    let mut most = (-1.0, [0.0; 3]);
    for (place, tip, error) in &all {
        let beside = motion.left_mm(tip, error);
        left.take(&beside);
        if beside.norm() > most.0 {
            most = (beside.norm(), *place);
        }
    }
    let size = Size {
        max_um: 1e3 * lengths.max(),
        rms_um: 1e3 * lengths.rms(),
        form_max_um: 1e3 * left.max(),
        form_rms_um: 1e3 * left.rms(),
        at_mm: most.1,
    };
    (size, motion)
}

/// Planes through the middle of the working space.
fn slices(
    machine: &Machine,
    others: &[(AxisName, f64)],
    before: &Beside<'_>,
    after: Option<&Beside<'_>>,
) -> Result<Vec<Slice>, ModelError> {
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
        // X is fastest, then Y: `across` comes before `up`, and the third has one node.
        let poses: Vec<Pose> = (0..grid.len())
            .map(|index| grid.node(machine, index).1)
            .collect();
        let lengths = |of: &Beside<'_>| {
            let left = poses
                .iter()
                .map(|pose| Vector3::from(of.left_um(pose)).norm());
            left.collect()
        };
        found.push(Slice {
            across: across.to_string(),
            up: up.to_string(),
            held: nodes(held).first().map(|at| Standing {
                axis: held.to_string(),
                at: *at,
            }),
            x: nodes(across),
            y: nodes(up),
            before_um: lengths(before),
            after_um: after.map(lengths),
        });
    }
    Ok(found)
}

/// The standard uncertainty of the position error over the working space from machines that the measurements allow; `None` of a
/// machine without one of the axes X, Y and Z.
///
/// # Errors
/// What [`Machine::state`] refuses of `others`.
pub fn uncertainty(
    machine: &Machine,
    others: &[(AxisName, f64)],
    ensemble: &Ensemble,
    (trials, seed): (u64, u64),
) -> Result<Option<Drawn>, ModelError> {
    let grid = MapGrid::over_travels(machine, [UNCERTAIN; 3], others)?;
    if grid.axes.is_empty() {
        return Ok(None);
    }
    let mut lengths = Lengths::default();
    let mut most = (-1.0, [0.0; 3]);
    for index in 0..grid.len() {
        let (place, pose) = grid.node(machine, index);
        let [x, y, z, ..] = ensemble.standard_uncertainty(&pose);
        let error = Vector3::new(x, y, z);
        lengths.take(&error);
        if error.norm() > most.0 {
            most = (error.norm(), by_axis(&grid, place));
        }
    }
    Ok(Some(Drawn {
        trials,
        seed,
        rms_um: 1e3 * lengths.rms(),
        max_um: 1e3 * most.0,
        at_mm: most.1,
    }))
}
