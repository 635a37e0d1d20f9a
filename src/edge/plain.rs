//! An edge that is the same everywhere along its contour, but for its place.
//!
//! What a sector has of its own (level, gain, stretch, tail) costs knowledge of its place, even held by priors. Where all that the sectors differ in
//! is what pixel noise makes them differ in, one level and one gain for all reach the Cramer-Rao bound. Two tests decide: what parameters of
//! their own would explain in all, and what slow curves of these along the contour would.

use nalgebra::allocator::Allocator;
use nalgebra::{
    DMatrix, DVector, DefaultAllocator, Dim, Matrix2, Matrix4, OMatrix, OVector, Vector2, Vector4,
};

use crate::edge::Template;
use crate::edge::blurred::Blurred;
use crate::edge::noise::by_chance;
use crate::edge::pool::Sectors;
use crate::edge::sector::{Match, PARAMETERS, Products, SHIFT};
use crate::edge::shape::Shape;

/// Steps to one level, one gain and all shifts: each is nearly linear, and the start is near.
const STEPS: usize = 3;
/// Which parameters of a sector are not its shift.
const OTHERS: [usize; 4] = [0, 1, 3, 4];

/// A plain edge.
pub(super) struct Plain {
    /// The common profile.
    pub(super) template: Template,
    /// Where it lies in each sector.
    pub(super) matches: Vec<Match>,
    /// The common profile as a blurred sharp edge, if it is one.
    pub(super) blurred: Option<Blurred>,
}

/// Normal equations of a sector.
struct Sums {
    sector: usize,
    /// Without the shift, which is solved for.
    rest: Matrix4<f64>,
    right: Vector4<f64>,
    /// One over the shift's variance, what level and gain move it by, and how far it is off.
    known: f64,
    moves: Vector2<f64>,
    off: f64,
    squares: f64,
}

impl Sectors<'_> {
    /// The edge with one level and one gain, its common profile learnt again; `shape` is that of the one so far. `None` where sectors have something of their own.
    pub(super) fn plain(
        &self,
        template: &Template,
        shape: &Shape,
        matches: &[Match],
    ) -> Option<Plain> {
        let (matches, scale) = self.shifts(shape, matches)?;
        let pool = self.pool(template, shape, &matches);
        let again = pool.template(template)?;
        let blurred = self.blurred(&pool, &again, &matches, scale);
        let template = match blurred {
            Some(edge) => edge.template(&again),
            None => again,
        };
        let (matches, _) = self.shifts(&Shape::of(&template), &matches)?;
        Some(Plain { template, matches, blurred })
    }

    /// The matches with one level and one gain, and the variance of a pixel in parts of what is assumed.
    fn shifts(&self, shape: &Shape, matches: &[Match]) -> Option<(Vec<Match>, f64)> {
        let used: Vec<usize> = (0..matches.len()).filter(|s| self.alive[*s] > 0.0).collect();
        let count = used.len() as f64;
        let mean =
            |of: fn(&Match) -> f64| used.iter().map(|s| of(&matches[*s])).sum::<f64>() / count;
        let (level, gain) = (mean(|m| m.level), mean(|m| m.gain));
        let mut found = matches.to_vec();
        for m in &mut found {
            *m = Match { level, gain, stretch: 0.0, tail: 0.0, ..*m };
        }
        let mut sums = self.sums(shape, &found, &used);
        for _ in 0..STEPS {
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for s in &sums {
                normal += s.rest.fixed_view::<2, 2>(0, 0);
                right += s.right.fixed_rows::<2>(0);
            }
            let step = normal.cholesky()?.solve(&right);
            for s in &sums {
                found[s.sector].shift += s.off - s.moves.dot(&step);
            }
            for m in &mut found {
                (m.level, m.gain) = (m.level + step.x, m.gain + step.y);
            }
            sums = self.sums(shape, &found, &used);
        }
        let bins: usize = used.iter().map(|s| self.bins[*s].len()).sum();
        let own = sums.iter().map(|s| explained(&s.rest, &s.right)).sum::<Option<f64>>()?;
        let squares = sums.iter().map(|s| s.squares).sum::<f64>();
        let scale = (squares - own) / (bins as f64 - PARAMETERS as f64 * count).max(1.0);
        let (slow, columns) = self.slow(&sums)?;
        if !by_chance(own, OTHERS.len() as f64 * count, scale) || !by_chance(slow, columns, scale) {
            return None;
        }
        for s in &sums {
            let m = &mut found[s.sector];
            m.misfit = scale;
            m.shift_variance = 1.0 / s.known;
            m.measured = (m.shift, m.shift_variance);
        }
        found.iter().all(|m| m.shift.is_finite()).then_some((found, scale))
    }

    /// The normal equations of all sectors in use.
    fn sums(&self, shape: &Shape, matches: &[Match], used: &[usize]) -> Vec<Sums> {
        let of = |&sector: &usize| {
            let mut products = Products::default();
            for b in &self.bins[sector] {
                let weight = (b.count / self.noise.pixel2).sqrt();
                products.add(&matches[sector].row(b, shape).map(|v| v * weight));
            }
            let (normal, right) = (products.normal(), products.right());
            let known = normal[(SHIFT, SHIFT)].max(f64::MIN_POSITIVE);
            let off = right[SHIFT] / known;
            let moves = OTHERS.map(|i| normal[(i, SHIFT)] / known);
            Sums {
                sector,
                rest: Matrix4::from_fn(|i, j| {
                    normal[(OTHERS[i], OTHERS[j])] - moves[i] * normal[(SHIFT, OTHERS[j])]
                }),
                right: Vector4::from_fn(|i, _| right[OTHERS[i]] - moves[i] * right[SHIFT]),
                known,
                moves: Vector2::new(moves[0], moves[1]),
                off,
                squares: products.squares(),
            }
        };
        used.iter().map(of).collect()
    }

    /// What slow curves along the contour explain in all parameters but the shift, and how many numbers they have.
    fn slow(&self, sums: &[Sums]) -> Option<(f64, f64)> {
        let n = OTHERS.len() * self.curve.slow(0).len();
        let (mut normal, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
        for s in sums {
            let curves = DVector::from_column_slice(self.curve.slow(s.sector));
            normal += (&curves * curves.transpose()).kronecker(&s.rest);
            right += curves.kronecker(&s.right);
        }
        Some((explained(&normal, &right)?, n as f64))
    }
}

/// How much of the squares' sum parameters explain, by their normal equations. Those that nothing depends on explain nothing.
fn explained<D: Dim>(normal: &OMatrix<f64, D, D>, right: &OVector<f64, D>) -> Option<f64>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    let mut held = normal.clone();
    for i in 0..right.len() {
        held[(i, i)] += 1e-9 * held[(i, i)] + 1e-12;
    }
    Some(right.dot(&held.cholesky()?.solve(right)))
}
