//! Optimisers, linear systems, vector instructions and random numbers, with the same bytes for any
//! number of threads.

mod adam;
mod cancellation;
mod linear;
mod memory;
mod random;
mod reduce;
pub mod simd;
mod skyline;
mod statistics;

pub use adam::{Adam, AdamSettings};
pub use cancellation::CancellationToken;
pub use linear::{NormalEquations, factorize_cholesky, solve_cholesky, solve_positive_definite};
pub use memory::machine_memory;
pub use random::Random;
pub use reduce::reduce_in_order;
pub use skyline::{SkylineMatrix, reverse_cuthill_mckee};
pub use statistics::{SIGMA_PER_MEDIAN, correlation, median};
