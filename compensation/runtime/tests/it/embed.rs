//! The example that is shown to integrators runs.

#[path = "../../examples/embed.rs"]
mod example;

#[test]
fn the_example_runs_and_is_short() {
    example::main().expect("it runs");
    let lines = include_str!("../../examples/embed.rs").lines().count();
    assert!(lines <= 60, "found {lines} lines");
}
