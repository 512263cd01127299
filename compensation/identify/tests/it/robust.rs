//! Robust fits end, also where many curves follow few poses and one row in seven is a slip.

use crate::lab::{Lab, Noise, csv};

const MACHINE: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 600.0]
axes.Z.travel = [0.0, 600.0]
";

#[test]
fn a_robust_fit_of_many_curves_ends() {
    let lab = Lab::new(MACHINE);
    let curves = ["EXX", "EYX", "EYY", "EZY", "EZZ", "EXZ"]
        .map(|error| format!("{{ error = \"{error}\", bspline = 10 }}"));
    let text = format!(
        "robust = true\nfolds = 0\nunknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", {}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\nuncertainty_um = 2.0\n",
        curves.join(", ")
    );
    for seed in 0..12 {
        let mut noise = Noise::new(seed);
        let rows = (0..60).map(|_| {
            let at = [(); 3].map(|()| noise.between(0.0, 600.0));
            // EC0Y = 20 µrad.
            let tip = [at[0] - 20e-6 * at[1], at[1], at[2]];
            let is_slip = noise.between(0.0, 1.0) < 0.15;
            let [x, y, z] = tip.map(|q| q + noise.normal(if is_slip { 0.05 } else { 0.002 }));
            [at[0], at[1], at[2], x, y, z]
        });
        lab.write("t.csv", &csv("X,Y,Z,x,y,z", rows));
        let found = lab.identify(&text);
        let found = found.unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert!(found.variance.is_finite());
    }
}
