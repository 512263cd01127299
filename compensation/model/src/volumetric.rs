//! Volumetric error: the error of the tool over poses of all axes after alignment of the workpiece.
//!
//! The workpiece is aligned once, by the rigid motion that best fits the errors of all poses and tools. The alignment
//! removes an error that displaces the workpiece equally at every pose. It does not remove a location error of a rotary
//! axis, which displaces the workpiece differently at every angle. At a single rotary pose these two errors could not
//! be distinguished, so the poses cover the travels of all axes.
//!
//! Each axis is approached from one of its two sides, so that backlash is included.

use volcomp_curve::Field;
use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_vocabulary::{AxisName, Direction};

use crate::{axis::Axis, error::ModelError, machine::Machine, range::in_order};

/// Half the number of poses over which the workpiece is aligned. The other half are mirrored about the middle of the travels, so that an
/// error that is linear over a travel is aligned exactly.
const HALF_POSES: u32 = 2048;
/// Number of poses from which the search for the largest error starts.
const STARTS: usize = 32;
const SAMPLES: u32 = 33;
/// Number of groups into which the poses are divided; for each direction of the error, the search starts from the worst
/// pose of each group. Rotary axes rotate the contributions of the axes after them, so the worst pose overall may not
/// lead to the maximum.
const STARTS_A_DIRECTION: usize = 2;
/// Number of equidistant samples along an axis for combinations with samples of other axes.
const COMBINED_SAMPLES: u32 = 9;
/// Maximum number of poses of the rotary axes at which contributions of the linear axes are sampled.
const ROTARY_POSES: usize = 400;
/// Number of combinations of samples from which the search starts.
const COMBINATIONS: usize = 48;
/// Maximum number of rounds in which all axes are sampled in turn, since the worst position of one axis may depend on the others.
const ROUNDS: usize = 4;
/// Number of sampled maxima that are refined between the samples.
const REFINED: usize = 16;
/// Smallest step of the refinement, as a fraction of the travel.
const MIN_STEP: f64 = 1e-4;
/// Bases of the Halton sequence, one for each dimension.
const BASES: [u32; 14] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43];
/// Number of the first [poses of all axes](poses_of_all_axes) at which the uncertainty of the volumetric error is evaluated.
pub const UNCERTAINTY_POSES: usize = 1000;

/// The errors of a machine with one tool, for [`volumetric`].
pub struct ErrorField<'a> {
    /// The name of the tool in `[tools]`; empty for the tool in the spindle.
    pub tool: &'a str,
    /// The machine that defines the ideal tip and tool axis.
    pub machine: &'a Machine,
    /// The machines whose curves contribute to the errors; the search samples the [places](Machine::places) of all of them.
    pub curves: Vec<&'a Machine>,
    /// Position (mm) and rotation (rad) of the error at a pose, in workpiece axes.
    pub errors: &'a dyn Fn(&State) -> [f64; 6],
}

/// A value of the volumetric error and the pose at which it occurs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Worst {
    /// Length in mm for a position, angle in rad for a tilt.
    pub value: f64,
    /// The pose, mm and deg.
    pub at: Vec<(AxisName, f64)>,
    /// [`ErrorField::tool`] of the tool with which it occurs.
    pub tool: String,
}

/// The volumetric error over poses of all axes.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct VolumetricError {
    /// Number of poses over which the workpiece was aligned, per tool.
    pub poses: usize,
    /// Largest error of the tip before alignment, mm, found by a search from the worst poses.
    pub max_mm: f64,
    /// Root mean square of the error of the tip before alignment, mm.
    pub rms_mm: f64,
    /// Largest error of the tip after alignment, found by the same search.
    pub position: Worst,
    /// Root mean square of the error of the tip after alignment, mm.
    pub position_rms_mm: f64,
    /// Largest tilt of the tool axis after alignment, found by the same search.
    pub tilt: Worst,
    /// Root mean square of the tilt after alignment, rad.
    pub tilt_rms_rad: f64,
    /// The rigid-body alignment of the workpiece.
    pub alignment: RigidMotion,
}

