//! What the tests of all fast lanes run on.

use pulp::Arch;

/// The instruction sets of this machine that a lane may run on.
pub(crate) fn instruction_sets() -> Vec<Arch> {
    let mut all = vec![Arch::new(), Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    all.extend(pulp::x86::V3::try_new().map(Arch::V3));
    all
}
