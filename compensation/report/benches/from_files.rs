//! Duration of the steps from measurement files to a report that a user waits for: `cargo bench -p volcomp-report`.
//!
//! - 10 000 targets × 10 runs (5 in each direction): read from CSV, evaluated by ISO 230-2, fitted with automatic choice; the same with a
//!   tenth of the targets, so that the ratio shows how the duration scales;
//! - the same steps in turn, with reading as the control: on a shared computer only durations from the same time are comparable, and the
//!   minimum of many rounds is closest to an idle computer;
//! - a folder of 200 files, drafted;
//! - 40 files of 41 targets and 10 runs: read, calibrated, and written as a report.

use std::{
    fmt::Write as _,
    fs,
    hint::black_box,
    path::Path,
    time::{Duration, Instant},
};

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_calibrate::{CalibrationFile, calibrate, draft};
use volcomp_fit::{FitOptions, choose_and_fit};
use volcomp_metrology::{evaluate, parse_csv};
use volcomp_model::Machine;
use volcomp_report::{Report, Stated, html};
use volcomp_vocabulary::Direction;

const MACHINE: &str = "name = \"bench\"\nstructure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 8000]\nY.travel = [0, 4000]\nZ.travel = [0, 2500]\n";

/// Measurement file of a positioning test over this travel, with deterministic noise.
fn table(targets: u32, runs: u32, travel_mm: f64, seed: u32) -> String {
    let mut text = "target mm,run,direction,deviation um\n".to_owned();
    for run in 1..=runs {
        for (direction, side) in [('+', 1.0), ('-', -1.0)] {
            for k in 0..targets {
                let noise = f64::from((k * 7919 + run * 104_729 + seed * 15_485_863) % 1000) * 1e-3;
                let target = travel_mm * f64::from(k) / f64::from(targets - 1);
                let wave = 5.0 * (target * 1e-3 + f64::from(seed)).sin();
                let _ = writeln!(text, "{target:.2},{run},{direction},{:.3}", wave + side + noise);
            }
        }
    }
    text
}

fn written(folder: &Path, name: &str, text: &str) {
    fs::write(folder.join(name), text).expect("written");
}

/// Folder with a machine, a calibration file and this number of measurement files, of different errors.
fn folder_of(files: usize, targets: u32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    written(folder.path(), "machine.toml", MACHINE);
    let mut calibration = "machine = \"machine.toml\"\n".to_owned();
    for file in 0..files {
        let axis = ["X", "Y", "Z"][file % 3];
        let component = ["EA", "EB", "EC", "EX", "EY", "EZ"][file / 3 % 6];
        let travel = [8000.0, 4000.0, 2500.0][file % 3];
        let other = ["Y", "Z", "X"][file % 3];
        let place = 100 * (file / 18);
        let name = format!("{component}{axis}-{other}{place}-{file}.csv").to_lowercase();
        let text = table(targets, 5, travel, u32::try_from(file).unwrap_or_default());
        let text = if component.ends_with(['A', 'B', 'C']) {
            text.replace("deviation um", "deviation urad")
        } else {
            text
        };
        written(folder.path(), &name, &text);
        let _ = write!(
            calibration,
            "[[measurement]]\nerror = \"{component}{axis}\"\nfile = \"{name}\"\nat = {{ {other} = {place} }}\n"
        );
    }
    written(folder.path(), "calibration.toml", &calibration);
    folder
}

fn large_test(criterion: &mut Criterion) {
    for targets in [1_000, 10_000] {
        let text = table(targets, 5, 8000.0, 1);
        criterion.bench_function(&format!("read, {targets} targets x 10 runs"), |b| {
            b.iter(|| parse_csv(black_box(text.as_bytes()), "large.csv"));
        });
        let measurement = parse_csv(text.as_bytes(), "large.csv").expect("a test");
        criterion.bench_function(&format!("evaluate, {targets} targets x 10 runs"), |b| {
            b.iter(|| evaluate(black_box(&measurement)));
        });
        // Reading, fitting, and everything else that a calibration does.
        let folder = tempfile::tempdir().expect("a folder");
        written(folder.path(), "machine.toml", MACHINE);
        written(folder.path(), "x.csv", &text);
        written(
            folder.path(),
            "calibration.toml",
            "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\n",
        );
        let path = folder.path().join("calibration.toml");
        criterion.bench_function(
            &format!("read and calibrate, {targets} targets x 10 runs"),
            |b| {
                b.iter(|| {
                    let file = CalibrationFile::read(black_box(&path)).expect("read");
                    calibrate(&file, |_, _| {}).expect("calibrated")
                });
            },
        );
    }
}

