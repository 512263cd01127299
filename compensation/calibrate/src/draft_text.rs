//! The text of a drafted calibration file.

use std::fmt::Write as _;

use volcomp_document::toml_string;
use volcomp_vocabulary::ErrorName;

use crate::draft::{LeftOver, Proposed, Question};
use crate::questions::{OPEN, question};

/// A squareness whose two straightnesses a draft has.
#[derive(Clone, Debug)]
pub(crate) struct Square {
    pub(crate) error: ErrorName,
    from: [ErrorName; 2],
    /// The angle of the references, µrad, where somebody has stated it.
    pub(crate) reference_angle_urad: Option<f64>,
}

impl Square {
    /// What is asked about it.
    pub(crate) fn question(&self) -> Question {
        Question {
            of: self.error.to_string(),
            key: "reference_angle_urad".to_owned(),
            question: question("reference_angle_urad", None),
        }
    }
}

/// The squarenesses against X and Y of which both straightnesses are there.
pub(crate) fn squares(proposed: &[Proposed]) -> Vec<Square> {
    const PAIRS: [(&str, [&str; 2]); 3] = [
        ("EC0Y", ["EXY", "EYX"]),
        ("EA0Z", ["EYZ", "EZY"]),
        ("EB0Z", ["EXZ", "EZX"]),
    ];
    let has = |error: &ErrorName| proposed.iter().any(|of| of.error == Some(*error));
    let mut squares = Vec::new();
    for (error, from) in PAIRS {
        let names = from.map(str::parse::<ErrorName>);
        if let (Ok(error), [Ok(first), Ok(second)]) = (error.parse(), names)
            && has(&first)
            && has(&second)
        {
            squares.push(Square {
                error,
                from: [first, second],
                reference_angle_urad: None,
            });
        }
    }
    squares
}

pub(crate) fn text(
    machine_file: &str,
    proposed: &[Proposed],
    squares: &[Square],
    conflicts: &[String],
    left_over: &[LeftOver],
) -> String {
    let mut text = String::from(
        "# Draft of a calibration file. Every \"?\" is a question that only the one who measured can answer;\n\
         # while there is one, `volcomp calibrate` refuses the file and names it. A key with a default may be taken out\n\
         # (\"Without it\"); what many questions have in common is answered at once by `--draft … --answer KEY=VALUE`.\n",
    );
    for conflict in conflicts {
        comment(&mut text, &format!("CONFLICT: {conflict}"));
    }
    for of in left_over {
        comment(&mut text, &format!("not used: {of}"));
    }
    // Writing to a String cannot fail.
    let _ = writeln!(text, "machine = {}", toml_string(machine_file));
    for of in proposed {
        text.push('\n');
        for said in of.said.iter().filter(|said| !said.is_empty()) {
            comment(&mut text, said);
        }
        for asked in of.questions() {
            comment(
                &mut text,
                &format!("QUESTION {}: {}", asked.key, asked.question),
            );
        }
        text.push_str("[[measurement]]\n");
        let error = of
            .error
            .map_or_else(|| OPEN.to_owned(), |error| error.to_string());
        let _ = writeln!(text, "error = \"{error}\"");
        match &of.files[..] {
            [only] => {
                let _ = writeln!(text, "file = {}", toml_string(only));
            }
            several => {
                comment(&mut text, &format!("files: {}", several.join(", ")));
                let _ = writeln!(text, "file = \"{OPEN}\"");
            }
        }
        if !of.at.is_empty() {
            let places: Vec<String> = of
                .at
                .iter()
                .map(|(axis, place)| match place {
                    Some(place) => format!("{axis} = {place:?}"),
                    None => format!("{axis} = \"{OPEN}\""),
                })
                .collect();
            let _ = writeln!(text, "at = {{ {} }}", places.join(", "));
        }
        for (key, value) in &of.keys {
            let _ = writeln!(text, "{key} = {value}");
        }
    }
    for square in squares {
        let [first, second] = square.from;
        text.push('\n');
        if square.reference_angle_urad.is_none() {
            let asked = square.question();
            comment(
                &mut text,
                &format!("QUESTION {}: {}", asked.key, asked.question),
            );
        }
        let angle = match square.reference_angle_urad {
            Some(angle) => format!("{angle:?}"),
            None => format!("\"{OPEN}\""),
        };
        let _ = writeln!(
            text,
            "[[squareness]]\nerror = \"{}\"\nfrom = [\"{first}\", \"{second}\"]\nreference_angle_urad = {angle}",
            square.error
        );
    }
    text
}

/// Comment lines; whatever stands in a file, it cannot leave the comment.
fn comment(text: &mut String, said: &str) {
    let clean: String = said
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    text.push_str("# ");
    text.push_str(&clean);
    text.push('\n');
}
