//! Noise: independent errors of each output plus random parts shared within a capture, and the whitening that follows from it.
//!
//! Within a capture V = σ² (I + Z D Zᵀ). Every column is first rotated into the span of Z and its complement, so that
//! a change of D touches only a few rows per capture.

mod captures;
mod estimate;
mod serial;

use std::cell::RefCell;
use std::rc::Rc;

use nalgebra::{DMatrix, DVectorView};

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::Layout;
pub(super) use crate::diagnose::noise::captures::NO_REMAINDER;
use crate::diagnose::noise::captures::Shared;
use crate::diagnose::noise::serial::Serial;
use crate::diagnose::rim::{MEMORY_DEG, Rim, Whitener};
use crate::fit::least_squares::transposed_times;

/// Noise as estimated or given.
#[derive(Debug, Clone)]
pub struct Noise {
    /// Standard deviation of each class of observations, mm.
    pub sigma_mm: Vec<f64>,
    /// Variance of each random component over `sigma_mm[0]`², that of the rim's form last where the space has it.
    pub ratios: Vec<f64>,
    /// Degrees of freedom behind the independent part; infinite where it was given.
    pub dof: f64,
}

/// The rotated space in which the noise is (nearly) diagonal.
#[derive(Debug, Clone)]
pub struct Space {
    groups: Vec<Group>,
    classes: Vec<usize>,
    keep: Vec<bool>,
    /// Component of each random column.
    components: Vec<usize>,
    /// Of each direction that lies in what captures share, its part in each of them.
    shared: Vec<Option<Shared>>,
    /// What all captures share, with its whitening at the ratios it was last asked for.
    rim: Option<Rim>,
    whitener: RefCell<Option<(Vec<f64>, Rc<Whitener>)>>,
    /// What neighbours share.
    serial: Option<Serial>,
}

#[derive(Debug, Clone)]
struct Group {
    rows: Vec<usize>,
    /// The capture's random columns.
    z: DMatrix<f64>,
    /// Orthonormal basis of them, as far as they are no errors that follow one another.
    q: DMatrix<f64>,
    /// Random columns in that basis.
    r: DMatrix<f64>,
}

impl Space {
    /// The space of a layout; observations that are not kept carry no weight.
    pub fn new(layout: &Layout, keep: &[bool]) -> Self {
        Self::of(layout, keep, None)
    }

    fn of(layout: &Layout, keep: &[bool], serial: Option<Serial>) -> Self {
        let mut rows = vec![Vec::new(); layout.group_count()];
        for (i, &g) in layout.groups.iter().enumerate() {
            if keep[i] {
                rows[g].push(i);
            }
        }
        let components: Vec<usize> =
            layout.random.iter().enumerate().flat_map(|(c, cols)| vec![c; cols.len()]).collect();
        let columns: Vec<&Vec<f64>> = layout.random.iter().flatten().collect();
        let z = DMatrix::from_fn(layout.values.len(), columns.len(), |i, c| columns[c][i]);
        let mut seen = z.clone();
        if let Some(serial) = &serial {
            serial.apply(&mut seen);
        }
        let groups = rows
            .into_iter()
            .map(|rows| {
                let seen = seen.select_rows(&rows);
                let q = orthonormal(&seen, 1e-6);
                let r = q.tr_mul(&seen);
                Group { z: z.select_rows(&rows), rows, q, r }
            })
            .collect();
        let mut space = Self {
            groups,
            classes: layout.classes.clone(),
            keep: keep.to_vec(),
            components,
            shared: Vec::new(),
            rim: None,
            whitener: RefCell::default(),
            serial,
        };
        space.shared =
            (0..layout.directions.len()).map(|d| Shared::of(&space, layout, d)).collect();
        space
    }

    /// The space in which the errors of neighbours have this correlation.
    pub fn with_serial(layout: &Layout, keep: &[bool], neighbours: f64) -> Self {
        Self::of(layout, keep, Some(Serial::new(layout, keep, neighbours)))
    }

