//! ISO 230-4 on circles of a machine with known errors. The errors displace positions; radial deviations follow from
//! these.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::circular::{
    CircularPlane, CircularTrace, Sense, SignatureKind, Signatures, circular_deviations,
    circular_signatures, parse_trace,
};

use crate::samples::near;

const RADIUS_MM: f64 = 150.0;

#[derive(Clone, Copy, Default)]
struct Machine {
    centre_um: [f64; 2],
    /// Rotation of the Y axis away from X, µrad.
    squareness: f64,
    /// Scale errors of both axes, µm/m.
    scales: [f64; 2],
    /// Reversal values B of both axes, µm.
    backlash: [f64; 2],
    /// Lag of each axis behind its command, as a length of the path, µm.
    lag: [f64; 2],
    /// Overshoot of each axis where it reverses, µm.
    spikes: [f64; 2],
}

const SPIKE_DEG: f64 = 2.0;

impl Machine {
    /// Tool position at an angle (rad) of the path, mm.
    fn position(&self, angle: f64, sense: Sense) -> [f64; 2] {
        let d = sense.sign();
        let at = |lag_um: f64| angle - d * lag_um * 1e-3 / RADIUS_MM;
        let mut x = RADIUS_MM * at(self.lag[0]).cos();
        let mut y = RADIUS_MM * at(self.lag[1]).sin();
        let forward_x = -d * angle.sin();
        let forward_y = d * angle.cos();
        let sign = |v: f64| if v > 0.0 { 1.0 } else { -1.0 };
        x += 1e-3 * (1e-3 * self.scales[0] * x + 0.5 * self.backlash[0] * sign(forward_x));
        y += 1e-3 * (1e-3 * self.scales[1] * y + 0.5 * self.backlash[1] * sign(forward_y));
        x -= 1e-6 * self.squareness * y;
        let since = |place: f64| (d * (angle - place)).rem_euclid(TAU).to_degrees();
        let bump = |place: f64| {
            let since = since(place);
            if since < 90.0 { (-since / SPIKE_DEG).exp() } else { 0.0 }
        };
        x += 1e-3 * self.spikes[0] * (bump(0.0) - bump(TAU / 2.0));
        y += 1e-3 * self.spikes[1] * (bump(TAU / 4.0) - bump(0.75 * TAU));
        [x + 1e-3 * self.centre_um[0], y + 1e-3 * self.centre_um[1]]
    }

    /// Table of circles in both senses, with noise.
    fn table(&self, noise_um: f64, seed: u64) -> String {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_um).unwrap();
        let mut text = "x,y,direction\n".to_owned();
        for sense in Sense::BOTH {
            for k in 0..720 {
                let angle = TAU * (f64::from(k) + 0.5) / 720.0;
                let [x, y] = self.position(angle, sense);
                let radial = noise.sample(&mut rng) * 1e-3;
                let (x, y) = (x + radial * angle.cos(), y + radial * angle.sin());
                writeln!(text, "{x:.7},{y:.7},{}", sense.key()).unwrap();
            }
        }
        text
    }

    fn trace(&self, noise_um: f64, seed: u64) -> CircularTrace {
        let table = self.table(noise_um, seed);
        let radius = Some(RADIUS_MM);
        parse_trace(table.as_bytes(), "circle.csv", CircularPlane::Xy, radius).unwrap()
    }
}

fn found(signatures: &Signatures, kind: SignatureKind) -> (f64, f64) {
    let one = signatures.ranked.iter().find(|s| s.kind == kind).unwrap();
    (one.size, one.uncertainty)
}

fn expected(machine: &Machine) -> [(SignatureKind, f64); 7] {
    [
        (SignatureKind::Squareness, machine.squareness),
        (SignatureKind::ScaleMismatch, machine.scales[0] - machine.scales[1]),
        (SignatureKind::BacklashFirst, machine.backlash[0]),
        (SignatureKind::BacklashSecond, machine.backlash[1]),
        // At 45° the radius changes by half of the lag of X minus the lag of Y.
        (SignatureKind::ServoMismatch, 0.5 * (machine.lag[0] - machine.lag[1])),
        (SignatureKind::SpikesFirst, machine.spikes[0]),
        (SignatureKind::SpikesSecond, machine.spikes[1]),
    ]
}