/// Poses that cover the travels of all axes evenly; the same on every call.
///
/// # Errors
/// See [`Machine::state`].
pub fn poses_of_all_axes(machine: &Machine) -> Result<Vec<State>, ModelError> {
    places(machine.axes().len()).map(|place| place.state(machine)).collect()
}

/// The volumetric error of a machine with one or several tools (`fields`), which must have the same axes.
///
/// # Errors
/// An empty list of fields, or the errors of [`Machine::state`].
pub fn volumetric(fields: &[ErrorField<'_>]) -> Result<VolumetricError, ModelError> {
    let axes = fields.first().map_or(0, |of| of.machine.axes().len());
    let all: Vec<Place> = places(axes).collect();
    // The search also tries the opposite approach of each corner.
    let corners = (0..1_usize << axes).map(|corner| Place {
        shares: (0..axes).map(|axis| f64::from(u8::from(corner >> axis & 1 == 1))).collect(),
        approach: vec![Direction::Positive; axes],
    });
    let (mut sums, mut before) = (RigidSums::default(), Lengths::default());
    let mut found = Vec::new();
    for (index, field) in fields.iter().enumerate() {
        for place in &all {
            let at = field.at(place)?;
            sums.take(&at.tip_mm, &at.error_mm);
            before.take(&at.error_mm);
            found.push((index, place.clone(), at));
        }
    }
    let alignment = sums.motion();
    let (mut position, mut tilt) = (Lengths::default(), Lengths::default());
    for (_, _, at) in &found {
        position.take(&at.left_mm(&alignment));
        tilt.take(&at.tilt_rad(&alignment));
    }
    for place in corners {
        for (index, field) in fields.iter().enumerate() {
            let at = field.at(&place)?;
            found.push((index, place.clone(), at));
        }
    }
    let grounds: Vec<_> = fields.iter().map(SearchGround::of).collect();
    let search = Search { samples: rotary_samples(&grounds)?, found, grounds };
    Ok(VolumetricError {
        poses: all.len(),
        max_mm: search.worst(&|at| at.error_mm)?.value,
        rms_mm: before.rms(),
        position: search.worst(&|at| at.left_mm(&alignment))?,
        position_rms_mm: position.rms(),
        tilt: search.worst(&|at| at.tilt_rad(&alignment))?,
        tilt_rms_rad: tilt.rms(),
        alignment,
    })
}

struct Search<'a> {
    grounds: Vec<SearchGround<'a>>,
    /// Evenly distributed poses and corners, with the index of their field.
    found: Vec<(usize, Place, At)>,
    samples: Vec<RotarySample>,
}

struct SearchGround<'a> {
    field: &'a ErrorField<'a>,
    /// Sampling positions of the curves along each axis, as fractions of the travel.
    places: Vec<Vec<f64>>,
    has_directions: Vec<bool>,
    grids: Vec<GridNodes>,
}

impl<'a> SearchGround<'a> {
    fn of(field: &'a ErrorField<'a>) -> Self {
        let axes = field.machine.axes().iter();
        let has_directions = axes.map(|axis| {
            let mut machines = field.curves.iter();
            machines.any(|machine| machine.has_directions(axis.name))
        });
        Self {
            field,
            places: places_of_curves(field),
            has_directions: has_directions.collect(),
            grids: nodes_of_grids(field),
        }
    }

    fn approaches(&self, axis: usize) -> &'static [Direction] {
        let count = if self.has_directions[axis] { 2 } else { 1 };
        &Direction::BOTH[..count]
    }
}

