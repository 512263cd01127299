//! Tests that every text gives a value, or an error with its position.

use proptest::prelude::*;
use volcomp_document::{CsvBatches, CsvTable, Document, InputError, ReadError, Section, read_text};

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

fn asked<T>(
    text: &str,
    decode: impl FnOnce(&Section<'_>) -> Result<T, InputError>,
) -> Result<T, InputError> {
    Document::new("f.toml", text).decode(|root| decode(&root))
}

#[test]
fn lookups_name_what_they_expect() {
    const WORDS: [(&str, u8); 2] = [("binary", 1), ("gray", 2)];
    let number = |text, range| asked(text, |s| s.number_or("a", range, 7.0)).map_err(|e| told(&e));
    let whole = |text| asked(text, |s| s.whole_or("a", 1..=60_u16, 9)).map_err(|e| told(&e));
    let word = |text| asked(text, |s| s.one_of("a", &WORDS, 0)).map_err(|e| told(&e));
    let truth = |text| asked(text, |s| s.truth_or("a", true)).map_err(|e| told(&e));
    let positive = |text| asked(text, |s| s.require("a")?.positive()).map_err(|e| told(&e));
    let tables =
        |text| asked(text, |s| s.tables("a", |t| t.require("n")?.number())).map_err(|e| told(&e));
    insta::assert_snapshot!(
        [
            format!("{:?}", number("", 0.0..=1.0)),
            format!("{:?}", number("a = 1", 0.0..=1.0)),
            format!("{:?}", number("a = 1.5", 0.0..=1.0)),
            format!("{:?}", number("a = -1", 0.0..=f64::INFINITY)),
            format!("{:?}", number("a = 3", f64::NEG_INFINITY..=2.0)),
            format!("{:?}", whole("")),
            format!("{:?}", whole("a = 0x3c")),
            format!("{:?}", whole("a = 61")),
            format!("{:?}", whole("a = -1")),
            format!("{:?}", whole("a = 99999999999999999999999999999999999999999999")),
            format!("{:?}", whole("a = 1.0")),
            format!("{:?}", word("")),
            format!("{:?}", word("a = \"gray\"")),
            format!("{:?}", word("a = \"grey\"")),
            format!("{:?}", truth("")),
            format!("{:?}", truth("a = 1")),
            format!("{:?}", positive("a = 0")),
            format!("{:?}", tables("")),
            format!("{:?}", tables("[[a]]\nn = 1\n[[a]]\nn = 2")),
            format!("{:?}", tables("[[a]]\nn = 1\n[[a]]\nm = 2")),
            format!("{:?}", tables("[a]\nn = 1")),
        ]
        .join("\n")
    );
}

fn told(error: &InputError) -> String {
    error.to_string()
}

#[test]
fn files_that_cannot_be_read_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let latin = folder.path().join("latin.toml");
    std::fs::write(&latin, b"name = \"Fr\xe4se\"").unwrap();
    assert!(matches!(Document::read(&latin), Err(ReadError::Encoding { offset: 10, .. })));
    for path in [folder.path().to_owned(), folder.path().join("none.toml")] {
        let error = Document::read(&path).expect_err("no file");
        assert!(matches!(error, ReadError::System { .. }), "{error}");
        assert!(error.to_string().starts_with(&path.display().to_string()));
    }
    #[cfg(unix)]
    {
        // Without a writer, opening it would never return.
        let pipe = folder.path().join("pipe.toml");
        let made = std::process::Command::new("mkfifo").args(["-m", "600"]).arg(&pipe).status();
        assert!(made.unwrap().success());
        let expected =
            format!("{}: cannot be read: found a named pipe, expected a file", pipe.display());
        assert_eq!(Document::read(&pipe).expect_err("a pipe").to_string(), expected);
        let secret = volcomp_document::private::read(&pipe).expect_err("a pipe").to_string();
        assert!(secret.contains("found a named pipe"), "{secret}");
        assert!(volcomp_document::read_bytes(&pipe).is_err());
    }
    // A file far above the size limit would exhaust the memory of the reader.
    let large = folder.path().join("large.toml");
    for unit in ["[", "ä", "#"] {
        std::fs::write(&large, unit.repeat(6 * 1024 * 1024)).unwrap();
        let read = Document::read(&large).unwrap().decode(|_| Ok::<(), InputError>(()));
        let told = read.expect_err("too large").to_string();
        assert!(told.contains("4 MiB at most"), "{told}");
    }
    #[cfg(target_os = "linux")]
    {
        let endless = read_text(std::path::Path::new("/dev/zero")).expect_err("without an end");
        let expected =
            "/dev/zero: found more than 256 MiB, expected a text file of at most that size";
        assert_eq!(endless.to_string(), expected);
    }
    // Files that are small on disk, but large once parsed.
    let dotted = "a.".repeat(70);
    for (count, form) in [
        (1500, "{dotted}a{n} = 1\n"),
        (1500, "[{dotted}a{n}]\n"),
        (1500, "[[{dotted}a{n}]] # .\n"),
        (1500, "t{n} = { {dotted}a = 1 }\n"),
        (101_000, "a{n} = 1\n"),
    ] {
        let lines =
            (0..count).map(|n| form.replace("{dotted}", &dotted).replace("{n}", &n.to_string()));
        let text: String = lines.collect();
        let told = Document::new("many.toml", &text)
            .decode(|_| Ok::<(), InputError>(()))
            .expect_err("too many keys")
            .to_string();
        assert!(told.contains("100000 at most"), "{told}");
    }
    let points = "[1.25, -0.5],\n".repeat(120_000);
    let points = Document::new("points.toml", &format!("points = [\n{points}]\n"));
    points.decode(|_| Ok::<(), InputError>(())).unwrap();
    let good = folder.path().join("good.toml");
    std::fs::write(&good, "a = 3").unwrap();
    let read = Document::read(&good).unwrap().decode(|root| root.require("a")?.number());
    assert_eq!(read.ok(), Some(3.0));
}

