//! The ring and the spot in a burn test's picture: which circles they are, and both measured.

use nalgebra::Vector2;

use crate::camera::View;
use crate::error::{Error, Result};
use crate::find::{self, Candidate, Look, Sides};
use crate::fit::Circle;
use crate::frame::Frame;
use crate::measure::annulus::{self, Flaw, Rings};
use crate::measure::bands::is_concentric;
use crate::measure::dirt;
use crate::measure::limits::is_steady;
use crate::measure::ring::Ring;
use crate::measure::tried::Tried;
use crate::measure::{spot, spots};

/// Rings that are tried, and spots inside each.
const TRIES: usize = 4;
/// So much that speaks against two circles' being a burn's together makes them something else.
const TOO_WEAK: usize = 3;
/// Score of a circle as a part of a clearer one's beside which it is no mark.
const LESS_CLEAR: f64 = 0.5;

/// Ring, spot and what a user should know.
pub(super) type Marks = (Ring, Ring, Vec<String>);

/// Finds and measures both. `near_mm` tells one of several test burns from the others.
pub(super) fn measure(
    frame: &Frame,
    view: &View,
    near_mm: Option<[f64; 2]>,
    subject: &str,
) -> Result<Marks> {
    let look = find::look_evenly(frame);
    let chosen = near_mm.map(|p| view.to_pixel(Vector2::from(p)));
    let scene = Scene::new(frame, view, &look, chosen);
    let rings = scene.rings();
    let mut tried = Tried::default();
    if let Some(marks) = scene.seek(&rings, &mut tried, subject)? {
        return Ok(marks);
    }
    // Beside scales, holes and scratches a burn's edges may be lost among many: once more where a ring was seen.
    let mut found: Option<Marks> = None;
    let lone = tried.lone.iter().copied().chain(tried.line.iter().map(|(line, _)| *line));
    let centers: Vec<_> = lone.map(|ring| ring.circle.center).take(TRIES).collect();
    for near in centers {
        let nearer = Scene::new(frame, view, &look, Some(near));
        let (rings, mut again) = (nearer.rings(), Tried::default());
        let Some(marks) = nearer.seek(&rings, &mut again, subject)?.filter(|m| !is_dot(&m.0, &m.1))
        else {
            continue;
        };
        match &found {
            None => found = Some(marks),
            Some((ring, ..)) if ring.circle.distance(marks.0.circle.center) > 0.0 => {
                return Err(two_burns(subject, view, ring.center_px, marks.0.center_px));
            }
            Some(_) => {}
        }
    }
    if let Some(marks) = found.or_else(|| tried.line_alone()) {
        return Ok(marks);
    }
    let elsewhere = match near_mm {
        Some(near_mm) if tried.lone.is_empty() => {
            let whole = Scene::new(frame, view, &look, None);
            whole.rings().all.first().map(|ring| none_near(subject, view, near_mm, ring))
        }
        _ => None,
    };
    Err(elsewhere.unwrap_or_else(|| tried.error(subject)))
}

/// Whether the spot may be a chip in a hole, or dirt.
pub(super) fn is_dot(ring: &Ring, spot: &Ring) -> bool {
    dirt::is_dot(&spot.circle, &ring.circle)
}

fn longer_side(frame: &Frame) -> f64 {
    frame.width().max(frame.height()) as f64
}

/// A picture with the circles in it that may be marks.
struct Scene<'a> {
    frame: &'a Frame,
    view: &'a View,
    look: &'a Look,
    steady: Vec<Candidate>,
    /// Whether it is known which of several burns is meant.
    is_chosen: bool,
}

