//! Edges of marks and rods in the second renderer: profiles of several forms, ragged along the contour.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

use super::dice::Dice;

/// What the step at an edge is blurred with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The step becomes an error function.
    Gauss,
    /// The step becomes a hyperbolic tangent.
    Tanh,
    /// A compact bell: a polynomial step.
    Bell,
    /// A lens out of focus: half a disc each side.
    Defocus,
    /// Leaning: a long tail outwards, as of heat.
    TailOut,
    /// Leaning: a long tail inwards.
    TailIn,
}

impl Form {
    /// Density of the blur (any scale) and where it ends.
    fn kernel(self, x: f64) -> f64 {
        match self {
            Self::Gauss => (-0.5 * x * x).exp(),
            Self::Tanh => x.cosh().powi(-2),
            Self::Bell => (1.0 - x * x).max(0.0).powi(2),
            Self::Defocus => (1.0 - x * x).max(0.0).sqrt(),
            Self::TailOut => x.max(0.0).powi(2) * (-x).exp(),
            Self::TailIn => Self::TailOut.kernel(-x),
        }
    }
}

/// Half the table's length, in softnesses.
const REACH: f64 = 3.0;
const STEPS: usize = 1200;

/// Share of the inner surface across an edge: 1 inside, 0 outside, 1/2 at 0; 10 % to 90 % is one softness.
pub struct Profile {
    softness_mm: f64,
    table: Vec<f64>,
}

impl Profile {
    pub fn new(form: Form, softness_mm: f64) -> Self {
        const CELLS: usize = 6000;
        const HALF: f64 = 16.0;
        let place = |i: f64| 2.0 * HALF * i / CELLS as f64 - HALF;
        let mut sum = vec![0.0];
        for i in 0..CELLS {
            sum.push(sum[i] + form.kernel(place(i as f64 + 0.5)));
        }
        let all = sum[CELLS];
        // Where the sum has reached a share.
        let reached = |share: f64| {
            let i = sum.partition_point(|s| *s < share * all).max(1);
            place(i as f64 - (sum[i] - share * all) / (sum[i] - sum[i - 1]))
        };
        let (middle, unit) = (reached(0.5), reached(0.9) - reached(0.1));
        let table = (0..=STEPS).map(|k| {
            let x = middle + unit * REACH * (2.0 * k as f64 / STEPS as f64 - 1.0);
            let i = ((x + HALF) / (2.0 * HALF) * CELLS as f64).clamp(0.0, CELLS as f64 - 1.0);
            let (whole, part) = (i as usize, i.fract());
            1.0 - (sum[whole] + part * (sum[whole + 1] - sum[whole])) / all
        });
        Self { softness_mm, table: table.collect() }
    }

    /// How far the edge reaches to either side.
    pub fn reach_mm(&self) -> f64 {
        REACH * self.softness_mm
    }

    /// Share at a distance outside the edge.
    pub fn at(&self, outside_mm: f64) -> f64 {
        let x = (outside_mm / self.reach_mm() + 1.0) * 0.5 * STEPS as f64;
        if x <= 0.0 {
            return 1.0;
        }
        let i = x as usize;
        if i >= STEPS {
            return 0.0;
        }
        self.table[i] + (x - i as f64) * (self.table[i + 1] - self.table[i])
    }
}

/// How an edge departs from its circle: rms and correlation length along the arc.
#[derive(Clone, Copy, Debug)]
pub struct Raggedness {
    pub rms_mm: f64,
    /// Where the correlation has fallen to 1/e.
    pub length_mm: f64,
    /// Correlation exp(-d/l), rough at all scales, rather than exp(-(d/l)²).
    pub is_rough: bool,
}

const DIRECTIONS: usize = 4096;
/// Shortest wave of a ragged edge.
const SHORTEST_WAVE_MM: f64 = 0.03;

/// Radius by direction: a circle with its raggedness, all waves from one around the circle on.
pub struct Contour {
    pub radius_mm: f64,
    most_mm: f64,
    bumps_mm: Vec<f64>,
}

