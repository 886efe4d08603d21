//! Gaussians in the PLY layout of viewers of 3D Gaussian splatting (Kerbl et al. 2023).

use super::splat::Splat;
use std::io::{self, Write};

const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
    "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];

/// Writes binary little-endian PLY, with a comment in its header.
pub fn write(out: &mut dyn Write, splats: &[Splat], comment: Option<&str>) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    if let Some(comment) = comment {
        writeln!(out, "comment {comment}")?;
    }
    writeln!(out, "element vertex {}", splats.len())?;
    for property in PROPERTIES {
        writeln!(out, "property float {property}")?;
    }
    writeln!(out, "end_header")?;
    for splat in splats {
        let harmonics = splat.harmonics();
        let groups: [&[f32]; 6] = [
            &splat.mean,
            &[0.0; 3],
            &harmonics,
            &[splat.opacity_logit],
            &splat.log_scale,
            &splat.rotation,
        ];
        for value in groups.into_iter().flatten() {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_and_rows_agree() {
        let splat = Splat {
            mean: [1.0, 2.0, 3.0],
            colour: [0.5, 1.0, 0.0],
            opacity_logit: -0.25,
            log_scale: [-4.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let mut bytes = Vec::new();
        write(&mut bytes, &[splat, splat], None).expect("memory");
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
        let header = String::from_utf8_lossy(&bytes[..start]);
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 2\n"));
        let properties = header.matches("property float ").count();
        assert_eq!(bytes.len() - start, 2 * 4 * properties);
        let value = |i: usize| {
            let b = &bytes[start + 4 * i..start + 4 * i + 4];
            f32::from_le_bytes([b[0], b[1], b[2], b[3]])
        };
        assert_eq!([value(0), value(1), value(2)], [1.0, 2.0, 3.0]);
        assert_eq!(value(6), 0.0);
        assert!((value(7) - 1.772_454).abs() < 1e-5);
        assert_eq!([value(9), value(10), value(13)], [-0.25, -4.0, 1.0]);
        let mut marked = Vec::new();
        write(&mut marked, &[], Some("from a test")).expect("memory");
        assert!(String::from_utf8_lossy(&marked).contains("1.0\ncomment from a test\nelement"));
    }
}
