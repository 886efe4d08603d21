//! What is exported: a reconstruction, cut to what was asked for, and its levelled world.

use super::axes::Axes;
use super::blended_colours::{evenly_spaced, picture_splats};
use super::error::ExportError;
use super::level::{LEVEL_UP, Up, level};
use super::screen_filter::widen;
use super::seen::views;
use super::splat::{Display, Splat, splats};
use crate::{FrameFiles, UnitOfLength};
use i2slam::geometry::{Pose, Vec3};
use i2slam::radiance::gaussian::GaussianMap;
use i2slam::{FrameEstimate, Map, Reconstruction};
use std::collections::BTreeMap;

/// Frames whose distances from a Gaussian are compared, evenly spread.
const MAX_COMPARED_FRAMES: usize = 64;

/// A box in the levelled world [m], from its least to its largest corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CropBox {
    /// Least coordinates.
    pub least: [f64; 3],
    /// Largest coordinates.
    pub most: [f64; 3],
}

impl CropBox {
    fn contains(&self, point: Vec3<f64>) -> bool {
        let point = point.to_array();
        (0..3).all(|i| (self.least[i]..=self.most[i]).contains(&point[i]))
    }
}

/// Choice of what is exported, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Selection {
    /// Gaussians with their mean outside this box are left out.
    pub crop: Option<CropBox>,
    /// Gaussians of a lower opacity are left out, 0 to 1.
    pub min_opacity: f32,
    /// Gaussians that fewer frames see are left out.
    pub min_views: usize,
    /// Where up is.
    pub up: Up,
    /// Whether colours are linear radiance, in place of picture values.
    pub linear: bool,
    /// Whether frames that are no keyframes are left out.
    pub keyframes: bool,
    /// Whether all pictures of a video have the exposure that is typical of the run, in place of those that
    /// the camera would have chosen.
    pub constant_exposure: bool,
}

/// What is exported.
pub struct Scene {
    /// The reconstruction in its own world, with the Gaussians that were chosen.
    pub(crate) reconstruction: Reconstruction,
    /// The frames that were chosen and whose pose was found.
    pub(crate) frames: Vec<FrameEstimate>,
    level_from_world: Pose<f64>,
    ground: Option<f64>,
    pub(crate) linear: bool,
    pub(crate) constant_exposure: bool,
    /// True if Gaussians were left out.
    pub(crate) is_cut: bool,
    /// Files of the pictures taken.
    pub(crate) files: FrameFiles,
    /// True if the frames are photographs in any order.
    pub(crate) is_unordered: bool,
    /// Names of pictures without ending, where these are not their numbers.
    picture_stems: Option<BTreeMap<usize, String>>,
}

impl Scene {
    /// Chooses from a reconstruction.
    ///
    /// # Errors
    /// [`ExportError::Refused`] where a hash grid is to be cut, or nothing is left.
    pub fn new(
        mut reconstruction: Reconstruction,
        selection: &Selection,
    ) -> Result<Self, ExportError> {
        let (turn, ground) = level(&reconstruction, selection.up);
        let level_from_world = Pose::new(turn, LEVEL_UP * -ground.unwrap_or(0.0));
        let frames = reconstruction.frames.iter();
        let is_chosen = |f: &&FrameEstimate| f.tracked && (f.keyframe || !selection.keyframes);
        let frames: Vec<FrameEstimate> = frames.filter(is_chosen).cloned().collect();
        if frames.is_empty() {
            let what = if selection.keyframes { "keyframe" } else { "frame" };
            return Err(ExportError::refused(format!("the result has no {what} with a pose")));
        }
        let is_cut =
            selection.crop.is_some() || selection.min_opacity > 0.0 || selection.min_views > 0;
        if is_cut {
            let views = views_of(&reconstruction, &frames, selection.min_views);
            let Map::Gaussians(map) = &mut reconstruction.map else {
                return Err(ExportError::refused(
                    "the map is a hash grid: it has no Gaussians to leave out, export it without \
                     --crop, --min-opacity and --min-views",
                ));
            };
            let most_views = views.iter().max().copied().unwrap_or(0);
            if (1..selection.min_views).contains(&most_views) {
                return Err(ExportError::refused(format!(
                    "--min-views {}: expected 1 to {most_views}, the most of the {} frames with a pose that see \
                     one Gaussian",
                    selection.min_views,
                    frames.len()
                )));
            }
            keep(map, |i, mean, opacity| {
                let inside = |b: CropBox| b.contains(level_from_world * mean);
                let is_seen = views.get(i).is_none_or(|views| *views >= selection.min_views);
                opacity >= selection.min_opacity && is_seen && selection.crop.is_none_or(inside)
            });
            if map.is_empty() {
                return Err(ExportError::refused(
                    "no Gaussian is left: choose a larger box, a lower opacity or fewer views (the box is in the \
                     levelled world, x right, y down, z forward of the first camera)",
                ));
            }
        }
        let Selection { linear, constant_exposure, .. } = *selection;
        Ok(Self {
            reconstruction,
            frames,
            level_from_world,
            ground,
            linear,
            constant_exposure,
            is_cut,
            files: FrameFiles::default(),
            is_unordered: false,
            picture_stems: None,
        })
    }