/// What a circle that may be the ring turned out to be.
enum Attempt {
    /// A burn's ring, with its spot.
    Both(Box<Marks>),
    /// A burn's ring beside another.
    SecondBurn(Candidate),
    /// Nothing that the surface does not have elsewhere.
    Surface,
    /// A ring in which no spot is seen.
    NoSpot,
    /// A ring with a spot that cannot be measured, or with nothing but dots.
    UnclearSpot { dots: bool },
    /// Two circles of which too much speaks against their being ring and spot; the smaller one, px.
    TooWeak { spot: Circle },
    /// Something else, or a ring that does not tell where it is.
    Flawed(Flaw),
}

impl<'a> Scene<'a> {
    /// All of a picture, or what is about a place in it.
    fn new(
        frame: &'a Frame,
        view: &'a View,
        look: &'a Look,
        near_px: Option<Vector2<f64>>,
    ) -> Self {
        let side = longer_side(frame);
        let options = find::Options {
            least_radius_px: 0.02 * side,
            most_radius_px: 0.6 * side,
            near: near_px.map(|p| (p, 0.1 * side)),
            least_coverage: 0.35,
            centers: 8,
            known: &[],
        };
        let steady = find::circles(look, options).into_iter().filter(is_steady).collect();
        Self { frame, view, look, steady, is_chosen: near_px.is_some() }
    }

    fn rings(&self) -> Rings {
        annulus::candidates(self.look, &self.steady, 0.06 * longer_side(self.frame))
    }

