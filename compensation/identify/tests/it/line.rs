//! Lines of sight: offset and slope, and unknowns that a straight line with rounded coordinates leaves undetermined.

use crate::lab::{Lab, Noise, csv, tip, value};

const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 400.0]
axes.Z.travel = [-500.0, 0.0]
tool.gauge = [0.0, 0.0, 0.0]
tool.length = 120.0
";

/// Readings of 10 µm and 20 µm/m from the set-up or from the machine: every reading contains the offset and the slope.
#[test]
fn readings_contain_offset_and_slope() {
    let lab = Lab::new(MACHINE);
    let rows = (0..=20).map(|k| {
        let x = 30.0 * f64::from(k);
        [x, 100.0, -200.0, 10.0 + 0.02 * x]
    });
    lab.write("l.csv", &csv("X,Y,Z,deviation_um", rows));
    let found = |more: &str, unknown: &str| {
        lab.identify(&format!(
            "folds = 0\nunknown = [{unknown}]\n[[observation]]\nkind = \"line\"\nfile = \"l.csv\"\ndirection = [1, 0, 0]\n{more}"
        ))
        .expect("identified")
    };
    let exx = "{ error = \"EXX\", legendre = 2 }";
    for (more, constant, slope) in [
        ("", 16.0, 6.0),
        ("offset = 10.0\n", 6.0, 6.0),
        ("slope = 20.0\n", 10.0, 0.0),
        ("offset = 10.0\nslope = 20.0\n", 0.0, 0.0),
    ] {
        let found = found(more, exx);
        for (name, expected) in [("EXX constant", constant), ("EXX legendre 1", slope)] {
            let (value, _) = value(&found, name);
            assert!((value - expected).abs() < 1e-3, "{more}{name}: {value}");
        }
    }
    let unknown = found("offset = \"unknown\"\nslope = \"unknown\"\n", "\"EC0Y\"");
    for (name, expected) in [("l.csv:offset", 10.0), ("l.csv:slope", 20.0)] {
        let (value, _) = value(&unknown, name);
        assert!((value - expected).abs() < 1e-3, "{name}: {value}");
    }
}