    /// Names the files of the pictures taken; pictures of photographs (`is_unordered`) are named after them,
    /// where they can be.
    #[must_use]
    pub fn with_files(self, files: FrameFiles, is_unordered: bool) -> Self {
        let picture_stems = is_unordered.then(|| files.stems(&self.frames)).flatten();
        Self { files, is_unordered, picture_stems, ..self }
    }

    /// True if pictures get the detail of those taken: these show what was cut from a map, and motion in them
    /// is unknown where blur was not modelled.
    pub fn has_detail_of_pictures(&self) -> bool {
        !self.is_cut && self.reconstruction.config.formation.blur
    }

    /// Frames that have a pose.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Name of a frame's picture.
    pub(crate) fn picture_name(&self, frame: &FrameEstimate) -> String {
        let stem = self.picture_stems.as_ref().and_then(|stems| stems.get(&frame.index));
        let number = || format!("{:06}", frame.index);
        let extension = if self.linear { "exr" } else { "png" };
        format!("{}.{extension}", stem.cloned().unwrap_or_else(number))
    }

    /// True if there is a map.
    pub fn has_map(&self) -> bool {
        !self.reconstruction.map.is_empty()
    }

    /// Number of Gaussians that were chosen; 0 of a hash grid.
    pub fn gaussians(&self) -> usize {
        self.reconstruction.map.gaussians()
    }

    /// The box, in the world of [`CropBox`], that holds all chosen Gaussians but the outermost hundredth on each
    /// side: least x, y, z, greatest x, y, z. `None` of a hash grid and of an empty map.
    pub fn bounds(&self) -> Option<[f64; 6]> {
        let Map::Gaussians(map) = &self.reconstruction.map else { return None };
        let place = |mean: &[f32; 3]| {
            (self.level_from_world * Vec3::from_array(mean.map(f64::from))).to_array()
        };
        let places: Vec<[f64; 3]> = map.means.iter().map(place).collect();
        let outermost = places.len() / 100;
        let mut bounds = [0.0; 6];
        for axis in 0..3 {
            let mut along: Vec<f64> = places.iter().map(|place| place[axis]).collect();
            along.sort_by(f64::total_cmp);
            bounds[axis] = *along.get(outermost)?;
            bounds[axis + 3] = along[along.len() - 1 - outermost];
        }
        Some(bounds)
    }

    /// The unit of all lengths.
    pub fn unit(&self) -> UnitOfLength {
        self.reconstruction.unit_of_length
    }

    /// True if the world of files is not that of the result.
    pub fn is_levelled(&self) -> bool {
        self.level_from_world != Pose::identity()
    }

    /// Angle by which the world was turned to level it [rad].
    pub fn levelling(&self) -> f64 {
        self.level_from_world.rotation.log().norm()
    }

    /// Height of the ground above the origin of the result; `None` where none was found, or the world is kept.
    pub fn ground(&self) -> Option<f64> {
        self.ground
    }

    /// The motion from the world of the result to that of a file.
    pub(crate) fn file_from_world(&self, axes: Axes) -> Pose<f64> {
        Pose::new(axes.rotation(), Vec3::zero()) * self.level_from_world
    }

