//! One circle measured to the noise: from a rough circle in the plane to centre, radius and their covariance.

use nalgebra::{Matrix2, Vector2};

use crate::camera::View;
use crate::edge::{
    Band, Contour, LocateOptions, Located, Profiles, flatten, hide, lens_share, locate, scan,
};
use crate::fit::circle::{self, Circle};
use crate::fit::correlated::{self, Wander};
use crate::frame::Frame;
use crate::measure::rows::{final_weights, group_rows, robust_weights, textured_rows};

/// Groups of sectors the correlated fit works on: enough for the wander of any real edge.
const GROUPS: usize = 72;
/// Shading across a soft edge moves it by a part of its softness that no residual shows; this much of the softness beyond
/// [`SHARP_PX`] is added to the centre's standard uncertainty, unless the edge is seen to be the same all round.
const SOFT_EDGE: f64 = 0.003;
/// An edge this sharp is a lens's.
const SHARP_PX: f64 = 3.0;
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

/// Where the edge is looked for.
#[derive(Debug, Clone, Copy)]
pub struct Search {
    /// How far the edge may be from the rough circle.
    pub reach_px: f64,
    /// How far inside the circle pixels still belong to this edge.
    pub inside_limit_px: f64,
    /// How far outside the circle pixels still belong to this edge.
    pub outside_limit_px: f64,
    /// Softness of the edge (standard deviation), roughly.
    pub softness_px: f64,
}

impl Search {
    /// The same no farther than some softnesses from the edge, where a glare, a gap or dirt beside it leads astray.
    pub(super) fn nearby(self, softnesses: f64) -> Self {
        let side_px = softnesses * self.softness_px + self.reach_px;
        Self {
            inside_limit_px: self.inside_limit_px.min(side_px),
            outside_limit_px: self.outside_limit_px.min(side_px),
            ..self
        }
    }

    /// Width of the band either side: wide enough to know both levels well (a band of ±3 softnesses costs a
    /// third of the accuracy), and for the edge to be anywhere within reach.
    fn band_px(&self) -> (f64, f64) {
        let wide = (8.0 * self.softness_px).max(5.0) + self.reach_px;
        (wide.min(self.inside_limit_px), wide.min(self.outside_limit_px))
    }
}

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

impl Ring {
    /// The same for a mark whose edge is soft by itself: only as much blur as a lens in focus has is corrected. Which
    /// part of the softness is the lens', and where in it the mark ends, is not known: the radius is as uncertain.
    pub fn soft_by_itself(self) -> Self {
        let own_mm = self.own_blur_mm();
        let mut ring = self.perhaps_soft();
        ring.circle.radius -= own_mm;
        ring.blur_mm -= own_mm;
        ring
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

    /// Covariance of the centre, mm².
    pub fn center_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into()
    }
}

/// Edge points in the plane with their variances, before any circle is fitted.
#[derive(Debug, Clone)]
pub struct Points {
    /// Place in the plane, mm.
    pub place_mm: Vec<Vector2<f64>>,
    /// Variance along the edge's normal, mm².
    pub variance_mm2: Vec<f64>,
    /// Whether the sector shows a usable edge.
    pub usable: Vec<bool>,
    /// Place in the picture.
    pub place_px: Vec<Vector2<f64>>,
    /// The edges they come from.
    pub located: Located,
    /// Whether the whole circle is seen.
    pub closed: bool,
    /// Share of the whole circle that the contour spans.
    pub span: f64,
    /// Curvature radius of the contour, px.
    pub radius_px: f64,
    /// Size of a pixel in the plane, mm.
    pub pixel_mm: f64,
    /// The brightest that the camera can tell, where the picture holds it.
    pub clip: Option<f32>,
    /// Whether the inside of the edge is as bright as the camera can tell.
    pub clipped_inside: bool,
    /// Whether light clips what is outside.
    pub clipped_outside: bool,
    /// Whether the edge was told from its flank alone, as a clip hides the rest.
    pub of_flank: bool,
}

impl Points {
    /// How far the rim lies from what was found, in the plane: what a tint or shadow beside it has moved.
    fn tint_mm(&self) -> f64 {
        (self.located.step.rim_px - self.located.step.distance_px) * self.pixel_mm
    }

    /// Moves the places in the plane, seen from this centre, to the rim.
    pub(super) fn move_to_rim(&mut self, center: Vector2<f64>) {
        let tint_mm = self.tint_mm();
        for place in &mut self.place_mm {
            *place += (*place - center).normalize() * tint_mm;
        }
    }
}

/// How closely an edge is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    /// Most sectors along the contour.
    sectors: usize,
    /// Pixels joined each way, per pixel of softness.
    joined: f64,
    /// Rounds of the sectors' matches and their common profile.
    rounds: usize,
    /// Bins per pixel of softness.
    bins: f64,
}

/// All that the pixels say.
pub(super) const CLOSE: Effort =
    Effort { sectors: 2 * GROUPS, joined: 1.0 / 3.0, rounds: 4, bins: 4.0 };
/// The same where the pixels' noise is so small, and so many share a bin, that how they fall into it would matter.
const CLOSEST: Effort = Effort { bins: 8.0, ..CLOSE };
/// Such noise, as a part of the step, and the radius of such a contour.
const SMALL_NOISE: f64 = 0.01;
const LONG_PX: f64 = 200.0;
/// Where the band must lie, and how wide it must be.
pub(super) const GLANCE: Effort =
    Effort { sectors: GROUPS, joined: 1.0 / 2.0, rounds: 2, bins: 4.0 };

