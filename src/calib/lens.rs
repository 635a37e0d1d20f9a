//! The lens from pictures of a target: which views count, how well they agree, and what they leave undetermined.

use std::path::PathBuf;

use nalgebra::{SMatrix, Vector2};
use rayon::prelude::*;
use serde::Serialize;

use crate::calib::board_view::fitted;
use crate::calib::bundle::{Bundle, adjusted};
use crate::calib::lens_doubts::doubts;
use crate::calib::target::Target;
use crate::camera::LensFile;
use crate::cv::{self, BoardView, Distortion};
use crate::error::{Error, Result};
use crate::fit::robust::median;
use crate::frame::{Channel, Gray, Picture};
use crate::repeats;
use crate::uncertainty::K95;

/// Fewest views that determine a lens; Zhang's method needs three.
const LEAST_VIEWS: usize = 3;
/// Fewest points of a view that is used.
const LEAST_POINTS: usize = 8;
/// A view whose residuals are this many times the other views' is bad.
const BAD_VIEW: f64 = 3.0;
/// Residuals below this are never bad, px.
const GOOD_PX: f64 = 0.1;
/// A point is bad whose residual is so many times the view's median, and one of so many points at most.
const BAD_POINT: f64 = 6.0;
const MOST_BAD: usize = 10;
/// A lens that misses by more is none, px: the target is another than was said.
const MOST_RMS_PX: f64 = 2.0;
/// A focal length less sure than this part of it is not determined.
const MOST_UNSURE: f64 = 0.3;
/// Cells across and down in which coverage is counted.
pub const CELLS: (usize, usize) = (8, 6);
/// The names of the numbers found, in OpenCV's order.
const NAMES: [&str; 9] = ["fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"];

/// How one picture fared.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct ViewReport {
    /// The picture.
    pub image: String,
    /// Target points found.
    pub points: usize,
    /// Root mean square of the points' distances from where the lens should see them; null where nothing was found.
    pub rms_px: Option<f64>,
    /// The largest of these distances.
    pub worst_px: Option<f64>,
    /// Angle between the target's face and the camera axis' normal plane.
    pub tilt_deg: Option<f64>,
    /// Whether the lens rests on this view.
    pub used: bool,
    /// Why not.
    pub rejected: Option<String>,
}

/// One number of the lens.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Parameter {
    /// As in the calibration file; k1..k3, p1, p2 are its distortion.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Half-width of its 95 % interval; null where it was held at zero.
    pub u95: Option<f64>,
}

/// The lens and what is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Report {
    /// Frame width.
    pub width_px: u32,
    /// Frame height.
    pub height_px: u32,
    /// The numbers found.
    pub parameters: Vec<Parameter>,
    /// Root mean square of all used points' distances.
    pub rms_px: f64,
    /// How far the board's points lie from its grid, as the views show it: standard deviations in its plane and out of it.
    pub board_sd_mm: [f64; 2],
    /// Share of the frame's cells in which points were seen.
    pub coverage: f64,
    /// Every picture.
    pub views: Vec<ViewReport>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// A point as it was seen, for the coverage picture.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Index of the view.
    pub view: usize,
    /// Its place.
    pub pixel: Vector2<f64>,
    /// Seen minus expected.
    pub residual_px: Vector2<f64>,
}

/// The report, the lens and the points.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// The report.
    pub report: Report,
    /// The lens, and how surely it is known.
    pub lens: LensFile,
    /// All points of used views.
    pub seen: Vec<Seen>,
    /// How many pictures could not be read.
    pub unread: usize,
}

/// Calibrates from pictures of the target.
pub fn calibrate(
    images: &[PathBuf],
    target: &Target,
    distortion: Distortion,
) -> Result<Calibrated> {
    type View = ((u32, u32), Option<BoardView>);
    let firsts = repeats::firsts(repeats::contents(images));
    let views: Vec<Result<View>> = images
        .par_iter()
        .zip(&firsts)
        .map(|(path, first)| {
            if first.is_some() {
                return Ok(((0, 0), None));
            }
            let gray = Picture::read(path)?.into_frame(Channel::Auto).to_eight();
            Ok(((gray.width as u32, gray.height as u32), look(&gray, target)?))
        })
        .collect();
    let Some(size) = views.iter().flatten().find(|v| v.1.is_some()).map(|v| v.0) else {
        return Err(nothing(images.len(), target, views));
    };
    let mut found = Vec::new();
    let mut rejected: Vec<Option<String>> = vec![None; images.len()];
    let mut unread = 0;
    for (i, view) in views.into_iter().enumerate() {
        match (view, firsts[i]) {
            (_, Some(first)) => {
                rejected[i] = Some(format!("is the picture {} again", images[first].display()));
            }
            (Err(e), _) => {
                rejected[i] = Some(e.to_string());
                unread += 1;
            }
            (Ok((_, None)), _) => rejected[i] = Some("the target was not found".into()),
            (Ok((own, Some(_))), _) if own != size => {
                rejected[i] = Some(format!(
                    "has {}×{} px where the others have {}×{} px",
                    own.0, own.1, size.0, size.1
                ));
            }
            (Ok((_, Some(v))), _) if v.pixels.len() < LEAST_POINTS => {
                rejected[i] = Some(format!("only {} points were found", v.pixels.len()));
            }
            (Ok((_, Some(v))), _) => found.push((i, v)),
        }
    }
    let names: Vec<String> = images.iter().map(|p| p.display().to_string()).collect();
    let made = from_views(&names, found, rejected, size, distortion)?;
    Ok(Calibrated { unread, ..made })
}