/// Checks that each signature, including those of size zero, is found within a small second-order bias plus four
/// standard uncertainties.
#[track_caller]
fn recovered(machine: &Machine, noise_um: f64, seed: u64) -> Signatures {
    let signatures = circular_signatures(&machine.trace(noise_um, seed)).unwrap();
    for (kind, size) in expected(machine) {
        let (value, u) = found(&signatures, kind);
        assert!(
            (value - size).abs() <= 2.0 * u + 0.02,
            "{kind:?}: {value} against {size} within {}",
            2.0 * u
        );
    }
    near(signatures.rms_left_um, noise_um, 0.1 * noise_um + 0.02);
    signatures
}

/// If a path is longer than a turn, one turn is evaluated and a note states the rest, for any overshoot, form of table
/// and number of senses.
#[test]
fn one_turn_is_evaluated_and_the_rest_is_noted() {
    let machine = Machine {
        centre_um: [20.0, -5.0],
        squareness: 40.0,
        scales: [30.0, -10.0],
        backlash: [3.0, 1.0],
        ..Machine::default()
    };
    let table = |turned: [f64; 2], by_angle: bool, stated: bool| {
        let mut text = if by_angle { "angle,deviation" } else { "x,y" }.to_owned();
        text += if stated { ",direction\n" } else { "\n" };
        for (sense, turned) in Sense::BOTH.into_iter().zip(turned) {
            // The steps avoid sums that end at half a degree, which a message could round up or down.
            let steps = (0_u32..).map(|step| f64::from(step) * 0.4);
            for at in steps.take_while(|at| *at <= turned + 0.1) {
                // A ballbar test starts before 0°.
                let degrees = if sense == Sense::CounterClockwise {
                    at + 0.25 - 0.5 * (turned - 360.0)
                } else {
                    360.25 + 0.5 * (turned - 360.0) - at
                };
                let angle = degrees.to_radians();
                let [x, y] = machine.position(angle, sense);
                let deviation = (x.hypot(y) - RADIUS_MM) * 1e3;
                let row = if by_angle {
                    format!("{degrees:.2},{deviation:.5}")
                } else {
                    format!("{x:.8},{y:.8}")
                };
                let direction = if stated { format!(",{}", sense.key()) } else { String::new() };
                writeln!(text, "{row}{direction}").unwrap();
            }
        }
        text
    };
    let evaluated = |turned, by_angle, stated| {
        let text = table(turned, by_angle, stated);
        let radius = Some(RADIUS_MM);
        let trace = parse_trace(text.as_bytes(), "c.csv", CircularPlane::Xy, radius).unwrap();
        (circular_deviations(&trace).unwrap(), trace)
    };
    for by_angle in [true, false] {
        for stated in [true, false] {
            let (one, trace) = evaluated([360.0; 2], by_angle, stated);
            assert_eq!(trace.points.len(), 1802);
            assert!(!trace.notes.iter().any(|note| note.contains("left out")));
            for turned in [450.0, 540.0, 720.0, 800.0] {
                let (found, trace) = evaluated([turned, turned], by_angle, stated);
                for (found, one) in found.g_um.into_iter().zip(one.g_um) {
                    // Reversal spikes are sampled every 0.4°, at different angles in each turn.
                    near(found.unwrap(), one.unwrap(), 0.05);
                }
                near(found.g_b_um.unwrap(), one.g_b_um.unwrap(), 0.02);
                for (found, one) in found.centre_um.into_iter().zip(one.centre_um) {
                    near(found, one, 0.02);
                }
                let left_out = turned - 360.0;
                let note = format!(
                    "cw: {turned:.0}° were run; one turn is evaluated, and {left_out:.0}° are left out"
                );
                assert!(trace.notes.contains(&note), "{:?}", trace.notes);
                assert!(trace.notes.contains(&format!("c{note}")), "{:?}", trace.notes);
            }
        }
    }
    // One sense over more than a turn, the other sense over half a turn.
    let (_, trace) = evaluated([450.0, 180.0], true, true);
    let count = |sense| trace.points.iter().filter(|p| p.sense == sense).count();
    assert_eq!(Sense::BOTH.map(count), [900, 451]);
}

