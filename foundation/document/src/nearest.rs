//! The word that was probably meant.

/// The known word that differs least from `found`, if it differs in few enough letters to be a slip of the hand; case
/// does not count.
pub fn nearest<'k>(found: &str, known: &[&'k str]) -> Option<&'k str> {
    let found: Vec<char> = found.to_lowercase().chars().collect();
    let most = (found.len() / 3).clamp(1, 3);
    let near = known.iter().filter_map(|word| {
        let letters: Vec<char> = word.to_lowercase().chars().collect();
        let slips = slips(&found, &letters);
        // Of a word as short as the slip nothing would be left.
        (slips <= most && slips < letters.len()).then_some((slips, *word))
    });
    let near = near.min_by_key(|(slips, _)| *slips).map(|(_, word)| word);
    near.or_else(|| without_suffix(&found, known))
}

/// The shortest known word that begins with the one that was found and `_`: a unit was left out, as in `limit` for
/// `limit_um`.
fn without_suffix<'k>(found: &[char], known: &[&'k str]) -> Option<&'k str> {
    let found: String = found.iter().collect();
    let longer = known.iter().copied().filter(|word| {
        let rest = word.to_lowercase();
        let rest = rest.strip_prefix(&found).map(str::to_owned);
        !found.is_empty() && rest.is_some_and(|rest| rest.starts_with('_'))
    });
    longer.min_by_key(|word| word.len())
}

/// The least number of letters left out, added, changed, or swapped with their neighbour, that make one word the other
/// (optimal string alignment).
fn slips(from: &[char], to: &[char]) -> usize {
    let mut above: Vec<usize> = vec![0; to.len() + 1];
    let mut row: Vec<usize> = (0..=to.len()).collect();
    for (i, letter) in from.iter().enumerate() {
        let mut next = vec![i + 1];
        for (j, other) in to.iter().enumerate() {
            let changed = row[j] + usize::from(letter != other);
            let mut least = changed.min(row[j + 1] + 1).min(next[j] + 1);
            let is_swap = i > 0 && j > 0 && from[i - 1] == *other && to[j - 1] == *letter;
            if is_swap {
                least = least.min(above[j - 1] + 1);
            }
            next.push(least);
        }
        above = std::mem::replace(&mut row, next);
    }
    row.last().copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_counted_as_by_hand() {
        for (from, to, expected) in [
            ("travel", "travel", 0),
            ("travl", "travel", 1),
            ("tarvel", "travel", 1),
            ("kitten", "sitting", 3),
            ("", "abc", 3),
            ("abc", "", 3),
        ] {
            let [from, to] = [from, to].map(|word| word.chars().collect::<Vec<_>>());
            assert_eq!(slips(&from, &to), expected, "{from:?} {to:?}");
        }
    }

    #[test]
    fn only_a_slip_of_the_hand_is_taken_for_another_word() {
        let known = ["travel", "point", "direction", "modulo"];
        assert_eq!(nearest("Travl", &known), Some("travel"));
        assert_eq!(nearest("poitn", &known), Some("point"));
        assert_eq!(nearest("backlash", &known), None);
        assert_eq!(nearest("x", &["y"]), None);
        assert_eq!(nearest("", &known), None);
    }

    #[test]
    fn a_key_without_its_unit_is_taken_for_the_key() {
        let known = [
            "_um",
            "limit_without_barrier_um",
            "limit_um",
            "limit_urad",
            "hold_ms",
        ];
        assert_eq!(nearest("limit", &known), Some("limit_um"));
        assert_eq!(nearest("hold", &known), Some("hold_ms"));
        assert_eq!(nearest("lim", &known), None);
        assert_eq!(nearest("", &known), None);
    }
}
