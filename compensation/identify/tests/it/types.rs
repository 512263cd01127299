//! Location errors that each measurement determines on the twelve five-axis types, compared with the table in the book's chapter "Which
//! measurement finds which error".

use std::{fmt::Write as _, fs, path::Path};

use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::AxisName;

use crate::lab::{Lab, Noise, tip};

const LINEAR: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const ROTARY: [AxisName; 2] = [AxisName::C, AxisName::A];
const TOOLS: [(&str, f64); 2] = [("short", -100.0), ("long", -260.0)];
/// All location errors, relative to the reference axes X and Y.
const UNKNOWN: &str = "unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", \"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\", \"EY0A\", \"EZ0A\", \"EB0A\", \"EC0A\"]\nfolds = 0\n";
const ERRORS: usize = 11;

/// Kinds of measurement: column header, and content of the observation file.
const MEASUREMENTS: [(&str, &[Part]); 7] = [
    ("diagonals", &[Part::Diagonals]),
    ("ball rows", &[Part::BallRows]),
    ("one sphere, one probe", &[Part::Sphere { tools: 1 }]),
    ("one sphere, two probes", &[Part::Sphere { tools: 2 }]),
    ("ballbar", &[Part::Ballbar]),
    ("tracker", &[Part::Tracker]),
    ("tracker and one sphere, one probe", &[Part::Tracker, Part::Sphere { tools: 1 }]),
];

#[derive(Clone, Copy)]
enum Part {
    /// The four body diagonals and two diagonals of each face; rotary axes at 0.
    Diagonals,
    /// Rows of balls along X, Y and Z and across each plane, read along and to both sides, at unknown positions; rotary axes at 0.
    BallRows,
    /// A touch probe on a sphere on the table, with unknown centre, at many angles.
    Sphere { tools: usize },
    /// A ballbar of unknown length from an unknown point on the table to the tip, at many angles.
    Ballbar,
    /// A tracker in an unknown frame, with an unknown target on two tools, at arbitrary poses.
    Tracker,
}

fn machine_text(translational: usize, rotary: usize) -> String {
    let mut text = format!(
        "[type]\ntranslational = {translational}\nrotary = {rotary}\nrotary_axes = [\"C\", \"A\"]\n\
         [axes.X]\ntravel = [-400.0, 400.0]\n[axes.Y]\ntravel = [-300.0, 300.0]\n[axes.Z]\ntravel = [-250.0, 250.0]\n\
         [axes.C]\ntravel = [-180.0, 180.0]\npoint = [20.0, -10.0, 0.0]\n\
         [axes.A]\ntravel = [-100.0, 100.0]\npoint = [0.0, 15.0, 40.0]\n\
         [tool]\ntip = [0.0, 0.0, -100.0]\n"
    );
    for (name, tip) in TOOLS {
        let _ = writeln!(text, "[tools.{name}]\ntip = [0.0, 0.0, {tip:.1}]");
    }
    text
}

/// Readings of a machine without errors: the errors of the machine do not affect which errors are determined.
struct Readings<'m> {
    machine: &'m Machine,
    noise: Noise,
}

