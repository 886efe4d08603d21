//! Binary models: `cameras.bin`, `images.bin`, `points3D.bin`, little-endian.

use super::camera::{ModelCamera, model_by_id};
use super::{ModelImage, ModelPoint, parse_pose};
use crate::DatasetError;
use i2slam_geometry::Vec3;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

/// Longest accepted name of an image [bytes].
const MAX_NAME_BYTES: u64 = 1 << 16;

/// Sequential reader of a file; a count is believed only as far as there are bytes for it.
struct ByteReader<'a> {
    file: &'a Path,
    data: BufReader<File>,
    /// Bytes that are not yet read.
    remaining: u64,
    /// Kind, number and count of the current record, for messages.
    record: Option<(&'static str, u64, u64)>,
}

impl<'a> ByteReader<'a> {
    fn open(file: &'a Path) -> Result<Self, DatasetError> {
        let failed = |e| DatasetError::read(file, e);
        let data = i2slam_storage::open(file).map_err(failed)?;
        let remaining = data.metadata().map_err(failed)?.len();
        Ok(Self { file, data: BufReader::new(data), remaining, record: None })
    }

    fn refuse(&self, reason: &str) -> DatasetError {
        let record = self.record.map_or("its count".to_owned(), |(what, number, count)| {
            format!("{what} {number} of {count}")
        });
        DatasetError::file(self.file, format!("{record}: {reason}"))
    }

    fn cut_off(&self) -> DatasetError {
        self.refuse("cut off; copy or write the model again")
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], DatasetError> {
        let mut bytes = [0; N];
        self.data.read_exact(&mut bytes).map_err(|e| match e.kind() {
            ErrorKind::UnexpectedEof => self.cut_off(),
            _ => DatasetError::read(self.file, e),
        })?;
        self.remaining = self.remaining.saturating_sub(N as u64);
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, DatasetError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, DatasetError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, DatasetError> {
        self.take().map(f64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], DatasetError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// Skips `count` records of `size` bytes; an error if the file ends before.
    fn skip(&mut self, count: u64, size: u64) -> Result<(), DatasetError> {
        let length = count.checked_mul(size).filter(|&length| length <= self.remaining);
        let length = length.ok_or_else(|| self.cut_off())?;
        let step = i64::try_from(length).map_err(|_| self.cut_off())?;
        self.data.seek_relative(step).map_err(|e| DatasetError::read(self.file, e))?;
        self.remaining -= length;
        Ok(())
    }

    /// Reads a zero-terminated name.
    fn name(&mut self) -> Result<String, DatasetError> {
        let mut name = Vec::new();
        let read = self.data.by_ref().take(MAX_NAME_BYTES).read_until(0, &mut name);
        let length = read.map_err(|e| DatasetError::read(self.file, e))?;
        self.remaining = self.remaining.saturating_sub(length as u64);
        if name.pop() != Some(0) {
            return Err(self.cut_off());
        }
        Ok(String::from_utf8_lossy(&name).into_owned())
    }

    /// Reads a count and that many records.
    fn records<T>(
        &mut self,
        what: &'static str,
        read: impl Fn(&mut Self) -> Result<T, DatasetError>,
    ) -> Result<Vec<T>, DatasetError> {
        let count = self.u64()?;
        let mut records = Vec::new();
        for number in 0..count {
            self.record = Some((what, number, count));
            records.push(read(self)?);
        }
        Ok(records)
    }
}

pub(super) fn cameras(file: &Path) -> Result<BTreeMap<u32, ModelCamera>, DatasetError> {
    let mut bytes = ByteReader::open(file)?;
    let cameras = bytes.records("camera", |bytes| {
        let id = bytes.u32()?;
        let number = bytes.take().map(i32::from_le_bytes)?;
        let size = (bytes.u64()? as usize, bytes.u64()? as usize);
        let (name, count) = model_by_id(number).map_err(|reason| bytes.refuse(&reason))?;
        let parameters: Result<Vec<f64>, _> = (0..count).map(|_| bytes.f64()).collect();
        let camera = ModelCamera::new(name, size, &parameters?);
        Ok((id, camera.map_err(|reason| bytes.refuse(&reason))?))
    })?;
    Ok(cameras.into_iter().collect())
}

pub(super) fn images(file: &Path) -> Result<Vec<ModelImage>, DatasetError> {
    ByteReader::open(file)?.records("image", |bytes| {
        let id = bytes.u32()?;
        let (q, t) = (bytes.f64s::<4>()?, bytes.f64s::<3>()?);
        let camera = bytes.u32()?;
        let name = bytes.name()?;
        if name.is_empty() {
            return Err(bytes.refuse("it has no name, expected that of its picture"));
        }
        let points = bytes.u64()?;
        bytes.skip(points, 24)?;
        let world_from_camera = parse_pose(q, t).map_err(|reason| bytes.refuse(&reason))?;
        Ok(ModelImage { id, camera, name, world_from_camera })
    })
}

pub(super) fn points(file: &Path) -> Result<Vec<ModelPoint>, DatasetError> {
    ByteReader::open(file)?.records("point", |bytes| {
        bytes.u64()?;
        let position = Vec3::from_array(bytes.f64s::<3>()?);
        bytes.skip(3, 1)?;
        let error = bytes.f64()?;
        if !(position.is_finite() && error.is_finite()) {
            return Err(bytes.refuse("a number is not finite"));
        }
        let count = bytes.u64()?;
        let mut images = Vec::new();
        for _ in 0..count {
            images.push(bytes.u32()?);
            bytes.skip(1, 4)?;
        }
        Ok(ModelPoint { position, error, images })
    })
}
