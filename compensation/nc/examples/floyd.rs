//! Path compensation by shortest paths: from a field of errors to commands in whole steps of a control.
//!
//! ```sh
//! cargo run --release -p volcomp-nc --example floyd
//! ```
//!
//! `examples/floyd/README.md` explains the output; `examples/floyd/printed.txt` contains it.

use std::{error::Error, fmt::Write as _};

use volcomp_nc::{
    model::{Machine, Temperatures, kinematics::Form, vocabulary::AxisName},
    plan::{Limits, Place, plan},
    shortest::{AllPairs, all_pairs, through},
};

/// Step of the control, mm.
const STEP_MM: f64 = 1e-3;
/// Half width of the field around the path, in steps along X and Y.
const FIELD: i32 = 100;
/// Maximum distance of a node from the exact correction, mm.
const BAND_MM: f64 = 2.2e-3;
/// Weight of the mean square change of the correction, relative to that of the deviation.
const PRICE: f64 = 0.05;

/// A point of the plane, mm.
type Point = [f64; 2];

/// Errors of a machine in the XY plane.
struct Field {
    machine: Machine,
}

impl Field {
    fn actual(&self, [x, y]: Point) -> Result<Point, Box<dyn Error>> {
        let state = self.machine.state(&[(AxisName::X, x), (AxisName::Y, y)])?;
        let error = self.machine.error_at(&state, Form::Exact, &Temperatures::default());
        Ok([x + error.position_mm.x, y + error.position_mm.y])
    }
}

/// A station of the path. Its nodes are the commands where the normal of the path crosses the grid of the field.
struct Station {
    at: Point,
    nodes: Vec<Point>,
}

fn stations(
    field: &Field,
    from: Point,
    to: Point,
    count: usize,
) -> Result<Vec<Station>, Box<dyn Error>> {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = way[0].hypot(way[1]);
    let normal = [-way[1] / length, way[0] / length];
    let mut stations = Vec::new();
    for place in 0..count {
        let share = place as f64 / (count - 1) as f64;
        let at = [from[0] + share * way[0], from[1] + share * way[1]];
        let actual = field.actual(at)?;
        // Required correction perpendicular to the path.
        let wanted = -((actual[0] - at[0]) * normal[0] + (actual[1] - at[1]) * normal[1]);
        let mut along: Vec<f64> = Vec::new();
        for line in -FIELD / 2..FIELD / 2 {
            for across in normal {
                if across.abs() > 1e-9 {
                    along.push(f64::from(line) * STEP_MM / across);
                }
            }
        }
        along.retain(|t| (t - wanted).abs() <= BAND_MM);
        along.sort_by(f64::total_cmp);
        along.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let nodes = along.iter().map(|t| [at[0] + t * normal[0], at[1] + t * normal[1]]);
        stations.push(Station { at, nodes: nodes.collect() });
    }
    Ok(stations)
}

/// Mean square deviation of the actual motion between two commands from the path, plus the weighted change of the correction.
fn weight(
    field: &Field,
    price: f64,
    here: (Point, Point),
    there: (Point, Point),
) -> Result<f64, Box<dyn Error>> {
    let way = [there.0[0] - here.0[0], there.0[1] - here.0[1]];
    let length = way[0].hypot(way[1]);
    let across = |at: Point, command: Point| -> Result<f64, Box<dyn Error>> {
        let actual = field.actual(command)?;
        Ok(((actual[1] - at[1]) * way[0] - (actual[0] - at[0]) * way[1]) / length * 1e3)
    };
    let half = |a: Point, b: Point| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let first = across(here.0, here.1)?;
    let middle = across(half(here.0, there.0), half(here.1, there.1))?;
    let last = across(there.0, there.1)?;
    let change: f64 = (0..2)
        .map(|k| ((there.1[k] - there.0[k]) - (here.1[k] - here.0[k])) * 1e3)
        .map(|um| um * um)
        .sum();
    Ok((first * first + 4.0 * middle * middle + last * last) / 6.0 + price * change)
}

