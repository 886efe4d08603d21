//! The primitive shapes and their ray intersections.

use super::Vec3;

/// A ray between two parameters; a point on it is `origin + t direction`.
pub(crate) struct Ray {
    pub(crate) origin: Vec3,
    /// Not of unit length: a camera's rays have length 1 along the optical axis, so that `t` is
    /// depth.
    pub(crate) direction: Vec3,
    pub(crate) from: f32,
    pub(crate) to: f32,
}

/// First intersection of a ray with a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) t: f32,
    /// Index of the surface.
    pub(crate) surface: usize,
    /// Position on the surface, in `[0, 1]²`.
    pub(crate) st: [f32; 2],
}

/// A surface without its material.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// `origin + s edges[0] + t edges[1]`, perpendicular edges, seen upright from the side of
    /// `normal`; `round`: only the ellipse inside.
    Quad { origin: Vec3, edges: [Vec3; 2], normal: Vec3, inverse: [Vec3; 2], round: bool },
    /// A ball; `(s, t)` is the octahedral map of its direction.
    Ball { centre: Vec3, radius: f32 },
    /// An upright frustum of a cone without its ends: `base` is the middle of its lower end.
    Frustum { base: Vec3, height: f32, radii: [f32; 2] },
    /// A rod with round ends; `axis` has unit length.
    Rod { foot: Vec3, axis: Vec3, length: f32, radius: f32 },
}

/// The product by component.
pub(super) fn by_component(a: Vec3, b: Vec3, f: impl Fn(f32, f32) -> f32) -> Vec3 {
    Vec3::new(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z))
}

impl Shape {
    /// A rectangle from its upper left corner, its edge to the right and its edge down.
    pub(crate) fn quad(origin: Vec3, right: Vec3, down: Vec3, round: bool) -> Self {
        let normal = down.cross(right);
        let normal = normal * normal.norm().recip();
        let inverse = [right, down].map(|e| e * e.norm_squared().recip());
        Self::Quad { origin, edges: [right, down], normal, inverse, round }
    }

    /// A rod between the middles of its round ends.
    pub(crate) fn rod(from: Vec3, to: Vec3, radius: f32) -> Self {
        let length = (to - from).norm();
        Self::Rod { foot: from, axis: (to - from) * length.recip(), length, radius }
    }

    /// Corners of a box around the shape.
    pub(crate) fn bounds(&self) -> [Vec3; 2] {
        match *self {
            Self::Quad { origin, edges: [e, f], .. } => {
                let corners = [origin, origin + e, origin + f, origin + e + f];
                let fold = |g: fn(f32, f32) -> f32| {
                    corners.into_iter().skip(1).fold(corners[0], |a, b| by_component(a, b, g))
                };
                [fold(f32::min), fold(f32::max)]
            }
            Self::Ball { centre, radius } => {
                let r = Vec3::new(radius, radius, radius);
                [centre - r, centre + r]
            }
            Self::Frustum { base, height, radii } => {
                let r = radii[0].max(radii[1]);
                [base - Vec3::new(r, r, 0.0), base + Vec3::new(r, r, height)]
            }
            Self::Rod { foot, axis, length, radius } => {
                let (r, top) = (Vec3::new(radius, radius, radius), foot + axis * length);
                [by_component(foot, top, f32::min) - r, by_component(foot, top, f32::max) + r]
            }
        }
    }

    /// Length of the shape along `s` and `t` [m].
    pub(crate) fn extent(&self) -> [f32; 2] {
        match *self {
            Self::Quad { edges, .. } => edges.map(|e| e.norm()),
            Self::Ball { radius, .. } => [3.5 * radius; 2],
            Self::Frustum { height, radii, .. } => {
                [std::f32::consts::PI * (radii[0] + radii[1]), height.hypot(radii[1] - radii[0])]
            }
            Self::Rod { length, radius, .. } => [std::f32::consts::TAU * radius, length],
        }
    }

    /// Fewest texels of light along `s` and `t`.
    pub(crate) fn least_texels(&self) -> [f32; 2] {
        // Light changes around a rod however thin it is.
        if matches!(self, Self::Rod { .. }) { [6.0, 2.0] } else { [2.0; 2] }
    }

