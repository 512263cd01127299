//! The kept inputs of the fuzz targets `table_…`.

use std::fs;

use volcomp_tables::axis_table::Format;

use super::read_text;

#[test]
fn the_corpus_is_read_and_refused_as_its_names_say() {
    let mut targets = 0;
    for format in Format::ALL {
        let folder = volcomp_test_support::root()
            .join("tests/fuzz/corpus")
            .join(format!("table_{}", format.name().replace('-', "_")));
        if format == Format::HeidenhainTnc407 {
            // Read as those of the iTNC 530.
            continue;
        }
        let mut seen = [0; 2];
        for entry in
            fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        {
            let path = entry.expect("an entry").path();
            let name = path
                .file_name()
                .expect("a name")
                .to_string_lossy()
                .into_owned();
            let text = String::from_utf8(fs::read(&path).expect("read")).expect("UTF-8");
            let is_valid = name.starts_with("valid-");
            let found = read_text(format, "X.comp", &text);
            assert_eq!(found.is_ok(), is_valid, "{format} {name}: {found:?}");
            seen[usize::from(is_valid)] += 1;
        }
        assert!(seen.iter().all(|count| *count >= 1), "{format}: {seen:?}");
        targets += 1;
    }
    assert_eq!(targets, 11);
}
