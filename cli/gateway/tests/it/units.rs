//! Every number of a configuration has the unit of the kind of its axis.

use std::path::Path;

use volcomp_gateway::config::Config;
use volcomp_port::{Description, DeviceError};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Urad};

/// A configuration of one axis on the eight lines of a module; nothing is asked of the module.
fn lines(axis: &str, keys: &str) -> String {
    format!(
        "machine = \"m.toml\"\n[[controller]]\nurl = \"modbus://127.0.0.1:9?profile=WAGO-750-8DI/8DO\"\naxes = [\"{axis}\"]\nunwatched = true\n{keys}\n"
    )
}

fn parsed(text: &str) -> Result<Config, String> {
    Config::parse(text, "G.toml", Path::new("")).map_err(|e| e.to_string())
}

/// What the gateway makes of the first controller, before it opens it.
fn described(config: &Config) -> Result<Description, DeviceError> {
    volcomp_devices::controller(&config.controllers[0])?.describe()
}

/// Steps on lines are those that the configuration states: 5 µrad asked are 5 µrad given, not 1000.
#[test]
fn a_rotary_axis_on_lines_has_its_own_steps() {
    let keys = "resolution_urad = 5.0\n[controller.digital]\nposition_bits = 8\nposition_deg_per_count = 1.5\nposition_zero_deg = -180.0";
    let config = parsed(&lines("C", keys)).expect("good");
    let axis = described(&config).expect("good").axes[0];
    assert_eq!(axis.name, AxisName::C);
    assert_eq!(axis.resolution, Displacement::Angle(Urad(5.0).to_rad()));
    let words = config.controllers[0]
        .digital_axis(AxisName::C)
        .expect("good");
    // 1.5° is π/120.
    let quarter = words.position.decode(60).position;
    assert!(
        (quarter + std::f64::consts::FRAC_PI_2).abs() < 1e-12,
        "{quarter}"
    );
    assert!(
        (words.position.decode(61).position - quarter - std::f64::consts::PI / 120.0).abs() < 1e-12
    );
    let linear = parsed(&lines(
        "X",
        "resolution_um = 0.5\n[controller.digital]\nposition_bits = 8",
    ));
    let step = described(&linear.expect("good")).expect("good").axes[0].resolution;
    assert_eq!(step, Displacement::from_micro(AxisKind::Linear, 0.5));
}

/// A key of the other kind is refused by name, and one that is needed is asked for by name.
#[test]
fn keys_of_the_other_kind_are_refused() {
    for (axis, keys, line, key) in [
        ("C", "resolution_um = 5.0", 6, "resolution_um"),
        ("X", "resolution_urad = 5.0", 6, "resolution_urad"),
        (
            "C",
            "[controller.digital]\nposition_mm_per_count = 0.1",
            7,
            "position_mm_per_count",
        ),
        (
            "C",
            "[controller.digital]\nposition_zero_mm = 0.1",
            7,
            "position_zero_mm",
        ),
        (
            "Z",
            "[controller.digital]\nposition_deg_per_count = 0.1",
            7,
            "position_deg_per_count",
        ),
    ] {
        let message = parsed(&lines(axis, keys)).expect_err("refused");
        assert!(
            message.starts_with(&format!("G.toml:{line}: ")),
            "{message}"
        );
        assert!(
            message.contains(key) && message.contains(&format!("the axes {axis}")),
            "{message}"
        );
    }
    let config = parsed(&lines("B", "resolution_urad = 5.0")).expect("each key for itself is good");
    let refused = described(&config).expect_err("refused");
    assert!(refused.is_input());
    let message = refused.to_string();
    assert!(
        message.contains("position_deg_per_count: missing"),
        "{message}"
    );
    assert!(message.contains("axis B is rotary"), "{message}");
}
