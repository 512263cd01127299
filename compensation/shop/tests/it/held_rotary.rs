//! A line measured while a rotary axis that carries it is held off 0: readings equal a separate chain of 4×4 matrices, and a calibration
//! reproduces the errors.

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_model::{Machine, Temperatures};
use volcomp_shop::{LineOfSight, Shop};
use volcomp_vocabulary::{Direction, ErrorName};

use crate::{shop_in, write};

type M = [[f64; 4]; 4];

/// Held coordinates of B, deg, and Y, mm.
const HELD: [f64; 2] = [30.0, 100.0];
/// A point on the line of B, and the point of the errors of Z, mm in MCS at machine zero.
const POINT_B: [f64; 3] = [50.0, 0.0, 200.0];
const POINT_Z: [f64; 3] = [10.0, 20.0, 30.0];
/// The measured point, mm in MCS with Z at 0 and the other axes held.
const MEASURED: [f64; 3] = [400.0, 150.0, -120.0];
/// EBZ at Z = 500, the end of its travel, µrad; EBZ is quadratic in the coordinate.
const TILT_URAD: f64 = 80.0;
/// EZZ at Z = 500, µm; quadratic in the coordinate.
const LENGTH_UM: f64 = 25.0;

fn product(a: &M, b: &M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn shift([x, y, z]: [f64; 3]) -> M {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]]
}

fn about_y(angle: f64, point: [f64; 3]) -> M {
    let (s, c) = angle.sin_cos();
    let turn = [[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let back = shift(point.map(|x| -x));
    product(&shift(point), &product(&turn, &back))
}

fn at(m: &M, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}

/// Error motion of Z at a coordinate: a tilt about Y and a displacement along Z, about the point of Z.
fn error_of_z(z: f64) -> M {
    let share = (z / 500.0).powi(2);
    let tilt = about_y(TILT_URAD * 1e-6 * share, POINT_Z);
    product(&shift([0.0, 0.0, LENGTH_UM * 1e-3 * share]), &tilt)
}

/// Reading with Z on the tool side, carried by B, which Y carries: excess motion of a point on the carriage along Z,
/// µm.
fn reading_on_the_tool_um(z: f64) -> f64 {
    let held = product(&shift([0.0, HELD[1], 0.0]), &about_y(HELD[0].to_radians(), POINT_B));
    let back = product(&about_y(-HELD[0].to_radians(), POINT_B), &shift([0.0, -HELD[1], 0.0]));
    let on_carriage = at(&back, MEASURED);
    let ideal = product(&held, &shift([0.0, 0.0, z]));
    let actual = product(&ideal, &error_of_z(z));
    let (to, from) = (at(&actual, on_carriage), at(&ideal, on_carriage));
    let moved: [f64; 3] = std::array::from_fn(|i| to[i] - from[i]);
    // Component along the direction of Z, which B has rotated.
    let (s, c) = HELD[0].to_radians().sin_cos();
    (moved[0] * s + moved[2] * c) * 1e3
}

/// Reading with Z and B carrying the workpiece, Z outermost: the errors of Z move the workpiece axes.
fn reading_on_the_table_um(z: f64) -> f64 {
    let held = product(&about_y(HELD[0].to_radians(), POINT_B), &shift([0.0, HELD[1], 0.0]));
    // The point is fixed on the table, so it does not move in workpiece axes.
    let on_table = at(&held, MEASURED);
    let actual = at(&error_of_z(z), on_table);
    (actual[2] - on_table[2]) * 1e3
}

fn truth(structure: &str) -> String {
    format!(
        "structure = \"{structure}\"\n[axes]\nY.travel = [0, 400]\nZ = {{ travel = [0, 500], point = {POINT_Z:?} }}\n\
         B = {{ travel = [-90, 90], point = {POINT_B:?} }}\n[errors]\n\
         EBZ = {{ poly = [0, 0, {:?}] }}\nEZZ = {{ poly = [0, 0, {:?}] }}\n",
        TILT_URAD / 250_000.0,
        LENGTH_UM / 250_000.0
    )
}

fn shop(folder: &std::path::Path, structure: &str) -> Shop {
    let held = format!("at = {{ B = {}, Y = {} }}", HELD[0], HELD[1]);
    let lines = format!(
        "machine = \"truth.toml\"\n[[measurement]]\nerror = \"EBZ\"\n{held}\n\
         [[measurement]]\nerror = \"EZZ\"\n{held}\npoint = {MEASURED:?}\n"
    );
    shop_in(folder, &truth(structure), &lines)
}

type Reading = fn(f64) -> f64;

const SIDES: [(&str, Reading); 2] =
    [("w b Y B Z t", reading_on_the_tool_um), ("w Z' B' Y' b t", reading_on_the_table_um)];

#[test]
fn readings_are_those_of_a_chain_written_by_hand() {
    for (structure, by_hand) in SIDES {
        let folder = tempfile::tempdir().expect("a folder");
        let shop = shop(folder.path(), structure);
        let line = shop.lines.last().expect("EZZ");
        let sight = LineOfSight::new(&shop.truth, &line.setup).expect("a line");
        let none = Temperatures::new();
        let errors = shop.truth.source(&none);
        let mut largest = 0.0_f64;
        for z in [0.0, 125.0, 250.0, 500.0] {
            let state = sight.state(z, Direction::Positive);
            let found = sight.reading(&errors, &state, &state);
            let expected = by_hand(z);
            assert!(
                (found - expected).abs() < 1e-6,
                "{structure} at {z}: {found} for {expected} µm"
            );
            largest = largest.max((expected - LENGTH_UM * (z / 500.0).powi(2)).abs());
        }
        assert!(largest > 10.0, "the tilt has a lever: {largest} µm");
    }
}

/// The Abbe offset is corrected with the lever arm at the held position: the original errors are found within 0.01.
#[test]
fn the_errors_come_back() {
    for (structure, _) in SIDES {
        let folder = tempfile::tempdir().expect("a folder");
        write(&shop(folder.path(), structure), folder.path());
        let file = CalibrationFile::read(&folder.path().join("calibration.toml")).expect("read");
        let found = calibrate(&file, |_, _| {}).expect("calibrated").machine;
        let truth = Machine::parse(&truth(structure), "truth").expect("valid");
        for name in ["EBZ", "EZZ"] {
            let name: ErrorName = name.parse().expect("a name");
            let own = truth.index_of(name.axis).expect("its axis");
            for z in [0.0, 130.0, 260.0, 390.0, 500.0] {
                let mut coordinates = [0.0; 9];
                coordinates[own] = z;
                let [put_in, found] = [&truth, &found].map(|machine| {
                    let curve = machine.error(name).expect("measured");
                    curve.value(own, &coordinates, None)
                });
                assert!(
                    (put_in - found).abs() < 0.01,
                    "{structure} {name} at {z}: {found} for {put_in}"
                );
            }
        }
    }
}