    /// The pose of a frame at mid-exposure in the world of a file.
    pub(crate) fn pose(&self, frame: &FrameEstimate, axes: Axes) -> Pose<f64> {
        self.file_from_world(axes) * frame.middle()
    }

    /// Refuses an empty map, from which nothing can be drawn.
    ///
    /// # Errors
    /// [`ExportError::Refused`].
    pub(crate) fn require_map(&self) -> Result<(), ExportError> {
        match self.has_map() {
            true => Ok(()),
            false => Err(ExportError::refused("the map of the result is empty")),
        }
    }

    /// The Gaussians of the map, in the world of a file.
    ///
    /// # Errors
    /// [`ExportError::Refused`] for a hash grid, and an empty map.
    pub fn splats(&self, axes: Axes) -> Result<Vec<Splat>, ExportError> {
        self.require_map()?;
        let map = match &self.reconstruction.map {
            Map::Gaussians(map) => map,
            Map::HashGrid(_) => {
                return Err(ExportError::refused(
                    "the map is a hash grid, which has no Gaussians to write: export its pictures \
                     (colmap, nerfstudio, video), its mesh or its path (tum, csv)",
                ));
            }
        };
        let file_from_world = self.file_from_world(axes);
        Ok(match self.linear {
            true => splats(map, &Display::Linear, file_from_world),
            false => picture_splats(&self.reconstruction, map, file_from_world),
        })
    }

    /// [`splats`](Self::splats) without gaps in viewers whose screen filter is narrower than that of the map:
    /// wider by what is missing in the nearest frame. Those of linear radiance, for programs that train on or
    /// light them, stay as they are.
    ///
    /// # Errors
    /// As [`splats`](Self::splats).
    pub fn splats_for_viewers(&self, axes: Axes) -> Result<Vec<Splat>, ExportError> {
        let mut splats = self.splats(axes)?;
        if !self.linear {
            let frames = evenly_spaced(&self.reconstruction.frames, MAX_COMPARED_FRAMES);
            let poses: Vec<Pose<f64>> =
                frames.into_iter().map(|frame| self.pose(frame, axes)).collect();
            widen(&mut splats, &self.reconstruction.camera, &poses);
        }
        Ok(splats)
    }
}

/// Frames that see each Gaussian, where somebody asks; else none.
fn views_of(
    reconstruction: &Reconstruction,
    frames: &[FrameEstimate],
    min_views: usize,
) -> Vec<usize> {
    match &reconstruction.map {
        Map::Gaussians(map) if min_views > 0 => views(reconstruction, frames, &map.means),
        _ => Vec::new(),
    }
}

/// Keeps the Gaussians that a rule on number, mean and opacity lets pass.
fn keep(map: &mut GaussianMap<f32>, passes: impl Fn(usize, Vec3<f64>, f32) -> bool) {
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    let kept: Vec<bool> = map
        .means
        .iter()
        .zip(&map.opacity_logits)
        .enumerate()
        .map(|(i, (mean, logit))| passes(i, Vec3::from_array(mean.map(f64::from)), opacity(*logit)))
        .collect();
    map.retain(&kept);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::example;

    #[test]
    fn picture_values_are_wider_for_viewers_and_radiance_is_not() {
        let scales = |linear: bool, for_viewers: bool| {
            let selection = Selection { linear, up: Up::Kept, ..Selection::default() };
            let scene = Scene::new(example(2), &selection).expect("a scene");
            let splats = match for_viewers {
                true => scene.splats_for_viewers(Axes::YDown),
                false => scene.splats(Axes::YDown),
            };
            let splats = splats.expect("a map of Gaussians");
            splats.iter().map(|splat| splat.log_scale).collect::<Vec<_>>()
        };
        let (map, radiance) = (scales(false, false), scales(true, false));
        assert_eq!(map, radiance);
        assert_eq!(scales(true, true), radiance);
        let wider = scales(false, true);
        assert!(wider.iter().flatten().zip(map.iter().flatten()).all(|(a, b)| a >= b));
        assert_ne!(wider, map);
    }
}
