//! One circle measured to the noise: from a rough circle in the plane to centre, radius and their covariance.

use nalgebra::{Matrix2, Vector2};

use crate::camera::View;
use crate::edge::lens_share;
use crate::fit::circle::{self, Circle};
use crate::fit::correlated::{self, Wander};
use crate::frame::Frame;
use crate::measure::points::{
    CLOSE, CLOSEST, GLANCE, GROUPS, Points, SHARP_PX, Search, edge_points,
};
use crate::measure::rows::{final_weights, group_rows, robust_weights, textured_rows};

/// Shading across a soft edge moves it by a part of its softness that no residual shows; this much of the softness beyond
/// [`SHARP_PX`] is added to the centre's standard uncertainty, unless the edge is seen to be the same all round.
const SOFT_EDGE: f64 = 0.003;
/// So does a heat tint that is stronger on one side, where it lies within the edge: how strong it is shows in what of it fades beyond
/// the rim, and this many times that part of the softness is added, less for sharper edges.
const LEANING: f64 = 2.3;
/// A tint goes on over some tenths of a millimetre. In an edge sharper than this it shows as a level beside it, not as a shift.
const TINT_MM: f64 = 0.1;
/// What goes on farther than this beyond the rim, as a part of its step, is no longer tint.
const MOST_TINT: f64 = 0.2;
/// What fades beyond the rim, more on one side, is taken out by a shape that it only roughly has: this part of what it would have
/// shifted is left.
const LEFT: f64 = 0.2;
/// What a texture leaves unknown of an edge all round, it does to a sector's profile so many times as much: that is no form.
const TEXTURED: f64 = 3.0;
/// Where light clips one side nobody knows how far it would have gone, nor where it would have gone farther: by this part of the softness
/// the half level may have moved on one side (0.25 where the light is a fifth beyond the top and as much less on the other side).
const CLIPPED: f64 = 0.25;
/// An edge as sharp as a lens's moves less by what a clip hides, and is told from its flank where that can be: centre and radius are off by these
/// parts of the softness (standard deviations; where the flank tells, and where not).
const CLIPPED_SHARP: [(f64, f64); 2] = [(0.05, 0.15), (0.12, 0.35)];
/// How much of all that a radius may be off besides what is known of its tint.
const EVEN: f64 = 0.7;

/// A circle measured in the plane.
#[derive(Debug, Clone)]
pub struct Ring {
    /// Centre and radius in plane mm.
    pub circle: Circle,
    /// Covariance of centre x, y and radius, mm².
    pub covariance: nalgebra::Matrix3<f64>,
    /// Degrees of freedom of that covariance.
    pub dof: f64,
    /// Standard deviation of the centre, both ways together, as far as the edge's points tell it.
    pub fitted_sd_mm: f64,
    /// Centre as it is seen in the picture.
    pub center_px: Vector2<f64>,
    /// Root mean square of the edge's own form (residuals of the groups), mm.
    pub form_rms_mm: f64,
    /// How much of that may be the surface's texture's (rms), mm.
    pub form_from_texture_mm: f64,
    /// Edge points used.
    pub edge_points: usize,
    /// Share of the circle on which the edge was found.
    pub arc_coverage: f64,
    /// Outer minus inner level, counts.
    pub contrast: f64,
    /// Pixel noise about the edge model, counts.
    pub noise: f64,
    /// Step of the middle sector as a part of the sectors' common profile: about 1. More of a faint edge is each sector's own noise, less
    /// means that most of what was used shows no edge.
    pub gain: f64,
    /// Diameter of another edge that shows where this one does not, as light comes from one side.
    pub other_mm: Option<f64>,
    /// Softness of the edge, px.
    pub softness_px: f64,
    /// What was added to the radius because a blurred disc's half level lies inside its rim, mm.
    pub blur_mm: f64,
    /// Whether the inside is as bright as the camera can tell: glare, if the circle is not whole.
    pub clipped_inside: bool,
    /// Whether light clips what is outside.
    pub clipped_outside: bool,
    /// What the edge teaches about how edges wander on this part.
    pub wander: Wander,
    /// Edge points in the picture, for the overlay: place and whether it was used.
    pub trace: Vec<(Vector2<f64>, bool)>,
    /// Residuals by group: angle in the plane (rad), residual (mm).
    pub residuals: Vec<(f64, f64)>,
}

