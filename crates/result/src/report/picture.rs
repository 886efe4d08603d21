//! Pictures inside the page: JPEG in base64.

use crate::pictures::interleaved_bytes;
use base64::Engine;
use i2slam::geometry::Image;

const QUALITY: u8 = 88;

/// The picture as a `data:` address. A picture too large for JPEG (65 535 pixels a side) or
/// empty gives an empty address.
pub(crate) fn data_address(picture: &Image<f32>) -> String {
    let size = u16::try_from(picture.width).ok().zip(u16::try_from(picture.height).ok());
    let Some((width, height)) = size.filter(|&(w, h)| w > 0 && h > 0) else {
        return String::new();
    };
    let pixels = interleaved_bytes(picture);
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, QUALITY);
    if encoder.encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb).is_err() {
        return String::new();
    }
    format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

/// Depth as colours, near warm and far cool, dark where there is none.
pub(crate) fn depth_colours(depth: &Image<f32>) -> Image<f32> {
    let mut valid: Vec<f32> = depth.plane(0).iter().copied().filter(|&d| d > 0.0).collect();
    valid.sort_by(f32::total_cmp);
    let quantile = |q: f64| valid.get((q * valid.len() as f64) as usize).copied().unwrap_or(1.0);
    let (near, far) = (quantile(0.02), quantile(0.98));
    let mut colours = Image::new(depth.width, depth.height, 3);
    for (i, &d) in depth.plane(0).iter().enumerate() {
        let share = ((d - near) / (far - near).max(1e-6)).clamp(0.0, 1.0);
        let colour = if d > 0.0 { warm_to_cool(share) } else { [0.06, 0.07, 0.09] };
        for (channel, value) in colour.into_iter().enumerate() {
            colours.plane_mut(channel)[i] = value;
        }
    }
    colours
}

/// Sand, coral, violet, night blue.
fn warm_to_cool(share: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 4] =
        [[0.99, 0.91, 0.70], [0.93, 0.50, 0.42], [0.48, 0.25, 0.52], [0.10, 0.12, 0.32]];
    let at = share * 3.0;
    let i = (at as usize).min(2);
    let u = at - i as f32;
    std::array::from_fn(|c| STOPS[i][c] * (1.0 - u) + STOPS[i + 1][c] * u)
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
    fn depth_without_readings_is_dark() {
        let colours = depth_colours(&Image::new(4, 3, 1));
        assert!(colours.data.iter().all(|&v| v < 0.1));
    }
}
