//! Messages about the content of files.

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

#[cfg(test)]
mod tests {
    use super::*;

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