/// Number of rounds; one without `cargo bench`, to test that the steps run.
fn rounds() -> usize {
    let is_measured = std::env::args().any(|argument| argument == "--bench");
    if is_measured { 15 } else { 1 }
}

/// Reads, evaluates, fits both directions, and reads and calibrates, in turn. Prints for each step the minimum and median duration, and
/// the median ratio to reading in the same round.
fn in_turn(_: &mut Criterion) {
    let text = table(10_000, 5, 8000.0, 1);
    let folder = tempfile::tempdir().expect("a folder");
    written(folder.path(), "machine.toml", MACHINE);
    written(folder.path(), "x.csv", &text);
    written(
        folder.path(),
        "calibration.toml",
        "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\n",
    );
    let path = folder.path().join("calibration.toml");
    let mut times: [Vec<f64>; 5] = Default::default();
    let rounds = rounds();
    for _ in 0..rounds {
        let start = Instant::now();
        let measurement = parse_csv(black_box(text.as_bytes()), "x.csv").expect("a test");
        let read = start.elapsed();
        let _ = black_box(evaluate(&measurement));
        let evaluated = start.elapsed();
        let curves = Direction::BOTH.map(|direction| measurement.mean_curve_in(direction));
        let curves = curves.map(|curve| curve.into_iter().unzip::<f64, f64, Vec<_>, Vec<_>>());
        let sets = curves.each_ref().map(|(x, u)| (&x[..], &u[..]));
        black_box(choose_and_fit(&sets, &FitOptions::default()).expect("fitted"));
        let all_three = start.elapsed();
        let again = Instant::now();
        let file = CalibrationFile::read(&path).expect("read");
        black_box(calibrate(&file, |_, _| {}).expect("calibrated"));
        let steps = [
            read,
            evaluated.saturating_sub(read),
            all_three.saturating_sub(evaluated),
            all_three,
            again.elapsed(),
        ];
        for (times, step) in times.iter_mut().zip(steps) {
            times.push(step.as_secs_f64() * 1e3);
        }
    }
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let names = [
        "read (control)",
        "evaluate",
        "fit both directions",
        "read, evaluate, fit",
        "read and calibrate",
    ];
    println!("10000 targets x 10 runs, {rounds} rounds in turn: least and middle, ms; by reading");
    for (name, own) in names.iter().zip(&times) {
        let least = own.iter().copied().fold(f64::INFINITY, f64::min);
        let ratios = own.iter().zip(&times[0]).map(|(own, read)| own / read);
        let (ratio, own) = (middle(ratios.collect()), middle(own.clone()));
        println!("{name:<22} {least:>8.1} {own:>8.1} {ratio:>6.2}");
    }
}

fn folder_drafted(criterion: &mut Criterion) {
    for files in [20, 200] {
        let folder = folder_of(files, 41);
        let machine = Machine::parse(MACHINE, "machine.toml").expect("a machine");
        let named = |path: &Path| path.file_name().unwrap_or_default().display().to_string();
        criterion.bench_function(&format!("draft of {files} files"), |b| {
            b.iter(|| draft(black_box(folder.path()), &machine, "machine.toml", named));
        });
    }
}

fn report_of_files(criterion: &mut Criterion) {
    let folder = folder_of(40, 41);
    let path = folder.path().join("calibration.toml");
    criterion.bench_function("report of 40 files, read and calibrated", |b| {
        b.iter(|| {
            let file = CalibrationFile::read(black_box(&path)).expect("read");
            let found = calibrate(&file, |_, _| {}).expect("calibrated");
            let report =
                Report::of_calibration("calibration.toml", &file, &found, &Stated::default());
            html(&report)
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(5));
    targets = large_test, in_turn, folder_drafted, report_of_files
}
criterion_main!(benches);
