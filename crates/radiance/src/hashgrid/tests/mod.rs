//! Tests of both lanes.

mod convergence;
mod files;
mod gradients;
mod occupancy;
mod parity;
mod poison;
mod scenes;
mod views;

use pulp::Arch;

/// Those of this machine that kernels are compiled for.
pub(super) fn instruction_sets() -> Vec<Arch> {
    let mut all = vec![Arch::new(), Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    all.extend(pulp::x86::V3::try_new().map(Arch::V3));
    all
}
