//! What captures share: its whitening, and the directions that lie in it alone.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::experiment::Layout;
use crate::diagnose::generic::Term;
use crate::diagnose::noise::{Group, Noise, Space};

/// A direction along which nothing but what captures share can move.
#[derive(Debug, Clone)]
pub(super) struct Shared {
    /// An observation of each capture, one that the direction moves where there is any.
    at: Vec<usize>,
    /// Its captures' rows, split.
    parts: DVector<f64>,
}

impl Shared {
    /// The direction, if it leaves nothing to the single observations.
    pub(super) fn of(space: &Space, layout: &Layout, direction: usize) -> Option<Self> {
        if space.random_count() == 0 {
            return None;
        }
        let factors = &layout.directions[direction].factors;
        let split = space.split(&DMatrix::from_column_slice(factors.len(), 1, factors));
        let captures = space.capture_rows();
        let (own, all) = (split.rows_range(captures..).norm(), split.norm());
        if own > NO_REMAINDER * all {
            return None;
        }
        let mut at = vec![None; layout.group_count()];
        for (i, &g) in layout.groups.iter().enumerate() {
            if at[g].is_none_or(|known: usize| factors[known] == 0.0) {
                at[g] = Some(i);
            }
        }
        let at = at.into_iter().collect::<Option<Vec<usize>>>()?;
        Some(Self { at, parts: split.rows(0, captures).column(0).into_owned() })
    }
}

/// Columns whose remainder is no larger a part of them lie in what captures share.
pub(in crate::diagnose) const NO_REMAINDER: f64 = 1e-9;

impl Space {
    /// The rows in front of the complement of a shape's columns, if they are all there is: the shape is of what is set for whole
    /// captures, and scales what they share of its direction.
    pub fn split_shared(&self, term: &Term, layout: &Layout) -> Option<DMatrix<f64>> {
        let shared = self.shared[term.direction].as_ref().filter(|_| term.is_by_capture(layout))?;
        let values = term.values_at(layout, &shared.at);
        let mut top = DMatrix::zeros(self.top(), values.ncols());
        for (mut column, values) in top.column_iter_mut().zip(values.column_iter()) {
            let rows = column.iter_mut().zip(shared.parts.iter()).enumerate();
            let d = self.random_count();
            rows.filter(|(_, (_, part))| **part != 0.0)
                .for_each(|(i, (row, part))| *row = part * values[i / d]);
        }
        Some(top)
    }

    /// Whitens the captures' own parts, in units of the independent noise.
    pub(super) fn whiten_captures(&self, top: &mut DMatrix<f64>, noise: &Noise) {
        let d = self.random_count();
        if d == 0 {
            return;
        }
        let factors: Vec<_> = self.groups.iter().map(|group| self.factor(group, noise)).collect();
        for mut column in top.column_iter_mut() {
            let captures = column.as_mut_slice().chunks_exact_mut(d);
            for (part, factor) in captures.zip(&factors) {
                if let Some(l) = factor {
                    forward(l, part);
                }
            }
        }
    }

    /// Lower Cholesky factor of I + R D Rᵀ.
    pub(super) fn factor(&self, group: &Group, noise: &Noise) -> Option<DMatrix<f64>> {
        let r = &group.r;
        let mut m = DMatrix::identity(r.nrows(), r.nrows());
        for (c, &component) in self.components.iter().enumerate() {
            m.ger(noise.ratios[component], &r.column(c), &r.column(c), 1.0);
        }
        m.cholesky().map(|c| c.l())
    }
}

/// Solves L x = b in place for the first values, as many as the lower triangle has rows.
fn forward(l: &DMatrix<f64>, values: &mut [f64]) {
    for i in 0..l.nrows() {
        let known: f64 = (0..i).map(|k| l[(i, k)] * values[k]).sum();
        values[i] = (values[i] - known) / l[(i, i)];
    }
}
