use std::collections::BTreeSet;

use volcomp_report::html;

use crate::browser::whole;

/// Texts between the tags of a page, without styles and scripts.
fn between_tags(page: &str) -> Vec<String> {
    let mut rest = page;
    let mut found = Vec::new();
    while let Some((text, after)) = rest.split_once('<') {
        found.push(text.split_whitespace().collect::<Vec<_>>().join(" "));
        let unseen = ["style", "script"].into_iter().find(|tag| after.starts_with(tag));
        let end = unseen.map_or_else(|| ">".to_owned(), |tag| format!("</{tag}>"));
        rest = after.split_once(&end).map_or("", |(_, rest)| rest);
    }
    found.push(rest.trim().to_owned());
    found
}

/// Snapshot of each distinct text of a page, without the numbers, which change with the model.
#[test]
fn words_of_a_report() {
    let page = html(&whole());
    let words = |text: &String| -> String {
        let keep =
            |word: &&str| !word.starts_with(|c: char| c.is_ascii_digit() || "-±−".contains(c));
        text.split(' ').filter(keep).collect::<Vec<_>>().join(" ")
    };
    // Texts with file paths differ between computers.
    let texts = between_tags(&page);
    let texts: BTreeSet<String> = (texts.iter())
        .filter(|text| !text.contains('/'))
        .map(words)
        .filter(|text| text.contains(' '))
        .collect();
    insta::assert_snapshot!(texts.into_iter().collect::<Vec<_>>().join("\n"));
}
