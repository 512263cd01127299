//! Why a plan does not fit, by the keys of the configuration file.

use volcomp_runtime::{
    PlanError,
    guard::{LimitsError, Quantity},
};
use volcomp_vocabulary::{AxisKind, AxisName};

/// The message of a plan that does not fit, with the keys that a person has to change.
pub(crate) fn by_keys(error: &PlanError) -> String {
    match error {
        PlanError::NoSuchFixedAxis {
            device,
            axis,
            machine,
            axes,
        } => {
            let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
            let letters = letters.join(" ");
            format!("{device}: fixed: axis {axis}: the machine {machine} has the axes {letters}")
        }
        PlanError::FixedPosition { device, axis } => format!(
            "{device}: fixed: axis {axis}: expected a finite {} coordinate",
            axis.kind()
        ),
        PlanError::FixedBeyond {
            device,
            axis,
            found,
            travel,
        } => format!(
            "{device}: fixed: axis {axis}: found {} {unit}, expected a position within its travel, {} to {} {unit}",
            found.mm_or_deg(),
            travel[0].mm_or_deg(),
            travel[1].mm_or_deg(),
            unit = axis.kind().coordinate_unit()
        ),
        PlanError::FixedRotary { device, axis } => format!(
            "{device}: fixed: axis {axis} turns, and nobody tells where it is: name it in reads = [\"{axis}\"] of a controller that shows its position, or, if no drive turns it, in not_driven = [\"{axis}\"] beside fixed"
        ),
        PlanError::NotDriven { device, axis } => format!(
            "{device}: not_driven: axis {axis}: expected a rotary axis whose position fixed states"
        ),
        PlanError::FixedIsShown { device, axis } => format!(
            "{device}: fixed: axis {axis} is one of the controller's axes, which shows where it stands"
        ),
        PlanError::Unwatched { device } => format!(
            "{device}: nothing at the control ramps the correction out when the gateway stops: name a heartbeat that the control watches, or state unwatched = true"
        ),
        PlanError::CycleTooShort {
            device,
            found_ms,
            shortest_ms,
        } => format!(
            "{device}: cycle_ms: found {found_ms} ms, expected at least {shortest_ms} ms, the shortest cycle of this device"
        ),
        PlanError::NoRotaryLimits { device, axis } => format!(
            "{device}: axis {axis} is rotary: [guard] limit_urad and slew_urad_per_s are missing"
        ),
        PlanError::Limits {
            device,
            axis,
            source,
        } => limits(device, *axis, source),
        PlanError::BeyondDevice {
            device,
            axis,
            found,
            largest,
        } => format!(
            "{device}: [guard] limit_{} of axis {axis}: found {found}, expected at most {largest}, the largest correction that this device can be told",
            axis.kind().micro_unit()
        ),
        other => other.to_string(),
    }
}

fn limits(device: &str, axis: Option<AxisName>, error: &LimitsError) -> String {
    let kind = axis.map_or(AxisKind::Linear, AxisName::kind);
    let unit = kind.micro_unit();
    let key = match error.what {
        Quantity::Resolution => format!("resolution_{unit}"),
        Quantity::Limit => format!("[guard] limit_{unit}"),
        Quantity::Warn => format!("[guard] warn_{unit}"),
        Quantity::Slew => format!("[guard] slew_{unit}_per_s"),
        Quantity::Accel => format!("[guard] accel_{unit}_per_s2"),
        Quantity::TestShift => format!("[guard] test_shift_{unit}"),
        Quantity::Axes => "axes".to_owned(),
        Quantity::Period => "cycle_ms".to_owned(),
        Quantity::Hold => "[guard] hold_ms".to_owned(),
        Quantity::ZeroAfter => "[guard] zero_after_ms".to_owned(),
        Quantity::ReadBack => {
            "cycles until a correction is read back, from [controller.barrier] scan_ms and cycle_ms"
                .to_owned()
        }
    };
    let of = axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
    let found = error.found();
    let expected = error.expected;
    let step = match error.what {
        Quantity::Limit if expected.contains("step") => step_keys(kind),
        _ => String::new(),
    };
    format!("{device}: {key}{of}: found {found}, expected {expected}{step}")
}

/// Where the step of an axis comes from.
fn step_keys(kind: AxisKind) -> String {
    let default = match kind {
        AxisKind::Linear => "1 µm",
        AxisKind::Rotary => "0.001°",
    };
    format!(
        ", which is resolution_{} ({default} where it is not stated; on CAN the factor in the DBC file)",
        kind.micro_unit()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_keys_of_the_configuration() {
        let device = || "focas://control".to_owned();
        let limit = PlanError::Limits {
            device: device(),
            axis: Some(AxisName::Z),
            source: LimitsError {
                what: Quantity::Limit,
                axis: Some((0, AxisKind::Linear)),
                found: 0.0005,
                expected: "at least one step of the controller",
            },
        };
        assert_eq!(
            by_keys(&limit),
            "focas://control: [guard] limit_um of axis Z: found 0.5 µm, expected at least one step of the controller, which is resolution_um (1 µm where it is not stated; on CAN the factor in the DBC file)"
        );
        for (error, key) in [
            (
                PlanError::NoRotaryLimits {
                    device: device(),
                    axis: AxisName::B,
                },
                "limit_urad",
            ),
            (
                PlanError::Unwatched { device: device() },
                "unwatched = true",
            ),
            (
                PlanError::CycleTooShort {
                    device: device(),
                    found_ms: 4.0,
                    shortest_ms: 7.5,
                },
                "cycle_ms: found 4 ms, expected at least 7.5 ms",
            ),
        ] {
            let message = by_keys(&error);
            assert!(message.contains(key), "{message}");
            assert!(!error.to_string().contains(key), "{error}");
        }
    }
}
