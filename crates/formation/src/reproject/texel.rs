//! Four numbers at once. Whole values in, whole values out: that is what compilers turn into one
//! vector operation each.

/// One sample of the fine grid: R, G, B and a zero.
pub(super) type Texel = [f32; 4];

/// `a + (b - a) t`.
#[inline(always)]
pub(super) fn mix(a: Texel, b: Texel, t: f32) -> Texel {
    [
        a[0] + (b[0] - a[0]) * t,
        a[1] + (b[1] - a[1]) * t,
        a[2] + (b[2] - a[2]) * t,
        a[3] + (b[3] - a[3]) * t,
    ]
}

/// `a + b s`.
#[inline(always)]
pub(super) fn add_scaled(a: Texel, b: Texel, s: f32) -> Texel {
    [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s, a[3] + b[3] * s]
}

/// `a - b`.
#[inline(always)]
pub(super) fn minus(a: Texel, b: Texel) -> Texel {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]]
}

/// `a s`.
#[inline(always)]
pub(super) fn scaled(a: Texel, s: f32) -> Texel {
    [a[0] * s, a[1] * s, a[2] * s, a[3] * s]
}

/// `a · b`.
#[inline(always)]
pub(super) fn dot(a: Texel, b: Texel) -> f32 {
    let p = [a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]];
    (p[0] + p[2]) + (p[1] + p[3])
}
