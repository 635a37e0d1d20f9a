//! One radius and one centre per table angle through the edge points of all captures.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use super::agreement;
use super::light::Bow;
use crate::camera::View;
use crate::fit::Circle;
use crate::fit::circle::tukey;
use crate::fit::correlated::{self, Fit, Rows};
use crate::fit::robust::{median, scatter};
use crate::measure::points::Points;
use crate::measure::rows::{group_rows, robust_weights};
use crate::uncertainty::k95;

/// The edge points of one capture in machine coordinates.
#[derive(Debug, Clone)]
pub(super) struct Arc {
    pub points: Points,
    pub position_mm: Vector2<f64>,
    /// Index of the capture's table angle.
    pub angle: usize,
    /// Index of the capture.
    pub capture: usize,
}

impl Arc {
    /// A point in machine coordinates.
    pub fn machine(&self, i: usize) -> Vector2<f64> {
        self.points.place_mm[i] + self.position_mm
    }
}

/// The joint solution.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub centers: Vec<Vector2<f64>>,
    pub radius: f64,
    /// By how much each capture lies elsewhere than the machine says.
    pub shifts: Vec<Vector2<f64>>,
    /// Weight of each point of each arc, 0 for rejected ones.
    pub weights: Vec<Vec<f64>>,
}

impl Joint {
    /// The rod in the camera's plane where the machine puts a capture.
    pub fn put(&self, arc: &Arc) -> Circle {
        Circle { center: self.centers[arc.angle] - arc.position_mm, radius: self.radius }
    }

    /// The rod in the camera's plane where a capture seems to be.
    pub fn seen(&self, angle: usize, capture: usize, position_mm: Vector2<f64>) -> Circle {
        Circle {
            center: self.centers[angle] + self.shifts[capture] - position_mm,
            radius: self.radius,
        }
    }
}

/// Robust joint fit by iterated reweighting: all arcs share the radius, arcs of one angle share the centre, and the
/// captures are displaced by about as much as the middles of their arcs miss the common circle.
pub(super) fn robust(arcs: &[Arc], start: &Joint, rounds: usize) -> Option<Joint> {
    let own: Vec<Vec<f64>> = arcs.iter().map(|a| robust_weights(&a.points)).collect();
    let mut joint = Joint { weights: own.clone(), ..start.clone() };
    for round in 0..rounds {
        let off = distances(arcs, |a| joint.seen(a.angle, a.capture, a.position_mm));
        let mut sizes: Vec<f64> =
            off.iter().zip(&own).flat_map(|(off, own)| usable(off, own)).map(f64::abs).collect();
        if sizes.len() < 10 {
            return None;
        }
        let scale = scatter(&mut sizes).max(1e-7);
        let cut = if round == 0 { 3.0 * scale } else { scale };
        for ((weights, own), off) in joint.weights.iter_mut().zip(&own).zip(&off) {
            for ((weight, own), off) in weights.iter_mut().zip(own).zip(off) {
                *weight = own * tukey(off / cut);
            }
        }
        let missed = missed(arcs, &joint, &own);
        let displacement = scatter(&mut missed.iter().flatten().copied().collect::<Vec<_>>());
        let gross = |m: &Option<f64>| {
            m.is_some_and(|m| m > (GROSS * displacement.max(scale)).max(GROSS_MM))
        };
        // Many that are far off are no slips but how this machine is.
        let slips = missed.iter().filter(|m| gross(m)).count() <= arcs.len().div_ceil(10);
        for (k, arc) in arcs.iter().enumerate() {
            let slipped = slips && gross(&missed[k]);
            // One that is no farther off than others are may only have been left behind as the cut came down.
            let usual = !slipped && missed[k].is_some_and(|m| m <= USUAL * displacement);
            if usual && agreeing(&joint.weights[k]) < LEFT_BEHIND {
                let again = displaced(arc, &own[k], &joint, cut);
                let better = |w: &Vec<f64>| agreeing(w) > agreeing(&joint.weights[k]);
                if let Some((shift, weights)) = again.filter(|(_, weights)| better(weights)) {
                    joint.shifts[arc.capture] = shift;
                    joint.weights[k] = weights;
                }
            }
            if slipped || agreeing(&joint.weights[k]) < LEAST_AGREEING {
                joint.weights[k].fill(0.0);
            }
        }
        // Wander alone moves the middle of an arc by half the scatter of its points.
        let ease = ((displacement / scale).powi(2) - 0.25).max(0.0);
        if step(arcs, &mut joint, ease, scale)? < 1e-9 {
            break;
        }
    }
    Some(joint)
}

