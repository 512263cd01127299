//! Commands along a path that minimize the deviation of the actual motion, where corrections are rounded, limited in rate, or must not
//! reverse an axis.
//!
//! At each station the candidate commands are a grid along the normals of the path. Candidates of neighbouring stations are the nodes of a
//! directed graph; the weight of an edge is the deviation of the actual motion between the two commands, plus a price on the change of the
//! correction. The shortest path through the graph is the plan. The grid is refined about the plan down to the step of the control; the
//! candidates of the last rounds are positions of the control.

use crate::{
    coordinates::{cross, dot},
    shortest::through,
};

/// A point in space, mm.
pub type Place = [f64; 3];

/// Constraints on the commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Command resolution, mm; 0: continuous.
    pub step_mm: f64,
    /// Deviation of the actual motion from the path, mm, at which the refinement of continuous commands stops; not used
    /// if `step_mm` is above 0.
    pub tolerance_mm: f64,
    /// Maximum change of an axis correction between neighbouring stations, mm.
    pub most_change_mm: f64,
    /// Weight of the mean square change of the correction, relative to the weight of the mean square deviation.
    pub price: f64,
    /// Commands may not reverse an axis that the path does not reverse.
    pub keeps_direction: bool,
}

impl Default for Limits {
    /// Resolution 1 µm, no other limit.
    fn default() -> Self {
        Self {
            step_mm: 1e-3,
            tolerance_mm: 0.0,
            most_change_mm: f64::INFINITY,
            price: 0.0,
            keeps_direction: false,
        }
    }
}

/// Planned commands and their quality.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The command at each station, mm.
    pub commands: Vec<Place>,
    /// RMS deviation of the actual motion at the stations and half-way between, mm.
    pub rms_mm: f64,
    /// Maximum deviation at the same positions, mm.
    pub max_mm: f64,
    /// Number of search rounds, with refined or re-centred grids.
    pub rounds: usize,
    /// Number of edge evaluations in all rounds.
    pub operations: u64,
}

/// Number of candidates on each side of the centre, along each normal.
const AROUND: i32 = 2;

/// Grid refinement factor per round.
const FINER: f64 = 0.5;

/// Maximum number of search rounds with one grid step; `MAX_ROUNDS` limits all rounds together.
const MAX_ROUNDS_AT_ONE_STEP: usize = 16;

const MAX_ROUNDS: usize = 400;

/// Minimum grid step, mm, if commands are continuous.
const FINEST_MM: f64 = 1e-7;

/// Plans one command for each station of `path`, in order. `actual` returns the actual position for a command, mm. Returns `None` for fewer than
/// two stations, for coordinates that are not finite, and if the limits permit no solution.
pub fn plan(path: &[Place], actual: impl Fn(Place) -> Place, limits: &Limits) -> Option<Plan> {
    let is_finite = path.iter().flatten().all(|x| x.is_finite());
    if path.len() < 2 || !is_finite {
        return None;
    }
    let stations: Vec<Station> = (0..path.len()).map(|at| Station::of(path, at)).collect();
    // The plain correction: the negative error at the nominal position.
    let mut commands: Vec<Place> = path.iter().map(|&at| add(at, sub(at, actual(at)))).collect();
    let largest = path.iter().zip(&commands);
    let largest = largest.map(|(at, to)| length(sub(*to, *at))).fold(0.0, f64::max);
    let mut step = (0.5 * largest).max(limits.step_mm);
    let mut search = Search { stations: &stations, actual: &actual, limits, operations: 0 };
    let mut rounds = 0;
    let finest = limits.step_mm.max(FINEST_MM);
    // The plain commands may violate the limits, so the first round is centred on the path itself.
    let mut middles = path.to_vec();
    while rounds < MAX_ROUNDS {
        let mut candidates: Vec<Vec<Place>> = Vec::with_capacity(path.len());
        for (place, station) in stations.iter().enumerate() {
            let mut own = station.grid(middles[place], step);
            own.push(commands[place]);
            own.push(path[place]);
            candidates.push(own);
        }
        let best = search.best(&candidates)?;
        commands.clone_from(&best);
        rounds += 1;
        // The best solution may lie beyond the grid: re-centre it before refining.
        let stays = best == middles;
        middles = best;
        if !stays && rounds % MAX_ROUNDS_AT_ONE_STEP != 0 {
            continue;
        }
        let is_fine = step <= finest;
        if is_fine || limits.step_mm == 0.0 && search.deviation(&middles).1 <= limits.tolerance_mm {
            break;
        }
        step = (step * FINER).max(finest);
    }
    if limits.step_mm > 0.0 {
        for _ in 0..MAX_ROUNDS_AT_ONE_STEP {
            // Corrections are whole steps of the control, so that a zero correction leaves the station unchanged.
            let around = commands.iter().zip(path);
            let candidates: Vec<Vec<Place>> =
                around.map(|(at, nominal)| steps_around(*at, *nominal, limits.step_mm)).collect();
            let best = search.best(&candidates)?;
            rounds += 1;
            let stays = best == commands;
            commands = best;
            if stays {
                break;
            }
        }
    }
    let (rms_mm, max_mm) = search.deviation(&commands);
    Some(Plan { commands, rms_mm, max_mm, rounds, operations: search.operations })
}

struct Station {
    at: Place,
    along: Place,
    normals: Vec<Place>,
    is_end: bool,
}

