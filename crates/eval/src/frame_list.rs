//! Lists of frames for evaluation: text, one index in the associated stream per line.

/// Published lists, name and text; their first lines give the source.
pub const PUBLISHED: [(&str, &str); 9] = [
    ("tum-fr1-desk", include_str!("../lists/tum-fr1-desk.txt")),
    ("tum-fr1-desk-keyframes", include_str!("../lists/tum-fr1-desk-keyframes.txt")),
    ("tum-fr2-xyz", include_str!("../lists/tum-fr2-xyz.txt")),
    ("tum-fr3-office", include_str!("../lists/tum-fr3-office.txt")),
    ("tum-fr3-office-keyframes", include_str!("../lists/tum-fr3-office-keyframes.txt")),
    ("scannet-0024-01", include_str!("../lists/scannet-0024-01.txt")),
    ("scannet-0031-00", include_str!("../lists/scannet-0031-00.txt")),
    ("scannet-0736-00", include_str!("../lists/scannet-0736-00.txt")),
    ("scannet-0785-00", include_str!("../lists/scannet-0785-00.txt")),
];

/// The text of a published list.
pub fn published(name: &str) -> Option<&'static str> {
    PUBLISHED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Parses sorted, unique indices with `#` comments; the error is the number of an invalid line.
pub fn parse(text: &str) -> Result<Vec<usize>, usize> {
    let mut frames = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default().trim();
        if !content.is_empty() {
            frames.push(content.parse().map_err(|_| number + 1)?);
        }
    }
    frames.sort_unstable();
    frames.dedup();
    Ok(frames)
}

/// Formats a list, with its origin in comment lines.
pub fn write(origin: &str, frames: &[usize]) -> String {
    let comments = origin.lines().map(|line| format!("# {line}\n"));
    comments.chain(frames.iter().map(|frame| format!("{frame}\n"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_lists_hold_what_their_first_line_says() {
        for (name, text) in PUBLISHED {
            let frames = parse(text).unwrap();
            let count = text.lines().next().and_then(|line| line.split(", ").nth(1));
            let count = count.and_then(|c| c.split(' ').next()).and_then(|c| c.parse().ok());
            assert_eq!(count, Some(frames.len()), "{name}");
            assert!(text.contains("Source: "), "{name}");
        }
        let of = |name| parse(published(name).unwrap()).unwrap();
        let (sharp, keyframes) = (of("tum-fr3-office"), of("tum-fr3-office-keyframes"));
        assert!(sharp.iter().all(|frame| keyframes.contains(frame)));
        assert_eq!(of("tum-fr1-desk")[..3], [42, 92, 100]);
        assert_eq!(published("tum-fr1-plant"), None);
    }

    #[test]
    fn a_list_is_read_as_it_was_written() {
        let text = write("two\nlines", &[3, 8]);
        assert_eq!(text, "# two\n# lines\n3\n8\n");
        assert_eq!(parse(&text), Ok(vec![3, 8]));
        assert_eq!(parse("9 # last\n\n1\n9"), Ok(vec![1, 9]));
        assert_eq!(parse("1\n2.5"), Err(2));
    }
}