/// Share of an arc's points that have a weight.
fn agreeing(weights: &[f64]) -> f64 {
    weights.iter().filter(|w| **w > 0.0).count() as f64 / weights.len() as f64
}

/// By how much an arc by itself lies elsewhere than the machine says, and the weights of its points there.
fn displaced(arc: &Arc, own: &[f64], joint: &Joint, cut: f64) -> Option<(Vector2<f64>, Vec<f64>)> {
    const STEPS: usize = 4;
    let put = joint.put(arc);
    let mut circle = joint.seen(arc.angle, arc.capture, arc.position_mm);
    let mut weights = own.to_vec();
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (place, weight) in arc.points.place_mm.iter().zip(&weights).filter(|(_, w)| **w > 0.0) {
            let out = (place - circle.center).normalize();
            normal += *weight * out * out.transpose();
            right += *weight * circle.distance(*place) * out;
        }
        circle.center += normal.try_inverse()? * right;
        let off = arc.points.place_mm.iter().map(|place| circle.distance(*place));
        weights = off.zip(own).map(|(off, own)| own * tukey(off / cut)).collect();
    }
    Some((circle.center - put.center, weights))
}

/// How far each point of each arc lies outside the arc's circle.
fn distances(arcs: &[Arc], circle: impl Fn(&Arc) -> Circle) -> Vec<Vec<f64>> {
    let of_arc = |arc: &Arc| {
        let circle = circle(arc);
        arc.points.place_mm.iter().map(|p| circle.distance(*p)).collect()
    };
    arcs.iter().map(of_arc).collect()
}

/// The distances of the points that have a weight of their own.
fn usable<'a>(off: &'a [f64], own: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    off.iter().zip(own).filter(|(_, own)| **own > 0.0).map(|(off, _)| *off)
}

/// How far the middle of each arc misses the common circle where the machine puts it.
fn missed(arcs: &[Arc], joint: &Joint, own: &[Vec<f64>]) -> Vec<Option<f64>> {
    let off = distances(arcs, |a| joint.put(a));
    let middle = |(off, own): (&Vec<f64>, &Vec<f64>)| {
        let mut off: Vec<f64> = usable(off, own).collect();
        (!off.is_empty()).then(|| median(&mut off).abs())
    };
    off.iter().zip(own).map(middle).collect()
}

/// An arc that misses the circle by this many times what the others do is no such arc, or its position is wrong.
const GROSS: f64 = 8.0;
/// The same of one that is as the others are; where less than this share of its points agrees it is looked at by itself.
const USUAL: f64 = 3.0;
const LEFT_BEHIND: f64 = 0.5;
/// No machine that cuts is out of place by this much by chance.
const GROSS_MM: f64 = 0.02;
/// Where less than this share of an arc's points agrees with a circle, they do so by chance.
const LEAST_AGREEING: f64 = 0.08;

