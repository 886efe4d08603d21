//! Values that leave memory for a scratch file when they have not been used for longest, and come
//! back byte for byte.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

/// A value that a scratch file can hold.
pub trait Storable: Send + Sync + 'static {
    /// Its sizes, which stay in memory.
    type Shape: Send;

    /// Sizes of this value.
    fn shape(&self) -> Self::Shape;
    /// Memory that it takes [bytes].
    fn memory(&self) -> usize;
    /// Appends its bytes.
    fn write(&self, bytes: &mut Vec<u8>);
    /// The value with these bytes, as many as [`write`](Self::write) appended; all zero after a
    /// failure of the file.
    fn read(shape: &Self::Shape, bytes: &[u8]) -> Self;
}

/// A bound for the memory of [`Stored`] values: those that were not used for longest are moved to a
/// file, which exists as long as this does. What is moved changes no result.
#[derive(Debug)]
pub struct ScratchStore {
    /// Memory of values that stay out of the file [bytes].
    limit: usize,
    /// Folder of the file.
    folder: PathBuf,
    resident: Mutex<Resident>,
    file: Mutex<Option<ScratchFile>>,
    failure: OnceLock<io::ErrorKind>,
}

/// Values in memory.
#[derive(Debug, Default)]
struct Resident {
    bytes: usize,
    /// Values by the time of their last use.
    by_use: BTreeMap<u64, Weak<dyn Evict>>,
    uses: u64,
}

/// A file of values, and places where values were that are gone.
#[derive(Debug)]
struct ScratchFile {
    file: File,
    /// Set where an open file cannot be unlinked: it is removed in the end.
    path: Option<PathBuf>,
    end: u64,
    /// By length [bytes].
    free: BTreeMap<usize, Vec<u64>>,
}

/// A value in memory or in the file of a [`ScratchStore`]. Copies share it.
pub struct Stored<T: Storable>(Arc<Entry<T>>);

struct Entry<T: Storable> {
    scratch: Arc<ScratchStore>,
    slot: Mutex<Slot<T>>,
}

struct Slot<T: Storable> {
    /// `None` if only the file has it.
    value: Option<Arc<T>>,
    shape: T::Shape,
    /// [bytes]
    memory: usize,
    last_use: u64,
    /// First byte and length in the file, once written.
    place: Option<(u64, usize)>,
}

/// A value that can be moved to the file.
trait Evict: Send + Sync {
    fn evict(&self);
}

impl ScratchStore {
    /// Keeps up to `limit` bytes of values in memory, and the others in a file without a name in a
    /// folder, made with the first of them.
    pub fn new(limit: usize, folder: impl Into<PathBuf>) -> Arc<Self> {
        Arc::new(Self {
            limit,
            folder: folder.into(),
            resident: Mutex::default(),
            file: Mutex::default(),
            failure: OnceLock::new(),
        })
    }

    /// Keeps all values in memory.
    pub fn in_memory() -> Arc<Self> {
        Self::new(usize::MAX, PathBuf::new())
    }

    /// Takes a value.
    pub fn insert<T: Storable>(self: &Arc<Self>, value: T) -> Stored<T> {
        let (shape, memory) = (value.shape(), value.memory());
        let slot = Slot { value: Some(Arc::new(value)), shape, memory, last_use: 0, place: None };
        let entry = Arc::new(Entry { scratch: Arc::clone(self), slot: Mutex::new(slot) });
        entry.use_now(&mut locked(&entry.slot), memory);
        self.evict();
        Stored(entry)
    }

    /// The first failure to read a value back: what was computed since then is wrong. A value that
    /// cannot be written stays in memory.
    pub fn failure(&self) -> Option<io::ErrorKind> {
        self.failure.get().copied()
    }

    /// Memory of the values in memory [bytes].
    pub fn resident_bytes(&self) -> usize {
        locked(&self.resident).bytes
    }

    /// Length of the file [bytes].
    pub fn file_bytes(&self) -> u64 {
        locked(&self.file).as_ref().map_or(0, |file| file.end)
    }

    /// Moves values to the file until the others are within the limit.
    fn evict(&self) {
        loop {
            // Released before the value is locked, which locks in the other order.
            let next = {
                let mut resident = locked(&self.resident);
                if resident.bytes <= self.limit {
                    return;
                }
                resident.by_use.pop_first()
            };
            let Some((_, value)) = next else { return };
            value.upgrade().iter().for_each(|value| value.evict());
        }
    }

