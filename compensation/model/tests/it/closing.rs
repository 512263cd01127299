//! On an axis with `modulo` a curve must end where it starts.

use volcomp_model::Machine;
use volcomp_test_support::cases;

fn parsed(error: &str) -> Result<Machine, String> {
    let text = format!(
        "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
         C = {{ travel = [0, 360], modulo = 360 }}\n[errors]\n{error}\n"
    );
    Machine::parse(&text, "m.toml").map_err(|error| error.to_string())
}

fn grid(axes: &str, nodes: &str, values: &str) -> String {
    format!("EZC = {{ grid = {{ axes = {axes}, nodes = {nodes}, values = {values} }} }}")
}

#[test]
fn a_grid_closes_along_the_axis_that_goes_round() {
    let closed = [
        grid("[\"C\", \"X\"]", "[[0, 180, 360], [0, 500]]", "[[0, 1], [5, 6], [0, 1]]"),
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 180, 360]]", "[[0, 5, 0], [1, 6, 1]]"),
        grid("[\"X\", \"Z\"]", "[[0, 500], [0, 500]]", "[[0, 5], [1, 6]]"),
    ];
    for error in closed {
        assert!(parsed(&error).is_ok(), "{error}: {:?}", parsed(&error));
    }
    let open = [
        grid("[\"C\", \"X\"]", "[[0, 180, 360], [0, 500]]", "[[0, 1], [5, 6], [0, 2]]"),
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 180, 360]]", "[[0, 5, 0], [1, 6, 2]]"),
        // An error of another axis that also depends on C.
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 360]]", "[[0, 0], [1, 2]]").replace("EZC", "EZX"),
    ];
    for error in open {
        let message = parsed(&error).expect_err(&error);
        let expected =
            "first value 1 and last value 2 differ, expected the same: the axis has a modulo";
        assert!(message.contains(expected) && message.starts_with("m.toml:8: "), "{message}");
    }
}

/// A curve of any kind that jumps at the roll-over of its axis is rejected with the size of the jump. For a table at
/// 0.000° a flickering last digit would change the correction by 160 µm.
#[test]
fn curves_of_every_kind_close_where_the_axis_rolls_over() {
    for [curve, jump] in &cases(
        r"
{ chebyshev = [0.0, 80.0], domain = [0.0, 360.0] } | 160.000
{ poly = [0.0, 0.5] } | 180.000
{ fourier = [0.0, 80.0, 80.0], period = 250.0 } | 124.9
{ bspline = { knots = [0, 0, 0, 0, 360, 360, 360, 360], coefficients = [0, 10, 70, 80], degree = 3 } } | 80.000
{ forward = { poly = [1.0] }, backward = { poly = [0.0, 0.5] } } | 180.000
",
    ) {
        let message = parsed(&format!("EXC = {curve}")).expect_err(curve);
        let expected = format!("jumps by {jump}");
        assert!(
            message.contains(&expected)
                && message.starts_with("m.toml:8: ")
                && message.contains("EXC"),
            "{message}"
        );
        assert!(message.contains("expected at most 1 µm or µrad"), "{message}");
    }
    for curve in [
        "{ poly = [3.0] }",
        "{ fourier = [0.0, 80.0, 80.0], period = 360.0 }",
        "{ fourier = [0.0, 80.0, 80.0], period = 120.0 }",
        // Curves fitted to readings close only within the scatter of the readings.
        "{ chebyshev = [0.0, 0.4], domain = [0.0, 360.0] }",
        "{ poly = [0.0, -0.5, 0.0013888888888888888] }",
    ] {
        let message = parsed(&format!("EXC = {curve}"));
        assert!(message.is_ok(), "{curve}: {message:?}");
    }
}
