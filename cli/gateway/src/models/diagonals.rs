//! The displacement error along the diagonals of the working volume, for two models.

use volcomp_model::{Fading, Machine, ModelError};
use volcomp_runtime::Model;
use volcomp_vocabulary::{AxisName, PerAxis};

use crate::documents::ModelDiagonal;

/// Number of equal steps per diagonal.
const STEPS: usize = 40;

/// The errors along the diagonals of the linear axes: four diagonals of three axes, two of two. Rotary axes are at zero
/// or the nearest end of travel. The error is that of the displacement from the start of the diagonal (ISO 230-6),
/// without correction and at the reference temperature.
pub(crate) fn diagonals(
    before: &Machine,
    after: &Machine,
) -> Result<Vec<ModelDiagonal>, ModelError> {
    let same = |a: &Machine| -> Vec<AxisName> { a.axes().iter().map(|axis| axis.name).collect() };
    if same(before) != same(after) {
        return Ok(Vec::new());
    }
    let models = [
        Model::new(before, Fading::default())?,
        Model::new(after, Fading::default())?,
    ];
    let mut linear: Vec<AxisName> = same(after);
    linear.retain(|axis| !axis.is_rotary());
    linear.sort_unstable();
    linear.truncate(3);
    if linear.len() < 2 {
        return Ok(Vec::new());
    }
    // As in ISO 230-6: at most one axis moves backward, and of two axes the first.
    let backward = (0..linear.len()).take(if linear.len() == 2 { 1 } else { 3 });
    core::iter::once(None)
        .chain(backward.map(Some))
        .map(|backward| diagonal(after, &models, &linear, backward))
        .collect()
}

/// The name of a diagonal: `NPP` for X backward, Y and Z forward; `NP0` if Z does not move; signs such as `−U +V` for
/// other axis letters.
fn name(linear: &[AxisName], backward: Option<usize>) -> String {
    let of_cube = [AxisName::X, AxisName::Y, AxisName::Z];
    let goes_back = |place: usize| backward == Some(place);
    if linear.iter().all(|axis| of_cube.contains(axis)) {
        let sign = |axis: &AxisName| match linear.iter().position(|name| name == axis) {
            None => '0',
            Some(place) if goes_back(place) => 'N',
            Some(_) => 'P',
        };
        return of_cube.iter().map(sign).collect();
    }
    let signs = linear.iter().enumerate().map(|(place, name)| {
        let sign = if goes_back(place) { '−' } else { '+' };
        format!("{sign}{name}")
    });
    signs.collect::<Vec<_>>().join(" ")
}

fn diagonal(
    machine: &Machine,
    models: &[Model; 2],
    linear: &[AxisName],
    backward: Option<usize>,
) -> Result<ModelDiagonal, ModelError> {
    let state_at = |share: f64| {
        let coordinates: Vec<(AxisName, f64)> = (machine.axes().iter())
            .map(|axis| {
                let Some(place) = linear.iter().position(|name| *name == axis.name) else {
                    return (axis.name, axis.nearest_zero());
                };
                let [low, high] = axis.travel;
                let share = if backward == Some(place) {
                    1.0 - share
                } else {
                    share
                };
                (axis.name, low + share * (high - low))
            })
            .collect();
        machine.state(&coordinates)
    };
    let chain = machine.chain();
    let way = chain.ideal_tip_mm(&state_at(1.0)?) - chain.ideal_tip_mm(&state_at(0.0)?);
    let length = way.norm();
    let direction = way / length.max(f64::MIN_POSITIVE);
    let error_um = |model: &Model, share: f64| -> Result<f64, ModelError> {
        let [error, _] = model.errors(&state_at(share)?, &PerAxis::ZERO);
        let [x, y, z] = error.position_mm;
        Ok(1e3 * (x * direction.x + y * direction.y + z * direction.z))
    };
    let first = [error_um(&models[0], 0.0)?, error_um(&models[1], 0.0)?];
    let points = (0..=STEPS).map(|step| {
        let share = step as f64 / STEPS as f64;
        let [before, after] = [error_um(&models[0], share)?, error_um(&models[1], share)?];
        Ok([share * length, before - first[0], after - first[1]])
    });
    Ok(ModelDiagonal {
        name: name(linear, backward),
        points: points.collect::<Result<_, ModelError>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_standard() {
        use AxisName::{U, V, X, Y, Z};
        let all = [None, Some(0), Some(1), Some(2)].map(|backward| name(&[X, Y, Z], backward));
        assert_eq!(all, volcomp_model::BODY_DIAGONALS);
        assert_eq!(name(&[X, Z], Some(0)), "N0P");
        assert_eq!(name(&[U, V], Some(0)), "−U +V");
    }

    /// A scale that is 50 µm/m long on X of a machine of 300 × 400 mm: along the diagonal of 500 mm the displacement errs by
    /// 50e-6 · 300 · 300/500 mm = 9 µm at its end.
    #[test]
    fn the_end_of_a_diagonal_errs_as_by_hand() {
        let text = |scale: f64| {
            format!(
                "structure = \"w b X Y t\"\naxes.X.travel = [0.0, 300.0]\naxes.Y.travel = [0.0, 400.0]\n[errors]\nEXX = {{ poly = [7.0, {scale}] }}\n"
            )
        };
        let machine = |scale| Machine::parse(&text(scale), "m").expect("right");
        let found = diagonals(&machine(0.0), &machine(0.05)).expect("it compiles");
        let names: Vec<&str> = found
            .iter()
            .map(|diagonal| diagonal.name.as_str())
            .collect();
        assert_eq!(names, ["PP0", "NP0"]);
        for diagonal in found {
            let [length, before, after] = diagonal.points[STEPS];
            assert!(
                (length - 500.0).abs() < 1e-9 && before.abs() < 1e-9,
                "{before}"
            );
            assert!((after - 9.0).abs() < 1e-6, "{after}");
        }
    }
}