/// Overlapping arcs are longer than a turn together, but none is a full turn. All are evaluated, and a note states
/// this.
#[test]
fn overlapping_arcs_are_all_evaluated() {
    let [square, overlapping] = [90, 95].map(|degrees| {
        let mut text = "x,y,direction\n".to_owned();
        for quadrant in 0..4 {
            for sense in Sense::BOTH {
                for step in 0..=degrees {
                    let step = match sense {
                        Sense::CounterClockwise => step,
                        Sense::Clockwise => degrees - step,
                    };
                    let angle = f64::from(90 * quadrant + step).to_radians();
                    let (x, y) = (RADIUS_MM * angle.cos(), RADIUS_MM * angle.sin());
                    let y = y * (1.0 + 20e-6) + 50e-6 * x;
                    writeln!(text, "{x:.6},{y:.6},{}", sense.key()).unwrap();
                }
            }
        }
        let radius = Some(RADIUS_MM);
        let trace = parse_trace(text.as_bytes(), "c.csv", CircularPlane::Xy, radius).unwrap();
        (circular_deviations(&trace).unwrap(), trace)
    });
    for (found, expected) in overlapping.0.g_um.into_iter().zip(square.0.g_um) {
        near(found.unwrap(), expected.unwrap(), 0.1);
    }
    assert!(square.0.g_um[0].unwrap() > 3.0, "{square:?}");
    let note = "ccw: arcs of together 380° overlap; what was run twice is evaluated twice";
    assert!(overlapping.1.notes.iter().any(|found| found == note), "{:?}", overlapping.1.notes);
}

#[test]
fn each_single_signature_is_recovered_and_ranked_first() {
    use SignatureKind as Kind;
    type Change = fn(&mut Machine);
    let cases: [(Kind, Change); 7] = [
        (Kind::Squareness, |m| m.squareness = 60.0),
        (Kind::ScaleMismatch, |m| m.scales = [30.0, -20.0]),
        (Kind::BacklashFirst, |m| m.backlash = [4.0, 0.0]),
        (Kind::BacklashSecond, |m| m.backlash = [0.0, -4.0]),
        (Kind::ServoMismatch, |m| m.lag = [1.0, 7.0]),
        (Kind::SpikesFirst, |m| m.spikes = [5.0, 0.0]),
        (Kind::SpikesSecond, |m| m.spikes = [0.0, 5.0]),
    ];
    for (seed, (kind, set)) in (4_u64..).zip(cases) {
        let mut machine = Machine::default();
        set(&mut machine);
        for noise_um in [0.0, 0.3] {
            let signatures = recovered(&machine, noise_um, seed);
            assert_eq!(signatures.ranked[0].kind, kind);
            assert!(signatures.ranked[0].share > 0.5, "{kind:?}");
        }
    }
}

#[test]
fn all_signatures_together_are_recovered_over_many_seeds() {
    let machine = Machine {
        centre_um: [12.0, -30.0],
        squareness: -45.0,
        scales: [25.0, -12.0],
        backlash: [3.0, -2.0],
        lag: [6.0, 2.0],
        spikes: [4.0, 2.5],
    };
    for seed in 0..40 {
        let signatures = recovered(&machine, 0.5, seed);
        let shares: f64 = signatures.ranked.iter().map(|s| s.share).sum();
        near(shares, 1.0, 1e-12);
        let ranges: Vec<f64> = signatures.ranked.iter().map(|s| s.range_um).collect();
        assert!(ranges.is_sorted_by(|a, b| a >= b));
        near(signatures.spike_width_deg, SPIKE_DEG, 0.8);
        for spike in [0, 2] {
            near(signatures.spikes_um[spike].unwrap(), 4.0, 1.0);
        }
    }
}

