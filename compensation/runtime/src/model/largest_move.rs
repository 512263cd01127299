//! Largest change of the correction when one model replaces another.
//!
//! The change is sampled at the corners and the centre of the work space and at the sampling positions of the curves,
//! in either direction of approach. Coordinate ascent then starts from the largest changes found.

use volcomp_kinematics::{Correctors, State};
use volcomp_model::{Machine, curve::Field};
use volcomp_vocabulary::{Direction, Displacement, Mm, PerAxis, Rad};

use super::Model;

/// Maximum number of sampled states, apart from those at curve nodes.
const MAX_STATES: usize = 5000;
/// Maximum number of sampled states at curve nodes. With more states the result is infinite, and the operator must
/// check the change.
const MAX_NODE_STATES: usize = 100_000;
/// Number of additional equidistant intervals per axis. An axis without errors has no curve, but its position may
/// change the lever arms of other axes.
const PLACES: usize = 25;
/// Maximum number of states in the coordinate ascent. It is raised to the number of states of one pass, but
/// not above `MAX_NODE_STATES`.
const MAX_CLIMB_STATES: usize = 40_000;
const MAX_PASSES: usize = 2;
/// Number of points with the largest changes that are also sampled with the other axes at the ends of their travel.
const MAX_BEST_NODES: usize = 20;

/// Largest change of the correction in the work space when one model replaces another. Infinite if the axes differ, or if there are too many
/// nodes to compare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LargestMove {
    pub linear: Mm,
    pub rotary: Rad,
}

impl LargestMove {
    const NONE: Self = Self { linear: Mm(0.0), rotary: Rad(0.0) };

    /// The larger linear and the larger rotary change of two results.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            linear: Mm(self.linear.0.max(other.linear.0)),
            rotary: Rad(self.rotary.0.max(other.rotary.0)),
        }
    }
}

struct Pair<'a> {
    models: [&'a Model; 2],
    correctors: [Correctors; 2],
    worst: LargestMove,
    left: usize,
    /// For each axis, the largest change of its correction in either direction (mm or rad) and the state with it.
    most: PerAxis<[(f64, State); 2]>,
}

