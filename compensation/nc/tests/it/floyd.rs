//! Shortest paths compared with another algorithm, plans with closed forms, and joint rounding with the exact line.

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::Machine;
use volcomp_nc::{
    Job, SetUp, Strategy,
    plan::{Limits, Place, plan},
    shortest::{GraphError, all_pairs, through},
};

use crate::identity::result_of;

/// Distances from one node by relaxing every edge once per node (Bellman–Ford).
fn by_relaxation(weights: &[Vec<f64>], from: usize) -> Vec<f64> {
    let mut lengths = vec![f64::INFINITY; weights.len()];
    lengths[from] = 0.0;
    for _ in 0..weights.len() {
        for (a, row) in weights.iter().enumerate() {
            for (b, weight) in row.iter().enumerate() {
                lengths[b] = lengths[b].min(lengths[a] + weight);
            }
        }
    }
    lengths
}

#[test]
fn all_pairs_equal_relaxation() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for count in [1, 2, 5, 12, 30] {
        for edges in [0.1, 0.4, 1.0] {
            let mut weights = vec![vec![f64::INFINITY; count]; count];
            for weight in weights.iter_mut().flatten() {
                if random.random_bool(edges) {
                    *weight = random.random_range(0.0..10.0);
                }
            }
            let mut rounds = 0;
            let found = all_pairs(&weights, |round, _| rounds = round).expect("a graph");
            assert_eq!((rounds, found.operations), (count, (count as u64).pow(3)));
            for from in 0..count {
                let lengths = by_relaxation(&weights, from);
                for (to, length) in lengths.into_iter().enumerate() {
                    let distance = found.distance(from, to);
                    assert!(distance == length || (distance - length).abs() < 1e-12);
                    // The edges of the path add up to its length.
                    let path = found.path(from, to);
                    assert_eq!(path.is_some(), length.is_finite(), "{from} {to}");
                    let Some(path) = path else { continue };
                    let sum: f64 = path.windows(2).map(|pair| weights[pair[0]][pair[1]]).sum();
                    assert!((sum - length).abs() < 1e-12, "{path:?}");
                    assert_eq!((path.first(), path.last()), (Some(&from), Some(&to)));
                }
            }
        }
    }
}

#[test]
fn invalid_graphs_are_refused() {
    let seen = |_: usize, _: &[Vec<f64>]| ();
    let error = all_pairs(&[vec![0.0, 1.0], vec![0.0]], seen);
    assert_eq!(error, Err(GraphError::NotSquare { node: 1, found: 1, expected: 2 }));
    for found in [-1.0, f64::NAN] {
        let error = all_pairs(&[vec![0.0, found], vec![1.0, 0.0]], seen);
        assert!(matches!(error, Err(GraphError::Weight { from: 0, to: 1, .. })));
    }
    let empty = all_pairs(&[], seen).expect("no nodes");
    assert_eq!((empty.path(0, 0), empty.distance(3, 4)), (None, f64::INFINITY));
    assert_eq!(through(&[], |_, _, _| 1.0), None);
    assert_eq!(through(&[2, 0, 2], |_, _, _| 1.0), None);
    assert_eq!(through(&[2, 2], |_, _, _| f64::INFINITY), None);
}

/// The layered search finds the same path as the all-pairs search on the graph with a source and a sink, with fewer operations.
#[test]
fn layered_and_all_pairs_search_agree() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    for _ in 0..40 {
        let counts: Vec<usize> =
            (0..random.random_range(2..7)).map(|_| random.random_range(1..6)).collect();
        let mut edges: Vec<Vec<Vec<f64>>> =
            counts.windows(2).map(|pair| vec![vec![0.0; pair[1]]; pair[0]]).collect();
        for weight in edges.iter_mut().flatten().flatten() {
            *weight = random.random_range(0.0..1.0);
        }
        let found = through(&counts, |layer, from, to| edges[layer][from][to]).expect("a way");
        let total: usize = counts.iter().sum();
        let mut weights = vec![vec![f64::INFINITY; total + 2]; total + 2];
        let first = |layer: usize| counts[..layer].iter().sum::<usize>();
        for (layer, edges) in edges.iter().enumerate() {
            for (from, row) in edges.iter().enumerate() {
                for (to, weight) in row.iter().enumerate() {
                    weights[first(layer) + from][first(layer + 1) + to] = *weight;
                }
            }
        }
        weights[total][..counts[0]].fill(0.0);
        let last = counts.len() - 1;
        for row in &mut weights[first(last)..total] {
            row[total + 1] = 0.0;
        }
        let all = all_pairs(&weights, |_, _| ()).expect("a graph");
        assert!((all.distance(total, total + 1) - found.length).abs() < 1e-12);
        let path = all.path(total, total + 1).expect("a way");
        let nodes: Vec<usize> =
            found.nodes.iter().enumerate().map(|(layer, node)| first(layer) + node).collect();
        assert_eq!(path[1..path.len() - 1], nodes);
        assert!(found.operations < all.operations);
    }
}