/// The graph of some stations: nodes in the order of stations, weights in µm².
fn graph(field: &Field, price: f64, stations: &[Station]) -> Result<Vec<Vec<f64>>, Box<dyn Error>> {
    let count: usize = stations.iter().map(|station| station.nodes.len()).sum();
    let mut weights = vec![vec![f64::INFINITY; count]; count];
    let mut first = 0;
    for pair in stations.windows(2) {
        let next = first + pair[0].nodes.len();
        for (from, a) in pair[0].nodes.iter().enumerate() {
            for (to, b) in pair[1].nodes.iter().enumerate() {
                weights[first + from][next + to] =
                    weight(field, price, (pair[0].at, *a), (pair[1].at, *b))?;
            }
        }
        first = next;
    }
    Ok(weights)
}

/// Distances from one node by Dijkstra's algorithm without a heap, and the number of sums compared.
fn dijkstra(weights: &[Vec<f64>], from: usize) -> (Vec<f64>, u64) {
    let count = weights.len();
    let (mut lengths, mut done) = (vec![f64::INFINITY; count], vec![false; count]);
    lengths[from] = 0.0;
    let mut operations = 0;
    while let Some(at) = (0..count)
        .filter(|node| !done[*node] && lengths[*node].is_finite())
        .min_by(|a, b| lengths[*a].total_cmp(&lengths[*b]))
    {
        done[at] = true;
        for to in 0..count {
            operations += 1;
            lengths[to] = lengths[to].min(lengths[at] + weights[at][to]);
        }
    }
    (lengths, operations)
}

/// Prints the output of the example.
///
/// # Errors
/// The machine file cannot be read.
pub(crate) fn printed(machine: &str) -> Result<String, Box<dyn Error>> {
    let field = Field { machine: Machine::parse(machine, "mill.toml")? };
    let mut text = String::new();
    small(&field, &mut text)?;
    long(&field, &mut text)?;
    more_nodes(&field, &mut text)?;
    eight_directions(&mut text)?;
    Ok(text)
}

/// A graph of six nodes, with the matrix of each round.
fn small(field: &Field, text: &mut String) -> Result<(), Box<dyn Error>> {
    let mut stations = stations(field, [40.0, 60.0], [240.0, 170.0], 4)?;
    for (place, station) in stations.iter_mut().enumerate() {
        let middle = station.nodes.len() / 2;
        let many = if place == 0 || place == 3 { 1 } else { 2 };
        station.nodes = station.nodes[middle..middle + many].to_vec();
    }
    let weights = graph(field, PRICE, &stations)?;
    writeln!(
        text,
        "Six nodes: a start, two stations with two nodes each, a target. Distances in µm², row from, column to."
    )?;
    let mut failed = Ok(());
    let found = all_pairs(&weights, |round, distances| {
        failed = matrix(text, round, distances);
    })?;
    failed?;
    let path = found.path(0, 5).unwrap_or_default();
    writeln!(text, "\nThe shortest way: {path:?}, {:.4} µm²\n", found.distance(0, 5))?;
    Ok(())
}

fn matrix(text: &mut String, round: usize, distances: &[Vec<f64>]) -> std::fmt::Result {
    writeln!(text, "\nD({round})")?;
    for row in distances {
        for distance in row {
            if distance.is_finite() {
                write!(text, "{distance:9.4}")?;
            } else {
                write!(text, "{:>9}", "-")?;
            }
        }
        writeln!(text)?;
    }
    Ok(())
}

/// The graph with a start node before the first nodes and a target node after the last ones, connected by edges of weight 0.
fn closed(weights: &[Vec<f64>], first: usize, last: usize) -> Vec<Vec<f64>> {
    let nodes = weights.len();
    let mut closed = weights.to_vec();
    for (node, row) in closed.iter_mut().enumerate() {
        let to_target = if node >= last { 0.0 } else { f64::INFINITY };
        row.extend([f64::INFINITY, to_target]);
    }
    let mut start = vec![f64::INFINITY; nodes + 2];
    start[..first].fill(0.0);
    closed.extend([start, vec![f64::INFINITY; nodes + 2]]);
    closed
}