/// The true sizes are within the stated 95 % uncertainties in 180 to 199 of 200 simulations.
#[test]
fn the_uncertainty_of_a_signature_matches_simulations() {
    let machine = Machine { squareness: 20.0, ..Machine::default() };
    let within = (0..200)
        .filter(|seed| {
            let trace = machine.trace(0.5, 1000 + seed);
            let signatures = circular_signatures(&trace).unwrap();
            let (value, u) = found(&signatures, SignatureKind::Squareness);
            (value - 20.0).abs() <= u
        })
        .count();
    assert!((180..=199).contains(&within), "{within}");
}

/// An ellipse with the half axes R ± 5 µm, displaced by 40 and −30 µm: G = G(b) = 10 µm, F = ±5 µm, D = 0.
#[test]
fn deviations_of_an_ellipse_by_hand() {
    let machine = Machine {
        centre_um: [40.0, -30.0],
        scales: [5e3 / RADIUS_MM, -5e3 / RADIUS_MM],
        ..Machine::default()
    };
    let trace = machine.trace(0.0, 1);
    let found = circular_deviations(&trace).unwrap();
    for k in 0..2 {
        near(found.g_um[k].unwrap(), 10.0, 0.01);
        near(found.f_max_um[k].unwrap(), 5.0, 0.01);
        near(found.f_min_um[k].unwrap(), -5.0, 0.01);
    }
    near(found.g_b_um.unwrap(), 10.0, 0.01);
    near(found.d_um.unwrap(), 0.0, 0.01);
    // The reader has removed the centre of the positions.
    near(found.centre_um[0].hypot(found.centre_um[1]), 0.0, 0.01);
    assert!(trace.notes[0].contains("0.0400, -0.0300 mm"), "{:?}", trace.notes);
}

/// The two senses are circles with the same centre and radii 2 µm apart: G = 0 for each sense, G(b) = 2 µm, and D is
/// the mean of both.
#[test]
fn both_senses_together_are_worse_than_each() {
    let mut text = "angle,deviation um,direction\n".to_owned();
    for k in 0..360 {
        let offset = 8.0 * f64::from(k).to_radians().cos();
        writeln!(text, "{k},{},ccw\n{k},{},cw", 3.0 + offset, 5.0 + offset).unwrap();
    }
    let trace = parse_trace(text.as_bytes(), "b.csv", CircularPlane::Xy, Some(100.0)).unwrap();
    let found = circular_deviations(&trace).unwrap();
    near(found.g_um[0].unwrap(), 0.0, 1e-9);
    near(found.g_um[1].unwrap(), 0.0, 1e-9);
    near(found.g_b_um.unwrap(), 2.0, 1e-9);
    near(found.d_um.unwrap(), 4.0, 1e-9);
    near(found.centre_um[0], 8.0, 1e-9);
    near(found.f_max_um[1].unwrap(), 5.0, 1e-9);
}

#[test]
fn the_sense_follows_the_order_of_rows_and_one_sense_determines_less() {
    let machine = Machine { squareness: 30.0, ..Machine::default() };
    let table = |sense: Sense| {
        let angles: Vec<i32> = (0..360).collect();
        let rows = angles.iter().map(|k| match sense {
            Sense::CounterClockwise => *k,
            Sense::Clockwise => 359 - *k,
        });
        let rows = rows.map(|k| {
            let [x, y] = machine.position((f64::from(k) + 0.5).to_radians(), sense);
            format!("{x};{y}\n")
        });
        format!("X mm;Y mm\n{}", rows.collect::<String>())
    };
    for sense in Sense::BOTH {
        let trace = parse_trace(table(sense).as_bytes(), "c.csv", CircularPlane::Xy, None).unwrap();
        assert!(trace.points.iter().all(|p| p.sense == sense));
        let deviations = circular_deviations(&trace).unwrap();
        assert_eq!((deviations.g_b_um, deviations.d_um), (None, None));
        // Without a stated radius, F is unknown.
        assert_eq!(deviations.f_max_um, [None; 2]);
        let signatures = circular_signatures(&trace).unwrap();
        let kinds: Vec<_> = signatures.ranked.iter().map(|s| s.kind).collect();
        assert!(!kinds.contains(&SignatureKind::ServoMismatch));
        near(found(&signatures, SignatureKind::Squareness).0, 30.0, 0.05);
    }
}

