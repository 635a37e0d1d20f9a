//! Errors that repeat with every turn of an axis' screw.

use nalgebra::DMatrix;

use crate::diagnose::algebra::orthonormal;
use crate::diagnose::experiment::{Parameter, Scan};

/// Waves in a turn of a screw: its error is seldom a pure one.
pub(super) const CYCLE_WAVES: usize = 2;
/// What a cycle gets back of the price of having several forms, nats: its further wave pays by its parameters.
pub(super) const PURE_WAVE: f64 = std::f64::consts::LN_2;

/// Parameters of an error that repeats with every turn of a screw.
pub(super) fn cycle(waves: usize, typical_mm: f64, pitches_mm: &[f64]) -> Vec<Parameter> {
    let names = ["cos_mm", "sin_mm", "cos2_mm", "sin2_mm"];
    let linear = names[..2 * waves].iter().map(|name| Parameter::linear(*name, typical_mm));
    linear.chain([Parameter::shape("pitch_mm", pitches_mm)]).collect()
}

/// Different places along an axis, in order; nearer ones than `apart_mm` are one.
pub(super) fn levels(mut places_mm: Vec<f64>, apart_mm: f64) -> Vec<f64> {
    places_mm.sort_by(f64::total_cmp);
    places_mm.dedup_by(|next, kept| *next - *kept < apart_mm);
    places_mm
}

/// Whether a cycle of such a pitch shows at these places: its cosine and sine beside a constant and a slope, in every phase.
pub(super) fn tells_cycle(places_mm: &[f64], pitch_mm: f64) -> bool {
    cycles_told(places_mm)(pitch_mm)
}

/// The same for many pitches.
fn cycles_told(places_mm: &[f64]) -> impl Fn(f64) -> bool {
    /// Places that a constant, a slope and a cycle need at least.
    const FEWEST: usize = 5;
    /// Part of a full cycle's square that has to be left in its weakest phase.
    const LEAST: f64 = 0.1;
    let n = places_mm.len();
    let line = DMatrix::from_fn(n, 2, |row, c| if c == 0 { 1.0 } else { places_mm[row] });
    let basis = orthonormal(&line, 1e-9);
    move |pitch_mm| {
        if n < FEWEST {
            return false;
        }
        let turn = |row: usize| std::f64::consts::TAU * places_mm[row] / pitch_mm;
        let of = |(row, c)| if c == 0 { f64::cos(turn(row)) } else { f64::sin(turn(row)) };
        let wave = DMatrix::from_fn(n, 2, |row, c| of((row, c)));
        let left = &wave - &basis * basis.tr_mul(&wave);
        let squares = left.tr_mul(&left).symmetric_eigenvalues();
        squares.min() > LEAST * 0.5 * n as f64
    }
}

/// The pitches to look through of an axis that goes so far by these places.
pub(super) fn pitches(places_mm: &[f64], travel_mm: f64) -> Scan {
    /// Pitches that screws have.
    const SHORTEST_MM: f64 = 2.0;
    const LONGEST_MM: f64 = 40.0;
    /// Turns that make a bend a cycle.
    const FEWEST_TURNS: f64 = 3.0;
    /// Places in a turn, about.
    const FEWEST_PLACES: f64 = 1.0;
    /// Pitches for each turn more on the travel: halfway between two of them a wave keeps four fifths of its square.
    const FINENESS: f64 = 2.0;
    /// Independent ones for each turn more: the highest peak of noise is as likely to be high as that of so many (Baluev 2008).
    const INDEPENDENT: f64 = 4.0;
    let shortest_mm = (FEWEST_PLACES * travel_mm / places_mm.len().max(1) as f64).max(SHORTEST_MM);
    let longest_mm = (travel_mm / FEWEST_TURNS).min(LONGEST_MM);
    let turns = travel_mm / shortest_mm - travel_mm / longest_mm;
    if turns.is_nan() || turns <= 0.0 {
        return Scan::default();
    }
    let is_told = cycles_told(places_mm);
    let of_turns = |k: usize| travel_mm / (travel_mm / shortest_mm - k as f64 / FINENESS);
    let values = (0..=(FINENESS * turns) as usize).map(of_turns).filter(|p| is_told(*p)).collect();
    Scan { values, turns_over: travel_mm, nats: (INDEPENDENT * turns).max(1.0).ln() }
}

/// The error with such parameters at a place along the axis, mm. A pitch longer than `longest_mm` is not seen as a cycle.
pub(super) fn cycle_mm(p: &[f64], place_mm: f64, longest_mm: f64) -> f64 {
    let (pitch_mm, waves) = (p[p.len() - 1].min(longest_mm), &p[..p.len() - 1]);
    let turn = std::f64::consts::TAU * place_mm / pitch_mm;
    let wave = |(k, w): (usize, &[f64])| {
        let (s, c) = ((k + 1) as f64 * turn).sin_cos();
        w[0] * c + w[1] * s
    };
    waves.chunks_exact(2).enumerate().map(wave).sum()
}
