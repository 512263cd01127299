//! Time to identify about a hundred unknowns from a tracker at 300 poses.

use std::{fmt::Write as _, hint::black_box, path::Path};

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_identify::{Observations, identify};

const POSES: u32 = 300;
const MACHINE: &str = "structure = \"w b X Y Z C B t\"
axes.X.travel = [0.0, 2000.0]
axes.Y.travel = [0.0, 1000.0]
axes.Z.travel = [0.0, 700.0]
axes.C.travel = [-180.0, 180.0]
axes.B.travel = [-90.0, 90.0]
";

fn spread(k: u32, of: f64) -> f64 {
    (f64::from(k) * of).fract()
}

/// Nominal positions of a target 250 mm below the tip, rounded to 10 µm as noise.
fn rows() -> String {
    let mut text = String::from("X,Y,Z,C,B,x,y,z\n");
    for k in 1..=POSES {
        let at = [
            2000.0 * spread(k, 0.618_034),
            1000.0 * spread(k, 0.754_878),
            700.0 * spread(k, 0.569_840),
            360.0 * spread(k, 0.819_173) - 180.0,
            180.0 * spread(k, 0.671_044) - 90.0,
        ];
        let ([sc, cc], [sb, cb]) = (sine_cosine(at[3]), sine_cosine(at[4]));
        let target = [-250.0 * sb * cc, -250.0 * sb * sc, -250.0 * cb];
        for q in at {
            let _ = write!(text, "{q:?},"); // writing to a String cannot fail
        }
        let seen = [0, 1, 2].map(|axis| format!("{:.2}", at[axis] + target[axis]));
        let _ = writeln!(text, "{}", seen.join(","));
    }
    text
}

fn sine_cosine(degrees: f64) -> [f64; 2] {
    let (sin, cos) = degrees.to_radians().sin_cos();
    [sin, cos]
}

fn observations(penalty: &str) -> Option<Observations> {
    let mut unknown = vec![
        "\"EC0Y\", \"EA0Z\", \"EB0Z\", \"EX0C\", \"EA0C\", \"EB0C\", \"EA0B\", \"EC0B\"".to_owned(),
    ];
    for axis in ["X", "Y", "Z"] {
        for component in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            unknown.push(format!("{{ error = \"{component}{axis}\", legendre = 4 }}"));
        }
    }
    let keys = format!(
        "machine = \"machine.toml\"\nfolds = 0\npenalty = \"{penalty}\"\nunknown = [{}]\n[[observation]]\nkind = \"points\"\nfile = \"rows.csv\"\ntarget = \"unknown\"\nuncertainty_um = 5.0\n",
        unknown.join(", ")
    );
    let table = rows();
    let read = |path: &Path| {
        let is_machine = path.ends_with("machine.toml");
        Ok(if is_machine { MACHINE.to_owned() } else { table.clone() })
    };
    Observations::parse(&keys, Path::new("observations.toml"), &read).ok()
}

fn identification(criterion: &mut Criterion) {
    for penalty in ["none", "auto"] {
        let Some(observations) = observations(penalty) else {
            eprintln!("the observations of this bench cannot be read");
            return;
        };
        let found = identify(&observations, |_, _| {});
        let count = found.map(|found| found.parameters.len()).unwrap_or_default();
        let name = format!("300 poses, {count} unknowns, penalty {penalty}");
        criterion.bench_function(&name, |b| {
            b.iter(|| identify(black_box(&observations), |_, _| {}).map(|found| found.rank).ok());
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = identification
}
criterion_main!(benches);
