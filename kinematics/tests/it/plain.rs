//! The model in plain 4×4 arrays, implemented from its definition alone.

use volcomp_kinematics::{Chain, Form, GivenErrors, MotionFrame, Side, State};
use volcomp_vocabulary::AxisKind;

pub(crate) type M = [[f64; 4]; 4];

const EYE: M =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &M, b: &M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn trans(t: [f64; 3]) -> M {
    let mut m = EYE;
    for i in 0..3 {
        m[i][3] = t[i];
    }
    m
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Rotation by the rotation vector `r` (rad): the power series of the exponential.
fn rot_vector(r: [f64; 3]) -> M {
    let hat: M =
        [[0.0, -r[2], r[1], 0.0], [r[2], 0.0, -r[0], 0.0], [-r[1], r[0], 0.0, 0.0], [0.0; 4]];
    let (mut sum, mut term) = (EYE, EYE);
    for n in 1..60 {
        term = product(&term, &hat);
        for i in 0..3 {
            for j in 0..3 {
                term[i][j] /= f64::from(n);
                sum[i][j] += term[i][j];
            }
        }
        term[3][3] = 0.0;
    }
    sum
}

fn small(r: [f64; 3]) -> M {
    let mut m = EYE;
    m[0][1] = -r[2];
    m[0][2] = r[1];
    m[1][0] = r[2];
    m[1][2] = -r[0];
    m[2][0] = -r[1];
    m[2][1] = r[0];
    m
}

fn minus(v: [f64; 3]) -> [f64; 3] {
    v.map(|x| -x)
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

fn scaled(v: [f64; 3], f: f64) -> [f64; 3] {
    v.map(|x| x * f)
}

fn apply(m: &M, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}

fn about(rotation: &M, c: [f64; 3]) -> M {
    product(&product(&trans(c), rotation), &trans(minus(c)))
}

/// Position error ΔP (mm) and rotation vector ρ (rad) of the `exact` or `htm` form.
pub(crate) fn error(
    chain: &Chain,
    errors: &GivenErrors,
    state: &State,
    form: Form,
) -> [[f64; 3]; 2] {
    let exact = form == Form::Exact;
    let rotation = |r: [f64; 3]| if exact { rot_vector(r) } else { small(r) };
    let (mut actual, mut ideal) = (EYE, EYE);
    for (i, joint) in chain.joints().iter().enumerate() {
        let (q, u): (f64, [f64; 3]) = (state.q[i], joint.direction.into());
        let c: [f64; 3] = joint.point_mm.into();
        let omega: [f64; 3] = errors.location[i].angular_rad.into();
        let mut d = if exact { apply(&rot_vector(omega), u) } else { plus(u, cross(omega, u)) };
        let linear = joint.kind == AxisKind::Linear;
        let (motion, nominal) = if linear {
            (trans(scaled(d, q)), trans(scaled(u, q)))
        } else {
            let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
            d = scaled(d, 1.0 / length);
            let line = plus(c, errors.location[i].linear_mm.into());
            (about(&rot_vector(scaled(d, q)), line), about(&rot_vector(scaled(u, q)), c))
        };
        let mut twist = rotation(errors.motion[i].angular_rad.into());
        for (row, x) in twist.iter_mut().zip(errors.motion[i].linear_mm.iter()) {
            row[3] = *x;
        }
        let e = about(&twist, c);
        let mut s = rotation(errors.assembly[i].angular_rad.into());
        for (row, x) in s.iter_mut().zip(errors.assembly[i].linear_mm.iter()) {
            row[3] = *x;
        }
        let rides = linear || joint.motion_frame == MotionFrame::Turning;
        let order = match (joint.side, rides) {
            (Side::Tool, true) => [s, motion, e],
            (Side::Tool, false) => [s, e, motion],
            (Side::Workpiece, true) => [e, motion, s],
            (Side::Workpiece, false) => [motion, e, s],
        };
        for factor in &order {
            actual = product(&actual, factor);
        }
        ideal = product(&ideal, &nominal);
    }
    let tip = chain.tool_tip_mm().into();
    let position = plus(apply(&actual, tip), minus(apply(&ideal, tip)));
    // R_actual · R_idealᵀ
    let r: [[f64; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| (0..3).map(|k| actual[i][k] * ideal[j][k]).sum())
    });
    let skew = [0.5 * (r[2][1] - r[1][2]), 0.5 * (r[0][2] - r[2][0]), 0.5 * (r[1][0] - r[0][1])];
    let sine = skew.iter().map(|x| x * x).sum::<f64>().sqrt();
    let scale = if exact && sine > 0.0 { sine.asin() / sine } else { 1.0 };
    [position, scaled(skew, scale)]
}
