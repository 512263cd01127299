use volcomp_metrology::MotionKind;
use volcomp_vocabulary::{AxisKind, ErrorName};

/// Description of an error, such as `straightness deviation of X in Y`; empty if the name is invalid.
pub(crate) fn described(error: &str) -> String {
    let Ok(name) = error.parse::<ErrorName>() else {
        return String::new();
    };
    let axis = name.axis;
    let letter = match name.component.mcs_index() {
        0 => 'X',
        1 => 'Y',
        _ => 'Z',
    };
    let rotary = axis.kind() == AxisKind::Rotary;
    let own = name.component.mcs_index() == axis.mcs_index();
    if name.location {
        return "location error".to_owned();
    }
    match MotionKind::of(name) {
        MotionKind::Positioning => format!("positioning deviation of {axis}"),
        _ if name.component.is_angular() && !rotary && own => format!("roll of {axis}"),
        _ if name.component.is_angular() => {
            format!("tilt of {axis} about {letter}")
        }
        _ if rotary && own => format!("axial error motion of {axis}"),
        _ if rotary => format!("radial error motion of {axis} in {letter}"),
        _ => format!("straightness deviation of {axis} in {letter}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_described_in_words() {
        for (error, words) in [
            ("EXX", "positioning deviation of X"),
            ("EYX", "straightness deviation of X in Y"),
            ("EAX", "roll of X"),
            ("ECY", "tilt of Y about Z"),
            ("ECC", "positioning deviation of C"),
            ("EXC", "radial error motion of C in X"),
            ("EZC", "axial error motion of C"),
            ("EC0Y", "location error"),
            ("<b>", ""),
        ] {
            assert_eq!(described(error), words);
        }
    }
}