    /// The first of the rings with a spot; one whose spot may be dirt only where no other has any. Lines are put by.
    fn seek<'c>(
        &self,
        rings: &'c Rings,
        tried: &mut Tried<'c>,
        subject: &str,
    ) -> Result<Option<Marks>> {
        let mut dotted: Option<(&Candidate, Marks)> = None;
        // A line is sharper than a pale burn, and comes last.
        let (zones, lines) = rings.all.split_at(rings.zones);
        let zones = zones.iter().take(TRIES).map(|c| (c, false));
        for (outer, is_line) in zones.chain(lines.iter().take(TRIES).map(|c| (c, true))) {
            let is_known = |other: &Candidate| is_concentric(other, outer);
            if tried.rules_out(outer)
                || tried.unclear.iter().any(|u| is_known(u))
                || dotted
                    .as_ref()
                    .is_some_and(|(ring, _)| is_known(ring) || is_nothing(outer, ring))
            {
                continue;
            }
            match self.attempt(outer, &rings.all) {
                Attempt::Both(marks) if is_line => {
                    tried.line.get_or_insert((outer, *marks));
                }
                Attempt::Both(marks) if !is_dot(&marks.0, &marks.1) => return Ok(Some(*marks)),
                Attempt::Both(marks) => match &dotted {
                    Some((other, _)) => {
                        return Err(two_burns(
                            subject,
                            self.view,
                            other.circle.center,
                            outer.circle.center,
                        ));
                    }
                    None => dotted = Some((outer, *marks)),
                },
                Attempt::SecondBurn(other) => {
                    return Err(two_burns(
                        subject,
                        self.view,
                        outer.circle.center,
                        other.circle.center,
                    ));
                }
                Attempt::Surface => {}
                Attempt::NoSpot => tried.lone.push(outer),
                Attempt::UnclearSpot { dots } => {
                    tried.lone.push(outer);
                    tried.unclear.push(outer);
                    if !dots {
                        break; // The ring is there; a worse one with a better spot would be a wrong answer.
                    }
                }
                Attempt::TooWeak { spot } => {
                    tried.refuse(outer, Flaw::Other);
                    tried.spots.push(spot);
                }
                Attempt::Flawed(flaw) => tried.refuse(outer, flaw),
            }
        }
        Ok(dotted.map(|(_, marks)| marks).filter(|_| tried.unclear.is_empty()))
    }

    /// Looks for a spot in what may be one of the `rings`, and measures both.
    fn attempt(&self, outer: &Candidate, rings: &[Candidate]) -> Attempt {
        if !self.stands_out(self.look, outer, outer, Sides::Edge) {
            return Attempt::Surface;
        }
        if find::is_folded(self.look, outer) || find::is_toothed(self.look, outer) {
            return Attempt::Flawed(Flaw::Other);
        }
        if annulus::is_rippled(self.look, outer, &self.steady) {
            return Attempt::Flawed(Flaw::Ripples);
        }
        let edges: Vec<Candidate> =
            self.steady.iter().filter(|c| is_concentric(c, outer)).copied().collect();
        let spots_at = |place: &'static spots::Place| {
            let near = place.look_near(self.frame, outer);
            let look = near.as_ref().unwrap_or(self.look);
            let mut spots = spots::candidates(look, outer, &edges, place);
            spots.retain(|s| annulus::beats_bands(s, outer, &self.steady) && !is_groove(look, s));
            (!spots.is_empty()).then_some((place, near, spots))
        };
        let mut looks = spots::PLACES.iter().filter_map(spots_at).peekable();
        if looks.peek().is_none() {
            return Attempt::NoSpot;
        }
        if !self.is_chosen
            && let Some(other) = annulus::second_burn(self.look, rings, outer)
        {
            return Attempt::SecondBurn(*other);
        }
        let mut attempt = Attempt::Flawed(Flaw::Other);
        let mut dots = true;
        for (place, near, spots) in looks {
            dots &= spots.iter().all(|s| dirt::is_dot(&s.circle, &outer.circle));
            if spots::has_rivals(place, &spots) {
                return Attempt::UnclearSpot { dots };
            }
            let look = near.as_ref().unwrap_or(self.look);
            let ring =
                match annulus::measure((self.frame, self.look), self.view, outer, &edges, spots[0])
                {
                    Ok(ring) => ring,
                    Err(_) if matches!(attempt, Attempt::UnclearSpot { .. }) => break,
                    Err(flaw) => return Attempt::Flawed(flaw),
                };
            let (frame, view) = (self.frame, self.view);
            let inside = spot::Inside { frame, view, ring: &ring, edges: &edges, place };
            let clear =
                spots.iter().filter(|s| self.stands_out(look, s, outer, Sides::Disc)).take(TRIES);
            if let Some(spot) = inside.measure_likeliest(clear, &spots, outer) {
                // The light of a lone spot's surroundings falls off in a circle, too.
                if find::is_fall_off(self.look, ring.seen(self.view)) {
                    return Attempt::Flawed(Flaw::Other);
                }
                if weaknesses(&ring, &spot) >= TOO_WEAK {
                    return Attempt::TooWeak { spot: spot.seen(self.view) };
                }
                if is_dot(&ring, &spot)
                    && let Some(dot) = spots.iter().min_by(|a, b| {
                        let off = |c: &Candidate| (c.circle.center - spot.center_px).norm();
                        off(a).total_cmp(&off(b))
                    })
                    && dirt::is_strewn(self.frame, dot, &outer.circle)
                {
                    return Attempt::UnclearSpot { dots: true };
                }
                let warnings = warnings(&ring, &spot);
                return Attempt::Both(Box::new((ring, spot, warnings)));
            }
            attempt = Attempt::UnclearSpot { dots };
        }
        attempt
    }

    /// Whether a mark stands out from its surface, clear of what is a mark beside the ring `outer`.
    fn stands_out(&self, look: &Look, c: &Candidate, outer: &Candidate, sides: Sides) -> bool {
        let least_step = 0.3 * outer.step.abs();
        // What runs along ring and spot in turn looks like a circle too: beside a clear spot it is no mark.
        let is_mark = |e: &&Candidate| {
            let clear = e.score > LESS_CLEAR * c.score || is_concentric(e, outer);
            clear || matches!(sides, Sides::Edge)
        };
        let others = (self.steady.iter().filter(is_mark))
            .filter(|e| e.step.abs() > least_step && !alike(e, c));
        let others: Vec<Circle> = others.map(|e| e.circle).collect();
        find::stands_out(look, c, sides, &others) == Some(true)
    }
}

