//! The volumetric error over poses of all axes, compared with a brute-force search over random poses.
//!
//! The best-fit rigid motion is compared with known rigid motions and a dense singular value decomposition.

use std::fmt::Write as _;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{
    Form, State,
    nalgebra::{DMatrix, DVector, Vector3},
    volumetric_error,
};
use volcomp_model::{
    ErrorField, Lengths, Machine, RigidMotion, RigidSums, Temperatures, VolumetricError, volumetric,
};
use volcomp_vocabulary::{AxisName, Direction};

const POSES: usize = 20_000;

/// A machine of this structure with random location errors, constants, slopes and waves.
fn random_machine(structure: &str, random: &mut ChaCha8Rng) -> Machine {
    let axes: Vec<AxisName> = structure
        .split_whitespace()
        .filter_map(|part| AxisName::from_letter(part.chars().next()?))
        .collect();
    let mut text =
        format!("structure = \"{structure}\"\n[tool]\ntip = [0.0, 0.0, -150.0]\n[axes]\n");
    for axis in &axes {
        if axis.is_rotary() {
            let point: [f64; 3] = std::array::from_fn(|_| random.random_range(-200.0..200.0));
            writeln!(text, "{axis} = {{ travel = [-110.0, 90.0], point = {point:?} }}").unwrap();
        } else {
            writeln!(text, "{axis}.travel = [-300.0, 300.0]").unwrap();
        }
    }
    text += "[errors]\n";
    for axis in &axes {
        let (domain, period) =
            if axis.is_rotary() { ("[-110.0, 90.0]", 360.0) } else { ("[-300.0, 300.0]", 0.0) };
        for component in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let mut c = || random.random_range(-8.0..8.0);
            let curve = if period > 0.0 {
                format!(
                    "fourier = [{}, {}, {}, {}, {}], period = {period}",
                    c(),
                    c(),
                    c(),
                    c(),
                    c()
                )
            } else {
                format!("chebyshev = [{}, {}, {}, {}], domain = {domain}", c(), c(), c(), c())
            };
            let reversal: f64 = random.random_range(-8.0..8.0);
            writeln!(text, "{component}{axis} = {{ mean = {{ {curve} }}, reversal = {reversal} }}")
                .unwrap();
        }
    }
    for axis in axes.iter().filter(|axis| axis.is_rotary()) {
        for component in ["EX0", "EY0", "EZ0", "EA0", "EB0", "EC0"] {
            let along = component.as_bytes()[1] - b'A';
            let own = match axis {
                AxisName::A => 0,
                AxisName::B => 1,
                _ => 2,
            };
            // A rotation about the axis itself has no effect and is rejected.
            if along == own || component.as_bytes()[1] == b'X' + own {
                continue;
            }
            writeln!(text, "{component}{axis} = {}", random.random_range(-100.0..100.0)).unwrap();
        }
    }
    Machine::parse(&text, "random.toml").unwrap()
}

fn errors(machine: &Machine) -> impl Fn(&State) -> [f64; 6] + '_ {
    let source = machine.source(&Temperatures::new());
    move |pose| {
        let found = volumetric_error(machine.chain(), &source, pose, Form::Exact);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    }
}

/// Over random poses: largest tip error and tilt after alignment, and largest tip error before.
fn brute_force(machine: &Machine, random: &mut ChaCha8Rng) -> [f64; 3] {
    let error_at = errors(machine);
    let mut sums = RigidSums::default();
    let mut found = Vec::with_capacity(POSES);
    for _ in 0..POSES {
        let at = machine.axes().iter().map(|axis| {
            let [low, high] = axis.travel;
            (axis.name, random.random_range(low..=high))
        });
        let mut pose = machine.state(&at.collect::<Vec<_>>()).unwrap();
        for side in &mut pose.approach {
            *side = Some(Direction::BOTH[usize::from(random.random::<bool>())]);
        }
        let [x, y, z, a, b, c] = error_at(&pose);
        let tip = machine.chain().ideal_tip_mm(&pose);
        let axis = machine.chain().ideal_pose(&pose).rotation * machine.chain().tool_axis();
        let (position, turn) = (Vector3::new(x, y, z), Vector3::new(a, b, c));
        sums.take(&tip, &position);
        found.push((tip, axis, position, turn));
    }
    let motion = sums.motion();
    let [mut positions, mut tilts, mut before] = [Lengths::default(); 3];
    for (tip, axis, position, turn) in found {
        before.take(&position);
        positions.take(&motion.left_mm(&tip, &position));
        let left = motion.left_rad(&turn);
        tilts.take(&(left - axis * axis.dot(&left)));
    }
    [positions.max(), tilts.max(), before.max()]
}