/// Number of sectors for a contour of this length: some pixels each, and enough for wander and gaps.
fn sectors_for(length_px: f64, softness_px: f64, most: usize) -> usize {
    ((length_px / (6.0f64).max(0.7 * softness_px)) as usize).clamp(24, most)
}

/// The edges of these profiles. Faint ones need wider sectors: a point must be surer than the edge is soft.
fn located(mut profiles: Profiles, contour: &Contour, effort: Effort) -> Option<Located> {
    // Gain, stretch and the common flank look much alike: they part slowly.
    let rounds = effort.rounds * if profiles.hidden.is_some() { 4 } else { 1 };
    let options = LocateOptions { rounds, ..LocateOptions::default() };
    let mut best = None;
    loop {
        let located = locate(&profiles, contour.closed, options);
        let sure =
            located.as_ref().is_some_and(|l| l.point_sd_px() < 0.2 * l.step.softness_px.max(0.7));
        best = located.or(best);
        if sure || profiles.sectors() < 48 {
            return best;
        }
        profiles = profiles.halved();
    }
}

/// The edge points about a rough circle. `None` where no edge can be located there.
pub(super) fn edge_points(
    frame: &Frame,
    view: &View,
    rough: Circle,
    search: Search,
    effort: Effort,
) -> Option<Points> {
    let contour = Contour::of_circle(view, rough.center, rough.radius)?;
    let softness = search.softness_px.max(0.6);
    let band = Band {
        inside_px: search.band_px().0.min(0.95 * contour.mean_radius_px()),
        outside_px: search.band_px().1,
        bin_px: (softness / effort.bins).max(0.25),
        sectors: sectors_for(contour.length_px(), softness, effort.sectors),
    };
    // Soft edges are as well read from a reduced picture, in a fraction of the time.
    let factor = (softness * effort.joined).floor().clamp(1.0, 8.0) as usize;
    let mut profiles = scan(frame, factor, &contour, band);
    let clip = profiles.clip();
    // Of a flank that goes on behind a clip the light's slope is in the sectors' gains. Only a lens's flank is known to be symmetric.
    let flanks = if softness < SHARP_PX { hide(&profiles) } else { None };
    let of_flanks = flanks.and_then(|flanks| located(flanks, &contour, effort));
    let of_flank = of_flanks.is_some();
    let edges = match of_flanks {
        Some(edges) => edges,
        None => {
            profiles.mask_glare();
            flatten(&mut profiles, &contour, softness);
            located(profiles, &contour, effort)?
        }
    };
    let mut points = Points {
        place_mm: Vec::new(),
        variance_mm2: Vec::new(),
        usable: Vec::new(),
        place_px: Vec::new(),
        closed: contour.closed,
        span: contour.span_rad / std::f64::consts::TAU,
        radius_px: contour.mean_radius_px(),
        pixel_mm: view.pixel_mm(),
        clip,
        clipped_inside: clip.is_some_and(|c| edges.step.inner > 0.97 * f64::from(c)),
        clipped_outside: clip.is_some_and(|c| edges.step.outer > 0.97 * f64::from(c)),
        of_flank,
        located: edges,
    };
    for e in &points.located.points {
        let pixel = contour.point(e.angle_rad, e.distance_px);
        let place = view.to_plane(pixel);
        let normal = (place - rough.center).normalize();
        // Variance along the plane's normal: pixels per mm along that direction.
        let per_mm = (view.px_per_mm(place) * normal).norm();
        points.place_mm.push(place);
        points.variance_mm2.push(e.variance_px2 / (per_mm * per_mm));
        points.usable.push(e.usable && e.variance_px2.is_finite());
        points.place_px.push(pixel);
    }
    Some(points)
}

/// Measures the circle near `rough`. `known` is what a longer edge has taught about wander.
pub fn measure(
    frame: &Frame,
    view: &View,
    rough: Circle,
    search: Search,
    known: Option<&Wander>,
) -> Option<Ring> {
    /// Looks at most, the last one a close one.
    const LOOKS: usize = 5;
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
        let points = edge_points(frame, view, guess, search, effort)?;
        let weights = robust_weights(&points);
        let pixel = 1.0 / view.px_per_mm(guess.center).determinant().abs().sqrt();
        let fitted = circle::robust(&points.place_mm, &weights, Some(guess), 0.02 * pixel)?;
        let moved = fitted.circle.apart(&guess) / pixel;
        guess = fitted.circle;
        let softness = points.located.step.softness_px;
        quiet = points.radius_px > LONG_PX
            && points.located.noise < SMALL_NOISE * points.located.step.contrast().abs();
        last = Some((points, fitted));
        let settled = moved < 0.25 * softness.max(0.5)
            && (0.85..1.18).contains(&(softness / search.softness_px));
        search.reach_px = (0.1 * softness).max(0.5);
        search.softness_px = softness.max(0.6);
        if settled && close {
            break;
        }
        close |= settled;
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
    let pixel_mm = view.mm_per_px(view.to_pixel(center)).determinant().abs().sqrt();
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
        let hidden = (step.softness_px * pixel_mm / TINT_MM).powi(2).min(1.0);
        let within_mm = soft_mm * SOFT_EDGE.hypot(LEANING * tint.min(MOST_TINT) * hidden);
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
