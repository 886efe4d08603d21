//! What every setting means: the documentation of its field, and where its value is from.

use super::Config;

/// The declarations that are read for their documentation: one text for code, program and page.
const DECLARATIONS: [&str; 4] = [
    include_str!("mod.rs"),
    include_str!("../../../formation/src/shutter/poses.rs"),
    include_str!("../../../formation/src/tone/frame.rs"),
    include_str!("../../../formation/src/tone/start.rs"),
];

/// Key, colon, source of its value.
const SOURCES: &str = include_str!("sources.txt");

/// Columns of a comment.
const WIDTH: usize = 96;

/// A field of a section or a choice of a setting, as declared.
#[derive(Clone, Debug)]
struct Item {
    /// Struct or enum.
    owner: String,
    name: String,
    /// Type of a field; empty for a choice.
    kind: String,
    meaning: String,
}

/// What is declared, in order.
struct Declared(Vec<Item>);

impl Declared {
    fn read() -> Self {
        let mut items = Vec::new();
        for text in DECLARATIONS {
            read_items(text, &mut items);
        }
        Self(items)
    }

    fn of<'a>(&'a self, owner: &'a str) -> impl Iterator<Item = &'a Item> {
        self.0.iter().filter(move |item| item.owner == owner)
    }

    /// The field at a path of names.
    fn field(&self, key: &str) -> Option<&Item> {
        let mut owner = "Config";
        let mut found = None;
        for name in key.split('.') {
            found = self.of(owner).find(|item| item.name == name);
            owner = found.map_or("", |item| item.kind.as_str());
        }
        found
    }

    /// Meaning of a key, with the choices that it has.
    fn meaning(&self, key: &str) -> Option<String> {
        let field = self.field(key)?;
        let is_section = |item: &Item| !item.kind.is_empty();
        let choices: Vec<String> = self
            .of(&field.kind)
            .take_while(|item| !is_section(item))
            .map(|choice| format!("`{}`: {}", choice.name, choice.meaning))
            .collect();
        Some(format!("{} {}", field.meaning, choices.join(" ")).trim_end().to_owned())
    }
}

/// Fields of `pub struct`s and choices of `pub enum`s with the `///` lines above them.
fn read_items(text: &str, items: &mut Vec<Item>) {
    let (mut owner, mut kebab, mut meaning) = (String::new(), true, String::new());
    for line in text.lines().map(str::trim) {
        if let Some(words) = line.strip_prefix("///") {
            meaning = format!("{meaning} {}", words.trim()).trim_start().to_owned();
        } else if line.starts_with("#[") {
            if line.contains("rename_all") {
                kebab = line.contains("kebab-case");
            } else if line == "#[serde(skip)]" {
                meaning.clear();
            }
        } else {
            let head = line.strip_prefix("pub struct ").or_else(|| line.strip_prefix("pub enum "));
            let field = line.strip_prefix("pub ").and_then(|rest| rest.split_once(": "));
            let (name, kind) = match (head, field) {
                (Some(head), _) => {
                    owner = head.trim_end_matches(" {").to_owned();
                    meaning.clear();
                    continue;
                }
                (None, Some((name, kind))) => (name.to_owned(), kind),
                (None, None) => (choice_name(line.trim_end_matches(','), kebab), ""),
            };
            if line == "}" {
                owner.clear();
            } else if !owner.is_empty() && line.ends_with(',') && !meaning.is_empty() {
                let kind = kind.trim_end_matches(',').to_owned();
                let meaning = std::mem::take(&mut meaning);
                items.push(Item { owner: owner.clone(), name, kind, meaning });
            }
            meaning.clear();
        }
    }
}

/// A variant as serde names it.
fn choice_name(variant: &str, kebab: bool) -> String {
    let mut name = String::new();
    for (place, character) in variant.chars().enumerate() {
        if kebab && place > 0 && character.is_uppercase() {
            name.push('-');
        }
        name.extend(character.to_lowercase());
    }
    name
}

