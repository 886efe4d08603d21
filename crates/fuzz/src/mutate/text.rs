//! Changes of texts: lines, words and numbers.

use i2slam_compute::Random;
use std::ops::Range;

/// Words put in place of others.
const NUMBERS: [&str; 24] = [
    "0",
    "-1",
    "1",
    "-0.0",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "1e999",
    "2147483647",
    "2147483648",
    "4294967296",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551615",
    "99999999999999999999999999",
    "0.1",
    "1000000",
    "65536",
    "16777216",
    "1e30",
];

/// Words that are none.
const WORDS: [&str; 18] = [
    "",
    "\0",
    "\u{feff}",
    "\u{1b}[2J",
    "é",
    "\u{202e}",
    "\"",
    "'",
    "{",
    "[",
    "]",
    "null",
    "true",
    "../../../../etc/passwd",
    "/dev/zero",
    ".",
    "-",
    "%s%n",
];

/// Number of repetitions of lines and brackets.
const MANY: [usize; 4] = [2, 20, 300, 6000];

/// Bytes that repeated lines take at most.
const MAX_REPEATED: usize = 1 << 22;

/// The text with one change.
pub(super) fn change(text: &str, donor: &str, random: &mut Random) -> Vec<u8> {
    let changed = match random.below(12) {
        0..=4 => replace_number(text, random),
        5 => replace_word(text, random),
        6 => swap_words(text, random),
        7..=9 => change_lines(text, donor, random),
        10 => nest(text, random),
        _ => rewrite(text, random),
    };
    if changed.as_bytes() == text.as_bytes() { format!("{text} ") } else { changed }.into_bytes()
}

/// Places of the words: runs of letters, digits, signs and points.
fn words(text: &str) -> Vec<Range<usize>> {
    let is_word = |c: char| c.is_alphanumeric() || "+-._/".contains(c);
    let mut found = Vec::new();
    let mut start = None;
    for (at, c) in text.char_indices().chain([(text.len(), ' ')]) {
        match (is_word(c), start) {
            (true, None) => start = Some(at),
            (false, Some(from)) => {
                found.push(from..at);
                start = None;
            }
            _ => {}
        }
    }
    found
}

fn replaced(text: &str, range: Range<usize>, with: &str) -> String {
    format!("{}{with}{}", &text[..range.start], &text[range.end..])
}

fn replace_number(text: &str, random: &mut Random) -> String {
    let is_number = |range: &Range<usize>| text[range.clone()].parse::<f64>().is_ok();
    let numbers: Vec<Range<usize>> = words(text).into_iter().filter(is_number).collect();
    if numbers.is_empty() {
        return replace_word(text, random);
    }
    let range = numbers[random.below(numbers.len())].clone();
    let old: f64 = text[range.clone()].parse().unwrap_or_default();
    match random.below(5) {
        0 => replaced(text, range, &(-old).to_string()),
        1 => replaced(text, range, &(old * 1e6).to_string()),
        _ => replaced(text, range, NUMBERS[random.below(NUMBERS.len())]),
    }
}

fn replace_word(text: &str, random: &mut Random) -> String {
    let all = words(text);
    if all.is_empty() {
        return format!("{text}{}", WORDS[random.below(WORDS.len())]);
    }
    let range = all[random.below(all.len())].clone();
    match random.below(8) {
        0 => replaced(text, range, &"a".repeat(100_000)),
        1 => replaced(text, range, &text[all[random.below(all.len())].clone()]),
        _ => replaced(text, range, WORDS[random.below(WORDS.len())]),
    }
}

fn swap_words(text: &str, random: &mut Random) -> String {
    let all = words(text);
    if all.len() < 2 {
        return replace_word(text, random);
    }
    let first = random.below(all.len() - 1);
    let second = first + 1 + random.below((all.len() - first - 1).min(8));
    let (a, b) = (all[first].clone(), all[second].clone());
    let swapped = replaced(text, b.clone(), &text[a.clone()]);
    replaced(&swapped, a, &text[b])
}

fn change_lines(text: &str, donor: &str, random: &mut Random) -> String {
    let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
    let donors: Vec<&str> = donor.split_inclusive('\n').collect();
    let at = random.below(lines.len());
    match random.below(6) {
        0 | 1 => drop(lines.remove(at)),
        2 => {
            let room = 1 + MAX_REPEATED / lines[at].len().max(1);
            let copies = vec![lines[at]; MANY[random.below(MANY.len())].min(room)];
            lines.splice(at..at, copies);
        }
        3 => {
            let other = random.below(lines.len());
            lines.swap(at, other);
        }
        4 if !donors.is_empty() => lines.insert(at, donors[random.below(donors.len())]),
        4 => lines.insert(at, "\n"),
        _ => lines.truncate(at),
    }
    lines.concat()
}

/// Inserts many brackets, which recursive readers follow.
fn nest(text: &str, random: &mut Random) -> String {
    let bracket = ["[", "{\"a\":", "(", "[[a]]\n"][random.below(4)];
    let all = words(text);
    let at = all.get(random.below(all.len().max(1))).map_or(0, |range| range.start);
    replaced(text, at..at, &bracket.repeat(MANY[random.below(MANY.len())] * 20))
}

/// Changes all of the text.
fn rewrite(text: &str, random: &mut Random) -> String {
    match random.below(6) {
        0 => String::new(),
        1 => text.replace('\n', "\r\n"),
        2 => format!("\u{feff}{text}"),
        3 => text.replace('\n', " "),
        4 => text.replace(' ', ""),
        _ => text.repeat(2),
    }
}
