//! The mapping between pixels of one frame and millimetres in the measuring plane, both ways.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::horizon::Horizon;
use super::plane_uncertainty::PlaneUncertainty;
use crate::camera::{Lens, Mapping};

/// Pixel ↔ plane for frames of one size. Pixels: centre of the top-left pixel is (0, 0), v down.
#[derive(Debug, Clone)]
pub struct View {
    lens: Lens,
    horizon: Option<Horizon>,
    to_plane: Matrix3<f64>,
    to_image: Matrix3<f64>,
    uncertainty: PlaneUncertainty,
}

impl View {
    pub(super) fn new(mapping: &Mapping, width_px: usize, height_px: usize) -> Self {
        let (lens, to_plane, uncertainty) = match mapping {
            Mapping::Pinhole { lens, homography_mm, covariance, .. } => {
                let of = |c| PlaneUncertainty::of(c, lens, homography_mm);
                let uncertainty = covariance.as_deref().and_then(of);
                (lens.clone(), *homography_mm, uncertainty.unwrap_or_default())
            }
            &Mapping::Scale { mm_per_px, rotation_deg } => {
                let lens = Lens {
                    width_px: width_px as u32,
                    height_px: height_px as u32,
                    fx_px: 1.0,
                    fy_px: 1.0,
                    cx_px: (width_px as f64 - 1.0) / 2.0,
                    cy_px: (height_px as f64 - 1.0) / 2.0,
                    distortion: [0.0; 5],
                };
                let (s, c) = rotation_deg.to_radians().sin_cos();
                let m = mm_per_px;
                // Plane = R(rotation) · diag(m, -m) · (u, v).
                let h = Matrix3::new(m * c, m * s, 0.0, m * s, -m * c, 0.0, 0.0, 0.0, 1.0);
                (lens, h, PlaneUncertainty::default())
            }
        };
        // The calibration file's check has shown that the inverse exists.
        let to_image = to_plane.try_inverse().unwrap_or_else(Matrix3::identity);
        Self { horizon: Horizon::of(&lens), lens, to_plane, to_image, uncertainty }
    }

    /// Frame width.
    pub fn width_px(&self) -> usize {
        self.lens.width_px as usize
    }

    /// Frame height.
    pub fn height_px(&self) -> usize {
        self.lens.height_px as usize
    }

    /// Where the camera axis (the plane's origin) is seen, in pixels.
    pub fn axis_px(&self) -> Vector2<f64> {
        self.to_pixel(Vector2::zeros())
    }

    /// Pixel → plane mm.
    pub fn to_plane(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        project(&self.to_plane, self.undistort(pixel))
    }

    /// Plane mm → pixel.
    pub fn to_pixel(&self, plane_mm: Vector2<f64>) -> Vector2<f64> {
        self.distort(project(&self.to_image, plane_mm)).0
    }

    /// d(plane mm) / d(pixel) at a pixel.
    pub fn mm_per_px(&self, pixel: Vector2<f64>) -> Matrix2<f64> {
        let ideal = self.undistort(pixel);
        let (_, lens) = self.distort(ideal);
        let plane = projection_jacobian(&self.to_plane, ideal);
        lens.try_inverse().map_or_else(Matrix2::zeros, |inverse| plane * inverse)
    }

    /// d(pixel) / d(plane mm) at a point of the plane.
    pub fn px_per_mm(&self, plane_mm: Vector2<f64>) -> Matrix2<f64> {
        let (_, lens) = self.distort(project(&self.to_image, plane_mm));
        lens * projection_jacobian(&self.to_image, plane_mm)
    }

    /// How far a point of the plane is seen away from its place when k1, k2, p1, p2 differ by `lens` from the
    /// calibration's, to first order in the lens' own distortion.
    pub fn lens_shift_mm(&self, plane_mm: Vector2<f64>, lens: [f64; 4]) -> Vector2<f64> {
        let p = project(&self.to_image, plane_mm);
        let [k1, k2, p1, p2] = lens;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = r2 * (k1 + r2 * k2);
        let shift = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        project(&self.to_plane, p + shift) - plane_mm
    }

