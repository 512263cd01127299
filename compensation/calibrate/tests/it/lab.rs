//! A folder with machine file, measurement files and calibration file.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_calibrate::{CalibrateError, Calibration, CalibrationFile, calibrate};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_kinematics::{Pose, Side, actual_pose, vector_from_rotation};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, Direction, ErrorName};

pub(crate) struct Lab(tempfile::TempDir);

impl Lab {
    pub(crate) fn new(machine: &str) -> Self {
        let lab = Self(tempfile::tempdir().expect("a folder"));
        lab.write("machine.toml", machine);
        lab
    }

    pub(crate) fn folder(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.folder().join(name), text).expect("written");
    }

    /// Reads a calibration file that consists of a first line with the name of the machine file, and `text`.
    pub(crate) fn read(&self, text: &str) -> Result<CalibrationFile, CalibrateError> {
        let text = format!("machine = \"machine.toml\"\n{text}");
        self.write("calibration.toml", &text);
        CalibrationFile::read(&self.folder().join("calibration.toml"))
    }

    pub(crate) fn tried(&self, text: &str) -> Result<Calibration, CalibrateError> {
        calibrate(&self.read(text)?, |_, _| {})
    }

    pub(crate) fn calibrated(&self, text: &str) -> Calibration {
        self.tried(text).expect("calibrated")
    }

    pub(crate) fn refused(&self, text: &str) -> String {
        match self.tried(text) {
            Ok(_) => panic!("calibrated, expected a refusal of\n{text}"),
            Err(error) => error.to_string(),
        }
    }
}

pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn normal(&mut self, sigma: f64) -> f64 {
        let drawn: f64 = StandardNormal.sample(&mut self.0);
        sigma * drawn
    }
}

/// A line along one axis, with all other rotary axes at 0.
pub(crate) struct Line<'a> {
    pub(crate) error: &'a str,
    /// Positions of the other linear axes, mm.
    pub(crate) at: &'a [(AxisName, f64)],
    /// The measured point, mm in MCS with the measured axis at 0. The point moves with the component that carries it.
    pub(crate) point: [f64; 3],
    /// Whether the point is on the side of the joint that does not move with the carriage.
    pub(crate) other: bool,
    pub(crate) targets: usize,
    pub(crate) runs: usize,
}

/// Reading of a perfect instrument, µm or µrad, with the sign of the error.
pub(crate) fn reading(truth: &Machine, line: &Line<'_>, target: f64) -> f64 {
    let name: ErrorName = line.error.parse().expect("an error name");
    let index = truth.index_of(name.axis).expect("an axis");
    let joint = truth.chain().joints()[index];
    let mut at = line.at.to_vec();
    at.push((name.axis, target));
    let mut state = truth.state(&at).expect("a state");
    state.approach[index] = Some(Direction::Positive);
    let [mut workpiece, mut tool] = [Pose::identity(), Pose::identity()];
    for (joint, q) in truth.chain().joints().iter().zip(state.q) {
        match joint.side {
            Side::Workpiece => workpiece = workpiece * joint.motion(q),
            Side::Tool => tool = tool * joint.motion(q),
        }
    }
    // The point moves with the carriage of a linear axis; a rotary axis rotates below it.
    let goes = match (joint.side, line.other || name.axis.is_rotary()) {
        (_, true) => 0.0,
        (Side::Tool, false) => target,
        (Side::Workpiece, false) => -target,
    };
    let point = Vector3::from(line.point) + joint.direction * goes;
    let on_tool = tool.inverse().transform_point(&point);
    let none = Temperatures::new();
    let actual = actual_pose(truth.chain(), &truth.source(&none), &state);
    let ideal = workpiece * tool;
    let to_mcs = workpiece.rotation.transpose();
    let k = name.component.mcs_index();
    if name.component.is_angular() {
        let turned = actual.rotation * ideal.rotation.transpose();
        (to_mcs * vector_from_rotation(&turned))[k] * 1e6
    } else {
        let moved = actual.transform_point(&on_tool) - ideal.transform_point(&on_tool);
        (to_mcs * moved)[k] * 1e3
    }
}

/// Writes the readings of a line with noise (µm or µrad); returns the `[[measurement]]` table of the line for the
/// calibration file.
pub(crate) fn measure(
    lab: &Lab,
    truth: &Machine,
    file: &str,
    line: &Line<'_>,
    sigma: f64,
    noise: &mut Noise,
) -> String {
    let name: ErrorName = line.error.parse().expect("an error name");
    let [low, high] = truth.axis(name.axis).expect("an axis").travel;
    let mut csv = String::from("target,run,direction,deviation\n");
    for run in 1..=line.runs {
        for step in 0..line.targets {
            let target = low + (high - low) * step as f64 / (line.targets - 1) as f64;
            let value = reading(truth, line, target) + noise.normal(sigma);
            writeln!(csv, "{target},{run},+,{value:.9}").expect("a String");
        }
    }
    lab.write(file, &csv);
    let held: Vec<String> = line.at.iter().map(|(a, q)| format!("{a} = {q:?}")).collect();
    let rides = if line.other { "rides = \"other\"\n" } else { "" };
    format!(
        "[[measurement]]\nerror = \"{}\"\nfile = \"{file}\"\nat = {{ {} }}\npoint = {:?}\n{rides}",
        line.error,
        held.join(", "),
        line.point
    )
}