/// Stations along X at intervals of 1 mm.
fn along_x(count: u32) -> Vec<Place> {
    (0..count).map(|k| [f64::from(k), 0.0, 0.0]).collect()
}

#[test]
fn without_limits_the_deviation_is_zero() {
    let path: Vec<Place> =
        (0..30).map(|k| [f64::from(k), 0.5 * f64::from(k), -0.2 * f64::from(k)]).collect();
    let actual = |at: Place| {
        [
            at[0] + 0.02 * (0.3 * at[0]).sin(),
            at[1] + 1e-4 * at[0],
            at[2] + 0.01 * (0.2 * at[1]).cos(),
        ]
    };
    let limits = Limits { step_mm: 0.0, tolerance_mm: 2e-5, ..Limits::default() };
    let found = plan(&path, actual, &limits).expect("a plan");
    // Half-way between stations the curvature of the sine remains: 0.02·0.3²/8.
    assert!(found.max_mm < 2.3e-4, "{found:?}");
    let at_stations = path.iter().zip(&found.commands).map(|(at, to)| {
        let by: Place = std::array::from_fn(|i| actual(*to)[i] - at[i]);
        // Along the path a command may be early or late.
        let along = (by[0] + 0.5 * by[1] - 0.2 * by[2]) / 1.29;
        [by[0] - along, by[1] - 0.5 * along, by[2] + 0.2 * along]
            .map(f64::abs)
            .into_iter()
            .fold(0.0, f64::max)
    });
    assert!(at_stations.fold(0.0, f64::max) < 1.5e-4);
}

/// The error jumps by 10 µm, and the correction may change by 1 µm per station. The best plan starts before the jump and is 5 µm off on
/// both sides, not 10 µm after it.
#[test]
fn a_rate_limit_centres_the_plan_on_a_jump() {
    let path = along_x(60);
    let actual = |at: Place| [at[0], at[1] + if at[0] < 29.5 { 0.0 } else { 0.010 }, at[2]];
    let limits = Limits { most_change_mm: 0.001, ..Limits::default() };
    let found = plan(&path, actual, &limits).expect("a plan");
    let off = |k: usize| actual(found.commands[k])[1];
    let worst = (0..60).map(|k| off(k).abs()).fold(0.0, f64::max);
    assert!((0.0045..=0.0055).contains(&worst), "{worst}");
    for pair in found.commands.windows(2) {
        assert!((pair[1][1] - pair[0][1]).abs() <= 0.001 + 1e-12);
    }
    assert!(found.commands.iter().all(|c| (c[1] * 1e3 - (c[1] * 1e3).round()).abs() < 1e-9));
    // A correction that follows the error as fast as permitted from the jump on.
    let mut following = 0.0_f64;
    let mut worst_following = 0.0_f64;
    for at in &path {
        let wanted = -(actual(*at)[1]);
        following += (wanted - following).clamp(-0.001, 0.001);
        worst_following = worst_following.max((actual(*at)[1] + following).abs());
    }
    assert!(worst > 0.0 && worst_following > 1.6 * worst, "{worst_following} {worst}");
}