    /// How far each of the independent errors of plane and lens, each as large as one standard deviation, moves a place in the plane.
    pub fn plane_errors_mm(&self, plane_mm: Vector2<f64>) -> impl Iterator<Item = Vector2<f64>> {
        let ideal = project(&self.to_image, plane_mm);
        let w = (self.to_plane * Vector3::new(ideal.x, ideal.y, 1.0)).z;
        self.uncertainty.moves_mm(ideal, w, plane_mm, move || self.distort(ideal).0)
    }

    /// From the lens to the plane along its axis, mm: the size in the plane of an angle seen through a lens whose focal length is known.
    pub fn distance_mm(&self) -> f64 {
        projection_jacobian(&self.to_plane, Vector2::zeros()).determinant().abs().sqrt()
    }

    /// Mean size of a pixel in the plane, at the frame's middle.
    pub fn pixel_mm(&self) -> f64 {
        self.pixel_mm_at(self.middle_px())
    }

    /// Whether the plane is seen as in a mirror; one that is not has v down where Y is up.
    pub fn is_mirror_image(&self) -> bool {
        self.mm_per_px(self.middle_px()).determinant() > 0.0
    }

    fn middle_px(&self) -> Vector2<f64> {
        Vector2::new(self.lens.width_px as f64 - 1.0, self.lens.height_px as f64 - 1.0) / 2.0
    }

    /// Mean size of a pixel in the plane, at a place in the picture.
    pub fn pixel_mm_at(&self, pixel: Vector2<f64>) -> f64 {
        self.mm_per_px(pixel).determinant().abs().sqrt()
    }

    /// Pixel → distortion-free normalised image, by Newton's method.
    fn undistort(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let l = &self.lens;
        let seen = Vector2::new((pixel.x - l.cx_px) / l.fx_px, (pixel.y - l.cy_px) / l.fy_px);
        if l.distortion == [0.0; 5] {
            return seen;
        }
        let mut ideal = seen;
        for _ in 0..20 {
            let (at, jacobian) = self.distort(ideal);
            let Some(inverse) = jacobian.try_inverse() else { break };
            let step = inverse * (pixel - at);
            ideal += step;
            if step.norm() < 1e-14 {
                break;
            }
        }
        ideal
    }

    /// Normalised image → pixel, with the derivative. Brown-Conrady, as in OpenCV's documentation; straight on beyond the horizon.
    fn distort(&self, p: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let l = &self.lens;
        if let Some(horizon) = self.horizon.filter(|h| p.norm_squared() > h.radius * h.radius) {
            let radius = p.norm();
            let gain = horizon.gain(radius);
            let bend = horizon.bend(radius) / radius;
            // The tangential terms stay as they are at the horizon.
            let edge = self.brown(p * (horizon.radius / radius)).0;
            let ring = p * horizon.gain(horizon.radius) * (horizon.radius / radius);
            let plain = Vector2::new(l.fx_px * ring.x + l.cx_px, l.fy_px * ring.y + l.cy_px);
            let at = Vector2::new(l.fx_px * gain * p.x, l.fy_px * gain * p.y);
            let focal = Matrix2::new(l.fx_px, 0.0, 0.0, l.fy_px);
            let slope = Matrix2::identity() * gain + p * p.transpose() * bend;
            let center = Vector2::new(l.cx_px, l.cy_px);
            return (at + center + edge - plain, focal * slope);
        }
        self.brown(p)
    }

    fn brown(&self, p: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let l = &self.lens;
        let [k1, k2, p1, p2, k3] = l.distortion;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // d(radial)/d(r²)·2
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            l.fx_px * (radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x),
            l.fx_px * cross,
            l.fy_px * cross,
            l.fy_px * (radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x),
        );
        (Vector2::new(l.fx_px * xd + l.cx_px, l.fy_px * yd + l.cy_px), jacobian)
    }
}

fn project(h: &Matrix3<f64>, p: Vector2<f64>) -> Vector2<f64> {
    let q = h * Vector3::new(p.x, p.y, 1.0);
    Vector2::new(q.x / q.z, q.y / q.z)
}

