//! Where a key stands in a TOML text.

use toml::de::{DeTable, DeValue};

/// The line, counted from 1, of the key at `path`: names of tables and keys, or the place of a
/// table in an array of tables. `None` where the text has no such key, or is no TOML.
pub fn line_of_key(text: &str, path: &[&str]) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let at = in_table(table.get_ref(), path)?;
    Some(text.get(..at)?.matches('\n').count() + 1)
}

/// Byte at which the key begins.
fn in_table(table: &DeTable<'_>, path: &[&str]) -> Option<usize> {
    let (first, rest) = path.split_first()?;
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == *first)?;
    if rest.is_empty() { Some(key.span().start) } else { in_value(value.get_ref(), rest) }
}

fn in_value(value: &DeValue<'_>, path: &[&str]) -> Option<usize> {
    match value {
        DeValue::Table(table) => in_table(table, path),
        DeValue::Array(array) => {
            let (place, rest) = path.split_first()?;
            let element = array.get(place.parse::<usize>().ok()?)?;
            if rest.is_empty() {
                Some(element.span().start)
            } else {
                in_value(element.get_ref(), rest)
            }
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_however_they_are_written() {
        let text = "seed = 1\n\n[map]\nkind = \"x\"\n[mapping]\nmap.kind = 3\ninner = { a = 1,\n \
                    b = 2 }\n[[row]]\nname = \"one\"\n\n[[row]]\n# two\nname = \"two\"\n";
        let line = |path: &[&str]| line_of_key(text, path);
        assert_eq!(line(&["seed"]), Some(1));
        assert_eq!(line(&["map", "kind"]), Some(4));
        assert_eq!(line(&["mapping", "map", "kind"]), Some(6));
        assert_eq!(line(&["mapping", "inner", "b"]), Some(8));
        assert_eq!(line(&["row", "1", "name"]), Some(14));
        assert_eq!(line(&["row", "1"]), Some(12));
        assert_eq!(line(&["row", "2"]), None);
        assert_eq!(line(&["seed", "deeper"]), None);
        assert_eq!(line_of_key("a = [", &["a"]), None);
    }
}
