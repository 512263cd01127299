//! The table `[dh]` of a machine file: axis positions by Denavit–Hartenberg parameters.

use volcomp_document::{InputError, Section, Value};
use volcomp_kinematics::{
    DhConvention, DhRow, DhTable, Pose, Structure,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::axis::Axis;

/// Direction components below this are rounding errors of sines and cosines of right angles.
const DIRECTION_ROUNDING: f64 = 1e-14;
/// Coordinates below this are rounding errors, mm.
const POINT_ROUNDING_MM: f64 = 1e-10;
/// Maximum distance of a configured point from the line of its axis, mm.
const ON_THE_LINE_MM: f64 = 1e-6;

/// Sets the directions and points of the axes from `[dh]`, if the file has it.
pub(super) fn place_by_table(
    root: &Section<'_>,
    structure: &Structure,
    axes: &mut [Axis],
) -> Result<(), InputError> {
    let Some(section) = root.section("dh")? else {
        return Ok(());
    };
    section.allow(&["convention", "base", "rows"])?;
    let conventions = [("distal", DhConvention::Distal), ("proximal", DhConvention::Proximal)];
    let table = DhTable {
        convention: section.one_of("convention", &conventions, DhConvention::Distal)?,
        base: match section.section("base")? {
            Some(base) => decode_base(&base)?,
            None => Pose::identity(),
        },
        rows: decode_rows(&section.require("rows")?, structure)?.into_iter().collect(),
    };
    let chain = table.to_chain(structure.clone()).map_err(|e| section.error(e.to_string()))?;
    let stated = root.require("axes")?.section()?;
    for (axis, joint) in axes.iter_mut().zip(chain.joints()) {
        let keys = stated.require(&axis.name.to_string())?.section()?;
        if let Some(value) = keys.get("direction") {
            return Err(value.error(format!(
                "found the direction of axis {} beside [dh], expected one of them",
                axis.name
            )));
        }
        axis.direction = Some(rounded(&joint.direction, DIRECTION_ROUNDING));
        // A linear axis has no fixed line; `point` is the point to which its errors apply.
        if axis.name.kind() == AxisKind::Linear {
            continue;
        }
        match (axis.point_mm, keys.get("point")) {
            (Some(point), Some(value)) => {
                let off_mm = (Vector3::from(point) - joint.point_mm).cross(&joint.direction).norm();
                // NaN is rejected as well.
                if off_mm > ON_THE_LINE_MM || off_mm.is_nan() {
                    return Err(value.error(format!(
                        "found a point {off_mm:.6} mm off the line that [dh] gives axis {}, expected one on it",
                        axis.name
                    )));
                }
            }
            _ => axis.point_mm = Some(rounded(&joint.point_mm, POINT_ROUNDING_MM)),
        }
    }
    Ok(())
}

fn rounded(vector: &Vector3<f64>, below: f64) -> [f64; 3] {
    vector.map(|x| if x.abs() < below { 0.0 } else { x }).into()
}

fn decode_base(section: &Section<'_>) -> Result<Pose, InputError> {
    section.allow(&["point", "x", "z"])?;
    let vector = |key: &str, default: [f64; 3]| {
        Ok::<_, InputError>(Vector3::from(section.optional(key, Value::vector)?.unwrap_or(default)))
    };
    let (point, x, z) =
        (vector("point", [0.0; 3])?, vector("x", [1.0, 0.0, 0.0])?, vector("z", [0.0, 0.0, 1.0])?);
    // The vector is scaled first, so that the squares neither underflow nor overflow.
    let unit = |v: Vector3<f64>| (v.amax() > 0.0).then(|| (v / v.amax()).normalize());
    let frame = unit(z).zip(unit(x)).and_then(|(z, x)| {
        let y = z.cross(&x).try_normalize(1e-6)?;
        Some(Matrix3::from_columns(&[y.cross(&z), y, z]))
    });
    let Some(rotation) = frame else {
        return Err(section.error(
            "found x along z or a vector of zeros, expected two directions across each other",
        ));
    };
    Ok(Pose { rotation, translation_mm: point })
}

fn decode_rows(value: &Value<'_>, structure: &Structure) -> Result<Vec<DhRow>, InputError> {
    let axes = structure.axes();
    let items = value.items()?;
    if items.len() != axes.len() {
        return Err(value.error(format!(
            "found {} rows, expected {}: one for each axis of `{structure}`, from the workpiece to the tool",
            items.len(),
            axes.len()
        )));
    }
    let mut rows = Vec::new();
    for (item, &axis) in items.iter().zip(axes) {
        let row = item.section()?;
        row.allow(&["axis", "theta", "d", "a", "alpha"])?;
        let named = row.require("axis")?;
        if named.text()?.parse::<AxisName>() != Ok(axis) {
            return Err(named.error(format!(
                "found \"{}\", expected \"{axis}\": rows are in the order of `{structure}`",
                named.text()?
            )));
        }
        let number = |key: &str| {
            let stated = row.optional(key, Value::number)?;
            Ok::<_, InputError>(stated.unwrap_or(0.0))
        };
        rows.push(DhRow {
            theta_rad: number("theta")?.to_radians(),
            d_mm: number("d")?,
            a_mm: number("a")?,
            alpha_rad: number("alpha")?.to_radians(),
        });
    }
    Ok(rows)
}
