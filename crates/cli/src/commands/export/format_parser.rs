//! Parser of `--format`, which knows formats of other programs by name.

use super::arguments::Format;
use clap::builder::{EnumValueParser, PossibleValue, StyledStr, TypedValueParser};
use clap::error::{ContextKind, ContextValue};
use clap::{Arg, Command, Error};
use std::ffi::OsStr;

/// Names of formats that are not written, and advice on those that are.
const UNWRITTEN: [(&[&str], &str); 3] = [
    (&["gltf"], "'mesh' with --out FILE.glb writes a surface as binary glTF, 'glb' the Gaussians"),
    (
        &["obj", "stl", "fbx", "off", "dae", "usd", "usdz", "3mf"],
        "'mesh' writes the surface as .glb or .ply, which Blender and MeshLab turn into other formats",
    ),
    (
        &["splat", "spz", "ksplat", "sog", "gaussians"],
        "'ply' and 'compressed-ply' are read by splat viewers and converters",
    ),
];

/// Parser of a [`Format`].
#[derive(Clone)]
pub(super) struct FormatParser;

impl TypedValueParser for FormatParser {
    type Value = Format;

    fn parse_ref(
        &self,
        command: &Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<Format, Error> {
        let parser = EnumValueParser::<Format>::new();
        parser.parse_ref(command, argument, value).map_err(|mut error| {
            if let Some(advice) = advice(&value.to_string_lossy()) {
                // A name that is spelt alike means something else.
                error.remove(ContextKind::SuggestedValue);
                let advice = ContextValue::StyledStrs(vec![StyledStr::from(advice)]);
                error.insert(ContextKind::Suggested, advice);
            }
            error
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let values: Vec<_> = EnumValueParser::<Format>::new().possible_values()?.collect();
        Some(Box::new(values.into_iter()))
    }
}

/// Advice for somebody who looks for a format that is not written.
fn advice(name: &str) -> Option<&'static str> {
    let name = name.trim_start_matches('.').to_lowercase();
    UNWRITTEN.iter().find(|(names, _)| names.contains(&name.as_str())).map(|(_, advice)| *advice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

    #[test]
    fn formats_of_other_programs_are_answered_with_one_that_is_written() {
        let refusal = |name: &str| {
            let command = Command::new("export");
            let parsed = FormatParser.parse_ref(&command, None, OsStr::new(name));
            parsed.map_err(|error| error.to_string())
        };
        assert_eq!(refusal("mesh"), Ok(Format::Mesh));
        for name in ["obj", ".STL", "usdz", "gltf"] {
            assert!(refusal(name).unwrap_err().contains("tip: 'mesh'"), "{name}");
        }
        assert!(refusal("splat").unwrap_err().contains("tip: 'ply'"));
        let written: Vec<String> = Format::value_variants().iter().map(|f| f.name()).collect();
        let unwritten = UNWRITTEN.iter().flat_map(|(names, _)| *names);
        assert!(unwritten.clone().all(|name| !written.iter().any(|w| w == name)));
    }
}