/// A circle seen in the picture, px, in the plane, mm.
pub(super) fn in_plane(view: &View, seen: Circle) -> Circle {
    let radius = seen.radius * view.pixel_mm_at(seen.center);
    Circle { center: view.to_plane(seen.center), radius }
}

impl Ring {
    /// The circle as it is seen in the picture, px.
    pub fn seen(&self, view: &View) -> Circle {
        let radius = self.circle.radius / view.pixel_mm_at(self.center_px);
        Circle { center: self.center_px, radius }
    }

    /// The same for a mark whose edge is soft by itself: only as much blur as a lens in focus has is corrected. Which
    /// part of the softness is the lens', and where in it the mark ends, is not known: the radius is as uncertain.
    pub fn soft_by_itself(self) -> Self {
        let own_mm = self.own_blur_mm();
        let mut ring = self.perhaps_soft();
        ring.circle.radius -= own_mm;
        ring.blur_mm -= own_mm;
        ring
    }

    /// The same for an edge with bands of tint about it, so strong as a part of its step: the first of them lies within it.
    pub(super) fn banded(mut self, share: f64, pixel_mm: f64) -> Self {
        let moved_mm = tint_sd_mm(share, self.softness_px, pixel_mm);
        (0..2).for_each(|i| self.covariance[(i, i)] += moved_mm * moved_mm);
        self.covariance[(2, 2)] += (EVEN * moved_mm).powi(2);
        self
    }

    /// Whether bands of tint, as strong as they come, would widen what is known of its place.
    pub(super) fn may_hide_tint(&self, pixel_mm: f64) -> bool {
        /// Of what is known (standard deviations).
        const MATTERS: f64 = 0.2;
        let sd_mm = self.center_covariance().trace().sqrt();
        tint_sd_mm(MOST_TINT, self.softness_px, pixel_mm) > MATTERS * sd_mm
    }

    /// The same for an edge that may be out of focus or soft by itself: the radius is as uncertain as for the latter.
    pub fn perhaps_soft(mut self) -> Self {
        /// A soft edge's rim may be out of place by this part of its softness (standard deviation), and the more the more ragged
        /// it is: a ragged edge's tint cannot be told from its raggedness.
        const LEAST: f64 = 0.03;
        const RAGGED: f64 = 0.9;
        const MOST_RAGGED: f64 = 0.2;
        let own_mm = self.own_blur_mm();
        let softness_mm = (2.0 * self.circle.radius * self.blur_mm).max(0.0).sqrt();
        let ragged = (self.form_rms_mm / softness_mm.max(1e-9)).min(MOST_RAGGED);
        let tinted_mm =
            (LEAST + RAGGED * ragged) * softness_mm * (1.0 - lens_share(self.softness_px));
        self.covariance[(2, 2)] += own_mm * own_mm / 3.0 + tinted_mm * tinted_mm;
        self
    }

    /// The part of the blur's correction that is right only if the lens made all of the blur.
    fn own_blur_mm(&self) -> f64 {
        self.blur_mm * (1.0 - lens_share(self.softness_px).powi(2))
    }

    /// What a user should know where light clips one side of the edge; `name` is the circle's.
    pub(super) fn clip_warning(&self, name: &str) -> Option<String> {
        (self.clipped_inside || self.clipped_outside).then(|| {
            format!(
                "light clips the picture beside the {name}'s edge: where that is is less sure; expose less"
            )
        })
    }

    /// Covariance of the centre, mm².
    pub fn center_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into()
    }
}

