//! Time to compensate programs of many short lines, compared with copying them, and with parsing and printing their numbers.

use std::{fmt::Write as _, hint::black_box, io::Write as _};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{Corrector, Job, SetUp, compensate};

const BLOCKS: u32 = 50_000;
/// All 21 errors of three axes, without backlash.
const THREE: &str = "structure = \"w X' b Y Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 500.0]
axes.Z.travel = [-400.0, 0.0]
[errors]
EXX = { poly = [0.0, 0.02, 0.00001] }
EYX = { poly = [0.0, 0.0, 0.00001] }
EZX = { poly = [0.0, 0.0, -0.00002] }
EAX = { poly = [0.0, 0.02] }
EBX = { poly = [0.0, 0.01] }
ECX = { poly = [0.0, -0.015] }
EXY = { poly = [0.0, 0.0, 0.00001] }
EYY = { poly = [0.0, -0.02] }
EZY = { poly = [0.0, 0.0, 0.00001] }
EAY = { poly = [0.0, 0.01] }
EBY = { poly = [0.0, -0.02] }
ECY = { poly = [0.0, 0.01] }
EXZ = { poly = [0.0, 0.0, 0.00001] }
EYZ = { poly = [0.0, 0.0, -0.00001] }
EZZ = { poly = [0.0, 0.01] }
EAZ = { poly = [0.0, 0.01] }
EBZ = { poly = [0.0, -0.01] }
ECZ = { poly = [0.0, 0.005] }
EC0Y = 20.0
EA0Z = -15.0
EB0Z = 10.0
";
const FIVE: &str = include_str!("../../../examples/trunnion.toml");

/// A random walk of short steps about a position; one line per step.
fn program(first: &str, places: &[(char, f64)]) -> String {
    let mut seed = 1_u64;
    let mut text = format!("G21 G90 G17 G54\n{first}\n");
    let mut at: Vec<f64> = places.iter().map(|(_, at)| *at).collect();
    text.push_str("G0");
    for ((letter, _), at) in places.iter().zip(&at) {
        let _ = write!(text, " {letter}{at:.3}"); // writing to a String cannot fail
    }
    text.push_str("\nG1 F2000\n");
    for _ in 0..BLOCKS {
        text.push_str("G1");
        for ((letter, start), at) in places.iter().zip(&mut at) {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let step = (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
            *at = (*at + step).clamp(start - 40.0, start + 40.0);
            let _ = write!(text, " {letter}{at:.3}");
        }
        text.push('\n');
    }
    text
}

#[expect(clippy::cast_possible_truncation, reason = "coordinates are small")]
/// Parses each number and prints it with its own decimals; copies everything else.
fn read_and_print(text: &[u8], out: &mut Vec<u8>) {
    let mut digits = itoa::Buffer::new();
    let mut at = 0;
    while at < text.len() {
        let is_number = |byte: u8| byte.is_ascii_digit() || byte == b'-';
        let to = text[at..].iter().position(|byte| is_number(*byte));
        let begin = to.map_or(text.len(), |to| at + to);
        out.extend_from_slice(&text[at..begin]);
        at = begin;
        if let Ok((value, length)) = fast_float2::parse_partial::<f64, _>(&text[begin..]) {
            let number = &text[begin..begin + length];
            let point = number.iter().position(|byte| *byte == b'.');
            let decimals = point.map_or(0, |point| length - 1 - point);
            let power = [1, 10, 100, 1000][decimals.min(3)];
            let steps = (value * power as f64).round() as i64;
            if steps < 0 {
                out.push(b'-');
            }
            let (whole, part) = (steps.unsigned_abs() / power, steps.unsigned_abs() % power);
            out.extend_from_slice(digits.format(whole).as_bytes());
            if decimals > 0 {
                out.push(b'.');
                out.extend_from_slice(&digits.format(power + part).as_bytes()[1..]);
            }
            at = begin + length.max(1);
        }
    }
}

fn benches(criterion: &mut Criterion) {
    let three = program("", &[('X', 300.0), ('Y', 250.0), ('Z', -150.0)]);
    let five = [('X', 300.0), ('Y', 250.0), ('Z', -100.0), ('A', -45.0), ('C', 10.0)];
    let cases = [
        ("three axes", Machine::parse(THREE, "three.toml"), three),
        ("five axes", Machine::parse(FIVE, "five.toml"), program("", &five)),
        ("five axes, centre point", Machine::parse(FIVE, "five.toml"), program("M428", &five)),
    ];
    let mut group = criterion.benchmark_group("nc");
    group.throughput(Throughput::Elements(u64::from(BLOCKS)));
    for (name, machine, text) in cases {
        let machine = machine.expect("a good machine");
        let corrector = Corrector::new(&machine, &Temperatures::new(), 0.001).expect("compiles");
        let setup = SetUp::default();
        let mut out = Vec::with_capacity(2 * text.len());
        group.bench_function(BenchmarkId::new("copied", name), |bencher| {
            bencher.iter(|| {
                out.clear();
                out.write_all(black_box(text.as_bytes())).expect("memory");
            });
        });
        out.clear();
        read_and_print(text.as_bytes(), &mut out);
        assert_eq!(out, text.as_bytes(), "the baseline changes {name}");
        group.bench_function(BenchmarkId::new("read and printed", name), |bencher| {
            bencher.iter(|| {
                out.clear();
                read_and_print(black_box(text.as_bytes()), &mut out);
            });
        });
        group.bench_function(BenchmarkId::new("compensated", name), |bencher| {
            bencher.iter(|| {
                out.clear();
                let job = Job::new(&corrector, &setup);
                compensate(&mut black_box(text.as_bytes()), &mut out, job, |_| Ok(()))
                    .expect("compensated")
            });
        });
        eprintln!(
            "{name}: {} lines in, {} out",
            text.lines().count(),
            out.split(|byte| *byte == b'\n').count() - 1
        );
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