/// Whether a circle is far too faint, and seen far too poorly, to count beside a ring: what light leaves on an even plate.
fn is_nothing(c: &Candidate, ring: &Candidate) -> bool {
    /// Of the ring's step, and of its score.
    const FAINT: f64 = 0.2;
    c.step.abs() < FAINT * ring.step.abs() && c.score < FAINT * ring.score
}

/// Whether a spot is a line, or one of many circles about its centre, as a turned plate's grooves are.
fn is_groove(look: &Look, spot: &Candidate) -> bool {
    /// Width in radii: a crater's rim is wider.
    const WIDEST: f64 = 0.11;
    /// Swings of the mean level beyond it, by such a part of its step: a ring, its zones and its halo have some.
    const MOST_SWINGS: usize = 4;
    const SWING: f64 = 0.6;
    find::is_line(look, spot.circle, WIDEST)
        || find::swings_beyond(look, spot.circle, SWING * spot.step.abs()) > MOST_SWINGS
}

/// How much speaks against two circles' being a burn's ring and spot: each of it is seen with burns, but hardly ever much of it together.
fn weaknesses(ring: &Ring, spot: &Ring) -> usize {
    /// Contrast over noise, texture included.
    const FAINT: f64 = 1.5;
    /// A spot's form in its radii, its radius and how far off it lies in the ring's.
    const RAGGED: f64 = 0.12;
    const LARGE: f64 = 0.3;
    const FAR: f64 = 0.5;
    let is_faint = |mark: &Ring| mark.contrast.abs() < FAINT * mark.noise;
    let apart = (spot.circle.center - ring.circle.center).norm();
    let against = [
        ring.arc_coverage < spot::PARTLY,
        is_faint(ring),
        spot.arc_coverage < spot::WHOLE,
        is_faint(spot),
        spot.form_rms_mm > RAGGED * spot.circle.radius,
        spot.circle.radius > LARGE * ring.circle.radius,
        apart > FAR * ring.circle.radius,
    ];
    against.into_iter().filter(|weak| *weak).count()
}

/// What about two marks makes them less sure.
fn warnings(ring: &Ring, spot: &Ring) -> Vec<String> {
    let seen = 100.0 * ring.arc_coverage;
    let gap = (seen < 60.0).then(|| format!("only {seen:.0} % of the ring's edge was found"));
    let clipped = [("ring", ring), ("spot", spot)].map(|(name, mark)| mark.clip_warning(name));
    gap.into_iter().chain(clipped.into_iter().flatten()).collect()
}

/// No ring about the place that was asked for, but something like one elsewhere.
fn none_near(subject: &str, view: &View, near_mm: [f64; 2], ring: &Candidate) -> Error {
    let [x, y] = near_mm;
    let seen_mm = view.to_plane(ring.circle.center);
    let place = format!("{:.2},{:.2}", seen_mm.x, seen_mm.y);
    Error::measure(
        subject,
        format!("no ring was found near {x},{y} mm; the clearest circle lies about {place} mm"),
        format!(
            "leave --near-mm out, or give the place of the burn that is meant, as --near-mm {place}"
        ),
    )
}

fn two_burns(subject: &str, view: &View, a: Vector2<f64>, b: Vector2<f64>) -> Error {
    let named = [a, b].map(|px| {
        let mm = view.to_plane(px);
        let near = format!("{:.2},{:.2}", mm.x, mm.y);
        (format!("{near} mm (pixel {:.0}, {:.0})", px.x, px.y), near)
    });
    let [(a, near), (b, _)] = named;
    Error::measure(
        subject,
        format!("shows two test burns, near {a} and {b}"),
        format!("say which one with --near-mm X,Y, as --near-mm {near}, or crop the picture"),
    )
}

/// Whether two may be one edge, seen twice.
fn alike(a: &Candidate, b: &Candidate) -> bool {
    (a.circle.radius / b.circle.radius - 1.0).abs() < 0.15 && a.step * b.step > 0.0
}
