//! Measured lengths of the bar, and where each was taken: read from a file, what it leaves out told by the path.

use std::path::Path as FilePath;

use super::decouple::Options;
use super::model::{Bar, Point};
use super::path::{Path, Pose};
use crate::error::{Error, Result};
use crate::repeats;
use crate::table::Table;
use crate::units;

/// Measured lengths and where they were taken.
#[derive(Debug, Clone)]
pub struct Data {
    pub(super) points: Vec<Point>,
    pub(super) lengths_mm: Vec<f64>,
    pub(super) paths: Vec<(String, Path)>,
    /// What a user should know of the file.
    pub(super) warnings: Vec<String>,
}

impl Data {
    /// The points path by path, by rising B.
    pub(super) fn along_paths(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.points.len()).collect();
        let key = |i: &usize| (self.points[*i].path, self.points[*i].pose.b_rad);
        order.sort_by(|a, b| {
            let ((p, b_rad), (q, c_rad)) = (key(a), key(b));
            p.cmp(&q).then(b_rad.total_cmp(&c_rad))
        });
        order
    }

    /// Whether B turns one way along every path: as `dir` says, or without it as the rows follow each other.
    pub(super) fn goes_one_way(&self) -> bool {
        let steps = self.points.windows(2).filter(|two| two[0].path == two[1].path);
        let ways: Vec<f64> = if self.points.iter().all(|p| p.dir == 0.0) {
            steps.map(|two| two[1].pose.b_rad - two[0].pose.b_rad).filter(|s| *s != 0.0).collect()
        } else {
            self.points.iter().map(|p| p.dir).filter(|way| *way != 0.0).collect()
        };
        ways.windows(2).all(|two| two[0].signum() == two[1].signum())
    }

    /// Reads `b_deg,length_mm`, optionally `x_mm,z_mm,path,cup_y_mm,dir`. Where X or Z is missing the path tells it.
    pub fn read(file: impl AsRef<FilePath>, options: &Options) -> Result<Self> {
        let mut table = Table::read(
            file,
            &["b_deg", "length_mm"],
            &["x_mm", "z_mm", "path", "cup_y_mm", "dir"],
        )?;
        let mut warnings = Vec::new();
        repeats::measured_once(&mut table, &["length_mm"], &mut warnings);
        let (mut paths, mut points) = (Vec::<(String, Path)>::new(), Vec::new());
        let shifts = table.optional_column("cup_y_mm")?;
        warnings.extend(units::angles("b_deg", &table.column("b_deg")?));
        let dir = table.optional_column("dir")?;
        if let Some(dir) = &dir {
            table.check_directions("dir", dir, &mut warnings)?;
        }
        let has = |name: &str| (0..table.rows()).any(|row| table.text(row, "path") == name);
        if let Some((name, _)) = options.paths.iter().find(|(name, _)| !has(name)) {
            let reason =
                format!("names path '{name}', which no row of {} has", table.path().display());
            return Err(Error::option(
                "--path",
                reason,
                "give a name that stands in its column 'path'",
            ));
        }
        for row in 0..table.rows() {
            let name = table.text(row, "path");
            let key = match &shifts {
                Some(y) => format!("{name} {}", y[row]),
                None => name.to_owned(),
            };
            let index = match paths.iter().position(|(n, _)| *n == key) {
                Some(index) => index,
                None => {
                    paths.push((key, path_of(&table, row, shifts.as_deref(), options)?));
                    paths.len() - 1
                }
            };
            let path = paths[index].1;
            let b_deg = table.number(row, "b_deg")?;
            let implied = path.pose(&options.setup, b_deg.to_radians());
            let column = |name: &str, implied: Option<f64>| -> Result<f64> {
                if table.has(name) && !table.text(row, name).is_empty() {
                    return table.number(row, name);
                }
                implied.ok_or_else(|| {
                    table.error(
                        row,
                        "b_deg",
                        format!("the bar does not reach at {b_deg}°"),
                        "check --bar-mm, --pivot-mm, --below-mm and the path",
                    )
                })
            };
            let pose = Pose {
                b_rad: b_deg.to_radians(),
                x_mm: column("x_mm", implied.map(|p| p.x_mm))?,
                // Files have the source's Z, down; the other sense is tried below.
                up_mm: -column("z_mm", implied.map(|p| -p.up_mm))?,
            };
            let dir = dir.as_ref().map_or(0.0, |dir| dir[row]);
            points.push(Point { pose, path: index, cup_y_mm: path.cup_y_mm, dir });
        }
        let lengths_mm = table.column("length_mm")?;
        let largest = with_sense(&mut points, &lengths_mm, options, table.has("z_mm"))?;
        if largest > 5.0 {
            return Err(Error::file(
                table.path(),
                format!("lengths differ by up to {largest:.3} mm from the set-up's"),
                "length_mm is the whole length of the bar; check --bar-mm, --pivot-mm, --below-mm and the path names",
            ));
        }
        Ok(Self { points, lengths_mm, paths, warnings })
    }
}

/// The path that a row's name stands for.
fn path_of(table: &Table, row: usize, cup_y_mm: Option<&[f64]>, options: &Options) -> Result<Path> {
    let name = table.text(row, "path");
    let given = options.paths.iter().find(|(n, _)| n == name).map(|p| p.1);
    let mut path = match (given, name, cup_y_mm) {
        (Some(path), ..) => path,
        (None, "", _) => Path::SOURCE,
        // A name of one's own does where the columns say all that a path does.
        (None, _, Some(_)) if table.has("x_mm") && table.has("z_mm") => {
            Path::parse(name).unwrap_or(Path::SOURCE)
        }
        (None, ..) => {
            Path::parse(name).map_err(|e| e.in_file(table.path(), Some(table.line(row))))?
        }
    };
    if let Some(y) = cup_y_mm {
        path.cup_y_mm = y[row];
    }
    Ok(path)
}

/// Turns the points' Z round where the lengths say that the file counts it the other way. Tells how far the lengths are from the set-up's.
fn with_sense(
    points: &mut Vec<Point>,
    lengths_mm: &[f64],
    options: &Options,
    may_be_up: bool,
) -> Result<f64> {
    let bar = Bar::new(&options.setup)?;
    let gap = |points: &[Point]| -> Result<f64> {
        let nominal = bar.known(points, &[0.0; 6])?;
        Ok(nominal.iter().zip(lengths_mm).map(|(n, l)| (n - l).abs()).fold(0.0, f64::max))
    };
    let down = gap(points)?;
    if may_be_up {
        let mut turned = points.clone();
        turned.iter_mut().for_each(|p| p.pose.up_mm = -p.pose.up_mm);
        let up = gap(&turned)?;
        if up < down {
            *points = turned;
            return Ok(up);
        }
    }
    Ok(down)
}