impl Readings<'_> {
    fn between(&mut self, range: [f64; 2]) -> f64 {
        self.noise.between(range[0], range[1])
    }

    fn angles(&mut self) -> [f64; 2] {
        [self.between([-170.0, 170.0]), self.between([-90.0, 90.0])]
    }

    fn linear(&mut self) -> [f64; 3] {
        [[-300.0, 300.0], [-250.0, 250.0], [-200.0, 200.0]].map(|range| self.between(range))
    }

    /// The tip at a pose, with a tool that is longer than the tool of the machine by `beyond`, mm.
    fn tip(&self, linear: [f64; 3], angles: [f64; 2], beyond: f64) -> Vector3<f64> {
        let at: Vec<_> =
            LINEAR.into_iter().zip(linear).chain(ROTARY.into_iter().zip(angles)).collect();
        tip(self.machine, &at, [0.0, 0.0, beyond])
    }

    /// Linear axis coordinates with the tip at a workpiece point; the tip is a linear function of these coordinates.
    fn linear_at(&self, point: Vector3<f64>, angles: [f64; 2], beyond: f64) -> [f64; 3] {
        let zero = self.tip([0.0; 3], angles, beyond);
        let along = |axis: usize| {
            let mut linear = [0.0; 3];
            linear[axis] = 1.0;
            self.tip(linear, angles, beyond) - zero
        };
        let columns = Matrix3::from_columns(&[along(0), along(1), along(2)]);
        let inverse = columns.try_inverse().expect("three directions");
        (inverse * (point - zero)).into()
    }

    /// Writes a row file, and returns its table for the observation file.
    fn of(&mut self, part: Part, lab: &Lab) -> String {
        match part {
            Part::Diagonals => Self::diagonals(lab),
            Part::BallRows => Self::ball_rows(lab),
            Part::Sphere { tools } => self.sphere(lab, tools),
            Part::Ballbar => self.ballbar(lab),
            Part::Tracker => self.tracker(lab),
        }
    }

    fn diagonals(lab: &Lab) -> String {
        let mut tables = String::new();
        let signs = [
            [1, 1, 1],
            [-1, 1, 1],
            [1, -1, 1],
            [1, 1, -1],
            [1, 1, 0],
            [-1, 1, 0],
            [0, 1, 1],
            [0, -1, 1],
            [1, 0, 1],
            [1, 0, -1],
        ];
        for (place, sign) in signs.into_iter().enumerate() {
            let [x, y, z] = [400 * sign[0], 300 * sign[1], 250 * sign[2]];
            let mut file = String::from("X,Y,Z,deviation_um\n");
            for step in -2..=2 {
                let at = [x, y, z].map(|end| f64::from(end) * f64::from(step) / 2.0);
                let _ = writeln!(file, "{},{},{},0", at[0], at[1], at[2]);
            }
            lab.write(&format!("d{place}.csv"), &file);
            let _ = writeln!(
                tables,
                "[[observation]]\nkind = \"line\"\nfile = \"d{place}.csv\"\ndirection = [{x}, {y}, {z}]\noffset = \"unknown\""
            );
        }
        tables
    }

    fn ball_rows(lab: &Lab) -> String {
        let distances = [0.0, 90.0, 180.0, 270.0, 360.0];
        let mut balls = String::from("ball,distance_mm\n");
        for (ball, distance) in distances.iter().enumerate() {
            let _ = writeln!(balls, "{ball},{distance}");
        }
        lab.write("balls.csv", &balls);
        let mut tables = String::new();
        for (place, (along, side)) in [
            ([1, 0, 0], [0, 1, 0]),
            ([0, 1, 0], [0, 0, 1]),
            ([0, 0, 1], [1, 0, 0]),
            ([1, 1, 0], [0, 0, 1]),
            ([0, 1, 1], [1, 0, 0]),
            ([1, 0, 1], [0, 1, 0]),
        ]
        .into_iter()
        .enumerate()
        {
            let along = Vector3::from(along.map(f64::from)).normalize();
            let mut file = String::from("X,Y,Z,ball,along_um,side1_um,side2_um\n");
            for (ball, distance) in distances.into_iter().enumerate() {
                let at = along * (distance - 180.0);
                let _ = writeln!(file, "{:.9},{:.9},{:.9},{ball},0,0,0", at.x, at.y, at.z);
            }
            lab.write(&format!("row{place}.csv"), &file);
            let _ = writeln!(
                tables,
                "[[observation]]\nkind = \"ball-row\"\nfile = \"row{place}.csv\"\nrow = \"balls.csv\"\nside1 = {side:?}"
            );
        }
        tables
    }

    fn sphere(&mut self, lab: &Lab, tools: usize) -> String {
        let centre = Vector3::new(150.0, 60.0, -180.0);
        let mut file = String::from("X,Y,Z,C,A,sphere,tool\n");
        for (tool, length) in TOOLS.into_iter().take(tools) {
            for _ in 0..12 {
                let angles = self.angles();
                let [x, y, z] = self.linear_at(centre, angles, length - TOOLS[0].1);
                let [c, a] = angles;
                let _ = writeln!(file, "{x:.9},{y:.9},{z:.9},{c:.9},{a:.9},table,{tool}");
            }
        }
        lab.write("sphere.csv", &file);
        "[[observation]]\nkind = \"sphere\"\nfile = \"sphere.csv\"\n".to_owned()
    }

    fn ballbar(&mut self, lab: &Lab) -> String {
        let point = Vector3::new(40.0, -30.0, -150.0);
        let mut file = String::from("X,Y,Z,C,A,tool,length_mm\n");
        for _ in 0..60 {
            let angles = self.angles();
            let way: Vector3<f64> = Vector3::from([0.0; 3].map(|_: f64| self.between([-1.0, 1.0])));
            let [x, y, z] = self.linear_at(point + way.normalize() * 150.0, angles, 0.0);
            let [c, a] = angles;
            let _ = writeln!(file, "{x:.9},{y:.9},{z:.9},{c:.9},{a:.9},short,150");
        }
        lab.write("ballbar.csv", &file);
        "[[observation]]\nkind = \"distance\"\nfile = \"ballbar.csv\"\npoint = \"unknown\"\ndead_length = \"unknown\"\n".to_owned()
    }

    fn tracker(&mut self, lab: &Lab) -> String {
        let mut file = String::from("X,Y,Z,C,A,tool,x,y,z\n");
        for (tool, length) in TOOLS {
            for _ in 0..30 {
                let (linear, angles) = (self.linear(), self.angles());
                let seen = self.tip(linear, angles, length - TOOLS[0].1);
                let [x, y, z] = linear;
                let [c, a] = angles;
                let _ = writeln!(
                    file,
                    "{x:.9},{y:.9},{z:.9},{c:.9},{a:.9},{tool},{:.9},{:.9},{:.9}",
                    seen.x, seen.y, seen.z
                );
            }
        }
        lab.write("tracker.csv", &file);
        "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nframe = \"unknown\"\ntarget = { short = \"unknown\", long = \"unknown\" }\n".to_owned()
    }
}

