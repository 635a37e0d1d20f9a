//! Numbers of a scene: fixed, or drawn by the seed.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::error::{Error, Result};

/// One number of a scene: `3.0`, a range `[2.2, 3.4]`, or a choice `{ any = [0.0, 0.6] }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, a range [low, high], or a choice { any = [..] }")]
pub enum Draw {
    /// Always this value.
    Fixed(f64),
    /// Uniform between the two.
    Between([f64; 2]),
    /// One of these, all equally likely.
    Any {
        /// The values.
        any: Vec<f64>,
    },
}

impl From<f64> for Draw {
    fn from(value: f64) -> Self {
        Self::Fixed(value)
    }
}

impl From<[f64; 2]> for Draw {
    fn from(range: [f64; 2]) -> Self {
        Self::Between(range)
    }
}

impl Draw {
    /// The same choice of values, each times a factor.
    pub fn times(&self, factor: f64) -> Self {
        match self {
            Self::Fixed(value) => Self::Fixed(value * factor),
            Self::Between(range) => Self::Between(range.map(|v| v * factor)),
            Self::Any { any } => Self::Any { any: any.iter().map(|v| v * factor).collect() },
        }
    }
}

/// Draws a scene's numbers and checks them against what they may be.
#[derive(Debug)]
pub struct Dice {
    origin: PathBuf,
    /// The generator, for what has no number in the scene (places of dots, phases).
    pub rng: ChaCha8Rng,
    /// Every number drawn so far by its field; a list where a field was drawn again.
    pub drawn: Map<String, Value>,
}

impl Dice {
    /// Dice for one purpose (`stream`) of one seed; `origin` names the scene in messages.
    pub fn new(origin: &Path, seed: u64, stream: u64) -> Self {
        Self { origin: origin.to_owned(), rng: stream_rng(seed, stream), drawn: Map::new() }
    }

    /// Draws a number; an error where any value it could take lies outside `allowed`.
    pub fn roll(&mut self, field: &str, draw: &Draw, allowed: RangeInclusive<f64>) -> Result<f64> {
        let values: &[f64] = match draw {
            Draw::Fixed(value) => std::slice::from_ref(value),
            Draw::Between(range) => range,
            Draw::Any { any } => any,
        };
        let fix = format!("choose between {} and {}", allowed.start(), allowed.end());
        if values.is_empty() {
            return Err(self.fault(field, "the choice is empty", fix));
        }
        if let Some(bad) = values.iter().find(|v| !allowed.contains(v)) {
            return Err(self.fault(field, format!("may become {bad}"), fix));
        }
        if let Draw::Between([low, high]) = draw
            && low > high
        {
            let reason = format!("the range [{low}, {high}] begins with its larger end");
            return Err(self.fault(field, reason, format!("write [{high}, {low}]")));
        }
        let value = match draw {
            Draw::Fixed(value) => *value,
            Draw::Between([low, high]) => low + (high - low) * self.rng.random::<f64>(),
            Draw::Any { any } => any[self.rng.random_range(0..any.len())],
        };
        self.note(field, value);
        Ok(value)
    }

    fn note(&mut self, field: &str, value: f64) {
        match self.drawn.get_mut(field) {
            None => drop(self.drawn.insert(field.to_owned(), value.into())),
            Some(Value::Array(list)) => list.push(value.into()),
            Some(single) => *single = vec![single.take(), value.into()].into(),
        }
    }

    /// As [`Dice::roll`] for two coordinates.
    pub fn roll2(
        &mut self,
        field: &str,
        draws: &[Draw; 2],
        allowed: RangeInclusive<f64>,
    ) -> Result<[f64; 2]> {
        let x = self.roll(field, &draws[0], allowed.clone())?;
        Ok([x, self.roll(field, &draws[1], allowed)?])
    }

    /// A direction, all equally likely, in radians.
    pub fn direction(&mut self) -> f64 {
        self.rng.random::<f64>() * std::f64::consts::TAU
    }

    /// The same as a vector of length one.
    pub fn heading(&mut self) -> Vector2<f64> {
        let (sin, cos) = self.direction().sin_cos();
        Vector2::new(cos, sin)
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.rng.random::<f64>()
    }

    /// Normal with zero mean and unit variance.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// An error about one field of the scene.
    pub fn fault(&self, field: &str, reason: impl Into<String>, fix: impl Into<String>) -> Error {
        Error::field(&self.origin, None, field, reason, fix)
    }
}

/// A generator of its own for each seed and purpose.
pub fn stream_rng(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_keep_their_range_and_faults_name_the_field() {
        let mut dice = Dice::new(Path::new("s.toml"), 1, 0);
        for _ in 0..100 {
            let v = dice.roll("a.b", &Draw::Between([2.0, 3.0]), 0.0..=5.0).unwrap();
            assert!((2.0..=3.0).contains(&v));
        }
        let bad = [[1.0, 9.0].into(), [3.0, 2.0].into(), Draw::Any { any: vec![] }];
        for bad in std::iter::once(Draw::Fixed(f64::NAN)).chain(bad) {
            let message = dice.roll("ring.radius_mm", &bad, 0.0..=5.0).unwrap_err().to_string();
            assert!(message.starts_with("s.toml: ring.radius_mm: "), "{message}");
        }
    }
}