fn of_one_tool(machine: &Machine) -> VolumetricError {
    let error_at = errors(machine);
    let field = ErrorField { tool: "", machine, curves: vec![machine], errors: &error_at };
    volumetric(&[field]).unwrap()
}

/// The result is between 0.99 and 1.3 times that of the brute force: random poses miss the corners.
#[test]
fn the_largest_error_over_all_axes_is_that_of_brute_force() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for structure in volcomp_test_support::structures::all_types() {
        let structure = structure.to_string();
        let machine = random_machine(&structure, &mut random);
        let found = of_one_tool(&machine);
        let brute = brute_force(&machine, &mut random);
        let ours = [found.position.value, found.tilt.value, found.max_mm];
        for (ours, brute) in ours.into_iter().zip(brute) {
            assert!(ours > 0.99 * brute && ours < 1.3 * brute, "{structure}: {ours} {brute}");
        }
    }
}

/// An offset of a rotary axis by 0.2 mm is a rigid motion at one rotary pose, but an error of 0.2 mm over all angles.
#[test]
fn an_offset_of_a_rotary_axis_is_an_error_over_its_angles() {
    let text = "structure = \"w C' b X Y Z t\"\n[axes]\nC.travel = [-180.0, 180.0]\nX.travel = [-100.0, 100.0]\nY.travel = [-100.0, 100.0]\nZ.travel = [-100.0, 100.0]\n[errors]\nEX0C = 200.0\n";
    let machine = Machine::parse(text, "offset.toml").unwrap();
    let found = of_one_tool(&machine);
    // An axis at (o, 0) instead of 0 moves the tool by o − R(C)⁻¹ o in workpiece axes: the mean over a turn is o, and the residual has
    // the length of o at every angle.
    assert!((found.position.value - 0.2).abs() < 1e-3, "{found:?}");
    assert!((found.position_rms_mm - 0.2).abs() < 1e-3, "{found:?}");
    assert!(found.tilt.value < 1e-5, "{found:?}");
    assert_eq!(found.position.at.len(), 4);
}

/// No alignment removes backlash: the volumetric error contains half of the backlash on each side.
#[test]
fn play_is_part_of_the_volumetric_error() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[errors]\nEXX = { mean = { poly = [0.0] }, reversal = 100.0 }\n";
    let machine = Machine::parse(text, "play.toml").unwrap();
    let found = of_one_tool(&machine);
    assert!((found.position.value - 0.05).abs() < 1e-3, "{found:?}");
    assert!((found.position_rms_mm - 0.05).abs() < 1e-3, "{found:?}");
}

/// The largest error is at an end of travel approached downwards, before and after alignment.
#[test]
fn the_ends_of_the_travels_are_reached_from_both_sides() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[errors]\nEXX = { mean = { poly = [0.0, 0.2] }, reversal = -40.0 }\n";
    let machine = Machine::parse(text, "ends.toml").unwrap();
    let found = of_one_tool(&machine);
    // 0.2 µm/mm over 500 mm, plus half the backlash; alignment removes the mean, 50 µm.
    assert!((found.max_mm - 0.12).abs() < 1e-9, "{found:?}");
    assert!((found.position.value - 0.07).abs() < 1e-3, "{found:?}");
}

/// Each axis has a peak that is one table node wide. The search finds the pose at which all peaks add up.
#[test]
fn narrow_spots_of_curves_are_found() {
    use rand::RngExt as _;
    let mut random = ChaCha8Rng::seed_from_u64(8);
    for _ in 0..20 {
        let errors: String = ["EXX", "EYY", "EZZ"]
            .map(|name| {
                let spot = random.random_range(1..200);
                let node =
                    |place: u32| [f64::from(5 * place), if place == spot { 30.0 } else { 0.0 }];
                let table: Vec<[f64; 2]> = (0..=200).map(node).collect();
                format!("{name} = {{ table = {table:?}, interpolation = \"linear\" }}\n")
            })
            .concat();
        let text = format!(
            "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 1000]\nZ.travel = [0, 1000]\n[errors]\n{errors}"
        );
        let found = of_one_tool(&Machine::parse(&text, "spots.toml").unwrap());
        let expected = 0.03 * 3.0_f64.sqrt();
        assert!((found.max_mm - expected).abs() < 1e-6, "{found:?}");
        assert!(found.position.value > 0.97 * expected, "{found:?}");
    }
}