impl Station {
    fn of(path: &[Place], at: usize) -> Self {
        let last = path.len() - 1;
        let way = sub(path[(at + 1).min(last)], path[at.saturating_sub(1)]);
        let size = length(way);
        let along = if size > 0.0 { scale(way, 1.0 / size) } else { [0.0; 3] };
        // The axis most perpendicular to the path gives the first normal.
        let across = (0..3).min_by(|a, b| along[*a].abs().total_cmp(&along[*b].abs()));
        let mut first = [0.0; 3];
        first[across.unwrap_or(2)] = 1.0;
        let first = sub(first, scale(along, dot(first, along)));
        let size = length(first);
        let first = scale(first, 1.0 / size.max(f64::MIN_POSITIVE));
        Self {
            at: path[at],
            along,
            normals: vec![first, cross(along, first)],
            is_end: at == 0 || at == last,
        }
    }

    fn grid(&self, middle: Place, step: f64) -> Vec<Place> {
        let mut places = Vec::new();
        for i in -AROUND..=AROUND {
            for j in -AROUND..=AROUND {
                let by = add(
                    scale(self.normals[0], f64::from(i) * step),
                    scale(self.normals[1], f64::from(j) * step),
                );
                places.push(add(middle, by));
            }
        }
        places
    }
}

/// Commands about `at` whose corrections are whole steps.
fn steps_around(at: Place, nominal: Place, step: f64) -> Vec<Place> {
    let nearest = sub(at, nominal).map(|x| (x / step).round());
    let mut places = Vec::with_capacity(27);
    for i in -1..=1 {
        for j in -1..=1 {
            for k in -1..=1 {
                let by = [f64::from(i), f64::from(j), f64::from(k)];
                places.push(std::array::from_fn(|axis| {
                    nominal[axis] + (nearest[axis] + by[axis]) * step
                }));
            }
        }
    }
    places
}

struct Search<'a, F> {
    stations: &'a [Station],
    actual: &'a F,
    limits: &'a Limits,
    operations: u64,
}

impl<F: Fn(Place) -> Place> Search<'_, F> {
    fn best(&mut self, candidates: &[Vec<Place>]) -> Option<Vec<Place>> {
        let counts: Vec<usize> = candidates.iter().map(Vec::len).collect();
        let missed: Vec<Vec<Place>> = candidates
            .iter()
            .zip(self.stations)
            .map(|(own, station)| own.iter().map(|at| self.missed(station, *at)).collect())
            .collect();
        let weight = |layer: usize, from: usize, to: usize| {
            let commands = [candidates[layer][from], candidates[layer + 1][to]];
            self.weight(layer, commands, [missed[layer][from], missed[layer + 1][to]])
        };
        let found = through(&counts, weight)?;
        self.operations += found.operations;
        let nodes = candidates.iter().zip(&found.nodes);
        Some(nodes.map(|(own, node)| own[*node]).collect())
    }

    /// Deviation of the actual position from a station, mm: perpendicular to the path, but in all directions at the ends of the path.
    fn missed(&self, station: &Station, command: Place) -> Place {
        let by = sub((self.actual)(command), station.at);
        if station.is_end {
            return by;
        }
        sub(by, scale(station.along, dot(by, station.along)))
    }

    /// Mean square deviation of the motion between two commands, plus the price on the change of the correction; infinite if a limit
    /// forbids it.
    fn weight(&self, layer: usize, [from, to]: [Place; 2], [first, last]: [Place; 2]) -> f64 {
        let (here, there) = (&self.stations[layer], &self.stations[layer + 1]);
        let change = sub(sub(to, there.at), sub(from, here.at));
        // Tolerates rounding for a change equal to the limit.
        let most = self.limits.most_change_mm * (1.0 + 1e-9);
        if change.iter().any(|x| x.abs() > most) {
            return f64::INFINITY;
        }
        if self.limits.keeps_direction {
            let (nominal, commanded) = (sub(there.at, here.at), sub(to, from));
            if nominal.iter().zip(commanded).any(|(n, c)| n * c < 0.0) {
                return f64::INFINITY;
            }
        }
        let middle = self.missed_half_way(layer, from, to);
        // Simpson's rule.
        let square = (dot(first, first) + 4.0 * dot(middle, middle) + dot(last, last)) / 6.0;
        square + self.limits.price * dot(change, change)
    }

    fn missed_half_way(&self, layer: usize, from: Place, to: Place) -> Place {
        let (here, there) = (&self.stations[layer], &self.stations[layer + 1]);
        let by = sub((self.actual)(scale(add(from, to), 0.5)), scale(add(here.at, there.at), 0.5));
        let way = sub(there.at, here.at);
        let square = dot(way, way);
        if square == 0.0 {
            return by;
        }
        sub(by, scale(way, dot(by, way) / square))
    }

    /// RMS and maximum deviation of the motion, at the stations and half-way between.
    fn deviation(&self, commands: &[Place]) -> (f64, f64) {
        let at = self.stations.iter().zip(commands);
        let at = at.map(|(station, command)| length(self.missed(station, *command)));
        let pairs = commands.windows(2).enumerate();
        let between =
            pairs.map(|(layer, pair)| length(self.missed_half_way(layer, pair[0], pair[1])));
        let sizes: Vec<f64> = at.chain(between).collect();
        let squares: f64 = sizes.iter().map(|size| size * size).sum();
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        ((squares / sizes.len() as f64).sqrt(), largest)
    }
}

fn add(a: Place, b: Place) -> Place {
    std::array::from_fn(|i| a[i] + b[i])
}

fn sub(a: Place, b: Place) -> Place {
    std::array::from_fn(|i| a[i] - b[i])
}

fn scale(a: Place, by: f64) -> Place {
    a.map(|x| x * by)
}

fn length(a: Place) -> f64 {
    dot(a, a).sqrt()
}