impl<'a> Search<'a> {
    /// The largest length of a vector over all poses. The search starts from the poses with the largest length, from
    /// the poses with the largest component in each direction, and from [combinations](Self::combinations) of samples.
    /// NaN if a length is NaN.
    fn worst(&'a self, of: &dyn Fn(&At) -> Vector3<f64>) -> Result<Worst, ModelError> {
        let length = |at: &At| of(at).norm();
        let mut starts: Vec<_> = (self.found.iter()).map(|one| (length(&one.2), one)).collect();
        // Descending; in the total order NaN is the largest.
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut maxima = Vec::new();
        for (value, (field, place, _)) in starts.into_iter().take(STARTS) {
            let mut ascent = Ascent::from(&self.grounds[*field], place.clone(), value);
            if !value.is_nan() {
                ascent.sample_axes(false, &length)?;
            }
            maxima.push(ascent);
        }
        let mut places: Vec<(usize, Place)> = Vec::new();
        for direction in directions() {
            let component = |at: &At| of(at).dot(&direction);
            let group = self.found.len().div_ceil(STARTS_A_DIRECTION).max(1);
            for part in self.found.chunks(group) {
                let values = part.iter().map(|one| (component(&one.2), one));
                let largest = values.max_by(|a, b| a.0.total_cmp(&b.0));
                let Some((value, (field, place, _))) = largest else {
                    continue;
                };
                let mut ascent = Ascent::from(&self.grounds[*field], place.clone(), value);
                ascent.sample(&component)?;
                places.push((*field, ascent.place));
            }
        }
        places.extend(self.combinations(of));
        for (number, start) in places.iter().enumerate() {
            // Several directions may give the same place.
            if !places[..number].contains(start) {
                maxima.push(self.sampled(start.0, start.1.clone(), &length)?);
            }
        }
        maxima.sort_by(|a, b| b.value.total_cmp(&a.value));
        maxima.dedup_by(|a, b| a.value == b.value && a.place.shares == b.place.shares);
        maxima.truncate(REFINED);
        let mut largest: Option<Ascent<'_>> = None;
        for mut ascent in maxima {
            if !ascent.value.is_nan() {
                ascent.refine(&length)?;
            }
            if largest.as_ref().is_none_or(|most| ascent.value > most.value) {
                largest = Some(ascent);
            }
        }
        Ok(largest.map_or_else(Worst::default, |of| Worst {
            value: of.value,
            at: of.place.coordinates(of.ground.field.machine),
            tool: of.ground.field.tool.to_owned(),
        }))
    }

