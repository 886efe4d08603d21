//! Pictures that leave memory for a file, and come back byte for byte.

use i2slam_geometry::Image;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A file for pictures of frames that are rarely read: what is moved there changes no result.
#[derive(Debug)]
pub struct ScratchFile {
    /// The file, and where its next picture begins.
    file: Mutex<(File, u64)>,
    failure: OnceLock<io::ErrorKind>,
}

impl ScratchFile {
    /// Takes an empty file, opened for reading and writing, which the caller removes.
    pub fn new(file: File) -> Self {
        Self { file: Mutex::new((file, 0)), failure: OnceLock::new() }
    }

    /// The first failure to read a picture back: what was computed since then is wrong.
    pub fn failure(&self) -> Option<io::ErrorKind> {
        self.failure.get().copied()
    }

    /// Adds bytes; returns where they begin.
    fn append(&self, bytes: &[u8]) -> io::Result<u64> {
        let mut guard = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let (file, end) = &mut *guard;
        let begin = *end;
        file.seek(SeekFrom::Start(begin))?;
        file.write_all(bytes)?;
        *end += bytes.len() as u64;
        Ok(begin)
    }

    /// Reads bytes from a place on; zeros where that fails, which [`failure`](Self::failure) tells.
    fn read(&self, begin: u64, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        let mut guard = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let file = &mut guard.0;
        let done = file.seek(SeekFrom::Start(begin)).and_then(|_| file.read_exact(&mut bytes));
        if let Err(error) = done {
            self.failure.get_or_init(|| error.kind());
            bytes.fill(0);
        }
        bytes
    }
}

/// Values of pictures that a scratch file holds.
pub(crate) trait StoredValue: Copy {
    fn to_bytes(values: &[Self]) -> Vec<u8>;
    fn from_bytes(bytes: &[u8]) -> Vec<Self>;
}

impl StoredValue for u8 {
    fn to_bytes(values: &[Self]) -> Vec<u8> {
        values.to_vec()
    }

    fn from_bytes(bytes: &[u8]) -> Vec<Self> {
        bytes.to_vec()
    }
}

impl StoredValue for f32 {
    fn to_bytes(values: &[Self]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn from_bytes(bytes: &[u8]) -> Vec<Self> {
        bytes.as_chunks::<4>().0.iter().map(|v| Self::from_le_bytes(*v)).collect()
    }
}

/// A picture in memory or in a scratch file.
#[derive(Clone, Debug)]
pub(crate) enum StoredImage<T> {
    Memory(Arc<Image<T>>),
    /// The place of the values, and width, height and channels.
    Scratch {
        file: Arc<ScratchFile>,
        begin: u64,
        size: [usize; 3],
    },
}

impl<T: StoredValue> StoredImage<T> {
    pub(crate) fn new(image: Image<T>) -> Self {
        Self::Memory(Arc::new(image))
    }

    /// The picture, read where it is not in memory.
    pub(crate) fn image(&self) -> Arc<Image<T>> {
        match self {
            Self::Memory(image) => Arc::clone(image),
            Self::Scratch { file, begin, size: [width, height, channels] } => {
                let values = width * height * channels;
                let data = T::from_bytes(&file.read(*begin, values * size_of::<T>()));
                Arc::new(Image { width: *width, height: *height, channels: *channels, data })
            }
        }
    }

    /// Moves the picture to a file; it stays in memory where that takes no more.
    pub(crate) fn move_to(&mut self, file: &Arc<ScratchFile>) {
        let Self::Memory(image) = self else { return };
        if let Ok(begin) = file.append(&T::to_bytes(&image.data)) {
            let size = [image.width, image.height, image.channels];
            *self = Self::Scratch { file: Arc::clone(file), begin, size };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    fn scratch(folder: &TemporaryFolder, name: &str) -> Arc<ScratchFile> {
        let mut options = File::options();
        let options = options.read(true).write(true).create_new(true);
        Arc::new(ScratchFile::new(options.open(folder.join(name)).expect("a file")))
    }

    #[test]
    fn pictures_come_back_byte_for_byte() {
        let folder = TemporaryFolder::new("scratch");
        let file = scratch(&folder, "pictures");
        let depth = Image::from_fn(7, 5, 1, |_, c, r| 0.1 + c as f32 / (1.0 + r as f32));
        let colour = Image::from_fn(7, 5, 3, |k, c, r| (70 * k + 7 * c + r) as u8);
        let (mut first, mut second) =
            (StoredImage::new(depth.clone()), StoredImage::new(colour.clone()));
        first.move_to(&file);
        second.move_to(&file);
        assert!(matches!(first, StoredImage::Scratch { .. }));
        assert_eq!(*second.image(), colour);
        assert_eq!(*first.image(), depth);
        assert_eq!(file.failure(), None);
    }

    #[test]
    fn a_picture_that_cannot_be_read_back_is_told() {
        let folder = TemporaryFolder::new("scratch-cut");
        let file = scratch(&folder, "pictures");
        let mut image = StoredImage::new(Image::from_fn(7, 5, 1, |_, c, _| c as f32));
        image.move_to(&file);
        let cut = File::options().write(true).open(folder.join("pictures"));
        cut.expect("the file").set_len(20).expect("cut");
        assert!(image.image().data.iter().all(|value| *value == 0.0));
        assert_eq!(file.failure(), Some(io::ErrorKind::UnexpectedEof));
    }
}