    /// Correlation of the errors of neighbours, where it is part of the noise.
    pub fn serial(&self) -> Option<f64> {
        self.serial.as_ref().map(|s| s.neighbours)
    }

    /// The likeliest correlation of neighbours in what a fit leaves, and what it gains against none, nats.
    pub fn likeliest_serial(
        &self,
        layout: &Layout,
        residual: &[f64],
        tangent: &DMatrix<f64>,
        noise: &Noise,
    ) -> (f64, f64) {
        if self.random_count() > 0 {
            return serial::likeliest_within(layout, &self.keep, residual);
        }
        let scaled = |columns: DMatrix<f64>| self.whiten_rest(columns, noise);
        let residual = DMatrix::from_column_slice(residual.len(), 1, residual);
        serial::likeliest(layout, &self.keep, &scaled(residual), &scaled(tangent.clone()))
    }

    /// The space with the form of the rim as a further random part, where the layout has a rim.
    pub fn with_rim(layout: &Layout, keep: &[bool]) -> Self {
        let mut space = Self::new(layout, keep);
        if !layout.rim_deg.is_empty() && !layout.random.is_empty() {
            let columns = Rim::columns(&layout.rim_deg, MEMORY_DEG);
            let top = space.top();
            space.rim = Some(Rim::new(&columns, &space.split(&columns), top));
        }
        space
    }

    /// Whether the form of the rim is part of the noise.
    pub fn has_rim(&self) -> bool {
        self.rim.is_some()
    }

    /// Root mean square of the rim's form, where it is part of the noise.
    pub fn rim_rms_mm(&self, noise: &Noise) -> Option<f64> {
        self.rim.as_ref().and(noise.ratios.last()).map(|ratio| noise.sigma_mm[0] * ratio.sqrt())
    }

    /// The whitening of the rim's form.
    fn whitener(&self, noise: &Noise) -> Option<Rc<Whitener>> {
        let rim = self.rim.as_ref()?;
        let mut cached = self.whitener.borrow_mut();
        match cached.as_ref() {
            Some((ratios, whitener)) if *ratios == noise.ratios => Some(whitener.clone()),
            _ => {
                let mut f = rim.raw().clone();
                self.whiten_captures(&mut f, noise);
                let ratio = noise.ratios.last().copied().unwrap_or(0.0);
                let whitener = Rc::new(Whitener::new(f, ratio));
                *cached = Some((noise.ratios.clone(), whitener.clone()));
                Some(whitener)
            }
        }
    }

    /// Number of kept observations.
    pub fn observations(&self) -> usize {
        self.keep.iter().filter(|k| **k).count()
    }

    fn random_count(&self) -> usize {
        self.components.len()
    }

    fn component_count(&self) -> usize {
        self.components.iter().max().map_or(0, |c| c + 1) + usize::from(self.rim.is_some())
    }

    fn capture_rows(&self) -> usize {
        self.groups.len() * self.random_count()
    }

    fn class_count(&self) -> usize {
        self.classes.iter().max().map_or(1, |c| c + 1)
    }

    /// Rows in front of the complement: one per capture and random column, then those of the rim.
    pub fn top(&self) -> usize {
        self.capture_rows() + self.rim.as_ref().map_or(0, Rim::rows)
    }

    /// Whether an observation is used.
    pub fn kept(&self, observation: usize) -> bool {
        self.keep[observation]
    }

