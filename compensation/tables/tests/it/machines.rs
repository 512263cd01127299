//! Maps of machines equal the exact correction; effect of temperatures, and neglected effects.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::{
    MachineMap, MapOptions, Position, TablesError, Transfer, axes_of, control,
    model::{
        Machine, Temperatures,
        kinematics::{CorrectionOptions, State},
    },
    refresh_s,
    vocabulary::{AxisName, Direction},
};

const GANTRY: &str = r#"
structure = "w X' b Y Z t"
[axes]
X = { travel = [0.0, 800.0] }
Y = { travel = [0.0, 650.0] }
Z = { travel = [-500.0, 0.0] }
[errors]
EXX = { mean = { poly = [0.0, 0.05, -2.0e-5] }, reversal = 6.0 }
EYX = { poly = [0.0, 0.03, -4.0e-5] }
EBX = { poly = [0.0, 0.04, 2.0e-5] }
EYY = { forward = { poly = [0.0, 0.04] }, backward = { poly = [3.0, 0.0405] } }
EAY = { poly = [0.0, -0.03] }
EC0Y = 30.0
EZZ = { table = [[-500.0, 0.0], [-310.0, 4.0], [-130.0, -3.0], [0.0, 0.0]], interpolation = "linear" }
[thermal]
reference = 20.0
[[thermal.expansion]]
error = "EXX"
sensor = "scale_x"
um_per_m_k = 11.5
fixed_mm = 0.0
[[thermal.drift]]
error = "EZZ"
sensors = { spindle = 1.0 }
um_per_k = 3.2
lag_s = 600.0
"#;

const FIVE_AXES: &str = r#"
structure = "w C' X' b Y Z B t"
[axes]
X = { travel = [0.0, 500.0] }
Y = { travel = [0.0, 400.0] }
Z = { travel = [-300.0, 0.0] }
C = { travel = [0.0, 360.0] }
B = { travel = [-90.0, 90.0] }
[tool]
tip = [0.0, 0.0, -150.0]
[errors]
EXX = { poly = [0.0, 0.05] }
EX0C = 20.0
EA0B = 40.0
"#;

fn parsed(text: &str) -> Machine {
    Machine::parse(text, "machine.toml").expect("a machine")
}

#[expect(clippy::cast_possible_truncation, reason = "travels of a machine")]
fn steps(mm: f64) -> i32 {
    (mm * 1000.0) as i32
}

/// Largest difference between a map and the exact corrections at random positions and directions, mm.
fn largest_mm(machine: &Machine, temperatures: &Temperatures, made: &MachineMap) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let header = made.table.map.header();
    let outputs: Vec<AxisName> = axes_of(header.outputs).collect();
    let options = CorrectionOptions::of(&outputs);
    let mut largest = 0.0_f64;
    for _ in 0..3000 {
        let mut state: State = machine.state(&made.held).expect("its axes");
        let mut position = Position::default();
        for (place, name) in axes_of(header.grid).enumerate() {
            let index = machine.index_of(name).expect("its axis");
            let [low, high] = machine.axes()[index].travel;
            let steps = rng.random_range(steps(low)..=steps(high));
            position.steps[place] = steps;
            position.directions[place] = Some(Direction::BOTH[rng.random_range(0..2)]);
            let at = f64::from(steps) * 1e-3;
            state.q[index] = if name.is_rotary() { at.to_radians() } else { at };
            state.approach[index] = position.directions[place];
        }
        let exact = machine.correction_at(&state, temperatures, &options);
        let found = made.table.map.correction_mm(&position);
        let squares = outputs.iter().zip(found).map(|(name, found)| {
            let index = machine.index_of(*name).expect("its axis");
            (found - exact.delta[index]).powi(2)
        });
        largest = largest.max(squares.sum::<f64>().sqrt());
    }
    largest
}

#[test]
fn the_map_of_a_gantry_is_its_correction_within_the_bound() {
    let machine = parsed(GANTRY);
    let temperatures: Temperatures =
        [("scale_x", 23.0), ("spindle", 28.0)].map(|(name, t)| (name.to_owned(), t)).into();
    for within_mm in [0.003, 0.001] {
        let options = MapOptions { within_mm, words: 20000, ..MapOptions::default() };
        let made = MachineMap::new(&machine, &temperatures, &options).expect("a map");
        let stated = made.table.misfit.max_mm;
        let found = largest_mm(&machine, &temperatures, &made);
        assert!(stated <= within_mm, "{stated}");
        assert!(found <= 1.02 * stated && found > 0.3 * stated, "{found}, stated {stated}");
        // The header has half of the reversal value of 6 µm, with the opposite sign of the error.
        let header = made.table.map.header();
        let step = f64::from(header.scale);
        assert!((f64::from(header.reversal[0][0]) + 3.0 * step).abs() < 0.1 * step, "{header:?}");
        assert_eq!(made.held, []);
        assert_eq!(made.elsewhere_mm, None);
        let checksum =
            u32::from_str_radix(&machine.checksum()["sha256:".len()..][..8], 16).expect("digits");
        assert_eq!(header.model, checksum);
    }
}