impl<'a> Pair<'a> {
    fn new(
        models: [&'a Model; 2],
        correctors: [Correctors; 2],
        worst: LargestMove,
        left: usize,
    ) -> Self {
        Self { models, correctors, worst, left, most: PerAxis::default() }
    }

    /// Returns the change of the correction at a state, and updates `worst` and `most`. Returns `NONE` once `left`, the
    /// number of remaining evaluations, is 0.
    fn sample(&mut self, state: &State) -> LargestMove {
        if self.left == 0 {
            return LargestMove::NONE;
        }
        self.left -= 1;
        let of = |place: usize| self.models[place].correction_of(state, &self.correctors[place]);
        let [before, after] = [of(0).delta, of(1).delta];
        let mut worst = [0.0_f64; 2];
        for (index, name) in self.models[0].axes.iter().enumerate() {
            let moved = after[index] - before[index];
            for (most, moved) in self.most[index].iter_mut().zip([moved, -moved]) {
                if moved > most.0 {
                    *most = (moved, *state);
                }
            }
            let moved = moved.abs();
            let worst = &mut worst[usize::from(name.is_rotary())];
            *worst = worst.max(if moved.is_nan() { f64::INFINITY } else { moved });
        }
        let moved = LargestMove { linear: Mm(worst[0]), rotary: Rad(worst[1]) };
        self.worst = self.worst.max(moved);
        moved
    }

    fn sample_from(&mut self, q: &PerAxis<f64>, directions: &[PerAxis<Option<Direction>>]) -> f64 {
        let moves = directions.iter().map(|approach| {
            let state = State { q: *q, approach: *approach };
            let moved = self.sample(&state);
            // One number that ranks positions: a milliradian counts like a millimetre.
            moved.linear.0 + moved.rotary.0
        });
        moves.fold(0.0, f64::max)
    }
}

impl Model {
    /// Largest change of the correction in the work space when `other` replaces this model, over both directions of
    /// approach. `ways` are the correcting axes of each controller path, with this model and with the other one. The
    /// change depends on the correcting axes, so it is evaluated for each path, and for all axes together.
    pub fn largest_move(
        &self,
        other: &Self,
        ways: impl IntoIterator<Item = [Correctors; 2]>,
    ) -> LargestMove {
        if self.axes != other.axes {
            return LargestMove { linear: Mm(f64::INFINITY), rotary: Rad(f64::INFINITY) };
        }
        let all = [self, other].map(|model| model.correctors_among(&model.axes));
        let mut sets: Vec<[Correctors; 2]> = Vec::new();
        for pair in ways.into_iter().chain([all]) {
            if !sets.contains(&pair) {
                sets.push(pair);
            }
        }
        let space = Space::of(self, other);
        if space.node_states() * sets.len() > MAX_NODE_STATES {
            return LargestMove { linear: Mm(f64::INFINITY), rotary: Rad(f64::INFINITY) };
        }
        let left = MAX_STATES / sets.len() + space.node_states();
        sets.into_iter().fold(LargestMove::NONE, |worst, correctors| {
            let mut pair = Pair::new([self, other], correctors, worst, left);
            space.sample(&mut pair);
            pair.worst
        })
    }
}

/// Sampling positions in the work space of two models, mm and rad.
struct Space {
    ends: Vec<Vec<f64>>,
    middle: PerAxis<f64>,
    /// Sampling positions of the curves and equidistant positions, by axis.
    places: Vec<Vec<f64>>,
    /// Nodes of grids over two axes, and positions of pairs of rotary axes: the product of two rotations is largest with both turned.
    grids: Vec<GridNodes>,
    /// The relevant directions of approach: all axes in the same direction, and each reversing axis
    /// opposite to the others.
    directions: Vec<PerAxis<Option<Direction>>>,
}

impl Space {
    fn of(old: &Model, new: &Model) -> Self {
        let mut space = Self {
            ends: Vec::new(),
            middle: PerAxis::default(),
            places: Vec::new(),
            grids: Vec::new(),
            directions: Vec::new(),
        };
        for axis in 0..old.axes.len() {
            let mut ends = Vec::new();
            let mut places = Vec::new();
            for model in [old, new] {
                let [low, high] = model.travel[axis].map(Displacement::mm_or_rad);
                space.middle[axis] = f64::midpoint(low, high);
                ends.extend([low, high]);
                // Both ends of ±360° and the centre are the same pose, so equidistant positions cover one turn.
                let whole = if old.axes[axis].is_rotary() {
                    (high - low).min(std::f64::consts::TAU)
                } else {
                    high - low
                };
                let at = |part: usize, of: usize| low + whole * part as f64 / of as f64;
                places.extend((0..=PLACES).map(|part| at(part, PLACES)));
                places.push(high);
                places.extend(&model.places[axis]);
            }
            for list in [&mut ends, &mut places] {
                list.sort_by(f64::total_cmp);
                list.dedup();
            }
            space.ends.push(ends);
            space.places.push(places);
        }
        for model in [old, new] {
            let more = model.grids.iter().filter(|grid| !space.grids.contains(grid));
            let more: Vec<GridNodes> = more.cloned().collect();
            space.grids.extend(more);
        }
        let rotary = (0..old.axes.len()).filter(|axis| old.axes[*axis].is_rotary());
        let rotary: Vec<usize> = rotary.collect();
        for (index, one) in rotary.iter().enumerate() {
            for other in &rotary[index + 1..] {
                let axes = [*one, *other];
                let nodes = axes.map(|axis| thinned(&space.places[axis], PLACES).collect());
                space.grids.push(GridNodes { axes, nodes });
            }
        }
        space.directions = directions(old, new);
        space
    }

    /// The one or two directions of approach in which every position is sampled.
    fn both(&self) -> &[PerAxis<Option<Direction>>] {
        &self.directions[..self.directions.len().min(2)]
    }

    /// Number of states at the positions along the axes and at the grid nodes, all of which are sampled.
    fn node_states(&self) -> usize {
        let along: usize = self.places.iter().map(Vec::len).sum();
        let of_grid = |grid: &GridNodes| grid.nodes[0].len().saturating_mul(grid.nodes[1].len());
        let on_grids = self.grids.iter().map(of_grid);
        on_grids.fold(along, usize::saturating_add).saturating_mul(self.both().len())
    }

    fn sample(&self, pair: &mut Pair<'_>) {
        let whole = pair.left.saturating_sub(self.node_states());
        // A third for the corners, the rest for the points with the largest changes.
        self.corners(pair, whole / 3);
        // Positions along each axis, with all others centred, at which the correction of an axis
        // changes most.
        let mut along = Vec::new();
        for (axis, places) in self.places.iter().enumerate() {
            let before = std::mem::take(&mut pair.most);
            let points = places.iter().map(|place| vec![(axis, *place)]);
            self.sample_points(pair, points);
            along.push(pair.most);
            for (most, before) in pair.most.iter_mut().zip(before) {
                for (most, before) in most.iter_mut().zip(before) {
                    if before.0 > most.0 {
                        *most = before;
                    }
                }
            }
        }
        for GridNodes { axes: [one, two], nodes } in &self.grids {
            let points = nodes[0].iter().flat_map(|a| {
                let row = nodes[1].iter();
                row.map(move |b| vec![(*one, *a), (*two, *b)])
            });
            self.sample_points(pair, points);
        }
        self.climb(pair, &along);
    }

