//! The head of a column of readings: its name, alone or with a unit behind it.

use volcomp_document::split_head;

/// A head is a name alone or with its unit behind a blank or a mark: `target`, `target mm`, `target_mm`,
/// `deviation [µm]`. The unit; `None` where the head is another one.
pub(crate) fn unit_of<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let (found, unit) = split_head(head);
    found.eq_ignore_ascii_case(name).then_some(unit)
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
}
