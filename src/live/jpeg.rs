//! The brightness of a JPEG, without its colours: what a live camera's frame costs most.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::frame::Gray;

/// The end mark may be followed by this many bytes of padding.
const TAIL: usize = 1024;

/// Whether it begins as a JPEG but lacks the end mark: decoders fill what is missing with gray.
pub fn is_cut_short(bytes: &[u8]) -> bool {
    let tail = &bytes[bytes.len().saturating_sub(TAIL)..];
    bytes.starts_with(&[0xff, 0xd8]) && !tail.windows(2).any(|w| w == [0xff, 0xd9])
}

/// Decodes luma; `None` for what is no JPEG that has it.
pub fn luma(bytes: &[u8]) -> Option<Gray<u8>> {
    if !bytes.starts_with(&[0xff, 0xd8]) {
        return None;
    }
    let options =
        DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let data = decoder.decode().ok()?;
    let info = decoder.info()?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    (data.len() == width * height).then_some(Gray { width, height, data })
}
