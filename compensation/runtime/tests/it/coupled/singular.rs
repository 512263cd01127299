//! Tests near a singular pose, and tests of the output steps of rotary axes.

use std::fmt::Write;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::Vector;
use volcomp_model::Machine;
use volcomp_runtime::{kinematics::State, rotary_step_error};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, MAX_AXES, Mm, PerAxis, PerChannel, Rad};

use super::{
    cell::{COMPILED_MM, Cell},
    poses,
    scene::{Path, Scene, Seen},
};

/// A trunnion table, C on A, with its pivot 0.1 m below the spindle nose.
fn trunnion(rng: &mut ChaCha8Rng) -> Cell {
    let mut number = |size: f64| rng.random_range(-size..=size);
    let mut text = "structure = \"w C' A' b X Y Z t\"\n".to_owned();
    for (axis, half) in [("C", 180), ("A", 90), ("X", 400), ("Y", 400), ("Z", 400)] {
        let point = if axis < "X" { "[0, 0, -100.0]" } else { "[0, 0, 0]" };
        writeln!(text, "[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point}")
            .expect("a string");
    }
    text += "[errors]\n";
    for axis in ["X", "Y", "Z", "A", "C"] {
        for what in ["EX", "EY", "EZ"] {
            writeln!(text, "{what}{axis} = {}", number(4.0)).expect("a string");
        }
        for what in ["EA", "EB"] {
            writeln!(text, "{what}{axis} = {}", number(15.0)).expect("a string");
        }
    }
    Cell::of(Machine::parse(&text, "m.toml").expect("a machine"), &[2, 3, 4, 1, 0])
}

/// Within 1.5° of the singular pose the correction of C is many times the tool axis error; the tool error stays within its bound. If
/// each axis were limited and rounded alone (50 µm, 100 µrad, steps of 17 µrad), 10.8 µm would become 51.3 µm.
#[test]
fn near_the_singular_pose_the_tool_is_no_further_off() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let (mut worst_alone, mut seen) = (0.0_f64, Seen::default());
    for _ in 0..poses() {
        let cell = trunnion(&mut rng);
        let mut limits = cell.random_limits(&mut rng);
        limits.period = std::time::Duration::from_millis(4);
        limits.ramp = std::time::Duration::from_millis(500);
        for axis in limits.axes.iter_mut().take(limits.count) {
            (axis.limit, axis.resolution, axis.slew_per_s) = match axis.kind {
                AxisKind::Linear => (0.050, 0.001, 0.5),
                AxisKind::Rotary => (100e-6, 17e-6, 500e-6),
            };
            axis.accel_per_s2 = f64::INFINITY;
        }
        let mut state = cell.random_state(&mut rng);
        state.q[1] = rng.random_range(-0.026..=0.026);
        let full = cell.wanted(&state, &PerChannel::ZERO).full();
        let alone = PerChannel::from_fn(|i| {
            let axis = &limits.axes[i];
            let limited = full[i].clamp(-axis.limit, axis.limit);
            (limited / axis.resolution).round() * axis.resolution
        });
        let without = cell.off(&state, &PerChannel::ZERO);
        worst_alone = worst_alone.max(cell.off(&state, &alone) - without);
        let mut scene = Scene {
            path: Path { from: state, rate: PerAxis::ZERO },
            limits,
            ..Scene::new(&cell, &mut rng, false, false)
        };
        for _ in 0..300 {
            scene.follow(&mut rng, &mut seen);
        }
        assert!(scene.vector.is_ramped());
    }
    let worst = seen.worst.expect("judged");
    println!("alone {worst_alone} mm over what is without, together {worst} mm over the bound");
    assert!(worst <= COMPILED_MM, "{worst} {}", seen.reported);
    assert!(worst_alone > 0.020, "the case is one: {worst_alone}");
}

