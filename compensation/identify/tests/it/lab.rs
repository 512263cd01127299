//! A folder with observation files, and readings of a machine with known errors.

use std::fs;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use volcomp_identify::{Identification, IdentifyError, Observations, identify};
use volcomp_kinematics::{actual_pose, nalgebra::Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

pub(crate) struct Lab(tempfile::TempDir);

impl Lab {
    pub(crate) fn new(machine: &str) -> Self {
        let lab = Self(tempfile::tempdir().expect("a folder"));
        lab.write("machine.toml", machine);
        lab
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.0.path().join(name), text).expect("written");
    }

    pub(crate) fn write_bytes(&self, name: &str, bytes: &[u8]) {
        fs::write(self.0.path().join(name), bytes).expect("written");
    }

    pub(crate) fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    pub(crate) fn machine(&self) -> Machine {
        let text = fs::read_to_string(self.0.path().join("machine.toml")).expect("read");
        Machine::parse(&text, "machine.toml").expect("a machine")
    }

    pub(crate) fn read(&self, text: &str) -> Result<Observations, IdentifyError> {
        self.write("o.toml", &format!("machine = \"machine.toml\"\n{text}"));
        Observations::read(&self.0.path().join("o.toml"))
    }

    pub(crate) fn identify(&self, text: &str) -> Result<Identification, IdentifyError> {
        identify(&self.read(text)?, |_, _| {})
    }

    pub(crate) fn refused(&self, text: &str) -> String {
        match self.identify(text) {
            Ok(_) => panic!("found something, expected a refusal"),
            Err(error) => error.to_string(),
        }
    }
}

pub(crate) fn csv<const N: usize>(head: &str, rows: impl IntoIterator<Item = [f64; N]>) -> String {
    let mut text = format!("{head}\n");
    for row in rows {
        text += &row.map(|number| format!("{number:?}")).join(",");
        text.push('\n');
    }
    text
}

/// All notes of a result, one per line.
pub(crate) fn words(found: &Identification) -> String {
    let notes: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    notes.join("\n")
}

pub(crate) fn value(found: &Identification, name: &str) -> (f64, f64) {
    let parameter = found.parameters.iter().find(|p| p.name == name);
    let parameter = parameter.unwrap_or_else(|| panic!("{name}: {:?}", found.parameters));
    (parameter.value, parameter.uncertainty.unwrap_or(f64::NAN))
}

pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn normal(&mut self, sigma: f64) -> f64 {
        Normal::new(0.0, sigma).expect("a sigma").sample(&mut self.0)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        use rand::RngExt as _;
        self.0.random_range(low..high)
    }
}

/// The actual tip of a machine, with the offset of a target in tool axes, mm.
pub(crate) fn tip(machine: &Machine, at: &[(AxisName, f64)], offset: [f64; 3]) -> Vector3<f64> {
    let state = machine.state(at).expect("a state");
    let source = machine.source(&Temperatures::default());
    let tip = machine.chain().tool_tip_mm() + Vector3::from(offset);
    actual_pose(machine.chain(), &source, &state).transform_point(&tip)
        - machine.chain().workpiece_origin_mm()
}

pub(crate) fn worn(machine: &str, errors: &str) -> Machine {
    Machine::parse(&format!("{machine}[errors]\n{errors}"), "truth").expect("a machine")
}