/// Number of determined location errors, and names of those fixed at zero.
fn found(translational: usize, rotary: usize, parts: &[Part]) -> (usize, Vec<String>) {
    let lab = Lab::new(&machine_text(translational, rotary));
    let machine = lab.machine();
    let mut readings = Readings { machine: &machine, noise: Noise::new(7) };
    let tables: String = parts.iter().map(|part| readings.of(*part, &lab)).collect();
    let identified = lab.identify(&format!("{UNKNOWN}{tables}")).expect("identified");
    let is_error = |name: &str| UNKNOWN.contains(&format!("\"{name}\""));
    let parameters = identified.parameters.iter();
    let errors = parameters.filter(|parameter| is_error(&parameter.name));
    let (determined, left): (Vec<_>, Vec<_>) = errors.partition(|p| p.determined);
    (determined.len(), left.into_iter().map(|p| p.name.clone()).collect())
}

fn table() -> String {
    let mut text = String::from("| type |");
    for (head, _) in MEASUREMENTS {
        let _ = write!(text, " {head} |");
    }
    text.push_str("\n| --- |");
    text.push_str(&" --- |".repeat(MEASUREMENTS.len()));
    text.push('\n');
    for rotary in 1..=3 {
        for translational in 0..=3 {
            let machine = Lab::new(&machine_text(translational, rotary)).machine();
            let _ = write!(text, "| `{}` |", machine.chain().structure());
            for (_, parts) in MEASUREMENTS {
                let (count, left) = found(translational, rotary, parts);
                let cell = match (count, left.len()) {
                    (ERRORS, _) => "all".to_owned(),
                    (_, few) if few <= 4 => format!("{count}; not {}", left.join(" ")),
                    _ => format!("{count}"),
                };
                let _ = write!(text, " {cell} |");
            }
            text.push('\n');
        }
    }
    text
}

#[test]
fn the_table_of_the_book_matches_the_equations() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/which-measurement.md");
    let text = fs::read_to_string(&page).expect("the page");
    let (marks, found) = (["<!-- types -->\n", "<!-- end of types -->"], table());
    let begin = text.find(marks[0]).expect("the mark") + marks[0].len();
    let end = text.find(marks[1]).expect("the other mark");
    if std::env::var_os("VOLCOMP_WRITE").is_some() {
        let whole = format!("{}{found}{}", &text[..begin], &text[end..]);
        fs::write(&page, whole).expect("written");
        return;
    }
    assert_eq!(&text[begin..end], found, "write it anew with VOLCOMP_WRITE=1");
}
