//! `i2slam eval`: a result, or any trajectory, against the truth.

use crate::arguments::{Eval, Fit};
use crate::failure::Failure;
use crate::output::say;
use crate::picture::{at_size_of, read_png};
use i2slam::dataset::read_trajectory;
use i2slam_eval::image::{psnr, ssim};
use i2slam_eval::trajectory::{
    Alignment, DEFAULT_TOLERANCE, TrajectoryError, absolute_trajectory_error,
};
use serde::Serialize;
use std::path::Path;

/// All figures of an evaluation.
#[derive(Serialize)]
struct Evaluation {
    #[serde(flatten)]
    trajectory: TrajectoryError,
    #[serde(flatten)]
    pictures: Option<Pictures>,
}

/// Sharp renders against the true pictures, means over frames.
#[derive(Serialize)]
struct Pictures {
    psnr_sharp_db: f64,
    ssim_sharp: f64,
    sharp_frames: usize,
}

pub(crate) fn eval(arguments: &Eval) -> Result<(), Failure> {
    let estimate = &arguments.estimate;
    let trajectory =
        if estimate.is_dir() { estimate.join("trajectory.txt") } else { estimate.clone() };
    let pictures = match &arguments.reference {
        Some(reference) if estimate.is_dir() => Some(judge_pictures(estimate, reference)?),
        Some(_) => {
            let message = "--reference needs a result folder, not a trajectory";
            return Err(Failure::Usage(message.to_owned()));
        }
        None => None,
    };
    let fit = match arguments.align {
        Fit::Se3 => Alignment::Se3,
        Fit::Sim3 => Alignment::Sim3,
    };
    let truth = read_trajectory(&arguments.groundtruth)?;
    let estimate = read_trajectory(&trajectory)?;
    let trajectory = absolute_trajectory_error(&estimate, &truth, fit, DEFAULT_TOLERANCE)?;
    let evaluation = Evaluation { trajectory, pictures };
    if !arguments.json {
        print(&evaluation);
        return Ok(());
    }
    let text = serde_json::to_string_pretty(&evaluation);
    say(&text.map_err(|e| Failure::Failed(e.to_string()))?);
    Ok(())
}

fn print(evaluation: &Evaluation) {
    let t = &evaluation.trajectory;
    let scale = if t.alignment == Alignment::Sim3 {
        format!(", scale {:.4}", t.scale)
    } else {
        String::new()
    };
    say(&format!("poses               {}{scale}", t.pairs));
    let rows = [
        ("ATE RMSE", t.ate_rmse_m),
        ("ATE mean", t.ate_mean_m),
        ("ATE median", t.ate_median_m),
        ("ATE largest", t.ate_max_m),
        ("SplaTAM's mean", t.splatam_mean_m),
    ];
    for (name, metres) in rows {
        say(&format!("{name:<16}{:>8.3} cm", metres * 100.0));
    }
    if let Some(p) = &evaluation.pictures {
        say(&format!("sharp PSNR      {:>8.2} dB over {} frames", p.psnr_sharp_db, p.sharp_frames));
        say(&format!("sharp SSIM      {:>8.4}", p.ssim_sharp));
    }
}

/// Pictures of the same name in `renders/sharp` and in the reference.
fn judge_pictures(result: &Path, reference: &Path) -> Result<Pictures, Failure> {
    let drawn = result.join("renders/sharp");
    let unreadable = |e: std::io::Error| Failure::Failed(format!("{}: {e}", drawn.display()));
    let mut sums = [0.0; 2];
    let mut frames = 0;
    let entries = std::fs::read_dir(&drawn).map_err(unreadable)?;
    let mut names: Vec<_> = entries.flatten().map(|entry| entry.file_name()).collect();
    names.sort();
    for name in names.iter().filter(|name| reference.join(name).is_file()) {
        let path = reference.join(name);
        let picture = read_png(&drawn.join(name))?;
        let truth = at_size_of(read_png(&path)?, &picture).ok_or_else(|| {
            Failure::Failed(format!("{} shows another view than the render", path.display()))
        })?;
        let measured = psnr(&picture, &truth)?;
        if measured.is_finite() {
            sums[0] += measured;
            sums[1] += ssim(&picture, &truth)?;
            frames += 1;
        }
    }
    if frames == 0 {
        let message = format!(
            "no picture of {} has a partner in {} (NNNNNN.png)",
            drawn.display(),
            reference.display()
        );
        return Err(Failure::Failed(message));
    }
    let mean = |sum: f64| sum / frames as f64;
    Ok(Pictures { psnr_sharp_db: mean(sums[0]), ssim_sharp: mean(sums[1]), sharp_frames: frames })
}