/// One motion, whose error grows to 20 µm at its end. With corrections −d at the start and d short of the error at the end, the mean square
/// deviation is d²/3 and the change 20 µm − 2d; with a price of 1/12 the sum is least at d = 5 µm.
#[test]
fn a_price_shares_the_error_between_deviation_and_change() {
    let actual = |at: Place| [at[0], at[1] + 2e-4 * at[0], at[2]];
    let limits = Limits { price: 1.0 / 12.0, ..Limits::default() };
    let found = plan(&[[0.0; 3], [100.0, 0.0, 0.0]], actual, &limits).expect("a plan");
    for (command, expected) in found.commands.iter().zip([-0.005, -0.015]) {
        assert!((command[1] - expected).abs() < 1e-9, "{found:?}");
    }
}

/// An error that falls faster than the path rises would reverse the command. With `keeps_direction` there is no reversal, at a larger RMS
/// deviation.
#[test]
fn keeps_direction_forbids_reversals() {
    let path: Vec<Place> = (0..40).map(|k| [f64::from(k), 0.002 * f64::from(k), 0.0]).collect();
    let actual = |at: Place| [at[0], at[1] + 0.01 * (0.5 * at[0]).sin(), at[2]];
    let free = plan(&path, actual, &Limits::default()).expect("a plan");
    let turns =
        |commands: &[Place]| commands.windows(2).filter(|p| p[1][1] < p[0][1] - 1e-12).count();
    assert!(turns(&free.commands) > 0);
    let limits = Limits { keeps_direction: true, ..Limits::default() };
    let kept = plan(&path, actual, &limits).expect("a plan");
    assert_eq!(turns(&kept.commands), 0);
    assert!(kept.rms_mm > free.rms_mm);
}

#[test]
fn invalid_paths_have_no_plan() {
    let limits = Limits::default();
    assert_eq!(plan(&[], |at| at, &limits), None);
    assert_eq!(plan(&along_x(1), |at| at, &limits), None);
    assert_eq!(plan(&[[f64::NAN; 3], [0.0; 3]], |at| at, &limits), None);
    // With all stations at one position the plan is trivial.
    let still = plan(&[[1.0; 3]; 4], |at| at, &limits).expect("a plan");
    assert_eq!(still.max_mm, 0.0);
}

const MILL: &str = "structure = \"w X' b Y Z t\"
axes = { X = { travel = [0, 1000] }, Y = { travel = [0, 1000] }, Z = { travel = [-500, 0] } }
[errors]
EYX = { fourier = [0, 0, 25.0], period = 180.0 }
EXX = { fourier = [0, 18.0, 0], period = 260.0 }
EXY = { fourier = [0, 0, 12.0], period = 150.0 }
";

fn compensated(program: &str, strategy: Strategy) -> String {
    let machine = Machine::parse(MILL, "mill.toml").expect("a machine");
    let setup =
        SetUp::parse("start = { X = 0.0, Y = 0.0, Z = 0.0 }\n", "setup.toml").expect("a set-up");
    let result =
        result_of((&machine, 2e-4), &setup, program.as_bytes(), |job| Job { strategy, ..job });
    String::from_utf8(result.expect("compensated").0).expect("text")
}

/// Deviation of the tool perpendicular to the line from (20, 30) to (820, 530), with the errors of the machine written out.
fn across_um(program: &str) -> Vec<f64> {
    let (dx, dy) = (800.0_f64, 500.0_f64);
    let length = dx.hypot(dy);
    let number = |line: &str, letter: char| {
        let rest = &line[line.find(letter).expect("a word") + 1..];
        let end = rest.find(|c: char| !"0123456789.-".contains(c)).unwrap_or(rest.len());
        rest[..end].parse::<f64>().expect("a number")
    };
    let lines = program.lines().filter(|line| line.contains('X') && !line.contains("G0"));
    lines
        .map(|line| {
            let (x, y) = (number(line, 'X'), number(line, 'Y'));
            let wave = |q: f64, period: f64| std::f64::consts::TAU * q / period;
            let ex = 18.0 * wave(x, 260.0).cos() + 12.0 * wave(y, 150.0).sin();
            let ey = 25.0 * wave(x, 180.0).sin();
            // X carries the workpiece, thus the errors of X.
            let (px, py) = (x - 20.0, y - 30.0);
            ((py + 1e-3 * ey) * dx - (px + 1e-3 * ex) * dy) / length * 1e3
        })
        .collect()
}