/// Measures the circle near `rough`. `known` is what a longer edge has taught about wander.
pub fn measure(
    frame: &Frame,
    view: &View,
    rough: Circle,
    search: Search,
    known: Option<&Wander>,
) -> Option<Ring> {
    measure_if(frame, view, rough, search, known, &|_| true)
}

/// The same as long as what is seen is `worth` a closer look.
pub(super) fn measure_if(
    frame: &Frame,
    view: &View,
    rough: Circle,
    search: Search,
    known: Option<&Wander>,
    worth: &dyn Fn(&Points) -> bool,
) -> Option<Ring> {
    /// Looks at most, the last one a close one.
    const LOOKS: usize = 5;
    /// How much softer than expected an edge may be that one glance has told well enough.
    const NEAR: std::ops::Range<f64> = 0.5..2.0;
    let mut guess = rough;
    let mut search = search;
    let (mut close, mut quiet, mut last) = (false, false, None);
    for look in 1..=LOOKS {
        close |= look == LOOKS;
        let effort = match (close, quiet) {
            (true, true) => CLOSEST,
            (true, false) => CLOSE,
            (false, _) => GLANCE,
        };
        let points = edge_points(frame, view, guess, search, effort, None)?;
        if !worth(&points) {
            return None;
        }
        let weights = robust_weights(&points);
        let pixel = 1.0 / view.px_per_mm(guess.center).determinant().abs().sqrt();
        let fitted = circle::robust(&points.place_mm, &weights, Some(guess), 0.02 * pixel)?;
        let moved = fitted.circle.apart(&guess) / pixel;
        guess = fitted.circle;
        let softness = points.located.step.softness_px;
        quiet = points.are_quiet();
        last = Some((points, fitted));
        let softer = softness / search.softness_px;
        let settled = moved < 0.25 * softness.max(0.5) && (0.85..1.18).contains(&softer);
        search.reach_px = (0.1 * softness).max(0.5);
        search.softness_px = softness.max(0.6);
        if settled && close {
            break;
        }
        // A glance that was not led far has seen where to look closely.
        close |= moved < softness.max(0.5) && NEAR.contains(&softer);
    }
    let (points, fitted) = last?;
    let weights = final_weights(&points, &fitted);
    let sectors = group_rows(&points, &weights, fitted.circle, GROUPS);
    let together = textured_rows(frame, view, &points, fitted.circle, search);
    let fit = correlated::fit(together.as_ref().unwrap_or(&sectors), known)?;
    // Where the step comes and goes it is not texture that moves it.
    let textured = together.as_ref().filter(|_| points.located.is_even());
    let form_from_texture_mm = TEXTURED * textured.map_or(0.0, typical_variance).sqrt();
    let ring = finish(view, &points, fitted.circle, &weights, &sectors, fit, known.is_some());
    Some(Ring { form_from_texture_mm, ..ring })
}

/// How far a tint of that share of the step may have moved an edge that it lies within (standard deviation).
fn tint_sd_mm(share: f64, softness_px: f64, pixel_mm: f64) -> f64 {
    let hidden = (softness_px * pixel_mm / TINT_MM).powi(2).min(1.0);
    let soft_mm = (softness_px - SHARP_PX).max(0.0) * pixel_mm;
    LEANING * share.min(MOST_TINT) * hidden * soft_mm
}

/// Variance of a typical row.
fn typical_variance(rows: &correlated::Rows) -> f64 {
    rows.variance.len() as f64 / rows.variance.iter().map(|v| 1.0 / v).sum::<f64>()
}

/// How far the half level of a disc blurred by `sigma_px` lies inside its rim: σ²/2R, and for small discs what a straight edge fitted to the
/// blurred disc's exact profile gets wrong besides (to 0.3 % of it up to σ = 0.32 `seen_px`, the half level's radius).
fn blur_px(sigma_px: f64, seen_px: f64) -> f64 {
    let q2 = (sigma_px / seen_px).powi(2).min(0.1);
    sigma_px * sigma_px / (2.0 * seen_px) * (1.0 - q2 * (0.456 + q2 * (1.515 + q2 * 7.44)))
}