/// Cases with sums by hand: a peak that lowers the largest error but adds to another pose, a single grid node, and a peak in the curve of another
/// machine.
#[test]
fn spots_that_add_up_elsewhere_are_found() {
    let three = |errors: &str| {
        let text = format!(
            "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 1000]\nZ.travel = [0, 1000]\n[errors]\n{errors}"
        );
        Machine::parse(&text, "spot.toml").unwrap()
    };
    let spot = |um: f64| {
        format!(
            "EXX = {{ table = [[0, 0], [412.45, 0], [412.5, {um:?}], [412.55, 0], [1000, 0]], interpolation = \"linear\" }}\n"
        )
    };
    // EXY is 80 µm at one end of Y and −60 µm at the other: the peak of −60 µm adds to the smaller value.
    let wave = "EXY = { table = [[0, 80], [1000, -60]], interpolation = \"linear\" }\n";
    let found = of_one_tool(&three(&format!("{}{wave}", spot(-60.0))));
    assert!((found.max_mm - 0.12).abs() < 1e-6, "{found:?}");
    let mut values = vec![vec![0.0; 101]; 101];
    values[40][30] = 60.0;
    let nodes: Vec<f64> = (0..=100).map(|place| 10.0 * f64::from(place)).collect();
    let grid = three(&format!(
        "EZX = {{ grid = {{ axes = [\"X\", \"Y\"], nodes = [{nodes:?}, {nodes:?}], values = {values:?} }} }}\n"
    ));
    let found = of_one_tool(&grid);
    assert!((found.max_mm - 0.06).abs() < 1e-6, "{found:?}");
    let (model, truth) = (three("EXX = { poly = [0.0] }\n"), three(&spot(60.0)));
    let errors = errors(&truth);
    let field =
        ErrorField { tool: "", machine: &model, curves: vec![&model, &truth], errors: &errors };
    let found = volumetric(&[field]).unwrap();
    assert!((found.max_mm - 0.06).abs() < 1e-6, "{found:?}");
}

/// A constant tilt vanishes in the alignment with one tool. With two tool lengths more than 5 µm remain, because its effect at the tip
/// differs.
#[test]
fn tools_of_two_lengths_have_one_alignment() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[tool]\ngauge = [0.0, 0.0, 0.0]\nlength = 100.0\n[tools.SHORT]\nlength = 50.0\n[tools.LONG]\nlength = 250.0\n[errors]\nEBZ = 100.0\n";
    let machine = Machine::parse(text, "tools.toml").unwrap();
    assert_eq!(machine.extreme_tools().unwrap(), ["LONG", "SHORT"]);
    let with = |name: &str| {
        let mut machine = machine.clone();
        machine.select_tool(name).unwrap();
        machine
    };
    let [short, long] = ["SHORT", "LONG"].map(with);
    let (of_short, of_long) = (errors(&short), errors(&long));
    let field = |tool, machine, errors| ErrorField { tool, machine, curves: vec![machine], errors };
    let one = volumetric(&[field("SHORT", &short, &of_short)]).unwrap();
    assert!(one.position.value < 1e-5, "{one:?}");
    let both = [field("SHORT", &short, &of_short), field("LONG", &long, &of_long)];
    let both = volumetric(&both).unwrap();
    // 100 µrad over 200 mm are 20 µm between the tools; the alignment removes a part of them by a rotation.
    assert!(both.position.value > 0.005, "{both:?}");
}

