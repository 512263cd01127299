//! Tests of the document layer: whatever the text, an answer or a message with its place.

mod csv_file;

use proptest::prelude::*;
use volcomp_document::{Document, InputError};

fn first_number(text: &str) -> Result<f64, InputError> {
    Document::new("f.toml", text).decode(|root| {
        root.allow(&["a", "b"])?;
        root.require("a")?.number()
    })
}

#[test]
fn every_message_has_file_line_and_key() {
    let told = |text: &str| first_number(text).expect_err(text).to_string();
    insta::assert_snapshot!(
        [
            told(""),
            told("a = nan"),
            told("\n\na = [1]"),
            told("a = 1\nc = 2"),
            told("a = 1\na = 2"),
            told("a = "),
            told("a = 2020-01-01"),
        ]
        .join("\n")
    );
}

#[test]
fn whole_numbers_are_numbers() {
    assert_eq!(first_number("a = 0x10").ok(), Some(16.0));
    assert_eq!(first_number("a = -3").ok(), Some(-3.0));
    assert_eq!(first_number("a = 1_000").ok(), Some(1000.0));
}

proptest! {
    #[test]
    fn any_text_is_decoded_or_refused_with_a_line_that_is_there(text in "(?s).{0,60}") {
        if let Err(error) = first_number(&text) {
            prop_assert!(error.line >= 1 && error.line <= text.matches('\n').count() + 1);
            prop_assert!(error.span.end <= text.len() || error.span.start == 0);
        }
    }
}
