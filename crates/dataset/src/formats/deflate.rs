//! Deflated parts of files (RFC 1951), inflated while they are read: memory is that of what is asked
//! for, however much the part inflates to.

use miniz_oxide::inflate::stream::{InflateState, inflate};
use miniz_oxide::{DataFormat, MZFlush, MZStatus};
use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Take};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// Inflated bytes of a part of a file, in any order; reading on from the last place is quick, and
/// going back inflates the part again from its start.
#[derive(Debug)]
pub(crate) struct DeflatedBytes {
    file: PathBuf,
    part: Range<u64>,
    /// The decoder at the end of what was read last.
    decoder: Mutex<Option<Inflater>>,
}

impl DeflatedBytes {
    pub(super) fn new(file: PathBuf, part: Range<u64>) -> Self {
        Self { file, part, decoder: Mutex::new(None) }
    }

    /// A decoder of the part from its start.
    pub(super) fn decoder(&self) -> io::Result<Inflater> {
        let mut file = i2slam_storage::open(&self.file)?;
        file.seek(SeekFrom::Start(self.part.start))?;
        let input = BufReader::new(file.take(self.part.end.saturating_sub(self.part.start)));
        Ok(Inflater { input, state: InflateState::new_boxed(DataFormat::Raw), position: 0 })
    }

    /// Reads `count` inflated bytes from `from` on; the caller knows that so many are there.
    pub(super) fn read(&self, from: u64, count: usize) -> io::Result<Vec<u8>> {
        let mut kept = self.decoder.lock().unwrap_or_else(PoisonError::into_inner);
        let mut decoder = match kept.take().filter(|decoder| decoder.position <= from) {
            Some(decoder) => decoder,
            None => self.decoder()?,
        };
        let skipped = from - decoder.position;
        io::copy(&mut decoder.by_ref().take(skipped), &mut io::sink())?;
        let mut bytes = vec![0; count];
        decoder.read_exact(&mut bytes)?;
        *kept = Some(decoder);
        Ok(bytes)
    }
}

/// Decoder of a deflated stream.
pub(super) struct Inflater {
    input: BufReader<Take<File>>,
    state: Box<InflateState>,
    /// Inflated bytes that were read.
    position: u64,
}

impl Read for Inflater {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let input = self.input.fill_buf()?;
            let is_empty = input.is_empty();
            let step = inflate(&mut self.state, input, out, MZFlush::None);
            self.input.consume(step.bytes_consumed);
            if step.bytes_written > 0 || out.is_empty() {
                self.position += step.bytes_written as u64;
                return Ok(step.bytes_written);
            }
            match step.status {
                Ok(MZStatus::StreamEnd) => return Ok(0),
                Ok(_) if !is_empty => {}
                _ => return Err(io::Error::new(io::ErrorKind::InvalidData, "damaged")),
            }
        }
    }
}

impl fmt::Debug for Inflater {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Inflater").field("position", &self.position).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn parts_are_read_in_any_order_and_no_further_than_they_go() {
        let scratch = TemporaryFolder::new("deflate");
        let bytes: Vec<u8> = (0..200_000_u64).map(|i| ((i * i) >> 7) as u8).collect();
        let packed = miniz_oxide::deflate::compress_to_vec(&bytes, 6);
        let (file, end) = (scratch.join("packed"), 3 + packed.len() as u64);
        std::fs::write(&file, [&[1, 2, 3], packed.as_slice(), &[4; 99]].concat()).expect("room");
        let part = DeflatedBytes::new(file.clone(), 3..end);
        for from in [0, 7, 100_000, 199_000, 5, 150_000] {
            assert_eq!(part.read(from as u64, 1000).expect("bytes"), bytes[from..from + 1000]);
        }
        assert!(part.read(199_500, 1000).is_err(), "beyond the end");
        let mut all = Vec::new();
        part.decoder().expect("a decoder").read_to_end(&mut all).expect("bytes");
        assert_eq!(all, bytes);
        let cut_off = DeflatedBytes::new(file, 3..end - 10);
        assert!(cut_off.decoder().expect("a decoder").read_to_end(&mut all).is_err());
    }
}
