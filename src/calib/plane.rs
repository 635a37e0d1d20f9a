//! Pixel → machine mm with the machine as the ruler: one mark, photographed from known machine positions.
//!
//! A mark at the machine place M is seen, with the machine at P, at the plane offset `M - P` from the camera axis. With
//! `p` its undistorted normalised image, `H·p = M - P`. The camera axis is where the lens' principal point looks, so
//! `H` maps 0 to 0: six numbers (scale, turn, tilt about two axes, aspect and shear) and M's two, found by least
//! squares from five positions or more.

mod known;
mod report;

pub use report::{CaptureReport, Orientation, Report};

use nalgebra::{SMatrix, SVector, Vector2};

use crate::calib::homography::{solve, undetermined};
use crate::calib::mark::{self, Sightings};
use crate::calib::plane::known::{Known, field_u95_mm};
use crate::calib::plane::report::report;
use crate::calib::unseen_lens::ideal;
use crate::camera::{
    Calibration, LENS_NUMBERS, Lens, LensCovariance, LensFile, Mapping, PlaneCovariance, light,
};
use crate::error::{Error, Result};
use crate::frame::{Channel, Frame, Picture};
use crate::measure::rod::Capture;
use crate::units;

/// Fewest positions: four would determine the mapping, one more checks it.
pub const LEAST_POSITIONS: usize = 5;
/// A picture whose removal shrinks the residuals by this factor shows something else than the mark.
const ODD_ONE_OUT: f64 = 5.0;
/// How often the mark is registered in the shape that the mapping so far gives it.
const SHAPINGS: usize = 2;

/// Of the way to the frame's corner, what may be unsure there. Positions along a line leave all of it unsure.
const MOST_UNSURE: f64 = 0.1;

/// The report and the calibration that it describes.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// The report.
    pub report: Report,
    /// Lens and plane.
    pub calibration: Calibration,
}

/// Calibrates from the captures' pictures. Without a `lens` the camera is taken as free of distortion and its counts as light.
pub fn calibrate(captures: &[Capture], lens: Option<&LensFile>) -> Result<Calibrated> {
    enough(captures)?;
    let gamma = lens.map_or(1.0, |l| l.gamma);
    let frames = captures
        .iter()
        .map(|c| Ok(light(Picture::read(&c.path)?.into_frame(Channel::Auto), gamma)))
        .collect::<Result<Vec<Frame>>>()?;
    let (w, h) = (frames[0].width(), frames[0].height());
    let known = lens.map_or((w, h), |l| (l.lens.width_px as usize, l.lens.height_px as usize));
    if let Some((c, f)) =
        captures.iter().zip(&frames).find(|(_, f)| (f.width(), f.height()) != known)
    {
        return Err(Error::file(
            &c.path,
            format!(
                "has {}×{} px where {} has {}×{} px",
                f.width(),
                f.height(),
                if lens.is_some() { "the lens" } else { "the first picture" },
                known.0,
                known.1
            ),
            "use pictures of one camera at one resolution, and its own lens file",
        ));
    }
    let positions: Vec<Vector2<f64>> = captures.iter().map(|c| c.position_mm).collect();
    let from = |sightings: &Sightings| from_sightings(captures, sightings, lens, (w, h));
    let mut made = match mark::find(&frames, &positions) {
        Some((mark, rough)) => {
            // Large marks are shaped so much by distortion that their first places tell the mapping only roughly.
            let mut places = rough;
            for _ in 0..SHAPINGS {
                let view = from(&places)?.calibration.view(w, h)?;
                places = mark.again(&frames, &places, &view);
            }
            from(&places)?
        }
        None => from(&vec![None; frames.len()])?,
    };
    made.calibration.gamma = gamma;
    Ok(made)
}

