//! Specification of a sequence: every field has a default, a range and a line of documentation.

mod sections;
mod work;

use crate::error::SyntheticError;
use crate::sensor::Response;
use i2slam_storage::{line_at, nearest_key, shortened};
use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;
use std::path::Path;

/// Defines the specification by its sections. Those behind the semicolon came later: sequences
/// that leave them at their defaults are written without them, the same bytes as before.
macro_rules! specification {
    ($($name:ident : $section:ident),+ $(,)? ; $($later:ident : $later_section:ident),+ $(,)?) => {
        pub use sections::{ $($section,)+ $($later_section),+ };

        /// A whole specification, `SPEC.toml`.
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct Spec {
            /// Seed of room, motion and noise.
            pub seed: u64,
            $(
                #[doc = concat!("Section `[", stringify!($name), "]`.")]
                pub $name: $section,
            )+
            $(
                #[doc = concat!("Section `[", stringify!($later), "]`.")]
                pub $later: $later_section,
            )+
        }

        impl Spec {
            fn print_sections(&self, text: &mut String, whole: bool) {
                $( self.$name.print(text); )+
                $( if whole || self.$later != Default::default() { self.$later.print(text); } )+
            }

            fn check_sections(&self) -> Result<(), SyntheticError> {
                $( self.$name.check()?; )+
                $( self.$later.check()?; )+
                Ok(())
            }
        }
    };
}
specification! {
    camera: CameraSpec,
    room: RoomSpec,
    light: LightSpec,
    motion: MotionSpec,
    exposure: ExposureSpec,
    white_balance: WhiteBalanceSpec,
    noise: NoiseSpec,
    depth: DepthSpec,
    output: OutputSpec;
    gloss: GlossSpec,
    lens: LensSpec,
    stills: StillsSpec,
}

/// Specifications that come with the crate: name and text.
pub const SHIPPED: [(&str, &str); 5] = [
    ("glossy", include_str!("../../specs/glossy.toml")),
    ("lamps", include_str!("../../specs/lamps.toml")),
    ("stills", include_str!("../../specs/stills.toml")),
    ("turn-away", include_str!("../../specs/turn-away.toml")),
    ("round-trip", include_str!("../../specs/round-trip.toml")),
];

impl Spec {
    /// Parses and checks a specification; `origin` names it in errors.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, SyntheticError> {
        let spec: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|at| format!(", line {}", line_at(text, at.start)));
            SyntheticError::Malformed {
                origin: origin.to_owned() + &line.unwrap_or_default(),
                message: shortened(error.message()) + &hint(error.message()),
            }
        })?;
        spec.validate()?;
        Ok(spec)
    }

    /// A specification that comes with the crate, one of [`SHIPPED`].
    pub fn shipped(name: &str) -> Option<Self> {
        let (name, text) = SHIPPED.iter().find(|(known, _)| *known == name)?;
        Self::from_toml(text, name).ok()
    }

    /// Reads and checks a specification file.
    pub fn from_toml_file(path: &Path) -> Result<Self, SyntheticError> {
        let text = i2slam_storage::read_text(path).map_err(|e| SyntheticError::read(path, e))?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Formats the specification as a commented file that reads back to the same values.
    pub fn to_toml(&self) -> String {
        self.print(true)
    }

    /// As [`to_toml`](Self::to_toml), without those of the later sections that have their defaults.
    pub(crate) fn record(&self) -> String {
        self.print(false)
    }

    fn print(&self, whole: bool) -> String {
        let mut text = String::from(
            "# Specification of a synthetic sequence. Every line may be left out: these are the\n\
             # values then taken.\n\n# Seed of room, motion and noise.\n",
        );
        text.push_str(&format!("seed = {}\n", self.seed));
        self.print_sections(&mut text, whole);
        text
    }

    /// An error for values outside their documented range, and for more pixels or rays than can be
    /// rendered.
    pub fn validate(&self) -> Result<(), SyntheticError> {
        self.check_sections()?;
        self.lens.check_light()?;
        let (low, high) = (self.exposure.shutter_minimum, self.exposure.shutter_maximum);
        if low > high {
            return Err(SyntheticError::OutOfRange {
                key: "exposure.shutter_minimum".into(),
                value: low.to_string(),
                expected: format!("at most exposure.shutter_maximum = {high}"),
            });
        }
        self.check_work()
    }
}

