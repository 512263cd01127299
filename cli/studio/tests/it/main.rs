//! The studio as a library: the folder alone, and the page over HTTP.

mod folder;
mod http;

use std::{fs, path::Path};

use tempfile::TempDir;
use volcomp_studio::{Folder, TypedAnswer};

/// A folder with one positioning test of a machine with one axis.
pub(crate) fn small() -> (TempDir, Folder) {
    let dir = tempfile::tempdir().expect("writable");
    let folder = Folder::open(dir.path()).expect("there");
    let machine = "name = \"small\"\nstructure = \"w b X Y Z t\"\naxes.X.travel = [0.0, 400.0]\naxes.Y.travel = [0.0, 300.0]\naxes.Z.travel = [-200.0, 0.0]\n";
    folder.set_machine("machine.toml", machine).expect("a machine");
    folder.receive("exx.csv", SLOPE.as_bytes()).expect("taken");
    (dir, folder)
}

/// A deviation of 20 µm/m, thus 8 µm at 400 mm.
pub(crate) const SLOPE: &str = "target_mm,run,direction,deviation_um\n0,1,+,0\n100,1,+,2\n200,1,+,4\n300,1,+,6\n400,1,+,8\n0,2,+,0.1\n100,2,+,2.1\n200,2,+,4.1\n300,2,+,6.1\n400,2,+,8.1\n";

pub(crate) fn defaults(folder: &Folder) -> Vec<TypedAnswer> {
    let draft = folder.state().expect("readable").draft.expect("drafted");
    let questions = draft.questions.into_iter();
    questions
        .filter_map(|question| {
            Some(TypedAnswer { value: question.default?, of: question.of, key: question.key })
        })
        .collect()
}

pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let path = entry.expect("readable").path();
        let target = to.join(path.file_name().expect("a name"));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, target).expect("writable");
        }
    }
}
