//! One capture at a position that was misread or mistyped: without it all others agree far better.

use nalgebra::{DMatrix, DVector};

use super::joint::{Arc, Joint};

/// Captures that disagree by less, root mean square, are where machines put them.
const LEAST_MM: f64 = 0.005;
/// Without the one at fault the others disagree by less than this part of it, and by this part of what they do without any other.
const BETTER: f64 = 0.25;
/// Arcs of which one can be told from the others.
const LEAST_ARCS: usize = 5;
/// Groups of an arc's points.
const GROUPS: usize = 10;

/// One group of an arc's points: its row of the design (centre x, y of every angle, radius), and how far outside the common circle it lies.
struct Group {
    arc: usize,
    row: Vec<f64>,
    off_mm: f64,
}

/// The capture at fault, if there is one.
pub(super) fn at_fault(arcs: &[Arc], joint: &Joint) -> Option<usize> {
    if arcs.len() < LEAST_ARCS {
        return None;
    }
    let groups: Vec<Group> =
        arcs.iter().enumerate().flat_map(|(k, arc)| of_arc(k, arc, joint)).collect();
    let all = disagreement(&groups, None)?;
    if all < LEAST_MM {
        return None;
    }
    let mut without: Vec<(f64, usize)> =
        (0..arcs.len()).filter_map(|k| Some((disagreement(&groups, Some(k))?, k))).collect();
    without.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [(least, at), (second, _), ..] = without[..] else { return None };
    (least < BETTER * all && least < BETTER * second).then(|| arcs[at].capture)
}

fn of_arc(k: usize, arc: &Arc, joint: &Joint) -> Vec<Group> {
    let circle = joint.put(arc);
    let count = arc.points.place_mm.len();
    let group = |g: usize| {
        let (mut row, mut off, mut n) = (vec![0.0; 2 * joint.centers.len() + 1], 0.0, 0.0);
        for i in g * count / GROUPS..(g + 1) * count / GROUPS {
            if joint.weights[k][i] > 0.0 {
                let place = arc.points.place_mm[i];
                let out = (place - circle.center).normalize();
                row[2 * arc.angle] += out.x;
                row[2 * arc.angle + 1] += out.y;
                off += circle.distance(place);
                n += 1.0;
            }
        }
        row.iter_mut().for_each(|v| *v /= n);
        row[2 * joint.centers.len()] = 1.0;
        (n > 0.0).then_some(Group { arc: k, row, off_mm: off / n })
    };
    (0..GROUPS).filter_map(group).collect()
}

/// Root mean square by which the arcs miss one circle, all but one of them. `None` where they determine none.
fn disagreement(groups: &[Group], without: Option<usize>) -> Option<f64> {
    let kept: Vec<&Group> = groups.iter().filter(|g| Some(g.arc) != without).collect();
    let columns = kept.first()?.row.len();
    if kept.len() <= columns {
        return None;
    }
    let design = DMatrix::from_fn(kept.len(), columns, |r, c| kept[r].row[c]);
    let off = DVector::from_fn(kept.len(), |r, _| kept[r].off_mm);
    let solved = design.tr_mul(&design).cholesky()?.solve(&design.tr_mul(&off));
    let left = off - design * solved;
    Some((left.norm_squared() / (kept.len() - columns) as f64).sqrt())
}
