//! The edge points about a rough circle, in the plane with their variances, before any circle is fitted.

use nalgebra::Vector2;

use crate::camera::View;
use crate::edge::{
    Band, Contour, Levels, LocateOptions, Located, Lost, Profiles, Slope, even_out, flatten, hide,
    locate, scan,
};
use crate::find::Light;
use crate::fit::Circle;
use crate::frame::Frame;

/// Groups of sectors the correlated fit works on: enough for the wander of any real edge.
pub(super) const GROUPS: usize = 72;
/// An edge this sharp is a lens's.
pub(super) const SHARP_PX: f64 = 3.0;

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
    /// Whether heat may have tinted the surface beside it, more on one side than on the other, as beside what is burnt.
    pub tinted: bool,
    /// The picture's light, where it falls off farther than a slope across this edge tells.
    pub light: Option<Light>,
}

impl Search {
    /// The same beside a mark that is burnt, in a picture's light.
    pub(super) fn burnt(self, light: Option<Light>) -> Self {
        Self { tinted: true, light, ..self }
    }

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
    /// Share of the usable points beside which light clips the picture, on the flank or on the level it rises to.
    pub clipped: f64,
    /// Whether the edge was told from its flank alone, as a clip hides the rest.
    pub of_flank: bool,
    /// The light's slope as the levels inside the edge tell it, and those outside.
    pub light: [Option<Slope>; 2],
}

impl Points {
    /// Whether how pixels fall into bins would matter.
    pub(super) fn are_quiet(&self) -> bool {
        self.radius_px > LONG_PX
            && self.located.noise < SMALL_NOISE * self.located.step.contrast().abs()
    }

    /// Contrast over a pixel's noise.
    pub(super) fn clarity(&self) -> f64 {
        self.located.step.contrast().abs() / self.located.noise
    }

    /// How far the rim lies from what was found, in the plane: what a tint or shadow beside it has moved.
    pub(super) fn tint_mm(&self) -> f64 {
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
pub(super) const CLOSEST: Effort = Effort { bins: 8.0, ..CLOSE };
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
fn located(
    mut profiles: Profiles,
    contour: &Contour,
    effort: Effort,
    tinted: bool,
) -> Option<Located> {
    // Gain, stretch and the common flank look much alike: they part slowly.
    let rounds = effort.rounds * if profiles.hidden.is_some() { 4 } else { 1 };
    let options = LocateOptions { rounds, tinted, ..LocateOptions::default() };
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

/// Share of the usable edges at which light clips the picture within a few softnesses: there it hides a part of the flank or of the level, and
/// more of it where the light is stronger.
fn clipped(edges: &Located, lost: &Lost) -> f64 {
    const SOFTNESSES: f64 = 3.0;
    let within_px = SOFTNESSES * edges.step.softness_px;
    let usable = || edges.points.iter().filter(|e| e.usable);
    let clipped = usable().filter(|e| lost.near(e.angle_rad, e.distance_px, within_px)).count();
    clipped as f64 / usable().count().max(1) as f64
}

/// The edge points about a rough circle. `None` where no edge can be located there. `light` is the light's slope, where it is known (0 for
/// none): a closed contour tells it by itself.
pub(super) fn edge_points(
    frame: &Frame,
    view: &View,
    rough: Circle,
    search: Search,
    effort: Effort,
    light: Option<Vector2<f64>>,
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
    let lost = Lost::of(&profiles);
    // Of a flank that goes on behind a clip the light's slope is in the sectors' gains. Only a lens's flank is known to be symmetric.
    let flanks = if softness < SHARP_PX { hide(&profiles) } else { None };
    let of_flanks = flanks.and_then(|flanks| located(flanks, &contour, effort, search.tinted));
    let of_flank = of_flanks.is_some();
    let (edges, sides) = match of_flanks {
        Some(edges) => (edges, [None; 2]),
        None => {
            profiles.mask_glare();
            if let Some(light) = search.light {
                even_out(&mut profiles, &contour, |at| light.at(at));
            }
            let seen = Levels::of(&profiles, &contour, softness);
            let own = || seen.slope().filter(|slope| contour.closed && slope.is_sure());
            if let Some(per_px) = light.or_else(|| own().map(|slope| slope.per_px)) {
                flatten(&mut profiles, &contour, per_px);
            }
            (located(profiles, &contour, effort, search.tinted)?, seen.by_side())
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
        clipped: clipped(&edges, &lost),
        of_flank,
        light: sides,
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