#[test]
fn tables_that_are_no_circle_are_refused() {
    let read = |text: &str, radius: Option<f64>| {
        parse_trace(text.as_bytes(), "t.csv", CircularPlane::Xy, radius).unwrap_err().to_string()
    };
    let rows = |row: &str| row.repeat(20);
    let messages = [
        read("", None),
        read("a,b\n1,2\n", None),
        read("angle,x\n1,2\n", Some(100.0)),
        read("angle,deviation,x,y\n1,2,3,4\n", Some(100.0)),
        read("angle um,deviation\n1,2\n", Some(100.0)),
        read("angle,deviation deg\n1,2\n", Some(100.0)),
        read("x inch,y\n1,2\n", None),
        read("y,z\n1,2\n", None),
        read("angle,deviation\n1,2\n", Some(100.0)),
        read("angle,deviation\n1,nan\n", Some(100.0)),
        read("angle,deviation,direction\n1,2,left\n", Some(100.0)),
        read(&format!("angle,deviation\n{}", rows("1,2\n")), None),
        read(&format!("angle,deviation\n{}", rows("1,100000\n")), Some(100.0)),
        read(&format!("angle,deviation\n{}", rows("1,2\n")), Some(0.0)),
        read(&format!("x,y\n{}", rows("1,2\n")), None),
    ];
    insta::assert_snapshot!(messages.join("\n"));
    let mut short = "angle,deviation\n".to_owned();
    for k in 0..30 {
        writeln!(short, "{},1", f64::from(k) * 1e-4).unwrap();
    }
    let trace = parse_trace(short.as_bytes(), "s.csv", CircularPlane::Xy, Some(9.0)).unwrap();
    assert!(circular_deviations(&trace).is_err());
    assert!(circular_signatures(&trace).is_err());
}

/// 50 points at standstill with encoder jitter before, within or after the circle do not change the sense of any other
/// point.
#[test]
fn a_standstill_changes_no_sense() {
    let table = |stands: &[usize]| {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        let jitter = Normal::new(0.0, 1e-4).unwrap();
        let mut text = "x,y\n".to_owned();
        // One turn counter-clockwise, and the same turn back.
        for k in 0..=1440_usize {
            let angle = TAU * (720 - k.abs_diff(720)) as f64 / 720.0;
            let [x, y] = [RADIUS_MM * angle.cos(), RADIUS_MM * angle.sin()];
            let count = if stands.contains(&k) { 50 } else { 0 };
            for _ in 0..count {
                let [dx, dy] = [jitter.sample(&mut rng), jitter.sample(&mut rng)];
                writeln!(text, "{:.7},{:.7}", x + dx, y + dy).unwrap();
            }
            writeln!(text, "{x:.7},{y:.7}").unwrap();
        }
        parse_trace(text.as_bytes(), "s.csv", CircularPlane::Xy, Some(RADIUS_MM)).unwrap()
    };
    let without = table(&[]);
    let expected = |k: usize| {
        if k < 720 { Sense::CounterClockwise } else { Sense::Clockwise }
    };
    for (k, point) in without.points.iter().enumerate() {
        assert_eq!(point.sense, expected(k), "{k}");
    }
    for stand in [0, 100, 1000, 1440] {
        let with = table(&[stand]);
        for (k, point) in with.points.iter().enumerate() {
            let k = if k > stand + 50 { k - 50 } else { k.min(stand) };
            assert_eq!(point.sense, expected(k), "{k} with a standstill at {stand}");
        }
        let [one, other] = [&with, &without].map(|trace| circular_deviations(trace).unwrap());
        for k in 0..2 {
            near(one.g_um[k].unwrap(), other.g_um[k].unwrap(), 1.0);
        }
    }
    // Where the path reverses, only the points at standstill may have either sense.
    let with = table(&[720]);
    for (k, point) in with.points.iter().enumerate() {
        if k < 720 {
            assert_eq!(point.sense, Sense::CounterClockwise, "{k}");
        } else if k > 770 {
            assert_eq!(point.sense, Sense::Clockwise, "{k}");
        }
    }
}

