//! One file per subcommand.

mod bench;
mod degrade;
mod demo;
mod eval;
mod info;
mod presets;
mod render;
mod run;
mod synth;

pub(crate) use bench::Bench as BenchArguments;
pub(crate) use degrade::Degrade as DegradeArguments;
pub(crate) use info::Info as InfoArguments;
pub(crate) use synth::Synth as SynthArguments;

use crate::arguments::{Command, Machine};
use crate::failure::Failure;
use crate::output::counted;

/// Do what was typed.
pub(crate) fn dispatch(command: Command) -> Result<(), Failure> {
    match command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Render(arguments) => render::render(&arguments),
        Command::Eval(arguments) => eval::eval(&arguments),
        Command::Demo(arguments) => demo::demo(&arguments),
        Command::Presets(arguments) => presets::presets(&arguments),
        Command::Synth(arguments) => synth::synth(&arguments),
        Command::Degrade(arguments) => degrade::degrade(&arguments),
        Command::Bench(arguments) => bench::bench(&arguments),
        Command::Info(arguments) => info::info(&arguments),
    }
}

/// Set the number of threads for everything that follows.
fn use_threads(machine: &Machine) -> Result<(), Failure> {
    let Some(threads) = machine.threads else { return Ok(()) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads));
    let failed = |e| {
        let count = counted(usize::from(threads), "thread");
        Failure::Failed(format!("cannot start {count}: {e}"))
    };
    pool.build_global().map_err(failed)
}