/// The largest error over all tools is the largest error over the extreme tools. The extreme tools include a tool to
/// the side, whose lever differs from the levers of straight tools.
#[test]
fn the_error_is_largest_with_an_extreme_tool() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[tool]\ngauge = [0.0, 0.0, 0.0]\nlength = 100.0\n[tools.A]\nlength = 50.0\n[tools.B]\nlength = 120.0\n[tools.LONG]\nlength = 250.0\n[tools.SAME]\nlength = 250.0\n[tools.SIDE]\nlength = 100.0\noffset = [300.0, 0.0, 0.0]\n[tools.SIDE_SHORTER]\nlength = 100.0\noffset = [200.0, 0.0, 0.0]\n[tools.ANGLED]\ntip = [0.0, 0.0, -100.0]\naxis = [1.0, 0.0, 0.0]\n[errors]\nECZ = { poly = [0.0, 0.0, 1e-3] }\nEBZ = { poly = [0.0, 0.05] }\n";
    let machine = Machine::parse(text, "tools.toml").unwrap();
    let extreme = machine.extreme_tools().unwrap();
    assert_eq!(extreme, ["A", "ANGLED", "LONG", "SIDE"]);
    let all: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    let (of_extreme, of_all) = (largest(&machine, &extreme), largest(&machine, &all));
    assert!((of_extreme - of_all).abs() < 1e-9, "{of_extreme} {of_all}");
    assert!(of_all > 1.5 * largest(&machine, &["A", "LONG"]));
}

/// Largest error of the tip with any of these tools.
fn largest(machine: &Machine, names: &[&str]) -> f64 {
    let with = |name: &&str| {
        let mut machine = machine.clone();
        machine.select_tool(name).unwrap();
        machine
    };
    let machines: Vec<Machine> = names.iter().map(with).collect();
    let of_machines: Vec<_> = machines.iter().map(errors).collect();
    let field = |(machine, errors)| ErrorField { tool: "", machine, curves: vec![machine], errors };
    let fields: Vec<_> = machines
        .iter()
        .zip(of_machines.iter().map(|errors| errors as &dyn Fn(&_) -> _))
        .map(field)
        .collect();
    volumetric(&fields).unwrap().max_mm
}

/// Angled heads that reach lower than the longest straight tool do not replace that tool in the search: its largest
/// tilt is about an axis nearly parallel to the tools of the heads.
#[test]
fn the_longest_straight_tool_counts_beside_angled_heads() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[tool]\ngauge = [0.0, 0.0, 0.0]\nlength = 81.0\n[tools.SHORT]\nlength = 81.0\n[tools.LONG]\nlength = 189.0\n[tools.SIDE]\nlength = 243.0\naxis = [0.0, -1.0, 0.0]\n[tools.HEAD]\nlength = 299.0\naxis = [0.0, 1.0, 1.0]\n[errors]\nEAZ = 4.0\nEBZ = 48.0\nECZ = 19.0\n";
    let machine = Machine::parse(text, "heads.toml").unwrap();
    let extreme = machine.extreme_tools().unwrap();
    let all: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    let (of_extreme, of_all) = (largest(&machine, &extreme), largest(&machine, &all));
    assert!((of_extreme - of_all).abs() < 1e-9, "{of_extreme} {of_all} {extreme:?}");
    assert!(extreme.contains(&"LONG"), "{extreme:?}");
}

/// A tip slightly off the line between two others is an extreme tool, although it is outermost in few directions.
#[test]
fn a_tip_beside_the_line_between_two_others_counts() {
    let text = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 500.0]\nY.travel = [0.0, 500.0]\nZ.travel = [0.0, 500.0]\n[tools.LEFT]\ntip = [-400.0, 0.0, -100.0]\n[tools.RIGHT]\ntip = [400.0, 0.0, -130.0]\n[tools.MIDDLE]\ntip = [0.0, 0.0, -115.0]\n[tools.OUT]\ntip = [50.0, 3.0, -119.0]\n[errors]\nEAZ = 4.0\n";
    let machine = Machine::parse(text, "tools.toml").unwrap();
    let extreme = machine.extreme_tools().unwrap();
    assert_eq!(extreme, ["LEFT", "OUT", "RIGHT"]);
}

/// Errors are narrow peaks of both signs in all axes and components. A peak may lower the error at one pose and raise it at another, and two peaks
/// may have to coincide: at least 98 % of the largest error over all combinations of table nodes is found.
#[test]
fn spots_that_must_be_met_together_are_found() {
    for (structure, cases) in [("w b X Y Z t", 10), ("w C' b X Y Z t", 3)] {
        for seed in 0..cases {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let (machine, nodes) = machine_of_spots(structure, &mut random);
            let found = of_one_tool(&machine);
            let truth = largest_at_nodes(&machine, &nodes, &found);
            for (ours, truth) in [found.max_mm, found.position.value].iter().zip(truth) {
                assert!(
                    *ours > 0.98 * truth,
                    "{structure}, seed {seed}: found {ours} mm of {truth} mm"
                );
            }
        }
    }
}

