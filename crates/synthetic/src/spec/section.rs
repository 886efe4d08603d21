//! One list gives a section's fields, defaults, ranges and documentation.

use crate::error::SyntheticError;
use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

/// A value that a range applies to.
pub(crate) trait Ranged {
    /// Refuses what lies outside; `key` names the place.
    fn within(&self, range: &RangeInclusive<f64>, key: &str) -> Result<(), SyntheticError>;
}

fn check(value: f64, range: &RangeInclusive<f64>, key: &str) -> Result<(), SyntheticError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(SyntheticError::OutOfRange {
        key: key.to_owned(),
        value: value.to_string(),
        expected: format!("{} to {}", range.start(), range.end()),
    })
}

impl Ranged for f64 {
    fn within(&self, range: &RangeInclusive<f64>, key: &str) -> Result<(), SyntheticError> {
        check(*self, range, key)
    }
}

impl Ranged for usize {
    fn within(&self, range: &RangeInclusive<f64>, key: &str) -> Result<(), SyntheticError> {
        check(*self as f64, range, key)
    }
}

impl<const N: usize> Ranged for [f64; N] {
    fn within(&self, range: &RangeInclusive<f64>, key: &str) -> Result<(), SyntheticError> {
        self.iter().try_for_each(|value| check(*value, range, key))
    }
}

/// A value as it is written in TOML.
pub(crate) fn written<T: Debug + serde::Serialize>(value: &T) -> String {
    toml::Value::try_from(value).map_or_else(|_| format!("{value:?}"), |v| v.to_string())
}

/// Documentation lines as comments.
pub(crate) fn comments(text: &mut String, lines: &[&str]) {
    for line in lines {
        text.push_str(&format!("#{line}\n"));
    }
}

/// The range of a field as a comment.
pub(crate) fn range_comment(text: &mut String, low: impl Display, high: impl Display) {
    text.push_str(&format!("# Range: {low} to {high}.\n"));
}

/// Defines a section of the specification. A field is `/// doc`, `name: Type = default` and,
/// after a comma, the range of its numbers.
macro_rules! section {
    (
        $(#[doc = $about:literal])+
        $section:ident : $name:ident {
            $( $(#[doc = $doc:literal])+ $field:ident : $type:ty = $default:expr $(, $range:expr)? ; )+
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name { $( $(#[doc = $doc])+ pub $field: $type, )+ }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )+ }
            }
        }

        impl $name {
            pub(super) fn print(&self, text: &mut String) {
                text.push('\n');
                $crate::spec::section::comments(text, &[$($about),+]);
                text.push_str(concat!("[", stringify!($section), "]\n"));
                $(
                    $crate::spec::section::comments(text, &[$($doc),+]);
                    $( $crate::spec::section::range_comment(text, $range.start(), $range.end()); )?
                    let value = $crate::spec::section::written(&self.$field);
                    text.push_str(&format!("{} = {value}\n", stringify!($field)));
                )+
            }

            pub(super) fn check(&self) -> Result<(), crate::SyntheticError> {
                $( $(
                    let key = concat!(stringify!($section), ".", stringify!($field));
                    $crate::spec::section::Ranged::within(&self.$field, &$range, key)?;
                )? )+
                Ok(())
            }
        }
    };
}
pub(crate) use section;
