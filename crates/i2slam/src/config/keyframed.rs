//! Settings of a session on keyframes that come with poses.

use super::Config;
use serde::{Deserialize, Serialize};

/// How keyframes that come with poses (`run --rgb`) are refined together with a radiance field.
/// Lengths are in the unit of the poses, which is the metre only if their source knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyframedConfig {
    /// Keyframes that are waited for before the map starts.
    pub first_keyframes: usize,
    /// How far a keyframe without depth is taken to see.
    pub reach: f32,
    /// Learning rate of start and end poses: lengths and rad, or, with `preconditioning`
    /// "picture", root mean square changes of the picture. It falls tenfold during the steps after
    /// the last keyframe.
    pub camera_rate: f32,
    /// Steps of the map before poses move.
    pub pose_delay: usize,
    /// Whether poses are stepped in coordinates in which all of them change the picture alike
    /// (CamP); never without `formation.blur`.
    pub preconditioning: Preconditioning,
    /// Added to the diagonal of JᵀJ, as a share of it.
    pub preconditioning_damping: f32,
    /// Steps of a keyframe from one JᵀJ to the next; before the first of these, whenever its steps
    /// have doubled.
    pub preconditioning_interval: usize,
    /// λ_traj, against means over pixels; a sum over the squared unit of length and rad².
    pub trajectory_weight: f32,
    /// Whether the pictures of keyframes from files without depth are followed as a video, which
    /// gives them dense depth and, where it fits the pictures clearly better, other poses to begin
    /// with.
    pub refine_imported: bool,
    /// First distance of start and end pose, as a share of the motion in one frame interval.
    pub initial_split: f32,
    /// Standard deviations c beyond which an estimated depth is let go: its loss is Cauchy's
    /// c² ln(1 + r² / (c² σ²)); 0 for never, which is r² / σ².
    pub depth_outlier: f32,
    /// Steps during which the finer half of the grids comes in, one after another; 0 trains all
    /// from the start.
    pub coarse_steps: usize,
    /// λ_depth where keyframes come with estimated depth in most pixels: a mean of (d − d̂)² over
    /// its variance. Rays are then sampled around these surfaces alone, `hashgrid.shell` of their
    /// depth or three deviations to both sides.
    pub surface_depth_weight: f32,
    /// Share of it that is left at the last step: once depth has told where surfaces are, pictures
    /// tell better what is thin or beside an edge.
    pub surface_depth_left: f32,
    /// `camera_rate` there.
    pub surface_camera_rate: f32,
    /// Factor of `hashgrid.final_iterations` there: a step takes a tenth of the time.
    pub surface_steps: f32,
    /// Most samples of such a step, about: fewer than `hashgrid.rays` pixels are drawn while rays
    /// have many, as through the fog that a field begins as; 0 for any number.
    pub surface_samples: usize,
    /// Factor by which `hashgrid.occupancy_cells` is larger there, and `hashgrid.finest_cell`,
    /// `hashgrid.step` and `hashgrid.step_min` are smaller: there is less to sample.
    pub surface_detail: f32,
    /// Longest edge of a cell of the finest grid there, in pixels at the median depth when the field
    /// begins: what pictures resolve needs cells. With smaller ones than `hashgrid.finest_cell` asks
    /// for the field has at least a grid more for each halving, and up to four times the entries. 0
    /// for any.
    pub surface_cell: f32,
    /// Largest ratio of the cells of neighbouring grids there: a scene whose cube is large beside its
    /// finest cells gets more grids than `hashgrid.levels`, up to 32, each of which takes memory
    /// and time. 0 for any.
    pub surface_growth: f32,
    /// Times during these steps that all keyframes are found anew in the map.
    pub surface_searches: usize,
}

/// Coordinates in which poses are stepped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preconditioning {
    /// Their own: lengths and angles.
    Off,
    /// Those of `P = (JᵀJ + damping)^(-1/2)`, J being that of the picture (CamP).
    Picture,
    /// The same scaled so that a step is as long as without, in the root mean square of its twelve
    /// numbers: a map that is still smooth does not make it longer. What the picture hardly shows
    /// is damped like the mean translation or rotation.
    Pose,
}

impl Config {
    /// The same with the readout of the rows that a front end found [s], where settings name none
    /// and what they ask for can see rows that are read in turn.
    #[must_use]
    pub fn with_found_readout(self, seconds: f64) -> Self {
        if self.input.is_rolling() {
            return self;
        }
        let mut rolling = self.clone();
        rolling.input.rolling_shutter_readout = seconds;
        if rolling.validate().is_ok() { rolling } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::MapKind;

    #[test]
    fn a_readout_that_was_found_goes_to_maps_that_can_see_it() {
        let config = |kind, preset| {
            let mut config = Config::preset(preset).expect("known");
            config.map.kind = kind;
            config
        };
        let readout =
            |config: Config| config.with_found_readout(0.02).input.rolling_shutter_readout;
        assert_eq!(readout(config(MapKind::Gaussian, "default-rgb")), 0.02);
        assert_eq!(readout(config(MapKind::HashGrid, "default-rgb")), 0.0);
        assert_eq!(readout(config(MapKind::Gaussian, "paper-rgb")), 0.0);
        let mut still = config(MapKind::Gaussian, "default-rgb");
        still.formation.blur = false;
        assert_eq!(readout(still), 0.0);
        let mut given = config(MapKind::Gaussian, "default-rgb");
        given.input.rolling_shutter_readout = -0.01;
        assert_eq!(readout(given), -0.01);
        let mut searched = config(MapKind::Gaussian, "default-rgb");
        searched.input.optimise_rolling_shutter = true;
        let refusal = searched.validate().expect_err("nothing looks for it").to_string();
        assert!(refusal.contains("optimise_rolling_shutter"), "{refusal}");
    }
}