/// One path through the whole field by both algorithms.
fn long(field: &Field, text: &mut String) -> Result<(), Box<dyn Error>> {
    let stations = stations(field, [20.0, 30.0], [420.0, 280.0], 25)?;
    let counts: Vec<usize> = stations.iter().map(|station| station.nodes.len()).collect();
    let nodes: usize = counts.iter().sum();
    let weights = graph(field, PRICE, &stations)?;
    let first = |station: usize| counts[..station].iter().sum::<usize>();
    let layered = through(&counts, |station, from, to| {
        weights[first(station) + from][first(station + 1) + to]
    })
    .ok_or("the graph has no way")?;
    let closed = closed(&weights, counts[0], first(counts.len() - 1));
    let all: AllPairs = all_pairs(&closed, |_, _| ())?;
    let (single, by_dijkstra) = dijkstra(&closed, nodes);
    writeln!(
        text,
        "A path of 472 mm with 25 stations; nodes where its normals cross the lines of a field of {FIELD} x {FIELD} steps of 1 µm: {nodes}."
    )?;
    let same = all.path(nodes, nodes + 1).is_some_and(|path| {
        let way = layered.nodes.iter().enumerate().map(|(station, node)| first(station) + node);
        path[1..path.len() - 1].iter().copied().eq(way)
    });
    writeln!(text, "  {:<38}{:>12}{:>14}", "", "length, µm²", "sums compared")?;
    for (name, length, operations) in [
        ("all pairs (Floyd)", all.distance(nodes, nodes + 1), all.operations),
        ("from the start (Dijkstra)", single[nodes + 1], by_dijkstra),
        ("from station to station", layered.length, layered.operations),
    ] {
        writeln!(text, "  {name:<38}{length:>12.4}{operations:>14}")?;
    }
    writeln!(text, "  the same way: {}", if same { "yes" } else { "no" })?;
    // RMS and maximum deviation perpendicular to the path, and maximum change of the correction, µm.
    let across = |commands: &[Point]| -> Result<[f64; 3], Box<dyn Error>> {
        let mut squares = 0.0;
        let mut largest = 0.0_f64;
        for (station, command) in stations.iter().zip(commands) {
            let actual = field.actual(*command)?;
            let um = ((actual[1] - station.at[1]) * 400.0 - (actual[0] - station.at[0]) * 250.0)
                / 400.0_f64.hypot(250.0)
                * 1e3;
            squares += um * um;
            largest = largest.max(um.abs());
        }
        let by = |k: usize| {
            let (at, to) = (stations[k].at, commands[k]);
            [to[0] - at[0], to[1] - at[1]]
        };
        let change = |k: usize| (by(k)[0] - by(k - 1)[0]).hypot(by(k)[1] - by(k - 1)[1]);
        let changes = (1..commands.len()).map(change).fold(0.0, f64::max);
        Ok([(squares / commands.len() as f64).sqrt(), largest, 1e3 * changes])
    };
    let nominal: Vec<Point> = stations.iter().map(|station| station.at).collect();
    let mut rounded = Vec::new();
    for station in &stations {
        let actual = field.actual(station.at)?;
        let step = |k: usize| ((station.at[k] - actual[k]) / STEP_MM).round() * STEP_MM;
        rounded.push([station.at[0] + step(0), station.at[1] + step(1)]);
    }
    let chosen = |nodes: &[usize]| -> Vec<Point> {
        let nodes = stations.iter().zip(nodes);
        nodes.map(|(station, node)| station.nodes[*node]).collect()
    };
    let path: Vec<Place> = nominal.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
    let actual = |[x, y, z]: Place| match field.actual([x, y]) {
        Ok([x, y]) => [x, y, z],
        // Unreachable: the whole path is within the machine's travel.
        Err(_) => [f64::NAN; 3],
    };
    let planned = plan(&path, actual, &Limits::default()).ok_or("no plan")?;
    let planned: Vec<Point> = planned.commands.iter().map(|[x, y, _]| [*x, *y]).collect();
    let free = graph(field, 0.0, &stations)?;
    let free =
        through(&counts, |station, from, to| free[first(station) + from][first(station + 1) + to])
            .ok_or("the graph has no way")?;
    writeln!(
        text,
        "  {:<38}{:>12}{:>14}{:>16}",
        "across the path at the stations, µm", "rms", "largest", "largest change"
    )?;
    for (name, commands) in [
        ("as programmed", &nominal),
        ("corrected, each axis rounded to 1 µm", &rounded),
        ("nodes on normals, shortest way", &chosen(&free.nodes)),
        ("the same with a price on changes", &chosen(&layered.nodes)),
        ("the control's own places, planned", &planned),
    ] {
        let [rms, largest, change] = across(commands)?;
        writeln!(text, "  {name:<38}{rms:>12.3}{largest:>14.3}{change:>16.3}")?;
    }
    writeln!(text)?;
    Ok(())
}