    /// Coordinate ascent: moves one axis at a time to its largest change. It starts from the largest change found, and from the combined
    /// maxima of the single axes, because a scan along one axis does not show the sum of two contributions.
    fn climb(&self, pair: &mut Pair<'_>, along: &[PerAxis<[(f64, State); 2]>]) {
        let axes = pair.models[0].axes.len();
        let goals: Vec<(usize, usize)> = (0..axes)
            .flat_map(|axis| [(axis, 0), (axis, 1)])
            .filter(|(axis, sign)| pair.most[*axis][*sign].0 > 0.0)
            .collect();
        let round = goals.len() * self.places.iter().map(Vec::len).sum::<usize>();
        pair.left = MAX_CLIMB_STATES.max(round.min(MAX_NODE_STATES));
        for (goal, sign) in &goals {
            let mut together = State::default();
            for (axis, most) in along.iter().enumerate() {
                let (moved, at) = most[*goal][*sign];
                let is_found = moved > 0.0;
                together.q[axis] = if is_found { at.q[axis] } else { self.middle[axis] };
                together.approach[axis] =
                    if is_found { at.approach[axis] } else { Some(Direction::Positive) };
            }
            pair.sample(&together);
            pair.sample_from(&together.q, &self.directions);
        }
        for _ in 0..MAX_PASSES {
            let before = pair.most;
            for (goal, sign) in &goals {
                for axis in 0..axes {
                    let (_, from) = pair.most[*goal][*sign];
                    let mut state = from;
                    for place in &self.places[axis] {
                        state.q[axis] = *place;
                        pair.sample(&state);
                    }
                    if self.both().len() > 1 {
                        let (_, mut turned) = pair.most[*goal][*sign];
                        for direction in Direction::BOTH {
                            turned.approach[axis] = Some(direction);
                            pair.sample(&turned);
                        }
                    }
                }
            }
            let rose = |(goal, sign): &(usize, usize)| {
                pair.most[*goal][*sign].0 > 1.01 * before[*goal][*sign].0
            };
            if !goals.iter().any(rose) {
                break;
            }
        }
    }

    /// Samples points that fix one or two axes, with the other axes centred; the points with the largest changes are also sampled with the other
    /// axes at their ends.
    fn sample_points(&self, pair: &mut Pair<'_>, points: impl Iterator<Item = Vec<(usize, f64)>>) {
        let at = |mut q: PerAxis<f64>, point: &[(usize, f64)]| {
            for (axis, place) in point {
                q[*axis] = *place;
            }
            q
        };
        let mut found: Vec<_> = points
            .map(|point| (pair.sample_from(&at(self.middle, &point), self.both()), point))
            .collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, point) in found.into_iter().take(MAX_BEST_NODES) {
            for ends in self.diagonals() {
                pair.sample_from(&at(ends, &point), self.both());
            }
        }
    }

    /// Samples the centre and the corners of the work space and, within the budget, combinations of centres and ends, in all relevant
    /// directions of approach.
    fn corners(&self, pair: &mut Pair<'_>, at_most: usize) {
        let with_middles: Vec<Vec<f64>> = (self.ends.iter().enumerate())
            .map(|(axis, ends)| {
                let mut all = ends.clone();
                all.push(self.middle[axis]);
                all
            })
            .collect();
        let count = |grid: &[Vec<f64>]| {
            let sizes = grid.iter().map(Vec::len);
            sizes.fold(self.directions.len(), usize::saturating_mul)
        };
        let grid = if count(&with_middles) <= at_most { &with_middles } else { &self.ends };
        pair.sample_from(&self.middle, &self.directions);
        let all = grid.iter().map(Vec::len).product::<usize>();
        // If there are too many corners, an evenly spread subset is sampled.
        let step = (count(grid).div_ceil(at_most.max(1))).max(1) | 1;
        for number in (0..all).step_by(step) {
            let mut q = PerAxis::default();
            let mut rest = number;
            for (axis, places) in grid.iter().enumerate() {
                q[axis] = places[rest % places.len()];
                rest /= places.len();
            }
            pair.sample_from(&q, &self.directions);
        }
    }