    fn write(&self, bytes: &[u8]) -> io::Result<u64> {
        let mut file = locked(&self.file);
        let file = match &mut *file {
            Some(file) => file,
            None => file.insert(ScratchFile::create(&self.folder)?),
        };
        file.write(bytes)
    }

    /// Reads bytes; zeros where that fails.
    fn read(&self, (begin, length): (u64, usize)) -> Vec<u8> {
        let mut bytes = vec![0; length];
        let read = locked(&self.file)
            .as_mut()
            .map_or_else(|| Err(io::ErrorKind::NotFound.into()), |f| f.read(begin, &mut bytes));
        if let Err(error) = read {
            self.failure.get_or_init(|| error.kind());
            bytes.fill(0);
        }
        bytes
    }
}

impl<T: Storable> Entry<T> {
    /// Counts a use, of a value that has come into memory with `added` bytes.
    fn use_now(self: &Arc<Self>, slot: &mut Slot<T>, added: usize) {
        let mut resident = locked(&self.scratch.resident);
        resident.by_use.remove(&slot.last_use);
        resident.uses += 1;
        slot.last_use = resident.uses;
        let this: Weak<Self> = Arc::downgrade(self);
        resident.by_use.insert(slot.last_use, this);
        resident.bytes += added;
    }
}

impl<T: Storable> Evict for Entry<T> {
    fn evict(&self) {
        let mut slot = locked(&self.slot);
        let Some(value) = &slot.value else { return };
        if slot.place.is_none() {
            let mut bytes = Vec::new();
            value.write(&mut bytes);
            // Without room on the disk it stays, and is tried again after its next use.
            let Ok(begin) = self.scratch.write(&bytes) else { return };
            slot.place = Some((begin, bytes.len()));
        }
        slot.value = None;
        let mut resident = locked(&self.scratch.resident);
        resident.bytes -= slot.memory;
        resident.by_use.remove(&slot.last_use);
    }
}

impl<T: Storable> Drop for Entry<T> {
    fn drop(&mut self) {
        let slot = self.slot.get_mut().unwrap_or_else(PoisonError::into_inner);
        if slot.value.is_some() {
            let mut resident = locked(&self.scratch.resident);
            resident.bytes -= slot.memory;
            resident.by_use.remove(&slot.last_use);
        }
        if let Some((begin, length)) = slot.place
            && let Some(file) = &mut *locked(&self.scratch.file)
        {
            file.free.entry(length).or_default().push(begin);
        }
    }
}

impl<T: Storable> Stored<T> {
    /// The value, read from the file where it is not in memory.
    pub fn get(&self) -> Arc<T> {
        let (entry, mut slot) = (&self.0, locked(&self.0.slot));
        if let Some(value) = &slot.value {
            let value = Arc::clone(value);
            entry.use_now(&mut slot, 0);
            return value;
        }
        // A value without memory has been written.
        let bytes = slot.place.map(|place| entry.scratch.read(place)).unwrap_or_default();
        let value = Arc::new(T::read(&slot.shape, &bytes));
        slot.value = Some(Arc::clone(&value));
        let memory = slot.memory;
        entry.use_now(&mut slot, memory);
        drop(slot);
        entry.scratch.evict();
        value
    }

    /// Another value in the same scratch.
    pub fn insert_beside(&self, value: T) -> Self {
        self.0.scratch.insert(value)
    }
}

impl<T: Storable> std::fmt::Debug for Stored<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stored").finish_non_exhaustive()
    }
}

impl<T: Storable> Clone for Stored<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl ScratchFile {
    /// Makes an empty file in a folder; on Unix it has no name, so that nothing is left of it however
    /// the program ends.
    fn create(folder: &Path) -> io::Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        loop {
            let number = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".i2slam-scratch-{}-{number}", std::process::id()));
            match File::options().read(true).write(true).create_new(true).open(&path) {
                Ok(file) => {
                    let is_removed = cfg!(unix) && fs::remove_file(&path).is_ok();
                    let path = (!is_removed).then_some(path);
                    return Ok(Self { file, path, end: 0, free: BTreeMap::new() });
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Writes bytes where there is room; returns where they begin.
    fn write(&mut self, bytes: &[u8]) -> io::Result<u64> {
        let free = self.free.get_mut(&bytes.len()).and_then(Vec::pop);
        let begin = free.unwrap_or(self.end);
        self.file.seek(SeekFrom::Start(begin))?;
        self.file.write_all(bytes)?;
        self.end = self.end.max(begin + bytes.len() as u64);
        Ok(begin)
    }

    fn read(&mut self, begin: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(begin))?;
        self.file.read_exact(bytes)
    }
}

