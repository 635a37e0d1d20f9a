//! All usable sectors laid on top of each other: the common profile, node by node, as the pixels have it.

use crate::edge::levels::{Curve, median};
use crate::edge::noise::Noise;
use crate::edge::sector::{Bin, Match};
use crate::edge::shape::Shape;
use crate::edge::{Side, Template};

/// What the sectors say of each node of the common profile.
pub(super) struct Pool {
    /// Mean value.
    pub(super) value: Vec<f64>,
    /// One over its variance; 0 where no pixel falls.
    pub(super) weight: Vec<f64>,
    /// Pixels.
    pixels: Vec<f64>,
    hidden: Option<Side>,
}

/// All sectors of a band, and what is known of them.
pub(super) struct Sectors<'a> {
    pub(super) bins: &'a [Vec<Bin>],
    /// 1 for those in use, 0 for others.
    pub(super) alive: &'a [f64],
    pub(super) curve: &'a Curve,
    pub(super) noise: &'a Noise,
    /// The side that a clip hides.
    pub(super) hidden: Option<Side>,
}

impl Sectors<'_> {
    /// Lays the sectors on the nodes of `template`, which the matches and `shape` are of.
    pub(super) fn pool(&self, template: &Template, shape: &Shape, matches: &[Match]) -> Pool {
        let shifts: Vec<f64> = matches.iter().map(|m| m.shift).collect();
        let unsure: Vec<f64> = matches.iter().map(|m| m.shift_variance).collect();
        let (smooth, sd, _) = self.curve.fit_order(2, &shifts, self.alive);
        // Shifts that are mostly noise would sharpen the profile on that noise: shrink them to the curve.
        let trust = (1.0 - median(&unsure, self.alive) / (sd * sd).max(1e-300)).clamp(0.0, 1.0);
        // The tail that all sectors have is the common profile's.
        let tails: Vec<f64> = matches.iter().map(|m| m.tail).collect();
        let usual_tail = median(&tails, self.alive);
        let n = template.values.len();
        let (mut sum, mut weight, mut pixels) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for (s, bins) in self.bins.iter().enumerate() {
            if self.alive[s] == 0.0 {
                continue;
            }
            let m = &matches[s];
            let shift = smooth[s] + trust * (m.shift - smooth[s]);
            for b in bins {
                let x = Match { shift, ..*m }.place(b, &shape.edge);
                let place = (x - template.start_px) / template.step_px;
                if place < -0.5 || place >= n as f64 - 0.5 {
                    continue;
                }
                let i = (place + 0.5) as usize;
                let node = i as f64;
                let old = shape.at(x);
                let y = (b.value - m.level - (m.tail - usual_tail) * old.tail) / m.gain;
                let variance = self.noise.variance(b, i);
                let r = (y - old.profile) * m.gain / variance.sqrt();
                let w = m.gain * m.gain / variance * crate::fit::circle::tukey(r / 3.0);
                sum[i] += w * (y - old.slope * (place - node) * template.step_px);
                weight[i] += w;
                pixels[i] += b.count;
            }
        }
        let mean = |(sum, weight): (&f64, &f64)| if *weight > 0.0 { sum / weight } else { 0.0 };
        let value = sum.iter().zip(&weight).map(mean).collect();
        Pool { value, weight, pixels, hidden: self.hidden }
    }
}

impl Pool {
    /// Distance, value and weight of the nodes of `template`, which it has, that pixels fall on.
    pub(super) fn nodes<'a>(
        &'a self,
        template: &'a Template,
    ) -> impl Iterator<Item = (f64, f64, f64)> + 'a {
        let node = |i| (template.place_px(i), self.value[i], self.weight[i]);
        (0..self.value.len()).map(node).filter(|(_, _, weight)| *weight > 0.0)
    }

    /// The common profile again, on the nodes of the one before. `None` where a clip hides what it would have to be.
    pub(super) fn template(&self, before: &Template) -> Option<Template> {
        let mut template = before.clone();
        let n = template.values.len();
        let mut last = template.values[0];
        // Nodes that hardly any pixel falls on keep their neighbour's value.
        let least = 0.1 * self.pixels.iter().sum::<f64>() / n as f64;
        let known: Vec<bool> =
            (0..n).map(|i| self.weight[i] > 0.0 && self.pixels[i] > least).collect();
        for ((old, value), known) in template.values.iter_mut().zip(&self.value).zip(&known) {
            if *known {
                last = *value;
            }
            *old = last;
        }
        if let Some(side) = self.hidden {
            template.mirror(&known, side)?;
        }
        template.denoise();
        Some(template)
    }
}
