//! Unknowns of which the noise leaves nothing known.

use volcomp_kinematics::nalgebra::DMatrix;

use crate::{
    params::Param,
    rank::{LEAST_SHARE, of_unit_length},
    system::System,
};

/// mm and mrad: no error of a machine is larger. Where the noise alone gives an unknown a larger standard uncertainty than this, the
/// observations tell less of it than is known before any measurement: a value would be noise, and harm where it is applied.
pub(crate) const LARGEST: f64 = 1.0;

/// An error coefficient that is left at zero for its uncertainty.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Uncertain {
    pub(crate) param: usize,
    /// The standard uncertainty that it would have, in its unit.
    pub(crate) uncertainty: f64,
}

impl Uncertain {
    /// Which of the kept unknowns is to be left at zero first, where these are the derivatives of all by the numbers, each divided by
    /// its uncertainty: of those that are about as uncertain the last one, since more is known of the others without it. `None` where
    /// something is known of all.
    pub(crate) fn among(system: &System, kept: &[usize], jacobian: &DMatrix<f64>) -> Option<Self> {
        let own = jacobian.select_columns(kept);
        let lengths: Vec<f64> = own.column_iter().map(|column| column.norm()).collect();
        let inverse = of_unit_length(own)
            .qr()
            .r()
            .solve_upper_triangular(&DMatrix::identity(kept.len(), kept.len()))?;
        let uncertain = |place: usize| {
            let param = kept[place];
            let inside = inverse.row(place).norm() / lengths[place];
            Self {
                param,
                uncertainty: inside * system.unit_of(param).1,
            }
        };
        let is_error = |of: &Self| matches!(system.params.at(of.param), Param::Coefficient(_));
        let found: Vec<Self> = (0..kept.len())
            .map(uncertain)
            .filter(|of| is_error(of) && of.uncertainty > 1e3 * LARGEST)
            .collect();
        let most = found.iter().map(|of| of.uncertainty).fold(0.0, f64::max);
        found
            .into_iter()
            .rfind(|of| of.uncertainty >= LEAST_SHARE * most)
    }

    /// What it is, for people.
    pub(crate) fn words(self, system: &System) -> String {
        let (symbol, largest) = match system.unit_of(self.param).0 {
            "urad" => ("µrad", "mrad"),
            _ => ("µm", "mm"),
        };
        format!(
            "{} is not determined: with the stated noise its standard uncertainty would be {:.0} {symbol}, more than {LARGEST} {largest}, which no error of a machine is larger than: it is left at zero",
            system.name(self.param),
            self.uncertainty
        )
    }
}