/// One step of the weighted least squares over centres, radius and displacements; returns how far it went.
/// `scale` is a point's standard deviation, `ease` a displacement's variance in those of a point.
fn step(arcs: &[Arc], joint: &mut Joint, ease: f64, scale: f64) -> Option<f64> {
    let angles = joint.centers.len();
    let first_shift = 2 * angles + 1;
    let n = first_shift + 2 * joint.shifts.len();
    let mut normal = DMatrix::<f64>::zeros(n, n);
    let mut right = DVector::<f64>::zeros(n);
    // An arc's points are not independent: together they count as its groups.
    let total: f64 = joint.weights.iter().flatten().sum();
    let share = (GROUPS_PER_ARC * arcs.len()) as f64 / total.max(f64::MIN_POSITIVE);
    for (k, arc) in arcs.iter().enumerate() {
        let circle = joint.seen(arc.angle, arc.capture, arc.position_mm);
        for (place, weight) in arc.points.place_mm.iter().zip(&joint.weights[k]) {
            if *weight > 0.0 {
                let d = circle.distance(*place);
                let out = (place - circle.center).normalize();
                let (at, own) = (2 * arc.angle, first_shift + 2 * arc.capture);
                let row = [
                    (at, out.x),
                    (at + 1, out.y),
                    (2 * angles, 1.0),
                    (own, out.x),
                    (own + 1, out.y),
                ];
                for (r, a) in row {
                    right[r] += share * weight * a * d;
                    for (c, b) in row {
                        normal[(r, c)] += share * weight * a * b;
                    }
                }
            }
        }
    }
    for (i, shift) in joint.shifts.iter().enumerate() {
        // Student's t (4 degrees of freedom): one position that is grossly wrong must not pull the others.
        let stiff = 6.0 / (4.0 * ease.max(1e-9) + shift.norm_squared() / (scale * scale));
        for k in 0..2 {
            normal[(first_shift + 2 * i + k, first_shift + 2 * i + k)] += stiff;
            right[first_shift + 2 * i + k] -= stiff * shift[k];
        }
    }
    let tiny = 1e-12 * normal.view((0, 0), (first_shift, first_shift)).trace();
    for i in 0..n {
        normal[(i, i)] += tiny;
    }
    let step = normal.cholesky()?.solve(&right);
    let pair = |at: usize| Vector2::new(step[at], step[at + 1]);
    joint.centers.iter_mut().enumerate().for_each(|(i, c)| *c += pair(2 * i));
    joint.shifts.iter_mut().enumerate().for_each(|(i, s)| *s += pair(first_shift + 2 * i));
    joint.radius += step[2 * angles];
    (joint.radius.is_finite() && joint.radius > 0.0).then(|| step.norm())
}

/// The joint fit with what it says of the captures.
pub(super) struct Refined {
    /// Coefficients: centre x, y of every angle, then the radius, as corrections of the robust solution.
    pub fit: Fit,
    /// The arc of each row of the fit; rows of one arc stand together.
    pub groups: Vec<usize>,
    /// Root mean square of what the common circle leaves over where the machine puts the captures.
    pub misses_mm: f64,
    /// The same with every capture where it seems to be.
    pub form_mm: f64,
    /// How far each of the plane's independent errors moves the coefficients, a column each.
    pub by_plane: DMatrix<f64>,
    /// By what part the pictures seem enlarged, where the arcs bend otherwise than their places say.
    pub enlarged: Option<f64>,
}

impl Refined {
    /// Standard deviation (each axis) of the captures' places, 0 where they are likely to be as the machine says.
    pub fn position_scatter_mm(&self) -> f64 {
        if self.fit.displaced > 0.5 { self.fit.displacement_sd } else { 0.0 }
    }
}

