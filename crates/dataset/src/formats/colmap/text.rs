//! Text models: `cameras.txt`, `images.txt`, `points3D.txt`.

use super::camera::ModelCamera;
use super::{ModelImage, ModelPoint, parse_pose};
use crate::DatasetError;
use crate::text::{data_lines, parse_number, parse_numbers, read_model_text};
use i2slam_geometry::Vec3;
use std::collections::BTreeMap;
use std::path::Path;

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]`
pub(super) fn cameras(file: &Path) -> Result<BTreeMap<u32, ModelCamera>, DatasetError> {
    let text = read_model_text(file)?;
    let mut cameras = BTreeMap::new();
    for (line, content) in data_lines(&text) {
        let words: Vec<&str> = content.split_whitespace().collect();
        let [id, model, width, height, parameters @ ..] = words.as_slice() else {
            let reason = format!(
                "{} columns, expected camera, model, width, height, parameters",
                words.len()
            );
            return Err(DatasetError::line(file, line, reason));
        };
        let parameters: Result<Vec<f64>, _> =
            parameters.iter().map(|word| parse_number(file, line, "parameter", word)).collect();
        let size = (
            parse_integer(file, line, "width", width)?,
            parse_integer(file, line, "height", height)?,
        );
        let camera = ModelCamera::new(model, size, &parameters?)
            .map_err(|reason| DatasetError::line(file, line, reason))?;
        cameras.insert(parse_integer(file, line, "camera", id)?, camera);
    }
    Ok(cameras)
}

/// Two lines per image: `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, then its 2D points, which
/// may be none.
pub(super) fn images(file: &Path) -> Result<Vec<ModelImage>, DatasetError> {
    let text = read_model_text(file)?;
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    let mut images = Vec::new();
    // An empty second line is an image without points, so blank lines are skipped before images only.
    while let Some((line, content)) = lines.next() {
        let content = content.trim_start_matches('\u{feff}');
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        images.push(parse_image(file, line, content)?);
        if let Some((line, content)) = lines.next() {
            check_points(file, line, content)?;
        }
    }
    Ok(images)
}

/// Refuses a line that does not hold 2D points `X Y POINT3D_ID`.
fn check_points(file: &Path, line: usize, content: &str) -> Result<(), DatasetError> {
    let count = content.split_whitespace().count();
    let first = content.split_whitespace().nth(2);
    if count.is_multiple_of(3) && first.is_none_or(|word| word.parse::<i64>().is_ok()) {
        return Ok(());
    }
    let reason = format!(
        "{count} columns, expected the 2D points of the image before, X Y POINT3D_ID each (an \
         empty line if there is none)"
    );
    Err(DatasetError::line(file, line, reason))
}

fn parse_image(file: &Path, line: usize, content: &str) -> Result<ModelImage, DatasetError> {
    let mut rest = content;
    let mut words = [""; 9];
    for word in &mut words {
        let (first, behind) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        (*word, rest) = (first, behind.trim_start());
    }
    if rest.is_empty() {
        let count = content.split_whitespace().count();
        let reason = format!(
            "{count} columns, expected 10: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME (every \
             image has two lines)"
        );
        return Err(DatasetError::line(file, line, reason));
    }
    let names = ["qw", "qx", "qy", "qz", "tx", "ty", "tz"];
    let [qw, qx, qy, qz, tx, ty, tz] = parse_numbers(file, line, names, &words[1..8])?;
    let pose = parse_pose([qw, qx, qy, qz], [tx, ty, tz]);
    Ok(ModelImage {
        id: parse_integer(file, line, "image", words[0])?,
        camera: parse_integer(file, line, "camera", words[8])?,
        name: rest.to_owned(),
        world_from_camera: pose.map_err(|reason| DatasetError::line(file, line, reason))?,
    })
}

/// `POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]`
pub(super) fn points(file: &Path) -> Result<Vec<ModelPoint>, DatasetError> {
    let text = read_model_text(file)?;
    let point = |(line, content): (usize, &str)| {
        let words: Vec<&str> = content.split_whitespace().collect();
        if words.len() < 8 || !words.len().is_multiple_of(2) {
            let reason = format!(
                "{} columns, expected POINT3D_ID X Y Z R G B ERROR and pairs of numbers",
                words.len()
            );
            return Err(DatasetError::line(file, line, reason));
        }
        let value = |at: usize, name| parse_number(file, line, name, words[at]);
        let position = Vec3::new(value(1, "x")?, value(2, "y")?, value(3, "z")?);
        let images: Result<Vec<u32>, _> =
            words[8..].chunks(2).map(|pair| parse_integer(file, line, "image", pair[0])).collect();
        Ok(ModelPoint { position, error: value(7, "error")?, images: images? })
    };
    data_lines(&text).map(point).collect()
}

fn parse_integer<T: std::str::FromStr>(
    file: &Path,
    line: usize,
    name: &str,
    word: &str,
) -> Result<T, DatasetError> {
    word.parse().map_err(|_| {
        DatasetError::line(file, line, format!("{name} is '{word}', expected a whole number"))
    })
}