fn enough(captures: &[Capture]) -> Result<()> {
    let mut places: Vec<Vector2<f64>> = Vec::new();
    for c in captures {
        if places.iter().all(|p| (p - c.position_mm).norm() > 1e-6) {
            places.push(c.position_mm);
        }
    }
    if places.len() < LEAST_POSITIONS {
        return Err(Error::measure(
            "captures",
            format!("only {} different machine positions", places.len()),
            format!(
                "photograph the mark from at least {LEAST_POSITIONS}, spread over the frame in X and Y"
            ),
        ));
    }
    Ok(())
}

/// As [`calibrate`], from the mark's places in frames of this size, px.
pub fn from_sightings(
    captures: &[Capture],
    sightings: &[Option<Vector2<f64>>],
    lens: Option<&LensFile>,
    (width, height): (usize, usize),
) -> Result<Calibrated> {
    let known_lens = lens.is_some();
    let covariance = lens.and_then(|l| l.covariance.as_ref());
    let lens = &lens.map_or_else(|| ideal(width, height), |l| l.lens.clone());
    let normal = lens.normalised();
    let mut used: Vec<usize> = (0..captures.len()).filter(|&i| sightings[i].is_some()).collect();
    let mut warnings = Vec::new();
    for i in (0..captures.len()).filter(|i| !used.contains(i)) {
        warnings.push(format!("{}: left out, the mark is not where the other captures say (position mistyped, or not in the picture?)", captures[i].image));
    }
    let place = |i: usize| {
        let pixel = sightings[i].unwrap_or_default();
        (normal.to_plane(pixel), captures[i].position_mm)
    };
    let mut fit = solve(&used, &place)?;
    let variance = |rest: &[usize]| solve(rest, &place).ok().map(|fit| fit.variance);
    while let Some(odd) = odd_one_out(&used, variance) {
        warnings.push(format!(
            "{}: left out, it does not fit the others (position mistyped, or not the mark?)",
            captures[odd].image
        ));
        used.retain(|&i| i != odd);
        fit = solve(&used, &place)?;
    }
    let by_lens = covariance.map(|c| Ok((*c, slopes(&used, captures, sightings, lens, c)?)));
    let by_lens = by_lens.transpose()?;
    let known = Known::new(&fit, lens, by_lens.as_ref());
    let mut report = report(captures, sightings, &used, &known, known_lens, warnings);
    report.warnings.extend(units::pixel("a pixel, by the machine's positions,", report.mm_per_px));
    let reach_mm =
        report.mm_per_px * 0.5 * f64::from(lens.width_px).hypot(f64::from(lens.height_px));
    if report.field_u95_mm > MOST_UNSURE * reach_mm {
        return Err(undetermined());
    }
    // What an unknown lens does to the corners is no homography: one as unsure there stands for it.
    let widened = match known_lens {
        true => 1.0,
        false => report.field_u95_mm / field_u95_mm(&known).max(f64::MIN_POSITIVE),
    };
    let homography = fit.homography_covariance() * (widened * widened);
    let mapping = Mapping::Pinhole {
        lens: lens.clone(),
        homography_mm: fit.homography(),
        covariance: Some(Box::new(PlaneCovariance { homography, lens: by_lens })),
        mirrored: report.orientation == Orientation::Mirrored,
    };
    Ok(Calibrated {
        calibration: Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 },
        report,
    })
}

/// How the homography's six numbers change with the lens' numbers, as far as those are unsure.
fn slopes(
    used: &[usize],
    captures: &[Capture],
    sightings: &[Option<Vector2<f64>>],
    lens: &Lens,
    covariance: &LensCovariance,
) -> Result<SMatrix<f64, 6, LENS_NUMBERS>> {
    let mut slopes = SMatrix::<f64, 6, LENS_NUMBERS>::zeros();
    for i in 0..LENS_NUMBERS {
        let step = 0.1 * covariance[(i, i)].max(0.0).sqrt();
        if step == 0.0 {
            continue;
        }
        let through = |by: f64| {
            let mut numbers = SVector::zeros();
            numbers[i] = by;
            let view = lens.plus(&numbers).normalised();
            let place = |k: usize| {
                (view.to_plane(sightings[k].unwrap_or_default()), captures[k].position_mm)
            };
            solve(used, &place).map(|fit| fit.p)
        };
        let change = (through(step)? - through(-step)?) / (2.0 * step);
        slopes.set_column(i, &change.fixed_rows::<6>(0));
    }
    Ok(slopes)
}

