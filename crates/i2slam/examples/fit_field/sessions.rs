//! Both maps on the same pictures, by a whole session.

use crate::frames::{Frames, HOLD_OUT};
use i2slam::config::MapKind;
use i2slam::{Config, Session};
use std::error::Error;

pub(crate) fn print(frames: &Frames, seed: u64) -> Result<(), Box<dyn Error>> {
    for (name, kind) in [("Gaussians", MapKind::Gaussian), ("hash grid", MapKind::HashGrid)] {
        let mut config = Config { seed, ..Config::default() };
        config.map.kind = kind;
        config.mapping.hold_out = HOLD_OUT;
        let mut session = Session::new(config, frames.camera, frames.frame_rate);
        for frame in &frames.frames {
            session.process(frame)?;
        }
        session.finish(&mut |_, _| true);
        let reconstruction = session.reconstruction();
        let mut viewer = reconstruction.viewer();
        let psnr = frames.held_out(|frame| viewer.sharp(&reconstruction.frames[frame]));
        println!("{name}, by a session: held out {psnr:.2} dB");
    }
    Ok(())
}