    /// Four corners of the work space that are far apart, mm and rad.
    fn diagonals(&self) -> impl Iterator<Item = PerAxis<f64>> + '_ {
        (0..4_usize).map(|number| {
            let mut q = PerAxis::default();
            for (axis, ends) in self.ends.iter().enumerate() {
                let is_high = (number & 1 == 1) ^ (number & 2 == 2 && axis % 2 == 1);
                q[axis] = if is_high { ends[ends.len() - 1] } else { ends[0] };
            }
            q
        })
    }
}

fn directions(old: &Model, new: &Model) -> Vec<PerAxis<Option<Direction>>> {
    let all = |direction| PerAxis::from_fn(|_| Some(direction));
    let mut directions = vec![all(Direction::Positive)];
    let reversing = (0..old.axes.len()).filter(|axis| old.reverses[*axis] || new.reverses[*axis]);
    let reversing: Vec<usize> = reversing.collect();
    if reversing.is_empty() {
        return directions;
    }
    directions.push(all(Direction::Negative));
    if reversing.len() > 1 {
        for axis in reversing {
            let mut one = all(Direction::Positive);
            one[axis] = Some(Direction::Negative);
            directions.push(one);
        }
    }
    directions
}

fn thinned(places: &[f64], at_most: usize) -> impl Iterator<Item = f64> + '_ {
    let step = places.len().div_ceil(at_most.max(1)).max(1);
    places.iter().copied().step_by(step)
}

/// Converts coordinates along each axis from mm or deg to mm or rad.
pub(super) fn in_mm_or_rad(machine: &Machine, along: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let along = along.into_iter().enumerate();
    along.map(|(axis, coordinates)| places(machine, axis, &coordinates)).collect()
}

/// Converts coordinates of an axis from mm or deg to mm or rad; empty for an axis that does not exist.
fn places(machine: &Machine, axis: usize, coordinates: &[f64]) -> Vec<f64> {
    let Some(axis) = machine.axes().get(axis) else {
        return Vec::new();
    };
    let kind = axis.name.kind();
    let place = |q: &f64| Displacement::from_coordinate(kind, *q).mm_or_rad();
    coordinates.iter().map(place).collect()
}

/// The nodes of a grid over two axes, mm and rad.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GridNodes {
    pub(super) axes: [usize; 2],
    pub(super) nodes: [Vec<f64>; 2],
}

pub(super) fn grids(machine: &Machine) -> Vec<GridNodes> {
    let mut grids: Vec<GridNodes> = Vec::new();
    for (_, curve) in machine.errors() {
        for field in curve.fields() {
            let Field::Grid(grid) = field else { continue };
            let axes = grid.axes();
            let nodes = [0, 1].map(|side| places(machine, axes[side], &grid.nodes()[side]));
            let grid = GridNodes { axes, nodes };
            if !grids.contains(&grid) {
                grids.push(grid);
            }
        }
    }
    grids
}

pub(super) fn reverses(machine: &Machine) -> Vec<bool> {
    let axes = machine.axes().iter();
    axes.map(|axis| machine.has_directions(axis.name)).collect()
}

#[cfg(test)]
mod tests {
    use volcomp_model::{Fading, Machine};

    use super::*;

    const SMALL: &str = "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[errors]\n";
    const TURNING: &str = "structure = \"w X' b Y Z C t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[axes.C]\ntravel = [-360.0, 360.0]\n[errors]\n";

    const TILTING: &str = "structure = \"w C' A' b X Y Z t\"\n[axes.X]\ntravel = [0.0, 600.0]\n[axes.Y]\ntravel = [0.0, 500.0]\n[axes.Z]\ntravel = [-400.0, 0.0]\n[axes.A]\ntravel = [-110.0, 30.0]\npoint = [300.0, 250.0, -450.0]\n[axes.C]\ntravel = [-360.0, 360.0]\npoint = [300.0, 250.0, -450.0]\n[tool]\ntip=[0.0,0.0,-150.0]\n[errors]\n";