fn look(gray: &Gray<u8>, target: &Target) -> Result<Option<BoardView>> {
    let places = target.points_mm();
    Ok(cv::detect(gray, target)?.map(|d| BoardView {
        board_mm: d.ids.iter().filter_map(|&i| places.get(i)).map(|p| p.push(0.0)).collect(),
        pixels: d.pixels,
        radius_mm: target.dot_radius_mm(),
    }))
}

/// Why no picture is of use: a picture that cannot be read (or a program without OpenCV) says so itself.
fn nothing<V>(count: usize, target: &Target, views: Vec<Result<V>>) -> Error {
    views.into_iter().find_map(Result::err).unwrap_or_else(|| {
        Error::measure(
            format!("{count} pictures"),
            format!("none shows the whole of {target}"),
            "check the target's kind and its columns and rows (squares, not inner corners, for chessboards)",
        )
    })
}

/// As [`calibrate`], from points already found; `found` has the views with their pictures' indices.
pub fn from_views(
    names: &[String],
    mut found: Vec<(usize, BoardView)>,
    mut rejected: Vec<Option<String>>,
    size: (u32, u32),
    distortion: Distortion,
) -> Result<Calibrated> {
    let total = found.len();
    let mut spent = Vec::new();
    let start = loop {
        if found.len() < LEAST_VIEWS {
            return Err(Error::measure(
                format!("{} pictures", names.len()),
                format!("only {} agree on a lens, of {total} that show the target", found.len()),
                "give ten or more pictures by one camera, tilted in different directions, and check the target's columns and rows (squares, not inner corners, for chessboards)",
            ));
        }
        let views: Vec<BoardView> = found.iter().map(|f| f.1.clone()).collect();
        let fit = fitted(&views, size, distortion)?;
        let camera = fit.lens.normalised();
        let residuals: Vec<Vec<Vector2<f64>>> =
            views.iter().zip(&fit.poses).map(|(v, p)| v.residuals(&camera, p)).collect();
        let each: Vec<f64> = residuals.iter().map(|r| rms(r)).collect();
        let mut sorted = each.clone();
        sorted.sort_by(f64::total_cmp);
        let middle = sorted[(sorted.len() - 1) / 2];
        let worst = (0..each.len()).max_by(|&a, &b| each[a].total_cmp(&each[b])).unwrap_or(0);
        if each[worst] < (BAD_VIEW * middle).max(GOOD_PX) || found.len() == LEAST_VIEWS {
            break fit;
        }
        if let Some(better) = without_bad_points(&found[worst].1, &residuals[worst]) {
            found[worst].1 = better;
            continue;
        }
        let (index, view) = found.remove(worst);
        rejected[index] = Some(format!(
            "its points miss by {:.2} px rms, {:.1} times as much as the others'",
            each[worst],
            each[worst] / middle
        ));
        spent.push((index, view.pixels.len(), each[worst]));
    };
    let views: Vec<BoardView> = found.iter().map(|f| f.1.clone()).collect();
    let bundle = adjusted(&views, &start, distortion.free());
    let used: Vec<usize> = found.iter().map(|f| f.0).collect();
    let made = report(names, &used, &rejected, &spent, size, &bundle, distortion);
    if made.report.rms_px > MOST_RMS_PX {
        return Err(Error::measure(
            format!("{} pictures", names.len()),
            format!("the best lens misses the target's points by {:.1} px", made.report.rms_px),
            "check the target's columns and rows, and that all pictures are of one camera and one target",
        ));
    }
    let unsure = |p: &Parameter| p.u95.is_some_and(|u| u.is_nan() || u > MOST_UNSURE * p.value);
    if made.report.parameters[..2].iter().any(unsure) {
        return Err(Error::measure(
            format!("{} pictures", names.len()),
            "they do not determine the focal length",
            "tilt the target by 20° to 40° in different directions",
        ));
    }
    Ok(made)
}

