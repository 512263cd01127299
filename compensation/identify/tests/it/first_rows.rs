//! Rows before the first motion of an axis: no file states the approach direction. Expected values are from independent
//! formulas.

use std::fmt::Write as _;

use volcomp_identify::Identification;

use crate::lab::{Lab, Noise, value, words};

const AXES: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 600.0]
axes.Z.travel = [0.0, 600.0]
";
const BAND_OF_95_PERCENT: f64 = 1.959_964;

/// Approach direction of an axis at the first row.
#[derive(Clone, Copy, Debug, PartialEq)]
enum First {
    Drawn,
    /// The mean of both directions.
    Mean,
    /// The machine overran before the first row, as ISO 230-2 requires.
    Overrun,
}

const ALL: [First; 3] = [First::Drawn, First::Mean, First::Overrun];

impl First {
    fn side(self, noise: &mut Noise) -> f64 {
        match self {
            Self::Drawn => noise.between(-1.0, 1.0).signum(),
            Self::Mean => 0.0,
            Self::Overrun => 1.0,
        }
    }
}

/// Correct data must not give a note on an inverted sign or an outlier.
fn assert_no_cause(found: &Identification) {
    let notes = words(found);
    for said in ["inverted", "outlier"] {
        assert!(!notes.contains(said), "{notes}");
    }
}

const EC0Y: f64 = 20.0;
const DIAGONAL_NOISE_UM: f64 = 0.2;
const TARGETS: u32 = 9;

/// Readings along a diagonal of X and Y with reversal values, µm: at y the tip deviates by EC0Y·y in −X.
fn diagonal(noise: &mut Noise, first: First, reversal_um: f64) -> Vec<[f64; 2]> {
    let sides = first.side(noise) + first.side(noise);
    let rows = (0..TARGETS).map(|k| {
        let at = 75.0 * f64::from(k);
        let sides = if k == 0 { sides } else { 2.0 };
        let along = 0.5 * reversal_um * sides - 1e-3 * EC0Y * at;
        [at, along / 2.0_f64.sqrt() + noise.normal(DIAGONAL_NOISE_UM)]
    });
    rows.collect()
}

fn diagonal_file(rows: &[[f64; 2]]) -> String {
    let mut text = String::from("X,Y,Z,deviation_um\n");
    for [at, read] in rows {
        let _ = writeln!(text, "{at:?},{at:?},300,{read:?}");
    }
    text
}

fn with_reversal(reversal_um: f64) -> String {
    let of = |name: &str| {
        format!("{name} = {{ mean = {{ poly = [0.0] }}, reversal = {reversal_um:?} }}\n")
    };
    format!("{AXES}[errors]\n{}{}", of("EXX"), of("EYY"))
}

const DIAGONAL: &str = "[[observation]]
kind = \"line\"
file = \"d.csv\"
direction = [1, 1, 0]
offset = \"unknown\"
uncertainty_um = 0.2
";

/// Best-fit line through the targets; half the reversal value of each axis is an additional uncertainty of the first target.
fn straight_line(rows: &[[f64; 2]], reversal_um: f64) -> (f64, f64) {
    let square = DIAGONAL_NOISE_UM.powi(2);
    let weighted = rows.iter().enumerate().map(|(k, row)| {
        let more = 2.0 * (0.5 * reversal_um / 2.0_f64.sqrt()).powi(2);
        (1.0 / (square + if k == 0 { more } else { 0.0 }), *row)
    });
    // Readings after the first row contain half the reversal value of both axes.
    let both = 2.0 * 0.5 * reversal_um / 2.0_f64.sqrt();
    let [mut w, mut wx, mut wxx, mut wy, mut wxy] = [0.0; 5];
    for (k, (weight, [at, read])) in weighted.enumerate() {
        let read = if k == 0 { read } else { read - both };
        w += weight;
        wx += weight * at;
        wxx += weight * at * at;
        wy += weight * read;
        wxy += weight * at * read;
    }
    let determinant = w * wxx - wx * wx;
    let slope = (w * wxy - wx * wy) / determinant;
    let to_um_per_m = 1e3 * 2.0_f64.sqrt();
    (-slope * to_um_per_m, (w / determinant).sqrt() * to_um_per_m)
}

