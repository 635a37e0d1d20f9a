//! How far a lens' polynomial is believed: beyond the frame it may turn back, and a circle that is seen in part runs out there.

use crate::camera::Lens;

/// The radius in the undistorted image up to which the polynomial holds; farther out it goes on straight.
#[derive(Debug, Clone, Copy)]
pub(super) struct Horizon {
    /// Where, as a tangent of the angle from the axis.
    pub radius: f64,
    /// The distorted radius there.
    at: f64,
    /// How it grows there.
    slope: f64,
}

/// A polynomial that grows by less than this part is about to turn back.
const LEAST_SLOPE: f64 = 0.3;
/// Part of the frame's half diagonal by which its corners are exceeded: edges are looked for a little outside.
const MARGIN: f64 = 1.05;
/// Steps from the axis to the frame's corner.
const STEPS: f64 = 200.0;

impl Horizon {
    /// Of a lens; `None` where its polynomial never turns back.
    pub fn of(lens: &Lens) -> Option<Self> {
        let [k1, k2, _, _, k3] = lens.distortion;
        let at = |r: f64| r * (1.0 + r * r * (k1 + r * r * (k2 + r * r * k3)));
        let slope = |r: f64| 1.0 + r * r * (3.0 * k1 + r * r * (5.0 * k2 + r * r * 7.0 * k3));
        let corner = [0.0, f64::from(lens.width_px)]
            .into_iter()
            .flat_map(|u| [0.0, f64::from(lens.height_px)].map(|v| (u, v)))
            .map(|(u, v)| {
                ((u - lens.cx_px) / lens.fx_px).hypot((v - lens.cy_px) / lens.fy_px) * MARGIN
            })
            .fold(0.0, f64::max);
        if [k1, k2, k3] == [0.0; 3] || corner <= 0.0 {
            return None;
        }
        // Steps fine beside the frame, then growing, up to where no camera looks.
        let step = corner / STEPS;
        let next = |r: &f64| Some(r + step.max(r / STEPS));
        let radii = std::iter::successors(Some(step), next).take_while(|r| *r < 10.0);
        let mut last = None;
        for radius in radii {
            let grows = slope(radius);
            // What the frame shows is the lens' own, however it bends.
            let is_seen = last.is_none_or(|h: Self| h.at < corner);
            if grows <= 0.0 || (grows < LEAST_SLOPE && !is_seen) {
                return last;
            }
            last = Some(Self { radius, at: at(radius), slope: grows });
        }
        None
    }

    /// Distorted over undistorted radius beyond it.
    pub fn gain(&self, radius: f64) -> f64 {
        (self.at + self.slope * (radius - self.radius)) / radius
    }

    /// Its derivative by the radius.
    pub fn bend(&self, radius: f64) -> f64 {
        (self.slope - self.gain(radius)) / radius
    }
}