/// A machine with two peaks per curve, 0.1 mm or 0.1° wide, and the table nodes of each axis.
fn machine_of_spots(structure: &str, random: &mut ChaCha8Rng) -> (Machine, Vec<Vec<f64>>) {
    let axes: Vec<AxisName> = structure
        .split_whitespace()
        .filter_map(|part| AxisName::from_letter(part.chars().next()?))
        .collect();
    let mut text = format!("structure = \"{structure}\"\n[axes]\n");
    let mut errors = String::new();
    let mut nodes = Vec::new();
    for axis in &axes {
        let end = if axis.is_rotary() { 170.0 } else { 300.0 };
        writeln!(text, "{axis}.travel = [{:?}, {end:?}]", -end).unwrap();
        let spots: [f64; 3] = std::array::from_fn(|_| random.random_range(-0.9..0.9) * end);
        let mut of_axis = vec![-end, end];
        of_axis.extend(spots.iter().flat_map(|at| [at - 0.05, *at, at + 0.05]));
        of_axis.sort_by(f64::total_cmp);
        for component in ["EX", "EY", "EZ"] {
            let table: Vec<[f64; 2]> = of_axis
                .iter()
                .map(|at| {
                    let spot = spots.contains(at);
                    let size = if spot { 60.0 } else { 10.0 };
                    [*at, random.random_range(-size..size)]
                })
                .collect();
            writeln!(
                errors,
                "{component}{axis} = {{ table = {table:?}, interpolation = \"linear\" }}"
            )
            .unwrap();
        }
        nodes.push(of_axis);
    }
    let machine = Machine::parse(&format!("{text}[errors]\n{errors}"), "spots.toml").unwrap();
    (machine, nodes)
}

/// Largest error over all combinations of nodes, mm, before and after the alignment in `found`.
fn largest_at_nodes(machine: &Machine, nodes: &[Vec<f64>], found: &VolumetricError) -> [f64; 2] {
    let error_at = errors(machine);
    let [mut before, mut after] = [Lengths::default(); 2];
    let combinations = nodes.iter().map(Vec::len).product::<usize>();
    for number in 0..combinations {
        let mut rest = number;
        let at = machine.axes().iter().zip(nodes).map(|(axis, nodes)| {
            let node = nodes[rest % nodes.len()];
            rest /= nodes.len();
            (axis.name, node)
        });
        let pose = machine.state(&at.collect::<Vec<_>>()).unwrap();
        let [x, y, z, ..] = error_at(&pose);
        let error = Vector3::new(x, y, z);
        before.take(&error);
        after.take(&found.alignment.left_mm(&machine.chain().ideal_tip_mm(&pose), &error));
    }
    [before.max(), after.max()]
}

/// A peak in the curve of one direction that adds to a peak of another axis is found.
#[test]
fn a_spot_of_one_direction_is_found() {
    let text = "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 500]\n[errors]\nEXX = { forward = { table = [[0, -4], [175, -4], [187.5, -10], [200, -4], [700, -4], [700.5, 9], [701, -4], [1000, -4]], interpolation = \"linear\" }, backward = { table = [[0, 4], [1000, 4]], interpolation = \"linear\" } }\nEXY = { table = [[0, 0], [235, 0], [240, 5], [260, 5], [265, 0], [500, 0]], interpolation = \"linear\" }\n";
    let found = of_one_tool(&Machine::parse(text, "direction.toml").unwrap());
    assert!((found.max_mm - 0.014).abs() < 1e-6, "{found:?}");
}

