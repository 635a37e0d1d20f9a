//! Whether a picture has too few grays for its edges: a palette's, or those of line art.

/// Pixels looked at.
const SEEN: usize = 1 << 16;
/// Fewer grays than this, and farther apart in counts than the other, are too coarse for an edge.
const FEW: usize = 32;
const APART: usize = 4;

/// How many grays there are where they are few and far apart.
pub(super) fn few(pixels: &[u8]) -> Option<usize> {
    let mut seen = [false; 256];
    // An odd step comes through all columns.
    let step = (pixels.len() / SEEN) | 1;
    pixels.iter().step_by(step).for_each(|p| seen[usize::from(*p)] = true);
    let count = seen.iter().filter(|s| **s).count();
    let (first, last) = (seen.iter().position(|s| *s)?, seen.iter().rposition(|s| *s)?);
    (count > 1 && count < FEW && last - first >= APART * (count - 1)).then_some(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_palette_is_told_and_a_pale_picture_is_not() {
        let ramp = |step: u8, count: u8| -> Vec<u8> {
            (0..40_000u32).map(|i| 10 + step * (i * i % u32::from(count)) as u8).collect()
        };
        assert_eq!(few(&ramp(1, 20)), None);
        assert_eq!(few(&[7; 500]), None);
        assert!(few(&ramp(16, 15)).is_some());
        assert_eq!(few(&[0, 255, 0, 0, 255]), Some(2));
    }
}