    fn sampled(
        &'a self,
        field: usize,
        place: Place,
        size: &dyn Fn(&At) -> f64,
    ) -> Result<Ascent<'a>, ModelError> {
        let ground = &self.grounds[field];
        let value = size(&ground.field.at(&place)?);
        let mut ascent = Ascent::from(ground, place, value);
        ascent.sample(size)?;
        Ok(ascent)
    }

    /// Combinations of samples of all axes at which the length is probably large, each with the index of its field.
    ///
    /// The length is not a sum over the axes: a narrow peak of one axis may lower the length at one pose and raise it
    /// at another. The vector, however, is a sum of contributions of the linear axes for fixed rotary axes, except for
    /// small levers, and the length is the maximum of the vector's components over all directions. So the largest
    /// contributions are added for each direction.
    fn combinations(&self, of: &dyn Fn(&At) -> Vector3<f64>) -> Vec<(usize, Place)> {
        let mut found: Vec<(f64, usize, Place)> = Vec::new();
        for sample in &self.samples {
            let base = of(&sample.at);
            let contributions = sample.of_axes.iter().map(|samples| {
                let vectors = samples.iter().map(|one| (of(&one.at) - base, one));
                vectors.collect::<Vec<_>>()
            });
            let contributions: Vec<_> = contributions.collect();
            for direction in directions() {
                let (mut sum, mut place) = (base, sample.place.clone());
                for vectors in &contributions {
                    let along = |of: &(Vector3<f64>, &LinearSample)| of.0.dot(&direction);
                    let largest = vectors.iter().max_by(|a, b| along(a).total_cmp(&along(b)));
                    if let Some((vector, one)) = largest {
                        sum += vector;
                        place.shares[one.axis] = one.share;
                        place.approach[one.axis] = one.approach;
                    }
                }
                found.push((sum.norm(), sample.field, place));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.dedup_by(|a, b| a.0 == b.0 && a.2.shares == b.2.shares);
        let largest = found.into_iter().take(COMBINATIONS);
        largest.map(|(_, field, place)| (field, place)).collect()
    }
}

/// The errors at a pose of the rotary axes: with all linear axes in the middle of their travels, and with one linear
/// axis at each of its samples.
struct RotarySample {
    field: usize,
    place: Place,
    at: At,
    of_axes: Vec<Vec<LinearSample>>,
}

struct LinearSample {
    axis: usize,
    share: f64,
    approach: Direction,
    at: At,
}

/// Samples of all fields: at equidistant fractions of the travels and at the places of the curves. Axes with
/// direction-dependent curves are sampled with approach from both sides.
fn rotary_samples(grounds: &[SearchGround<'_>]) -> Result<Vec<RotarySample>, ModelError> {
    let mut samples = Vec::new();
    for (number, ground) in grounds.iter().enumerate() {
        for place in rotary_poses(ground) {
            samples.push(RotarySample {
                field: number,
                at: ground.field.at(&place)?,
                of_axes: linear_samples(ground, &place)?,
                place,
            });
        }
    }
    Ok(samples)
}

fn linear_samples(
    ground: &SearchGround<'_>,
    rest: &Place,
) -> Result<Vec<Vec<LinearSample>>, ModelError> {
    let mut of_axes = Vec::new();
    let axes = ground.field.machine.axes().iter();
    for (axis, (one, places)) in axes.zip(&ground.places).enumerate() {
        if one.name.is_rotary() {
            continue;
        }
        let mut samples = Vec::new();
        for share in shares(COMBINED_SAMPLES, places) {
            for &approach in ground.approaches(axis) {
                let mut place = rest.clone();
                (place.shares[axis], place.approach[axis]) = (share, approach);
                samples.push(LinearSample { axis, share, approach, at: ground.field.at(&place)? });
            }
        }
        of_axes.push(samples);
    }
    Ok(of_axes)
}

/// Poses of the rotary axes at their samples, thinned evenly to at most `ROTARY_POSES`, with approach from both sides
/// if a curve depends on the direction. The linear axes are in the middle of their travels.
fn rotary_poses(ground: &SearchGround<'_>) -> Vec<Place> {
    let axes = ground.field.machine.axes();
    let rotary: Vec<(usize, Vec<f64>)> = (axes.iter().zip(&ground.places).enumerate())
        .filter(|(_, (axis, _))| axis.name.is_rotary())
        .map(|(index, (_, places))| (index, shares(COMBINED_SAMPLES, places).collect()))
        .collect();
    let most = (1..=ROTARY_POSES).rev().find(|most| {
        let counts = rotary.iter().map(|(_, shares)| shares.len().min(*most));
        counts.product::<usize>() <= ROTARY_POSES
    });
    let sides = rotary.iter().map(|(axis, _)| ground.approaches(*axis));
    let sides = sides.max_by_key(|sides| sides.len());
    let pose = |side: &Direction| Place {
        shares: vec![0.5; axes.len()],
        approach: vec![*side; axes.len()],
    };
    let sides = sides.unwrap_or(&[Direction::Positive]);
    let mut poses: Vec<Place> = sides.iter().map(pose).collect();
    for (axis, shares) in rotary {
        let step = shares.len().div_ceil(most.unwrap_or(1)).max(1);
        let mut turned = Vec::new();
        for pose in &poses {
            for share in shares.iter().step_by(step) {
                let mut pose = pose.clone();
                pose.shares[axis] = *share;
                turned.push(pose);
            }
        }
        poses = turned;
    }
    poses
}

/// Two axes, and the fractions of their travels at which a grid over them has nodes.
type GridNodes = [(usize, Vec<f64>); 2];

/// Equidistant fractions of a travel, and the places of curves as fractions.
fn shares(equal: u32, places: &[f64]) -> impl Iterator<Item = f64> {
    let share = move |sample| f64::from(sample) / f64::from(equal - 1);
    (0..equal).map(share).chain(places.iter().copied())
}

/// Coordinates as fractions of the travel of an axis; coordinates outside the travel are omitted.
fn shares_of<'a>(axis: &Axis, at: &'a [f64]) -> impl Iterator<Item = f64> + use<'a> {
    let [low, high] = axis.travel;
    let shares = at.iter().map(move |at| (at - low) / (high - low));
    shares.filter(|share| (0.0..=1.0).contains(share))
}

