use volcomp_vocabulary::CorrectionLimit;

use crate::failure::Failure;

pub(crate) const RAISE_LIMIT: &str = ", or allow more with --limit-um";

/// The option of the commands that write corrections.
#[derive(clap::Args)]
pub(crate) struct LimitArgument {
    /// Largest correction of an axis: µm for linear, µrad for rotary axes, at most 2000; above it nothing is written
    #[arg(long, value_name = "UM", default_value_t = 250.0, allow_negative_numbers = true)]
    limit_um: f64,
}

impl LimitArgument {
    pub(crate) fn limit(&self) -> Result<CorrectionLimit, Failure> {
        CorrectionLimit::new(self.limit_um)
            .map_err(|error| Failure::Input(format!("--limit-um: {error}")))
    }
}
