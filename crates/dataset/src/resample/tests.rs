use super::*;
use i2slam_geometry::Vec3;

fn camera() -> Camera<f64> {
    Camera { width: 64, height: 48, fx: 50.0, fy: 52.0, cx: 33.0, cy: 23.0 }
}

/// One camera for colour and depth.
fn alone(camera: Camera<f64>) -> Recorded {
    Recorded { colour: camera, depth: camera, grid: camera }
}

fn lens() -> Distortion {
    Distortion { radial: [-0.2, 0.05, 0.0], tangential: [0.01, -0.004], ..Distortion::default() }
}

/// A picture of a linear function of the ray, as the distorting camera records it.
fn recorded_ramp(lens: &Distortion) -> Image<f32> {
    let mut image = Image::new(64, 48, 3);
    for row in 0..48 {
        for column in 0..64 {
            let (x, y) = ray_behind(lens, column as f64 + 0.5, row as f64 + 0.5);
            for channel in 0..3 {
                image.data[(channel * 48 + row) * 64 + column] = ramp(channel, x, y);
            }
        }
    }
    image
}

fn ramp(channel: usize, x: f64, y: f64) -> f32 {
    (0.5 + [0.4, -0.3, 0.2][channel] * x + [0.1, 0.3, -0.4][channel] * y) as f32
}

/// The ray that the lens puts at `(u, v)`, by fixed-point iteration.
fn ray_behind(lens: &Distortion, u: f64, v: f64) -> (f64, f64) {
    let target = ((u - camera().cx) / camera().fx, (v - camera().cy) / camera().fy);
    let (mut x, mut y) = target;
    for _ in 0..200 {
        let (dx, dy) = lens.distort(x, y);
        (x, y) = (x + target.0 - dx, y + target.1 - dy);
    }
    (x, y)
}

#[test]
fn removing_the_lens_gives_the_pinhole_picture() {
    for delivered in [(56, 40), (28, 20), (19, 13)] {
        let resampler = Resampler::new(&alone(camera()), &lens(), 4, delivered);
        assert!(resampler.covered.is_none());
        let out = resampler.colour(&recorded_ramp(&lens()));
        for row in 0..delivered.1 {
            for column in 0..delivered.0 {
                let ray = resampler.camera.unproject(column as f64 + 0.5, row as f64 + 0.5, 1.0);
                for channel in 0..3 {
                    let expected = ramp(channel, ray.x, ray.y);
                    assert!((out.at(channel, column, row) - expected).abs() < 2e-4);
                }
            }
        }
    }
}

#[test]
fn depth_comes_from_the_pixel_the_ray_was_recorded_in() {
    let resampler = Resampler::new(&alone(camera()), &lens(), 4, (28, 20));
    let point = resampler.camera.unproject(10.5, 4.5, 2.0);
    let (x, y) = lens().distort(point.x / point.z, point.y / point.z);
    let (u, v) = camera().project(Vec3::new(x, y, 1.0));
    let mut recorded = Image::<u16>::new(64, 48, 1);
    recorded.data[v as usize * 64 + u as usize] = 10_000;
    assert_eq!(resampler.depth(&recorded, 5000.0, 10.0).at(0, 10, 4), 2.0);
    assert_eq!(resampler.depth(&recorded, 5000.0, 1.9).at(0, 10, 4), 0.0);
    let valid = resampler.depth(&recorded, 5000.0, 10.0).data.iter().filter(|&&z| z > 0.0).count();
    assert_eq!(valid, 1);
}

#[test]
fn without_a_lens_cropping_and_scaling_agree_with_geometry() {
    let image = recorded_ramp(&Distortion::default());
    let whole = Resampler::new(&alone(camera()), &Distortion::default(), 0, (64, 48));
    assert_eq!(whole.colour(&image), image);
    let half = Resampler::new(&alone(camera()), &Distortion::default(), 0, (32, 24));
    let expected = image.resized_by_area(32, 24);
    for (a, b) in half.colour(&image).data.iter().zip(&expected.data) {
        assert!((a - b).abs() < 1e-6);
    }
    let depth = Image { width: 64, height: 48, channels: 1, data: (0..64 * 48).collect() };
    let metres = depth.data.iter().map(|&v| f32::from(v)).collect();
    let expected = Image { width: 64, height: 48, channels: 1, data: metres };
    assert_eq!(half.depth(&depth, 1.0, 1e9), expected.resized_by_nearest(32, 24));
}

#[test]
fn pixels_the_lens_did_not_record_are_marked() {
    let outward = Distortion { radial: [0.3, 0.0, 0.0], ..Distortion::default() };
    let resampler = Resampler::new(&alone(camera()), &outward, 0, (64, 48));
    let covered = resampler.covered.clone().expect("the corners are outside");
    assert!(!covered.at(0, 0, 0) && covered.at(0, 32, 24));
    let depth = Image { width: 64, height: 48, channels: 1, data: vec![1000; 64 * 48] };
    let depth = resampler.depth(&depth, 1000.0, 10.0);
    for (z, covered) in depth.data.iter().zip(&covered.data) {
        assert_eq!(*z > 0.0, *covered);
    }
    let border = resampler.full_cover_border;
    let size = (64 - 2 * border, 48 - 2 * border);
    assert!(Resampler::new(&alone(camera()), &outward, border, size).covered.is_none());
    let size = (size.0 + 2, size.1 + 2);
    assert!(Resampler::new(&alone(camera()), &outward, border - 1, size).covered.is_some());
}