/// What the correlated fit about a circle says of the edge, its form in the sectors included.
fn finish(
    view: &View,
    points: &Points,
    about: Circle,
    weights: &[f64],
    sectors: &correlated::Rows,
    fit: correlated::Fit,
    is_spot: bool,
) -> Ring {
    let center = about.center + Vector2::new(fit.beta[0], fit.beta[1]);
    let residuals = &sectors.y - &sectors.design * &fit.beta;
    // Faint sectors are noise more than form: they count by what they know.
    let known: f64 = sectors.variance.iter().map(|v| 1.0 / v).sum();
    let form = residuals.iter().zip(&sectors.variance).map(|(r, v)| r * r / v).sum::<f64>() / known;
    let pixel_mm = view.pixel_mm_at(view.to_pixel(center));
    let seen_px = (about.radius + fit.beta[2]) / pixel_mm;
    let step = points.located.step;
    let blur_mm = blur_px(step.softness_px, seen_px) * pixel_mm;
    let tint_mm = points.tint_mm();
    let mut covariance = nalgebra::Matrix3::zeros();
    covariance.copy_from(&fit.covariance);
    let fitted_sd_mm = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    covariance[(2, 2)] += (step.rim_sd_px * pixel_mm).powi(2);
    let is_clipped = points.clipped_inside || points.clipped_outside;
    if is_clipped || points.of_flank {
        let (center, radius) = CLIPPED_SHARP[usize::from(!points.of_flank)];
        let sharp_mm = step.softness_px.min(SHARP_PX) * pixel_mm;
        (0..2).for_each(|i| covariance[(i, i)] += (center * sharp_mm).powi(2));
        covariance[(2, 2)] += (radius * sharp_mm).powi(2);
    }
    if !points.located.plain {
        let soft_mm = (step.softness_px - SHARP_PX).max(0.0) * pixel_mm;
        // A ring's tint lies on either side, a spot's outside: inside it goes on by its own dome.
        let [inside, outside] = step.fades.map(f64::abs);
        let tint = if is_spot { outside } else { outside.max(inside) };
        let within_mm = (SOFT_EDGE * soft_mm).hypot(tint_sd_mm(tint, step.softness_px, pixel_mm));
        let clipped = if is_clipped { CLIPPED } else { 0.0 };
        let unseen_mm =
            within_mm.hypot(LEFT * points.located.leaning_px * pixel_mm).hypot(clipped * soft_mm);
        (0..2).for_each(|i| covariance[(i, i)] += unseen_mm * unseen_mm);
        covariance[(2, 2)] += (EVEN * unseen_mm).powi(2);
    }
    let used = weights.iter().filter(|w| **w > 0.0).count();
    Ring {
        circle: Circle { center, radius: about.radius + fit.beta[2] + blur_mm + tint_mm },
        covariance,
        dof: fit.dof,
        fitted_sd_mm,
        center_px: view.to_pixel(center),
        form_rms_mm: form.sqrt(),
        form_from_texture_mm: 0.0,
        edge_points: used,
        gain: points.located.gains[1],
        other_mm: None,
        arc_coverage: points.span * used as f64 / points.usable.len() as f64,
        contrast: step.contrast(),
        noise: points.located.noise,
        softness_px: step.softness_px,
        blur_mm,
        clipped_inside: points.clipped_inside,
        clipped_outside: points.clipped_outside,
        wander: fit.wander,
        trace: points.place_px.iter().zip(weights).map(|(p, w)| (*p, *w > 0.0)).collect(),
        residuals: sectors
            .place
            .iter()
            .zip(&residuals)
            .map(|(p, r)| ((p - about.center).y.atan2((p - about.center).x), *r))
            .collect(),
    }
}
