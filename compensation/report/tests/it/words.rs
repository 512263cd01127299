//! Every word of a report in both languages, side by side.

use std::collections::BTreeSet;

use volcomp_report::{Language, html};

use crate::browser::whole;

/// What stands between the tags of a page, without styles and scripts.
fn between_tags(page: &str) -> Vec<String> {
    let mut rest = page;
    let mut found = Vec::new();
    while let Some((text, after)) = rest.split_once('<') {
        found.push(text.split_whitespace().collect::<Vec<_>>().join(" "));
        let unseen = ["style", "script"]
            .into_iter()
            .find(|tag| after.starts_with(tag));
        let end = unseen.map_or_else(|| ">".to_owned(), |tag| format!("</{tag}>"));
        rest = after.split_once(&end).map_or("", |(_, rest)| rest);
    }
    found.push(rest.trim().to_owned());
    found
}

/// The pages have the same texts in the same places; each that is not the same in both is listed once, and so is each sentence that is.
#[test]
fn words_in_english_and_german() {
    let report = whole();
    let [en, de] =
        [Language::En, Language::De].map(|language| between_tags(&html(&report, language)));
    assert_eq!(en.len(), de.len());
    let mut pairs = BTreeSet::new();
    let mut alike = BTreeSet::new();
    for (en, de) in en.iter().zip(&de) {
        // Numbers change with every mend of a model, words do not.
        let words = |text: &str| -> String {
            let keep =
                |word: &&str| !word.starts_with(|c: char| c.is_ascii_digit() || "-±−".contains(c));
            text.split(' ').filter(keep).collect::<Vec<_>>().join(" ")
        };
        if en != de {
            pairs.insert(format!("{} | {}", words(en), words(de)));
        // Texts with the path of a file are those of the programs, in English.
        } else if words(en).split(' ').count() > 2 && !en.contains('/') {
            alike.insert(words(en));
        }
    }
    let lines = |of: BTreeSet<String>| of.into_iter().collect::<Vec<_>>().join("\n");
    insta::assert_snapshot!(format!(
        "{}\n\nThe same in both:\n{}",
        lines(pairs),
        lines(alike)
    ));
}
