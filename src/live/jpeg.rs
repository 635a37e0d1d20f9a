//! The brightness of a JPEG, without its colours: what a live camera's frame costs most.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::frame::Gray;

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