/// The one without which the others fit far better, where there are enough of them to tell.
pub fn odd_one_out(used: &[usize], variance: impl Fn(&[usize]) -> Option<f64>) -> Option<usize> {
    if used.len() <= LEAST_POSITIONS + 1 {
        return None;
    }
    let all = variance(used)?;
    let without = |&i: &usize| {
        let rest: Vec<usize> = used.iter().copied().filter(|&j| j != i).collect();
        Some((i, variance(&rest)?))
    };
    let best = used.iter().filter_map(without).min_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|(_, better)| *better < all / ODD_ONE_OUT.powi(2)).map(|(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::circle::{Circle, robust};
    use crate::measure::plane_errors::PlaneErrors;
    use crate::uncertainty::K95;
    use nalgebra::Matrix3;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A tilted camera calibrated by a machine that scatters by 1 µm, over and over: how often a circle's centre and radius, its edge seen
    /// without error, lie within what the plane's uncertainty says of them.
    #[test]
    fn circles_seen_through_a_scattering_calibration_lie_within_its_uncertainty() {
        const CASES: usize = 400;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let lens = Lens {
            distortion: [-0.05, 0.1, 0.0, 0.0, 0.0],
            fx_px: 3500.0,
            fy_px: 3500.0,
            ..ideal(1600, 1200)
        };
        let homography_mm = Matrix3::new(28.0, 0.6, 0.0, 0.5, -28.0, 0.0, 0.02, -0.03, 1.0);
        let mapping = Mapping::Pinhole {
            lens: lens.clone(),
            homography_mm,
            covariance: None,
            mirrored: false,
        };
        let truth = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
        let truth = truth.view(1600, 1200).unwrap();
        let exact = LensFile { lens, covariance: None, gamma: 1.0 };
        let angles = || (0..90).map(|i| f64::from(i).to_radians() * 4.0);
        let circle = Circle { center: Vector2::new(1.5, -0.8), radius: 2.0 };
        for side in [3, 4] {
            let mut inside = [0; 3];
            for _ in 0..CASES {
                let mut captures = Vec::new();
                let mut sightings = Vec::new();
                for i in 0..side * side {
                    let grid = Vector2::new(f64::from(i % side), f64::from(i / side))
                        / f64::from(side - 1)
                        - Vector2::repeat(0.5);
                    let at = grid.component_mul(&Vector2::new(9.0, 6.5));
                    let scatter = Vector2::from_fn(|_, _| {
                        let n: f64 = StandardNormal.sample(&mut rng);
                        1e-3 * n
                    });
                    captures.push(Capture::in_memory("", scatter - at, 0.0));
                    sightings.push(Some(truth.to_pixel(at)));
                }
                let made = from_sightings(&captures, &sightings, Some(&exact), (1600, 1200));
                let made = made.unwrap().calibration;
                let view = made.view(1600, 1200).unwrap();
                let rim = |a: f64| circle.center + Vector2::new(a.cos(), a.sin()) * circle.radius;
                let seen: Vec<_> =
                    angles().map(|a| view.to_plane(truth.to_pixel(rim(a)))).collect();
                let found =
                    robust(&seen, &vec![1.0; seen.len()], Some(circle), 1.0).unwrap().circle;
                let covariance = PlaneErrors::at(&view, found, angles()).covariance(f64::INFINITY);
                let off = [
                    found.center.x - circle.center.x,
                    found.center.y - circle.center.y,
                    found.radius - circle.radius,
                ];
                for i in 0..3 {
                    inside[i] += usize::from(off[i].abs() < K95 * covariance[(i, i)].sqrt());
                }
            }
            let share = inside.map(|n| n as f64 / CASES as f64);
            assert!(share.iter().all(|s| (0.92..0.98).contains(s)), "{side}: {share:?}");
        }
    }
}
