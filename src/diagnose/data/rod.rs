//! `rod` data: edge points of a check rod in pixels, capture by capture.

mod layout;
pub mod planned;
mod read;
mod sense;

use nalgebra::{Complex, Vector2};

use crate::camera::{Calibration, View};
use crate::diagnose::data::{after_a_rest, extend_times, known_effects, need, show};
use crate::diagnose::effects::Library;
use crate::diagnose::effects::rod::{CameraError, CaptureError, library};
use crate::diagnose::experiment::{
    Active, EffectInfo, Experiment, Layout, Parameter, PlannedCapture, Untestable,
};
use crate::error::Result;
use crate::machine::{DataKind, Machine};
use crate::table::Table;
use layout::layout;
use read::Captures;

/// The captures and their edge points.
#[derive(Debug, Clone)]
pub struct Rod {
    view: View,
    /// From the camera to the plane, where the calibration has a lens to tell it.
    distance_mm: Option<f64>,
    /// Unit vectors of the picture's axes on the plane: along u, against v.
    axes: [Vector2<f64>; 2],
    /// Machine place of each capture.
    pub place: Vec<Vector2<f64>>,
    c_sense: f64,
    /// C of each capture with its sense; empty where missing, like the other optional columns.
    pub c_rad: Vec<f64>,
    /// Time.
    pub t_s: Vec<f64>,
    /// Temperature.
    pub temp_c: Vec<f64>,
    /// Direction from which X came.
    pub dir_x: Vec<f64>,
    /// Direction from which Y came.
    pub dir_y: Vec<f64>,
    /// Capture of each point.
    capture: Vec<usize>,
    /// Where the edge points lie in the machine frame by the calibration.
    points: Vec<Vector2<f64>>,
    /// Where the rod is looked at from: a fixed point near its centre.
    pole: Vector2<f64>,
    /// Unit vectors from there to the points.
    rays: Vec<Vector2<f64>>,
}

impl Rod {
    /// Whether the calibration has a lens to be wrong.
    pub fn has_lens(&self) -> bool {
        self.distance_mm.is_some()
    }

    /// Why an effect that needs these columns cannot be tested.
    pub fn needs(&self, names: &[&str]) -> Option<Untestable> {
        let x: Vec<f64> = self.place.iter().map(|p| p.x).collect();
        let y: Vec<f64> = self.place.iter().map(|p| p.y).collect();
        let present: [(&str, &[f64]); 7] = [
            ("x_mm", &x),
            ("y_mm", &y),
            ("c_deg", &self.c_rad),
            ("t_s", &self.t_s),
            ("temp_c", &self.temp_c),
            ("dir_x", &self.dir_x),
            ("dir_y", &self.dir_y),
        ];
        need(&present, names)
    }

    /// Why an effect cannot be tested that shows wherever a direction is known, though it may never change.
    pub fn shows(&self, dir: &str) -> Option<Untestable> {
        show(&[("dir_x", &self.dir_x), ("dir_y", &self.dir_y)], dir)
    }