/// A table with only a column `radius` is rejected with the expected names: 150.002 mm must not be read as a deviation
/// of 150 µm.
#[test]
fn a_column_of_radii_is_not_read_as_deviations() {
    let read = |head: &str| {
        let cells = head.split(',').count();
        let mut text = format!("{head}\n");
        for k in 0..360 {
            let row = [k.to_string(), "0.002".to_owned(), "150".to_owned()];
            writeln!(text, "{}", row[..cells].join(",")).unwrap();
        }
        parse_trace(text.as_bytes(), "r.csv", CircularPlane::Xy, Some(RADIUS_MM))
    };
    for head in ["angle,radius", "angle,radius mm", "angle,radial", "angle,radius [um]"] {
        let message = read(head).unwrap_err().to_string();
        assert!(
            message.contains("`radius deviation`, `radial deviation`; not a radius alone"),
            "{head}: {message}"
        );
    }
    for (head, um) in [
        ("angle,deviation mm", 2.0),
        ("angle,radius deviation mm", 2.0),
        ("angle,Radial Deviation [mm]", 2.0),
        ("angle,radius_deviation", 0.002),
        ("angle,radius deviation,radius mm", 0.002),
    ] {
        assert_eq!(read(head).unwrap().points[7].deviation_um, um, "{head}");
    }
}

/// If an arc contains no reversal of an axis, the spike of this axis is unknown. All other signatures are found.
#[test]
fn spikes_outside_an_arc_are_not_estimated() {
    let machine = Machine { squareness: 40.0, backlash: [3.0, 2.0], ..Machine::default() };
    // The first arc is from −20° to 200°; the second is from 100° to 350° and contains only the reversals at 180° and
    // 270°.
    for ([from, to], passed) in
        [([-20.0, 200.0], [true, true, true, false]), ([100.0, 350.0], [false, false, true, true])]
    {
        let mut text = String::from("x,y,direction\n");
        for sense in Sense::BOTH {
            // No point is exactly at a reversal of an axis.
            let steps = (0..441).map(|step| (f64::from(step) + 0.3) / 441.0);
            for share in steps {
                let share = if sense.sign() > 0.0 { share } else { 1.0 - share };
                let degrees: f64 = from + share * (to - from);
                let [x, y] = machine.position(degrees.to_radians(), sense);
                let word = if sense.sign() > 0.0 { "ccw" } else { "cw" };
                writeln!(text, "{x:.6},{y:.6},{word}").expect("a string");
            }
        }
        let trace = parse_trace(text.as_bytes(), "arc.csv", CircularPlane::Xy, Some(RADIUS_MM));
        let signatures = circular_signatures(&trace.expect("a trace")).expect("signatures");
        assert_eq!(signatures.spikes_um.map(|spike| spike.is_some()), passed);
        for spike in signatures.spikes_um.into_iter().flatten() {
            near(spike, 0.0, 0.1);
        }
        for (kind, size) in [
            (SignatureKind::Squareness, 40.0),
            (SignatureKind::BacklashFirst, 3.0),
            (SignatureKind::BacklashSecond, 2.0),
        ] {
            near(found(&signatures, kind).0, size, 1.0);
        }
        for signature in &signatures.ranked {
            assert!(
                signature.uncertainty < 5.0,
                "{:?} ± {}",
                signature.kind,
                signature.uncertainty
            );
        }
    }
}
