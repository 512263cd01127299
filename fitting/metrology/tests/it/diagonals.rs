//! Tests of ISO 230-6 on diagonals of a machine with known errors.

use volcomp_metrology::{Diagonal, Direction, Measurement, Reading, evaluate_diagonals};

use crate::samples::near;

const EDGES: [f64; 3] = [800.0, 600.0, 500.0];
const RUNS: u32 = 2;

/// Errors of a machine: squareness errors (µrad), scale error (µm/m) and reversal value of X (µm).
struct Known {
    ec0y: f64,
    ea0z: f64,
    eb0z: f64,
    scale: f64,
    backlash_x: f64,
}

impl Known {
    fn measure(&self, name: &str, targets: usize) -> (Diagonal, Measurement) {
        let diagonal = Diagonal::named(name).unwrap();
        let signs = diagonal.signs().map(f64::from);
        let lengths: [f64; 3] = std::array::from_fn(|k| EDGES[k] * signs[k].abs());
        let length = lengths.iter().map(|l| l * l).sum::<f64>().sqrt();
        let unit: [f64; 3] = std::array::from_fn(|k| signs[k] * lengths[k] / length);
        // The start of each diagonal is at the ends of travel from which the axes move away.
        let start: [f64; 3] = std::array::from_fn(|k| if signs[k] < 0.0 { EDGES[k] } else { 0.0 });
        let mut readings = Vec::new();
        for run in 1..=RUNS {
            for direction in Direction::BOTH {
                for k in 0..targets {
                    let target = length * k as f64 / (targets - 1) as f64;
                    let [x, y, z]: [f64; 3] = std::array::from_fn(|k| start[k] + unit[k] * target);
                    let way = match direction {
                        Direction::Positive => 1.0,
                        Direction::Negative => -1.0,
                    };
                    let moved = [
                        1e-3 * (-self.ec0y * y + self.eb0z * z + self.scale * x)
                            + 0.5 * self.backlash_x * way * signs[0],
                        1e-3 * (-self.ea0z * z + self.scale * y),
                        1e-3 * self.scale * z,
                    ];
                    let along: f64 = moved.iter().zip(unit).map(|(m, u)| m * u).sum();
                    readings.push(Reading { target, run, direction, deviation: along });
                }
            }
        }
        let name = format!("{name}.csv");
        (diagonal, Measurement { name, readings, ..Measurement::default() })
    }
}

const KNOWN: Known = Known { ec0y: 21.0, ea0z: -13.0, eb0z: 8.0, scale: 4.0, backlash_x: 3.0 };

fn refused(measured: &[(Diagonal, Measurement)], edges: Option<[f64; 3]>) -> String {
    let measured: Vec<(Diagonal, &Measurement)> = measured.iter().map(|(d, m)| (*d, m)).collect();
    evaluate_diagonals(&measured, edges).unwrap_err().to_string()
}

#[test]
fn body_diagonals_give_back_squareness_scale_and_reversal() {
    let measured = ["PPN", "PPP", "PNP", "NPP"].map(|name| KNOWN.measure(name, 11));
    let measured: Vec<(Diagonal, &Measurement)> = measured.iter().map(|(d, m)| (*d, m)).collect();
    let found = evaluate_diagonals(&measured, Some(EDGES)).unwrap();
    let names: Vec<&str> = found.diagonals.iter().map(|m| m.diagonal.name()).collect();
    assert_eq!(names, ["PPP", "NPP", "PNP", "PPN"]);
    let squareness: Vec<_> =
        found.squareness.iter().map(|s| (s.error.to_string(), s.urad)).collect();
    for ((error, urad), (name, expected)) in
        squareness.into_iter().zip([("EC0Y", 21.0), ("EA0Z", -13.0), ("EB0Z", 8.0)])
    {
        assert_eq!(error, name);
        near(urad, expected, 1e-9);
    }
    near(found.scale_um_per_m, 4.0, 1e-9);
    // The reversal value along the diagonal is that of X times the direction cosine of X.
    let length = EDGES.iter().map(|e| e * e).sum::<f64>().sqrt();
    near(found.b_d_um.unwrap(), 3.0 * 800.0 / length, 1e-9);
    assert!(found.lacking.is_empty() && found.spread_um > 10.0);
    // On straight lines, E of each diagonal is its growth plus the reversal value.
    for m in &found.diagonals {
        near(m.result.e.unwrap(), m.growth_um.abs() + found.b_d_um.unwrap(), 1e-9);
        near(m.result.e_forward.unwrap(), m.growth_um.abs(), 1e-9);
    }
    let largest = found.diagonals.iter().map(|m| m.result.e.unwrap());
    near(found.e_d_um.unwrap(), largest.fold(0.0, f64::max), 0.0);
}

#[test]
fn face_diagonals_give_back_the_squareness_of_their_plane() {
    for (names, error, expected) in [
        (["PP0", "NP0"], "EC0Y", 21.0),
        (["P0P", "N0P"], "EB0Z", 8.0),
        (["0PP", "0NP"], "EA0Z", -13.0),
    ] {
        let measured = names.map(|name| KNOWN.measure(name, 6));
        let measured: Vec<(Diagonal, &Measurement)> =
            measured.iter().map(|(d, m)| (*d, m)).collect();
        let found = evaluate_diagonals(&measured, Some(EDGES)).unwrap();
        assert_eq!(found.squareness.len(), 1);
        assert_eq!(found.squareness[0].error.to_string(), error);
        near(found.squareness[0].urad, expected, 1e-9);
    }
}

#[test]
fn missing_diagonals_are_listed() {
    let one = KNOWN.measure("PNP", 5);
    let found = evaluate_diagonals(&[(one.0, &one.1)], None).unwrap();
    let lacking: Vec<&str> = found.lacking.iter().map(|d| d.name()).collect();
    assert_eq!(lacking, ["PPP", "NPP", "PPN"]);
    assert_eq!((found.spread_um, found.squareness.len()), (0.0, 0));
}

#[test]
fn names_of_diagonals() {
    assert_eq!(Diagonal::named(" npp "), Diagonal::named("NPP"));
    assert_eq!(Diagonal::named("NNN"), None);
    assert_eq!(Diagonal::in_text("body diagonal PPN"), Diagonal::named("PPN"));
    assert_eq!(Diagonal::in_text("run-ppp.csv"), Diagonal::named("PPP"));
    assert_eq!(Diagonal::in_text("PPP and NPP"), None);
}

#[test]
fn contradictions_are_refused() {
    let m = |name: &str| KNOWN.measure(name, 5);
    let mut angles = m("PPP");
    angles.1.unit = Some(volcomp_metrology::DeviationUnit::Urad);
    let mut longer = m("NPP");
    longer.1.readings.iter_mut().for_each(|r| r.target *= 1.1);
    let messages = [
        refused(&[], None),
        refused(&[m("PPP"), m("PPP")], None),
        refused(&[m("PPP"), m("PP0")], None),
        refused(&[m("PPP"), longer], None),
        refused(&[angles], None),
        refused(&[m("PPP")], Some([800.0, 600.0, 700.0])),
        refused(&[m("PPP")], Some([800.0, 0.0, 500.0])),
        refused(&[m("PPP")], Some([f64::NAN, 600.0, 500.0])),
    ];
    insta::assert_snapshot!(messages.join("\n"));
}
