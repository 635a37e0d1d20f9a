//! The camera of the second renderer: where a pixel looks, area sampling, light falling off, and the sensor.
//!
//! Written from the calibration file's definition alone; only the finished calibration is handed to the program.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use pivotsight::camera::{Calibration, Lens, Mapping};

use super::dice::{Dice, Level};

pub const WIDTH_PX: usize = 1600;
pub const HEIGHT_PX: usize = 1200;

/// Samples a pixel each way where an edge runs through it.
const FINE: usize = 4;
/// Rounds of the fixed-point inversion of the distortion, which gains about two digits a round.
const INVERSION_ROUNDS: usize = 10;

/// A pinhole with distortion over a tilted plane, or a plain scale.
pub enum Camera {
    Pinhole(Box<Pinhole>),
    Scale { mm_per_px: f64, turn_rad: f64 },
}

/// The lens, and the plane by homographies from and to the undistorted normalised image.
pub struct Pinhole {
    lens: Lens,
    to_plane: Matrix3<f64>,
    from_plane: Matrix3<f64>,
}

impl Camera {
    /// Clean pictures have a plain scale; the others tilt, roll and distortion.
    pub fn draw(level: Level, mm_per_px: f64, dice: &mut Dice) -> Self {
        if level == Level::Clean {
            let turn_rad = if dice.chance(0.5) { 0.0 } else { dice.between((-0.2, 0.2)) };
            return Self::Scale { mm_per_px, turn_rad };
        }
        let f_px = dice.between((2800.0, 5200.0));
        let lens = Lens {
            width_px: WIDTH_PX as u32,
            height_px: HEIGHT_PX as u32,
            fx_px: f_px,
            fy_px: f_px * (1.0 + dice.between((-0.002, 0.002))),
            cx_px: 0.5 * (WIDTH_PX as f64 - 1.0) + dice.between((-25.0, 25.0)),
            cy_px: 0.5 * (HEIGHT_PX as f64 - 1.0) + dice.between((-25.0, 25.0)),
            distortion: [
                dice.between((-0.15, 0.1)),
                dice.between((-0.1, 0.1)),
                dice.between((-6e-4, 6e-4)),
                dice.between((-6e-4, 6e-4)),
                0.0,
            ],
        };
        // Machine X to the right, Y up in the picture, the camera looking down: then small turns.
        let tilt = 1.8_f64.to_radians();
        let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), dice.between((-tilt, tilt)))
            * Rotation3::from_axis_angle(&Vector3::y_axis(), dice.between((-tilt, tilt)))
            * Rotation3::from_axis_angle(&Vector3::z_axis(), dice.between((-0.06, 0.06)));
        let upright = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let mut from_plane = turn.matrix() * upright;
        from_plane.set_column(2, &Vector3::new(0.0, 0.0, f_px * mm_per_px));
        let inverse = from_plane.try_inverse().expect("a camera above the plane sees it");
        let to_plane = inverse / inverse[(2, 2)];
        Self::Pinhole(Box::new(Pinhole { lens, to_plane, from_plane }))
    }

    pub fn calibration(&self) -> Calibration {
        let mapping = match self {
            Self::Pinhole(pinhole) => {
                let Pinhole { lens, to_plane, .. } = pinhole.as_ref();
                Mapping::Pinhole {
                    lens: lens.clone(),
                    homography_mm: *to_plane,
                    covariance: None,
                    mirrored: false,
                }
            }
            Self::Scale { mm_per_px, turn_rad } => {
                Mapping::Scale { mm_per_px: *mm_per_px, rotation_deg: turn_rad.to_degrees() }
            }
        };
        Calibration { name: "holdout".to_owned(), mapping, laser: None, gamma: 1.0 }
    }

    /// Pixel to mm in the plane.
    pub fn to_plane(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Pinhole(pinhole) => {
                let Pinhole { lens, to_plane, .. } = pinhole.as_ref();
                let bent = Vector2::new(
                    (pixel.x - lens.cx_px) / lens.fx_px,
                    (pixel.y - lens.cy_px) / lens.fy_px,
                );
                let mut straight = bent;
                for _ in 0..INVERSION_ROUNDS {
                    let step = bent - distorted(straight, &lens.distortion);
                    straight += step;
                    if step.norm_squared() < 1e-28 {
                        break;
                    }
                }
                projected(to_plane, straight)
            }
            Self::Scale { mm_per_px, turn_rad } => {
                let (s, c) = turn_rad.sin_cos();
                let (right, up) = (pixel.x - MIDDLE_PX[0], MIDDLE_PX[1] - pixel.y);
                Vector2::new(c * right - s * up, s * right + c * up) * *mm_per_px
            }
        }
    }

    /// Mm in the plane to pixel.
    pub fn to_pixel(&self, plane_mm: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Pinhole(pinhole) => {
                let Pinhole { lens, from_plane, .. } = pinhole.as_ref();
                let bent = distorted(projected(from_plane, plane_mm), &lens.distortion);
                Vector2::new(bent.x * lens.fx_px + lens.cx_px, bent.y * lens.fy_px + lens.cy_px)
            }
            Self::Scale { mm_per_px, turn_rad } => {
                let (s, c) = turn_rad.sin_cos();
                let (right, up) =
                    (c * plane_mm.x + s * plane_mm.y, c * plane_mm.y - s * plane_mm.x);
                Vector2::new(MIDDLE_PX[0] + right / mm_per_px, MIDDLE_PX[1] - up / mm_per_px)
            }
        }
    }

    /// Where each pixel's centre looks, row by row.
    pub fn looks_mm(&self) -> Vec<Vector2<f64>> {
        let rows = (0..HEIGHT_PX).flat_map(|v| (0..WIDTH_PX).map(move |u| (u, v)));
        rows.map(|(u, v)| self.to_plane(Vector2::new(u as f64, v as f64))).collect()
    }
}

