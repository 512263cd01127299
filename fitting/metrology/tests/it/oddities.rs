//! What is odd about a straightness: not the line along which the optics were set up.

use std::fmt::Write as _;

use volcomp_metrology::{Measurement, Quantity, oddities, parse_csv};

/// A parabola of so many µm at its middle about a line of 5 mm: the optics.
fn straightness(middle_um: f64) -> Measurement {
    let mut text = String::from("target,deviation_um\n");
    for step in 0..=10 {
        let share = f64::from(step) / 10.0;
        let value = 5000.0 * share + 4.0 * middle_um * share * (1.0 - share);
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{},{value}", 100 * step);
    }
    let mut measurement = parse_csv(text.as_bytes(), "exy.csv").expect("readings");
    measurement.quantity = Some(Quantity::Straightness);
    measurement
}

#[test]
fn a_straightness_is_judged_without_the_line_of_its_optics() {
    let said = |middle_um: f64| oddities(&straightness(middle_um)).join("\n");
    assert_eq!(said(6.0), "");
    // In mm: 6 nm from the line.
    assert!(
        said(0.006).contains("every deviation is below 0.1 µm"),
        "{}",
        said(0.006)
    );
    // The middle and the ends of a parabola are up to two thirds of its height from its line.
    let told = said(6000.0);
    assert!(
        told.contains("are large for a machine tool") && !told.contains("5000"),
        "{told}"
    );
    // The same readings as a positioning are 5 mm in size.
    let positioning = Measurement {
        quantity: Some(Quantity::Positioning),
        ..straightness(6.0)
    };
    assert!(oddities(&positioning).join("\n").contains("up to 5000 µm"));
}
