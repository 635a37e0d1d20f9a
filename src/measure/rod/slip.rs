//! One capture at a position that was misread or mistyped: without it all others agree far better.

use nalgebra::{DMatrix, DVector};

use super::joint::{Arc, Joint};
use crate::fit::least_squares::transposed_times;
use crate::measure::rows::group_rows;

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
    let rows = group_rows(&arc.points, &joint.weights[k], joint.put(arc), GROUPS);
    let group = |i: usize| {
        let mut row = vec![0.0; 2 * joint.centers.len() + 1];
        row[2 * arc.angle] = rows.design[(i, 0)];
        row[2 * arc.angle + 1] = rows.design[(i, 1)];
        row[2 * joint.centers.len()] = rows.design[(i, 2)];
        Group { arc: k, row, off_mm: rows.y[i] }
    };
    (0..rows.y.len()).map(group).collect()
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
    let solved = transposed_times(&design, &design).cholesky()?.solve(&design.tr_mul(&off));
    let left = off - design * solved;
    Some((left.norm_squared() / (kept.len() - columns) as f64).sqrt())
}