/// Where the value of a key comes from.
fn source(key: &str) -> Option<&'static str> {
    let rows = SOURCES.lines().filter(|line| !line.starts_with('#'));
    rows.filter_map(|line| line.split_once(": "))
        .find(|(name, _)| *name == key)
        .map(|(_, text)| text)
}

impl Config {
    /// [`to_toml`](Self::to_toml) with meaning, unit, choices and source of every value as
    /// comments.
    pub fn to_commented_toml(&self) -> String {
        let declared = Declared::read();
        let mut text = String::from(
            "# A file for --config: keep what you change, the rest is that of the preset. Sources: P the\n\
             # paper's appendix A, S SplaTAM's published configuration, N torch-ngp; \"open\" where neither\n\
             # says, \"ours\" for what neither has.\n\n",
        );
        let mut section = String::new();
        for line in self.to_toml().lines() {
            if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                section = format!("{name}.");
                comment(&mut text, declared.field(name).map(|item| item.meaning.as_str()));
            } else if let Some((name, _)) = line.split_once(" = ") {
                let key = format!("{section}{name}");
                comment(&mut text, declared.meaning(&key).as_deref());
                let source = source(&key).map(|source| format!("Source: {source}"));
                comment(&mut text, source.as_deref());
            }
            text += line;
            text.push('\n');
        }
        text
    }
}

/// Words as lines of a comment.
fn comment(text: &mut String, words: Option<&str>) {
    let mut line = String::new();
    for word in words.unwrap_or_default().split(' ').filter(|word| !word.is_empty()) {
        if line.chars().count() + 1 + word.chars().count() > WIDTH {
            *text += &format!("#{line}\n");
            line.clear();
        }
        line.push(' ');
        line += word;
    }
    if !line.is_empty() {
        *text += &format!("#{line}\n");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PRESET_NAMES;
    use toml::{Table, Value};

    fn keys(table: &Table, path: &str, all: &mut Vec<String>) {
        for (name, value) in table {
            match value {
                Value::Table(inner) => keys(inner, &format!("{path}{name}."), all),
                _ => all.push(format!("{path}{name}")),
            }
        }
    }

    fn all_keys() -> Vec<String> {
        let mut all = Vec::new();
        keys(&Table::try_from(Config::default()).expect("a table"), "", &mut all);
        all
    }

    #[test]
    fn every_setting_has_a_meaning_and_a_source() {
        let declared = Declared::read();
        for key in all_keys() {
            assert!(declared.meaning(&key).is_some_and(|m| m.len() > 8), "{key} has no meaning");
            let known = source(&key).is_some_and(|s| !s.is_empty()) || key == "preset";
            assert!(known, "{key} has no line in config/sources.txt");
        }
        for line in SOURCES.lines().filter(|line| !line.starts_with('#')) {
            let (key, _) = line.split_once(": ").unwrap_or_else(|| panic!("no key: {line}"));
            assert!(all_keys().iter().any(|known| known == key), "no setting is called {key}");
        }
    }

    #[test]
    fn choices_are_named_as_they_are_written() {
        let meaning = Declared::read().meaning("formation.blur_model").expect("a key");
        for choice in ["`exact`: One render", "`image`: ", "`auto`: "] {
            assert!(meaning.contains(choice), "{meaning}");
        }
        let kind = Declared::read().meaning("map.kind").expect("a key");
        assert!(kind.contains("`gaussian`: 3D") && kind.contains("`hashgrid`: "), "{kind}");
        let method = Declared::read().meaning("tracking.method").expect("a key");
        assert!(method.contains("`second-order`: "), "{method}");
    }

    #[test]
    fn comments_change_no_value() {
        for name in PRESET_NAMES {
            let config = Config::preset(name).expect("known");
            let text = config.to_commented_toml();
            assert_eq!(Config::from_toml(&text, "test", None).ok(), Some(config));
            assert!(text.lines().all(|line| line.chars().count() <= WIDTH + 2), "{text}");
        }
    }
}
