//! Where pictures come from, told by how the user names it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::cv::Video;
use crate::error::{Error, Result};
use crate::frame::jpeg::is_cut_short;
use crate::frame::{Channel, Frame, Gray, Picture, named};
use crate::input;
use crate::live::jpeg;
use crate::live::mjpeg::Stream;

/// A picture as it came, not yet decoded where it came encoded: a picture that is dropped costs nothing.
#[derive(Debug, Clone)]
pub enum Shot {
    /// JPEG, PNG or another format's bytes, and the file it came from, if any.
    Encoded(Vec<u8>, Option<PathBuf>),
    /// Decoded by the camera's driver.
    Plain(Gray<u8>),
}

impl Shot {
    /// Whether it is the same to the last byte.
    pub(super) fn is_copy_of(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Encoded(a, _), Self::Encoded(b, _)) => a == b,
            (Self::Plain(a), Self::Plain(b)) => a.data == b.data,
            _ => false,
        }
    }

    /// What it is called: its file, or which frame it is.
    pub fn name(&self, number: usize) -> String {
        match self {
            Self::Encoded(_, Some(path)) => path.display().to_string(),
            _ => format!("frame {number}"),
        }
    }

    /// The picture as one gray frame.
    pub fn frame(&self) -> Result<Frame> {
        match self {
            Self::Plain(gray) => Ok(Frame::Eight(gray.clone())),
            Self::Encoded(bytes, path) => {
                let name = path.clone().unwrap_or_else(|| PathBuf::from("frame"));
                if is_cut_short(bytes) {
                    return Err(Error::file(name, "is cut short", "wait for the next picture"));
                }
                match jpeg::luma(bytes) {
                    Some(gray) => Ok(Frame::Eight(gray)),
                    None => Ok(Picture::decode(name, bytes)?.into_frame(Channel::Auto)),
                }
            }
        }
    }
}

/// Something that delivers one picture after the other.
pub(super) trait Source: Send {
    /// The next picture; `None` at the end.
    fn next(&mut self) -> Result<Option<Shot>>;
}

/// Opens a live source; its reads end where the flag is set.
pub(super) type Open = dyn Fn(Arc<AtomicBool>) -> Result<Box<dyn Source>> + Send;

/// What the user's words name.
pub(super) enum Named {
    /// Goes on whether it is looked at or not; opened again where it is lost.
    Live(Box<Open>),
    /// Waits to be read.
    Stored(Box<dyn Source>),
}

/// A device's number, a file, a folder or a URL.
pub(super) fn name(text: &str) -> Result<Named> {
    if text.starts_with("http://") {
        let url = text.to_owned();
        Stream::check(&url)?;
        return Ok(Named::Live(Box::new(move |stop| Ok(Box::new(Stream::open(&url, stop)?)))));
    }
    if text.contains("://") {
        return Err(Error::option(
            "SOURCE",
            format!("'{text}' is a kind of stream that is not read"),
            "give http:// (MJPEG), a device's number, a video file or a folder",
        ));
    }
    let path = Path::new(text);
    if path.is_dir() {
        return Ok(Named::Stored(Box::new(Folder::open(path)?)));
    }
    if let (Ok(device), false) = (text.parse::<u32>(), path.exists()) {
        // Opened once here, so that a camera that is not there is an error at once.
        Video::device(device).map(|_| ())?;
        return Ok(Named::Live(Box::new(move |_| Ok(Box::new(Video::device(device)?)))));
    }
    if !path.exists() {
        return Err(Error::option(
            "SOURCE",
            format!("'{text}' does not exist"),
            "give a device's number, a video file, a folder of pictures or an http:// stream",
        ));
    }
    Ok(Named::Stored(Box::new(Video::file(path)?)))
}

impl Source for Video {
    fn next(&mut self) -> Result<Option<Shot>> {
        Ok(self.read()?.map(Shot::Plain))
    }
}

/// The pictures of a folder, one after the other.
struct Folder(std::vec::IntoIter<PathBuf>);

impl Folder {
    fn open(path: &Path) -> Result<Self> {
        Ok(Self(pictures(path)?.into_iter()))
    }
}

/// The pictures of a folder in the order of their names.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let read = |e| Error::io(folder, "read", e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let file = entry.map_err(read)?.path();
        if named::is_one_of(&file, &named::PICTURES) {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(Error::file(
            folder,
            "has no pictures",
            format!("names must end in {}", named::PICTURES.join(", ")),
        ));
    }
    files.sort();
    Ok(files)
}

/// The files that a source is read from: a folder's pictures, a video; none of a camera or a stream.
///
/// # Errors
/// A folder that cannot be read, or has no pictures.
pub fn files(source: &str) -> Result<Vec<PathBuf>> {
    let path = Path::new(source);
    if path.is_dir() {
        pictures(path)
    } else {
        Ok(path.is_file().then(|| path.into()).into_iter().collect())
    }
}

impl Source for Folder {
    fn next(&mut self) -> Result<Option<Shot>> {
        let Some(path) = self.0.next() else { return Ok(None) };
        let bytes = input::bytes(&path, input::MOST_PICTURE)?;
        Ok(Some(Shot::Encoded(bytes, Some(path))))
    }
}
