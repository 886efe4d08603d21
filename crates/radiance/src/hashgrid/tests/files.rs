//! Fields as bytes.

use super::scenes::*;
use crate::hashgrid::*;

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
