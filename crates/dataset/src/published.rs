//! Which part of a published sequence the paper uses.

use std::ops::Range;

/// Scenes of ScanNet and the frames that the paper takes of them (appendix, "Real-world
/// dataset"), read as half-open ranges.
const SCANNET: [(&str, Range<usize>); 4] =
    [("0024_01", 0..300), ("0031_00", 0..300), ("0736_00", 1000..1400), ("0785_00", 0..500)];

/// The frames that the paper uses of a sequence, known by a name such as `scene0024_01` or
/// `0024-01`; `None` for every other sequence.
///
/// Published lists of sharp frames count from the start of this range.
pub fn paper_frames(name: &str) -> Option<Range<usize>> {
    let name = name.replace('-', "_");
    let digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    let known = |scene: &str| {
        name.match_indices(scene).any(|(at, _)| {
            let (before, behind) = (&name[..at], &name[at + scene.len()..]);
            !digit(before.chars().next_back()) && !digit(behind.chars().next())
        })
    };
    SCANNET.into_iter().find(|(scene, _)| known(scene)).map(|(_, range)| range)
}

#[cfg(test)]
mod tests {
    use super::paper_frames;

    #[test]
    fn scenes_are_known_by_name() {
        assert_eq!(paper_frames("scene0736_00"), Some(1000..1400));
        assert_eq!(paper_frames("0785-00"), Some(0..500));
        assert_eq!(paper_frames("scene0024_01.sens"), Some(0..300));
        assert_eq!(paper_frames("scene0024_00"), None);
        assert_eq!(paper_frames("scene10024_01"), None);
        assert_eq!(paper_frames("scene0024_011"), None);
    }
}
