//! An identification, compared with a solution of the same problem by SciPy with an independent model in NumPy.

use std::{collections::BTreeMap, process::Command};

use volcomp_identify::{Observations, identify};
use volcomp_test_support::root;

/// Names of the unknowns in `tests/reference/exact.py`.
const NAMES: [&str; 13] = [
    "EC0Y",
    "EA0Z",
    "EB0Z",
    "EA0C",
    "EB0C",
    "EXX legendre 1",
    "EYY legendre 1",
    "EZZ legendre 1",
    "EYX legendre 2",
    "EYX legendre 3",
    "ECC constant",
    "ECC cos 1",
    "ECC sin 1",
];

#[test]
fn values_and_covariance_are_those_of_scipy() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    let script = root().join("compensation/identify/tests/reference/exact.py");
    let data = root().join("examples/identification");
    let output =
        Command::new(python).arg(script).arg("fit").arg(&data).output().expect("Python is there");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let lines: Vec<Vec<f64>> = text
        .lines()
        .map(|line| line.split_whitespace().map(|n| n.parse().expect("a number")).collect())
        .collect();
    let (values, rows) = lines.split_first().expect("values and covariance");

    let folder = tempfile::tempdir().expect("a folder");
    for name in ["machine.toml", "tracker.csv"] {
        std::fs::copy(data.join(name), folder.path().join(name)).expect("copied");
    }
    let path = folder.path().join("o.toml");
    std::fs::write(
        &path,
        "machine = \"machine.toml\"\nfolds = 0
unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", \"EA0C\", \"EB0C\",
{ error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 1 }, { error = \"EZZ\", legendre = 1 },
{ error = \"EYX\", legendre = 3 }, { error = \"ECC\", fourier = 1 }]
[[observation]]
kind = \"points\"
file = \"tracker.csv\"
target = { long = \"unknown\" }
uncertainty_um = 5.0
",
    )
    .expect("written");
    let found = identify(&Observations::read(&path).expect("read"), |_, _| {}).expect("found");
    let determined: Vec<&str> =
        found.parameters.iter().filter(|p| p.determined).map(|p| p.name.as_str()).collect();
    let place: BTreeMap<&str, usize> =
        determined.iter().enumerate().map(|(k, n)| (*n, k)).collect();
    let mut largest = [0.0_f64; 2];
    for (k, name) in NAMES.iter().enumerate() {
        let parameter = found.parameters.iter().find(|p| p.name == *name).expect("an unknown");
        let sigma = parameter.uncertainty.expect("determined");
        let difference = (parameter.value - values[k]).abs();
        largest[0] = largest[0].max(difference / sigma);
        assert!(difference < 1e-6 * sigma, "{name}: {} {} ± {sigma}", parameter.value, values[k]);
        for (j, other) in NAMES.iter().enumerate() {
            let ours = found.covariance[(place[name], place[other])];
            let size = (rows[k][k] * rows[j][j]).sqrt();
            largest[1] = largest[1].max((ours - rows[k][j]).abs() / size);
            assert!(
                (ours - rows[k][j]).abs() < 1e-3 * size,
                "{name} {other}: {ours} {}",
                rows[k][j]
            );
        }
    }
    println!(
        "largest differences: values {:.1e} of their uncertainty, covariance {:.1e}",
        largest[0], largest[1]
    );
}
