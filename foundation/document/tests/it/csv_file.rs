//! Tests of CSV tables: separators, decimal commas, and positions in messages.

use proptest::prelude::*;
use volcomp_document::{CsvBatches, CsvTable, InputError};

fn columns_x_y(text: &str) -> Result<Vec<[f64; 2]>, InputError> {
    let table = CsvTable::parse("p.csv", text)?;
    let (x, y) = (table.require("X")?, table.require("Y")?);
    let row =
        |row: volcomp_document::CsvRow<'_>| Ok([row.cell(x).number()?, row.cell(y).number()?]);
    table.rows().map(row).collect()
}

/// Separator, whether numbers have decimal commas, names of the columns, and cells of the rows.
type Content = (char, bool, Vec<String>, Vec<Vec<String>>);

fn at_once(text: &str) -> Result<Content, InputError> {
    let table = CsvTable::parse("p.csv", text)?;
    let columns: Vec<_> = table.columns().collect();
    let cells = |row: volcomp_document::CsvRow<'_>| {
        let cells = columns.iter().map(|(column, _)| row.cell(*column).text());
        cells.map(str::to_owned).collect()
    };
    let names = columns.iter().map(|(_, name)| (*name).to_owned()).collect();
    let rows = table.rows().map(cells).collect();
    Ok((table.separator(), table.has_decimal_comma(), names, rows))
}

/// Content of the text when it is read in batches of at most `most` rows.
fn in_batches(text: &str, most: usize) -> std::io::Result<Content> {
    let mut batches = CsvBatches::open("p.csv", std::io::Cursor::new(text))?;
    let head = batches.head();
    let columns: Vec<_> = head.columns().map(|(column, _)| column).collect();
    let names = head.columns().map(|(_, name)| name.to_owned()).collect();
    let (separator, has_comma) = (head.separator(), head.has_decimal_comma());
    let mut rows = Vec::new();
    loop {
        let batch = batches.next_rows(most)?;
        if batch.rows().len() == 0 {
            return Ok((separator, has_comma, names, rows));
        }
        assert!(batch.rows().len() <= most && batch.has_decimal_comma() == has_comma);
        for row in batch.rows() {
            let cells = columns.iter().map(|column| row.cell(*column).text());
            rows.push(cells.map(str::to_owned).collect());
        }
    }
}

#[test]
fn every_usual_way_to_write_a_table_gives_the_same_numbers() {
    let expected = [[1.5, -20.0], [0.25, 1e3]];
    for text in [
        "X,Y\n1.5,-20\n0.25,1e3\n",
        "X;Y\n1,5;-20\n0,25;1e3\n",
        "X;Y\r\n1.5;-20\r\n\r\n0.25;1000.0\r\n",
        "X\tY\n1,5\t-20,0\n0,25\t1e3\n",
        "\u{feff}x ; y\n 1,5 ; -20 \n0,25;1e3",
        "sep=;\r\nX;Y\r\n1,5;-20\r\n0,25;1e3\r\n",
        "Y;note;X\n-20;\"a;b\";1,5\n1e3;;0,25\n",
        "X;Y;\n1,5;-20;\n;;\n0,25;1e3;;;\n",
        "# Measured by hand, in the evening; X first\n#\n\nX,Y\n1.5,-20\n0.25,1e3\n",
        "\u{feff}#, a, b, c\r\nX;Y\r\n1,5;-20\r\n0,25;1e3\r\n",
        "\"X\",\"Y\"\n\"1.5\",\"-20\"\n0.25,1e3\n",
    ] {
        assert_eq!(columns_x_y(text).unwrap(), expected, "{text:?}");
    }
}

#[test]
fn every_message_has_file_line_and_column() {
    let told = |text: &str| {
        let error = columns_x_y(text).expect_err(text);
        assert!(error.text.get(error.span.clone()).is_some(), "{text:?}");
        error.to_string()
    };
    insta::assert_snapshot!(
        [
            told(""),
            told("\n \n"),
            told("X;Z\n1;2\n"),
            told("X,y,Y\n1,2,3\n"),
            told("X,Y\n1,2\n3\n"),
            told("X,Y\n\n\n1,5,2\n"),
            told("Machine: mill\nOperator: none\nX,Y\n1,2\n"),
            told("X,Y\n\"1,2\n3,4\n"),
            told("X;Y\n1,5;2\n\n1.234;5\n"),
            told("X;Y\n1.234,5;2\n"),
            told("X,Y\n1,nan\n"),
            told("X,Y\n1,\n"),
        ]
        .join("\n")
    );
}