/// The search finds a peak of a linear axis that adds to a peak of the rotary table but reduces the error at all other
/// angles.
#[test]
fn a_spot_that_adds_at_one_angle_is_found() {
    let text = "structure = \"w C' X' b Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 500]\nZ.travel = [0, 500]\nC = { travel = [0, 360], point = [500, 250, 0] }\n[errors]\nEXX = { table = [[0, -10], [613.0, -10], [613.5, 6], [614.0, -10], [1000, -10]], interpolation = \"linear\" }\nEXC = { table = [[0, 0], [195, 0], [197, 14], [223, 14], [225, 0], [360, 0]], interpolation = \"linear\" }\n";
    let found = of_one_tool(&Machine::parse(text, "angle.toml").unwrap());
    assert!((found.max_mm - 0.020).abs() < 1e-6, "{found:?}");
}

type Point = (Vector3<f64>, Vector3<f64>);

fn best(points: &[Point]) -> RigidMotion {
    sums(points).motion()
}

fn sums(points: &[Point]) -> RigidSums {
    let mut sums = RigidSums::default();
    for (place, error) in points {
        sums.take(place, error);
    }
    sums
}

/// RMS and maximum of the residual, µm.
fn left_um(points: &[Point]) -> [f64; 2] {
    let motion = best(points);
    let mut lengths = Lengths::default();
    for (place, error) in points {
        lengths.take(&motion.left_mm(place, error));
    }
    [1e3 * lengths.rms(), 1e3 * lengths.max()]
}

/// Points on a regular grid over a box of this size with a corner at `from`, mm.
fn box_of(size: [f64; 3], from: [f64; 3]) -> Vec<Vector3<f64>> {
    let mut places = Vec::new();
    for index in 0..7 * 5 * 4 {
        let share = [
            f64::from(index % 7) / 6.0,
            f64::from(index / 7 % 5) / 4.0,
            f64::from(index / 35) / 3.0,
        ];
        places.push(Vector3::from_fn(|k, _| from[k] + size[k] * share[k]));
    }
    places
}

const BOXES: [([f64; 3], [f64; 3]); 6] = [
    ([20_000.0, 6_000.0, 3_000.0], [0.0; 3]),
    ([40_000.0, 8_000.0, 4_000.0], [-500.0, 0.0, 1_000.0]),
    ([600.0, 500.0, 400.0], [0.0, 0.0, -400.0]),
    ([100.0; 3], [1_000.0, 1_000.0, 500.0]),
    ([100.0; 3], [100_000.0, -100_000.0, 100_000.0]),
    ([40_000.0, 1.0, 0.1], [0.0; 3]),
];

#[test]
fn a_rigid_motion_leaves_nothing() {
    let motions = [
        ([0.0229, 0.0, 0.0], [0.0; 3]),
        ([0.4, -0.3, 0.2], [50e-6, -80e-6, 30e-6]),
        ([0.0; 3], [0.0, 0.0, 120e-6]),
    ];
    for (size, from) in BOXES {
        for (shift, turn) in motions {
            let (shift, turn) = (Vector3::from(shift), Vector3::from(turn));
            let points: Vec<Point> = box_of(size, from)
                .into_iter()
                .map(|place| (place, shift + turn.cross(&place)))
                .collect();
            let [rms, max] = left_um(&points);
            assert!(rms <= max && max < 1e-6, "{size:?} {from:?}: {rms} {max}");
            let found = best(&points);
            // For points within 0.1 mm of a line of 40 m, the rotation about the line has an effect of a few pm only.
            if size[2] > 1.0 {
                assert!((found.rotation_rad - turn).norm() < 1e-12, "{found:?}");
            }
            let orientation = found.left_rad(&turn);
            assert!(size[2] < 1.0 || orientation.norm() < 1e-12);
            let rms_um = 1e3 * sums(&points).rms_left_mm();
            assert!(rms_um < 1e-4, "{size:?} {from:?}: {rms_um}");
        }
    }
}

/// With random errors the residual equals that of a dense solution within 1e-6 µm.
#[test]
fn what_is_left_is_what_a_dense_decomposition_leaves() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for (size, from) in BOXES {
        let points: Vec<Point> = box_of(size, from)
            .into_iter()
            .map(|place| {
                let error = Vector3::from_fn(|_, _| random.random_range(-0.05..0.05));
                (place, error)
            })
            .collect();
        let dense = dense_left_um(&points);
        let [rms, max] = left_um(&points);
        let [dense_rms, dense_max] = dense;
        assert!((rms - dense_rms).abs() < 1e-6, "{size:?}: {rms} {dense:?}");
        assert!((max - dense_max).abs() < 1e-6, "{size:?}: {max} {dense:?}");
        assert!((1e3 * sums(&points).rms_left_mm() - rms).abs() < 1e-6);
    }
}