    /// C of each capture as it is read: error motions of the axis are functions of its own angle.
    pub fn c_read_rad(&self) -> impl Iterator<Item = f64> + '_ {
        self.c_rad.iter().map(|c| self.c_sense * c)
    }

    /// Travel of one machine axis over the captures.
    pub fn travel_mm(&self, axis: usize) -> f64 {
        let values: Vec<f64> = self.place.iter().map(|p| p[axis]).collect();
        let (low, high) = crate::fit::robust::range(&values);
        high - low
    }

    /// Machine places as seen from the rod: what a scale or squareness does to where the rod itself stands is its centre's.
    pub fn from_rod(&self) -> impl Iterator<Item = Vector2<f64>> {
        self.place.iter().map(|p| p - self.pole)
    }

    /// First time.
    pub fn start_s(&self) -> f64 {
        self.t_s.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Length of the run, s.
    pub fn duration_s(&self) -> f64 {
        let end = self.t_s.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if self.t_s.is_empty() { 0.0 } else { end - self.start_s() }
    }

    /// What the camera reports too much at plane offset `w`, where the edge's outward normal is `n`.
    fn camera_shift(&self, c: &CameraError, w: Vector2<f64>, n: Vector2<f64>) -> Vector2<f64> {
        let [eu, ev] = self.axes;
        let own = Vector2::new(eu.dot(&w), ev.dot(&w));
        let linear = |row: usize| c.linear[row][0] * own.x + c.linear[row][1] * own.y;
        let light = c.light[0] * own.x + c.light[1] * own.y;
        let perspective = c.unshortened[0] * own.x + c.unshortened[1] * own.y;
        let tilted = self.tilted(own, Vector2::from(c.tilt)) - own + own * perspective;
        let mut shift = eu * (linear(0) + tilted.x) + ev * (linear(1) + tilted.y) + n * light;
        if c.lens != [0.0; 4] {
            shift += self.view.lens_shift_mm(w, c.lens);
        }
        shift
    }

    /// Where a camera that is tilted sees a place of the plane (both in the picture's own axes): nearer is larger by `tilt` per mm,
    /// and along the tilt all is foreshortened, as far as the camera's distance is known.
    fn tilted(&self, own: Vector2<f64>, tilt: Vector2<f64>) -> Vector2<f64> {
        /// A camera leans no farther.
        const MOST_SINE: f64 = 0.9;
        let strength = tilt.norm();
        if strength == 0.0 {
            return own;
        }
        let sine = (strength * self.distance_mm.unwrap_or(0.0)).min(MOST_SINE);
        let along = tilt / strength;
        let shortened = along * (along.dot(&own) * (1.0 - (1.0 - sine * sine).sqrt()));
        (own - shortened) / (1.0 - tilt.dot(&own))
    }

    /// Where a capture sees a circle of that centre and radius, with its errors.
    fn rim<'a>(&self, g: usize, centre: Vector2<f64>, radius: f64, e: &'a CaptureError) -> Rim<'a> {
        let seen = centre + e.centre - e.place;
        let c = self.c_rad.get(g).copied().unwrap_or(0.0);
        let turned = |(order, a, b): &(u32, f64, f64)| {
            let (s, co) = (f64::from(*order) * c).sin_cos();
            (*order, a * co - b * s, a * s + b * co)
        };
        Rim {
            from_pole: seen - self.pole,
            from_frame: seen - self.place[g],
            radius: radius + e.radius,
            lobes: e.lobes.iter().map(turned).collect(),
            camera: (e.camera != CameraError::default()).then_some(&e.camera),
        }
    }

    /// Distance from the pole at which the edge should be seen, in that direction.
    fn predicted(&self, wanted: Vector2<f64>, rim: &Rim) -> f64 {
        /// So near the direction the edge is as straight as its tangent, mm: over this it leaves it by less than a nanometre.
        const NEAR_MM: f64 = 1e-4;
        // Where the plain circle is seen in this direction.
        let (r, aside) = (rim.radius, wanted.perp(&rim.from_pole));
        let reach = (r * r - aside * aside).max(0.0).sqrt();
        if rim.camera.is_none() && rim.lobes.is_empty() {
            return wanted.dot(&rim.from_pole) + reach;
        }
        let square = Vector2::new(-wanted.y, wanted.x);
        let mut n = (wanted * reach - square * aside) / r;
        let mut at = rim.from_pole;
        // The point of the real edge that is seen there: each round leaves a thousandth of the error.
        for _ in 0..3 {
            let out = n * (r + rim.lobes_mm(n));
            at = rim.from_pole + out;
            if let Some(camera) = rim.camera {
                at += self.camera_shift(camera, rim.from_frame + out, n);
            }
            let miss_mm = wanted.perp(&at);
            if miss_mm.abs() < NEAR_MM {
                break;
            }
            let miss = miss_mm / at.norm();
            n = Vector2::new(n.x + miss * n.y, n.y - miss * n.x).normalize();
        }
        at.dot(&n) / wanted.dot(&n)
    }
}

/// The rod's rim as one capture sees it.
struct Rim<'a> {
    /// Its centre as seen from the pole, and from the frame's middle.
    from_pole: Vector2<f64>,
    from_frame: Vector2<f64>,
    radius: f64,
    /// Order, cosine and sine over the direction from the centre.
    lobes: Vec<(u32, f64, f64)>,
    /// What the camera gets wrong, if anything.
    camera: Option<&'a CameraError>,
}

impl Rim<'_> {
    /// How far the rim lies beyond its radius in a direction.
    fn lobes_mm(&self, n: Vector2<f64>) -> f64 {
        let lobe = |(order, a, b): &(u32, f64, f64)| {
            let wave = Complex::new(n.x, n.y).powu(*order);
            a * wave.re + b * wave.im
        };
        self.lobes.iter().map(lobe).sum()
    }
}

/// Captures that are planned, about.
const PLANNED_CAPTURES: usize = 96;

/// A `rod` experiment.
pub struct RodExperiment {
    data: Rod,
    library: Library<Rod, CaptureError>,
    known: Vec<Active>,
    layout: Layout,
    nuisances: Vec<Parameter>,
}

/// Columns of the `--points` file of `pivotsight rod`: needed and possible.
pub const COLUMNS: (&[&str], &[&str]) =
    (&["capture", "x_mm", "y_mm", "u_px", "v_px"], &["c_deg", "t_s", "temp_c", "dir_x", "dir_y"]);

/// The same of a plan of captures without edge points, a row each; `image` and what else a table of captures has is passed over.
pub const PLAN_COLUMNS: (&[&str], &[&str]) = (&["x_mm", "y_mm"], &["*"]);

