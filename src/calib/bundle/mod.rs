//! The lens, the views' poses and the board's own points on which all views agree.
//!
//! A print is off by micrometres and never quite flat, alike in all views: taken as exact it bends the lens, and no scatter
//! between views shows it. So the board's points are found with the rest, each expected about its place on the grid; how near,
//! in its plane and out of it, the residuals tell themselves (the evidence of variance components: MacKay, "Bayesian interpolation",
//! 1992). Gauss-Newton, the points eliminated first (Triggs et al., "Bundle adjustment: a modern synthesis", 2000).

mod normal;

use std::collections::HashMap;

use nalgebra::{DVector, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use crate::camera::{LENS_NUMBERS as LENS, Lens, LensCovariance, View};
use crate::cv::{BoardView, LensFit, Pose};
use crate::uncertainty::{K95, k95};
use normal::{Normal, OfPoint, POSE, Sight};

/// Rounds of noise and print; the last changes them by less than a hundredth.
const ROUNDS: usize = 12;
/// Steps for each.
const STEPS: usize = 4;
/// A step that lowers the objective by less ends them.
const LEAST_DROP: f64 = 1e-4;
/// No print is nearer its grid than this part of its size.
const LEAST_SHARE: f64 = 1e-7;

/// What all views agree on.
#[derive(Debug, Clone)]
pub(super) struct Bundle {
    /// The lens and the poses.
    pub fit: LensFit,
    /// The views with the board's points where they are.
    pub views: Vec<BoardView>,
    /// Covariance of the lens' numbers, 1.96 standard deviations being half a 95 % interval; held ones have none. `None` where the
    /// views do not determine it.
    pub covariance: Option<LensCovariance>,
    /// How far the board's points lie from its grid, standard deviations in its plane and out of it, mm.
    pub board_sd_mm: [f64; 2],
}

/// The state that is improved.
#[derive(Clone)]
struct State {
    lens: Lens,
    poses: Vec<Pose>,
    /// Where the board's points are, seen from their places on the grid.
    off_mm: Vec<Vector3<f64>>,
}

/// Standard deviations: of a place in the picture, and of the board's points in its plane and out of it.
#[derive(Clone, Copy)]
struct Spread {
    px: f64,
    board_mm: [f64; 2],
}

impl Spread {
    fn prior(&self) -> Vector3<f64> {
        let [plane, out] = self.board_mm.map(|s| s.powi(-2));
        Vector3::new(plane, plane, out)
    }

    /// The normal equations, without one of the views if asked for.
    fn normal(&self, sights: &[Vec<Sight>], state: &State, without: Option<usize>) -> Normal {
        Normal::of(sights, without, self.px.powi(-2), &self.prior(), &state.off_mm)
    }
}

struct Problem<'v> {
    views: &'v [BoardView],
    /// Each view's points' numbers.
    ids: Vec<Vec<usize>>,
    points: usize,
    free: [bool; LENS],
}

/// Improves a fit for which the board is exact. `free` are the lens' numbers that are not held.
pub(super) fn adjusted(views: &[BoardView], start: &LensFit, free: [bool; LENS]) -> Bundle {
    let mut numbers = HashMap::new();
    let mut number = |p: &Vector3<f64>| {
        let next = numbers.len();
        *numbers.entry([p.x.to_bits(), p.y.to_bits()]).or_insert(next)
    };
    let ids: Vec<Vec<usize>> =
        views.iter().map(|v| v.board_mm.iter().map(&mut number).collect()).collect();
    let problem = Problem { views, points: numbers.len(), ids, free };
    let mut state = State {
        lens: start.lens.clone(),
        poses: start.poses.clone(),
        off_mm: vec![Vector3::zeros(); problem.points],
    };
    let size_mm = problem.size_mm();
    let mut spread = problem.first_spread(&state, size_mm);
    for _ in 0..ROUNDS {
        problem.improve(&mut state, spread);
        let Some(next) = problem.seen_spread(&state, spread, size_mm) else { break };
        let change = (next.board_mm[0] / spread.board_mm[0]).ln().abs();
        spread = next;
        if change < 0.01 {
            break;
        }
    }
    problem.improve(&mut state, spread);
    let covariance = problem.covariance(&state, spread);
    Bundle {
        views: (0..views.len()).map(|v| problem.view(v, &state)).collect(),
        fit: LensFit { lens: state.lens, poses: state.poses },
        covariance,
        board_sd_mm: spread.board_mm,
    }
}

