//! `i2slam man`: manual pages of this program.

use super::Arguments;
use crate::console::{counted, print, print_text};
use crate::failure::{Failure, failed};
use clap::{Args, Command, CommandFactory};
use clap_mangen::Man as Page;
use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(crate) struct Man {
    /// Write the pages of the program and of its commands into this folder, and print none;
    /// earlier ones are replaced
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Beginning of the line that titles a page; it tells our pages from other files.
const TITLE: &str = ".TH i2slam";
/// Largest file that is read as a page [bytes].
const LIMIT: u64 = 1 << 20;

pub(crate) fn man(arguments: &Man) -> Result<(), Failure> {
    let program = complete_program();
    let Some(folder) = &arguments.out else {
        let text = roff(program).map_err(|error| failed(Path::new("i2slam.1"), error))?;
        print_text(text.trim_end());
        return Ok(());
    };
    let pages = pages(&program);
    for (name, _) in &pages {
        refuse_foreign(&folder.join(name))?;
    }
    for (name, command) in &pages {
        let path = folder.join(name);
        let text = roff(command.clone()).map_err(|error| failed(&path, error))?;
        i2slam_storage::write_file(&path, |file| file.write_all(text.as_bytes()))?;
    }
    print(&format!("{} in {}", counted(pages.len(), "page"), folder.display()));
    Ok(())
}

/// The program with the names that its commands have in full: `i2slam-run`.
fn complete_program() -> Command {
    let mut program = Arguments::command().disable_help_subcommand(true);
    program.build();
    program
}

/// File names and commands of all pages, the program first.
fn pages(program: &Command) -> Vec<(String, Command)> {
    let shown = program.get_subcommands().filter(|command| !command.is_hide_set());
    let all = std::iter::once(program).chain(shown).cloned();
    all.map(|command| (Page::new(command.clone()).get_filename(), command)).collect()
}

/// Text of a page.
fn roff(command: Command) -> io::Result<String> {
    let mut text = Vec::new();
    Page::new(command).render(&mut text)?;
    let text = String::from_utf8_lossy(&text);
    let lines: Vec<_> = text.lines().map(with_version).collect();
    Ok(lines.join("\n") + "\n")
}

/// The title line with name, section, no date and version; of empty parts `clap_mangen` leaves out
/// the quotes, so that the next one takes their place.
fn with_version(line: &str) -> Cow<'_, str> {
    match line.starts_with(TITLE).then(|| line.split(' ').nth(1)).flatten() {
        Some(name) => {
            let version = env!("CARGO_PKG_VERSION");
            format!(".TH {name} 1 \"\" \"i2slam {version}\" i2slam").into()
        }
        None => line.into(),
    }
}

/// Refuses to replace what is no page of this program.
fn refuse_foreign(path: &Path) -> Result<(), Failure> {
    if path.symlink_metadata().is_err() {
        return Ok(());
    }
    let text = i2slam_storage::read_text_up_to(path, LIMIT).unwrap_or_default();
    match text.lines().any(|line| line.starts_with(TITLE)) {
        true => Ok(()),
        false => Err(Failure::Usage(format!(
            "--out: {} is there already, and no manual page of i2slam: choose another folder",
            path.display()
        ))),
    }
}
