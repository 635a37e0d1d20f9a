//! Noise estimated from what a fit leaves, by restricted maximum likelihood.
//!
//! The updates are the fixed-point form of the REML equations (Harville, "Maximum likelihood approaches to variance component
//! estimation", 1977).

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::noise::{Noise, Space};
use crate::fit::tails::ln_f_tail;

impl Space {
    /// Noise of residuals `y` after fitting the columns of `design` (both split). `given_mm` fixes the
    /// independent part; `near` is where the search starts.
    pub fn estimate(
        &self,
        design: &DMatrix<f64>,
        y: &DMatrix<f64>,
        given_mm: Option<f64>,
        near: Option<&Noise>,
    ) -> Noise {
        let n = self.observations();
        let short = self.shorten(design, y);
        let (design, y) = short.as_ref().map_or((design, y), |(d, y)| (d, y));
        let start = given_mm.unwrap_or_else(|| (y.norm_squared() / n.max(1) as f64).sqrt());
        let start = if start > 0.0 { start } else { 1e-12 };
        let mut noise = Noise {
            sigma_mm: vec![start; self.class_count()],
            ratios: near.map_or(vec![0.1; self.component_count()], |n| n.ratios.clone()),
            dof: f64::INFINITY,
        };
        for _ in 0..60 {
            let step = self.update(design, y, given_mm, &mut noise);
            if step < 1e-3 {
                break;
            }
        }
        noise
    }

    /// Where all observations share one noise, their complement matters only through its triangular factor: a few rows in
    /// place of thousands.
    fn shorten(
        &self,
        design: &DMatrix<f64>,
        y: &DMatrix<f64>,
    ) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let (top, p) = (self.top(), design.ncols());
        let rest = design.nrows() - top;
        if self.class_count() > 1 || top == 0 || rest <= p + 1 {
            return None;
        }
        let mut both = DMatrix::zeros(rest, p + 1);
        both.columns_mut(0, p).copy_from(&design.rows(top, rest));
        both.column_mut(p).copy_from(&y.view((top, 0), (rest, 1)));
        let r = both.qr().r();
        let mut short = DMatrix::zeros(top + p + 1, p + 1);
        short.view_mut((0, 0), (top, p)).copy_from(&design.rows(0, top));
        short.view_mut((0, p), (top, 1)).copy_from(&y.view((0, 0), (top, 1)));
        short.view_mut((top, 0), (p + 1, p + 1)).copy_from(&r);
        Some((short.columns(0, p).into_owned(), short.columns(p, 1).into_owned()))
    }

    /// One fixed-point step; returns the largest relative change.
    fn update(
        &self,
        design: &DMatrix<f64>,
        y: &DMatrix<f64>,
        given_mm: Option<f64>,
        noise: &mut Noise,
    ) -> f64 {
        let d = self.random_count();
        let basis = orthonormal(&self.whiten(design, noise), 1e-9);
        let mut e = self.whiten(y, noise);
        e -= &basis * basis.tr_mul(&e);
        let mut change: f64 = 0.0;
        if given_mm.is_none() {
            change = change.max(self.update_sigma(&basis, &e, noise));
        }
        // Zᵀ P y and tr(Zᵀ P Z), capture by capture, in units of σ.
        let components = noise.ratios.len();
        let (mut seen, mut expected) = (vec![0.0; components], vec![1e-300; components]);
        let whitener = self.whitener(noise);
        let top = self.top();
        let (mut e, mut basis) = (e.rows(0, top).into_owned(), basis.rows(0, top).into_owned());
        if let Some(w) = &whitener {
            // The columns of Z are whitened for the captures' parts alone: the rim's whitening goes to the other side.
            w.apply(&mut e);
            w.apply(&mut basis);
            (seen[components - 1], expected[components - 1]) = w.score(&e, &basis);
        }
        for (g, group) in self.groups.iter().enumerate().filter(|_| d > 0) {
            let k = group.q.ncols();
            let Some(l) = self.factor(group, noise) else { continue };
            let Some(z) = l.solve_lower_triangular(&group.r) else { continue };
            let part = e.view((g * d, 0), (k, 1));
            let fixed = basis.view((g * d, 0), (k, basis.ncols()));
            let score = z.tr_mul(&part);
            let lost = z.tr_mul(&fixed);
            for (c, &component) in self.components.iter().enumerate() {
                seen[component] += score[(c, 0)] * score[(c, 0)];
                let own = DMatrix::from_column_slice(k, 1, z.column(c).as_slice());
                let shared = whitener.as_ref().map_or(0.0, |w| w.taken(&own, g * d));
                expected[component] += own.norm_squared() - shared - lost.row(c).norm_squared();
            }
        }
        for (j, ratio) in noise.ratios.iter_mut().enumerate() {
            let factor = (seen[j] / expected[j].max(1e-300)).clamp(0.02, 50.0);
            let next = (*ratio * factor).clamp(1e-7, 1e9);
            if next > 1e-5 {
                change = change.max((next / *ratio - 1.0).abs());
            }
            *ratio = next;
        }
        change
    }

    /// Updates the independent part, pooling classes that do not differ.
    fn update_sigma(&self, basis: &DMatrix<f64>, e: &DMatrix<f64>, noise: &mut Noise) -> f64 {
        let top = self.top();
        let classes = noise.sigma_mm.len();
        let mut squares = vec![0.0; classes];
        let mut dof = vec![0.0; classes];
        if classes == 1 {
            squares[0] = e.norm_squared();
            dof[0] = self.observations() as f64 - basis.ncols() as f64;
        } else {
            for (i, &class) in self.classes.iter().enumerate().filter(|(i, _)| self.keep[*i]) {
                squares[class] += e[(top + i, 0)].powi(2);
                dof[class] += 1.0 - basis.row(top + i).norm_squared();
            }
        }
        let old = noise.sigma_mm.clone();
        let variance: Vec<f64> =
            (0..classes).map(|c| squares[c] * old[c].powi(2) / dof[c].max(0.5)).collect();
        let total_dof: f64 = dof.iter().sum::<f64>().max(0.5);
        let pooled =
            variance.iter().zip(&dof).map(|(v, d)| v * d.max(0.0)).sum::<f64>() / total_dof;
        let differ = (0..classes).any(|a| {
            (0..classes).any(|b| {
                a != b
                    && dof[a].min(dof[b]) > 5.0
                    && variance[a] > variance[b]
                    && ln_f_tail(variance[a] / variance[b], dof[a], dof[b]) < (1e-4_f64).ln()
            })
        });
        let mut change: f64 = 0.0;
        for c in 0..classes {
            let next = if differ { variance[c] } else { pooled }.sqrt().max(1e-12);
            change = change.max((next / old[c] - 1.0).abs());
            noise.sigma_mm[c] = next;
        }
        noise.dof = total_dof;
        change
    }
}
