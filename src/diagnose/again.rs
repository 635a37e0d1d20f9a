//! Another way to the answer: names alone first. A shape without a name may keep the place of several names, since only one of
//! them is tried beside it at a time.

use crate::diagnose::exchange::price;
use crate::diagnose::fit::{Fitted, Fitter};
use crate::diagnose::parts::{Part, parts, remove_all};
use crate::diagnose::select::{Selection, library_bonus};

/// How much likelier the answer by names first must be, nats for each name more: names together can follow a bump.
const CLEARLY: f64 = 6.0;

impl Selection {
    /// Grows an answer with shapes again from its names, by names only and then as usual; keeps the likelier one.
    pub(super) fn grow_again(&mut self, fitter: &Fitter) {
        let extras = &self.fitted.model.extras;
        let shape = |i: &usize| extras[*i].is_shape();
        let shapes: Vec<Part> = (0..extras.len()).filter(shape).map(Part::Extra).collect();
        if shapes.is_empty() {
            return;
        }
        let first = self.fitted.clone();
        let more = |f: &Fitted| f.model.active.len().saturating_sub(first.model.active.len());
        self.fitted = fitter.fit(remove_all(&first.model, &shapes), Some(&first.noise));
        self.shapes = false;
        self.grow(fitter);
        self.shapes = true;
        if more(&self.fitted) > 0 {
            self.grow(fitter);
        }
        let names = more(&self.fitted);
        let likelier = || worth(fitter, &self.fitted) - worth(fitter, &first);
        if names == 0 || likelier() < CLEARLY * names as f64 {
            self.fitted = first;
        }
    }
}

/// Log likelihood less the prices of all parts, nats.
fn worth(fitter: &Fitter, f: &Fitted) -> f64 {
    let prices: f64 = parts(&f.model).into_iter().map(|p| price(fitter, f, p)).sum();
    let beforehand = library_bonus(fitter) * f.model.active.len() as f64;
    fitter.ln_likelihood(f) - prices + beforehand
}
