//! ImportedKeyframes as numpy writes them.

/// An `.npy` file of numbers of a type such as `<f4`.
pub(crate) fn npy(descr: &str, shape: &[usize], numbers: &[f64]) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(|side| format!("{side},")).collect();
    let shape = sides.join(" ");
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for &number in numbers {
        match descr {
            "|u1" => bytes.push(number as u8),
            "<i8" => bytes.extend((number as i64).to_le_bytes()),
            "<f8" => bytes.extend(number.to_le_bytes()),
            _ => bytes.extend((number as f32).to_le_bytes()),
        }
    }
    bytes
}

/// An archive of members, stored or deflated, as `np.savez` and `np.savez_compressed` write it.
pub(crate) fn npz(members: &[(&str, Vec<u8>)], deflate: bool) -> Vec<u8> {
    let (mut out, mut table) = (Vec::new(), Vec::new());
    for (name, bytes) in members {
        let name = format!("{name}.npy");
        let packed =
            if deflate { miniz_oxide::deflate::compress_to_vec(bytes, 6) } else { bytes.clone() };
        let mut record = vec![20, 0, 0, 0, if deflate { 8 } else { 0 }, 0, 0, 0, 0, 0];
        record.extend(crc32fast::hash(bytes).to_le_bytes());
        record.extend((packed.len() as u32).to_le_bytes());
        record.extend((bytes.len() as u32).to_le_bytes());
        record.extend((name.len() as u16).to_le_bytes());
        let offset = out.len() as u32;
        // numpy leaves room for 64-bit sizes before every member, not in the table.
        let wide = [1, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        out.extend(b"PK\x03\x04");
        out.extend(&record);
        out.extend((wide.len() as u16).to_le_bytes());
        out.extend(name.bytes());
        out.extend(wide);
        out.extend(packed);
        table.extend(b"PK\x01\x02\x14\x03");
        table.extend(&record);
        table.extend([0; 12]);
        table.extend(offset.to_le_bytes());
        table.extend(name.bytes());
    }
    let place = out.len() as u32;
    let count = (members.len() as u16).to_le_bytes();
    out.extend(&table);
    out.extend(b"PK\x05\x06\x00\x00\x00\x00");
    out.extend([count, count].concat());
    out.extend((table.len() as u32).to_le_bytes());
    out.extend(place.to_le_bytes());
    out.extend([0, 0]);
    out
}
