//! What the page knows beside the Gaussians: camera, frames with their tone, responses, path.

use super::ViewerPage;
use super::quantise::QuantisedMap;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use i2slam::FrameEstimate;
use i2slam::formation::ResponseCurve;
use i2slam::radiance::gaussian::{ColourActivation, RasterSettings};
use serde::Serialize;

/// Largest number of frames that one can step through; of longer sequences an even choice.
pub(super) const MAX_FRAMES: usize = 100;

/// Largest number of points of the path; of longer ones every n-th.
const MAX_PATH: usize = 2000;

/// The JSON of the page.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Scene {
    gaussians: usize,
    chunk: usize,
    /// View colours, of the first Gaussians, and terms of all of them.
    view_colours: usize,
    view_terms: usize,
    /// Whether colours are logarithms of radiance; otherwise picture values.
    logarithmic: bool,
    /// Whether pictures are formed by exposure, white balance and response.
    tone: bool,
    /// Cut-offs of the renderer, as of ours.
    near: f32,
    far: f32,
    screen_variance: f32,
    alpha_min: f32,
    alpha_max: f32,
    camera: SceneCamera,
    /// Direction against gravity.
    up: [f32; 3],
    frames: Vec<SceneFrame>,
    /// Response curves, one or three tables each; [`response_table`].
    responses: Vec<Vec<String>>,
    /// Positions at mid-exposure of all tracked frames.
    path: Vec<[f32; 3]>,
}

#[derive(Serialize)]
struct SceneCamera {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

/// A frame that one can step to.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct SceneFrame {
    index: usize,
    /// Number and file.
    name: String,
    /// Since the first of them [s].
    time: f32,
    /// World from camera at mid-exposure.
    position: [f32; 3],
    /// Quaternion w, x, y, z.
    rotation: [f32; 4],
    log_exposure: f32,
    log_white_balance: [f32; 3],
    /// Place among the responses of the page.
    response: usize,
    /// Blur length [px].
    blur: f32,
    /// The picture taken, as a `data:` address; empty if it is not there.
    picture: String,
}

impl Scene {
    /// The scene of a map; `picture` gives the address of the picture of a frame.
    pub(super) fn new(
        page: &ViewerPage<'_>,
        map: &QuantisedMap,
        activation: ColourActivation,
        mut picture: impl FnMut(&FrameEstimate) -> String,
    ) -> Self {
        let settings = RasterSettings::default();
        let reconstruction = page.reconstruction;
        let camera = &reconstruction.camera;
        let (mut responses, mut used) = (Vec::new(), Vec::new());
        let chosen = chosen_frames(page.frames);
        let start = chosen.first().map_or(0.0, |frame| frame.timestamp);
        let mut place_of = |response: usize| {
            used.iter().position(|&known| known == response).unwrap_or_else(|| {
                used.push(response);
                responses.push(response_tables(&reconstruction.responses[response].curve()));
                responses.len() - 1
            })
        };
        let frames = chosen.iter().map(|frame| {
            let tone = frame.tone;
            let pose = frame.middle();
            SceneFrame {
                index: frame.index,
                name: page.files.name(frame.index),
                time: (frame.timestamp - start) as f32,
                position: pose.translation.to_array().map(|v| v as f32),
                rotation: quaternion(frame),
                log_exposure: tone.log_exposure,
                log_white_balance: tone.log_white_balance,
                response: place_of(frame.response),
                blur: frame.blur_length as f32,
                picture: picture(frame),
            }
        });
        Self {
            frames: frames.collect(),
            gaussians: map.count,
            view_colours: map.view_colours,
            view_terms: map.view_terms,
            chunk: super::quantise::CHUNK,
            logarithmic: activation == ColourActivation::Exponential,
            tone: reconstruction.config.formation.tone,
            near: settings.near,
            far: settings.far,
            screen_variance: settings.screen_variance,
            alpha_min: settings.alpha_min,
            alpha_max: settings.alpha_max,
            camera: SceneCamera {
                width: camera.width,
                height: camera.height,
                fx: camera.fx,
                fy: camera.fy,
                cx: camera.cx,
                cy: camera.cy,
            },
            responses,
            up: page.up.to_array().map(|v| v as f32),
            path: path(page.frames),
        }
    }

    /// JSON that may stand in a `script` element.
    pub(super) fn json(&self) -> String {
        // Numbers and strings always serialise; `<` only occurs in strings.
        serde_json::to_string(self).unwrap_or_default().replace('<', "\\u003c")
    }
}

/// World-from-camera quaternion w, x, y, z at mid-exposure.
fn quaternion(frame: &FrameEstimate) -> [f32; 4] {
    let q = frame.middle().rotation;
    [q.w, q.v.x, q.v.y, q.v.z].map(|v| v as f32)
}