impl Drop for ScratchFile {
    fn drop(&mut self) {
        // A file that stays is told apart by its name.
        self.path.iter().for_each(|path| drop(fs::remove_file(path)));
    }
}

/// Appends the bytes of numbers, for [`Storable::write`].
pub fn append_floats(bytes: &mut Vec<u8>, values: &[f32]) {
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

/// The numbers of bytes from [`append_floats`], for [`Storable::read`].
pub fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|value| f32::from_le_bytes(*value)).collect()
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    /// A hundred bytes of one value.
    #[derive(Debug, PartialEq)]
    struct Block(Vec<u8>);

    impl Block {
        fn new(value: u8) -> Self {
            Self(vec![value; 100])
        }
    }

    impl Storable for Block {
        type Shape = ();

        fn shape(&self) {}

        fn memory(&self) -> usize {
            100
        }

        fn write(&self, bytes: &mut Vec<u8>) {
            bytes.extend(&self.0);
        }

        fn read((): &(), bytes: &[u8]) -> Self {
            Self(bytes.to_vec())
        }
    }

    #[test]
    fn values_beyond_the_limit_come_back_byte_for_byte() {
        let folder = TemporaryFolder::new("scratch");
        let scratch = ScratchStore::new(350, folder.join(""));
        let values: Vec<Stored<Block>> = (0..10).map(|v| scratch.insert(Block::new(v))).collect();
        assert_eq!((scratch.resident_bytes(), scratch.file_bytes()), (300, 700));
        for (number, value) in values.iter().enumerate() {
            assert_eq!(*value.get(), Block::new(number as u8));
        }
        assert_eq!(scratch.resident_bytes(), 300);
        assert_eq!(scratch.failure(), None);
        drop((values, scratch));
        assert_eq!(fs::read_dir(folder.join("")).expect("the folder").count(), 0);
    }

    #[test]
    fn values_in_use_stay_and_places_of_dropped_ones_are_used_again() {
        let folder = TemporaryFolder::new("scratch-use");
        let scratch = ScratchStore::new(200, folder.join(""));
        let used = scratch.insert(Block::new(1));
        for value in 2..10 {
            drop(scratch.insert(Block::new(value)));
            used.get();
        }
        assert_eq!(scratch.file_bytes(), 0);
        let mut others = Vec::new();
        for _ in 0..5 {
            others = (2..10).map(|v| scratch.insert(Block::new(v))).collect();
        }
        assert!(scratch.file_bytes() <= 1600, "{}", scratch.file_bytes());
        assert_eq!(*others[3].get(), Block::new(5));
        assert_eq!(*used.get(), Block::new(1));
    }

    #[test]
    fn a_value_that_cannot_be_read_back_is_told_and_one_that_cannot_be_written_stays() {
        let folder = TemporaryFolder::new("scratch-cut");
        let scratch = ScratchStore::new(100, folder.join(""));
        let values = [1, 2].map(|v| scratch.insert(Block::new(v)));
        locked(&scratch.file).as_ref().expect("a file").file.set_len(20).expect("cut");
        assert_eq!(*values[0].get(), Block::new(0));
        assert_eq!(scratch.failure(), Some(io::ErrorKind::UnexpectedEof));

        let nowhere = ScratchStore::new(100, folder.join("nowhere"));
        let values = [1, 2].map(|v| nowhere.insert(Block::new(v)));
        assert_eq!(*values[0].get(), Block::new(1));
        assert_eq!((nowhere.resident_bytes(), nowhere.failure()), (200, None));
    }

    #[test]
    fn threads_see_the_same_values() {
        let folder = TemporaryFolder::new("scratch-threads");
        let scratch = ScratchStore::new(250, folder.join(""));
        let values: Vec<Stored<Block>> = (0..20).map(|v| scratch.insert(Block::new(v))).collect();
        std::thread::scope(|scope| {
            for step in [1, 3, 7, 9] {
                let values = &values;
                scope.spawn(move || {
                    for i in 0..400 {
                        let number = i * step % 20;
                        assert_eq!(*values[number].get(), Block::new(number as u8));
                    }
                });
            }
        });
        assert!(scratch.resident_bytes() <= 250, "{}", scratch.resident_bytes());
    }
}
