mod gradient;
mod lanes;
mod quality;
mod scene;

use i2slam_geometry::Image;

/// The same image in single precision.
fn narrow(image: &Image<f64>) -> Image<f32> {
    let data = image.data.iter().map(|&v| v as f32).collect();
    Image { width: image.width, height: image.height, channels: image.channels, data }
}

/// The same image in double precision.
fn wide(image: &Image<f32>) -> Image<f64> {
    let data = image.data.iter().map(|&v| f64::from(v)).collect();
    Image { width: image.width, height: image.height, channels: image.channels, data }
}
