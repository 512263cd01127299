use std::collections::BTreeMap;

use volcomp_curve::{BSpline, Curve, Table};

type Rows = BTreeMap<(&'static str, &'static str), Vec<Vec<f64>>>;

fn golden() -> Rows {
    let mut rows = Rows::new();
    for line in include_str!("../reference/scipy.csv").lines().filter(|l| !l.starts_with('#')) {
        let mut parts = line.split(',');
        let key = (parts.next().unwrap(), parts.next().unwrap());
        rows.entry(key).or_default().push(parts.map(|p| p.parse().unwrap()).collect());
    }
    rows
}

fn compare(curve: &Curve, expected: &[Vec<f64>], case: &str) {
    for row in expected {
        let [x, value, slope] = row[..] else { panic!("{case}: {row:?}") };
        for (found, expected) in [(curve.value(x), value), (curve.derivative(x), slope)] {
            let difference = (found - expected).abs();
            assert!(
                difference < 1e-11 * (1.0 + expected.abs()),
                "{case} at {x}: {found} {expected}"
            );
        }
    }
}

#[test]
fn monotone_cubic() {
    let rows = golden();
    let cases: Vec<_> = rows.iter().filter(|((kind, _), _)| *kind == "pchip").collect();
    assert_eq!(cases.len(), 5);
    for ((_, case), expected) in cases {
        let nodes = rows[&("node", *case)].iter().map(|n| [n[0], n[1]]).collect();
        compare(&Table::cubic(nodes).unwrap().into(), expected, case);
    }
}

#[test]
fn bspline_of_every_degree() {
    let rows = golden();
    let cases: Vec<_> = rows.iter().filter(|((kind, _), _)| *kind == "bspline").collect();
    assert_eq!(cases.len(), 10);
    for ((_, case), expected) in cases {
        let degree = case[case.len() - 1..].parse().unwrap();
        let column = |kind| rows[&(kind, *case)].iter().map(|r| r[0]).collect::<Vec<_>>();
        let spline = BSpline::new(column("knot"), column("coefficient"), degree).unwrap();
        compare(&spline.into(), expected, case);
    }
}