impl Problem<'_> {
    /// A view with the board's points where they are.
    fn view(&self, v: usize, state: &State) -> BoardView {
        let mut view = self.views[v].clone();
        view.board_mm.iter_mut().zip(&self.ids[v]).for_each(|(p, &id)| *p += state.off_mm[id]);
        view
    }

    /// Sum of the squares of all points' residuals, px².
    fn squares(&self, state: &State) -> f64 {
        let camera = state.lens.normalised();
        let of = |v| self.view(v, state).residuals(&camera, &state.poses[v]);
        (0..self.views.len()).flat_map(of).map(|r| r.norm_squared()).sum()
    }

    /// Numbers seen: two of each point of each view.
    fn count(&self) -> f64 {
        self.ids.iter().map(|ids| 2 * ids.len()).sum::<usize>() as f64
    }

    /// The board's diagonal.
    fn size_mm(&self) -> f64 {
        let places = || self.views.iter().flat_map(|v| &v.board_mm);
        let low = places().fold(Vector3::repeat(f64::INFINITY), |m, p| m.inf(p));
        let high = places().fold(Vector3::repeat(f64::NEG_INFINITY), |m, p| m.sup(p));
        (high - low).norm()
    }

    /// All of what is left is the pictures', and the print is as far off as that seen on the board.
    fn first_spread(&self, state: &State, size_mm: f64) -> Spread {
        let px = (self.squares(state) / self.count()).sqrt().max(1e-6);
        let distance_mm =
            state.poses.iter().map(|p| p.shift_mm.norm()).sum::<f64>() / state.poses.len() as f64;
        let mm = (px * distance_mm / state.lens.fx_px).max(LEAST_SHARE * size_mm);
        Spread { px, board_mm: [mm, 3.0 * mm] }
    }

    fn objective(&self, state: &State, spread: Spread) -> f64 {
        let prior = spread.prior();
        let board: f64 = state.off_mm.iter().map(|o| o.component_mul(o).dot(&prior)).sum();
        self.squares(state) / spread.px.powi(2) + board
    }

    /// Gauss-Newton steps, each halved until it helps.
    fn improve(&self, state: &mut State, spread: Spread) {
        let mut at = self.objective(state, spread);
        for _ in 0..STEPS {
            let normal = spread.normal(&self.sights(state), state, None);
            let Some(step) = normal.solve() else { return };
            let points = normal.points_step(&step);
            let tried = (0..6).find_map(|halved| {
                let share = 0.5_f64.powi(halved);
                let next = state.moved(&step, &points, share);
                let there = self.objective(&next, spread);
                (there < at).then_some((next, there))
            });
            let Some((next, there)) = tried else { return };
            *state = next;
            let drop = at - there;
            at = there;
            if drop < LEAST_DROP {
                return;
            }
        }
    }

    /// Everything's slopes at the state.
    fn sights(&self, state: &State) -> Vec<Vec<Sight>> {
        let camera = state.lens.normalised();
        let bent: Vec<[View; 2]> = (0..LENS)
            .map(|i| [STEP, -STEP].map(|by| state.lens.plus(&only(i, by)).normalised()))
            .collect();
        (0..self.views.len())
            .map(|v| {
                let (pose, view) = (&state.poses[v], self.view(v, state));
                let by_lens: Vec<_> = bent
                    .iter()
                    .map(|cameras| slope(cameras.each_ref().map(|c| view.residuals(c, pose))))
                    .collect();
                let of_pose = |i, by| view.residuals(&camera, &moved(pose, &only(i, by)));
                let by_pose: Vec<_> =
                    (0..POSE).map(|i| slope([STEP, -STEP].map(|by| of_pose(i, by)))).collect();
                let of_point = |i: usize, by: f64| {
                    let mut shifted = view.clone();
                    shifted.board_mm.iter_mut().for_each(|p| p[i] += by);
                    shifted.residuals(&camera, pose)
                };
                let by_point: Vec<_> =
                    (0..3).map(|i| slope([STEP, -STEP].map(|by| of_point(i, by)))).collect();
                let residuals = view.residuals(&camera, pose);
                let sight =
                    |(k, residual): (usize, &Vector2<f64>)| Sight {
                        point: self.ids[v][k],
                        residual: *residual,
                        by_lens: SMatrix::from_fn(|i, c| {
                            if self.free[i] { by_lens[i][k][c] } else { 0.0 }
                        }),
                        by_pose: SMatrix::from_fn(|i, c| by_pose[i][k][c]),
                        by_point: SMatrix::from_fn(|i, c| by_point[i][k][c]),
                    };
                residuals.iter().enumerate().map(sight).collect()
            })
            .collect()
    }

    /// Pictures' noise and print as what is left shows them.
    fn seen_spread(&self, state: &State, spread: Spread, size_mm: f64) -> Option<Spread> {
        let normal = spread.normal(&self.sights(state), state, None);
        let inverse = normal.inverse()?;
        let prior = spread.prior();
        let mut told = [0.0; 2];
        for point in &normal.points {
            let covariance = point.own + normal.beyond(&inverse, point);
            let share = |i: usize| 1.0 - covariance[(i, i)] * prior[i];
            told[0] += share(0) + share(1);
            told[1] += share(2);
        }
        let squares = |i: usize| state.off_mm.iter().map(|o| o[i] * o[i]).sum::<f64>();
        let least = LEAST_SHARE * size_mm;
        let sd = |squares: f64, told: f64| (squares / told.max(1e-9)).sqrt().max(least);
        let board_mm = [sd(squares(0) + squares(1), told[0]), sd(squares(2), told[1])];
        let free = self.free.iter().filter(|f| **f).count() + POSE * self.views.len();
        let dof = self.count() - free as f64 - told[0].max(0.0) - told[1].max(0.0);
        (dof > 1.0).then(|| Spread { px: (self.squares(state) / dof).sqrt().max(1e-6), board_mm })
    }

    /// How well the lens is known. By the jackknife over views: each in turn is left out (one linear step from the fit), and the lenses
    /// so found scatter as the lens does. The errors of a view's points have causes in common (its blur and tilt, the detector's
    /// windows), so a view counts as one witness, however many its points. What the views leave open of the board adds to it.
    fn covariance(&self, state: &State, spread: Spread) -> Option<LensCovariance> {
        let sights = self.sights(state);
        let views = self.views.len() as f64;
        let without = |v| {
            let step = spread.normal(&sights, state, Some(v)).solve()?;
            Some(step.fixed_rows::<LENS>(0).into_owned())
        };
        let steps: Option<Vec<SVector<f64, LENS>>> =
            (0..self.views.len()).into_par_iter().map(without).collect();
        let scatter: LensCovariance = steps?.iter().map(|step| step * step.transpose()).sum();
        let student = (k95(views - 1.0) / K95).powi(2);
        let scatter = scatter * ((views - 1.0) / views * student);
        let normal = spread.normal(&sights, state, None);
        let inverse = normal.inverse()?;
        let prior = spread.prior();
        let lens = inverse.rows(0, LENS).into_owned();
        let mut board = LensCovariance::zeros();
        for OfPoint { own, blocks, .. } in &normal.points {
            let mut pulls = SMatrix::<f64, LENS, 3>::zeros();
            for (r, block) in blocks {
                pulls += lens.columns(*r, block.nrows()) * block * own;
            }
            board += pulls * Matrix3::from_diagonal(&prior) * pulls.transpose();
        }
        let covariance = scatter + board;
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }
}

