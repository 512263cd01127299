//! Replays the fuzz corpus: responses, requests and headers parse as what their file names state.

use std::path::Path;

use volcomp_focas::frame::{Blocks, HEAD, Head, Request, parse_commands};

#[test]
fn corpus_frames_parse() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/focas");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).unwrap();
        let head = bytes.first_chunk().map(Head::parse);
        let blocks = Blocks::parse(&bytes).map(Iterator::collect::<Vec<_>>);
        let commands = parse_commands(&bytes);
        if name.starts_with("answer-") {
            assert!(blocks.unwrap().iter().all(Result::is_ok), "{name}");
        } else if name.starts_with("request-") {
            let request = Request::new(commands.as_ref().unwrap()).unwrap();
            assert_eq!(request.bytes()[HEAD..], bytes, "{name}");
        } else if name.starts_with("head-") {
            assert!(head.unwrap().is_ok(), "{name}");
        }
        seen += 1;
    }
    assert!(seen >= 5);
}