/// Positions along each axis at which the search samples the curves of all machines of a field, as fractions of the
/// travel.
fn places_of_curves(field: &ErrorField<'_>) -> Vec<Vec<f64>> {
    let axes = field.machine.axes();
    let mut nodes = vec![Vec::new(); axes.len()];
    let mut of_curves = vec![Vec::new(); axes.len()];
    for machine in &field.curves {
        for (all, of_machine) in nodes.iter_mut().zip(machine.nodes()) {
            all.extend(of_machine);
        }
        for (name, error) in machine.errors() {
            for of in error.fields() {
                if let (Field::Curve(curve), Ok(axis)) = (of, machine.index_of(name.axis)) {
                    of_curves[axis].push(curve.places());
                }
            }
        }
    }
    let of_axes = axes.iter().zip(nodes).zip(of_curves);
    let of_axes = of_axes.map(|((axis, mut nodes), of_curves)| {
        nodes.extend(axis.travel);
        shares_of(axis, &thinned(nodes, &of_curves)).collect()
    });
    of_axes.collect()
}

/// All nodes, and of the places of the curves only as many that no two neighbours are further apart than those of the
/// densest curve there. The search refines what it finds, so all places of many curves would only take time.
fn thinned(mut nodes: Vec<f64>, of_curves: &[Vec<f64>]) -> Vec<f64> {
    in_order(&mut nodes);
    let mut all = of_curves.concat();
    all.extend(&nodes);
    in_order(&mut all);
    let gap_at = |place: f64| {
        let gaps = of_curves.iter().filter_map(|places| {
            let next = places.partition_point(|other| *other <= place);
            Some(places.get(next)? - places.get(next.checked_sub(1)?)?)
        });
        // Equal gaps may differ in the last digits.
        gaps.fold(f64::INFINITY, f64::min) * 1.001
    };
    let mut kept: Vec<f64> = Vec::new();
    for (index, &place) in all.iter().enumerate() {
        let leaves_gap = match (kept.last(), all.get(index + 1)) {
            (Some(last), Some(next)) => next - last > gap_at(*last).min(gap_at(place)),
            _ => true,
        };
        if leaves_gap || nodes.binary_search_by(|node| node.total_cmp(&place)).is_ok() {
            kept.push(place);
        }
    }
    kept
}

fn nodes_of_grids(field: &ErrorField<'_>) -> Vec<GridNodes> {
    let axes = field.machine.axes();
    let errors = field.curves.iter().flat_map(|machine| machine.errors());
    let mut of_grids = Vec::new();
    for (_, curve) in errors {
        for of in curve.fields() {
            let Field::Grid(grid) = of else { continue };
            let (on, nodes) = (grid.axes(), grid.nodes());
            if on.iter().all(|axis| *axis < axes.len()) {
                of_grids.push([0, 1].map(|i| {
                    let axis = on[i];
                    (axis, shares_of(&axes[axis], &nodes[i]).collect())
                }));
            }
        }
    }
    of_grids
}

struct Ascent<'a> {
    ground: &'a SearchGround<'a>,
    place: Place,
    value: f64,
}

impl<'a> Ascent<'a> {
    fn from(ground: &'a SearchGround<'a>, place: Place, value: f64) -> Self {
        Self { ground, place, value }
    }

