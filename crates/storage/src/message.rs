//! Messages about files and their content.

/// Characters at the beginning and at the end of a long message that are kept: what is quoted of a
/// damaged file may be as long as the file, and pushes the rest off a terminal.
const KEPT: (usize, usize) = (600, 300);

/// The message; without its middle if it is very long.
pub fn shortened(message: &str) -> String {
    let (begin, end) = KEPT;
    let count = message.chars().count();
    if count <= begin + end {
        return message.to_owned();
    }
    let chars = || message.chars();
    chars().take(begin).chain(" ... ".chars()).chain(chars().skip(count - end)).collect()
}

/// Line of a byte of a text, from 1.
pub fn line_at(text: &str, byte: usize) -> usize {
    text.bytes().take(byte).filter(|b| *b == b'\n').count() + 1
}

/// Names in a line.
const MAX_NAMES: usize = 8;

/// The first of many names in a line, and the number of the others.
pub fn listed(names: &[impl AsRef<str>]) -> String {
    let first: Vec<&str> = names.iter().take(MAX_NAMES).map(AsRef::as_ref).collect();
    let line = first.join(", ");
    match names.len().saturating_sub(MAX_NAMES) {
        0 => line,
        more => format!("{line} and {more} more"),
    }
}

/// Similarity by Jaro and Winkler of two names, 0 to 1, from which one may be meant by the other.
const MIN_SIMILARITY: f64 = 0.85;
/// Similarity that the same section counts as.
const SAME_SECTION: f64 = 0.01;

/// Of known keys, names behind dots, the one that an unknown key may mean: that of the same name in another
/// section, or the most similar name. `None` where none is alike.
pub fn nearest_key<'a>(key: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let parts = |key: &'a str| key.rsplit_once('.').unwrap_or(("", key));
    let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
    let similarity = |known: &'a str| {
        let (of_section, of_name) = parts(known);
        let similarity = strsim::jaro_winkler(name, of_name);
        let in_section = if of_section == section { SAME_SECTION } else { 0.0 };
        (similarity >= MIN_SIMILARITY).then_some((similarity + in_section, known))
    };
    let alike = known.into_iter().filter_map(similarity);
    alike.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, known)| known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_key_may_be_of_another_section_or_misspelt() {
        let known = ["seed", "camera.frames", "camera.fps", "mapping.iterations", "map.iterations"];
        let nearest = |key| nearest_key(key, known);
        assert_eq!(nearest("frames"), Some("camera.frames"));
        assert_eq!(nearest("mapping.iteration"), Some("mapping.iterations"));
        assert_eq!(nearest("map.itertions"), Some("map.iterations"));
        assert_eq!(nearest("camera.vignette"), None);
        assert_eq!(nearest_key("frames", []), None);
    }

    #[test]
    fn many_names_are_counted() {
        assert_eq!(listed(&["a.jpg", "b.jpg"]), "a.jpg, b.jpg");
        let names: Vec<String> = (0..10).map(|i| i.to_string()).collect();
        assert_eq!(listed(&names), "0, 1, 2, 3, 4, 5, 6, 7 and 2 more");
        assert_eq!(listed(&names[..8]), "0, 1, 2, 3, 4, 5, 6, 7");
    }

    #[test]
    fn long_messages_keep_their_ends() {
        assert_eq!(shortened("camera.json: fx is 'é'"), "camera.json: fx is 'é'");
        let long = format!("camera.json: fx is '{}', expected a number", "é".repeat(100_000));
        let short = shortened(&long);
        assert_eq!(short.chars().count(), 905);
        assert!(short.starts_with("camera.json: fx is 'é"), "{short}");
        assert!(short.ends_with("é', expected a number"), "{short}");
    }
}
