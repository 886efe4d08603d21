//! Reading of regular files only, up to a limit: a named pipe would wait for a writer, a device may
//! never end.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// Largest text file [bytes]: a list of 100 000 frames takes 10 MB.
pub const MAX_TEXT: u64 = 256 << 20;

/// Bytes of a text file that are looked at before it is read whole.
const TEXT_HEAD: u64 = 1 << 12;

/// Opens a regular file, following links.
///
/// # Errors
/// Those of the system; `InvalidInput` if the path is anything but a regular file.
pub fn open(path: &Path) -> io::Result<File> {
    let file = open_without_waiting(path).map_err(|error| of_dangling_link(path, error))?;
    let kind = file.metadata()?.file_type();
    match kind.is_file() {
        true => Ok(file),
        false if kind.is_dir() => Err(refusal("it is a folder, expected a file")),
        false => Err(refusal("it is no regular file, but a pipe, a socket or a device")),
    }
}

/// A link to nothing is listed in its folder, so that "no such file" would be a riddle.
fn of_dangling_link(path: &Path, error: io::Error) -> io::Error {
    match path.read_link() {
        Ok(target) if error.kind() == io::ErrorKind::NotFound => {
            let message = format!("it is a link to {}, which is not there", target.display());
            io::Error::new(io::ErrorKind::NotFound, message)
        }
        _ => error,
    }
}

/// Opening a named pipe waits for its writer, unless it is opened as non-blocking; regular files
/// are read as always.
#[cfg(unix)]
fn open_without_waiting(path: &Path) -> io::Result<File> {
    use rustix::fs::{Mode, OFlags, open};
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
    Ok(File::from(open(path, flags, Mode::empty())?))
}

#[cfg(not(unix))]
fn open_without_waiting(path: &Path) -> io::Result<File> {
    File::open(path)
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open`]; `FileTooLarge` beyond the limit.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata()?.len();
    let too_large = || {
        let message = format!("it is too large: at most {} MB are read", limit / 1_000_000);
        io::Error::new(io::ErrorKind::FileTooLarge, message)
    };
    if size > limit {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX)).map_err(|_| {
        let message = format!("there is no memory for its {} MB", size / 1_000_000);
        io::Error::new(io::ErrorKind::OutOfMemory, message)
    })?;
    // A file may grow while it is read.
    file.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_large()) } else { Ok(bytes) }
}

/// Reads a part of a regular file.
///
/// # Errors
/// As [`open`]; `UnexpectedEof`, before anything is allocated, if the file ends before the part does.
pub fn read_range(path: &Path, range: Range<u64>) -> io::Result<Vec<u8>> {
    let mut file = open(path)?;
    let cut_off = || io::Error::new(io::ErrorKind::UnexpectedEof, "it is cut off");
    let length = range.end.checked_sub(range.start).ok_or_else(cut_off)?;
    if range.end > file.metadata()?.len() {
        return Err(cut_off());
    }
    let mut bytes = vec![0; usize::try_from(length).map_err(|_| cut_off())?];
    file.seek(SeekFrom::Start(range.start))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Reads a regular text file of at most [`MAX_TEXT`] bytes.
///
/// # Errors
/// As [`read_text_up_to`].
pub fn read_text(path: &Path) -> io::Result<String> {
    read_text_up_to(path, MAX_TEXT)
}

/// Reads a regular text file of at most `limit` bytes.
///
/// # Errors
/// As [`read`]; `InvalidData` if it is not UTF-8, or begins with zero bytes as a file does that was
/// set to a size and never written.
pub fn read_text_up_to(path: &Path, limit: u64) -> io::Result<String> {
    let no_text = || io::Error::new(io::ErrorKind::InvalidData, "it is no text (not UTF-8)");
    let mut head = Vec::new();
    open(path)?.take(TEXT_HEAD).read_to_end(&mut head)?;
    if head.contains(&0) {
        return Err(no_text());
    }
    String::from_utf8(read(path, limit)?).map_err(|_| no_text())
}

fn refusal(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;
    use std::fs;

    #[test]
    fn regular_files_are_read_up_to_the_limit() {
        let scratch = TemporaryFolder::new("read");
        let path = scratch.join("a.txt");
        fs::write(&path, "12345").expect("room");
        assert_eq!(read(&path, 5).expect("five bytes"), b"12345");
        assert_eq!(read_text(&path).expect("text"), "12345");
        let kind = |result: io::Result<Vec<u8>>| result.expect_err("a refusal").kind();
        assert_eq!(kind(read(&path, 4)), io::ErrorKind::FileTooLarge);
        assert_eq!(kind(read(&scratch.0, 4)), io::ErrorKind::InvalidInput);
        assert_eq!(kind(read(&scratch.join("none"), 4)), io::ErrorKind::NotFound);
        // A file without content takes no room, and would take memory.
        File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("a sparse file");
        let sparse = read_text_up_to(&path, u64::MAX).expect_err("no text");
        assert_eq!(sparse.kind(), io::ErrorKind::InvalidData);
        fs::write(&path, [0xff, 0xfe]).expect("room");
        assert_eq!(read_text(&path).expect_err("no text").kind(), io::ErrorKind::InvalidData);
    }

    #[test]
    fn parts_lie_within_their_file() {
        let scratch = TemporaryFolder::new("range");
        let path = scratch.join("a.txt");
        fs::write(&path, "12345").expect("room");
        assert_eq!(read_range(&path, 1..4).expect("three bytes"), b"234");
        assert_eq!(read_range(&path, 5..5).expect("nothing"), b"");
        for beyond in [Range { start: 4, end: 6 }, Range { start: 3, end: 2 }, 0..u64::MAX] {
            let error = read_range(&path, beyond.clone()).expect_err("no such part");
            assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof, "{beyond:?}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_link_to_nothing_is_named() {
        let scratch = TemporaryFolder::new("dangling");
        let link = scratch.join("camera.json");
        std::os::unix::fs::symlink("../elsewhere.json", &link).expect("a link");
        let error = read(&link, 4).expect_err("nothing there");
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(error.to_string().contains("is a link to ../elsewhere.json"), "{error}");
    }

    #[test]
    #[cfg(unix)]
    fn pipes_and_devices_are_refused_at_once() {
        let scratch = TemporaryFolder::new("pipe");
        let pipe = scratch.join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.is_ok_and(|status| status.success()), "mkfifo");
        std::os::unix::fs::symlink("/dev/zero", scratch.join("endless")).expect("a link");
        for path in [pipe, scratch.join("endless")] {
            let error = read(&path, 1 << 20).expect_err("no regular file");
            assert!(error.to_string().contains("no regular file"), "{error}");
        }
    }
}
