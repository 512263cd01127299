//! Tests the published two-axis equations of the error-twist model (Procedia Engineering 24 (2011) 845–849).

use rand::RngExt;
use volcomp_kinematics::{Chain, Form, GivenErrors, State, volumetric_error};
use volcomp_vocabulary::AxisName;

use crate::{motion, seeded};

#[test]
fn twist_gives_the_two_axis_equations() {
    let mut rng = seeded(4);
    let mut chain = Chain::new("w b X Y t".parse().unwrap());
    for _ in 0..1000 {
        let mut random = |size: f64| rng.random_range(-size..=size);
        let (xt, yt, x, y) = (random(300.0), random(300.0), random(800.0), random(800.0));
        chain.set_tool([xt, yt, 0.0], [0.0, 0.0, 1.0]).unwrap();
        let mut errors = GivenErrors::default();
        for index in 0..2 {
            errors.motion[index] = motion(&mut rng);
            errors.assembly[index] = motion(&mut rng);
        }
        let [ex, ey] = [errors.motion[0], errors.motion[1]];
        let [sx, sy] = [errors.assembly[0], errors.assembly[1]];
        let [dx, ax, tx, cx] = [ex.linear_mm, ex.angular_rad, sx.linear_mm, sx.angular_rad];
        let [dy, ay, ty, cy] = [ey.linear_mm, ey.angular_rad, sy.linear_mm, sy.angular_rad];
        let expected = [
            dx.x + tx.x + dy.x + ty.x - (y + yt) * (ax.z + cy.z + cx.z) - yt * ay.z,
            dx.y + tx.y + dy.y + ty.y + xt * (ax.z + cy.z + cx.z + ay.z) + x * cx.z,
            dx.z + tx.z + dy.z + ty.z + (y + yt) * (ax.x + cx.x + cy.x)
                - xt * (ax.y + ay.y + cy.y)
                - (x + xt) * cx.y
                + yt * ay.x,
        ];
        let state = State::new(&chain, [(AxisName::X, x), (AxisName::Y, y)]).unwrap();
        let ours = volumetric_error(&chain, &errors, &state, Form::Twist);
        for (k, expected) in expected.into_iter().enumerate() {
            let um = (ours.position_mm[k] - expected).abs() * 1e3;
            assert!(um < 1e-9, "{k}: {um} um");
        }
        let rotation = ax + cx + cy + ay;
        assert!((ours.rotation_rad - rotation).norm() * 1e6 < 1e-9);
    }
}
