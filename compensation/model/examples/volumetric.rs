//! Validates the volumetric error on random five-axis machines of every type. The reference is the largest error after
//! alignment by brute force, with a separate implementation of kinematics, curves and alignment.
//!
//! `cargo run --release -p volcomp-model --example volumetric -- 200 1000000`: 200 machines with a million random poses
//! each. The result must be at least 99 % of the true value; otherwise a machine could pass wrongly.

use std::{fmt::Write as _, sync::atomic::AtomicU64, sync::atomic::Ordering, thread};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::{
    ErrorField, Machine, Temperatures,
    kinematics::{Form, Side, State, Structure, nalgebra::DMatrix, nalgebra::DVector},
    vocabulary::AxisName,
    volumetric,
};

type V3 = [f64; 3];

const THREADS: u64 = 2;
/// Required share of the true value.
const TOLERANCE: f64 = 0.99;
/// Number of poses from which the brute force searches locally.
const FROM: usize = 8;
const LOOKS: u32 = 4000;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let mut count = |otherwise: u32| {
        let given = arguments.next().map(|word| word.parse::<u32>());
        given.transpose().map(|count| count.unwrap_or(otherwise))
    };
    let (Ok(machines), Ok(poses)) = (count(20), count(100_000)) else {
        eprintln!("expected a number of machines and a number of poses");
        std::process::exit(2);
    };
    let next = AtomicU64::new(0);
    let work = || {
        let mut found = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= u64::from(machines) {
                return found;
            }
            found.push(compared(seed, poses));
        }
    };
    let found: Vec<Compared> = thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
        let found = threads.into_iter().map(thread::ScopedJoinHandle::join);
        found.flat_map(|found| found.expect("a thread that ends")).collect()
    });
    println!("{machines} machines, {poses} random poses of each");
    for (what, of) in [("position", 0), ("tilt", 1)] {
        let ratios = |by: fn(&Truth) -> f64| {
            let all = found.iter().map(|one| one.found[of] / by(&one.truth[of]));
            let [low, high] = all.fold([f64::INFINITY, 0.0_f64], |[low, high], ratio| {
                [low.min(ratio), high.max(ratio)]
            });
            format!("{low:.4} to {high:.4}")
        };
        let off = |one: &&Compared| (one.found[of] / one.truth[of].largest() - 1.0).abs() > 0.05;
        let passed = |one: &&Compared| one.found[of] <= TOLERANCE * one.truth[of].largest();
        println!("largest {what}, of that which is found by volumetric:");
        println!("  to the worst random pose:       {}", ratios(|of| of.random));
        println!("  to the worst pose near those:   {}", ratios(|of| of.near));
        println!("  at its own pose, by hand:       {}", ratios(|of| of.there));
        println!("  more than 5 % off the truth:    {}", found.iter().filter(off).count());
        println!("  below 99 % of it, false passes: {}", found.iter().filter(passed).count());
        for one in found.iter().filter(off).chain(found.iter().filter(passed)) {
            println!(
                "    machine {} `{}`: {:?} {:?}",
                one.seed, one.structure, one.found[of], one.truth[of]
            );
        }
    }
}

/// The largest error or tilt by brute force, mm or rad.
#[derive(Clone, Copy, Debug, Default)]
struct Truth {
    random: f64,
    near: f64,
    /// The value at the pose that `volumetric` finds.
    there: f64,
}

impl Truth {
    fn largest(&self) -> f64 {
        self.random.max(self.near).max(self.there)
    }
}

struct Compared {
    seed: u64,
    structure: String,
    found: [f64; 2],
    truth: [Truth; 2],
}

fn compared(seed: u64, poses: u32) -> Compared {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let own = Own::random(seed, &mut random);
    let machine = Machine::parse(&own.file(), "random.toml").expect("a machine");
    let source = machine.source(&Temperatures::new());
    let errors = |pose: &State| {
        let found = volcomp_model::kinematics::volumetric_error(
            machine.chain(),
            &source,
            pose,
            Form::Exact,
        );
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    };
    let field = ErrorField { tool: "", curves: vec![&machine], machine: &machine, errors: &errors };
    let found = volumetric(&[field]).expect("a machine with axes");
    let mut truth = own.brute_force(poses as usize, &mut random);
    let aligned = truth.1;
    let named = [&found.position.at, &found.tilt.at];
    for (of, (truth, named)) in truth.0.iter_mut().zip(named).enumerate() {
        let place = own.axes.iter().map(|axis| {
            let at = named.iter().find(|(name, _)| *name == axis.name);
            at.expect("every axis").1
        });
        let place: Vec<f64> = place.collect();
        // The pose does not include the directions of approach, so the largest error of all combinations counts.
        for sides in 0..1_usize << place.len() {
            let side = |axis: usize| if sides >> axis & 1 == 1 { 1.0 } else { -1.0 };
            let sides = (0..place.len()).map(side);
            let pose: Vec<f64> = place.iter().copied().chain(sides).collect();
            truth.there = truth.there.max(aligned.left(&own.at(&pose))[of]);
        }
    }
    Compared {
        seed,
        structure: own.structure.to_string(),
        found: [found.position.value, found.tilt.value],
        truth: truth.0,
    }
}

