//! Scene files and the presets that need none.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::tomlfile;

/// Scenes that come with the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Square view, smooth surface, sharp round edges.
    Clean,
    /// Brushed metal seen through tilt and distortion, unevenly lit.
    Typical,
    /// Missing arcs, glare, spatter or dirt, soft ragged edges.
    Hard,
}

impl Preset {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Typical => "typical",
            Self::Hard => "hard",
        }
    }
}

/// A scene that comes with the program, of the texts of its kind in the order of [`Preset`].
pub(super) fn preset<T: DeserializeOwned + AsScene>(which: Preset, texts: [&str; 3]) -> Result<T> {
    let [clean, typical, hard] = texts;
    let text = match which {
        Preset::Clean => clean,
        Preset::Typical => typical,
        Preset::Hard => hard,
    };
    let origin = PathBuf::from(format!("preset {}", which.word()));
    checked(&origin, tomlfile::parse(&origin, text)?)
}

/// A scene read from a file.
pub(super) fn read<T: DeserializeOwned + AsScene>(path: &Path) -> Result<T> {
    checked(path, tomlfile::read(path)?)
}

/// What scenes of both kinds have at the top of their file.
pub trait AsScene {
    /// The kind it must be: "burn" or "rod".
    const KIND: &'static str;
    /// The file's `schema` and `kind`.
    fn header(&self) -> (u32, &str);
    /// Where the scene comes from, for messages.
    fn origin_mut(&mut self) -> &mut PathBuf;
}

fn checked<T: AsScene>(origin: &Path, mut scene: T) -> Result<T> {
    let (schema, kind) = scene.header();
    if schema != 1 {
        return Err(Error::field(
            origin,
            None,
            "schema",
            format!("is {schema}, this program reads 1"),
            "use a matching version",
        ));
    }
    if kind != T::KIND {
        return Err(Error::field(
            origin,
            None,
            "kind",
            format!("is '{kind}', this command renders '{}'", T::KIND),
            format!("use 'render {kind}' if there is one, or another scene file"),
        ));
    }
    *scene.origin_mut() = origin.to_owned();
    Ok(scene)
}