/// The value that an unknown field may mean, by the message of the parser; empty of another message.
fn hint(message: &str) -> String {
    let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    let sections = toml::Table::try_from(Spec::default()).unwrap_or_default();
    let keys = |(section, values): (&String, &toml::Value)| {
        let names = values.as_table().into_iter().flat_map(toml::Table::keys);
        let inner: Vec<String> = names.map(|name| format!("{section}.{name}")).collect();
        [section.clone()].into_iter().chain(inner)
    };
    let known: Vec<String> = sections.iter().flat_map(keys).collect();
    let nearest = unknown.and_then(|key| nearest_key(key, known.iter().map(String::as_str)));
    nearest.map(|known| format!("; did you mean `{known}`?")).unwrap_or_default()
}

/// A value with an allowed range.
pub(crate) trait Ranged {
    /// An error for values outside; `key` names the field.
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

/// Formats a value as TOML.
pub(crate) fn to_toml_value<T: Debug + serde::Serialize>(value: &T) -> String {
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
                $crate::spec::comments(text, &[$($about),+]);
                text.push_str(concat!("[", stringify!($section), "]\n"));
                $(
                    $crate::spec::comments(text, &[$($doc),+]);
                    $( $crate::spec::range_comment(text, $range.start(), $range.end()); )?
                    let value = $crate::spec::to_toml_value(&self.$field);
                    text.push_str(&format!("{} = {value}\n", stringify!($field)));
                )+
            }

            pub(super) fn check(&self) -> Result<(), crate::SyntheticError> {
                $( $(
                    let key = concat!(stringify!($section), ".", stringify!($field));
                    $crate::spec::Ranged::within(&self.$field, &$range, key)?;
                )? )+
                Ok(())
            }
        }
    };
}
pub(crate) use section;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_printed_specification_reads_back() {
        let spec = Spec { seed: 7, ..Spec::default() };
        let text = spec.to_toml();
        assert_eq!(Spec::from_toml(&text, "printed").expect("readable"), spec);
        assert!(text.contains("# Width of the pictures [px].\n# Range: 16 to 8192.\nwidth = 320"));
    }

    #[test]
    fn later_sections_are_recorded_where_they_say_something() {
        let mut spec = Spec::default();
        assert!(spec.to_toml().contains("[gloss]") && !spec.record().contains("[gloss]"));
        spec.gloss.polish = 0.05;
        assert_eq!(Spec::from_toml(&spec.record(), "recorded").expect("readable"), spec);
    }

    #[test]
    fn shipped_specifications_are_read() {
        for (name, text) in SHIPPED {
            Spec::from_toml(text, name).expect(name);
            assert!(Spec::shipped(name).is_some_and(|spec| spec != Spec::default()), "{name}");
        }
        assert_eq!(Spec::shipped("turn"), None);
    }

    #[test]
    fn an_empty_specification_is_the_default() {
        assert_eq!(Spec::from_toml("", "empty").expect("readable"), Spec::default());
    }

    #[test]
    fn unknown_keys_and_values_out_of_range_are_named() {
        let message = |text: &str| Spec::from_toml(text, "a.toml").expect_err(text).to_string();
        let unknown = message("[camera]\nwidht = 3");
        assert!(unknown.contains("widht") && unknown.contains("line 2"), "{unknown}");
        assert!(unknown.contains("`width`"), "{unknown}");
        assert!(message("[colour]\nx = 1").contains("colour"));
        assert!(
            message("[camera]\nwidth = 3").contains("camera.width = 3 is out of range: 16 to 8192")
        );
        assert!(message("[room]\nsize = [5.0, 4.0]").contains("line 2"));
        assert!(message("[exposure]\nresponse = \"gamma\"").contains("reinhard"));
        assert!(message("[motion]\nspeed = nan").contains("motion.speed = NaN"));
        assert!(
            message("[exposure]\nshutter_minimum = 0.5\nshutter_maximum = 0.2").contains("at most")
        );
    }
}