/// Plans between two stations 40 mm apart with an increasing number of stations between them.
fn more_nodes(field: &Field, text: &mut String) -> Result<(), Box<dyn Error>> {
    writeln!(
        text,
        "Two stations 40 mm apart, and more between them: the correction across the path at these two, µm."
    )?;
    for count in [2, 3, 4] {
        let stations = stations(field, [100.0, 80.0], [134.0, 101.071], count)?;
        let counts: Vec<usize> = stations.iter().map(|station| station.nodes.len()).collect();
        let weights = graph(field, PRICE, &stations)?;
        let first = |station: usize| counts[..station].iter().sum::<usize>();
        let found = through(&counts, |station, from, to| {
            weights[first(station) + from][first(station + 1) + to]
        })
        .ok_or("the graph has no way")?;
        let at = |station: usize| {
            let Station { at, nodes } = &stations[station];
            let node = nodes[found.nodes[station]];
            let by = [node[0] - at[0], node[1] - at[1]];
            1e3 * (by[1] * 34.0 - by[0] * 21.071) / 34.0_f64.hypot(21.071)
        };
        writeln!(text, "  {count} nodes: {:7.3} {:7.3}", at(0), at(count - 1))?;
    }
    writeln!(text)?;
    Ok(())
}

/// A correction that grows from zero to (5, 3) steps in moves to one of eight neighbours, under a constant error.
fn eight_directions(text: &mut String) -> Result<(), Box<dyn Error>> {
    const SIDE: usize = 8;
    let wanted = [5.0, 3.0];
    let mut weights = vec![vec![f64::INFINITY; SIDE * SIDE]; SIDE * SIDE];
    let place = |node: usize| [(node % SIDE) as f64, (node / SIDE) as f64];
    for (from, row) in weights.iter_mut().enumerate() {
        for (to, weight) in row.iter_mut().enumerate() {
            let (a, b) = (place(from), place(to));
            let by = [b[0] - a[0], b[1] - a[1]];
            if from != to && by.iter().all(|step| step.abs() <= 1.0) {
                let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
                *weight = (middle[0] - wanted[0]).powi(2) + (middle[1] - wanted[1]).powi(2);
            }
        }
    }
    let target = 3 * SIDE + 5;
    let found = all_pairs(&weights, |_, _| ())?;
    let (single, _) = dijkstra(&weights, 0);
    let path = found.path(0, target).ok_or("no way")?;
    writeln!(
        text,
        "Eight directions: a correction on its way from (0, 0) to (5, 3) steps, as soon as it can."
    )?;
    for y in (0..5).rev() {
        let row: String =
            (0..SIDE).map(|x| if path.contains(&(y * SIDE + x)) { " o" } else { " ." }).collect();
        writeln!(text, " {row}")?;
    }
    writeln!(
        text,
        "  {} steps, {:.2} step²; Dijkstra: {:.2} step²",
        path.len() - 1,
        found.distance(0, target),
        single[target]
    )?;
    Ok(())
}

#[allow(dead_code, reason = "a test takes this file in as a module")]
fn main() -> Result<(), Box<dyn Error>> {
    print!("{}", printed(include_str!("../../../examples/mill.toml"))?);
    Ok(())
}
