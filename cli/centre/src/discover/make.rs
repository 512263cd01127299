//! The make and type of a control, read from what a server says of itself. A server tells its product as a URI, which names the
//! software and no control.

/// Words by which makers name themselves, and their names.
const MAKERS: [(&str, &str); 12] = [
    ("volcomp", "volcomp-gateway"),
    ("siemens", "Siemens"),
    ("simatic", "Siemens"),
    ("heidenhain", "HEIDENHAIN"),
    ("fanuc", "FANUC"),
    ("beckhoff", "Beckhoff"),
    ("rexroth", "Bosch Rexroth"),
    ("fagor", "Fagor"),
    ("mitsubishi", "Mitsubishi Electric"),
    ("okuma", "Okuma"),
    ("mazak", "Mazak"),
    ("haas", "Haas"),
];

/// Words that can follow `SINUMERIK` as its type.
const SINUMERIK_TYPES: [&str; 8] = [
    "one",
    "840d",
    "840de",
    "840dsl",
    "828d",
    "808d",
    "808dadvanced",
    "sl",
];

/// The make, and the type where it is told; empty where the texts name no maker.
pub(super) fn make_of(texts: &[&str]) -> String {
    let words: Vec<&str> = texts
        .iter()
        .flat_map(|text| text.split(|letter: char| !letter.is_alphanumeric()))
        .filter(|word| !word.is_empty())
        .collect();
    let is_type =
        |word: &&str| (SINUMERIK_TYPES.iter()).any(|kind| word.eq_ignore_ascii_case(kind));
    // Its type stands behind its name where there is one, in whichever of the texts that is; a number alone tells it, too.
    let places = words.iter().enumerate();
    let named = places.filter(|(_, word)| tells(word, "sinumerik"));
    let types = named.map(|(place, _)| {
        let behind = words.iter().skip(place + 1).copied();
        behind.take_while(is_type).collect::<Vec<_>>()
    });
    if let Some(behind) = types.max_by_key(Vec::len) {
        let has_number = |word: &&str| word.starts_with(|letter: char| letter.is_ascii_digit());
        let number = words
            .iter()
            .copied()
            .find(|word| has_number(word) && is_type(word));
        let kind = if behind.is_empty() {
            number.into_iter().collect()
        } else {
            behind
        };
        let all: Vec<&str> = ["Siemens", "SINUMERIK"].into_iter().chain(kind).collect();
        return all.join(" ");
    }
    let mut known = MAKERS.iter();
    let maker = known.find(|(name, _)| words.iter().any(|word| tells(word, name)));
    maker.map_or_else(String::new, |(_, name)| (*name).to_owned())
}

/// Whether a word is a name, or has a long one in it, as `SinumerikOpcUaServer` has.
fn tells(word: &str, name: &str) -> bool {
    if name.len() < 6 {
        word.eq_ignore_ascii_case(name)
    } else {
        word.to_ascii_lowercase().contains(name)
    }
}

#[cfg(test)]
mod tests {
    use super::make_of;

    #[test]
    fn a_make_is_read_and_a_uri_is_none() {
        for (texts, make) in [
            (["SINUMERIK 840D sl", "urn:x"], "Siemens SINUMERIK 840D sl"),
            (
                ["OPC UA", "urn:siemens:sinumerik:server"],
                "Siemens SINUMERIK",
            ),
            (["sinumerik one", ""], "Siemens SINUMERIK one"),
            (["SinumerikOpcUaServer", "urn:x:one"], "Siemens SINUMERIK"),
            (["OPCUAServer@840D", "sinumerik"], "Siemens SINUMERIK 840D"),
            (["", "http://www.beckhoff.com/TwinCAT"], "Beckhoff"),
            (["server", "urn:control"], ""),
            (["FreeOpcUa", "urn:freeopcua:python:server"], ""),
            // A name within a word is none.
            (["haastings", "urn:unfanuclike"], ""),
        ] {
            assert_eq!(make_of(&texts), make, "{texts:?}");
        }
    }
}
