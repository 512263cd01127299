//! The report as one self-contained HTML file with styles, script and pictures.

mod curves;
mod first_page;
mod positioning;
mod volume;
mod whole_machine;
mod write;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use sha2::{Digest as _, Sha256};

use self::write::Page;
use crate::{
    plot::{STYLE, colour_variables, escaped},
    report::Report,
};

const PAGE_STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Renders the report as an HTML file. The same report gives the same bytes.
pub fn html(report: &Report) -> String {
    let style = format!("{}{PAGE_STYLE}{STYLE}", colour_variables());
    let title = match &report.head.machine {
        Some(machine) => format!("Calibration report – {machine}"),
        None => "Calibration report".to_owned(),
    };
    let mut page = Page {
        text: format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src '{}'; script-src '{}'; base-uri 'none'; form-action 'none'\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <meta name=\"generator\" content=\"volcomp {}\">\
             <title>{}</title><style>{style}</style></head><body><main>",
            hash(&style),
            hash(SCRIPT),
            escaped(&report.version),
            escaped(&title)
        ),
    };
    first_page::head(&mut page, report);
    let sections: [(&str, &str, Section); 11] = [
        ("verdict", "Verdict", first_page::verdict),
        ("warnings", "Warnings", first_page::warnings),
        ("curves", "Error curves", curves::curves),
        ("positioning", "Positioning tests (ISO 230-2)", positioning::positioning),
        ("squareness", "Squareness", volume::squareness),
        ("diagonals", "Body diagonals (ISO 230-6)", volume::diagonals),
        ("volume", "Volumetric error", volume::volume),
        ("uncertainty", "Uncertainty", whole_machine::uncertainty),
        ("open", "What was not measured", whole_machine::open),
        ("identified", "Identifiability", whole_machine::identified),
        ("files", "Measurement files", first_page::files),
    ];
    let shown = sections.into_iter().filter(|(id, _, _)| match *id {
        "identified" => report.identified.is_some(),
        "files" => !report.head.files.is_empty(),
        _ => true,
    });
    let shown: Vec<_> = shown.collect();
    page.put("<nav class=\"screen\" aria-label=\"Contents\">");
    for (number, (id, name, _)) in shown.iter().enumerate() {
        page.put(&format!(
            "<a href=\"#{id}\"><span class=\"no\">{}</span>{}</a>",
            number + 1,
            escaped(name)
        ));
    }
    page.put("</nav>");
    for (number, (id, name, section)) in shown.iter().enumerate() {
        page.put(&format!(
            "<section id=\"{id}\"><h2><span class=\"no\">{}</span>{}</h2>",
            number + 1,
            escaped(name)
        ));
        section(&mut page, report);
        page.put("</section>");
    }
    page.put(&format!("<footer>Made by volcomp {}. The same input gives the same bytes.</footer></main><script>{SCRIPT}</script></body></html>\n", escaped(&report.version)));
    page.text
}

type Section = fn(&mut Page, &Report);

/// Hash source of a script or a style for the content security policy.
fn hash(text: &str) -> String {
    format!("sha256-{}", STANDARD.encode(Sha256::digest(text.as_bytes())))
}