impl RodExperiment {
    /// From a table of [`COLUMNS`].
    pub fn from_table(
        table: &Table,
        calibration: &Calibration,
        machine: Option<&Machine>,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let captures = Captures::of(table);
        let c_deg = captures.column("c_deg")?;
        let (data, rim) = read::rod(&captures, &c_deg, calibration, machine, warnings)?;
        let values: Vec<f64> = data.points.iter().map(|p| (p - data.pole).norm()).collect();
        let spread =
            values.iter().map(|v| (v - rim.radius).powi(2)).sum::<f64>() / values.len() as f64;
        if spread.sqrt() > 0.1 * rim.radius {
            warnings.push(format!(
                "the points scatter by {:.3} mm about a circle of {:.3} mm: check that x_mm, y_mm are in \
                 millimetres and have the sign of the machine",
                spread.sqrt(),
                rim.radius
            ));
        }
        warnings.extend(sense::doubt(&data));
        let layout = layout(&data, values, &c_deg);
        let library = library(&data);
        let known = match machine {
            Some(machine) => known_effects(&library, machine, warnings)?,
            None => Vec::new(),
        };
        let nuisance =
            |name: &'static str, start: f64| Parameter { start, ..Parameter::linear(name, 0.01) };
        let nuisances = vec![
            nuisance("centre_x_mm", rim.center.x),
            nuisance("centre_y_mm", rim.center.y),
            nuisance("radius_mm", rim.radius),
        ];
        Ok(Self { data, library, known, layout, nuisances })
    }
}

impl Experiment for RodExperiment {
    fn kind(&self) -> DataKind {
        DataKind::Rod
    }

    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn nuisances(&self) -> &[Parameter] {
        &self.nuisances
    }

    fn effects(&self) -> &[EffectInfo] {
        &self.library.infos
    }

    fn predict(&self, nuisances: &[f64], active: &[Active]) -> Vec<f64> {
        let captures = self.data.place.len();
        let all = [self.known.as_slice(), active].concat();
        let errors = self.library.errors(&self.data, captures, &all);
        let centre = Vector2::new(nuisances[0], nuisances[1]);
        let rims: Vec<Rim> = (errors.iter().enumerate())
            .map(|(g, e)| self.data.rim(g, centre, nuisances[2], e))
            .collect();
        (self.data.capture.iter().zip(&self.data.rays))
            .map(|(g, ray)| self.data.predicted(*ray, &rims[*g]))
            .collect()
    }

    fn predicted_columns(&self, predicted: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
        let d = &self.data;
        let pixels = predicted.iter().enumerate().map(|(i, distance)| {
            d.view.to_pixel(d.pole + d.rays[i] * *distance - d.place[d.capture[i]])
        });
        let (u, v): (Vec<f64>, Vec<f64>) = pixels.map(|p| (p.x, p.y)).unzip();
        vec![("u_px", u), ("v_px", v)]
    }

    fn proposals(&self) -> Vec<Vec<PlannedCapture>> {
        let d = &self.data;
        let places = d.planned_places(self.nuisances[2].start);
        let side = |n: usize| if n.is_multiple_of(2) { 1.0 } else { -1.0 };
        let rounds = (PLANNED_CAPTURES / places.len()).max(1);
        let capture = |k: usize| {
            let (round, place) = (k / places.len(), k % places.len());
            let at = places[place];
            let mut capture = PlannedCapture::default().with("x_mm", at.x).with("y_mm", at.y);
            // C angles that no small harmonic repeats on.
            if !d.c_rad.is_empty() {
                capture = capture.with("c_deg", (round * 83 % 360) as f64);
            }
            if !d.dir_x.is_empty() {
                capture = capture.with("dir_x", side(round + place));
            }
            if !d.dir_y.is_empty() {
                capture = capture.with("dir_y", side((round + place) / 2));
            }
            capture
        };
        let now: Vec<PlannedCapture> = (0..rounds * places.len()).map(capture).collect();
        let later = after_a_rest(&now, &d.t_s, &d.temp_c);
        vec![now, later]
    }

    fn with_plan(&self, plan: &[PlannedCapture]) -> Box<dyn Experiment> {
        let mut data = self.data.clone();
        let mut values = self.layout.values.clone();
        let radius = values.iter().sum::<f64>() / values.len().max(1) as f64;
        for capture in plan {
            let last = data.place.last().copied().unwrap_or(data.pole);
            let place = Vector2::new(
                capture.or_last("x_mm", &[last.x]),
                capture.or_last("y_mm", &[last.y]),
            );
            for ray in self.data.seen(place, radius) {
                data.points.push(data.pole + ray * radius);
                data.rays.push(ray);
                data.capture.push(data.place.len());
                values.push(radius);
            }
            data.place.push(place);
            if let Some(last) = data.c_rad.last().copied() {
                let planned = capture.number("c_deg").map(|c| data.c_sense * c.to_radians());
                data.c_rad.push(planned.unwrap_or(last));
            }
            capture.extend("dir_x", &mut data.dir_x);
            capture.extend("dir_y", &mut data.dir_y);
            capture.extend("temp_c", &mut data.temp_c);
        }
        extend_times(&mut data.t_s, plan);
        let c_deg: Vec<f64> = data.c_read_rad().map(f64::to_degrees).collect();
        let mut layout = layout(&data, values, &c_deg);
        // Planned captures may see more of the rim; their noise is the run's all the same.
        layout.random.truncate(self.layout.random.len());
        let library = library(&self.data);
        let (known, nuisances) = (self.known.clone(), self.nuisances.clone());
        Box::new(Self { data, library, known, layout, nuisances })
    }
}