    /// Moves to `place` if the quantity is larger there, and returns whether it moved.
    fn try_place(&mut self, place: Place, size: &dyn Fn(&At) -> f64) -> Result<bool, ModelError> {
        let value = size(&self.ground.field.at(&place)?);
        let is_larger = value > self.value;
        if is_larger {
            (self.value, self.place) = (value, place);
        }
        Ok(is_larger)
    }

    fn with(&self, axis: usize, share: f64) -> Place {
        let mut place = self.place.clone();
        place.shares[axis] = share.clamp(0.0, 1.0);
        place
    }

    /// Samples the nodes of grids over two axes, then positions along each axis, including the
    /// nodes of its curves.
    fn sample(&mut self, size: &dyn Fn(&At) -> f64) -> Result<(), ModelError> {
        for [(first, of_first), (second, of_second)] in &self.ground.grids {
            for a in of_first {
                for b in of_second {
                    let mut place = self.with(*first, *a);
                    place.shares[*second] = *b;
                    self.try_place(place, size)?;
                }
            }
        }
        self.sample_axes(true, size)
    }

    fn sample_axes(
        &mut self,
        at_places: bool,
        size: &dyn Fn(&At) -> f64,
    ) -> Result<(), ModelError> {
        let axes = self.place.shares.len();
        // Number of consecutive axes at their maximum with the other axes at their present positions.
        let mut settled = 0;
        for axis in (0..axes).cycle().take(ROUNDS * axes) {
            let mut is_better = false;
            let places = at_places.then(|| &self.ground.places[axis][..]);
            for share in shares(SAMPLES, places.unwrap_or_default()) {
                let mut place = self.with(axis, share);
                is_better |= self.try_place(place.clone(), size)?;
                // A peak may exist in the curve of one direction of approach only.
                if self.ground.has_directions[axis] {
                    place.approach[axis] = -place.approach[axis];
                    is_better |= self.try_place(place, size)?;
                }
            }
            settled = if is_better { 1 } else { settled + 1 };
            if settled == axes {
                break;
            }
        }
        Ok(())
    }

    /// Moves each axis by decreasing steps, and also tries the opposite direction of approach.
    fn refine(&mut self, size: &dyn Fn(&At) -> f64) -> Result<(), ModelError> {
        let mut step = 1.0 / f64::from(SAMPLES - 1);
        while step > MIN_STEP {
            let mut is_better = false;
            for axis in 0..self.place.shares.len() {
                let mut place = self.place.clone();
                place.approach[axis] = -place.approach[axis];
                is_better |= self.try_place(place, size)?;
                for by in [step, -step] {
                    let share = self.place.shares[axis] + by;
                    is_better |= self.try_place(self.with(axis, share), size)?;
                }
            }
            if !is_better {
                step *= 0.5;
            }
        }
        Ok(())
    }
}

struct At {
    tip_mm: Vector3<f64>,
    tool_axis: Vector3<f64>,
    error_mm: Vector3<f64>,
    rotation_rad: Vector3<f64>,
}

impl At {
    fn left_mm(&self, alignment: &RigidMotion) -> Vector3<f64> {
        alignment.left_mm(&self.tip_mm, &self.error_mm)
    }

    /// Tilt of the tool axis after alignment: a rotation about the tool axis has no effect on a rotating tool.
    fn tilt_rad(&self, alignment: &RigidMotion) -> Vector3<f64> {
        let left = alignment.left_rad(&self.rotation_rad);
        left - self.tool_axis * self.tool_axis.dot(&left)
    }
}

impl ErrorField<'_> {
    fn at(&self, place: &Place) -> Result<At, ModelError> {
        let pose = place.state(self.machine)?;
        let [x, y, z, a, b, c] = (self.errors)(&pose);
        let chain = self.machine.chain();
        Ok(At {
            tip_mm: chain.ideal_tip_mm(&pose),
            tool_axis: chain.ideal_pose(&pose).rotation * chain.tool_axis(),
            error_mm: Vector3::new(x, y, z),
            rotation_rad: Vector3::new(a, b, c),
        })
    }
}