/// The last digit of A flickers at the edge of the singular range, 1.146°: each axis moves by at most one step, linear axes also by the
/// effect of that step at its lever arm.
#[test]
fn a_flickering_digit_at_the_edge_of_the_singular_pose_moves_each_axis_by_one_step() {
    let text = "structure = \"w C' A' b X Y Z t\"\n[axes.X]\ntravel = [0.0, 600.0]\n[axes.Y]\ntravel = [0.0, 500.0]\n[axes.Z]\ntravel = [-400.0, 0.0]\n[axes.A]\ntravel = [-110.0, 30.0]\npoint = [300.0, 250.0, -450.0]\n[axes.C]\ntravel = [-360.0, 360.0]\npoint = [300.0, 250.0, -450.0]\n[errors]\nEBZ = 10.0\n";
    let cell = Cell::of(Machine::parse(text, "m.toml").expect("a machine"), &[2, 3, 4, 1, 0]);
    let digit = 0.001_f64.to_radians();
    let mut limits = cell.random_limits(&mut ChaCha8Rng::seed_from_u64(1));
    limits.period = std::time::Duration::from_millis(4);
    limits.ramp = std::time::Duration::from_millis(500);
    for axis in limits.axes.iter_mut().take(limits.count) {
        (axis.limit, axis.resolution, axis.slew_per_s) = match axis.kind {
            AxisKind::Linear => (0.2, 0.001, 0.5),
            AxisKind::Rotary => (600e-6, digit, 2000e-6),
        };
        axis.accel_per_s2 = f64::INFINITY;
    }
    let mut state = State::default();
    for (q, place) in state.q.iter_mut().zip([0.3, 0.0, 550.0, 250.0, -300.0]) {
        *q = place;
    }
    for edge in [0.8594_f64, 0.9, 1.0, 1.1, 1.145] {
        let mut vector = Vector::at(&PerChannel::ZERO);
        let (mut low, mut high) = (PerChannel::ZERO, PerChannel::ZERO);
        for cycle in 0..6000 {
            state.q[1] = edge.to_radians() + if cycle / 125 % 2 == 0 { digit } else { 0.0 };
            let wanted = cell.wanted(&state, &vector.output());
            vector.follow(&wanted, &limits, 0.004);
            if cycle == 1000 {
                (low, high) = (vector.output(), vector.output());
            }
            low = PerChannel::from_fn(|i| vector.output()[i].min(low[i]));
            high = PerChannel::from_fn(|i| vector.output()[i].max(high[i]));
        }
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let moved = (high[i] - low[i]) / axis.resolution;
            // A step of C moves Y by up to 250 mm times that step.
            let most = if axis.kind == AxisKind::Rotary { 1.01 } else { 6.0 };
            assert!(moved <= most, "{edge}°, {i}: {moved} steps");
        }
    }
}

/// The reported step error is half a step times its lever: no sampled tip error exceeds it by more than 1 %, and the largest is at least
/// 90 % of it.
#[test]
fn the_rotary_step_error_is_exact() {
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    for structure in all_types() {
        let cell = Cell::new(&structure, &mut rng);
        let chain = cell.machine.chain();
        let step = Rad(20e-6);
        for (index, axis) in structure.axes().iter().enumerate() {
            let reported = cell.model.rotary_step_error(index, step);
            if !axis.is_rotary() {
                assert_eq!(reported, Mm(0.0));
                continue;
            }
            let mut most = 0.0_f64;
            for pose in 0..20_000 {
                let mut state = cell.random_state(&mut rng);
                if pose % 2 == 0 {
                    // At the ends of the linear travels, where the levers are longest.
                    for (q, joint) in state.q.iter_mut().zip(chain.joints()) {
                        if joint.kind == AxisKind::Linear {
                            *q = 400.0_f64.copysign(*q);
                        }
                    }
                }
                let tip = |by: f64| {
                    let mut state = state;
                    state.q[index] += by;
                    chain.ideal_tip_mm(&state)
                };
                most = most.max((tip(0.5 * step.0) - tip(0.0)).norm());
            }
            // Between the 25 sampled positions of another rotary axis the lever may be slightly longer.
            assert!(most <= reported.0 * 1.01, "{structure} {axis}: {most} {reported}");
            assert!(most >= reported.0 * 0.9, "{structure} {axis}: {most} {reported}");
        }
    }
    assert_eq!(rotary_step_error(500.0, Rad(20e-6)), Mm(0.005));
    let model = trunnion(&mut rng).model;
    assert_eq!(model.rotary_step_error(MAX_AXES + 1, Rad(1e-6)), Mm(0.0));
}
