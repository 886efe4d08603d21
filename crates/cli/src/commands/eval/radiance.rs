//! Linear radiance against the truth, after one gain for all frames.

use super::failed;
use super::figure::Figure;
use super::frames::Chosen;
use super::reference::Reference;
use super::subject::Subject;
use crate::failure::Failure;
use crate::picture::{at_size_of, read_exr};
use i2slam::geometry::Image;
use i2slam_eval::hdr::{Gain, HdrError, hdr_error_after};

/// All frames are held at once; of more, every n-th is judged.
const MAX_FRAMES: usize = 100;

/// The figures, none if there is no radiance to compare. A frame that lacks a render is left to
/// the judging of pictures.
pub(super) fn judge(
    subject: &Subject,
    reference: &Reference,
    chosen: &Chosen,
) -> Result<Vec<Figure>, Failure> {
    let renders = subject.renders("hdr", "exr")?;
    let listed =
        |frame: &usize| chosen.frames.is_empty() || chosen.frames.iter().any(|(f, _)| f == frame);
    let pairs: Vec<_> = renders
        .iter()
        .filter(|(frame, _)| listed(frame))
        .filter_map(|(frame, render)| Some((render, reference.radiance(*frame)?)))
        .collect();
    let mut frames: [Vec<Image<f32>>; 2] = [Vec::new(), Vec::new()];
    for (render, truth) in pairs.iter().step_by(pairs.len().div_ceil(MAX_FRAMES).max(1)) {
        let drawn = read_exr(render)?;
        let known = at_size_of(read_exr(truth)?, &drawn);
        let known = known.ok_or_else(|| failed(render, "has another size than its truth"))?;
        if frames[0].first().is_some_and(|first| first.width != drawn.width) {
            return Err(failed(render, "has another width than the frames before"));
        }
        frames[0].push(drawn);
        frames[1].push(known);
    }
    if frames[0].is_empty() {
        return Ok(Vec::new());
    }
    let count = frames[0].len();
    let [drawn, known] = frames.map(|frames| below_each_other(&frames));
    let common = hdr_error_after(Gain::Common, &drawn, &known, None)?;
    let each = hdr_error_after(Gain::PerChannel, &drawn, &known, None)?;
    Ok(figures(&common, &each, count))
}

/// One picture of pictures of equal width.
fn below_each_other(frames: &[Image<f32>]) -> Image<f32> {
    let (width, channels) = frames.first().map_or((0, 0), |f| (f.width, f.channels));
    let height = frames.iter().map(|f| f.height).sum();
    let planes = (0..channels).flat_map(|c| frames.iter().map(move |f| f.plane(c)));
    Image { width, height, channels, data: planes.collect::<Vec<_>>().concat() }
}

fn figures(common: &HdrError, each: &HdrError, frames: usize) -> Vec<Figure> {
    let figure = |key, label, unit, decimals, value| Figure {
        key,
        label,
        unit,
        decimals,
        value: Some(value),
    };
    let (stops, db) = ("stops", "dB");
    vec![
        figure("hdr_frames", "radiance: frames judged", "", 0, frames as f64),
        figure("hdr_log2_rmse_stops", "log2 radiance RMSE", stops, 3, common.log2_rmse_stops),
        figure("hdr_log2_psnr_db", "log2 radiance PSNR", db, 2, common.log2_psnr_db),
        figure("hdr_mu_law_psnr_db", "mu-law PSNR", db, 2, common.mu_law_psnr_db),
        figure(
            "hdr_log2_psnr_channel_gains_db",
            "log2 PSNR, gain per channel",
            db,
            2,
            each.log2_psnr_db,
        ),
        figure(
            "hdr_mu_law_psnr_channel_gains_db",
            "mu-law, gain per channel",
            db,
            2,
            each.mu_law_psnr_db,
        ),
    ]
}