/// RMS and maximum residual, µm, by least squares with a dense matrix of six normalised columns; points relative to the middle of their
/// range.
fn dense_left_um(points: &[Point]) -> [f64; 2] {
    let rows = 3 * points.len();
    let low = points.iter().fold(points[0].0, |a, p| a.inf(&p.0));
    let high = points.iter().fold(points[0].0, |a, p| a.sup(&p.0));
    let middle = (low + high) / 2.0;
    let matrix = DMatrix::from_fn(rows, 6, |row, column| {
        let (place, axis) = (points[row / 3].0 - middle, row % 3);
        let mut unit = Vector3::zeros();
        unit[column % 3] = 1.0;
        if column < 3 { unit[axis] } else { unit.cross(&place)[axis] }
    });
    let lengths: Vec<f64> = matrix.column_iter().map(|c| c.norm().max(1e-300)).collect();
    let scaled = DMatrix::from_fn(rows, 6, |row, column| matrix[(row, column)] / lengths[column]);
    let errors = DVector::from_fn(rows, |row, _| points[row / 3].1[row % 3]);
    let svd = scaled.clone().svd(true, true);
    let found = svd.solve(&errors, 1e-12).unwrap();
    let left = errors - scaled * found;
    let mut all = Lengths::default();
    for of in left.as_slice().chunks(3) {
        all.take(&Vector3::new(of[0], of[1], of[2]));
    }
    [1e3 * all.rms(), 1e3 * all.max()]
}

/// A rotation is zero only if the points do not determine it: about a line through all points, or any rotation about a single point.
#[test]
fn points_in_a_plane_on_a_line_or_at_one_place() {
    let turn = Vector3::new(20e-6, -30e-6, 40e-6);
    let shift = Vector3::new(0.01, 0.02, -0.03);
    let along = Vector3::new(3.0, -2.0, 6.0) / 7.0;
    let off_zero = Vector3::new(1e5, 2e4, -3e4);
    let across = Vector3::new(2.0, 6.0, 1.0).normalize();
    let point = |place: Vector3<f64>| (place, shift + turn.cross(&place));
    let line: Vec<Point> = (0..30).map(|k| point(off_zero + along * f64::from(k) * 11.3)).collect();
    let plane: Vec<Point> = (0..30)
        .map(|k| point(off_zero + along * f64::from(k) * 11.3 + across * f64::from(k % 4) * 70.0))
        .collect();
    let single = vec![point(off_zero); 5];
    for (points, seen) in
        [(&line, turn - along * along.dot(&turn)), (&plane, turn), (&single, Vector3::zeros())]
    {
        let found = best(points);
        assert!((found.rotation_rad - seen).norm() < 1e-11, "{found:?}");
        let [_, max] = left_um(points);
        assert!(max < 1e-6, "{max}");
    }
    let mut none = RigidSums::default();
    none.merge(&RigidSums::default());
    assert_eq!(none.motion().rotation_rad, Vector3::zeros());
    assert_eq!(none.rms_left_mm(), 0.0);
}

/// Merged partial sums equal the sums over all points.
#[test]
fn parts_are_put_together() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let places = box_of([20_000.0, 6_000.0, 3_000.0], [0.0; 3]);
    let points: Vec<Point> = places
        .into_iter()
        .map(|p| (p, Vector3::from_fn(|_, _| random.random_range(-0.1..0.1))))
        .collect();
    let whole = best(&points);
    let mut parts = RigidSums::default();
    for part in points.chunks(17) {
        parts.merge(&sums(part));
    }
    let of_parts = parts.motion();
    assert!((whole.shift_mm - of_parts.shift_mm).norm() < 1e-15);
    assert!((whole.rotation_rad - of_parts.rotation_rad).norm() < 1e-18);
}

/// Numbers that are NaN, infinite or overflow do not panic.
#[test]
fn what_is_no_number_stays_none() {
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let mut sums = RigidSums::default();
        for k in 0..4 {
            let place = Vector3::new(f64::from(k), bad, 1.0);
            sums.take(&place, &Vector3::repeat(bad));
        }
        let _ = (sums.motion(), sums.rms_left_mm());
    }
}