    /// The point and the outward normal at `(s, t)`.
    pub(crate) fn at(&self, [s, t]: [f32; 2]) -> (Vec3, Vec3) {
        match *self {
            Self::Quad { origin, edges: [e, f], normal, .. } => (origin + e * s + f * t, normal),
            Self::Ball { centre, radius } => {
                let normal = octahedron_direction([s, t]);
                (centre + normal * radius, normal)
            }
            Self::Frustum { base, height, radii } => {
                let (sine, cosine) = (std::f32::consts::TAU * s).sin_cos();
                let up = 1.0 - t;
                let radius = radii[0] + (radii[1] - radii[0]) * up;
                let slope = (radii[0] - radii[1]) / height;
                let normal = Vec3::new(cosine, sine, slope) * (1.0 + slope * slope).sqrt().recip();
                (base + Vec3::new(radius * cosine, radius * sine, up * height), normal)
            }
            Self::Rod { foot, axis, length, radius } => {
                let ((sine, cosine), (x, y)) =
                    ((std::f32::consts::TAU * s).sin_cos(), orthonormal_basis(axis));
                let normal = x * cosine + y * sine;
                (foot + axis * (length * t) + normal * radius, normal)
            }
        }
    }

    /// Ray parameter and `(s, t)` of the intersection between the ray's ends.
    #[inline]
    pub(crate) fn intersect(&self, ray: &Ray, to: f32) -> Option<(f32, [f32; 2])> {
        match self {
            Self::Quad { origin, normal, inverse, round, .. } => {
                let t = normal.dot(*origin - ray.origin) / normal.dot(ray.direction);
                // Also refuses the NaN of a ray inside the plane.
                if !(t > ray.from && t < to) {
                    return None;
                }
                let p = ray.origin + ray.direction * t - *origin;
                let st = [p.dot(inverse[0]), p.dot(inverse[1])];
                let inside = st[0] >= 0.0 && st[0] <= 1.0 && st[1] >= 0.0 && st[1] <= 1.0;
                let cut = *round && (st[0] - 0.5).powi(2) + (st[1] - 0.5).powi(2) > 0.25;
                (inside && !cut).then_some((t, st))
            }
            Self::Ball { centre, radius } => intersect_ball(ray, to, *centre, *radius),
            Self::Frustum { base, height, radii } => {
                intersect_frustum(ray, to, *base, *height, *radii)
            }
            Self::Rod { foot, axis, length, radius } => {
                intersect_rod(ray, to, (*foot, *axis, *length), *radius)
            }
        }
    }
}

fn intersect_ball(ray: &Ray, to: f32, centre: Vec3, radius: f32) -> Option<(f32, [f32; 2])> {
    let (o, d) = (ray.origin - centre, ray.direction);
    let (a, b) = (d.norm_squared(), o.dot(d));
    let closest = o - d * (b / a);
    let inside = radius * radius - closest.norm_squared();
    if inside <= 0.0 {
        return None;
    }
    let half = (inside / a).sqrt();
    let t = [-b / a - half, -b / a + half].into_iter().find(|&t| t > ray.from && t < to)?;
    Some((t, octahedron_position((o + d * t) * radius.recip())))
}

fn intersect_frustum(
    ray: &Ray,
    to: f32,
    base: Vec3,
    height: f32,
    radii: [f32; 2],
) -> Option<(f32, [f32; 2])> {
    let (o, d) = (ray.origin - base, ray.direction);
    let k = (radii[1] - radii[0]) / height;
    let radius = radii[0] + k * o.z;
    let a = d.x * d.x + d.y * d.y - k * k * d.z * d.z;
    let b = o.x * d.x + o.y * d.y - k * radius * d.z;
    let c = o.x * o.x + o.y * o.y - radius * radius;
    let root = b * b - a * c;
    if root <= 0.0 || a.abs() < 1e-12 {
        return None;
    }
    let root = root.sqrt();
    let (near, far) = ((-b - root) / a, (-b + root) / a);
    [near.min(far), near.max(far)].into_iter().find_map(|t| {
        let z = o.z + t * d.z;
        let met = t > ray.from && t < to && z >= 0.0 && z <= height;
        met.then(|| {
            let angle = (o.y + t * d.y).atan2(o.x + t * d.x) / std::f32::consts::TAU;
            (t, [angle.rem_euclid(1.0), 1.0 - z / height])
        })
    })
}