/// A machine with axes along the directions of their letters, implemented independently of the crates.
struct Own {
    structure: Structure,
    /// The axes from workpiece to tool.
    axes: Vec<Axis>,
    tip: V3,
}

struct Axis {
    name: AxisName,
    on_workpiece: bool,
    turning: bool,
    travel: [f64; 2],
    point: V3,
    curves: [Curve; 6],
    /// Backlash, µm and µrad: half is added when a position is approached upwards, and subtracted otherwise.
    reversal: [f64; 6],
    /// EX0 … EC0, µm and µrad.
    location: [f64; 6],
}

enum Curve {
    Chebyshev(Vec<f64>),
    /// Over 360°: mean, then cosine and sine of each harmonic.
    Fourier(Vec<f64>),
}

/// An error and its pose, mm and rad.
struct At {
    tip: V3,
    tool_axis: V3,
    error: V3,
    turn: V3,
}

/// A small rigid motion of the workpiece: a translation, and a rotation about `about`.
#[derive(Clone, Copy)]
struct Aligned {
    about: V3,
    shift: V3,
    turn: V3,
}

impl Aligned {
    /// Length of the residual error of the tip, mm, and residual tilt of the tool axis, rad.
    fn left(&self, at: &At) -> [f64; 2] {
        let moved = plus(self.shift, cross(self.turn, minus(at.tip, self.about)));
        let turn = minus(at.turn, self.turn);
        let along = dot(turn, at.tool_axis);
        [length(minus(at.error, moved)), length(minus(turn, scaled(at.tool_axis, along)))]
    }
}

impl Own {
    fn random(seed: u64, random: &mut impl Rng) -> Self {
        let pairs = [
            [AxisName::A, AxisName::B],
            [AxisName::A, AxisName::C],
            [AxisName::B, AxisName::A],
            [AxisName::B, AxisName::C],
            [AxisName::C, AxisName::A],
            [AxisName::C, AxisName::B],
        ];
        let pair = pairs[random.random_range(0..pairs.len())];
        let [_, _, _, _, _, _, _, of_twelve] = (seed % 12).to_be_bytes();
        let structure =
            Structure::from_type(of_twelve % 4, 1 + of_twelve / 4, &pair).expect("a type");
        let sizes = [random.random_range(1.0..10.0), random.random_range(1.0..20.0)];
        // Probability with which a machine has each error.
        let share = [1.0, 0.2][random.random_range(0..2_usize)];
        let axes = structure.axes().iter().enumerate().map(|(index, &name)| {
            let travel = if name.is_rotary() {
                let some = [random.random_range(-130.0..-20.0), random.random_range(20.0..130.0)];
                [[-180.0, 180.0], some][random.random_range(0..2_usize)]
            } else {
                [random.random_range(-1000.0..0.0), random.random_range(100.0..1000.0)]
            };
            let curves = std::array::from_fn(|k| {
                let size = if random.random_bool(share) { sizes[k / 3] } else { 0.0 };
                let mut some = |count: usize| -> Vec<f64> {
                    (0..count).map(|_| size * random.random_range(-1.0..1.0)).collect()
                };
                if name.is_rotary() {
                    Curve::Fourier(some(3 + 2 * (k % 4)))
                } else {
                    Curve::Chebyshev(some(3 + k))
                }
            });
            let play = |_| random.random_bool(0.3).then(|| random.random_range(-8.0..8.0));
            let reversal = [0, 1, 2, 3, 4, 5].map(play).map(Option::unwrap_or_default);
            let mut location = [0.0; 6];
            for (k, value) in location.iter_mut().enumerate() {
                // A rotation about the axis itself and an offset of a linear axis have no effect.
                if k % 3 == name.mcs_index()
                    || (k < 3 && !name.is_rotary())
                    || !random.random_bool(share)
                {
                    continue;
                }
                *value = random.random_range(-100.0..100.0);
            }
            Axis {
                name,
                on_workpiece: structure.side(index) == Side::Workpiece,
                turning: name.is_rotary() && random.random_bool(0.5),
                travel,
                point: std::array::from_fn(|_| random.random_range(-300.0..300.0)),
                curves,
                reversal,
                location,
            }
        });
        let axes = axes.collect();
        let tip = std::array::from_fn(|_| random.random_range(-200.0..200.0));
        Self { structure, axes, tip }
    }

