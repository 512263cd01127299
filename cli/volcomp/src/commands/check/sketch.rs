//! The chain as a drawing in text.

use std::fmt::Write;

use volcomp_kinematics::{Chain, Side};
use volcomp_vocabulary::AxisKind;

/// Two lines from the workpiece to the tool: the letters, and below each what it does.
///
/// ```text
///   w-----C'----X'----b-----Y-----Z-----B-----t
///  work  turn slide  bed  slide slide turn  tool
/// ```
pub(super) fn sketch(chain: &Chain) -> String {
    let mut places = vec![("w".to_owned(), "work")];
    let mut on_bed = false;
    let bed = || ("b".to_owned(), "bed");
    for joint in chain.joints() {
        if joint.side == Side::Tool && !on_bed {
            on_bed = true;
            places.push(bed());
        }
        let prime = if joint.side == Side::Workpiece {
            "'"
        } else {
            ""
        };
        let does = match joint.kind {
            AxisKind::Linear => "slide",
            AxisKind::Rotary => "turn",
        };
        places.push((format!("{}{prime}", joint.name), does));
    }
    if !on_bed {
        places.push(bed());
    }
    places.push(("t".to_owned(), "tool"));
    let last = places.len() - 1;
    let (mut letters, mut words) = ("   ".to_owned(), " ".to_owned());
    for (index, (letter, word)) in places.iter().enumerate() {
        letters += letter;
        if index < last {
            letters += &"-".repeat(6 - letter.chars().count());
        }
        // Writing to a string never fails.
        let _ = write!(words, "{word:^5} ");
    }
    format!("{letters}\n{}\n", words.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_stands_above_its_word() {
        let chain = |code: &str| Chain::new(code.parse().expect("a structure"));
        assert_eq!(
            sketch(&chain("w C' X' b Y Z B t")),
            "   w-----C'----X'----b-----Y-----Z-----B-----t\n work  turn  slide  bed  slide slide turn  tool\n"
        );
        let longest = sketch(&chain("w A' B' C' X' Y' Z' U' V' W' b t"));
        assert!(
            longest.lines().all(|line| line.chars().count() <= 80),
            "{longest}"
        );
        assert!(longest.contains("W'----b-----t"), "{longest}");
    }
}
