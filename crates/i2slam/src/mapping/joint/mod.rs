//! Joint optimisation of a radiance field and of keyframes whose poses are only roughly known.

mod field;
mod field_sampling;
mod pose_optimizer;
mod trajectory_term;

pub(crate) use field::JointFieldMapper;