    fn file(&self) -> String {
        let mut text =
            format!("structure = \"{}\"\n[tool]\ntip = {:?}\n", self.structure, self.tip);
        let mut errors = "[errors]\n".to_owned();
        for axis in &self.axes {
            let Axis { name, travel, point, .. } = axis;
            let frame = if axis.turning { "motion_frame = \"turning\"\n" } else { "" };
            let _ =
                writeln!(text, "[axes.{name}]\ntravel = {travel:?}\npoint = {point:?}\n{frame}");
            for (k, component) in ["EX", "EY", "EZ", "EA", "EB", "EC"].into_iter().enumerate() {
                let curve = match &axis.curves[k] {
                    Curve::Chebyshev(c) => format!("{{ chebyshev = {c:?}, domain = {travel:?} }}"),
                    Curve::Fourier(c) => format!("{{ fourier = {c:?}, period = 360.0 }}"),
                };
                let _ = match axis.reversal[k] {
                    0.0 => writeln!(errors, "{component}{name} = {curve}"),
                    play => writeln!(
                        errors,
                        "{component}{name} = {{ mean = {curve}, reversal = {play} }}"
                    ),
                };
                if axis.location[k] != 0.0 {
                    let _ = writeln!(errors, "{component}0{name} = {}", axis.location[k]);
                }
            }
        }
        text + &errors
    }

    /// The error at a pose: coordinates in mm and deg, then the directions of approach (1 upwards, −1 downwards). The tip is transformed
    /// from tool to workpiece twice, with and without errors.
    fn at(&self, pose: &[f64]) -> At {
        let (mut ideal, mut real) = (self.tip, self.tip);
        let (mut tool_axis, mut turn) = ([0.0, 0.0, 1.0], [0.0; 3]);
        let (coordinates, sides) = pose.split_at(self.axes.len());
        for ((axis, &q), side) in self.axes.iter().zip(coordinates).zip(sides).rev() {
            let six: [f64; 6] = std::array::from_fn(|k| {
                axis.curves[k].value(q, axis.travel) + 0.5 * side * axis.reversal[k]
            });
            let [shift, tilt] = in_mm_and_rad(six);
            let [offset, lean] = in_mm_and_rad(axis.location);
            let own_error = |real: &mut V3, turn: &mut V3| {
                let lever = minus(*real, axis.point);
                *real = plus(*real, plus(shift, cross(tilt, lever)));
                *turn = plus(*turn, tilt);
            };
            // The error motions of a linear axis move with it, like those of a rotary axis in the turning frame.
            let rides = !axis.name.is_rotary() || axis.turning;
            let before = rides != axis.on_workpiece;
            if before {
                own_error(&mut real, &mut turn);
            }
            let mut along = [0.0; 3];
            along[axis.name.mcs_index()] = 1.0;
            let leaning = plus(along, cross(lean, along));
            if axis.name.is_rotary() {
                let leaning = scaled(leaning, 1.0 / length(leaning));
                let (place, angle) = (plus(axis.point, offset), q.to_radians());
                ideal = plus(axis.point, turned(along, angle, minus(ideal, axis.point)));
                real = plus(place, turned(leaning, angle, minus(real, place)));
                tool_axis = turned(along, angle, tool_axis);
                turn = plus(turned(along, angle, minus(turn, lean)), lean);
            } else {
                ideal = plus(ideal, scaled(along, q));
                real = plus(real, scaled(leaning, q));
            }
            if !before {
                own_error(&mut real, &mut turn);
            }
        }
        At { tip: ideal, tool_axis, error: minus(real, ideal), turn }
    }

