//! Random programs on machines with lost motion, judged by a reader and a play operator that share nothing with the crate: at the end of every motion the
//! tool is where the program wants it, also after G28, G53 and drilling cycles.

use std::{collections::BTreeMap, fmt::Write as _};

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::Machine;
use volcomp_nc::{Decimals, Job, SetUp};

use crate::identity::result_of;

type Xyz = [f64; 3];

const LETTERS: [char; 3] = ['X', 'Y', 'Z'];
const HOME: Xyz = [0.0, 0.0, 10.0];

/// Lost motion of each axis, µm; error of each axis along itself and of Y and Z along X, both µm and µm/mm; work offset, mm.
struct World {
    lost_um: Xyz,
    along: [[f64; 2]; 3],
    across: [[f64; 2]; 2],
    offset: Xyz,
}

impl World {
    fn draw(draw: &mut ChaCha8Rng) -> Self {
        let line = |draw: &mut ChaCha8Rng| {
            [draw.random_range(-10.0..10.0), draw.random_range(-0.08..0.08)]
        };
        Self {
            lost_um: [(); 3].map(|()| draw.random_range(2.0..25.0)),
            along: [(); 3].map(|()| line(draw)),
            across: [(); 2].map(|()| line(draw)),
            offset: [(); 3].map(|()| [0.0, 12.5, -33.0][draw.random_range(0..3)]),
        }
    }

    fn machine(&self) -> Machine {
        let mut text = "structure = \"w b X Y Z t\"\n".to_owned();
        for letter in LETTERS {
            let _ = writeln!(text, "axes.{letter}.travel = [-500, 500]"); // writing to a String cannot fail
        }
        text.push_str("[errors]\n");
        for ((letter, lost), along) in LETTERS.iter().zip(self.lost_um).zip(self.along) {
            let _ = writeln!(
                text,
                "E{letter}{letter} = {{ mean = {{ poly = {along:?} }}, reversal = -{lost} }}"
            );
        }
        for (letter, across) in ['Y', 'Z'].iter().zip(self.across) {
            let _ = writeln!(text, "E{letter}X = {{ poly = {across:?} }}");
        }
        Machine::parse(&text, "m.toml").expect("a good machine")
    }

    fn set_up(&self) -> SetUp {
        let places = |at: Xyz| {
            let [x, y, z] = at;
            format!("X = {x:?}\nY = {y:?}\nZ = {z:?}\n")
        };
        let [start, offset, home] = [[0.0; 3], self.offset, HOME].map(places);
        let text = format!("[start]\n{start}[work_offset.G54]\n{offset}[home.G28]\n{home}");
        SetUp::parse(&text, "s.toml").expect("a good set-up")
    }
}

/// The drives, and the carriages that they push.
struct Drives<'a> {
    world: &'a World,
    drive: Xyz,
    carriage: Xyz,
}

impl Drives<'_> {
    fn go(&mut self, to: Xyz) {
        self.drive = to;
        for ((carriage, to), lost_um) in self.carriage.iter_mut().zip(to).zip(self.world.lost_um) {
            let half = 5e-4 * lost_um;
            *carriage = carriage.clamp(to - half, to + half);
        }
    }

    /// Machine coordinates of the tool.
    fn tool(&self) -> Xyz {
        let um = |[constant, slope]: [f64; 2], axis: usize| constant + slope * self.drive[axis];
        let of = |axis: usize| {
            let across = match axis {
                0 => 0.0,
                _ => um(self.world.across[axis - 1], 0),
            };
            self.carriage[axis] + 1e-3 * (um(self.world.along[axis], axis) + across)
        };
        [of(0), of(1), of(2)]
    }
}

/// Position of the tool at each mark `(N)` of a program; in a hole, at its bottom.
fn played(text: &str, world: &World) -> BTreeMap<usize, Xyz> {
    let mut drives = Drives { world, drive: [0.0; 3], carriage: [0.0; 3] };
    let in_machine = |at: Xyz| [0, 1, 2].map(|axis| at[axis] + world.offset[axis]);
    // Program coordinates.
    let mut at = world.offset.map(|offset| -offset);
    let (mut incremental, mut returns, mut cycle) = (false, false, None);
    let mut in_hole = None;
    let mut marks = BTreeMap::new();
    for line in text.lines() {
        if let Some(mark) = line.strip_prefix('(') {
            let mark = mark.trim_end_matches(')').parse().expect("a mark");
            marks.insert(mark, in_hole.take().unwrap_or_else(|| drives.tool()));
            continue;
        }
        let words = line.split_whitespace();
        let words: Vec<(char, f64)> = words
            .map(|word| (word.as_bytes()[0] as char, word[1..].parse().expect(line)))
            .collect();
        let has = |code: f64| words.contains(&('G', code));
        let word = |letter: char| Some(words.iter().find(|(found, _)| *found == letter)?.1);
        let named = LETTERS.map(word);
        incremental = has(91.0) || incremental && !has(90.0);
        returns = has(98.0) || returns && !has(99.0);
        if has(80.0) || has(0.0) || has(1.0) {
            cycle = None;
        }
        if has(81.0) || has(85.0) {
            cycle = cycle.or(Some((at[2], 0.0, 0.0)));
        }
        if let Some((_, bottom, plane)) = &mut cycle {
            *bottom = word('Z').unwrap_or(*bottom);
            *plane = word('R').unwrap_or(*plane);
        }
        if named == [None; 3] {
            continue;
        }
        let mut to = at;
        for axis in 0..3 {
            let from = if incremental { at[axis] } else { 0.0 };
            let from = if has(53.0) { -world.offset[axis] } else { from };
            to[axis] = named[axis].map_or(at[axis], |value| from + value);
        }
        let mut go = |to: Xyz| drives.go(in_machine(to));
        if let Some((initial, bottom, plane)) = cycle {
            let [x, y, _] = to;
            go([at[0], at[1], at[2].max(plane)]);
            go([x, y, at[2].max(plane)]);
            go([x, y, plane]);
            go([x, y, bottom]);
            in_hole = Some(drives.tool());
            to[2] = if returns { plane.max(initial) } else { plane };
        } else if has(28.0) {
            go(to);
            for axis in (0..3).filter(|axis| named[*axis].is_some()) {
                to[axis] = HOME[axis] - world.offset[axis];
            }
        }
        drives.go(in_machine(to));
        at = to;
    }
    marks
}

