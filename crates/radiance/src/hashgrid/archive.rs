//! A field with its occupancy as bytes, lossless.
//!
//! Layout, little endian: the 8 bytes `I2FIELD\n`, format version (`u32`), the settings of the
//! field, of the march and of the occupancy (13 + 6 + 4 numbers, `f64`) and the number of updates so
//! far (`f64`), a bit for each of the occupancy's cells (the lowest of a byte first) that says
//! whether its remembered density is above 0, those that are (`f32`), the table, the weights of the
//! density network and of the colour network (`f32`), and the CRC-32 (ISO-HDLC) of everything
//! before.

use super::{
    FieldSettings, HashGridField, MarchSettings, Occupancy, OccupancySettings, SettingsError,
};

const MAGIC: &[u8; 8] = b"I2FIELD\n";
const VERSION: u32 = 2;
const PREAMBLE: usize = MAGIC.len() + 4;

/// Error of reading a field.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldFileError {
    /// They do not begin like a field.
    #[error("is not a hash grid of i2slam")]
    NotAField,
    /// They are of another format version.
    #[error("has format version {0}; this program reads version {VERSION}")]
    Version(u32),
    /// They end too early, or go on after the end.
    #[error("is truncated or too long")]
    Length,
    /// Their checksum does not match.
    #[error("is damaged (its checksum does not match)")]
    Damaged,
    /// Their settings are out of range.
    #[error("has settings that cannot be ({0})")]
    Settings(SettingsError),
}

/// The settings as numbers, in order of the file.
fn settings_to_numbers(
    field: &FieldSettings,
    march: &MarchSettings,
    occupancy: &OccupancySettings,
) -> Vec<f64> {
    let [x, y, z] = field.centre;
    let counts = [
        field.levels,
        field.features,
        field.log2_table as usize,
        field.base_resolution as usize,
        field.finest_resolution as usize,
        field.hidden_width,
        field.density_layers,
        field.colour_layers,
        field.geometry_features,
    ];
    let mut all = vec![x, y, z, field.bound];
    all.extend(counts.map(|count| count as f64));
    let MarchSettings { near, step_min, step_max, cone, steps_max, transmittance_min } = *march;
    all.extend([near, step_min, step_max, cone].map(f64::from));
    all.extend([f64::from(steps_max), f64::from(transmittance_min)]);
    let OccupancySettings { resolution, decay, density, full_updates } = *occupancy;
    all.extend([resolution.into(), decay.into(), density.into(), f64::from(full_updates)]);
    all
}

/// Numbers of the file before the occupancy's updates so far.
const NUMBERS: usize = 13 + 6 + 4;

/// The settings back from [`settings_to_numbers`]. Counts that are none become 0, which no check lets pass.
fn settings_from_numbers(n: &[f64; NUMBERS]) -> (FieldSettings, MarchSettings, OccupancySettings) {
    let count = |i: usize| n[i] as usize;
    let field = FieldSettings {
        centre: [n[0], n[1], n[2]],
        bound: n[3],
        levels: count(4),
        features: count(5),
        log2_table: count(6) as u32,
        base_resolution: count(7) as u32,
        finest_resolution: count(8) as u32,
        hidden_width: count(9),
        density_layers: count(10),
        colour_layers: count(11),
        geometry_features: count(12),
    };
    let march = MarchSettings {
        near: n[13] as f32,
        step_min: n[14] as f32,
        step_max: n[15] as f32,
        cone: n[16] as f32,
        steps_max: n[17] as u32,
        transmittance_min: n[18] as f32,
    };
    let occupancy = OccupancySettings {
        resolution: n[19] as u32,
        decay: n[20] as f32,
        density: n[21] as f32,
        full_updates: n[22] as u32,
    };
    (field, march, occupancy)
}

/// A field with its occupancy and how densely rays are sampled.
#[derive(Clone, Debug, PartialEq)]
pub struct HashGridMap {
    /// Radiance and density.
    pub field: HashGridField,
    /// Occupied cells, in which rays are sampled.
    pub occupancy: Occupancy,
    /// Step lengths along rays.
    pub march: MarchSettings,
}

