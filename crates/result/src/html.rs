//! Parts of self-contained HTML pages: style sheet, escaped text, embedded pictures.

use crate::pictures::interleaved_bytes;
use base64::Engine;
use i2slam::geometry::Image;

/// The style sheet of this project's pages.
pub const STYLE: &str = include_str!("report/style.css");

/// Quality of embedded JPEG pictures, of 100.
const JPEG_QUALITY: u8 = 88;

/// Replaces the characters that have a meaning in HTML.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            other => escaped.push(other),
        }
    }
    escaped
}

/// Replaces each `{{key}}` of the template, but none in the values.
pub(crate) fn fill(template: &str, values: &[(&str, String)]) -> String {
    let mut page = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        page += before;
        let Some((key, after)) = after.split_once("}}") else { break };
        page += values.iter().find(|(name, _)| *name == key).map_or("", |(_, value)| value);
        rest = after;
    }
    page + rest
}

/// Encodes a picture as a `data:` address.
pub(crate) fn data_address(picture: &Image<f32>) -> String {
    jpeg_address(picture, JPEG_QUALITY)
}

/// Encodes a picture as a `data:` address (JPEG of a quality of 100, in base64); empty for an empty
/// picture and one too large for JPEG (65 535 pixels a side).
pub(crate) fn jpeg_address(picture: &Image<f32>, quality: u8) -> String {
    let size = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = size.filter(|&(w, h)| w > 0 && h > 0) else {
        return String::new();
    };
    let pixels = interleaved_bytes(picture);
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, quality);
    if encoder.encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb).is_err() {
        return String::new();
    }
    format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_become_jpeg_and_impossible_ones_nothing() {
        let address = data_address(&Image::new(16, 9, 3));
        let encoded = address.strip_prefix("data:image/jpeg;base64,").expect("an address");
        let bytes = base64::engine::general_purpose::STANDARD.decode(encoded).expect("base64");
        assert_eq!(bytes[..3], [0xff, 0xd8, 0xff]);
        assert_eq!(data_address(&Image::new(0, 0, 3)), "");
    }

    #[test]
    fn placeholders_in_values_stay() {
        let values = [("x", "{{y}}".into()), ("y", "2".into())];
        assert_eq!(fill("a {{x}} b {{y}}", &values), "a {{y}} b 2");
    }
}
