//! The sum over virtual cameras (eq. 6), and its transpose.

use i2slam_geometry::{Image, Real};

/// `hdr += weight · radiance`: one virtual camera's share of the exposure.
///
/// # Panics
/// When the images are of different shape.
pub fn accumulate<T: Real>(hdr: &mut Image<T>, weight: T, radiance: &Image<T>) {
    assert_same_shape(hdr, radiance);
    for (sum, &r) in hdr.data.iter_mut().zip(&radiance.data) {
        *sum += weight * r;
    }
}

/// `d_radiance = weight · d_hdr`: what one virtual camera's render is asked to change.
/// `d_radiance` is given the shape of `d_hdr`.
pub fn scale_into<T: Real>(d_hdr: &Image<T>, weight: T, d_radiance: &mut Image<T>) {
    shape_like(d_hdr, d_radiance);
    for (d, &sum) in d_radiance.data.iter_mut().zip(&d_hdr.data) {
        *d = weight * sum;
    }
}

/// Gives `image` the shape of `model`; its values are then to be overwritten.
pub(super) fn shape_like<T: Real>(model: &Image<T>, image: &mut Image<T>) {
    if shape(model) != shape(image) {
        image.reset(model.width, model.height, model.channels);
    }
}

pub(super) fn assert_same_shape<T: Real>(a: &Image<T>, b: &Image<T>) {
    assert_eq!(shape(a), shape(b), "images of different shape");
}

fn shape<T>(image: &Image<T>) -> (usize, usize, usize, usize) {
    (image.width, image.height, image.channels, image.data.len())
}