    fn brute_force(&self, poses: usize, random: &mut impl Rng) -> ([Truth; 2], Aligned) {
        let mut coordinates = Vec::with_capacity(2 * poses * self.axes.len());
        let mut found = Vec::with_capacity(poses);
        for _ in 0..poses {
            let place = self.axes.iter().map(|axis| {
                let [low, high] = axis.travel;
                random.random_range(low..=high)
            });
            let mut pose: Vec<f64> = place.collect();
            pose.extend(self.axes.iter().map(|_| if random.random() { 1.0 } else { -1.0 }));
            found.push(self.at(&pose));
            coordinates.extend(pose);
        }
        let aligned = aligned(&found);
        let left: Vec<[f64; 2]> = found.iter().map(|at| aligned.left(at)).collect();
        let truth = [0, 1].map(|of| {
            let mut worst: Vec<usize> = (0..poses).collect();
            let descending = |a: &usize, b: &usize| left[*b][of].total_cmp(&left[*a][of]);
            worst.select_nth_unstable_by(FROM.min(poses - 1), descending);
            worst.truncate(FROM);
            worst.sort_by(descending);
            let random_poses = left[worst[0]][of];
            let mut near = random_poses;
            for place in worst {
                let width = 2 * self.axes.len();
                let mut best = coordinates[place * width..][..width].to_vec();
                let mut value = left[place][of];
                let mut reach = 0.2;
                for _ in 0..LOOKS {
                    let mut there = best.clone();
                    let (place, sides) = there.split_at_mut(self.axes.len());
                    // Some axes keep their position, and a few change their direction of approach.
                    for ((axis, at), side) in self.axes.iter().zip(place).zip(sides) {
                        let [low, high] = axis.travel;
                        if random.random() {
                            let step = random.random_range(-1.0..1.0);
                            *at = (*at + reach * step * (high - low)).clamp(low, high);
                        }
                        if random.random_bool(0.1) {
                            *side = -*side;
                        }
                    }
                    let other = aligned.left(&self.at(&there))[of];
                    if other > value {
                        (value, best) = (other, there);
                    } else {
                        reach *= 0.998;
                    }
                }
                near = near.max(value);
            }
            Truth { random: random_poses, near, there: 0.0 }
        });
        (truth, aligned)
    }
}

impl Curve {
    fn value(&self, q: f64, [low, high]: [f64; 2]) -> f64 {
        match self {
            Self::Chebyshev(c) => {
                let x = ((2.0 * q - low - high) / (high - low)).clamp(-1.0, 1.0);
                let (mut sum, mut term, mut next) = (0.0, 1.0, x);
                for c in c {
                    sum += c * term;
                    (term, next) = (next, 2.0 * x * next - term);
                }
                sum
            }
            Self::Fourier(c) => {
                // Each harmonic is the previous one rotated by the angle.
                let (sin, cos) = q.to_radians().sin_cos();
                let (mut sum, mut of) = (c[0], [cos, sin]);
                for pair in c[1..].chunks(2) {
                    sum += pair[0] * of[0] + pair[1] * of[1];
                    of = [of[0] * cos - of[1] * sin, of[1] * cos + of[0] * sin];
                }
                sum
            }
        }
    }
}

/// Least-squares rigid motion of the position errors, by normal equations of six unknowns.
fn aligned(found: &[At]) -> Aligned {
    let mut about = [0.0; 3];
    for at in found {
        about = plus(about, scaled(at.tip, 1.0 / found.len() as f64));
    }
    let (mut matrix, mut right) = (DMatrix::<f64>::zeros(6, 6), DVector::<f64>::zeros(6));
    for at in found {
        // In metres, so that translations and rotations are of similar size.
        let [x, y, z] = scaled(minus(at.tip, about), 1e-3);
        let rows =
            [[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]];
        for (row, error) in rows.iter().zip(at.error) {
            for i in 0..6 {
                right[i] += row[i] * error;
                for j in 0..6 {
                    matrix[(i, j)] += row[i] * row[j];
                }
            }
        }
    }
    let solved = matrix.lu().solve(&right).expect("poses that see every motion");
    Aligned {
        about,
        shift: [solved[0], solved[1], solved[2]],
        turn: scaled([solved[3], solved[4], solved[5]], 1e-3),
    }
}

fn in_mm_and_rad([x, y, z, a, b, c]: [f64; 6]) -> [V3; 2] {
    [scaled([x, y, z], 1e-3), scaled([a, b, c], 1e-6)]
}

/// Rotates a point about an axis (Rodrigues).
fn turned(axis: V3, angle: f64, p: V3) -> V3 {
    let (sin, cos) = angle.sin_cos();
    let across = plus(scaled(p, cos), scaled(cross(axis, p), sin));
    plus(across, scaled(axis, dot(axis, p) * (1.0 - cos)))
}

fn plus(a: V3, b: V3) -> V3 {
    std::array::from_fn(|k| a[k] + b[k])
}

fn minus(a: V3, b: V3) -> V3 {
    std::array::from_fn(|k| a[k] - b[k])
}

fn scaled(a: V3, by: f64) -> V3 {
    a.map(|x| x * by)
}

fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V3, b: V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: V3) -> f64 {
    dot(a, a).sqrt()
}