impl Contour {
    pub fn new(radius_mm: f64, ragged: Raggedness, dice: &mut Dice) -> Self {
        let mut bumps_mm = Vec::new();
        if ragged.rms_mm > 0.0 {
            bumps_mm = vec![0.0; DIRECTIONS];
            let round_mm = TAU * radius_mm;
            let power = |wave: usize| {
                let x = PI * wave as f64 / round_mm * ragged.length_mm;
                if ragged.is_rough { 1.0 / (1.0 + 4.0 * x * x) } else { (-x * x).exp() }
            };
            let cosine: Vec<f64> =
                (0..DIRECTIONS).map(|i| (i as f64 / DIRECTIONS as f64 * TAU).cos()).collect();
            let waves = ((round_mm / SHORTEST_WAVE_MM) as usize).min(DIRECTIONS / 3);
            let all: f64 = 0.5 * power(0) + (1..=waves).map(power).sum::<f64>();
            for wave in 1..=waves {
                let size = ragged.rms_mm * (power(wave) / all).sqrt();
                if size < 1e-7 {
                    break;
                }
                let (a, b) = (size * dice.normal(), size * dice.normal());
                for (i, bump) in bumps_mm.iter_mut().enumerate() {
                    let turn = i * wave;
                    *bump += a * cosine[turn % DIRECTIONS]
                        + b * cosine[(turn + 3 * DIRECTIONS / 4) % DIRECTIONS];
                }
            }
        }
        let most_mm = bumps_mm.iter().fold(0.0, |most: f64, b| most.max(b.abs()));
        Self { radius_mm, most_mm, bumps_mm }
    }

    fn bump_mm(&self, from_centre_mm: Vector2<f64>) -> f64 {
        if self.bumps_mm.is_empty() {
            return 0.0;
        }
        let turn = from_centre_mm.y.atan2(from_centre_mm.x).rem_euclid(TAU) / TAU;
        let x = turn * DIRECTIONS as f64;
        let (i, part) = (x as usize, x.fract());
        let value = |i: usize| self.bumps_mm[i % DIRECTIONS];
        // Directions mean nothing at the centre.
        let near = (2.0 * from_centre_mm.norm() / self.radius_mm).min(1.0);
        near * (value(i) + part * (value(i + 1) - value(i)))
    }

    /// Distance outside the contour, exact within `reach_mm` of it.
    pub fn outside_mm(&self, from_centre_mm: Vector2<f64>, reach_mm: f64) -> f64 {
        let plain = from_centre_mm.norm() - self.radius_mm;
        if plain.abs() > reach_mm + self.most_mm {
            return plain;
        }
        plain - self.bump_mm(from_centre_mm)
    }
}

/// A contour with its profile.
pub struct Edge {
    pub contour: Contour,
    pub profile: Profile,
}

impl Edge {
    /// Share of the inside here.
    pub fn share(&self, from_centre_mm: Vector2<f64>) -> f64 {
        self.profile.at(self.contour.outside_mm(from_centre_mm, self.profile.reach_mm()))
    }

    pub fn is_near(&self, from_centre_mm: Vector2<f64>) -> bool {
        let away = (from_centre_mm.norm() - self.contour.radius_mm).abs();
        away < self.profile.reach_mm() + self.contour.most_mm + 0.01
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_have_their_softness() {
        let all = [Form::Gauss, Form::Tanh, Form::Bell, Form::Defocus, Form::TailOut, Form::TailIn];
        for form in all {
            let profile = Profile::new(form, 0.2);
            let crossing = |level: f64| {
                let places = (-4000..4000).map(|i| f64::from(i) * 1e-4);
                places.into_iter().find(|x| profile.at(*x) <= level).unwrap()
            };
            assert!((crossing(0.5)).abs() < 3e-4, "{form:?}");
            assert!((crossing(0.1) - crossing(0.9) - 0.2).abs() < 3e-4, "{form:?}");
        }
    }

    #[test]
    fn raggedness_has_its_rms() {
        let ragged = Raggedness { rms_mm: 0.01, length_mm: 0.2, is_rough: true };
        let mut dice = Dice::new(1, 0);
        let mean_square: f64 = (0..20)
            .map(|_| {
                let contour = Contour::new(3.0, ragged, &mut dice);
                contour.bumps_mm.iter().map(|b| b * b).sum::<f64>() / DIRECTIONS as f64
            })
            .sum::<f64>()
            / 20.0;
        assert!((mean_square.sqrt() - 0.01).abs() < 0.001);
    }
}