proptest! {
    #[test]
    fn ranges_hold(number in -1e9..1e9_f64, low in -1e9..1e9_f64, high in -1e9..1e9_f64) {
        let text = format!("a = {number:?}");
        let found = asked(&text, |s| s.require("a")?.number_in(low..=high));
        prop_assert_eq!(found.ok(), (low <= number && number <= high).then_some(number));
    }

    #[test]
    fn whole_numbers_hold_their_range(number in any::<i64>(), low in any::<i16>(), high in any::<i16>()) {
        let text = format!("a = {number}");
        let found = asked(&text, |s| s.require("a")?.whole(low..=high));
        let within = i16::try_from(number).ok().filter(|n| (low..=high).contains(n));
        prop_assert_eq!(found.ok(), within);
    }

    /// Any lookup in any text returns a value or an error that names the file.
    #[test]
    fn no_lookup_panics(
        text in "(a( = |\\.b = |]\nb = )|\\[a\\]\n|\\[\\[a\\]\\]\n)?[-+a-f0-9.\"x_\\[\\]{}=, \n]{0,12}",
        low in any::<f64>(), high in any::<f64>(), most in any::<usize>(), key in "[ab]|.{0,3}",
    ) {
        let answers = asked(&text, |s| {
            let mut told = vec![
                s.number_or(&key, low..=high, low).err(),
                s.whole_or(&key, most..=usize::MAX, 0).err(),
                s.truth_or(&key, true).err(),
                s.one_of(&key, &[("a", 1)], 2).err(),
                s.tables(&key, |t| t.require(&key)?.text().map(str::to_owned)).err(),
            ];
            if let Some(value) = s.get(&key) {
                told.extend([
                    value.positive().err(),
                    value.count(most).err(),
                    value.vector::<3>().err(),
                    value.texts().err(),
                    value.one_of::<u8>(&[]).err(),
                ]);
            }
            Ok::<_, InputError>(told)
        });
        let told = answers.unwrap_or_else(|error| vec![Some(error)]);
        for error in told.into_iter().flatten() {
            prop_assert!(error.to_string().starts_with("f.toml:"));
        }
    }
}