fn projection_jacobian(h: &Matrix3<f64>, p: Vector2<f64>) -> Matrix2<f64> {
    let q = h * Vector3::new(p.x, p.y, 1.0);
    let (x, y) = (q.x / q.z, q.y / q.z);
    Matrix2::new(
        (h[(0, 0)] - x * h[(2, 0)]) / q.z,
        (h[(0, 1)] - x * h[(2, 1)]) / q.z,
        (h[(1, 0)] - y * h[(2, 0)]) / q.z,
        (h[(1, 1)] - y * h[(2, 1)]) / q.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let lens = Lens {
            width_px: 1600,
            height_px: 1200,
            fx_px: 3500.0,
            fy_px: 3510.0,
            cx_px: 790.0,
            cy_px: 610.0,
            distortion: [-0.12, 0.3, 1e-3, -8e-4, 0.2],
        };
        let homography_mm = Matrix3::new(30.0, 0.5, 0.1, 0.4, -30.0, -0.2, 0.01, 0.02, 1.0);
        View::new(
            &Mapping::Pinhole { lens, homography_mm, covariance: None, mirrored: false },
            1600,
            1200,
        )
    }

    #[test]
    fn pixel_to_plane_and_back_is_exact() {
        let view = view();
        for (u, v) in [(0.0, 0.0), (1599.0, 0.0), (800.3, 600.1), (0.0, 1199.0), (1599.0, 1199.0)] {
            let pixel = Vector2::new(u, v);
            assert!((view.to_pixel(view.to_plane(pixel)) - pixel).norm() < 1e-9);
        }
    }

    #[test]
    fn a_lens_that_turns_back_outside_the_frame_goes_on_straight_there() {
        let mut view = view();
        view.lens.distortion = [-0.3, 0.0, 1e-3, -5e-4, 0.0];
        view.horizon = Horizon::of(&view.lens);
        let seen: Vec<f64> =
            (1..400).map(|i| view.distort(Vector2::new(0.0, 0.01 * f64::from(i))).0.y).collect();
        assert!(seen.windows(2).all(|w| w[1] > w[0] + 0.1), "it turns back");
        let horizon = view.horizon.expect("the polynomial turns back").radius;
        for r in [0.999 * horizon, 1.001 * horizon, 3.0 * horizon] {
            let p = Vector2::new(0.6, -0.8) * r;
            let (at, jacobian) = view.distort(p);
            let step = 1e-6 * r;
            for i in 0..2 {
                let mut q = p;
                q[i] += step;
                let slope = (view.distort(q).0 - at) / step;
                assert!((slope - jacobian.column(i)).norm() < 0.02 * view.lens.fx_px, "{r}");
            }
        }
    }

    #[test]
    fn jacobians_match_differences() {
        let view = view();
        let pixel = Vector2::new(300.0, 900.0);
        let h = 1e-3;
        let j = view.mm_per_px(pixel);
        for (c, e) in [Vector2::new(h, 0.0), Vector2::new(0.0, h)].into_iter().enumerate() {
            let difference = (view.to_plane(pixel + e) - view.to_plane(pixel - e)) / (2.0 * h);
            assert!((difference - j.column(c)).norm() < 1e-9);
        }
        let back = view.px_per_mm(view.to_plane(pixel));
        assert!((back * j - Matrix2::identity()).norm() < 1e-9);
    }

    #[test]
    fn a_plain_scale_has_v_down_as_minus_y_and_turns_counter_clockwise() {
        let view = View::new(&Mapping::Scale { mm_per_px: 0.01, rotation_deg: 90.0 }, 101, 101);
        assert!((view.to_plane(Vector2::new(150.0, 50.0)) - Vector2::new(0.0, 1.0)).norm() < 1e-12);
        let view = View::new(&Mapping::Scale { mm_per_px: 0.01, rotation_deg: 0.0 }, 101, 101);
        assert!(
            (view.to_plane(Vector2::new(50.0, 150.0)) - Vector2::new(0.0, -1.0)).norm() < 1e-12
        );
    }
}
