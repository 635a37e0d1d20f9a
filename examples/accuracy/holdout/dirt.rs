//! What lies on the surface or in the light of the second renderer's pictures: dots, scratches, fibres, glare.

use nalgebra::Vector2;

use super::optics::{HEIGHT_PX, WIDTH_PX};

/// A factor and a sum for each pixel.
pub struct Dirt {
    factor: Vec<f32>,
    glare: Vec<f32>,
}

impl Dirt {
    pub fn new() -> Self {
        let pixels = WIDTH_PX * HEIGHT_PX;
        Self { factor: vec![1.0; pixels], glare: vec![0.0; pixels] }
    }

    pub fn put_on(&self, i: usize, light: f64) -> f64 {
        light * f64::from(self.factor[i]) + f64::from(self.glare[i])
    }

    /// A stroke from one pixel to another (a dot where they are the same): `change` is -1 for black, 0.5 for half as bright again.
    pub fn stroke(&mut self, ends_px: [Vector2<f64>; 2], half_width_px: f64, change: f64) {
        let [from, to] = ends_px;
        let along = to - from;
        let soft_px = 0.9;
        let margin = half_width_px + 4.0 * soft_px;
        let low = Vector2::new(from.x.min(to.x), from.y.min(to.y));
        let high = Vector2::new(from.x.max(to.x), from.y.max(to.y));
        each_pixel(low.add_scalar(-margin), high.add_scalar(margin), |i, p| {
            let t = ((p - from).dot(&along) / along.norm_squared().max(1e-9)).clamp(0.0, 1.0);
            let outside = (p - from - along * t).norm() - half_width_px;
            let share = 0.5 - 0.5 * (outside / soft_px).tanh();
            self.factor[i] *= (1.0 + change * share) as f32;
        });
    }

    /// An oblong spot of light, `half_px` long and wide (standard deviations).
    pub fn glare(&mut self, centre_px: Vector2<f64>, half_px: [f64; 2], angle: f64, light: f64) {
        let reach = 4.0 * half_px[0].max(half_px[1]);
        let (s, c) = angle.sin_cos();
        each_pixel(centre_px.add_scalar(-reach), centre_px.add_scalar(reach), |i, p| {
            let d = p - centre_px;
            let (x, y) = ((c * d.x + s * d.y) / half_px[0], (c * d.y - s * d.x) / half_px[1]);
            self.glare[i] += (light * (-0.5 * (x * x + y * y)).exp()) as f32;
        });
    }
}

fn each_pixel(low: Vector2<f64>, high: Vector2<f64>, mut act: impl FnMut(usize, Vector2<f64>)) {
    let within = |x: f64, size: usize| x.clamp(0.0, size as f64) as usize;
    for v in within(low.y, HEIGHT_PX)..within(high.y + 1.0, HEIGHT_PX) {
        for u in within(low.x, WIDTH_PX)..within(high.x + 1.0, WIDTH_PX) {
            act(v * WIDTH_PX + u, Vector2::new(u as f64, v as f64));
        }
    }
}