    fn model(machine: &str, errors: &str) -> Model {
        let machine = Machine::parse(&format!("{machine}{errors}"), "m");
        let machine = machine.unwrap_or_else(|e| panic!("{e}"));
        Model::new(&machine, Fading::default()).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Changes that appear only between the corners, or in one direction of approach, are found.
    #[test]
    fn changes_between_corners_are_found() {
        let flat = model(SMALL, "EYX = 0.0\n");
        for (errors, least_um) in [
            (
                "EYX = { table = [[0.0, 0.0], [400.0, 300.0], [800.0, 0.0]], interpolation = \"linear\" }\n",
                299.0,
            ),
            // A narrow peak at a node that no equidistant sampling meets.
            (
                "EYX = { table = [[0.0, 0.0], [36.0, 0.0], [37.0, 300.0], [38.0, 0.0], [800.0, 0.0]], interpolation = \"linear\" }\n",
                299.0,
            ),
            // Tilt with the lever arm of Z: 200 µrad at X = 100 mm over 250 mm of Z.
            (
                "EAX = { table = [[0.0, 0.0], [100.0, 200.0], [800.0, 0.0]], interpolation = \"linear\" }\n",
                25.0,
            ),
            ("EXX = { mean = { poly = [0.0] }, reversal = 300.0 }\n", 149.0),
            ("EYY = { forward = { poly = [0.0] }, backward = { poly = [80.0] } }\n", 79.0),
            ("EYX = { fourier = [0.0, 0.0, 90.0], period = 800.0 }\n", 89.0),
            (
                "EZY = { grid = { axes = [\"Y\", \"Z\"], nodes = [[0, 200, 400], [0, 100, 250]], values = [[0, 0, 0], [0, 70, 0], [0, 0, 0]] } }\n",
                35.0,
            ),
        ] {
            let moved = flat.largest_move(&model(SMALL, errors), []);
            let um = moved.linear.to_um().0;
            assert!(um >= least_um, "{errors}: {um} µm");
        }
    }

    /// A peak at an off-centre grid node, one at the second of 801 nodes, and a change that needs two turned rotary axes are found.
    #[test]
    fn every_node_is_sampled() {
        let flat = model(SMALL, "EYX = 0.0\n");
        for (i, j) in (0..9).flat_map(|i| (0..6).map(move |j| (i, j))) {
            let mut values = [[0.0; 6]; 9];
            values[i][j] = 200.0;
            let grid = format!(
                "EXY = {{ grid = {{ axes = [\"Y\", \"Z\"], nodes = [[0, 50, 100, 150, 200, 250, 300, 350, 400], [0, 50, 100, 150, 200, 250]], values = {values:?} }} }}\n"
            );
            let um = flat.largest_move(&model(SMALL, &grid), []).linear.to_um().0;
            assert!(um > 199.0, "node {i}, {j}: {um} µm");
        }
        for target in [1, 15, 400, 799] {
            let rows = (0..=800).map(|k| format!("[{k}, {}]", if k == target { 200 } else { 0 }));
            let rows: Vec<String> = rows.collect();
            let table =
                format!("EYX = {{ table = [{}], interpolation = \"linear\" }}\n", rows.join(", "));
            let um = flat.largest_move(&model(SMALL, &table), []).linear.to_um().0;
            assert!(um > 199.0, "target {target}: {um} µm");
        }
        let still = model(TILTING, "EXX = 0.0\n");
        let wobbles =
            model(TILTING, "EBC = { fourier = [0.0, 0.0, 0.0, 0.0, 200.0], period = 360.0 }\n");
        let um = still.largest_move(&wobbles, []).linear.to_um().0;
        assert!(um > 300.0, "both turned: {um} µm");
    }

    /// The period of the screw error equals the sampling distance.
    #[test]
    fn a_periodic_error_between_samples_is_found() {
        let flat = model(SMALL, "EZZ = 0.0\n");
        let screw = model(SMALL, "EZZ = { fourier = [0.0, 0.0, 90.0], period = 10.0 }\n");
        let um = flat.largest_move(&screw, []).linear.to_um().0;
        assert!(um > 80.0, "{um} µm");
    }

    #[test]
    fn a_whole_turn_is_sampled() {
        let flat = model(TURNING, "EXC = 0.0\n");
        let wobbles = model(TURNING, "EXC = { fourier = [-80.0, 80.0, 0.0], period = 360.0 }\n");
        let um = flat.largest_move(&wobbles, []).linear.to_um().0;
        assert!(um > 150.0, "{um} µm at 180 deg");
    }

    #[test]
    fn the_number_of_states_is_bounded() {
        let nodes: Vec<String> = (0..=800).map(|k| format!("[{}, {}]", k, k % 7)).collect();
        let table =
            format!("EYX = {{ table = [{}], interpolation = \"linear\" }}\n", nodes.join(", "));
        let (old, new) = (model(SMALL, "EYX = 0.0\n"), model(SMALL, &table));
        let correctors = [&old, &new].map(|model| model.correctors_among(&model.axes));
        let left = MAX_STATES + Space::of(&old, &new).node_states();
        let mut pair = Pair::new([&old, &new], correctors, LargestMove::NONE, left);
        Space::of(&old, &new).sample(&mut pair);
        assert!(pair.left > 0, "every part had room");
        assert!(pair.worst.linear.0 > 0.005);
    }
}