const MIDDLE_PX: [f64; 2] = [0.5 * (WIDTH_PX as f64 - 1.0), 0.5 * (HEIGHT_PX as f64 - 1.0)];

fn projected(homography: &Matrix3<f64>, p: Vector2<f64>) -> Vector2<f64> {
    let q = homography * Vector3::new(p.x, p.y, 1.0);
    Vector2::new(q.x / q.z, q.y / q.z)
}

fn distorted(p: Vector2<f64>, [k1, k2, p1, p2, k3]: &[f64; 5]) -> Vector2<f64> {
    let (x, y, r2) = (p.x, p.y, p.norm_squared());
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )
}

/// What lies in the plane.
pub trait Scene {
    /// Reflectance without texture, and the shares of two further surfaces in it. Area-sampled.
    fn surface(&self, plane_mm: Vector2<f64>) -> [f64; 3];
    /// Whether an edge may run through a pixel here.
    fn is_edge(&self, plane_mm: Vector2<f64>) -> bool;
    /// Texture on what `surface` gave: a factor.
    fn texture(&self, plane_mm: Vector2<f64>, surface: &[f64; 3]) -> f64;
}

/// Light from the scene in each pixel, before shading, glare and dirt.
pub fn paint(looks_mm: &[Vector2<f64>], scene: &impl Scene) -> Vec<f32> {
    let pixel = |i: usize| {
        let at = looks_mm[i];
        let surface = if scene.is_edge(at) {
            let (u, v) = (i % WIDTH_PX, i / WIDTH_PX);
            let (left, above) = (u.saturating_sub(1), v.saturating_sub(1));
            let (right, below) = ((u + 1).min(WIDTH_PX - 1), (v + 1).min(HEIGHT_PX - 1));
            let along_u = (looks_mm[v * WIDTH_PX + right] - looks_mm[v * WIDTH_PX + left])
                / (right - left) as f64;
            let along_v = (looks_mm[below * WIDTH_PX + u] - looks_mm[above * WIDTH_PX + u])
                / (below - above) as f64;
            let mut sum = [0.0; 3];
            for k in 0..FINE * FINE {
                let part = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
                let place = at + along_u * part(k % FINE) + along_v * part(k / FINE);
                let one = scene.surface(place);
                sum.iter_mut().zip(one).for_each(|(s, o)| *s += o);
            }
            sum.map(|s| s / (FINE * FINE) as f64)
        } else {
            scene.surface(at)
        };
        (surface[0] * scene.texture(at, &surface)) as f32
    };
    (0..looks_mm.len()).map(pixel).collect()
}

/// A lamp's gradient and curvature over the frame, and vignetting about a displaced middle.
pub struct Shading {
    slope: Vector2<f64>,
    bend: [f64; 3],
    vignetting: f64,
    middle: Vector2<f64>,
}

impl Shading {
    /// `most` is the largest change of light across the frame.
    pub fn draw(most: f64, dice: &mut Dice) -> Self {
        let (size, way) = (dice.between((0.3 * most, most)), dice.angle());
        Self {
            slope: Vector2::new(way.cos(), way.sin()) * (0.5 * size),
            bend: [0; 3].map(|_| dice.between((-0.2, 0.2)) * most),
            vignetting: dice.between((0.1, 0.7)) * most,
            middle: Vector2::new(dice.between((-0.2, 0.2)), dice.between((-0.2, 0.2))),
        }
    }