#[test]
fn the_first_target_of_a_diagonal_has_little_weight() {
    let mut noise = Noise::new(31);
    for reversal_um in [0.0, 0.3, 2.0, 10.0] {
        let lab = Lab::new(&with_reversal(reversal_um));
        for first in ALL {
            let rows = diagonal(&mut noise, first, reversal_um);
            lab.write("d.csv", &diagonal_file(&rows));
            let found = lab
                .identify(&format!("folds = 0\nunknown = [\"EC0Y\"]\n{DIAGONAL}"))
                .expect("found");
            let expected = straight_line(&rows, reversal_um);
            let (value, uncertainty) = value(&found, "EC0Y");
            assert!(
                (value - expected.0).abs() < 1e-3 * expected.1
                    && (uncertainty - expected.1).abs() < 1e-3 * expected.1,
                "{reversal_um} {first:?}: {value} {uncertainty}, expected {expected:?}"
            );
            assert_no_cause(&found);
        }
    }
}

const DIAGONALS: u32 = 1000;

#[test]
fn coverage_on_a_diagonal_with_unknown_approach() {
    let mut noise = Noise::new(32);
    for reversal_um in [0.5, 10.0] {
        let lab = Lab::new(&with_reversal(reversal_um));
        for first in ALL {
            let mut inside = 0;
            let mut sum = 0.0;
            for _ in 0..DIAGONALS {
                lab.write("d.csv", &diagonal_file(&diagonal(&mut noise, first, reversal_um)));
                let found = lab
                    .identify(&format!("folds = 0\nunknown = [\"EC0Y\"]\n{DIAGONAL}"))
                    .expect("found");
                let (value, uncertainty) = value(&found, "EC0Y");
                let off = (value - EC0Y) / uncertainty;
                sum += off;
                inside += u32::from(off.abs() < BAND_OF_95_PERCENT);
            }
            let share = f64::from(inside) / f64::from(DIAGONALS);
            let mean = sum / f64::from(DIAGONALS);
            println!("diagonal, {reversal_um} um, {first:?}: {share} mean {mean:.3}");
            assert!((0.93..=0.97).contains(&share), "{first:?}: {share}");
        }
    }
}

/// In one direction along a diagonal only the first target has another approach. The reversal value is not determined,
/// and the squareness is as accurate as in a fit without reversal values.
#[test]
fn a_first_row_alone_determines_no_reversal_value() {
    let lab = Lab::new(AXES);
    let mut noise = Noise::new(33);
    for first in ALL {
        let rows = diagonal(&mut noise, first, 10.0);
        lab.write("d.csv", &diagonal_file(&rows));
        let found = lab
            .identify(&format!(
                "folds = 0\nunknown = [\"EC0Y\", {{ error = \"EXX\", reversal = true }}, {{ error = \"EYY\", reversal = true }}]\n{DIAGONAL}"
            ))
            .expect("found");
        for name in ["EXX reversal", "EYY reversal"] {
            let parameter = found.parameters.iter().find(|p| p.name == name);
            assert!(parameter.is_some_and(|p| !p.determined), "{name} {first:?}");
        }
        // The result equals that of a fit with an arbitrarily large reversal value.
        let expected = straight_line(&rows, 1e5);
        let (value, uncertainty) = value(&found, "EC0Y");
        assert!(
            (value - expected.0).abs() < 1e-3 * expected.1
                && (uncertainty - expected.1).abs() < 1e-3 * expected.1,
            "{first:?}: {value} {uncertainty}, expected {expected:?}"
        );
        assert_no_cause(&found);
    }
}

/// X moves at two positions of Y, which rests in each file: the approach direction of Y is one number per file, so more rows do not
/// reduce its uncertainty.
#[test]
fn an_axis_at_rest_has_one_approach_direction_per_file() {
    const REVERSAL_UM: f64 = 8.0;
    const NOISE_UM: f64 = 1.0;
    let lab = Lab::new(&format!(
        "{AXES}[errors]\nEXY = {{ mean = {{ poly = [0.0] }}, reversal = {REVERSAL_UM:?} }}\n"
    ));
    let mut noise = Noise::new(34);
    for sides in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]] {
        let mut observations = String::new();
        let mut means = [0.0; 2];
        for (place, y) in [50.0, 550.0].into_iter().enumerate() {
            let mut text = String::from("X,Y,Z,deviation_um\n");
            for k in 0..40 {
                let x = 15.0 * f64::from(k);
                let read =
                    0.5 * REVERSAL_UM * sides[place] - 1e-3 * EC0Y * y + noise.normal(NOISE_UM);
                means[place] += read / 40.0;
                let _ = writeln!(text, "{x:?},{y:?},300,{read:?}");
            }
            lab.write(&format!("l{place}.csv"), &text);
            let _ = write!(
                observations,
                "[[observation]]\nkind = \"line\"\nfile = \"l{place}.csv\"\ndirection = [1, 0, 0]\nuncertainty_um = {NOISE_UM:?}\n"
            );
        }
        let found = lab
            .identify(&format!("folds = 0\nunknown = [\"EC0Y\"]\n{observations}"))
            .expect("found");
        // The mean of each file has the same variance, and EC0Y changes it by −y: least squares through the origin.
        let variance = NOISE_UM.powi(2) / 40.0 + (0.5 * REVERSAL_UM).powi(2);
        let square = 0.05_f64.powi(2) + 0.55_f64.powi(2);
        let expected = -(0.05 * means[0] + 0.55 * means[1]) / square;
        let (value, uncertainty) = value(&found, "EC0Y");
        assert!((value - expected).abs() < 1e-3, "{value} {expected}");
        let expected = (variance / square).sqrt();
        assert!((uncertainty - expected).abs() < 1e-3, "{uncertainty} {expected}");
        assert_no_cause(&found);
    }
}