/// At most [`MAX_FRAMES`] of the tracked frames, evenly spread, the first among them.
pub(super) fn chosen_frames(frames: &[FrameEstimate]) -> Vec<&FrameEstimate> {
    let tracked: Vec<&FrameEstimate> = frames.iter().filter(|frame| frame.tracked).collect();
    let count = tracked.len().min(MAX_FRAMES);
    (0..count).map(|i| tracked[i * tracked.len() / count]).collect()
}

fn path(frames: &[FrameEstimate]) -> Vec<[f32; 3]> {
    let tracked: Vec<&FrameEstimate> = frames.iter().filter(|frame| frame.tracked).collect();
    let apart = tracked.len().div_ceil(MAX_PATH).max(1);
    let position = |f: &&FrameEstimate| f.middle().translation.to_array().map(|v| v as f32);
    tracked.iter().step_by(apart).map(position).collect()
}

/// Entries of a response table.
const TABLE: usize = 512;

/// Tables of one curve for all channels, or of three.
fn response_tables(curve: &ResponseCurve<f32>) -> Vec<String> {
    (0..curve.curves()).map(|channel| STANDARD.encode(response_table(curve, channel))).collect()
}

/// Picture values at [`TABLE`] linear values, evenly spaced in the fourth root (so that shadows
/// have their share), as `u16`, little endian.
fn response_table(curve: &ResponseCurve<f32>, channel: usize) -> Vec<u8> {
    let value = |i: usize| {
        let root = i as f32 / (TABLE - 1) as f32;
        let value = curve.evaluate(channel, root.powi(4)).clamp(0.0, 1.0);
        ((value * f32::from(u16::MAX)).round() as u16).to_le_bytes()
    };
    (0..TABLE).flat_map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::super::quantise::quantised;
    use super::*;
    use crate::FrameFiles;
    use crate::tests::example;
    use i2slam::formation::{CameraResponse, NodeSpacing, StartCurve};
    use i2slam::radiance::gaussian::{GaussianMap, Shape};

    #[test]
    fn long_sequences_show_an_even_choice_of_tracked_frames() {
        let frames = example(450).frames;
        let chosen = chosen_frames(&frames);
        assert_eq!((chosen.len(), chosen[0].index), (MAX_FRAMES, 0));
        assert!(chosen.windows(2).all(|w| matches!(w[1].index - w[0].index, 8 | 10)));
        assert!(chosen.iter().all(|frame| frame.tracked));
        assert_eq!(chosen_frames(&frames[..5]).len(), 4);
        assert!(chosen_frames(&[]).is_empty());
    }

    #[test]
    fn tables_stay_close_to_the_curve() {
        let mut response = CameraResponse::new(3, StartCurve::Shoulder, NodeSpacing::Power(2.2));
        response.nodes[2].iter_mut().enumerate().for_each(|(i, v)| {
            *v += 0.02 * (0.05 * i as f32).sin();
        });
        let curve = response.curve();
        for channel in 0..3 {
            let bytes = response_table(&curve, channel);
            let values: Vec<f32> = bytes
                .chunks_exact(2)
                .map(|b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0)
                .collect();
            for k in 0..=4000 {
                let x = (k as f32 / 4000.0).powi(3);
                let at = x.sqrt().sqrt() * (TABLE - 1) as f32;
                let i = (at as usize).min(TABLE - 2);
                let value = values[i] + (at - i as f32) * (values[i + 1] - values[i]);
                let due = curve.evaluate(channel, x);
                assert!((value - due).abs() < 0.25 / 255.0, "{value} for {due} at {x}");
            }
        }
    }

    #[test]
    fn every_response_is_written_once() {
        let mut reconstruction = example(8);
        let more = reconstruction.responses[0].clone();
        reconstruction.responses.extend([more.clone(), more]);
        reconstruction.frames[5].response = 2;
        let exponential = ColourActivation::Exponential;
        let map = quantised(&GaussianMap::new(Shape::Isotropic, exponential));
        let files = FrameFiles::default();
        let page = ViewerPage::of("x", &reconstruction, &files);
        let scene = Scene::new(&page, &map, exponential, |_| "</script>".into());
        assert_eq!(scene.responses.len(), 2);
        let places: Vec<usize> = scene.frames.iter().map(|frame| frame.response).collect();
        assert_eq!(places, [0, 0, 0, 0, 1, 0, 0]);
        assert_eq!(scene.path.len(), 7);
        let json = scene.json();
        assert!(!json.contains('<') && json.contains("\\u003c/script>"), "{json}");
    }
}