/// A random program, and the intended tool position at each of its marks, in machine coordinates. Motions that are
/// copied have no mark after them.
fn program(draw: &mut ChaCha8Rng, world: &World) -> (String, BTreeMap<usize, Xyz>) {
    let mut lines = vec!["G21 G90 G17 G94 G54".to_owned()];
    let mut at = world.offset.map(|offset| -offset);
    let (mut incremental, mut wanted) = (false, BTreeMap::new());
    let round = |value: f64| (1e3 * value).round() / 1e3;
    let mut mark = |lines: &mut Vec<String>, at: Xyz| {
        let place = wanted.len();
        lines.push(format!("({place})"));
        wanted.insert(place, [0, 1, 2].map(|axis| at[axis] + world.offset[axis]));
    };
    // Every side of approach becomes known.
    for (axis, letter) in LETTERS.iter().enumerate() {
        lines.push(format!("G0 {letter}{}", round(at[axis] + 20.0)));
        lines.push(format!("G0 {letter}{}", round(at[axis])));
    }
    lines.push("G1 F500".to_owned());
    for _ in 0..40 {
        let reach = [0.004, 0.02, 1.0, 10.0, 60.0][draw.random_range(0..5)];
        let kind = draw.random_range(0..12);
        if kind == 0 {
            incremental = !incremental;
            lines.push(["G90", "G91"][usize::from(incremental)].to_owned());
            continue;
        }
        if kind < 4 && incremental {
            incremental = false;
            lines.push("G90".to_owned());
        }
        let axis = draw.random_range(0..3);
        let near = |draw: &mut ChaCha8Rng, at: f64| {
            let way = draw.random_range(-reach..reach);
            round(at + if (at + way).abs() > 200.0 { -way } else { way })
        };
        match kind {
            1 => {
                let value = near(draw, at[axis] + world.offset[axis]);
                lines.push(format!("G53 G0 {}{value:.3}", LETTERS[axis]));
                at[axis] = value - world.offset[axis];
            }
            2 => {
                let through = near(draw, at[axis]);
                lines.push(format!("G28 {}{through:.3}", LETTERS[axis]));
                at[axis] = HOME[axis] - world.offset[axis];
            }
            3 => {
                let bottom = round(draw.random_range(-40.0..-10.0));
                let plane = round(bottom + draw.random_range(1.0..9.0));
                if at[2] < plane {
                    at[2] = plane + 2.0;
                    lines.push(format!("G0 Z{:.3}", at[2]));
                    mark(&mut lines, at);
                }
                let returns = draw.random_bool(0.5);
                let code = ["G99 G81", "G98 G81", "G99 G85", "G98 G85"]
                    [usize::from(returns) + 2 * draw.random_range(0..2)];
                let initial = at[2];
                for hole in 0..draw.random_range(1..4) {
                    at[0] = near(draw, at[0]);
                    let x = at[0];
                    lines.push(if hole == 0 {
                        format!("{code} X{x:.3} Z{bottom:.3} R{plane:.3}")
                    } else {
                        format!("X{x:.3}")
                    });
                    mark(&mut lines, [x, at[1], bottom]);
                    at[2] = if returns { initial } else { plane };
                }
                lines.push("G80".to_owned());
            }
            _ => {
                let code = ["G0", "G1"][draw.random_range(0..2)];
                let mut line = code.to_owned();
                for other in 0..3 {
                    if other == axis || draw.random_bool(0.3) {
                        let to = near(draw, at[other]);
                        let word = if incremental { round(to - at[other]) } else { to };
                        let _ = write!(line, " {}{word:.3}", LETTERS[other]); // writing to a String cannot fail
                        at[other] = if incremental { at[other] + word } else { to };
                    }
                }
                lines.push(line);
                mark(&mut lines, at);
            }
        }
    }
    lines.push("M30".to_owned());
    (lines.join("\n") + "\n", wanted)
}

#[test]
fn the_tool_is_where_the_program_wants_it() {
    let mut checked = 0;
    for seed in 0..1500 {
        let mut draw = ChaCha8Rng::seed_from_u64(seed);
        let world = World::draw(&mut draw);
        let (program, wanted) = program(&mut draw, &world);
        let result = result_of(
            (&world.machine(), 0.000_05),
            &world.set_up(),
            program.as_bytes(),
            |job: Job<'_>| Job { decimals: Decimals { mm: 6, ..Decimals::default() }, ..job },
        );
        let (out, _) = result.expect(&program);
        let out = String::from_utf8(out).expect("text");
        let found = played(&out, &world);
        assert_eq!(found.len(), wanted.len());
        for (mark, wanted) in wanted {
            let off_um = [0, 1, 2].map(|axis| 1e3 * (found[&mark][axis] - wanted[axis]));
            assert!(
                off_um.iter().all(|off| off.abs() < 0.6),
                "seed {seed}, ({mark}): {off_um:?}\n{program}\n{out}"
            );
            checked += 1;
        }
    }
    assert!(checked > 30_000, "{checked}");
}