/// A pose by fractions of the travels, and the side from which each axis is approached.
#[derive(Clone, PartialEq)]
struct Place {
    shares: Vec<f64>,
    approach: Vec<Direction>,
}

impl Place {
    fn coordinates(&self, machine: &Machine) -> Vec<(AxisName, f64)> {
        let axes = machine.axes().iter().zip(&self.shares);
        axes.map(|(axis, share)| {
            let [low, high] = axis.travel;
            (axis.name, low + (high - low) * share)
        })
        .collect()
    }

    fn state(&self, machine: &Machine) -> Result<State, ModelError> {
        let mut state = machine.state(&self.coordinates(machine))?;
        for (to, from) in state.approach.iter_mut().zip(&self.approach) {
            *to = Some(*from);
        }
        Ok(state)
    }
}

/// Fractions of the travels of all axes: the Halton sequence, and its mirror image with the
/// opposite approach.
fn places(axes: usize) -> impl Iterator<Item = Place> {
    (1..=HALF_POSES).flat_map(move |number| {
        // The fractional parts of the multiples of an irrational root are above and below one half equally often,
        // independent of the Halton fractions.
        let side = |axis: usize| {
            let root = f64::from(BASES[axis % BASES.len()]).sqrt();
            Direction::of((f64::from(number) * root).fract() - 0.5)
        };
        let drawn = Place {
            shares: (0..axes).map(|axis| halton(number, axis)).collect(),
            approach: (0..axes).map(|axis| side(axis).unwrap_or(Direction::Positive)).collect(),
        };
        let mirrored = Place {
            shares: drawn.shares.iter().map(|share| 1.0 - share).collect(),
            approach: drawn.approach.iter().map(|side| -*side).collect(),
        };
        [drawn, mirrored]
    })
}

/// A coordinate of a point of the Halton sequence, 0 to 1: the radical inverse of `number` in the base of the dimension (from 0). Bases
/// repeat after 14 dimensions.
pub fn halton(number: u32, dimension: usize) -> f64 {
    let base = BASES[dimension % BASES.len()];
    let (mut share, mut weight, mut rest) = (0.0, 1.0, number);
    while rest > 0 {
        weight /= f64::from(base);
        share += weight * f64::from(rest % base);
        rest /= base;
    }
    share
}

/// Threshold of the squared ratio of the points' distance from a line to their spread along it: 10 µm in 100 m. Below it the rotation about the line
/// cannot be distinguished from rounding errors.
const COLLINEAR_BELOW: f64 = 1e-14;

/// Sums over points and their error vectors, which determine the best-fit rigid motion.
///
/// State: means, and second moments about the means, updated with each point (Welford), so that points far from zero lose no digits.
/// [`merge`](Self::merge) combines partial sums.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidSums {
    count: f64,
    place_mm: Vector3<f64>,
    error_mm: Vector3<f64>,
    /// Σ p pᵀ, p relative to the mean.
    places: Matrix3<f64>,
    /// Σ p eᵀ, both relative to their means.
    products: Matrix3<f64>,
    /// Σ |e|², e relative to the mean.
    squares: f64,
}

impl RigidSums {
    /// Adds a point and its error vector, both in workpiece axes, mm.
    pub fn take(&mut self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) {
        self.merge(&Self {
            count: 1.0,
            place_mm: *place_mm,
            error_mm: *error_mm,
            ..Self::default()
        });
    }