    /// Root mean square of the noise of one observation, shared parts included.
    pub fn noise_rms_mm(&self, noise: &Noise) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for group in &self.groups {
            for (k, &i) in group.rows.iter().enumerate() {
                let z = group.z.row(k);
                let mut shared: f64 =
                    z.iter().zip(&self.components).map(|(z, &c)| z * z * noise.ratios[c]).sum();
                if let (Some(rim), Some(ratio)) = (&self.rim, noise.ratios.last()) {
                    shared += rim.squares[i] * ratio;
                }
                sum += noise.sigma_mm[self.classes[i]].powi(2) * (1.0 + shared);
                count += 1.0;
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    }

    /// Rows of split columns that belong to the captures that `wanted` picks.
    pub fn rows_of(&self, wanted: &dyn Fn(usize) -> bool) -> Vec<usize> {
        let (top, d) = (self.top(), self.random_count());
        let mut rows = Vec::new();
        for (g, group) in self.groups.iter().enumerate().filter(|(g, _)| wanted(*g)) {
            rows.extend(g * d..(g + 1) * d);
            rows.extend(group.rows.iter().map(|i| top + i));
        }
        rows
    }

    /// Rotates columns: `top()` rows of capture-level parts, then the remainder of each observation.
    pub fn split(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let (top, d) = (self.top(), self.random_count());
        let filtered = self.serial.as_ref().map(|s| {
            let mut own = columns.clone();
            s.apply(&mut own);
            own
        });
        let columns = filtered.as_ref().unwrap_or(columns);
        let mut out = DMatrix::zeros(top + columns.nrows(), columns.ncols());
        for (g, group) in self.groups.iter().enumerate() {
            let mut part = columns.select_rows(&group.rows);
            let coefficients = transposed_times(&group.q, &part);
            part -= &group.q * &coefficients;
            out.rows_mut(g * d, coefficients.nrows()).copy_from(&coefficients);
            for c in 0..columns.ncols() {
                for (&i, v) in group.rows.iter().zip(part.column(c).iter()) {
                    out[(top + i, c)] = *v;
                }
            }
        }
        if let Some(rim) = &self.rim {
            let mut rest = out.rows(top, columns.nrows()).into_owned();
            let along = rim.take(&mut rest);
            out.rows_mut(top - rim.rows(), rim.rows()).copy_from(&along);
            out.rows_mut(top, columns.nrows()).copy_from(&rest);
        }
        out
    }

    /// Scales split columns so that the noise has unit variance.
    pub fn whiten(&self, split: &DMatrix<f64>, noise: &Noise) -> DMatrix<f64> {
        let (top, n) = (self.top(), split.nrows() - self.top());
        let mut out = split.clone();
        let shared = self.whiten_top(&split.rows(0, top).into_owned(), noise);
        out.rows_mut(0, top).copy_from(&shared);
        let rest = self.whiten_rest(split.rows(top, n).into_owned(), noise);
        out.rows_mut(top, n).copy_from(&rest);
        out
    }

    /// Whitens the rows in front of the complement alone.
    pub fn whiten_top(&self, top: &DMatrix<f64>, noise: &Noise) -> DMatrix<f64> {
        let mut out = top / noise.sigma_mm[0];
        self.whiten_captures(&mut out, noise);
        if let Some(whitener) = self.whitener(noise) {
            whitener.apply(&mut out);
        }
        out
    }

    /// ln of the determinant of the noise's covariance.
    pub fn ln_det(&self, noise: &Noise) -> f64 {
        let kept = self.classes.iter().zip(&self.keep).filter(|(_, keep)| **keep);
        let own: f64 = kept.map(|(class, _)| 2.0 * noise.sigma_mm[*class].ln()).sum();
        let of_group = |group: &Group| {
            let l = self.factor(group, noise);
            l.map_or(0.0, |l| 2.0 * l.diagonal().map(f64::ln).sum())
        };
        let shared: f64 = self.groups.iter().map(of_group).sum();
        let serial = self.serial.as_ref().map_or(0.0, Serial::ln_det);
        own + shared + serial + self.whitener(noise).map_or(0.0, |w| w.ln_det)
    }

    /// Whitens the remainder of each observation.
    pub fn whiten_rest(&self, mut rest: DMatrix<f64>, noise: &Noise) -> DMatrix<f64> {
        for mut column in rest.column_iter_mut() {
            for (v, &class) in column.iter_mut().zip(&self.classes) {
                *v /= noise.sigma_mm[class];
            }
        }
        rest
    }

    /// How much of a whitened column lies in each random component, then in the complement of each class, whose squares are
    /// given (none for a column without a complement).
    pub fn shares(&self, top: DVectorView<f64>, rest: &[f64]) -> Vec<f64> {
        let (d, components) = (self.random_count(), self.component_count());
        let mut shares = vec![0.0; components + self.class_count()];
        let (captures, rim) = top.as_slice().split_at(self.capture_rows());
        for capture in captures.chunks_exact(d.max(1)) {
            for (v, &component) in capture.iter().zip(&self.components) {
                shares[component] += v * v;
            }
        }
        rim.iter().for_each(|v| shares[components - 1] += v * v);
        shares[components..].iter_mut().zip(rest).for_each(|(share, square)| *share = *square);
        let total: f64 = shares.iter().sum::<f64>().max(1e-300);
        shares.iter().map(|s| s / total).collect()
    }

    /// Dimension of each random component over all captures, then of the complement of each class; classes of one and the
    /// same noise count together.
    pub fn dimensions(&self, noise: &Noise) -> Vec<f64> {
        let components = self.component_count();
        let mut dimensions = vec![0.0; components];
        let mut used = 0.0;
        for group in self.groups.iter().filter(|g| !g.rows.is_empty()) {
            for &component in self.components.iter().take(group.q.ncols()) {
                dimensions[component] += 1.0;
                used += 1.0;
            }
        }
        if let Some(rim) = &self.rim {
            dimensions[components - 1] = rim.rows() as f64;
            used += rim.rows() as f64;
        }
        let all = self.observations() as f64;
        let of_class = |class: usize| {
            let same = noise.sigma_mm.iter().map(|s| *s == noise.sigma_mm[class]);
            let same: Vec<bool> = same.collect();
            let kept = self.classes.iter().zip(&self.keep);
            let count = kept.filter(|(c, keep)| **keep && same[**c]).count() as f64;
            count * (1.0 - used / all.max(1.0))
        };
        dimensions.extend((0..self.class_count()).map(of_class));
        dimensions
    }

    /// Rows of whitened columns that hold the captures' shared parts: row, capture, and which part it is.
    pub fn capture_rows_used(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        let d = self.random_count();
        let used = move |(g, group): (usize, &Group)| {
            let ranks = group.q.ncols();
            (0..ranks).map(move |k| (g * d + k, g, k))
        };
        self.groups.iter().enumerate().flat_map(used)
    }

    /// Capture-level residuals (whitened): one vector per capture with the component of each entry.
    pub fn capture_parts(&self, whitened: DVectorView<f64>) -> Vec<Vec<(usize, f64)>> {
        let (top, d) = (self.top(), self.random_count());
        self.groups
            .iter()
            .enumerate()
            .map(|(g, group)| {
                if d > 0 {
                    (0..group.q.ncols())
                        .map(|k| (self.components[k], whitened[g * d + k]))
                        .collect()
                } else {
                    group.rows.iter().map(|&i| (self.classes[i], whitened[top + i])).collect()
                }
            })
            .collect()
    }
}

impl Noise {
    /// Whether observations weigh about as they do with another noise: nothing is shared, and the outputs' noises are to each other as there.
    pub fn weighs_as(&self, other: &Self) -> bool {
        const ABOUT: f64 = 0.05;
        let parts = |noise: &Self| -> Vec<f64> {
            noise.sigma_mm.iter().map(|s| s / noise.sigma_mm[0]).collect()
        };
        let mut both = parts(self).into_iter().zip(parts(other));
        self.ratios.is_empty() && both.all(|(a, b)| (a / b - 1.0).abs() < ABOUT)
    }

    /// The same noise for a space without the rim: its form counts as noise of every point.
    pub fn without_rim(&self, space: &Space) -> Self {
        let mut noise = self.clone();
        if let Some(ratio) = space.rim.as_ref().and_then(|_| noise.ratios.pop()) {
            let more = 1.0 + ratio;
            noise.sigma_mm.iter_mut().for_each(|s| *s *= more.sqrt());
            noise.ratios.iter_mut().for_each(|r| *r /= more);
        }
        noise
    }
}
