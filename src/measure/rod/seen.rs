//! Which captures and table angles are measured: those whose captures show the rim where the others put it. One that does not is left out where enough
//! remain.

use super::Capture;
use super::follow::Followed;
use crate::error::{Error, Result};
use crate::fit::robust::median;

/// Share of a capture's edge that one of each table angle's must have on the circle, and another of several.
const LEAST_SEEN: f64 = 0.35;
const LEAST_SECOND: f64 = 0.2;
/// Table angles that show by themselves whether the rod turns about one axis: two centres lie on a circle about some axis always.
const TURNING: usize = 3;
/// Share of the captures that must agree where a table angle is left to one capture of several, or out: of half and half nobody knows which
/// is right.
const MAJORITY: f64 = 2.0 / 3.0;

/// Where a capture has less than this part of what the one in the middle has on the circle, it is another edge that crosses it.
const CROSSING: f64 = 1.0 / 3.0;

/// Captures that show another edge than the rim for the most part, where their table angle has enough without them.
pub(super) fn strays(captures: usize, angle_of: &[usize], followed: &Followed) -> Vec<usize> {
    let shares = shares(captures, followed);
    let angles = followed.robust.centers.len();
    let few = CROSSING * median(&mut shares.clone());
    let others = |angle: usize| {
        shares.iter().zip(angle_of).filter(|(share, a)| **a == angle && **share >= few).count()
    };
    let enough = if angles < TURNING { 2 } else { 1 };
    let stray = |i: &usize| shares[*i] > 0.0 && shares[*i] < few && others(angle_of[*i]) >= enough;
    (0..captures).filter(stray).collect()
}

/// The table angles that are measured.
pub(super) struct Seen<'f> {
    /// The rim's edge at these angles, which it has the numbers of.
    pub followed: Followed<'f>,
    /// These angles.
    pub c_deg: Vec<f64>,
    /// Which of them each capture has.
    pub angle_of: Vec<Option<usize>>,
}

/// Leaves out the table angles at which the rim is not seen. Too few that remain are refused: of one capture of several at an angle nobody
/// knows, where no other angle tells, whether it shows the rim or the chamfer.
pub(super) fn seen<'f>(
    captures: &[Capture],
    (c_deg, angle_of): (&[f64], &[usize]),
    mut followed: Followed<'f>,
) -> Result<Seen<'f>> {
    let shares = shares(captures.len(), &followed);
    let most = |angle: usize| {
        let own = shares.iter().zip(angle_of).filter(|(_, a)| **a == angle);
        own.map(|(share, _)| *share).fold(0.0, f64::max)
    };
    let kept: Vec<usize> = (0..c_deg.len()).filter(|&a| most(a) >= LEAST_SEEN).collect();
    let agreeing = shares.iter().filter(|share| **share > LEAST_SECOND).count();
    if kept.len() < TURNING || (agreeing as f64) < MAJORITY * captures.len() as f64 {
        for angle in 0..c_deg.len() {
            check(captures, &shares, angle_of, angle)?;
        }
    }
    let number = |angle: usize| kept.iter().position(|a| *a == angle);
    let is_kept: Vec<bool> = followed.arcs.iter().map(|a| number(a.angle).is_some()).collect();
    let (mut of_arcs, mut of_weights) = (is_kept.iter(), is_kept.iter());
    followed.arcs.retain(|_| *of_arcs.next().unwrap_or(&false));
    followed.robust.weights.retain(|_| *of_weights.next().unwrap_or(&false));
    followed.arcs.iter_mut().for_each(|a| a.angle = number(a.angle).unwrap_or_default());
    followed.robust.centers = kept.iter().map(|&a| followed.robust.centers[a]).collect();
    let angle_of = angle_of.iter().map(|&a| number(a)).collect();
    let c_deg = kept.into_iter().map(|a| c_deg[a]).collect();
    Ok(Seen { followed, c_deg, angle_of })
}

/// Share of each capture's edge that lies on the circle.
fn shares(captures: usize, followed: &Followed) -> Vec<f64> {
    let mut shares = vec![0.0; captures];
    for (arc, weights) in followed.arcs.iter().zip(&followed.robust.weights) {
        let used = weights.iter().filter(|w| **w > 0.0).count();
        shares[arc.capture] = used as f64 / weights.len().max(1) as f64;
    }
    shares
}

/// Refuses a table angle whose captures show hardly any edge on the common circle, or of whose captures one alone does: its centre
/// would be made of what is left.
fn check(captures: &[Capture], shares: &[f64], angle_of: &[usize], angle: usize) -> Result<()> {
    let own = || (0..captures.len()).filter(|&i| angle_of[i] == angle);
    let names = |keep: &dyn Fn(f64) -> bool| {
        let some = own().filter(|&i| keep(shares[i])).map(|i| captures[i].image.as_str());
        some.collect::<Vec<_>>().join(", ")
    };
    let most = own().map(|i| shares[i]).fold(0.0, f64::max);
    let trouble = if most < LEAST_SEEN {
        format!(
            "hardly any of the edges in {} lies on the rod's circle ({:.0} % at most)",
            names(&|_| true),
            100.0 * most
        )
    } else if own().count() > 1 && own().filter(|&i| shares[i] > LEAST_SECOND).count() == 1 {
        format!(
            "only one of the {} shows the rim where the rod's circle is: {} does, not {}",
            own().count(),
            names(&|share| share > LEAST_SECOND),
            names(&|share| share <= LEAST_SECOND)
        )
    } else {
        return Ok(());
    };
    let c_deg = own().next().map_or(0.0, |i| captures[i].c_deg);
    Err(Error::measure(
        format!("the captures at C = {c_deg}°"),
        trouble,
        "check their x_mm, y_mm and c_deg, add captures at this angle that show the rim clearly, or leave these out",
    ))
}
