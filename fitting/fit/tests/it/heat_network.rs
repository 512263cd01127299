//! A simulated machine: a thermal network of masses that conduct heat to one another and to the room, with a heat
//! source in the spindle and a drifting room temperature. It shares no code with the tested fits.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{ThermalRecord, ThermalRun};

/// Heat capacities, kJ/K: bearing, head, upper column, lower column, bed, scale.
const CAPACITY: [f64; 6] = [8.0, 60.0, 150.0, 220.0, 900.0, 5.0];
/// Indices of two masses, and the thermal conductance between them, W/K.
const CONDUCTION: [(usize, usize, f64); 5] =
    [(0, 1, 45.0), (1, 2, 30.0), (2, 3, 60.0), (3, 4, 40.0), (2, 5, 2.0)];
/// Conductance from each mass to the room by convection, W/K.
const CONVECTION: [f64; 6] = [4.0, 10.0, 14.0, 14.0, 30.0, 3.0];
/// Displacement of the tool by each mass, µm per kelvin of its temperature.
const EFFECT: [f64; 6] = [1.2, 3.0, 4.0, -2.5, -1.5, 0.0];
/// Number of rows of a run; `STEP_S` is their interval, s.
const ROWS: usize = 360;
const STEP_S: f64 = 60.0;
const SECONDS: u32 = 60;

fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// A run of six hours: noisy readings of the sensors, and the true temperatures of the masses.
pub(crate) struct Simulated {
    pub(crate) time_s: Vec<f64>,
    /// Readings of each sensor, °C: bearing, head, upper column, bed, scale, room, and a sensor in the control cabinet
    /// that has no effect.
    pub(crate) degc: Vec<Vec<f64>>,
    pub(crate) truth: Vec<Vec<f64>>,
}

pub(crate) fn simulated(seed: u64) -> Simulated {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let begun = random.random_range(18.0..24.0);
    let [phase, swing, trend] = [
        random.random_range(0.0..6.3),
        random.random_range(0.3..1.5),
        random.random_range(-0.3..0.3),
    ];
    let mut mass = [begun; 6];
    let (mut watt, mut cabinet) = (0.0, begun + 8.0);
    let mut found =
        Simulated { time_s: Vec::new(), degc: vec![Vec::new(); 7], truth: vec![Vec::new(); 6] };
    for row in 0..ROWS {
        let hours = row as f64 * STEP_S / 3600.0;
        // At the start, all masses have the temperature of the room.
        let room = begun + swing * ((hours + phase).sin() - phase.sin()) + trend * hours;
        if row % 20 == 0 {
            watt = [0.0, 150.0, 400.0, 900.0][random.random_range(0..4)];
        }
        for (all, degc) in found.truth.iter_mut().zip(mass) {
            all.push(degc);
        }
        found.time_s.push(row as f64 * STEP_S);
        cabinet += 0.2 * normal(&mut random);
        let shown = [mass[0], mass[1], mass[2], mass[4], mass[5], room, cabinet];
        for (all, degc) in found.degc.iter_mut().zip(shown) {
            all.push(degc + 0.03 * normal(&mut random));
        }
        // Steps of one second; the time constant of each mass is some minutes or more.
        for _ in 0..SECONDS {
            let mut flow = [0.0; 6];
            flow[0] += watt;
            for (a, b, conducts) in CONDUCTION {
                let between = conducts * (mass[a] - mass[b]);
                flow[a] -= between;
                flow[b] += between;
            }
            for (k, flow) in flow.iter_mut().enumerate() {
                *flow -= CONVECTION[k] * (mass[k] - room);
                mass[k] += *flow / (CAPACITY[k] * 1000.0);
            }
        }
    }
    found
}

/// A run with the displacement of the tool relative to its start, with noise of 0.2 µm.
pub(crate) fn run(seed: u64) -> ThermalRun {
    let machine = simulated(seed);
    let mut random = ChaCha8Rng::seed_from_u64(seed + 1_000_000);
    let moved = |row: usize| {
        let parts = machine.truth.iter().zip(EFFECT);
        parts.map(|(degc, per_k)| per_k * (degc[row] - degc[0])).sum::<f64>()
    };
    let displacement = (0..ROWS).map(|row| moved(row) + 0.2 * normal(&mut random)).collect();
    ThermalRecord { time_s: machine.time_s, degc: machine.degc, displacement }.into()
}

/// A run over five positions of an axis with an error curve. The scale expands by 11.5 µm/(m·K) from the fixed point at
/// 100 mm.
pub(crate) fn moving(seed: u64) -> ThermalRun {
    let machine = simulated(seed);
    let mut random = ChaCha8Rng::seed_from_u64(seed + 1_000_000);
    let position_mm: Vec<f64> = (0..ROWS).map(|row| 200.0 * (row % 5) as f64).collect();
    let displacement = |row: usize| {
        let (q, warmer) = (position_mm[row], machine.truth[5][row] - 20.0);
        let curve = 7.0 * (q / 150.0).sin();
        curve + 0.0115 * warmer * (q - 100.0) + 0.2 * normal(&mut random)
    };
    let displacement = (0..ROWS).map(displacement).collect();
    ThermalRun {
        record: ThermalRecord { time_s: machine.time_s, degc: machine.degc, displacement },
        position_mm,
    }
}
