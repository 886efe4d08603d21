//! Linear colours, Rec. 709 primaries.

/// Red, green, blue.
pub(crate) type Rgb = [f32; 3];

/// The colour of an sRGB code `0xRRGGBB`.
pub(crate) fn srgb(code: u32) -> Rgb {
    [16, 8, 0].map(|shift| decode(((code >> shift) & 255) as f32 / 255.0))
}

/// sRGB's inverse encoding (IEC 61966-2-1), of a value in `[0, 1]`.
pub(crate) fn decode(code: f32) -> f32 {
    if code <= 0.04045 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}

/// sRGB's encoding, of a value in `[0, 1]`.
pub(crate) fn encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// `(1 - u) a + u b`.
pub(crate) fn mix(a: Rgb, b: Rgb, u: f32) -> Rgb {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * u)
}

/// `s a`.
pub(crate) fn scale(a: Rgb, s: f32) -> Rgb {
    a.map(|v| v * s)
}

/// The product by channel.
pub(crate) fn times(a: Rgb, b: Rgb) -> Rgb {
    std::array::from_fn(|i| a[i] * b[i])
}

/// The sum.
pub(crate) fn plus(a: Rgb, b: Rgb) -> Rgb {
    std::array::from_fn(|i| a[i] + b[i])
}

/// Relative luminance, `0.2126 R + 0.7152 G + 0.0722 B`.
pub(crate) fn luminance(a: Rgb) -> f32 {
    0.2126 * a[0] + 0.7152 * a[1] + 0.0722 * a[2]
}