    /// Adds the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        if count == 0.0 {
            return;
        }
        let (place, error) = (other.place_mm - self.place_mm, other.error_mm - self.error_mm);
        let share = other.count / count;
        let both = self.count * share;
        self.places += other.places + place * place.transpose() * both;
        self.products += other.products + place * error.transpose() * both;
        self.squares += other.squares + error.norm_squared() * both;
        self.place_mm += place * share;
        self.error_mm += error * share;
        self.count = count;
    }

    /// The least-squares rigid motion. A rotation that the points do not determine (about a line through all of them, or about a single point) is
    /// zero. Points or errors that are not finite give NaN.
    pub fn motion(&self) -> RigidMotion {
        // With points and errors relative to their means, the translation is the mean error, and the rotation ω solves
        // Σ (|p|² − p pᵀ) ω = Σ p × e.
        RigidMotion {
            about_mm: self.place_mm,
            shift_mm: self.error_mm,
            rotation_rad: self.rotation(),
        }
    }

    /// Root mean square after best-fit rigid-body alignment, mm; 0 without a point. The value is a
    /// difference of sums: for errors of 1 mm that are an exact rigid motion, rounding leaves about
    /// 1e-8 mm.
    pub fn rms_left_mm(&self) -> f64 {
        let left = self.squares - self.rotation().dot(&self.turning());
        (left.max(0.0) / self.count.max(1.0)).sqrt()
    }

    /// Σ p × e.
    fn turning(&self) -> Vector3<f64> {
        let of = &self.products;
        Vector3::new(of[(1, 2)] - of[(2, 1)], of[(2, 0)] - of[(0, 2)], of[(0, 1)] - of[(1, 0)])
    }

    fn rotation(&self) -> Vector3<f64> {
        let turning = self.turning();
        let extent = self.places.trace();
        if extent == 0.0 {
            return Vector3::zeros();
        }
        // Both sides are divided by the extent, so that the threshold does not depend on the size of the machine or the
        // unit.
        let matrix = Matrix3::identity() - self.places / extent;
        let right = turning / extent;
        if !matrix.iter().chain(&right).all(|x| x.is_finite()) {
            return Vector3::repeat(f64::NAN);
        }
        let eigen = matrix.symmetric_eigen();
        let columns = eigen.eigenvectors.column_iter();
        columns
            .zip(&eigen.eigenvalues)
            .filter(|(_, value)| **value > COLLINEAR_BELOW)
            .map(|(about, value)| about * (about.dot(&right) / value))
            .sum()
    }
}

/// A small rigid motion: a rotation about a point, and a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RigidMotion {
    /// Centre of rotation, mm: the mean of the fitted points.
    pub about_mm: Vector3<f64>,
    /// Translation of the point `about_mm`, mm.
    pub shift_mm: Vector3<f64>,
    /// Small rotation about `about_mm`, as a vector along its axis, rad.
    pub rotation_rad: Vector3<f64>,
}

impl RigidMotion {
    /// Displacement of a point by the motion, mm.
    pub fn at_mm(&self, place_mm: &Vector3<f64>) -> Vector3<f64> {
        self.shift_mm + self.rotation_rad.cross(&(place_mm - self.about_mm))
    }

    /// Error at a point minus its displacement by the motion, mm.
    pub fn left_mm(&self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) -> Vector3<f64> {
        error_mm - self.at_mm(place_mm)
    }

    /// Orientation error minus the rotation of the motion, rad.
    pub fn left_rad(&self, rotation_rad: &Vector3<f64>) -> Vector3<f64> {
        rotation_rad - self.rotation_rad
    }
}

/// Root mean square and maximum length of vectors, in their unit (mm or rad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lengths {
    count: f64,
    squares: f64,
    largest: f64,
}

impl Lengths {
    /// Adds a vector.
    pub fn take(&mut self, vector: &Vector3<f64>) {
        let squared = vector.norm_squared();
        self.merge(&Self { count: 1.0, squares: squared, largest: squared.sqrt() });
    }

    /// Adds the vectors of another instance.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.squares += other.squares;
        self.largest = self.largest.max(other.largest);
    }

    /// Root mean square, in the unit of the vectors; 0 without a vector.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count.max(1.0)).sqrt()
    }

    /// Maximum length, in the unit of the vectors; 0 without a vector.
    pub fn max(&self) -> f64 {
        self.largest
    }
}

/// Unit vectors to the corners, edges and faces of a cube.
pub(crate) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..27).filter_map(|number| {
        let of = |divisor: i32| f64::from(number / divisor % 3 - 1);
        Vector3::new(of(1), of(3), of(9)).try_normalize(0.5)
    })
}