/// A view without the few points that lie far from where the others put them: a detector took something else for them.
fn without_bad_points(view: &BoardView, residuals: &[Vector2<f64>]) -> Option<BoardView> {
    let far = BAD_POINT * median(&mut residuals.iter().map(Vector2::norm).collect::<Vec<_>>());
    let good = |k: &usize| residuals[*k].norm() <= far.max(BAD_POINT * GOOD_PX);
    let kept: Vec<usize> = (0..residuals.len()).filter(good).collect();
    let bad = residuals.len() - kept.len();
    let few = bad > 0 && MOST_BAD * bad <= residuals.len() && kept.len() >= LEAST_POINTS;
    few.then(|| BoardView {
        board_mm: kept.iter().map(|&k| view.board_mm[k]).collect(),
        pixels: kept.iter().map(|&k| view.pixels[k]).collect(),
        ..view.clone()
    })
}

fn rms(residuals: &[Vector2<f64>]) -> f64 {
    let squares: f64 = residuals.iter().map(Vector2::norm_squared).sum();
    (squares / residuals.len().max(1) as f64).sqrt()
}

fn report(
    names: &[String],
    used: &[usize],
    rejected: &[Option<String>],
    spent: &[(usize, usize, f64)],
    size: (u32, u32),
    bundle: &Bundle,
    distortion: Distortion,
) -> Calibrated {
    let mut views: Vec<ViewReport> = names
        .iter()
        .zip(rejected)
        .map(|(image, rejected)| ViewReport {
            image: image.clone(),
            points: 0,
            rms_px: None,
            worst_px: None,
            tilt_deg: None,
            used: false,
            rejected: rejected.clone(),
        })
        .collect();
    for &(i, points, rms_px) in spent {
        (views[i].points, views[i].rms_px) = (points, Some(rms_px));
    }
    let mut seen = Vec::new();
    let camera = bundle.fit.lens.normalised();
    for ((i, view), pose) in used.iter().zip(&bundle.views).zip(&bundle.fit.poses) {
        let residuals = view.residuals(&camera, pose);
        let report = &mut views[*i];
        report.used = true;
        report.points = view.pixels.len();
        report.rms_px = Some(rms(&residuals));
        report.worst_px = Some(residuals.iter().map(Vector2::norm).fold(0.0, f64::max));
        let facing = pose.turn.matrix()[(2, 2)].abs().min(1.0);
        report.tilt_deg = Some(facing.acos().to_degrees());
        seen.extend(view.pixels.iter().zip(residuals).map(|(&pixel, residual_px)| Seen {
            view: *i,
            pixel,
            residual_px,
        }));
    }
    let l = &bundle.fit.lens;
    let values = [l.fx_px, l.fy_px, l.cx_px, l.cy_px].into_iter().chain(l.distortion);
    let parameters: Vec<Parameter> = NAMES
        .into_iter()
        .zip(values)
        .enumerate()
        .map(|(i, (name, value))| {
            let free = distortion.free()[i];
            let known = |c: &SMatrix<f64, 9, 9>| K95 * c[(i, i)].sqrt();
            let u95 = bundle.covariance.as_ref().map_or(f64::INFINITY, known);
            Parameter { name, value, u95: free.then_some(u95) }
        })
        .collect();
    let all: Vec<Vector2<f64>> = seen.iter().map(|s| s.residual_px).collect();
    let (rms_px, coverage) = (rms(&all), coverage(&seen, size));
    let warnings = doubts(&views, &parameters, &seen, (rms_px, coverage), l, distortion);
    Calibrated {
        report: Report {
            width_px: size.0,
            height_px: size.1,
            parameters,
            rms_px,
            board_sd_mm: bundle.board_sd_mm,
            coverage,
            views,
            warnings,
        },
        lens: LensFile { lens: l.clone(), covariance: bundle.covariance, gamma: 1.0 },
        seen,
        unread: 0,
    }
}

fn coverage(seen: &[Seen], size: (u32, u32)) -> f64 {
    let mut cells = vec![false; CELLS.0 * CELLS.1];
    for s in seen {
        let share = |p: f64, side: u32, n: usize| {
            ((p + 0.5) / f64::from(side) * n as f64).clamp(0.0, n as f64 - 1.0) as usize
        };
        cells[share(s.pixel.y, size.1, CELLS.1) * CELLS.0 + share(s.pixel.x, size.0, CELLS.0)] =
            true;
    }
    cells.iter().filter(|c| **c).count() as f64 / cells.len() as f64
}
