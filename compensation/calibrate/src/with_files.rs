//! Notes on files, each told once.

/// Sentences, each once behind the names of all files that it is about, from pairs of a file's name and what is to be said of it: in the order
/// in which each was first said.
pub fn with_files(notes: impl IntoIterator<Item = (String, String)>) -> Vec<String> {
    let mut told: Vec<(String, Vec<String>)> = Vec::new();
    for (file, note) in notes {
        match told.iter_mut().find(|(text, _)| *text == note) {
            Some((_, files)) if files.contains(&file) => {}
            Some((_, files)) => files.push(file),
            None => told.push((note, vec![file])),
        }
    }
    let text = |(note, files): (String, Vec<String>)| format!("{}: {note}", files.join(", "));
    told.into_iter().map(text).collect()
}
