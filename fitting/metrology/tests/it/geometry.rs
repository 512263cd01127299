//! Tests of straightness, squareness and Abbe's principle, with displaced rigid bodies and with files.
//!
//! Errors on parallel lines are tested as well.

use std::fmt::Write as _;
use std::iter;

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::{
    CarriedSide, Direction, Measurement, ParallelLine, Reading, ReferenceKind, ReferenceLine,
    Rides, SlopeUncertainty, SquarenessInputs, TiltReading, Travel, abbe_um, angular_method_um,
    lever_mm, opening, parse_csv, separate_parallel_lines, squareness, squareness_of_lengths,
    squareness_parts, squareness_uncertainty, straightness_of, straightness_of_profile, tilt_sign,
};
use volcomp_vocabulary::{ErrorName, Urad};

use crate::samples::near;

type Vector = [f64; 3];

fn named(error: &str) -> ErrorName {
    error.parse().unwrap()
}

fn add(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] + b[i])
}

fn sub(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn scaled(a: Vector, k: f64) -> Vector {
    a.map(|x| x * k)
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn rotated(v: Vector, w: Vector) -> Vector {
    let angle = dot(w, w).sqrt();
    if angle == 0.0 {
        return v;
    }
    let k = scaled(w, 1.0 / angle);
    let along = scaled(k, dot(k, v) * (1.0 - angle.cos()));
    add(add(scaled(v, angle.cos()), scaled(cross(k, v), angle.sin())), along)
}

/// Position of a point of the carriage after its error motion. `p` is the point at axis position 0; the error motion,
/// `delta` in mm and `epsilon` in rad, is stated at `c`.
fn disturbed(p: Vector, delta: Vector, epsilon: Vector, c: Vector) -> Vector {
    add(add(c, delta), rotated(sub(p, c), epsilon))
}

const DELTA_UM: Vector = [12.0, -7.0, 5.0];
const TILTS_URAD: Vector = [31.0, -18.0, 44.0];
const CARRIAGE_POINT: Vector = [120.0, -40.0, 900.0];
const DIRECTION: Vector = [0.0, 1.0, 0.0];
const POSITION_MM: f64 = 1375.0;
const POINT: Vector = [-300.0, 250.0, 80.0];

fn rigid_body_deviation_um(point_at_zero: Vector) -> Vector {
    let (delta, epsilon) = (scaled(DELTA_UM, 1e-3), scaled(TILTS_URAD, 1e-6));
    let moved = disturbed(point_at_zero, delta, epsilon, CARRIAGE_POINT);
    scaled(sub(moved, point_at_zero), 1e3)
}

fn model_deviation_um(rides: Rides, side: CarriedSide) -> Vector {
    let travel = Travel { side, direction_mcs: DIRECTION, position_mm: POSITION_MM };
    let lever = lever_mm(POINT, CARRIAGE_POINT, rides, travel);
    add(DELTA_UM, abbe_um(TILTS_URAD, lever))
}

#[track_caller]
fn near_vector(found: Vector, expected: Vector) {
    // The neglected second order is ε² × lever = (6e-5)² × 1.5e6 µm = 0.005 µm.
    let worst = sub(found, expected).map(f64::abs).into_iter().fold(0.0, f64::max);
    assert!(worst < 5e-3, "{found:?} against {expected:?}");
}

#[test]
fn a_point_on_the_carriage_moves_with_it() {
    // The carriage moves the point to m + u·q and tilts about its own point, so that the lever is m − c.
    for side in [CarriedSide::Tool, CarriedSide::Workpiece] {
        near_vector(model_deviation_um(Rides::Carriage, side), rigid_body_deviation_um(POINT));
    }
}

#[test]
fn a_fixed_point_meets_another_place_of_the_carriage_at_each_position() {
    // Tool-side axis: the point of the carriage that is at the fixed point now was u·q behind it at axis position 0.
    let passing = sub(POINT, scaled(DIRECTION, POSITION_MM));
    near_vector(
        model_deviation_um(Rides::Other, CarriedSide::Tool),
        rigid_body_deviation_um(passing),
    );
    // Workpiece-side axis: a fixed tool point moves by +u·q relative to the table, which is the motion that `E?N`
    // describes.
    let reached = add(POINT, scaled(DIRECTION, POSITION_MM));
    near_vector(
        model_deviation_um(Rides::Other, CarriedSide::Workpiece),
        rigid_body_deviation_um(reached),
    );
}

#[test]
fn yaw_at_a_lever_of_one_metre_by_hand() {
    // 10 µrad about Z with a lever of 1 m along Y give 10 µm towards −X.
    assert_eq!(abbe_um([0.0, 0.0, 10.0], [0.0, 1000.0, 0.0]), [-10.0, 0.0, 0.0]);
}

fn axis_of(letter: u8) -> Vector {
    std::array::from_fn(|i| f64::from(u8::from(i == usize::from(letter - b'X'))))
}

/// A rigid bridge is moved along a known profile, each foot to the position of the other, and its tilts are the
/// readings. For each error the readings give the profile.
#[test]
fn bridge_readings_give_the_profile_back_for_every_error() {
    let bridge_mm = 100.0;
    let profile_um = [0.0, 1.5, 4.0, 3.0, -2.0, -2.5, 0.5];
    for error in ["EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ"] {
        let name = error.as_bytes();
        let (across, along) = (axis_of(name[1]), axis_of(name[2]));
        let about = cross(along, across);
        let readings = |k: usize| {
            let rise_um = if k == 0 { 77.0 } else { profile_um[k] - profile_um[k - 1] };
            let foot_to_foot = add(
                scaled(along, bridge_mm),
                scaled(across, if k == 0 { 0.0 } else { rise_um * 1e-3 }),
            );
            let tilt = scaled(cross(along, foot_to_foot), 1e6 / bridge_mm);
            // The reading at target 0 is not used; the other readings are right-hand rotations about +A, +B or +C.
            let right_hand: f64 = tilt.iter().sum();
            let slope = dot(tilt, about);
            let target = -250.0 + bridge_mm * k as f64;
            if k == 0 { (target, [77.0; 2]) } else { (target, [right_hand, slope]) }
        };
        let all: Vec<_> = (0..profile_um.len()).map(readings).collect();
        for (which, reading) in [TiltReading::RightHand, TiltReading::Slope].into_iter().enumerate()
        {
            let tilts: Vec<_> = all.iter().map(|(q, r)| (*q, r[which])).collect();
            let found = angular_method_um(named(error), reading, &tilts, bridge_mm).unwrap();
            for ((_, h), expected) in found.iter().zip(profile_um) {
                assert!((h - expected).abs() < 1e-9, "{error} {reading:?}: {h} against {expected}");
            }
        }
    }
}

#[test]
fn bridge_and_targets_must_fit() {
    let tilts = |spacing: f64| [(0.0, 0.0), (100.0, 1.0), (100.0 + spacing, 2.0)];
    let method = |spacing, bridge| {
        angular_method_um(named("EYX"), TiltReading::RightHand, &tilts(spacing), bridge)
    };
    assert!(method(100.9, 100.0).is_ok());
    assert!(method(99.1, 100.0).is_ok());
    for (spacing, bridge) in
        [(101.1, 100.0), (98.9, 100.0), (100.0, 102.0), (-100.0, 100.0), (100.0, 0.0)]
    {
        assert!(method(spacing, bridge).is_err(), "{spacing} {bridge}");
    }
    insta::assert_snapshot!(method(101.1, 100.0).unwrap_err(), @"straightness by the angular method, targets 100 and 201.1: found a spacing of 101.1 mm, expected the bridge length 100 mm within 1 %");
    insta::assert_snapshot!(method(100.0, f64::NAN).unwrap_err(), @"straightness by the angular method: bridge length: found NaN mm, expected a positive length");
    insta::assert_snapshot!(tilt_sign(named("EXX"), TiltReading::Slope).unwrap_err(), @"straightness by the angular method: found `EXX`, expected EYX, EZX, EXY, EZY, EXZ or EYZ");
    assert!(
        angular_method_um(named("EYX"), TiltReading::Slope, &[(0.0, f64::NAN), (1.0, 0.0)], 1.0)
            .is_err()
    );
}

#[test]
fn reference_lines_by_hand() {
    // Least-squares line of (0, 1), (10, 3) and (20, 2): slope (−10·−1 + 10·0)/200 = 0.05, mean 2 at 10.
    let points = [(0.0, 1.0), (10.0, 3.0), (20.0, 2.0)];
    let line = ReferenceLine::least_squares(&points).unwrap();
    assert!((line.slope_um_per_mm - 0.05).abs() < 1e-15);
    assert!((line.intercept_um - 1.5).abs() < 1e-15);
    assert!((line.slope().0 - 50.0).abs() < 1e-12);
    let rest: f64 = line.removed_from(&points).iter().map(|(_, x)| x).sum();
    assert!(rest.abs() < 1e-12);
    let ends = ReferenceLine::end_points(&[points[2], points[0], points[1]]).unwrap();
    assert_eq!((ends.slope_um_per_mm, ends.intercept_um), (0.05, 1.0));
    assert_eq!(ends.removed_from(&points)[2].1, 0.0);
}

#[test]
fn a_line_needs_two_targets() {
    for points in
        [&[][..], &[(1.0, 2.0)], &[(1.0, 2.0), (1.0, 3.0)], &[(0.0, 0.0), (1.0, f64::NAN)]]
    {
        assert!(ReferenceLine::least_squares(points).is_err());
        assert!(ReferenceLine::end_points(points).is_err());
    }
    insta::assert_snapshot!(ReferenceLine::least_squares(&[(1.0, 2.0)]).unwrap_err(), @"least-squares reference line: points: found 1, expected at least two different targets");
}

/// Two axis lines and two reference beams; neither pair is exactly square. The slopes give the angle between the axis
/// lines within 0.001 µrad.
#[test]
fn squareness_from_slopes_is_the_angle_between_the_axis_lines() {
    // For each case: name of the squareness error, indices of the first axis p and the second axis s, and the
    // straightness errors of both axes.
    let cases =
        [("EC0Y", 0, 1, "EYX", "EXY"), ("EA0Z", 1, 2, "EZY", "EYZ"), ("EB0Z", 0, 2, "EZX", "EXZ")];
    let (out_urad, reference_urad, beam_urad) = (37.0, -3.2, 11.0);
    for (error, p, s, first, second) in cases {
        let unit = |i: usize| axis_of(b'X' + u8::try_from(i).unwrap());
        let rotation = match error {
            "EC0Y" => [0.0, 0.0, 1.0],
            "EA0Z" => [1.0, 0.0, 0.0],
            _ => [0.0, 1.0, 0.0],
        };
        // The first axis line is exact; the second is rotated right-handed by the squareness error.
        let second_line = rotated(unit(s), scaled(rotation, out_urad * 1e-6));
        // Beam p is rotated in the plane by `beam_urad`; beam s is at an angle of π/2 + `reference_urad` to beam p.
        let turned = |angle: f64| add(scaled(unit(p), angle.cos()), scaled(unit(s), angle.sin()));
        let beam_p = turned(beam_urad * 1e-6);
        let beam_s = turned((beam_urad + reference_urad) * 1e-6 + std::f64::consts::FRAC_PI_2);
        // A straightness slope is the component of the axis line normal to its own beam, towards the other beam.
        let across_p = turned(beam_urad * 1e-6 + std::f64::consts::FRAC_PI_2);
        let across_s = scaled(turned((beam_urad + reference_urad) * 1e-6), 1.0);
        let slope_first = dot(unit(p), across_p) / dot(unit(p), beam_p) * 1e6;
        let slope_second = dot(second_line, across_s) / dot(second_line, beam_s) * 1e6;
        let slopes = [(named(first), Urad(slope_first)), (named(second), Urad(slope_second))];
        let error = named(error);
        let reference = Urad(reference_urad);
        let found = squareness(error, reference, slopes).unwrap();
        assert!((found - Urad(out_urad)).abs().0 < 1e-3, "{error}: {found}");
        let swapped = squareness(error, reference, [slopes[1], slopes[0]]).unwrap();
        assert_eq!(found, swapped);
        let mut parts = squareness_parts(error).unwrap();
        parts.sort_unstable();
        let mut expected = [named(first), named(second)];
        expected.sort_unstable();
        assert_eq!(parts, expected);
    }
}

/// For each tilt of X, Y and Z about each axis, the sign equals that of the change of the angle between two lines, one
/// of which is rotated.
#[test]
fn a_tilt_opens_or_closes_the_angle_of_its_axes() {
    const URAD: f64 = 100.0;
    for (axis, own) in [("X", 0), ("Y", 1), ("Z", 2)] {
        for (about, turn) in [("A", 0), ("B", 1), ("C", 2)] {
            let error = named(&format!("E{about}0{axis}"));
            if own == turn {
                assert_eq!(opening(error), None, "{error}");
                continue;
            }
            let unit = |i: usize| axis_of(b'X' + u8::try_from(i).unwrap());
            let line = rotated(unit(own), scaled(unit(turn), URAD * 1e-6));
            let angle = dot(line, unit(3 - own - turn)).acos();
            let opens = (angle - std::f64::consts::FRAC_PI_2) * 1e6;
            let found = opening(error).expect("a squareness");
            assert!((URAD * found - opens).abs() < 1e-3, "{error}: {found} {opens}");
        }
    }
    for other in ["EX0Y", "ECY", "EC0U", "EA0C"] {
        assert_eq!(opening(named(other)), None, "{other}");
    }
}

#[test]
fn squareness_of_invalid_names_is_refused() {
    let slopes = [(named("EXY"), Urad(0.0)), (named("EYX"), Urad(0.0))];
    insta::assert_snapshot!(squareness(named("EC0X"), Urad(0.0), slopes).unwrap_err(), @"squareness from two slopes: found `EC0X`, expected EC0Y, EA0Z or EB0Z");
    insta::assert_snapshot!(squareness(named("EA0Z"), Urad(0.0), slopes).unwrap_err(), @"slopes for the squareness EA0Z: found `EXY, EYX`, expected EYZ and EZY");
    assert!(squareness(named("EC0Y"), Urad(0.0), [slopes[0]; 2]).is_err());
}

/// Width of the narrowest strip of this slope that contains all points.
fn width(points: &[(f64, f64)], slope: f64) -> f64 {
    let heights = || points.iter().map(|(q, x)| x - slope * q);
    heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(f64::INFINITY, f64::min)
}

/// The minimum zone equals that of a brute-force search over the slopes of all pairs of points, with refinement.
#[test]
fn the_minimum_zone_is_that_of_brute_force() {
    let mut state = 1_u64;
    let mut random = || {
        // Linear congruential generator with Knuth's constants.
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1_u32 << 24)
    };
    for count in [2, 3, 4, 7, 21, 60] {
        for _ in 0..20 {
            let points: Vec<(f64, f64)> = (0..count)
                .map(|k| {
                    (50.0 * f64::from(k) + 30.0 * random(), 12.0 * random() + 0.02 * f64::from(k))
                })
                .collect();
            let mut shuffled = points.clone();
            shuffled.rotate_left(points.len() / 2);
            let line = ReferenceLine::minimum_zone(&shuffled).unwrap();
            let left = line.removed_from(&points);
            let largest = left.iter().map(|(_, x)| *x).fold(f64::NEG_INFINITY, f64::max);
            let smallest = left.iter().map(|(_, x)| *x).fold(f64::INFINITY, f64::min);
            assert!((largest + smallest).abs() < 1e-9, "the line is in the middle");
            let found = largest - smallest;
            let mut best = f64::INFINITY;
            for (k, a) in points.iter().enumerate() {
                for b in &points[..k] {
                    best = best.min(width(&points, (a.1 - b.1) / (a.0 - b.0)));
                }
            }
            let (mut low, mut high) = (-2.0, 2.0);
            for _ in 0..200 {
                let thirds = [low + (high - low) / 3.0, high - (high - low) / 3.0];
                if width(&points, thirds[0]) < width(&points, thirds[1]) {
                    high = thirds[1];
                } else {
                    low = thirds[0];
                }
            }
            assert!((found - best).abs() < 1e-9, "{found} for {best}");
            assert!((found - width(&points, 0.5 * (low + high))).abs() < 1e-9);
        }
    }
    // Two different values at one target, and a repeated point.
    let doubled = [(0.0, 0.0), (0.0, 2.0), (10.0, 1.0), (10.0, 1.0), (20.0, 0.0), (20.0, 2.0)];
    let line = ReferenceLine::minimum_zone(&doubled).unwrap();
    assert!(line.slope_um_per_mm.abs() < 1e-12 && (line.intercept_um - 1.0).abs() < 1e-12);
    assert!(ReferenceLine::minimum_zone(&[(1.0, 2.0)]).is_err());
}

/// A triangle of 6 µm on a slope of 10 µrad. All three lines give 6 µm: the end-point line, the minimum zone, and the
/// least-squares line, which is level at 2 through (−1, 0), (0, 6) and (1, 0). With a fourth point, the three results
/// differ.
#[test]
fn the_three_reference_lines_by_hand() {
    let sloped = |q: f64, x: f64| (q, x + 0.01 * q);
    let profile = [sloped(0.0, 0.0), sloped(500.0, 6.0), sloped(1000.0, 0.0)];
    let found = straightness_of_profile(&profile).unwrap();
    for kind in [ReferenceKind::LeastSquares, ReferenceKind::EndPoints, ReferenceKind::MinimumZone]
    {
        let about = found.of(kind);
        assert_eq!(about.kind, kind);
        near(about.error_um, 6.0, 1e-9);
        near(about.line.slope().0, 10.0, 1e-9);
    }
    // Points (0, 0), (1, 3), (2, 0), (3, 3). The end-point line rises by 1 per unit: residuals 0, 2, −2, 0, range 4.
    // The least-squares line has slope 0.6: residuals −0.6, 1.8, −1.8, 0.6, range 3.6. The narrowest strip has slope 0:
    // range 3.
    let zigzag = [(0.0, 0.0), (1.0, 3.0), (2.0, 0.0), (3.0, 3.0)];
    let found = straightness_of_profile(&zigzag).unwrap();
    near(found.of(ReferenceKind::EndPoints).error_um, 4.0, 1e-12);
    near(found.of(ReferenceKind::LeastSquares).error_um, 3.6, 1e-12);
    near(found.of(ReferenceKind::MinimumZone).error_um, 3.0, 1e-12);
    // Residuals −0.6, 1.8, −1.8, 0.6: sum of squares 7.2, s² = 3.6, Σ(q − q̄)² = 5. 1 µm/mm is 1000 µrad.
    let u = found.slope_uncertainty.unwrap().standard_urad;
    near(u, (3.6_f64 / 5.0).sqrt() * 1e3, 1e-9);
}

#[test]
fn runs_of_both_directions_make_one_profile_and_their_difference() {
    let text = "target,run,direction,deviation_um\n0,1,+,0\n10,1,+,4\n20,1,+,0\n20,1,-,2\n10,1,-,2\n0,1,-,2\n";
    let found = straightness_of(&parse_csv(text.as_bytes(), "s.csv").unwrap()).unwrap();
    assert_eq!(found.profile, [(0.0, 1.0), (10.0, 3.0), (20.0, 1.0)]);
    assert_eq!(found.reversal_um, Some(2.0));
    let single = parse_csv(b"target,deviation_um\n0,1\n", "s.csv").unwrap();
    assert!(straightness_of(&single).is_err());
}

/// Runs with different slopes, as after realignment of the beam, increase the uncertainty of the slope by their
/// scatter: the standard deviation of (−60, 10, 50) µrad is 55.7 µrad.
#[test]
fn different_slopes_of_runs_widen_the_uncertainty() {
    let stated = |slopes: [f64; 3]| {
        let mut text = "target,run,direction,deviation_um\n".to_owned();
        for (run, slope) in (1..).zip(slopes) {
            for k in 0..11 {
                let at = 50.0 * f64::from(k);
                let noise = 0.05 * f64::from((7 * k + 3 * run) % 5 - 2);
                let _ = writeln!(text, "{at},{run},+,{:?}", 1e-3 * slope * at + noise);
            }
        }
        let found = straightness_of(&parse_csv(text.as_bytes(), "s.csv").unwrap()).unwrap();
        found.slope_uncertainty.unwrap().standard_urad
    };
    near(stated([-60.0, 10.0, 50.0]), 55.678 / 3.0_f64.sqrt(), 0.2);
    assert!(stated([0.0, 0.0, 0.0]) < 0.2);
}

/// The stated standard uncertainty of a slope equals the scatter of the slopes in simulations.
#[test]
fn the_uncertainty_of_a_slope_matches_simulations() {
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (mut slopes, mut stated) = (Vec::new(), Vec::new());
    for _ in 0..4000 {
        let profile: Vec<(f64, f64)> =
            (0..21).map(|k| (f64::from(k) * 50.0, noise.sample(&mut rng))).collect();
        let found = straightness_of_profile(&profile).unwrap();
        slopes.push(found.of(ReferenceKind::LeastSquares).line.slope().0);
        stated.push(found.slope_uncertainty.unwrap().standard_urad.powi(2));
    }
    let mean_square = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64;
    let scatter = mean_square(&slopes).sqrt();
    let stated = (stated.iter().sum::<f64>() / stated.len() as f64).sqrt();
    near(stated, scatter, 0.03 * scatter);
}

/// A straightness line of 500 mm: numbers of targets and runs, noise of a reading in µm, and scatter of the slope of
/// the reference between runs in µrad.
struct Line {
    targets: u32,
    runs: u32,
    noise_um: f64,
    realigned_urad: f64,
}

impl Line {
    /// Simulates readings in both directions with a reversal value, and with a profile if there are several runs.
    /// Returns the evaluated straightness, and the error of its slope in µrad.
    fn measured(
        &self,
        rng: &mut rand_chacha::ChaCha8Rng,
    ) -> (volcomp_metrology::Straightness, f64) {
        let normal = Normal::new(0.0, 1.0).unwrap();
        let targets = (0..self.targets).map(|k| 500.0 * f64::from(k) / f64::from(self.targets - 1));
        let height_um = if self.runs > 1 { 5.0 } else { 0.0 };
        let truth: Vec<(f64, f64)> =
            targets.map(|q| (q, 0.012 * q + height_um * (q / 90.0).sin())).collect();
        let mut readings = Vec::new();
        for run in 1..=self.runs {
            let slope = 1e-3 * self.realigned_urad * normal.sample(rng);
            let zero = 100.0 * normal.sample(rng);
            for direction in Direction::BOTH {
                let reversal = if direction == Direction::Positive { 1.5 } else { -1.5 };
                readings.extend(truth.iter().map(|(target, value)| Reading {
                    target: *target,
                    run,
                    direction,
                    deviation: value
                        + zero
                        + slope * target
                        + reversal
                        + self.noise_um * normal.sample(rng),
                }));
            }
        }
        let measurement = Measurement { readings, ..Measurement::default() };
        let found = straightness_of(&measurement).unwrap();
        let true_slope = ReferenceLine::least_squares(&truth).unwrap().slope().0;
        let error = found.of(ReferenceKind::LeastSquares).line.slope().0 - true_slope;
        (found, error)
    }
}

/// Fraction of simulated squareness errors whose deviation from the truth is within the stated U. The reference square
/// is calibrated to U = 3 µrad.
fn coverage(lines: [&Line; 2]) -> f64 {
    const TRIALS: u32 = 800;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let square = Normal::new(0.0, 1.5).unwrap();
    let inputs = SquarenessInputs { square_urad: Some(3.0), ..SquarenessInputs::default() };
    let inside = (0..TRIALS).filter(|_| {
        let [(first, a), (second, b)] = lines.map(|line| line.measured(&mut rng));
        let error = a + b + square.sample(&mut rng);
        let slopes = [first, second].map(|line| line.slope_uncertainty.unwrap());
        let found = squareness_uncertainty(&inputs, slopes, [500.0; 2]).unwrap();
        error.abs() <= found.whole_urad
    });
    inside.count() as f64 / f64::from(TRIALS)
}

/// The stated U contains the true squareness with a probability of 95.45 % (k = 2), or more if both lines have few
/// degrees of freedom. The reference is realigned only if there are several runs, because a single run does not show
/// this effect.
#[test]
fn the_uncertainty_of_a_squareness_covers_the_truth() {
    for runs in [1, 2, 5] {
        for targets in [3, 4, 11] {
            let realigned_urad = if runs > 1 { 20.0 } else { 0.0 };
            let line = |noise_um| Line { targets, runs, noise_um, realigned_urad };
            let noisy = line(2.0);
            // The scatter of this line is negligible.
            let still = Line { noise_um: 0.01, realigned_urad: 0.01, ..noisy };
            let [both, one] = [coverage([&noisy, &noisy]), coverage([&noisy, &still])];
            assert!((0.935..0.998).contains(&both), "{runs} {targets}: {both}");
            assert!((0.935..0.975).contains(&one), "{runs} {targets}: {one}");
        }
    }
}

/// The stated U also covers the slope of a profile that is summed from bridge tilts; the residuals about its line would
/// give only a fraction of this U.
#[test]
fn the_uncertainty_of_the_slope_of_a_bridge_covers_the_truth() {
    const TRIALS: u32 = 2000;
    let noise = Normal::new(0.0, 3.0).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    for steps in [2, 4, 20] {
        let mut inside = 0;
        for _ in 0..TRIALS {
            let tilts: Vec<f64> = (0..steps).map(|_| 8.0 + noise.sample(&mut rng)).collect();
            let mut profile = vec![(0.0, 0.0)];
            for tilt in &tilts {
                let (at, height) = *profile.last().unwrap();
                profile.push((at + 200.0, height + 0.2 * tilt));
            }
            let slope = ReferenceLine::least_squares(&profile).unwrap().slope().0;
            // The tilt at the first target is not used.
            let at = |(place, tilt): (usize, &f64)| (200.0 * (place + 1) as f64, *tilt);
            let readings = tilts.iter().enumerate().map(at);
            let readings: Vec<_> = iter::once((0.0, 1e3)).chain(readings).collect();
            let u = SlopeUncertainty::of_tilts(&readings).unwrap();
            inside += u32::from((slope - 8.0).abs() <= u.expanded_urad());
        }
        let share = f64::from(inside) / f64::from(TRIALS);
        assert!((0.935..0.975).contains(&share), "{steps}: {share}");
    }
}

/// For a point at (b, c) across X, the deviation is δ = E + ε_Y c − ε_Z b. The deviations of four lines are computed by
/// hand.
#[test]
fn parallel_lines_give_back_the_angles() {
    let truth = [(3.0, [10.0, -20.0]), (-1.0, [0.0, 7.5])];
    let line = |b: f64, c: f64| ParallelLine {
        offset_mm: [b, c],
        deviations_um: truth
            .iter()
            .map(|(e, [about_y, about_z])| e + 1e-3 * (about_y * c - about_z * b))
            .collect(),
    };
    let lines = [line(0.0, 0.0), line(800.0, 0.0), line(0.0, 600.0), line(-300.0, 450.0)];
    let found = separate_parallel_lines(&lines).unwrap();
    for (found, (linear, angles)) in found.iter().zip(truth) {
        near(found.linear_um, linear, 1e-9);
        near(found.angles_urad[0], angles[0], 1e-9);
        near(found.angles_urad[1], angles[1], 1e-9);
    }
    let in_one_plane = [line(0.0, 0.0), line(800.0, 0.0), line(400.0, 0.0)];
    let mut uneven = lines.clone();
    uneven[1].deviations_um.pop();
    let mut broken = lines.clone();
    broken[1].deviations_um[0] = f64::NAN;
    let messages = [
        separate_parallel_lines(&lines[..2]),
        separate_parallel_lines(&in_one_plane),
        separate_parallel_lines(&uneven),
        separate_parallel_lines(&broken),
    ]
    .map(|refused| refused.unwrap_err().to_string());
    insta::assert_snapshot!(messages.join("\n"), @r"
    parallel lines: lines: found 2, expected at least three
    parallel lines: lines: found all in one plane, expected three that are not in one plane
    parallel lines: targets: found 1 beside 2, expected the same on each line
    parallel lines: numbers: found one that is not finite, expected finite numbers
    ");
}

/// A parallelogram whose side AD is along the first axis; side AB is inclined by t relative to the second axis. If B is
/// inclined towards the first axis, the angle is smaller by t: the result is −t for EC0Y and EA0Z, +t for EB0Z.
#[test]
fn squareness_of_a_drawn_parallelogram() {
    let distance = |[ax, ay]: [f64; 2], [bx, by]: [f64; 2]| (bx - ax).hypot(by - ay);
    for t in [-3e-3_f64, 0.0, 1e-4, 8e-3] {
        for [ad, ab] in [[100.0, 100.0], [150.0, 80.0]] {
            let (a, d) = ([10.0, 20.0], [10.0 + ad, 20.0]);
            let b = [10.0 + ab * t.sin(), 20.0 + ab * t.cos()];
            let c = [b[0] + ad, b[1]];
            for side in [distance(a, d), distance(a, b)] {
                let lengths = [distance(a, c), distance(b, d), side];
                for (error, sign) in [("EC0Y", -1.0), ("EA0Z", -1.0), ("EB0Z", 1.0)] {
                    let found = squareness_of_lengths(error.parse().unwrap(), lengths).unwrap();
                    assert!((found.0 - sign * t * 1e6).abs() < 1e-6, "{error} {t}: {found:?}");
                }
            }
        }
    }
    for lengths in [[0.0; 3], [141.0, 141.0, 250.0], [f64::NAN, 141.0, 100.0], [199.0, 20.0, 100.0]]
    {
        assert!(squareness_of_lengths("EC0Y".parse().unwrap(), lengths).is_err(), "{lengths:?}");
    }
    assert!(squareness_of_lengths("EXX".parse().unwrap(), [141.4, 141.4, 100.0]).is_err());
}