/// Readings along a line of sight do not determine a rotation of the workpiece about it, also with coordinates rounded
/// to 10 µm.
#[test]
fn rounded_coordinates_determine_nothing() {
    let truth = "[errors]\nEC0Y = 30.0\nEXX = { poly = [0.0, 0.02] }\nEYX = { poly = [9.0, -0.06, 0.0001] }\nEBZ = { poly = [0.0, 0.05] }\n";
    let truth =
        volcomp_model::Machine::parse(&format!("{MACHINE}{truth}"), "truth").expect("a machine");
    let ideal = volcomp_model::Machine::parse(MACHINE, "ideal").expect("a machine");
    let lab = Lab::new(MACHINE);
    let places = |at: [f64; 3]| {
        use volcomp_vocabulary::AxisName::{X, Y, Z};
        [(X, at[0]), (Y, at[1]), (Z, at[2])]
    };
    let mut random = Noise::new(5);
    let tracker = (0..80).map(|_| {
        let at =
            [random.between(0.0, 600.0), random.between(0.0, 400.0), random.between(-500.0, 0.0)];
        let seen = tip(&truth, &places(at), [0.0; 3]);
        let [x, y, z] = [seen.x, seen.y, seen.z].map(|q| q + random.normal(0.003));
        [at[0], at[1], at[2], x, y, z]
    });
    lab.write("tracker.csv", &csv("X,Y,Z,x,y,z", tracker));
    let names = [
        "EXX", "EYX", "EZX", "EAX", "EBX", "ECX", "EXY", "EYY", "EZY", "EAY", "EBY", "ECY", "EXZ",
        "EYZ", "EZZ", "EAZ", "EBZ", "ECZ",
    ];
    let curves: Vec<String> =
        names.map(|name| format!("{{ error = \"{name}\", legendre = 2 }}")).to_vec();
    let ranks: Vec<(usize, (f64, f64))> = [20, 19]
        .into_iter()
        .map(|steps| {
            let direction = unit([600.0, 400.0, 500.0]);
            let line = (0..=steps).map(|k| {
                let share = f64::from(k) / f64::from(steps);
                let rounded = |q: f64| (q * 100.0).round() / 100.0;
                let at = [600.0 * share, 400.0 * share, 500.0 * share - 500.0].map(rounded);
                let off = tip(&truth, &places(at), [0.0; 3]) - tip(&ideal, &places(at), [0.0; 3]);
                let along = direction[0] * off.x + direction[1] * off.y + direction[2] * off.z;
                [at[0], at[1], at[2], 1e3 * along]
            });
            lab.write("line.csv", &csv("X,Y,Z,deviation_um", line));
            let found = lab
                .identify(&format!(
                    "folds = 0\nunknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", {}]\n[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nframe = \"unknown\"\nuncertainty_um = 3.0\n[[observation]]\nkind = \"line\"\nfile = \"line.csv\"\nuncertainty_um = 0.5\ndirection = [6, 4, 5]\noffset = \"unknown\"\n",
                    curves.join(", ")
                ))
                .expect("identified");
            (found.rank, value(&found, "EC0Y"))
        })
        .collect();
    // With 21 targets all coordinates are exact, with 20 targets all are rounded.
    let [(exact, (ec0y, uncertainty)), (rounded, (same, _))] = ranks[..] else {
        panic!("{ranks:?}")
    };
    assert_eq!(exact, rounded);
    assert!(uncertainty < 40.0, "{ranks:?}");
    assert!((ec0y - 30.0).abs() < 3.0 * uncertainty && (ec0y - same).abs() < 1.0, "{ranks:?}");
}

fn unit(of: [f64; 3]) -> [f64; 3] {
    let length = of.iter().map(|x| x * x).sum::<f64>().sqrt();
    of.map(|x| x / length)
}

/// A laser along or across its rows measures positioning or straightness. A laser along another diagonal than its rows
/// is a mistake and gives a note with the angle.
#[test]
fn a_line_of_sight_that_is_oblique_to_its_rows_is_noted() {
    let lab = Lab::new(MACHINE);
    let text = csv(
        "X,Y,Z,deviation_um",
        (0..=10).map(|k| {
            let share = f64::from(k) / 10.0;
            [600.0 * share, 400.0 * share, -200.0, share]
        }),
    );
    lab.write("l.csv", &text);
    let notes = |direction: &str| {
        let file = format!(
            "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"line\"\nfile = \"l.csv\"\ndirection = {direction}\n"
        );
        let notes = lab.read(&file).expect("read").notes;
        notes.into_iter().filter(|note| note.contains("the rows run along")).collect::<Vec<_>>()
    };
    for fine in ["[3, 2, 0]", "[-3, -2, 0]", "[3, 2.05, 0]", "[-2, 3, 0]", "[0, 0, 1]"] {
        assert!(notes(fine).is_empty(), "{fine}");
    }
    // The angle between the rows and X is atan(2/3) = 33.7°. The angle to the other diagonal is twice as large.
    for (direction, angle) in [("[1, 0, 0]", "33.7"), ("[3, -2, 0]", "67.4"), ("[1, 1, 0]", "11.3")]
    {
        let found = notes(direction);
        let expected = format!(
            "o.toml:7: observation[0].direction: the rows run along [0.832, 0.555, 0.000] in workpiece axes, {angle} deg from this direction"
        );
        assert!(found.len() == 1 && found[0].contains(&expected), "{found:?}");
    }
    // Rows that are not on a line are not checked.
    lab.write("l.csv", &(text + "300,0,-200,1\n"));
    assert!(notes("[1, 0, 0]").is_empty());
}