#[test]
fn joint_rounding_is_closer_to_the_line() {
    let program = "G21 G90 G0 X20 Y30\nG1 X820 Y530 F1000\nM2\n";
    let [plain, floyd] =
        [Strategy::Plain, Strategy::Floyd].map(|strategy| compensated(program, strategy));
    let [by_plain, by_floyd] = [&plain, &floyd].map(|program| across_um(program));
    assert_eq!(by_plain.len(), by_floyd.len());
    assert!(by_plain.len() > 50, "{plain}");
    let rms = |all: &[f64]| (all.iter().map(|um| um * um).sum::<f64>() / all.len() as f64).sqrt();
    let max = |all: &[f64]| all.iter().map(|um| um.abs()).fold(0.0, f64::max);
    println!(
        "plain {:.3} {:.3}, floyd {:.3} {:.3}",
        rms(&by_plain),
        max(&by_plain),
        rms(&by_floyd),
        max(&by_floyd)
    );
    // Two words, each uniform within half a step of 1 µm: 0.29 µm perpendicular to the line.
    assert!((0.25..0.33).contains(&rms(&by_plain)), "{}", rms(&by_plain));
    assert!(rms(&by_floyd) < 0.6 * rms(&by_plain), "{} {}", rms(&by_floyd), rms(&by_plain));
    assert!(max(&by_floyd) <= max(&by_plain) + 1e-9);
    // The end of the line is unchanged.
    let last = |program: &str| program.lines().rfind(|line| line.contains('X')).map(str::to_owned);
    assert_eq!(last(&plain), last(&floyd));
}

/// X has a digit more than Y, so the rounding of Y alone determines the deviation.
#[test]
fn joint_rounding_weights_each_axis_by_its_step() {
    let program = "G21 G90 G0 X20 Y30\nG1 X820.0000 Y530 F1000\nM2\n";
    let rms = |strategy| {
        let all = across_um(&compensated(program, strategy));
        (all.iter().map(|um| um * um).sum::<f64>() / all.len() as f64).sqrt()
    };
    let [plain, floyd] = [Strategy::Plain, Strategy::Floyd].map(rms);
    assert!(floyd <= plain, "{floyd} {plain}");
}

#[test]
fn unsplit_lines_are_equal_with_either_strategy() {
    let program = "G21 G90 G0 X20 Y30\nG1 X20.5 Y30.4 F1000\nX21 Y31\nG91 X300 Y200\nG90 G2 X421 Y231 I50 J0\nM2\n";
    assert_eq!(compensated(program, Strategy::Plain), compensated(program, Strategy::Floyd));
}

#[path = "../../examples/floyd.rs"]
mod example;

#[test]
fn the_example_prints_its_recorded_output() {
    let printed =
        example::printed(include_str!("../../../../examples/mill.toml")).expect("printed");
    assert_eq!(printed, include_str!("../../../../examples/floyd/printed.txt"));
}

/// The rounds D(0) … D(6) of the example equal Bellman–Ford on the paths through the first nodes only.
#[test]
fn each_round_holds_the_paths_over_the_first_nodes() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let count = 7;
    let weights: Vec<Vec<f64>> =
        (0..count).map(|_| (0..count).map(|_| random.random_range(0.0..5.0)).collect()).collect();
    let found = all_pairs(&weights, |round, distances| {
        for (from, own) in distances.iter().enumerate() {
            for to in (0..count).filter(|to| *to != from) {
                // Without the edges into the excluded nodes.
                let mut allowed = weights.clone();
                for (node, row) in allowed.iter_mut().enumerate() {
                    for (next, weight) in row.iter_mut().enumerate() {
                        let passes = |node: usize| node < round || node == from || node == to;
                        if !passes(node) || !passes(next) {
                            *weight = f64::INFINITY;
                        }
                    }
                }
                let expected = by_relaxation(&allowed, from)[to];
                assert!((own[to] - expected).abs() < 1e-12, "{round} {from} {to}");
            }
        }
    });
    assert!(found.is_ok());
}
