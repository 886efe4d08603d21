//! The fast lane of the encoding, sixteen positions at a time.

use super::Level;
pub(crate) use super::cpu_backward::BySlopes;
use super::cpu_backward::{PositionGradient, Scatter};
use super::cpu_forward::Encode;
use pulp::Arch;

/// Run a kernel for the number of features of a field, which its settings bound to 1, 2, 4 or 8.
macro_rules! dispatch {
    ($arch:expr, $features:expr, $kernel:ident $fields:tt) => {
        match $features {
            1 => $arch.dispatch($kernel::<1> $fields),
            2 => $arch.dispatch($kernel::<2> $fields),
            4 => $arch.dispatch($kernel::<4> $fields),
            _ => $arch.dispatch($kernel::<8> $fields),
        }
    };
}

/// [`Encode`] for `features` numbers per entry; `slopes` may be empty.
pub(crate) fn encode(
    arch: Arch,
    features: usize,
    (levels, table): (&[Level], &[f32]),
    positions: &[[f32; 3]],
    width: usize,
    out: &mut [f32],
    slopes: &mut [f32],
) {
    dispatch!(arch, features, Encode { levels, table, positions, out, width, slopes });
}

/// [`PositionGradient`] for `features` numbers per entry.
pub(crate) fn position_gradient(
    arch: Arch,
    features: usize,
    (levels, table): (&[Level], &[f32]),
    positions: &[[f32; 3]],
    (cotangent, width): (&[f32], usize),
    out: &mut [[f32; 3]],
) {
    dispatch!(arch, features, PositionGradient { levels, table, positions, cotangent, width, out });
}

/// [`Scatter`] for `features` numbers per entry.
pub(crate) fn scatter(
    arch: Arch,
    features: usize,
    level: &Level,
    positions: &[[f32; 3]],
    cotangent: &[f32],
    gradient: &mut [f32],
) {
    dispatch!(arch, features, Scatter { level, positions, cotangent, gradient });
}
