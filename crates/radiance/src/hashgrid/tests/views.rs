//! Pictures: from rays to a view, and back to its pose.

use super::*;
use crate::gaussian::tests::{single_cotangent, view};
use crate::{RadianceMap, Render, RenderCotangent, View, gaussian};
use i2slam_check::{assert_close, assert_gradient};
use i2slam_geometry::{Pose, Tangent, Vec3};

fn cotangent(width: usize, height: usize) -> RenderCotangent {
    single_cotangent(&gaussian::tests::cotangent(width, height, 1))
}

#[test]
fn pose_gradient_agrees_with_central_differences() {
    let (field, view, samples) = (field(settings(), 5), view(5, 4), samples(12));
    let pixels: Vec<_> = (0..20).map(|i| (i % 5, i / 5)).collect();
    let cotangents = cotangents(20, 3);
    let mut tangent = Tangent::zero();
    for (&(column, row), cotangent) in pixels.iter().zip(&cotangents) {
        let ray = Ray::through_pixel(&view, column, row);
        let gradient = reference::pull_back(&field, &ray, &samples, cotangent, None);
        tangent = tangent.plus(gradient.to_pose(&view, column, row));
    }
    // A step so short that no sample passes the side of a cell, where slopes jump.
    assert_gradient("pose", &[0.0; 6], &tangent.to_array(), 1e-6, 1e-6, |x| {
        let moved = Tangent::from_array([x[0], x[1], x[2], x[3], x[4], x[5]]);
        let view = View { world_from_camera: view.world_from_camera.retract(moved), ..view };
        let shown = |&(column, row): &(usize, usize)| {
            reference::render(&field, &Ray::through_pixel(&view, column, row), &samples)
        };
        pixels.iter().zip(&cotangents).map(|(p, c)| functional(&shown(p), c)).sum()
    });
}

fn map() -> (HashGridMap, FieldRenderer) {
    let march = MarchSettings { step_min: 0.05, step_max: 0.1, ..MarchSettings::cube(1.5) };
    let map = HashGridMap {
        field: field(settings(), 4).cast(),
        occupancy: Occupancy::new(OccupancySettings { resolution: 4, ..Default::default() }),
        march,
    };
    (map, FieldRenderer::new(march))
}

/// A picture of more pixels than are kept at once is what its rays show, forward and back.
#[test]
fn a_picture_is_its_rays() {
    let [width, height] = [80, 60];
    let (view, (map, mut renderer)) = (view(width, height).cast(), map());
    let (mut render, cotangent) = (Render::default(), cotangent(width, height));
    map.render(&mut renderer, &view, &mut render);
    let mut gradient = FieldGradient::zeros(&map.field);
    let tangent = map.pull_back(&mut renderer, &view, &cotangent, Some(&mut gradient));

    let pixel = |i: usize| (i % width, i / width);
    let count = width * height;
    let rays: Vec<Ray> =
        (0..count).map(|i| Ray::through_pixel(&view, pixel(i).0, pixel(i).1)).collect();
    let HashGridMap { field, occupancy, .. } = &map;
    let (mut renders, mut by_rays) = (Vec::new(), Vec::new());
    renderer.render(field, occupancy, &rays, &mut renders);
    for (i, ray) in renders.iter().enumerate() {
        let colour = [0, 1, 2].map(|c| render.radiance.data[c * count + i]);
        let (depth, opacity) = (render.depth.data[i], render.opacity.data[i]);
        assert_eq!(*ray, RayRender { radiance: colour, depth, opacity });
    }
    let cotangents: Vec<_> = (0..count)
        .map(|i| {
            let [r, g, b, depth, opacity] = cotangent.at(pixel(i).0, pixel(i).1);
            RayRender { radiance: [r, g, b], depth, opacity }
        })
        .collect();
    let mut whole = FieldGradient::zeros(field);
    renderer.pull_back(field, &rays, &cotangents, Some(&mut whole), Some(&mut by_rays));
    let poses = by_rays.iter().enumerate().map(|(i, g)| g.to_pose(&view, pixel(i).0, pixel(i).1));
    let sum = poses.fold(Tangent::zero(), Tangent::plus);
    assert_close("pose", &tangent.to_array(), &sum.to_array(), 1e-5);
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    assert_close("table", &wide(&gradient.table), &wide(&whole.table), 1e-5);
    assert_close("density", &wide(&gradient.density), &wide(&whole.density), 1e-5);
}

/// Depth is that along the optical axis: a wall at a distance has one depth in all pixels.
#[test]
fn depth_is_along_the_optical_axis() {
    let ((mut map, _), camera) = (map(), view(9, 7).camera.cast());
    let view = View { camera, world_from_camera: Pose::identity() };
    map.field.parameters_mut()[0].fill(0.0);
    // Only the cells behind z = 0.4 m (the middle of the cube) are there.
    let settings = OccupancySettings { resolution: 2, ..Default::default() };
    let there = |p: Vec3<f32>| p.z > 0.4;
    map.occupancy = Occupancy::of_cells([0.2, -0.1, 0.4], 1.5, settings, there);
    let rays = (0..63).map(|i| Ray::through_pixel(&view, i % 9, i / 9));
    for ray in rays {
        let first = map.occupancy.samples(&map.field, &map.march, &ray)[0];
        assert!((0.4..0.5).contains(&first.depth), "{first:?}");
    }
}

/// A cotangent without some planes is one with zeros.
#[test]
fn missing_planes_are_zeros() {
    let (view, (map, mut renderer)) = (view(12, 9).cast(), map());
    map.render(&mut renderer, &view, &mut Render::default());
    let mut zeros = cotangent(12, 9);
    zeros.depth.data.fill(0.0);
    zeros.opacity.data.fill(0.0);
    let missing = RenderCotangent { radiance: zeros.radiance.clone(), ..Default::default() };
    let tangent = map.pull_back(&mut renderer, &view, &zeros, None);
    assert_eq!(tangent, map.pull_back(&mut renderer, &view, &missing, None));
    assert_ne!(tangent, Tangent::zero());
    let nothing = map.pull_back(&mut renderer, &view, &RenderCotangent::default(), None);
    assert_eq!(nothing, Tangent::zero());
}
