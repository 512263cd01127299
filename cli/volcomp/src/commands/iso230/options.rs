//! What is known of a positioning test, as options: the inputs of its measurement uncertainty.

use volcomp_metrology::{Environment, REFERENCE_DEGC, UncertaintyInputs};

/// Inputs of the measurement uncertainty; what is not stated is left out, and said.
#[derive(clap::Args)]
#[command(next_help_heading = "Measurement uncertainty")]
pub(crate) struct UncertaintyOptions {
    /// Uncertainty of the instrument by its calibration (k = 2): the part that grows with the length, µm/m
    #[arg(long, value_name = "UM_PER_M")]
    device_um_per_m: Option<f64>,
    /// The part of it that does not grow, µm
    #[arg(long, value_name = "UM")]
    device_um: Option<f64>,
    /// By how much the beam may run off the axis over its length, mm
    #[arg(long, value_name = "MM")]
    misalignment_mm: Option<f64>,
    /// Range within which the temperature of the machine is known, K
    #[arg(long, value_name = "K")]
    temperature_range_k: Option<f64>,
    /// Expansion coefficient of the machine, µm/(m·K); without it that of the file
    #[arg(long, value_name = "UM_PER_M_K")]
    expansion: Option<f64>,
    /// Range within which that coefficient is known, µm/(m·K)
    #[arg(long, value_name = "UM_PER_M_K")]
    expansion_range: Option<f64>,
    /// Temperature of the machine, °C; without it the material temperature of the file that is farthest from 20 °C
    #[arg(long, value_name = "DEGC", allow_hyphen_values = true)]
    machine_degc: Option<f64>,
    /// Range of a drift test as long as the measurement, µm
    #[arg(long, value_name = "UM")]
    environment_um: Option<f64>,
}

impl UncertaintyOptions {
    /// Whether any of them is given.
    pub(crate) fn stated(&self) -> bool {
        [
            self.device_um_per_m,
            self.device_um,
            self.misalignment_mm,
            self.temperature_range_k,
            self.expansion,
            self.expansion_range,
            self.machine_degc,
            self.environment_um,
        ]
        .iter()
        .any(Option::is_some)
    }

    /// The inputs, with what the file knows of its surroundings.
    pub(crate) fn inputs(&self, environment: &Environment) -> UncertaintyInputs {
        let sensors = environment.material_temperature.iter().flatten();
        let farthest = sensors
            .flat_map(|sensor| [sensor.start, sensor.end])
            .map(|degc| degc - REFERENCE_DEGC)
            .max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let of_file = environment.expansion_coefficient.map(|c| c.start);
        UncertaintyInputs {
            device_um_per_m: self.device_um_per_m,
            device_um: self.device_um,
            misalignment_mm: self.misalignment_mm,
            temperature_range_k: self.temperature_range_k,
            // A coefficient of 0 in a file says that nothing was compensated, not what the machine is made of.
            expansion_um_per_m_k: self.expansion.or(of_file.filter(|c| *c > 0.0)),
            expansion_range_um_per_m_k: self.expansion_range,
            from_20_degc_k: self.machine_degc.map(|t| t - REFERENCE_DEGC).or(farthest),
            environment_um: self.environment_um,
        }
    }
}
