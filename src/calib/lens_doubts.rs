//! What the pictures of a target leave open of a lens.

use nalgebra::Vector2;

use crate::calib::lens::{Parameter, Seen, ViewReport};
use crate::camera::Lens;
use crate::cv::Distortion;

/// Where a lens misses its points by more, px, something is wrong with the pictures.
const LARGE_RMS_PX: f64 = 0.4;

/// What the pictures do not determine, and which pictures would.
pub(super) fn doubts(
    views: &[ViewReport],
    parameters: &[Parameter],
    seen: &[Seen],
    (rms_px, coverage): (f64, f64),
    lens: &Lens,
    distortion: Distortion,
) -> Vec<String> {
    let mut warnings: Vec<String> = views
        .iter()
        .filter_map(|v| Some(format!("{}: left out: {}", v.image, v.rejected.as_ref()?)))
        .collect();
    let used = views.iter().filter(|v| v.used).count();
    if used < 8 {
        warnings.push(format!("only {used} views: take ten or more"));
    }
    if rms_px > LARGE_RMS_PX {
        warnings.push(format!(
            "the points miss by {rms_px:.2} px rms, where 0.1 px is usual: all pictures must be sharp and of one camera that nobody refocused or zoomed between them, and the target flat"
        ));
    }
    let tilts = || views.iter().filter_map(|v| v.tilt_deg);
    let steepest = tilts().fold(0.0, f64::max);
    if steepest < 12.0 {
        warnings.push(format!(
            "no view is tilted by more than {steepest:.0}°: the focal length and the principal point are not determined; tilt the target by 20° to 40° in different directions"
        ));
    }
    let camera = lens.normalised();
    let corners = [
        Vector2::new(0.0, 0.0),
        Vector2::new(f64::from(lens.width_px) - 1.0, 0.0),
        Vector2::new(0.0, f64::from(lens.height_px) - 1.0),
        Vector2::new(f64::from(lens.width_px) - 1.0, f64::from(lens.height_px) - 1.0),
    ];
    let radius = |p: Vector2<f64>| camera.to_plane(p).norm();
    let reached = seen.iter().map(|s| radius(s.pixel)).fold(0.0, f64::max);
    // In the picture itself: where the fitted polynomial turns, radii beyond it in the plane mean nothing.
    let principal = Vector2::new(lens.cx_px, lens.cy_px);
    let far_px = corners.iter().map(|c| (c - principal).norm()).fold(0.0, f64::max);
    let reached_px = seen.iter().map(|s| (s.pixel - principal).norm()).fold(0.0, f64::max);
    if coverage < 0.7 || reached_px < 0.8 * far_px {
        warnings.push(format!(
            "the target was seen in {:.0} % of the frame and out to {:.0} % of its corners: beyond, the distortion is extrapolated; move the target into the corners",
            100.0 * coverage,
            100.0 * reached_px / far_px
        ));
    }
    for p in parameters {
        let Some(u95) = p.u95 else { continue };
        // What the uncertainty amounts to where it matters most.
        let (limit, effect_px) = match p.name {
            "fx_px" | "fy_px" => (0.005 * p.value, u95),
            "cx_px" => (0.01 * f64::from(lens.width_px), u95),
            "cy_px" => (0.01 * f64::from(lens.height_px), u95),
            name => {
                let power = match name {
                    "k1" => 3,
                    "k2" => 5,
                    "k3" => 7,
                    _ => 2,
                };
                // As far out as the points reach: beyond that the warning above holds.
                (2.0, u95 * reached.powi(power) * lens.fx_px)
            }
        };
        if effect_px > limit {
            warnings.push(format!(
                "{} is hardly determined: {:.4} ± {:.4}; tilt the target more and fill the frame{}",
                p.name,
                p.value,
                u95,
                if p.name == "k3" && distortion == Distortion::Full {
                    ", or hold it at zero with --distortion decentred"
                } else {
                    ""
                }
            ));
        }
    }
    warnings
}
