//! The head of a column of readings: its name, alone or with a unit behind it.

use crate::DeviationUnit;

/// A head is a name alone or with its unit behind a blank or a mark: `target`, `target mm`, `target_mm`,
/// `deviation [µm]`. The unit; `None` where the head is another one.
pub(crate) fn unit_of<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let behind = head.get(name.len()..)?;
    let is_mark = |c: char| c.is_whitespace() || "_-/,:[](){}".contains(c);
    let is_named = head[..name.len()].eq_ignore_ascii_case(name);
    let ends_there = behind.is_empty() || behind.starts_with(is_mark);
    (is_named && ends_there).then(|| behind.trim_matches(is_mark))
}

/// Whether targets may be in this unit, which the file then states.
pub(crate) fn is_target_unit(unit: &str) -> bool {
    ["", "mm", "deg", "°"].contains(&unit.to_lowercase().as_str())
}

/// What deviations in a unit are held in, and how many of it one is; `None` for a unit that is not known.
pub(crate) fn deviation_unit(unit: &str) -> Option<(DeviationUnit, f64)> {
    use DeviationUnit::{Um, Urad};
    Some(match unit.to_lowercase().as_str() {
        "mm" => (Um, 1e3),
        // The micro sign becomes no Greek letter in lower case: both are written.
        "um" | "µm" | "μm" => (Um, 1.0),
        "nm" => (Um, 1e-3),
        "rad" => (Urad, 1e6),
        "mrad" => (Urad, 1e3),
        "urad" | "µrad" | "μrad" => (Urad, 1.0),
        "deg" | "°" => (Urad, 1e6_f64.to_radians()),
        "arcsec" => (Urad, (1e6 / 3600.0_f64).to_radians()),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_names_alone_or_with_a_unit() {
        for (head, unit) in [
            ("target", Some("")),
            ("Target mm", Some("mm")),
            ("target_mm", Some("mm")),
            ("target [deg]", Some("deg")),
            ("targets", None),
            ("tar", None),
            ("deviation", None),
            ("targeµ", None),
        ] {
            assert_eq!(unit_of(head, "target"), unit, "{head}");
        }
    }

    /// 1 arcsec is 4.848 µrad, 1° is 17453 µrad.
    #[test]
    fn units_are_brought_into_micrometres_and_microradians() {
        for (unit, held, size) in [
            ("mm", DeviationUnit::Um, 1000.0),
            ("µm", DeviationUnit::Um, 1.0),
            ("arcsec", DeviationUnit::Urad, 4.848_136_811),
            ("deg", DeviationUnit::Urad, 17_453.292_52),
        ] {
            let (found, factor) = deviation_unit(unit).unwrap();
            assert_eq!(found, held);
            assert!((factor / size - 1.0).abs() < 1e-9, "{unit}: {factor}");
        }
        assert_eq!(deviation_unit("inch"), None);
    }
}
