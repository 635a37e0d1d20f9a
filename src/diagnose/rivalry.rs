//! What captures say of a named effect against what could stand in its place, or would say if they were taken.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::classes::{PairInstead, Rival};
use crate::diagnose::experiment::PlannedCapture;
use crate::diagnose::fit::{Fitter, Model};
use crate::diagnose::noise::Space;
use crate::diagnose::parts::{Part, remove};
use crate::diagnose::pool::Who;
use crate::diagnose::select::Selection;

/// A named effect and its rival: another effect, or two.
pub type Of = (usize, Vec<usize>);

/// What some rows say of a named effect against a rival, in units of the noise: the squares of the difference of their
/// predictions, and what the rival's own parameters can take up of it.
#[derive(Debug, Clone)]
pub struct Evidence {
    squares: f64,
    along: DVector<f64>,
    information: DMatrix<f64>,
}

/// A named effect and a rival: what the data say, and what each proposed capture would.
pub struct Weighed {
    /// Named effect and rival.
    pub of: Of,
    /// What the data say.
    pub own: Evidence,
    /// What each capture would.
    pub proposals: Vec<Evidence>,
}

impl Weighed {
    /// χ² by which the rival would fit worse with the data and all of the captures.
    pub fn parted_by_all(&self) -> f64 {
        self.proposals.iter().fold(self.own.clone(), |sum, p| sum.plus(p)).separation()
    }
}

impl Evidence {
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            along: &self.along + &other.along,
            information: &self.information + &other.information,
        }
    }

    pub fn minus(&self, other: &Self) -> Self {
        Self {
            squares: self.squares - other.squares,
            along: &self.along - &other.along,
            information: &self.information - &other.information,
        }
    }

    /// χ² by which the rival would fit worse after it has been refitted.
    pub fn separation(&self) -> f64 {
        let taken = self.information.clone().cholesky().map(|c| c.solve(&self.along));
        (self.squares - taken.map_or(0.0, |t| t.dot(&self.along))).max(0.0)
    }
}

/// A named effect in each of its forms, and a rival refitted in its place.
pub struct Rivalry {
    /// Named effect and rival.
    pub of: Of,
    forms: Vec<Model>,
    other: Model,
}

/// Every named effect against the other names of its class, and against the two that together could stand in its place.
pub fn rivalries(
    fitter: &Fitter,
    selection: &Selection,
    classes: &[Vec<Rival>],
    pairs: &[Option<PairInstead>],
) -> Vec<Rivalry> {
    let f = &selection.fitted;
    // Shapes without a name are columns of the data at hand; they are the same on both sides.
    let plain = |model: Model| Model { extras: Vec::new(), ..model };
    let swapped = |i: usize, by: &Rival| -> Option<Model> {
        let Who::Effect(active) = &selection.library.candidates[by.candidate].who else {
            return None;
        };
        let mut swapped = remove(&f.model, Part::Effect(i));
        swapped.active.push(active.clone());
        Some(plain(fitter.fit(swapped, Some(&f.noise)).model))
    };
    let mut list = Vec::new();
    for (i, (class, pair)) in classes.iter().zip(pairs).enumerate() {
        let named = f.model.active[i].effect;
        // The named effect may be there in another form, which the rival must not be able to follow either.
        let (others, rivals): (Vec<&Rival>, Vec<&Rival>) =
            class.iter().partition(|r| r.effect == named);
        if rivals.is_empty() && pair.is_none() {
            continue;
        }
        let mut forms = vec![plain(f.model.clone())];
        forms.extend(others.iter().filter_map(|form| swapped(i, form)));
        list.extend(rivals.iter().filter_map(|r| {
            let (of, forms) = ((named, vec![r.effect]), forms.clone());
            Some(Rivalry { of, forms, other: swapped(i, r)? })
        }));
        list.extend(pair.iter().map(|two| {
            let of = (named, two.effects.to_vec());
            Rivalry { of, forms: forms.clone(), other: plain(two.model.clone()) }
        }));
    }
    list
}

/// What the data and each of some further captures say of each rivalry.
pub fn weigh(
    fitter: &Fitter,
    selection: &Selection,
    rivalries: &[Rivalry],
    captures: &[PlannedCapture],
) -> Vec<Weighed> {
    let experiment = fitter.experiment.with_plan(captures);
    let layout = experiment.layout();
    let space = Space::new(layout, &vec![true; layout.values.len()]);
    let plan = Fitter::new(experiment.as_ref(), space, fitter.given_mm);
    let before = layout.group_count() - captures.len();
    let noise = selection.fitted.noise.without_rim(&fitter.space);
    // A path of its own has a cup of its own.
    let there = |model: &Model| {
        let mut model = model.clone();
        let new = experiment.nuisances().iter().skip(model.nuisances.len());
        model.nuisances.extend(new.map(|p| p.start));
        model
    };
    let mut list = Vec::new();
    for rivalry in rivalries {
        let other = there(&rivalry.other);
        let predicted = plan.predict(&other);
        let mut tangent = plan.whiten(&plan.tangent(&other, &predicted), &noise);
        for mut column in tangent.column_iter_mut() {
            let norm = column.norm();
            column /= if norm > 0.0 { norm } else { 1.0 };
        }
        for form in rivalry.forms.iter().map(|form| plan.predict(&there(form))) {
            let d = DMatrix::from_fn(form.len(), 1, |r, _| form[r] - predicted[r]);
            let d = plan.whiten(&d, &noise);
            let evidence = |rows: Vec<usize>| {
                let (j, d) = (tangent.select_rows(&rows), d.select_rows(&rows));
                Evidence {
                    squares: d.norm_squared(),
                    along: j.tr_mul(&d).column(0).into_owned(),
                    information: j.tr_mul(&j),
                }
            };
            let mut own = evidence(plan.space.rows_of(&|g| g < before));
            // Parameters that the data do not determine must not make the system singular.
            (0..own.information.nrows()).for_each(|k| own.information[(k, k)] += 1e-9);
            let of = |k: usize| evidence(plan.space.rows_of(&|g| g == before + k));
            let proposals = (0..captures.len()).map(of).collect();
            list.push(Weighed { of: rivalry.of.clone(), own, proposals });
        }
    }
    list
}