impl HashGridMap {
    /// Every number of the field and of its occupancy, bit for bit.
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { field, occupancy, march } = self;
        let p = field.parameters();
        let cells = occupancy.densities();
        let dense: Vec<f32> = cells.iter().copied().filter(|d| *d > 0.0).collect();
        let arrays = [&dense, &p.table, &p.density, &p.colour];
        let values: usize = arrays.iter().map(|a| a.len()).sum();
        let bits = cells.len().div_ceil(8);
        let mut bytes = Vec::with_capacity(PREAMBLE + 8 * (NUMBERS + 1) + bits + 4 * values + 4);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        let mut all = settings_to_numbers(field.settings(), march, occupancy.settings());
        all.push(f64::from(occupancy.updates()));
        all.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        let bit = |byte: u8, (i, d): (usize, &f32)| byte | u8::from(*d > 0.0) << i;
        bytes.extend(cells.chunks(8).map(|cells| cells.iter().enumerate().fold(0, bit)));
        for array in arrays {
            array.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        }
        let sum = crc32fast::hash(&bytes);
        bytes.extend_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Back from [`to_bytes`](Self::to_bytes).
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FieldFileError> {
        let mut reader = Reader { rest: check_frame(bytes)? };
        let mut n = [0.0; NUMBERS];
        for value in &mut n {
            *value = f64::from_le_bytes(reader.take()?);
        }
        let (field, march, settings) = settings_from_numbers(&n);
        let count = HashGridField::<f32>::parameter_count(field);
        let count = count.map_err(FieldFileError::Settings)?;
        if !(1..=512).contains(&settings.resolution) {
            let error = SettingsError { name: "occupancy resolution" };
            return Err(FieldFileError::Settings(error));
        }
        let updates = f64::from_le_bytes(reader.take()?) as u32;
        let cells = (settings.resolution as usize).pow(3);
        let bits = reader.split(cells.div_ceil(8))?;
        let is_dense = |cell: usize| bits[cell / 8] >> (cell % 8) & 1 == 1;
        let dense = (0..cells).filter(|cell| is_dense(*cell)).count();
        if reader.rest.len() != 4 * (dense + count) {
            return Err(FieldFileError::Length);
        }
        let mut field = HashGridField::zeros(field).map_err(FieldFileError::Settings)?;
        let mut densities = vec![0.0; cells];
        for (_, density) in densities.iter_mut().enumerate().filter(|(cell, _)| is_dense(*cell)) {
            *density = f32::from_le_bytes(reader.take()?);
        }
        for value in field.parameters_mut().into_iter().flatten() {
            *value = f32::from_le_bytes(reader.take()?);
        }
        let occupancy = Occupancy::restored(settings, densities, updates);
        Ok(Self { field, occupancy, march })
    }
}

/// Checks beginning, version and checksum; what lies between them.
fn check_frame(bytes: &[u8]) -> Result<&[u8], FieldFileError> {
    let begun = &MAGIC[..bytes.len().min(MAGIC.len())];
    if !bytes.starts_with(begun) {
        return Err(FieldFileError::NotAField);
    }
    let (head, rest) = bytes.split_first_chunk::<PREAMBLE>().ok_or(FieldFileError::Length)?;
    let version = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
    if version != VERSION {
        return Err(FieldFileError::Version(version));
    }
    let (inner, sum) = rest.split_last_chunk::<4>().ok_or(FieldFileError::Length)?;
    let checked = &bytes[..PREAMBLE + inner.len()];
    if crc32fast::hash(checked).to_le_bytes() != *sum {
        return Err(FieldFileError::Damaged);
    }
    Ok(inner)
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn split(&mut self, count: usize) -> Result<&'a [u8], FieldFileError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(FieldFileError::Length)?;
        self.rest = rest;
        Ok(taken)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], FieldFileError> {
        let (taken, rest) = self.rest.split_first_chunk::<N>().ok_or(FieldFileError::Length)?;
        self.rest = rest;
        Ok(*taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hashgrid::FieldRenderer;
    use crate::hashgrid::tests::{field, settings};
    fn map() -> HashGridMap {
        let field = field(settings(), 3).cast::<f32>();
        let march = MarchSettings::cube(1.5);
        let settings = OccupancySettings { resolution: 8, density: 1.0, ..Default::default() };
        let mut occupancy = Occupancy::new(settings);
        occupancy.refresh(&field, &mut FieldRenderer::new(march), 1);
        HashGridMap { field, occupancy, march }
    }

    #[test]
    fn reads_back_every_bit() {
        let map = map();
        let back = HashGridMap::from_bytes(&map.to_bytes()).expect("its own bytes");
        assert_eq!(back, map);
        assert_eq!(back.to_bytes(), map.to_bytes());
    }

    #[test]
    fn says_what_is_wrong() {
        let bytes = map().to_bytes();
        let refusal = |bytes: &[u8]| HashGridMap::from_bytes(bytes).err();
        assert_eq!(refusal(b"I2SLAM\r\nabcdefgh"), Some(FieldFileError::NotAField));
        for length in [0, 5, 10, 14] {
            assert_eq!(refusal(&bytes[..length]), Some(FieldFileError::Length), "{length}");
        }
        assert_eq!(refusal(&bytes[..bytes.len() - 1]), Some(FieldFileError::Damaged));
        let mut flipped = bytes.clone();
        flipped[bytes.len() / 2] ^= 1;
        assert_eq!(refusal(&flipped), Some(FieldFileError::Damaged));
        let mut newer = bytes.clone();
        newer[8] = 9;
        assert_eq!(refusal(&newer), Some(FieldFileError::Version(9)));
    }

    /// Bytes with a right checksum and wrong content.
    #[test]
    fn refuses_settings_and_lengths_that_cannot_be() {
        let bytes = map().to_bytes();
        let with = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut inner = bytes[..bytes.len() - 4].to_vec();
            change(&mut inner);
            let sum = crc32fast::hash(&inner);
            inner.extend_from_slice(&sum.to_le_bytes());
            HashGridMap::from_bytes(&inner).err()
        };
        let put = |at: usize, v: f64| {
            move |b: &mut Vec<u8>| b[12 + 8 * at..20 + 8 * at].copy_from_slice(&v.to_le_bytes())
        };
        let named = |name| Some(FieldFileError::Settings(SettingsError { name }));
        assert_eq!(with(&|_| ()), None);
        assert_eq!(with(&put(4, 0.0)), named("levels"));
        assert_eq!(with(&put(9, f64::NAN)), named("hidden_width"));
        assert_eq!(with(&put(19, 1e9)), named("occupancy resolution"));
        assert_eq!(with(&put(4, 2.0)), Some(FieldFileError::Length));
        assert_eq!(with(&|b| b.truncate(400)), Some(FieldFileError::Length));
    }
}
