//! The proposed next pose is a pose that the instrument of the file can measure and has not measured.

use std::fmt::Write;

use volcomp_identify::Identification;
use volcomp_vocabulary::AxisName;

use crate::lab::{Lab, Noise, csv, value};

const THREE_AXES: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [-300.0, 300.0]
axes.Y.travel = [-300.0, 300.0]
axes.Z.travel = [-300.0, 300.0]
";

fn next_at(found: &Identification) -> Vec<f64> {
    let next = found.next.as_ref().expect("a pose");
    next.pose.values().copied().collect()
}

/// Tips at the end of a ballbar of 150 mm about [10, 20, −30] in the XY plane, on a machine with linear axes only.
fn ballbar() -> (String, Vec<[f64; 3]>) {
    let mut noise = Noise::new(3);
    let stood = (0..29).map(|k| {
        let (sin, cos) = (f64::from(k) * 5.0_f64.to_radians()).sin_cos();
        [10.0 + 150.0 * cos, 20.0 + 150.0 * sin, -30.0]
    });
    let rows = (stood.clone()).map(|[x, y, z]| [x, y, z, 150.0 + noise.normal(0.001)]);
    (csv("X,Y,Z,length_mm", rows), stood.collect())
}

const BALLBAR: &str = "folds = 0
unknown = [\"EC0Y\"]
[[observation]]
kind = \"distance\"
file = \"b.csv\"
point = [10.0, 20.0, -30.0]
";

#[test]
fn a_ballbar_on_three_axes_gets_a_new_pose() {
    let lab = Lab::new(THREE_AXES);
    let (text, stood) = ballbar();
    lab.write("b.csv", &text);
    let found = lab.identify(BALLBAR).expect("found");
    let at = next_at(&found);
    let apart = |other: &[f64; 3]| -> f64 {
        let squares = at.iter().zip(other).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>().sqrt()
    };
    assert!((apart(&[10.0, 20.0, -30.0]) - 150.0).abs() < 0.01, "{at:?}");
    assert!(stood.iter().all(|row| apart(row) > 0.01), "{at:?}");
    // The pose is within the reachable arc of 0° to 140°.
    let angle = (at[1] - 20.0).atan2(at[0] - 10.0).to_degrees();
    assert!((-0.1..=140.1).contains(&angle) && (at[2] + 30.0).abs() < 0.01, "{at:?}");
}

/// No pose is proposed if every possible pose was measured: on three axes a sphere can only be probed at the same pose,
/// and a step gauge has no other faces.
#[test]
fn measured_poses_are_not_proposed_again() {
    let lab = Lab::new(THREE_AXES);
    lab.write("s.csv", "X,Y,Z,sphere,dx_um,dy_um,dz_um\n0,0,0,one,1,2,3\n100,0,0,two,1,2,3\n0,100,0,three,2,2,2\n100,0,0,two,2,2,2\n0,0,0,one,1,2,3\n");
    let mut gauge = String::from("pose,X,from,to,length_mm\n");
    for x in [0, 100, 200] {
        let _ = writeln!(gauge, "p{x},{x},,,");
    }
    for x in [100, 200] {
        let _ = writeln!(gauge, ",,p0,p{x},{x}.001");
    }
    lab.write("g.csv", &gauge);
    let found = lab
        .identify(
            "folds = 0
unknown = [{ error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"sphere\"
file = \"s.csv\"
[[observation]]
kind = \"distance\"
file = \"g.csv\"
",
        )
        .expect("found");
    assert_eq!(found.next, None);
}

/// Lines in the XY plane do not determine the squareness of Z to X: the proposed pose improves a parameter that can be determined.
#[test]
fn without_an_informative_pose_the_most_reducing_one_is_proposed() {
    let lab = Lab::new(THREE_AXES);
    let rows = (0..31).map(|k| {
        let at = f64::from(k) * 10.0 - 150.0;
        [at, at, 0.0, 0.02 * at]
    });
    lab.write("d.csv", &csv("X,Y,Z,deviation_um", rows));
    let observed = "folds = 0
unknown = [\"EB0Z\", { error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"line\"
file = \"d.csv\"
direction = [1, 1, 0]
";
    let found = lab.identify(observed).expect("found");
    assert!(value(&found, "EB0Z").1.is_nan(), "{:?}", found.parameters);
    let next = found.next.expect("a pose");
    assert_eq!(next.parameter, "EXX legendre 1");
    assert!(next.improvement.is_some_and(|by| by >= 1.0), "{next:?}");
}

/// The stated improvement by one more row follows from the stated uncertainties, although the residuals are ten times as large.
#[test]
fn the_improvement_follows_from_the_stated_uncertainties() {
    let lab = Lab::new("structure = \"w b X t\"\naxes = { X = { travel = [0, 1000] } }\n");
    let mut noise = Noise::new(9);
    let mut text = String::from("X,deviation_um\n");
    for x in [0.0, 100.0, 200.0, 300.0, 400.0, 500.0] {
        let _ = writeln!(text, "{x},{:?}", noise.normal(10.0));
    }
    text.push_str("1000,5\n");
    lab.write("d.csv", &text);
    let observed = "folds = 0
unknown = [{ error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"line\"
file = \"d.csv\"
direction = [1, 0, 0]
offset = \"unknown\"
";
    let found = lab.identify(observed).expect("found");
    assert!(found.variance > 4.0, "{}", found.variance);
    let next = found.next.expect("a pose");
    assert_eq!(next.parameter, "EXX legendre 1");
    // Slope of a line through these seven targets, and through these and an eighth: σ² of the slope is 1/Σ(x − x̄)².
    let mut places = vec![0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 1000.0];
    let spread = |places: &[f64]| {
        let mean = places.iter().sum::<f64>() / places.len() as f64;
        places.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
    };
    let before = spread(&places);
    places.push(next.pose[&AxisName::X]);
    let expected = (spread(&places) / before).sqrt();
    let stated = next.improvement.expect("determined");
    assert!((stated - expected).abs() < 1e-3, "{stated} {expected}");
}

/// A machine with rotary axes only is identified, and the proposed angle is new, although the machine cannot move its
/// tip to a sphere.
#[test]
fn a_machine_without_linear_axes_is_identified() {
    let lab = Lab::new(
        "structure = \"w C b t\"\naxes = { C = { travel = [-180, 180] } }\ntool = { tip = [100, 0, -50] }\n",
    );
    let mut text = String::from("C,sphere,dx_um,dy_um,dz_um\n");
    for k in 0..12 {
        let c = 0.1 * f64::from(k);
        let _ =
            writeln!(text, "{c},one,{:?},{:?},1", 0.5 * f64::from(k % 3), 0.2 * f64::from(k % 4));
    }
    lab.write("s.csv", &text);
    let observed =
        "folds = 0\nunknown = [\"EX0C\"]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n";
    // Any result is accepted for such a short part of a turn.
    let _ = lab.identify(observed);
    lab.write(
        "b.csv",
        "C,length_mm\n0,100\n30,100\n60,100\n90,100\n120,100\n150,100\n-30,100\n-60,100\n",
    );
    let observed = "folds = 0
unknown = [\"EX0C\"]
[[observation]]
kind = \"distance\"
file = \"b.csv\"
point = [0, 0, -50]
";
    let found = lab.identify(observed).expect("found");
    // All lengths are equal, so the axis passes through the point.
    let own = found.parameters.iter().find(|p| p.name == "EX0C");
    let own = own.expect("an unknown");
    assert!(own.determined && own.value.abs() < 0.1, "{own:?}");
    if let Some(next) = found.next {
        let at = next.pose[&AxisName::C];
        let measured = [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, -30.0, -60.0];
        assert!((-180.0..=180.0).contains(&at) && !measured.contains(&at), "{at}");
    }
}

/// Parameters in µm and µrad are compared by their largest effect. A squareness observed on a small part of the travel
/// moves the tool more elsewhere than curves of hundredths of a µm, so the proposed pose improves EC0Y.
#[test]
fn errors_are_compared_by_their_largest_effect() {
    let lab = Lab::new(THREE_AXES);
    let mut noise = Noise::new(14);
    let rows = (0..40).map(|k| {
        // Most rows are at one end of X, where the modes of EXX are hard to distinguish. Y stays within 60 mm.
        let x = if k < 36 { 250.0 + f64::from(k) } else { -280.0 + 100.0 * f64::from(k - 36) };
        let y = noise.between(-30.0, 30.0);
        let mut n = || noise.normal(0.001);
        [x, y, 0.0, x + n(), y + n(), n()]
    });
    lab.write("t.csv", &csv("X,Y,Z,x,y,z", rows));
    let found = lab
        .identify(
            "folds = 0
unknown = [\"EC0Y\", { error = \"EXX\", legendre = 2 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
frame = [0, 0, 0, 0, 0, 0]
",
        )
        .expect("found");
    // Largest effects in closed form: a squareness over 300 mm of Y; a Legendre polynomial, which is 1 at its ends.
    let effects: Vec<(f64, &str)> = ["EC0Y", "EXX constant", "EXX legendre 1", "EXX legendre 2"]
        .into_iter()
        .map(|name| {
            let lever = if name == "EC0Y" { 0.3 } else { 1.0 };
            (lever * value(&found, name).1, name)
        })
        .collect();
    let largest = effects.iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("four");
    let next = found.next.expect("a pose");
    assert_eq!((largest.1, next.parameter.as_str()), ("EC0Y", "EC0Y"), "{effects:?}");
    let y = next.pose[&AxisName::Y];
    assert!(y.abs() > 200.0, "{next:?}");
}

/// The proposed next pose names one of the tools in the rows; it names no tool if the rows name none.
#[test]
fn the_tool_of_the_next_pose_is_named() {
    let lab = Lab::new(&format!(
        "{THREE_AXES}[tools.short]\ntip = [0, 0, -50]\n[tools.long]\ntip = [0, 0, -150]\n"
    ));
    let mut noise = Noise::new(15);
    let mut rows = |tools: [&str; 2]| {
        let mut text = String::from("tool,X,Y,Z,x,y,z\n");
        for k in 0..30 {
            let at = [0; 3].map(|_| noise.between(-290.0, 290.0));
            let tool = tools[k % 2];
            let length = match tool {
                "short" => 50.0,
                "long" => 150.0,
                _ => 0.0,
            };
            let [x, y, z] = at;
            let [a, b, c] = [x, y, z - length].map(|q| q + noise.normal(0.001));
            let _ = writeln!(text, "{tool},{x:?},{y:?},{z:?},{a:?},{b:?},{c:?}");
        }
        text
    };
    let observed = "folds = 0\nunknown = [\"EC0Y\", { error = \"EBX\", legendre = 1 }]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
    for tools in [["short", "long"], ["long", "long"], ["", ""]] {
        lab.write("t.csv", &rows(tools));
        let next = lab.identify(observed).expect("found").next.expect("a pose");
        let named = next.tool.as_deref().unwrap_or("");
        assert!(tools.contains(&named), "{tools:?} {next:?}");
        if tools[0].is_empty() {
            assert_eq!(next.tool, None);
        }
    }
}

/// For sphere positions on a rotary table, the uncertainties of the line of C (effect at 300 mm) equal the values in
/// the book.
#[test]
fn spheres_far_from_the_axis_and_at_two_heights_are_better_than_poses() {
    let lab = Lab::new(
        "structure = \"w C' b X Y Z t\"
axes.X.travel = [-400.0, 400.0]
axes.Y.travel = [-400.0, 400.0]
axes.Z.travel = [-400.0, 400.0]
axes.C.travel = [-360.0, 360.0]
",
    );
    let largest = |spheres: &[(f64, f64)], poses: u32| {
        let mut noise = Noise::new(16);
        let mut text = String::from("X,Y,Z,C,sphere\n");
        for k in 0..poses {
            let (sphere, c) = (k as usize % spheres.len(), f64::from(k) * 37.0 % 360.0 - 180.0);
            let (radius, height) = spheres[sphere];
            let (sin, cos) = c.to_radians().sin_cos();
            // The table rotates the sphere by −C (ISO 841: the tool moves around it by +C).
            let mut n = || noise.normal(0.0003);
            let (x, y) = (radius * cos + n(), -radius * sin + n());
            let _ = writeln!(text, "{x:?},{y:?},{:?},{c:?},s{sphere}", height + n());
        }
        lab.write("s.csv", &text);
        let found = lab
            .identify("folds = 0\nunknown = [\"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\", \"EC0Y\"]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n")
            .expect("found");
        let of = |name: &str, lever: f64| lever * value(&found, name).1;
        let all =
            [of("EX0C", 1.0), of("EY0C", 1.0), of("EA0C", 0.3), of("EB0C", 0.3), of("EC0Y", 0.3)];
        [all[2].max(all[3]), all[4]]
    };
    let near = largest(&[(60.0, 100.0)], 24);
    let near_more = largest(&[(60.0, 100.0)], 48);
    let far = largest(&[(240.0, 100.0)], 24);
    let two_far = largest(&[(240.0, 20.0), (240.0, 220.0)], 24);
    // Values of the table in the book.
    let stated = [near, near_more, far, two_far];
    let book = [[1.46, 2.06], [1.02, 1.44], [0.36, 0.51], [0.31, 0.51]];
    for (found, expected) in stated.iter().flatten().zip(book.iter().flatten()) {
        assert!((found - expected).abs() < 0.006, "{stated:?}");
    }
}
