//! The case of the design: 320 x 240 and 50 000 Gaussians of four pixels radius.

use super::counts::{self, Count};
use super::{fastest, machine, on_threads, scene};
use i2slam_compute::{Adam, AdamSettings};
use i2slam_radiance::gaussian::{
    GaussianMap, MapGradient, Rasterizer, Render, RenderCotangent, StageSeconds, View, Work,
};
use std::hint::black_box;

const COUNT: usize = 50_000;
const SIZE: (usize, usize) = (320, 240);

/// A map with everything that one step needs.
pub(crate) struct Step {
    pub(crate) map: GaussianMap,
    pub(crate) view: View<f32>,
    cotangent: RenderCotangent,
    pub(crate) rasterizer: Rasterizer,
    out: Render,
    gradient: MapGradient,
    adam: [Adam; 4],
    ages: Vec<u32>,
}

impl Step {
    pub(crate) fn new(count: usize, (width, height): (usize, usize)) -> Self {
        let view = scene::view(width, height);
        Self {
            map: scene::map(count, &view),
            view,
            cotangent: scene::cotangent(&view),
            rasterizer: Rasterizer::default(),
            out: Render::default(),
            gradient: MapGradient::new(count),
            adam: std::array::from_fn(|_| Adam::new(AdamSettings::default())),
            ages: vec![0; count],
        }
    }

    pub(crate) fn forward(&mut self) {
        self.rasterizer.render(&self.map, &self.view, &mut self.out);
    }

    /// To all parameters of the map and to the pose.
    pub(crate) fn backward(&mut self) {
        let gradient = Some(&mut self.gradient);
        let Self { rasterizer, map, view, cotangent, .. } = self;
        black_box(rasterizer.pull_back(map, view, cotangent, gradient));
    }

    /// Means, colours, opacities and scales take a step, so short that the scene stays.
    pub(crate) fn adam(&mut self) {
        self.ages.iter_mut().for_each(|age| *age += 1);
        let (map, gradient, rate) = (&mut self.map, &self.gradient, 1e-12);
        let groups = [
            (map.means.as_flattened_mut(), gradient.means.as_flattened(), 3),
            (map.colours.as_flattened_mut(), gradient.colours.as_flattened(), 3),
            (map.opacity_logits.as_mut_slice(), gradient.opacity_logits.as_slice(), 1),
            (map.log_scales.as_flattened_mut(), gradient.log_scales.as_flattened(), 3),
        ];
        for (adam, (values, gradient, width)) in self.adam.iter_mut().zip(groups) {
            adam.step_elements(values, gradient, rate, width, &self.ages);
        }
    }

    /// The fastest times of all stages over some rounds.
    pub(crate) fn stage_seconds(&mut self, rounds: usize, least: f64) -> StageSeconds {
        let none = f64::MAX;
        let mut best = StageSeconds {
            project: none,
            sort: none,
            bin: none,
            blend: none,
            copy_out: none,
            blend_back: none,
            project_back: none,
        };
        fastest(rounds, least, || {
            self.forward();
            self.backward();
            let now = self.rasterizer.stage_seconds();
            best.project = best.project.min(now.project);
            best.sort = best.sort.min(now.sort);
            best.bin = best.bin.min(now.bin);
            best.blend = best.blend.min(now.blend);
            best.copy_out = best.copy_out.min(now.copy_out);
            best.blend_back = best.blend_back.min(now.blend_back);
            best.project_back = best.project_back.min(now.project_back);
        });
        best
    }
}

/// Name, time, and what counts the work of a stage.
type Stage = (&'static str, f64, fn(&Work) -> Count);

fn named(seconds: &StageSeconds) -> [Stage; 6] {
    [
        ("projection", seconds.project, counts::project),
        ("sorting", seconds.sort, counts::sort),
        ("binning", seconds.bin, counts::bin),
        ("forward", seconds.blend + seconds.copy_out, counts::blend),
        ("backward", seconds.blend_back, counts::blend_back),
        ("projection backward", seconds.project_back, counts::project_back),
    ]
}

/// Time, operations, bytes and share of the machine's limits, per stage, on all threads.
pub(crate) fn print() {
    let threads = rayon::current_num_threads();
    let (peak, bandwidth) = (machine::flops(threads), machine::bandwidth(threads).0);
    let mut step = Step::new(COUNT, SIZE);
    let seconds = step.stage_seconds(100, 3.0);
    let work = step.rasterizer.work();
    println!("# work\ngaussians,visible,pairs,visited,rows,tiles");
    println!(
        "{},{},{},{},{},{}",
        work.gaussians, work.visible, work.pairs, work.visited, work.rows, work.tiles
    );
    println!(
        "# stages\nstage,ms,mflop,mb,flop_per_byte,share_of_peak,share_of_bandwidth,share_of_roof"
    );
    for (name, seconds, count) in named(&seconds) {
        let Count { operations, bytes } = count(&work);
        let roof = (operations / peak).max(bytes / bandwidth);
        println!(
            "{name},{:.3},{:.1},{:.2},{:.1},{:.3},{:.3},{:.3}",
            seconds * 1e3,
            operations / 1e6,
            bytes / 1e6,
            operations / bytes,
            operations / peak / seconds,
            bytes / bandwidth / seconds,
            roof / seconds
        );
        println!("time,stages/{name},{seconds:.6e}");
    }
}

/// Forward, backward and Adam on one thread, and on all.
pub(crate) fn print_step() {
    println!("threads,forward_ms,backward_ms,adam_ms,step_ms");
    for threads in [1, rayon::current_num_threads()] {
        let times = on_threads(threads, || {
            let mut step = Step::new(COUNT, SIZE);
            let mut best = [f64::MAX; 4];
            fastest(60, 3.0, || {
                let parts: [fn(&mut Step); 3] = [Step::forward, Step::backward, Step::adam];
                let mut whole = 0.0;
                for (best, part) in best.iter_mut().zip(parts) {
                    let seconds = fastest(1, 0.0, || part(&mut step));
                    (*best, whole) = (best.min(seconds), whole + seconds);
                }
                best[3] = best[3].min(whole);
            });
            best
        });
        let Some([forward, backward, adam, step]) = times.map(|t| t.map(|t| t * 1e3)) else {
            continue;
        };
        println!("{threads},{forward:.3},{backward:.3},{adam:.3},{step:.3}");
        println!("time,step/{threads} threads,{:.6e}", step * 1e-3);
    }
}

/// Every stage on one thread and on all.
pub(crate) fn print_threads() {
    println!("stage,one_thread_ms,all_threads_ms,speedup");
    let run = |threads| on_threads(threads, || Step::new(COUNT, SIZE).stage_seconds(60, 2.0));
    let (Some(one), Some(all)) = (run(1), run(rayon::current_num_threads())) else { return };
    for ((name, one, _), (_, all, _)) in named(&one).into_iter().zip(named(&all)) {
        println!("{name},{:.3},{:.3},{:.2}", one * 1e3, all * 1e3, one / all);
    }
}