    /// Factor on the light at a pixel.
    pub fn at(&self, u: usize, v: usize) -> f64 {
        let half = 0.5 * WIDTH_PX as f64;
        let p = Vector2::new((u as f64 - MIDDLE_PX[0]) / half, (v as f64 - MIDDLE_PX[1]) / half);
        let bend = self.bend[0] * p.x * p.x + self.bend[1] * p.x * p.y + self.bend[2] * p.y * p.y;
        (1.0 + self.slope.dot(&p) + bend)
            / (1.0 + self.vignetting * (p - self.middle).norm_squared())
    }
}

/// How counts are stored.
#[derive(Clone, Copy, Debug)]
pub enum Depth {
    Eight,
    /// 12 bits in the lower bits of 16.
    TwelveLow,
    /// 12 bits in the upper bits of 16.
    TwelveHigh,
}

/// Shot noise, read noise, saturation and rounding; gamma 1.
pub struct Sensor {
    full_well_e: f64,
    read_e: f64,
    pub depth: Depth,
}

impl Sensor {
    pub fn draw(level: Level, dice: &mut Dice) -> Self {
        Self {
            full_well_e: dice.between_log(level.of([
                (40_000.0, 150_000.0),
                (7_000.0, 25_000.0),
                (4_000.0, 12_000.0),
            ])),
            read_e: dice.between(level.of([(3.0, 20.0), (3.0, 20.0), (5.0, 30.0)])),
            depth: if dice.chance(0.75) {
                Depth::Eight
            } else {
                dice.pick(&[Depth::TwelveLow, Depth::TwelveHigh])
            },
        }
    }

    /// `light` is a share of full scale.
    pub fn expose(&self, light: &[f32], dice: &mut Dice) -> Photo {
        let (top, shift) = match self.depth {
            Depth::Eight => (255.0, 0),
            Depth::TwelveLow => (4095.0, 0),
            Depth::TwelveHigh => (4095.0, 4),
        };
        let count = |share: &f32| {
            let electrons = f64::from(*share).max(0.0) * self.full_well_e;
            let noise = (electrons + self.read_e * self.read_e).sqrt() * dice.normal();
            let value = (electrons + noise) / self.full_well_e * top;
            (value.round().clamp(0.0, top) as u16) << shift
        };
        Photo { counts: light.iter().map(count).collect(), is_eight: top < 256.0 }
    }
}

/// A finished picture.
pub struct Photo {
    counts: Vec<u16>,
    is_eight: bool,
}

impl Photo {
    /// The file's bytes as PGM, which costs no time to pack.
    pub fn pgm(&self) -> Vec<u8> {
        let most = if self.is_eight { 255 } else { 65_535 };
        let mut file = format!("P5\n{WIDTH_PX} {HEIGHT_PX}\n{most}\n").into_bytes();
        if self.is_eight {
            file.extend(self.counts.iter().map(|c| *c as u8));
        } else {
            file.extend(self.counts.iter().flat_map(|c| c.to_be_bytes()));
        }
        file
    }

    pub fn write_png(&self, path: &str) -> image::ImageResult<()> {
        let (width, height) = (WIDTH_PX as u32, HEIGHT_PX as u32);
        let why = "a count for each pixel";
        if self.is_eight {
            let bytes = self.counts.iter().map(|c| *c as u8).collect();
            image::GrayImage::from_raw(width, height, bytes).expect(why).save(path)
        } else {
            type Deep = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;
            Deep::from_raw(width, height, self.counts.clone()).expect(why).save(path)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn program_sees_the_plane_as_the_renderer_does() {
        for seed in 0..20 {
            let level = Level::ALL[seed as usize % 3];
            let camera = Camera::draw(level, 0.008, &mut Dice::new(seed, 0));
            let view = camera.calibration().view(WIDTH_PX, HEIGHT_PX).unwrap();
            for (u, v) in [(0.0, 0.0), (1599.0, 0.0), (812.3, 511.7), (100.0, 1190.0)] {
                let pixel = Vector2::new(u, v);
                let place_mm = camera.to_plane(pixel);
                assert!((camera.to_pixel(place_mm) - pixel).norm() < 1e-8);
                assert!((view.to_plane(pixel) - place_mm).norm() < 1e-9);
            }
        }
    }
}