#[test]
fn the_span_of_an_error_is_its_row() {
    let text = "X,Y\r\n\r\n1,2\r\n3,far\r\n5,6\r\n";
    let error = columns_x_y(text).unwrap_err();
    assert_eq!(&error.text[error.span], "3,far");
}

#[test]
fn columns_that_are_not_known_are_named() {
    let table = CsvTable::parse("p.csv", "X;Remark;y;;Operator\n1;a;2;;b\n").unwrap();
    assert_eq!(table.names_besides(&["X", "Y"]), ["Remark", "Operator"]);
    assert_eq!(table.separator(), ';');
}

proptest! {
    #[test]
    fn any_text_is_read_or_refused_with_a_line_that_is_there(text in "(?s)(X[,;\t]Y\r?\n)?[XY0-9,;\t\"\r\n.é ]{0,40}") {
        if let Err(error) = columns_x_y(&text) {
            prop_assert!(error.line >= 1 && error.line <= text.matches('\n').count() + 1);
            prop_assert!(error.text.get(error.span.clone()).is_some(), "{:?}", error.span);
        }
    }

    #[test]
    fn batches_have_the_rows_of_the_whole_text(
        text in "(\u{feff}|sep=[,;\t]\r?\n|#,;\r?\n|\n){0,3}([X,;\t\"]{0,5}\r?\n)?[X05,;\t\"\r\n.é ]{0,40}",
        most in 1_usize..4,
    ) {
        prop_assert_eq!(in_batches(&text, most).ok(), at_once(&text).ok());
    }

    #[test]
    fn numbers_are_the_same_with_point_and_comma(rows in prop::collection::vec((-1e9..1e9, -1e9..1e9), 1..9)) {
        let lines: Vec<String> = rows.iter().map(|(x, y)| format!("{x};{y}\n")).collect();
        let text = format!("X;Y\n{}", lines.concat());
        let expected: Vec<[f64; 2]> = rows.into_iter().map(|(x, y)| [x, y]).collect();
        prop_assert_eq!(&columns_x_y(&text).unwrap(), &expected);
        prop_assert_eq!(&columns_x_y(&text.replace('.', ",")).unwrap(), &expected);
        prop_assert_eq!(&columns_x_y(&text.replace(';', ",")).unwrap(), &expected);
    }
}

#[test]
fn remarks_count_as_lines_and_halves_of_numbers_are_told() {
    let told = |text: &str| columns_x_y(text).expect_err(text).to_string();
    let message = told("# a\n# b\nX,Y\n1,x\n");
    assert!(message.starts_with("p.csv:4: Y: "), "{message}");
    let hint = "; if numbers have decimal commas, separate the columns by semicolons";
    let message = told("X,Y\n1,5,-20,0\n");
    assert!(message.contains("found 4 columns") && message.ends_with(hint), "{message}");
    let message = told("X,Y\n1.5,-20.5,3.5\n");
    assert!(message.contains("found 3 columns") && !message.contains(hint), "{message}");
    // The message shows quotation marks inside a quoted cell.
    let message = told("\"X \"\"a\"\"\",Z\n1,2\n");
    assert!(message.contains("found `X \"a\",Z`"), "{message}");
}

/// A quotation mark that is not closed is rejected in any cell, because the rows behind it would become part of that
/// cell.
#[test]
fn a_quote_that_is_not_closed_is_refused() {
    for rows in ["1,\"2\n3,4\n5,6\n", "\"1,2\n3,4\n", "1,\"2\n3,4\n5,\"6\"\n"] {
        let text = format!("X,Y\n{rows}");
        let message = columns_x_y(&text).expect_err(rows).to_string();
        let expected = "p.csv:2: found a cell of several lines, expected one line a row: is a double quote not closed?";
        assert_eq!(message, expected, "{rows}");
        assert!(in_batches(&text, 1).is_err(), "{rows}");
    }
    assert_eq!(columns_x_y("X,Y\n1,\"2\n").unwrap(), [[1.0, 2.0]]);
}