/// The message of the TOML parser is kept unless it concerns a value. If the first line is valid TOML, the message has
/// no hint at the file format.
#[test]
fn text_that_is_no_toml_is_told_in_words_of_the_file() {
    for (text, expected) in [
        ("a = 1\na = 12.5", "f.toml:2: the key `a` appears twice, expected each key once"),
        ("at = { X = 1, Y = 3,5 }", "f.toml:1: found `Y = 3,5`, expected a decimal point: Y = 3.5"),
        (
            "at = { Y = -3,25, Z = 1 }",
            "f.toml:1: found `Y = -3,25`, expected a decimal point: Y = -3.25",
        ),
        ("a = 12,5", "f.toml:1: found `12,5`, expected a decimal point: 12.5"),
        (
            "point = [0, 0,05, -550]",
            "f.toml:1: found `0,05`, expected a decimal point: 0.05 (TOML has no decimal commas)",
        ),
        (
            "at = 1\npoint = [\n  -3,007,\n]",
            "f.toml:3: found `-3,007`, expected a decimal point: -3.007 (TOML has no decimal commas)",
        ),
        (
            "a = oops",
            "f.toml:1: found `oops`, expected a number (12.5), a text in quotes (\"X\"), true or false",
        ),
        (
            "\n# readings\ntarget,deviation\n0,1.5\n",
            "f.toml:3: found `target,deviation`, expected TOML: `key = value` or `[table]`",
        ),
        (
            "target;deviation\n0;1,5\n",
            "f.toml:1: found `target;deviation`, expected TOML: `key = value` or `[table]`",
        ),
    ] {
        let told = first_number(text).expect_err(text).to_string();
        assert_eq!(told, expected);
    }
}

#[test]
fn a_file_of_another_kind_is_named_with_the_key_that_tells() {
    use volcomp_document::FileKind;
    let read = |text: &str| {
        let decode = |root: Section<'_>| root.allow_in(FileKind::Machine, &["name", "structure"]);
        let told = Document::new("f.toml", text).decode(decode);
        told.map_err(|e| e.to_string())
    };
    assert_eq!(read("name = 1\nstructure = 2"), Ok(()));
    for (text, expected) in [
        (
            "name = 1\n[[controller]]",
            "found a configuration of the gateway (it has the key `controller`)",
        ),
        ("[[measurement]]\nx = 1", "found a calibration file (it has the key `measurement`)"),
        // The key `structure` identifies a machine file, in which the key `guard` is unknown.
        (
            "structure = 1\n[guard]",
            "f.toml:2: guard: unknown key, expected one of: name, structure",
        ),
        ("strukture = 1", "did you mean `structure`?"),
    ] {
        let message = read(text).expect_err(text);
        assert!(message.contains(expected), "{text}: {message}");
    }
    // A key that is expected here does not identify another kind of file that also has this key.
    let decode = |root: Section<'_>| root.allow_in(FileKind::Calibration, &["machine", "unknown"]);
    let told = Document::new("f.toml", "unknown = []\nmachin = 1").decode(decode);
    let message = told.expect_err("a wrong key").to_string();
    assert!(message.contains("did you mean `machine`?"), "{message}");
}

/// Numbers above any quantity of a machine, whose calculations could overflow, are rejected with their position.
#[test]
fn numbers_that_overflow_are_refused() {
    for (text, expected) in [
        ("x = 1e15", None),
        ("x = -1e15", None),
        ("x = 1e-300", None),
        ("x = 1.1e15", Some("f.toml:1: x: found 1.1e15, expected a number from -1e15 to 1e15")),
        ("x = -1e308", Some("f.toml:1: x: found -1e308, expected a number from -1e15 to 1e15")),
        (
            "x = 9223372036854775807",
            Some("f.toml:1: x: found 9223372036854775807, expected a number from -1e15 to 1e15"),
        ),
        ("x = inf", Some("f.toml:1: x: found inf, expected a finite number")),
    ] {
        let found = Document::new("f.toml", text)
            .decode(|root| -> Result<f64, InputError> { root.require("x")?.number() });
        assert_eq!(found.err().map(|e| e.to_string()).as_deref(), expected, "{text}");
    }
    let table = CsvTable::parse("t.csv", "x\n1e308\n").expect("a table");
    let column = table.column("x").expect("a header").expect("it is there");
    let cell = table.rows().next().expect("a row").cell(column).number();
    let message = cell.expect_err("refused").to_string();
    assert!(message.contains("expected a number from -1e15 to 1e15"), "{message}");
}

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