/// A cylinder seen from outside, or the nearer of the balls at its ends.
fn intersect_rod(
    ray: &Ray,
    to: f32,
    (foot, axis, length): (Vec3, Vec3, f32),
    radius: f32,
) -> Option<(f32, [f32; 2])> {
    let o = ray.origin - foot;
    let (along, step) = (o.dot(axis), ray.direction.dot(axis));
    let (across, d) = (o - axis * along, ray.direction - axis * step);
    let a = d.norm_squared();
    let place = |t: f32| {
        let p = across + d * t;
        let (x, y) = orthonormal_basis(axis);
        let angle = p.dot(y).atan2(p.dot(x)) / std::f32::consts::TAU;
        (t, [angle.rem_euclid(1.0), ((along + step * t) / length).clamp(0.0, 1.0)])
    };
    let middle = -across.dot(d) / a;
    let inside = radius * radius - (across + d * middle).norm_squared();
    // Also refuses the NaN of a ray along the axis, which meets an end.
    if inside < 0.0 {
        return None;
    }
    let t = middle - (inside / a).sqrt();
    let height = along + step * t;
    if height >= 0.0 && height <= length {
        return (t > ray.from && t < to).then(|| place(t));
    }
    let ends = [foot, foot + axis * length].map(|end| intersect_ball(ray, to, end, radius));
    let near = ends.into_iter().flatten().map(|(t, _)| t).min_by(f32::total_cmp)?;
    Some(place(near))
}

/// Two unit vectors orthogonal to a unit vector (Duff et al. 2017).
pub(crate) fn orthonormal_basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let first = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    (first, Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// The octahedral map of a unit vector to `[0, 1]²` (Meyer et al. 2010).
fn octahedron_position(n: Vec3) -> [f32; 2] {
    let sum = n.x.abs() + n.y.abs() + n.z.abs();
    let (x, y) = (n.x / sum, n.y / sum);
    let (x, y) = if n.z >= 0.0 {
        (x, y)
    } else {
        ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y))
    };
    [0.5 + 0.5 * x, 0.5 + 0.5 * y]
}

/// The inverse of [`octahedron_position`].
fn octahedron_direction([s, t]: [f32; 2]) -> Vec3 {
    let (x, y) = (2.0 * s - 1.0, 2.0 * t - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let (x, y) =
        if z >= 0.0 { (x, y) } else { ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)) };
    let v = Vec3::new(x, y, z);
    v * v.norm().recip()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ray from afar through the surface point must come back at its `(s, t)`.
    #[test]
    fn rays_hit_the_points_they_aim_at() {
        let shapes = [
            Shape::quad(
                Vec3::new(1.0, 2.0, 3.0),
                Vec3::new(0.6, 0.8, 0.0),
                Vec3::new(0.0, 0.0, -2.0),
                false,
            ),
            Shape::Ball { centre: Vec3::new(0.2, -0.4, 1.0), radius: 0.7 },
            Shape::Frustum { base: Vec3::new(0.5, 0.1, 0.3), height: 0.8, radii: [0.4, 0.2] },
            Shape::rod(Vec3::new(0.2, 0.1, 1.0), Vec3::new(0.7, -0.3, 1.4), 0.05),
        ];
        for shape in shapes {
            for st in [[0.3, 0.4], [0.72, 0.11], [0.15, 0.93]] {
                let (point, normal) = shape.at(st);
                let origin = point + normal * 2.0;
                let ray = Ray { origin, direction: -normal * 0.5, from: 1e-3, to: 1e9 };
                let (t, found) = shape.intersect(&ray, 1e9).expect("a hit");
                assert!((t - 4.0).abs() < 1e-4, "{shape:?} {t}");
                assert!((found[0] - st[0]).abs() + (found[1] - st[1]).abs() < 1e-4, "{shape:?}");
            }
        }
    }

    #[test]
    fn a_rod_has_round_ends_and_lies_within_its_bounds() {
        let (foot, top) = (Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0, 0.3, 0.4));
        let rod = Shape::rod(foot, top, 0.1);
        let axis = (top - foot) * 2.0;
        let down = Ray { origin: top + axis, direction: -axis, from: 0.0, to: 9.0 };
        let (t, st) = rod.intersect(&down, 9.0).expect("the end");
        assert!((t - 0.9).abs() < 1e-5 && st[1] == 1.0, "{t} {st:?}");
        let [low, high] = rod.bounds();
        assert!((high - Vec3::new(1.1, 0.4, 0.5)).norm() < 1e-6);
        assert!((low - Vec3::new(0.9, -0.1, -0.1)).norm() < 1e-6);
        let (origin, direction) =
            (top + axis * 0.11 - Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0, 0.0, 0.0));
        let beside = Ray { origin, direction, from: 0.0, to: 9.0 };
        assert!(rod.intersect(&beside, 9.0).is_none());
    }

    #[test]
    fn a_quad_shows_its_normal_to_the_viewer_who_sees_it_upright() {
        // Seen along +y: right is +x, down is -z, so the normal points to -y.
        let quad =
            Shape::quad(Vec3::zero(), Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -1.0), false);
        assert!((quad.at([0.5, 0.5]).1 - Vec3::new(0.0, -1.0, 0.0)).norm() < 1e-6);
    }
}
