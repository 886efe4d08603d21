//! The program from outside: tiny made-up sequences in, result folders out.

mod bad_input;
mod causes;
mod commands;
mod eval;
mod field;
#[cfg(unix)]
mod footage;
mod info;
mod interrupt;
mod keyframed;
#[cfg(unix)]
mod lens;
mod overwrite;
mod protocols;
mod result;
mod robust;
mod rolling;
mod scene;
#[cfg(unix)]
mod streams;
mod tools;
#[cfg(unix)]
mod video;