#[test]
fn the_refresh_interval_follows_from_the_effect_of_1_k() {
    let machine = parsed(GANTRY);
    let made = MachineMap::new(
        &machine,
        &Temperatures::new(),
        &MapOptions { within_mm: 0.003, ..MapOptions::default() },
    )
    .expect("a map");
    // 11.5 µm/(m·K) over 800 mm for the scale, and 3.2 µm/K for the spindle.
    let found: Vec<(&str, f64)> =
        made.sensitivities.iter().map(|s| (s.sensor.as_str(), s.mm_per_k * 1e3)).collect();
    let [("scale_x", scale), ("spindle", spindle)] = found[..] else { panic!("{found:?}") };
    assert!((scale - 9.2).abs() < 0.05 && (spindle - 3.2).abs() < 0.02, "{found:?}");
    // 12.4 µm/K at 0.5 K/h: 1 µm in 580 s.
    let seconds = refresh_s(&made.sensitivities, 0.5, 0.001).expect("temperatures count");
    assert!((seconds - 3600.0 / 6.2).abs() < 5.0, "{seconds}");
    assert_eq!(refresh_s(&[], 0.5, 0.001), None);
    assert_eq!(refresh_s(&made.sensitivities, 0.0, 0.001), None);
}

#[test]
fn fixed_rotary_axes_and_their_neglected_effect() {
    let machine = parsed(FIVE_AXES);
    let options = MapOptions { within_mm: 0.002, ..MapOptions::default() };
    let made = MachineMap::new(&machine, &Temperatures::new(), &options).expect("a map");
    assert_eq!(made.held, [(AxisName::C, 0.0), (AxisName::B, 0.0)]);
    // An offset of C by 20 µm: half a turn from the fixed position it is 40 µm, plus the tilt of B.
    let elsewhere_um = made.elsewhere_mm.expect("two axes are held") * 1e3;
    assert!((38.0..80.0).contains(&elsewhere_um), "{elsewhere_um}");
    // With both axes in the grid nothing is neglected.
    let options = MapOptions {
        grid: vec![AxisName::X, AxisName::Y, AxisName::Z, AxisName::B, AxisName::C],
        within_mm: 0.006,
        words: 32767,
        ..MapOptions::default()
    };
    let made = MachineMap::new(&machine, &Temperatures::new(), &options).expect("a map");
    assert_eq!(made.elsewhere_mm, None);
    assert!(largest_mm(&machine, &Temperatures::new(), &made) <= 0.006);
}

#[test]
fn invalid_map_options_are_refused() {
    let gantry = parsed(GANTRY);
    let mut only_rotary = parsed(FIVE_AXES);
    only_rotary.set_correct(Some(&[AxisName::B])).expect("its axis");
    let no_axis = MapOptions { grid: vec![AxisName::A], ..MapOptions::default() };
    let small = MapOptions { limit_mm: 0.01, ..MapOptions::default() };
    for (machine, options, expected) in [
        (&gantry, no_axis, "has no axis A"),
        (&gantry, small, "expected at most 10 µm"),
        (&only_rotary, MapOptions::default(), "expected one to five different axes"),
    ] {
        let refused = MachineMap::new(machine, &Temperatures::new(), &options);
        let message = refused.expect_err(expected).to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn a_transfer_counts_every_frame() {
    let machine = parsed(GANTRY);
    let options = MapOptions { within_mm: 0.003, ..MapOptions::default() };
    let made = MachineMap::new(&machine, &Temperatures::new(), &options).expect("a map");
    let map = &made.table.map;
    let transfer = Transfer::of(map);
    assert_eq!(transfer.frames, volcomp_tables::writes(map, 7).count());
    let frames = transfer.frames * (control::FRAME_WORDS + control::REPORT_WORDS);
    assert_eq!(transfer.bytes, 2 * (frames + map.words().len()));
    let seconds = transfer.duration_s(1000.0, 0.02);
    assert!(
        (seconds - (transfer.bytes as f64 / 1000.0 + transfer.frames as f64 * 0.02)).abs() < 1e-9
    );
}

/// An axis that rolls over is rejected in a map's grid: outside the travel a map keeps its end value, while such an axis has the value of
/// the equivalent position.
#[test]
fn an_axis_that_rolls_over_has_no_map() {
    let text = FIVE_AXES
        .replace("C = { travel = [0.0, 360.0] }", "C = { travel = [0.0, 360.0], modulo = 360.0 }");
    let machine = parsed(&text);
    let made = |grid: &[AxisName]| {
        let options = MapOptions {
            grid: grid.to_vec(),
            within_mm: 0.006,
            words: 32767,
            ..MapOptions::default()
        };
        MachineMap::new(&machine, &Temperatures::new(), &options)
    };
    let linear = [AxisName::X, AxisName::Y, AxisName::Z];
    assert!(made(&linear).is_ok(), "held, it may roll over");
    let [x, y, z] = linear;
    let refused = made(&[x, y, z, AxisName::C]);
    assert!(
        matches!(refused, Err(TablesError::RollsOver { axis: AxisName::C, .. })),
        "{refused:?}"
    );
}