/// Generalised least squares about the robust solution. Coefficients: centre x, y of every angle, then the radius.
/// `is_nominal` tells whether a radius is the rod's.
pub(super) fn refine(
    arcs: &[Arc],
    angles: usize,
    joint: &Joint,
    (bow, view): (&Bow, &View),
    is_nominal: impl Fn(f64) -> bool,
) -> Option<Refined> {
    let mut design = Vec::new();
    let (mut y, mut variance, mut place, mut group) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut displacement, mut bent, mut outwards) = (Vec::new(), Vec::new(), Vec::new());
    let mut plane = Vec::new();
    for (k, arc) in arcs.iter().enumerate() {
        let rows = group_rows(&arc.points, &joint.weights[k], joint.put(arc), GROUPS_PER_ARC);
        for i in 0..rows.y.len() {
            let mut row = vec![0.0; 2 * angles + 1];
            row[2 * arc.angle] = rows.design[(i, 0)];
            row[2 * arc.angle + 1] = rows.design[(i, 1)];
            row[2 * angles] = 1.0;
            design.extend(row);
            y.push(rows.y[i]);
            variance.push(rows.variance[i]);
            place.push(rows.place[i]);
            group.push(k);
            let out = Vector2::new(rows.design[(i, 0)], rows.design[(i, 1)]);
            bent.push(bow.moves_mm(rows.place[i], out, arc.points.located.step.softness_px));
            outwards.push(bow.outwards_mm(rows.place[i], out));
            plane.extend(view.plane_errors_mm(rows.place[i]).map(|moved| moved.dot(&out)));
            displacement.push(out);
        }
    }
    let count = y.len();
    let rows = Rows {
        design: DMatrix::from_row_slice(count, 2 * angles + 1, &design),
        y: DVector::from_vec(y),
        variance,
        place,
        group: group.clone(),
        covariance: None,
        // Where every angle has one capture only, they cannot disagree: then positions have to be taken for exact.
        displacement: (arcs.len() > angles).then_some(displacement),
        unsteady: UNSTEADY,
        unsteady_if_long: false,
    };
    let mut fit = correlated::fit(&rows, None)?;
    let rms = |v: &DVector<f64>| (v.norm_squared() / v.len() as f64).sqrt();
    let mut enlarged = None;
    if let Some((other, by)) = if_enlarged(&rows, &fit, &outwards) {
        // Another object's edge at another height bends so too.
        let radius = joint.radius + other.beta[2 * angles];
        if is_nominal(radius) || rms(&fit.residuals) < agreement::DISAGREEMENT_MM {
            (fit, enlarged) = (other, Some(by));
        }
    }
    for rows in correlated::groups(&group) {
        let moved = fit.influence.columns(rows.start, rows.len()).column_sum();
        let place_mm = PLACE_PX * arcs[group[rows.start]].points.pixel_mm;
        fit.covariance += &moved * moved.transpose() * (place_mm * place_mm);
    }
    let bent = &fit.influence * DVector::from_vec(bent);
    fit.covariance += &bent * bent.transpose();
    let plane = DMatrix::from_row_slice(count, plane.len() / count, &plane);
    let by_plane = &fit.influence * plane;
    fit.covariance += &by_plane * by_plane.transpose();
    Some(Refined {
        misses_mm: rms(&fit.residuals),
        form_mm: rms(&(&fit.residuals - &fit.moved)),
        fit,
        groups: group,
        by_plane,
        enlarged,
    })
}

/// The fit with a scale of the pictures of its own, and that scale, where all arcs miss the circle outwards or all inwards by the same: places
/// that scatter do not, arcs that bend too little or too much do. A rim at another height than the calibration's plane bends so, and one beside
/// an edge at another height.
fn if_enlarged(rows: &Rows, fit: &Fit, outwards: &[f64]) -> Option<(Fit, f64)> {
    let ranges = correlated::groups(&rows.group);
    if ranges.len() < LEAST_ARCS || fit.displaced < 0.5 {
        return None;
    }
    let n = ranges.len() as f64;
    let means: Vec<f64> = ranges.into_iter().map(|r| fit.residuals.rows_range(r).mean()).collect();
    let mean = means.iter().sum::<f64>() / n;
    let sd = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    if mean.abs() < LEAST_MISS_MM.max(ALL_MISS * k95(n - 1.0) * sd / n.sqrt()) {
        return None;
    }
    let p = rows.design.ncols();
    let mut design = rows.design.clone().insert_column(p, 0.0);
    design.set_column(p, &DVector::from_column_slice(outwards));
    let mut other = correlated::fit(&Rows { design, ..rows.clone() }, None)?;
    let by = other.beta[p];
    other.beta = other.beta.remove_row(p);
    other.covariance = other.covariance.remove_row(p).remove_column(p);
    other.influence = other.influence.remove_row(p);
    (other.displacement_sd < 0.5 * fit.displacement_sd).then_some((other, by))
}

/// Arcs of which it can be said that all miss alike, by how much at least, and by how many times the half width of their mean's interval.
const LEAST_ARCS: usize = 4;
const LEAST_MISS_MM: f64 = 0.0005;
const ALL_MISS: f64 = 3.0;

/// An arc as a whole is out of place by this much (standard deviation), and all arcs together too far out or in by that: how pixels
/// integrate light and where the counts are rounded shows in no residual. So clean renderings of two makers scatter.
const PLACE_PX: f64 = 0.001;
pub(super) const RADIUS_PX: f64 = 0.002;

/// [`Rows::unsteady`] of a rod's rim: each of several captures shows a part of it in its own light.
const UNSTEADY: f64 = 0.7;

/// Groups of edge points of one arc in the correlated fit.
const GROUPS_PER_ARC: usize = 30;
