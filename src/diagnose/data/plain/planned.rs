//! What could be measured next of an axis, a path or by burns.

use super::PlainExperiment;
use crate::diagnose::data::{evenly, pace_s, times_to_come};
use crate::diagnose::experiment::{PlannedCapture, Setting};
use crate::fit::robust::range;

/// Places of each column in planned captures.
const PLANNED_STEPS: usize = 7;

impl PlainExperiment {
    /// Captures that could be taken of one axis or path, which is named where it is not alone.
    pub(super) fn proposals_of(&self, series: usize, alone: bool) -> Vec<PlannedCapture> {
        let mut first = PlannedCapture::default();
        if let Some(name) = self.data.series_names.get(series).filter(|_| !alone) {
            first.0.insert(self.sort.series, Setting::Name(name.clone()));
        }
        let mut list = vec![first];
        for &name in self.sort.planned {
            let values = self.settings(name, series);
            if values.is_empty() {
                continue;
            }
            let with = |capture: &PlannedCapture| {
                let mut set: Vec<PlannedCapture> =
                    values.iter().map(|v| capture.clone().with(name, *v)).collect();
                // A path goes back the other way round.
                if capture.number("dir") == Some(-1.0) {
                    set.reverse();
                }
                set
            };
            list = list.iter().flat_map(with).collect();
        }
        list.retain(|capture| self.can_be(capture, series));
        list
    }

    /// Whether a screw can be at a capture's temperature then: right after the run it has not cooled.
    fn can_be(&self, capture: &PlannedCapture, series: usize) -> bool {
        /// Part of its range by which it may have.
        const COOLS: f64 = 0.1;
        let (t_s, screw_c) = (self.data.get("t_s"), self.data.get("screw_c"));
        let (Some(then_s), Some(then_c)) = (capture.number("t_s"), capture.number("screw_c"))
        else {
            return true;
        };
        let rows = self.data.rows_of(series);
        let last = rows.iter().copied().max_by(|a, b| t_s[*a].total_cmp(&t_s[*b]));
        let own: Vec<f64> = rows.iter().map(|row| screw_c[*row]).collect();
        let (low, high) = range(&own);
        let rests = then_s > range(t_s).1 + 2.0 * pace_s(t_s);
        rests || last.is_none_or(|row| then_c > screw_c[row] - COOLS * (high - low))
    }

    /// What a planned capture of an axis or path may set a column to: both directions, or places over its measured range.
    fn settings(&self, name: &str, series: usize) -> Vec<f64> {
        let d = &self.data;
        let column = d.get(name);
        if column.is_empty() {
            return Vec::new();
        }
        match name {
            "dir" => return vec![1.0, -1.0],
            "t_s" => return times_to_come(column),
            _ => {}
        }
        let own: Vec<f64> = d.rows_of(series).into_iter().map(|row| column[row]).collect();
        let (mut low, mut high) = range(if own.is_empty() { column } else { &own });
        if name == "b_deg" {
            // What B can do on one side it can do on the other.
            high = high.max(-low);
            low = -high;
        }
        if high == low && self.sort.widened.contains(&name) {
            // What never changed hides what it does: half as much of it shows that.
            low = 0.5 * high;
        }
        evenly(low, high, if high > low { PLANNED_STEPS } else { 1 })
    }
}
