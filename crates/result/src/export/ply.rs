//! Gaussians in the PLY layout of viewers of 3D Gaussian splatting (Kerbl et al. 2023).

use super::harmonics;
use super::splat::Splat;
use std::io::{self, Write};

/// Properties before and after the harmonics of degree 1 and 2, which only a map with view colours
/// has.
const FIRST: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
const LAST: [&str; 8] =
    ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];

/// Writes binary little-endian PLY, with a comment in its header.
pub fn write(out: &mut dyn Write, splats: &[Splat], comment: Option<&str>) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    if let Some(comment) = comment {
        writeln!(out, "comment {comment}")?;
    }
    writeln!(out, "element vertex {}", splats.len())?;
    let has_view = splats.iter().any(|splat| splat.view.is_some());
    let rest = if has_view { 3 * (harmonics::COUNT - 1) } else { 0 };
    let rest = (0..rest).map(|k| format!("f_rest_{k}"));
    let all = FIRST.map(str::to_owned).into_iter().chain(rest).chain(LAST.map(str::to_owned));
    for property in all {
        writeln!(out, "property float {property}")?;
    }
    writeln!(out, "end_header")?;
    for splat in splats {
        let [constant, others @ ..] = splat.harmonics();
        // One channel after another.
        let mut rest = [[0.0; harmonics::COUNT - 1]; 3];
        (0..3).for_each(|c| (0..others.len()).for_each(|k| rest[c][k] = others[k][c]));
        let groups: [&[f32]; 7] = [
            &splat.mean,
            &[0.0; 3],
            &constant,
            if has_view { rest.as_flattened() } else { &[] },
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
            view: None,
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
        let mut coefficients = [[0.0; 3]; harmonics::COUNT];
        (coefficients[0], coefficients[2]) = ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]);
        let mut glossy = Vec::new();
        let seen = Splat { view: Some(coefficients), ..splat };
        write(&mut glossy, &[seen, splat], None).expect("memory");
        let start = glossy.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
        let header = String::from_utf8_lossy(&glossy[..start]);
        assert!(
            header.contains("f_dc_2\nproperty float f_rest_0\n") && header.contains("f_rest_23")
        );
        let rows: Vec<f32> =
            glossy[start..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert_eq!((rows.len(), rows[6], rows[9 + 1], rows[9 + 8 + 1]), (2 * 41, 1.0, 4.0, 5.0));
        assert!(rows[41 + 9..41 + 9 + 24].iter().all(|v| *v == 0.0));
        let mut marked = Vec::new();
        write(&mut marked, &[], Some("from a test")).expect("memory");
        assert!(String::from_utf8_lossy(&marked).contains("1.0\ncomment from a test\nelement"));
    }
}
