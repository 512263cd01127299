//! On an axis with `modulo`, what is given by nodes must end with the value that it starts with.

use volcomp_model::Machine;

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
        grid(
            "[\"C\", \"X\"]",
            "[[0, 180, 360], [0, 500]]",
            "[[0, 1], [5, 6], [0, 1]]",
        ),
        grid(
            "[\"X\", \"C\"]",
            "[[0, 500], [0, 180, 360]]",
            "[[0, 5, 0], [1, 6, 1]]",
        ),
        grid("[\"X\", \"Z\"]", "[[0, 500], [0, 500]]", "[[0, 5], [1, 6]]"),
    ];
    for error in closed {
        assert!(parsed(&error).is_ok(), "{error}: {:?}", parsed(&error));
    }
    let open = [
        grid(
            "[\"C\", \"X\"]",
            "[[0, 180, 360], [0, 500]]",
            "[[0, 1], [5, 6], [0, 2]]",
        ),
        grid(
            "[\"X\", \"C\"]",
            "[[0, 500], [0, 180, 360]]",
            "[[0, 5, 0], [1, 6, 2]]",
        ),
        // The error of another axis, looked up along C.
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 360]]", "[[0, 0], [1, 2]]").replace("EZC", "EZX"),
    ];
    for error in open {
        let told = parsed(&error).expect_err(&error);
        let expected =
            "first value 1 and last value 2 differ, expected the same: the axis has a modulo";
        assert!(
            told.contains(expected) && told.starts_with("m.toml:8: "),
            "{told}"
        );
    }
}
