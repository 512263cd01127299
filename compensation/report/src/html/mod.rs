//! The report as one HTML file that needs nothing else: styles, script and pictures are in it.

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
    plot::{STYLE, escaped},
    report::Report,
    texts::{Language, Texts, texts},
};

const PAGE_STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// The report as an HTML file. The same report gives the same bytes.
pub fn html(report: &Report, language: Language) -> String {
    let t = texts(language);
    let style = format!("{PAGE_STYLE}{STYLE}");
    let title = match &report.head.machine {
        Some(machine) => format!("{} – {machine}", t.title),
        None => t.title.to_owned(),
    };
    let mut page = Page {
        text: format!(
            "<!DOCTYPE html>\n<html lang=\"{}\"><head><meta charset=\"utf-8\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src '{}'; script-src '{}'; base-uri 'none'; form-action 'none'\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <meta name=\"generator\" content=\"volcomp {}\">\
             <title>{}</title><style>{style}</style></head><body><main>",
            t.code,
            hash(&style),
            hash(SCRIPT),
            escaped(&report.version),
            escaped(&title)
        ),
    };
    first_page::head(&mut page, report, t);
    let sections: [(&str, &str, Section); 11] = [
        ("verdict", t.verdict, first_page::verdict),
        ("warnings", t.warnings, first_page::warnings),
        ("curves", t.curves, curves::curves),
        ("positioning", t.positioning, positioning::positioning),
        ("squareness", t.squareness, volume::squareness),
        ("diagonals", t.diagonals, volume::diagonals),
        ("volume", t.volume, volume::volume),
        ("uncertainty", t.uncertainty, whole_machine::uncertainty),
        ("open", t.open, whole_machine::open),
        ("identified", t.identified, whole_machine::identified),
        ("files", t.files, first_page::files),
    ];
    let shown = sections.into_iter().filter(|(id, _, _)| match *id {
        "identified" => report.identified.is_some(),
        "files" => !report.head.files.is_empty(),
        _ => true,
    });
    let shown: Vec<_> = shown.collect();
    page.put(&format!(
        "<nav class=\"screen\" aria-label=\"{}\">",
        escaped(t.contents)
    ));
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
        section(&mut page, report, t);
        page.put("</section>");
    }
    page.put(&format!(
        "<footer>{} {}. {}</footer></main><script>{SCRIPT}</script></body></html>\n",
        escaped(t.made_by),
        escaped(&report.version),
        escaped(t.same_bytes)
    ));
    page.text
}

type Section = fn(&mut Page, &Report, &Texts);

/// How a content security policy names a script or a style that may run.
fn hash(text: &str) -> String {
    format!(
        "sha256-{}",
        STANDARD.encode(Sha256::digest(text.as_bytes()))
    )
}