impl State {
    fn moved(&self, step: &DVector<f64>, points: &[Vector3<f64>], share: f64) -> Self {
        let mut next = self.clone();
        next.lens = next.lens.plus(&(step.fixed_rows::<LENS>(0) * share));
        for (v, pose) in next.poses.iter_mut().enumerate() {
            *pose = moved(pose, &(step.fixed_rows::<POSE>(LENS + POSE * v) * share));
        }
        next.off_mm.iter_mut().zip(points).for_each(|(off, step)| *off += step * share);
        next
    }
}

/// Of a central difference: pixels, millimetres, radians, distortion.
const STEP: f64 = 1e-5;

/// Central differences: what is seen a step ahead and a step behind.
fn slope([ahead, behind]: [Vec<Vector2<f64>>; 2]) -> Vec<Vector2<f64>> {
    ahead.iter().zip(behind).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()
}

/// One of some numbers changed.
fn only<const N: usize>(which: usize, by: f64) -> SVector<f64, N> {
    SVector::from_fn(|i, _| if i == which { by } else { 0.0 })
}

/// The pose turned and shifted a little.
fn moved(pose: &Pose, by: &SVector<f64, POSE>) -> Pose {
    let [turn, shift]: [Vector3<f64>; 2] = [0, 3].map(|at| by.fixed_rows::<3>(at).into());
    Pose { turn: Rotation3::new(turn) * pose.turn, shift_mm: pose.shift_mm + shift }
}
