//! Captures on disk: the picture as it came, and its row in the manifest that `rod` reads. Both are written whole, the
//! picture first: whatever happens afterwards, what is stored stays readable.

use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::error::{Error, Result};
use crate::live::Shot;
use crate::output::{create_folder, write_whole};
use crate::table::{MOST_DEG, Table};

/// The manifest's name and header.
const MANIFEST: &str = "captures.csv";
const HEADER: &str = "image,x_mm,y_mm,c_deg\n";

/// Where the machine stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Machine X.
    pub x_mm: f64,
    /// Machine Y.
    pub y_mm: f64,
    /// Table angle.
    pub c_deg: f64,
}

/// Farther no axis goes, mm.
const MOST_MM: f64 = 1e6;

impl Position {
    /// Reads `X Y [C]`, as an operator types it.
    pub fn parse(line: &str) -> Result<Self> {
        // Beside blanks or semicolons a comma between digits is a decimal mark: 3,5 4 is not X 3 Y 5 C 4.
        let apart = |c: char| c.is_whitespace() || c == ';';
        let tight = line
            .as_bytes()
            .windows(3)
            .any(|w| w[1] == b',' && w[0].is_ascii_digit() && w[2].is_ascii_digit());
        let commas = !(tight && line.trim().contains(apart));
        let between = |c: char| apart(c) || (commas && c == ',');
        let words: Vec<&str> = line.split(between).filter(|w| !w.is_empty()).collect();
        let numbers: Vec<f64> = words.iter().map_while(|w| w.parse().ok()).collect();
        match numbers[..] {
            [x_mm, y_mm, ref rest @ ..]
                if words.len() == numbers.len()
                    && words.len() <= 3
                    && numbers.iter().all(|v| v.is_finite()) =>
            {
                let c_deg = rest.first().copied().unwrap_or(0.0);
                if x_mm.abs().max(y_mm.abs()) > MOST_MM || c_deg.abs() > MOST_DEG {
                    return Err(Error::option(
                        "position",
                        format!("'{}' is where no machine goes", line.trim()),
                        "type X and Y in mm and C in degrees",
                    ));
                }
                Ok(Self { x_mm, y_mm, c_deg })
            }
            _ => Err(Error::option(
                "position",
                format!("'{}' is not X Y or X Y C", line.trim()),
                "type the machine's X and Y in mm, and C in degrees where it is not 0, with blanks between and a point as the decimal mark",
            )),
        }
    }

    /// Reads a table of positions: `x_mm,y_mm` and optionally `c_deg`.
    pub fn read(path: &Path) -> Result<Vec<Self>> {
        let table = Table::read(path, &["x_mm", "y_mm"], &["c_deg"])?;
        let c = table.optional_column("c_deg")?;
        (0..table.rows())
            .map(|r| {
                Ok(Self {
                    x_mm: table.number(r, "x_mm")?,
                    y_mm: table.number(r, "y_mm")?,
                    c_deg: c.as_ref().map_or(0.0, |c| c[r]),
                })
            })
            .collect()
    }
}

/// A folder of captures; an old one is continued.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    next: usize,
}

impl Store {
    /// Opens or creates the folder.
    pub fn open(folder: &Path) -> Result<Self> {
        create_folder(folder)?;
        let store = Self { folder: folder.to_owned(), next: 1 };
        store.rows()?;
        Ok(store)
    }

    /// What the manifest holds, ready for another row.
    fn rows(&self) -> Result<String> {
        let path = self.manifest();
        match std::fs::read_to_string(&path) {
            Ok(mut text) if text.starts_with(HEADER) => {
                // An editor may have left the last line open.
                if !text.ends_with('\n') {
                    text.push('\n');
                }
                Ok(text)
            }
            Ok(_) => Err(Error::file(
                path,
                "was not written by this program",
                format!("choose another folder, or make its header {}", HEADER.trim()),
            )),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(HEADER.to_owned()),
            Err(e) => Err(Error::io(path, "read", e)),
        }
    }

    /// Where the manifest is.
    pub fn manifest(&self) -> PathBuf {
        self.folder.join(MANIFEST)
    }

    /// Stores a picture under the next free number; gives its name.
    pub fn add(&mut self, shot: &Shot, at: Position) -> Result<String> {
        let (bytes, extension) = match shot {
            Shot::Encoded(bytes, _) if bytes.starts_with(&[0xff, 0xd8]) => (bytes.clone(), "jpg"),
            Shot::Encoded(bytes, path) => {
                let known = path.as_ref().and_then(|p| p.extension()?.to_str());
                (bytes.clone(), known.unwrap_or("png"))
            }
            Shot::Plain(gray) => {
                let mut bytes = Vec::new();
                PngEncoder::new_with_quality(
                    &mut bytes,
                    CompressionType::Fast,
                    FilterType::Adaptive,
                )
                .write_image(
                    &gray.data,
                    gray.width as u32,
                    gray.height as u32,
                    ExtendedColorType::L8,
                )
                .map_err(|e| Error::measure("capture", e.to_string(), "report this"))?;
                (bytes, "png")
            }
        };
        // Where folders can be locked, two sessions in one take turns; the lock ends with the process.
        let turn = std::fs::File::open(&self.folder);
        let _turn = turn.ok().filter(|folder| folder.lock().is_ok());
        let stem = loop {
            let stem = format!("capture-{:04}", self.next);
            let taken = ["jpg", "png", extension]
                .iter()
                .any(|e| self.folder.join(format!("{stem}.{e}")).exists());
            self.next += 1;
            if !taken {
                break stem;
            }
        };
        let name = format!("{stem}.{extension}");
        write_whole(self.folder.join(&name), &bytes)?;
        // Read anew: another session, or a hand, may have added rows meanwhile.
        let rows = self.rows()?;
        let longer = format!("{rows}{name},{},{},{}\n", at.x_mm, at.y_mm, at.c_deg);
        write_whole(self.manifest(), longer.as_bytes())?;
        Ok(name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_read_as_operators_type_them() {
        assert_eq!(
            Position::parse("12.5 -3 90\n").unwrap(),
            Position { x_mm: 12.5, y_mm: -3.0, c_deg: 90.0 }
        );
        assert_eq!(Position::parse("1,2").unwrap().c_deg, 0.0);
        assert_eq!(Position::parse("1, 2").unwrap().y_mm, 2.0);
        assert_eq!(Position::parse("1.5; 2; 3").unwrap().c_deg, 3.0);
        for bad in ["", "1", "1 2 3 4", "1 x", "nan 2", "3,5 4", "3,5, 4", "12,5; 7"] {
            assert!(Position::parse(bad).is_err(), "{bad}");
        }
    }
}
