//! HTML building blocks; all text from files goes through [`escaped`].

use std::fmt::Write as _;

use crate::plot::{escaped, short};

/// A page under construction.
pub(crate) struct Page {
    pub(crate) text: String,
}

/// A cell of a table.
pub(crate) enum Cell {
    /// Text, left-aligned.
    Text(String),
    /// A number, right-aligned, with its decimals; a dash for `None`.
    Number(Option<f64>, usize),
    /// Text that may be broken anywhere: a file name.
    Path(String),
    /// Text that stays on one line.
    Fixed(String),
    /// Markup produced by this crate.
    Markup(String),
}

impl Cell {
    pub(crate) fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    pub(crate) fn number(value: f64, decimals: usize) -> Self {
        Self::Number(Some(value), decimals)
    }
}

impl Page {
    pub(crate) fn put(&mut self, markup: &str) {
        self.text += markup;
    }

    /// A paragraph of a class.
    pub(crate) fn paragraph(&mut self, class: &str, text: &str) {
        // Writing to a String cannot fail.
        let _ = write!(self.text, "<p class=\"{class}\">{}</p>", escaped(text));
    }

    /// A heading of a level.
    pub(crate) fn heading(&mut self, level: u8, text: &str, small: &str) {
        let small = if small.is_empty() {
            String::new()
        } else {
            format!("<small>{}</small>", escaped(small))
        };
        let _ = write!(self.text, "<h{level}>{}{small}</h{level}>", escaped(text));
    }

    /// A table that scrolls inside its frame if it is too wide. Columns whose name begins with `>` hold numbers.
    pub(crate) fn table(&mut self, columns: &[&str], rows: impl IntoIterator<Item = Vec<Cell>>) {
        self.text += "<div class=\"wide\"><table><thead><tr>";
        for column in columns {
            let (class, name) = match column.strip_prefix('>') {
                Some(name) => (" class=\"n\"", name),
                None => ("", *column),
            };
            let _ = write!(self.text, "<th{class}>{}</th>", escaped(name));
        }
        self.text += "</tr></thead><tbody>";
        for row in rows {
            self.text += "<tr>";
            for cell in row {
                let _ = match cell {
                    Cell::Text(text) => write!(self.text, "<td>{}</td>", escaped(&text)),
                    Cell::Path(text) => write!(
                        self.text,
                        "<td><span class=\"path\">{}</span></td>",
                        escaped(&text)
                    ),
                    Cell::Fixed(text) => {
                        write!(self.text, "<td class=\"fix\">{}</td>", escaped(&text))
                    }
                    Cell::Markup(markup) => write!(self.text, "<td>{markup}</td>"),
                    Cell::Number(value, decimals) => write!(
                        self.text,
                        "<td class=\"n\">{}</td>",
                        value.map_or_else(|| "–".to_owned(), |value| short(value, decimals))
                    ),
                };
            }
            self.text += "</tr>";
        }
        self.text += "</tbody></table></div>";
    }

    /// A picture in a frame that scrolls on narrow screens, with a caption.
    pub(crate) fn figure(&mut self, svg: &str, caption: &str) {
        self.text += "<figure>";
        if !caption.is_empty() {
            let _ = write!(self.text, "<figcaption>{}</figcaption>", escaped(caption));
        }
        let _ = write!(self.text, "<div class=\"scroll\">{svg}</div></figure>");
    }
}
