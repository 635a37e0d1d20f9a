//! Whether a JPEG is whole: decoders fill what is missing with gray, in which edges would be measured.

const START: u8 = 0xd8;
const END: u8 = 0xd9;

/// Whether it begins as a JPEG and ends before its end marker. What follows that marker does not matter, and a
/// thumbnail's end marker lies in a segment of its own.
pub fn is_cut_short(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, START]) && end(bytes).is_none()
}

/// Where the end marker stands.
fn end(bytes: &[u8]) -> Option<usize> {
    let mut at = 2;
    loop {
        at = next_marker(bytes, at)?;
        let marker = bytes[at + 1];
        at += 2;
        match marker {
            END => return Some(at - 2),
            // Markers that stand alone.
            0x01 | 0xd0..=START => {}
            _ => {
                let length = bytes.get(at..at + 2)?;
                at += usize::from(u16::from_be_bytes([length[0], length[1]])).max(2);
                // Behind a scan's head its data follow: markers are told apart in them as anywhere.
            }
        }
    }
}

/// The next 0xff that begins a marker: in a scan's data 0xff is followed by zero, and before a marker it may be repeated.
fn next_marker(bytes: &[u8], from: usize) -> Option<usize> {
    let pairs = bytes.get(from..)?.windows(2);
    let is_marker = |pair: &[u8]| pair[0] == 0xff && pair[1] != 0x00 && pair[1] != 0xff;
    pairs.into_iter().position(is_marker).map(|i| from + i)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded() -> Vec<u8> {
        let image = image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * y * 7) as u8]));
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_picture_is_cut_short_wherever_it_was_cut() {
        let whole = encoded();
        assert!(!is_cut_short(&whole));
        assert!((2..whole.len()).all(|n| is_cut_short(&whole[..n])));
        // What stands behind its end is none of it, and fill bytes may stand before any marker.
        assert!(!is_cut_short(&[&whole[..], &[0; 5000]].concat()));
        let (body, end) = whole.split_at(whole.len() - 2);
        assert!(!is_cut_short(&[body, &[0xff, 0xff], end].concat()));
        assert!(is_cut_short(&[body, &[0; 5000]].concat()));
        // A thumbnail's end is not the picture's.
        let with = |part: &[u8]| [&whole[..2], part, &whole[2..]].concat();
        let thumbnail = with(&[0xff, 0xe1, 0, 6, 0xff, 0xd8, 0xff, 0xd9]);
        assert!(!is_cut_short(&thumbnail));
        assert!(is_cut_short(&thumbnail[..thumbnail.len() - 2]));
        assert!(!is_cut_short(b"\x89PNG"));
    }

    #[test]
    fn cameras_own_pictures_are_whole() {
        let Ok(folder) = std::fs::read_dir("../shared/data/fibres") else {
            eprintln!("skipped: no pictures of a camera");
            return;
        };
        for path in folder.map(|entry| entry.unwrap().path()) {
            let bytes = std::fs::read(&path).unwrap();
            assert!(!is_cut_short(&bytes), "{}", path.display());
            assert!(!bytes.starts_with(&[0xff, START]) || is_cut_short(&bytes[..bytes.len() / 2]));
        }
    }
}