const TRACKER_WORLDS: u32 = 150;

/// Tracker poses all over the travels; reversal values are identified as well.
fn tracker(noise: &mut Noise, first: First, poses: u32, reversal_um: f64, slips: bool) -> String {
    let reversals = [reversal_um, -reversal_um, reversal_um];
    let slopes = [5.0, -8.0, 3.0];
    let mut sides = [(); 3].map(|()| first.side(noise));
    let mut before: Option<[f64; 3]> = None;
    let mut text = String::from("X,Y,Z,x,y,z\n");
    for _ in 0..poses {
        let at = [(); 3].map(|()| noise.between(0.0, 600.0).round());
        if let Some(before) = before {
            for axis in 0..3 {
                let moved: f64 = at[axis] - before[axis];
                if moved != 0.0 {
                    sides[axis] = moved.signum();
                }
            }
        }
        before = Some(at);
        let own = |axis: usize| {
            let um = 0.5 * reversals[axis] * sides[axis] + slopes[axis] * (at[axis] / 300.0 - 1.0);
            at[axis] + 1e-3 * um
        };
        // EC0Y = 20, EA0Z = 5 and EB0Z = −10 µrad.
        let tip = [own(0) - 20e-6 * at[1] - 10e-6 * at[2], own(1) - 5e-6 * at[2], own(2)];
        let [x, y, z] = tip.map(|q| {
            let is_slip = slips && noise.between(0.0, 1.0) < 0.05;
            q + noise.normal(if is_slip { 0.03 } else { 0.001 })
        });
        let _ = writeln!(text, "{},{},{},{x:?},{y:?},{z:?}", at[0], at[1], at[2]);
    }
    text
}

fn of_tracker(more: &str) -> String {
    let curves = ["EXX", "EYY", "EZZ"]
        .map(|error| format!("{{ error = \"{error}\", legendre = 1, reversal = true }}"));
    format!(
        "folds = 0\n{more}unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", {}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\nuncertainty_um = 1.0\n",
        curves.join(", ")
    )
}

/// Share of the bands of squareness and reversal values that contain the truth.
fn share_of_tracker(first: First, poses: u32, reversal_um: f64, slips: bool) -> f64 {
    let lab = Lab::new(AXES);
    let mut noise = Noise::new(35);
    let more = if slips { "robust = true\n" } else { "" };
    let mut inside = 0;
    for _ in 0..TRACKER_WORLDS {
        lab.write("t.csv", &tracker(&mut noise, first, poses, reversal_um, slips));
        let found = lab.identify(&of_tracker(more)).expect("found");
        for (name, expected) in [
            ("EC0Y", 20.0),
            ("EA0Z", 5.0),
            ("EB0Z", -10.0),
            ("EXX reversal", reversal_um),
            ("EYY reversal", -reversal_um),
            ("EZZ reversal", reversal_um),
        ] {
            let (value, uncertainty) = value(&found, name);
            inside += u32::from((value - expected).abs() < BAND_OF_95_PERCENT * uncertainty);
        }
        if !slips {
            assert_no_cause(&found);
        }
    }
    let share = f64::from(inside) / f64::from(6 * TRACKER_WORLDS);
    println!("tracker, {poses} poses, {reversal_um} um, {first:?}, slips {slips}: {share}");
    share
}

#[test]
fn coverage_of_poses_with_unknown_approach() {
    for (poses, reversal_um) in [(20, 1.0), (20, 20.0), (40, 20.0)] {
        for first in ALL {
            let share = share_of_tracker(first, poses, reversal_um, false);
            assert!((0.93..=0.97).contains(&share), "{first:?}: {share}");
        }
    }
}

#[test]
fn robust_coverage_of_poses_with_unknown_approach() {
    for first in [First::Drawn, First::Mean] {
        let share = share_of_tracker(first, 30, 10.0, true);
        assert!((0.93..=0.97).contains(&share), "{first:?}: {share}");
    }
}
