//! Follows a rim through all captures.

use nalgebra::Vector2;
use rayon::prelude::*;

use super::Capture;
use super::joint::{self, Arc, Joint};
use super::light::{Bow, Light, Shift};
use super::outer::Found;
use crate::camera::View;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::measure::points::{CLOSE, GLANCE, Search, edge_points};

/// A rim in all captures.
pub(super) struct Followed<'f> {
    /// Its edge in each capture that shows it.
    pub arcs: Vec<Arc>,
    /// The common circle.
    pub robust: Joint,
    /// How far the light moves it.
    pub shift: Shift,
    /// How far light that fades towards the corners bends it.
    pub bow: Bow,
    /// What all captures are seen through.
    pub view: &'f View,
}

/// Follows a rim through all captures: edge points and the joint circle in turn.
pub(super) fn follow<'f>(
    captures: &[Capture],
    frames: &'f [(Frame, View)],
    rim: &Found,
    angle_of: &[usize],
) -> Result<Followed<'f>> {
    let mut guess = Joint {
        centers: rim.centers.clone(),
        radius: rim.radius_mm,
        shifts: vec![Vector2::zeros(); captures.len()],
        weights: Vec::new(),
    };
    let mut softness = vec![2.0; captures.len()];
    let mut arcs: Vec<Arc> = Vec::new();
    let mut light: Option<Light> = None;
    let mut seen = None;
    for (reach_px, effort) in [(12.0, GLANCE), (4.0, GLANCE), (1.0, CLOSE)] {
        light = seen;
        let slope = light.map(|light| light.divided_per_px());
        arcs = frames
            .par_iter()
            .enumerate()
            .filter(|(i, _)| !rim.without.contains(i))
            .filter_map(|(i, (frame, view))| {
                let position_mm = captures[i].position_mm;
                let rough = guess.seen(angle_of[i], i, position_mm);
                let per_mm = 1.0 / view.pixel_mm();
                let inside_limit_px = rim.inner_mm.map_or(60.0, |inner_mm| {
                    (0.6 * (rim.radius_mm - inner_mm) * per_mm).clamp(4.0, 60.0)
                });
                let search = Search {
                    reach_px,
                    inside_limit_px,
                    outside_limit_px: 60.0,
                    softness_px: softness[i],
                    tinted: false,
                    light: None,
                };
                let mut points = edge_points(frame, view, rough, search, effort, slope)?;
                points.move_to_rim(rough.center);
                Some(Arc { points, position_mm, angle: angle_of[i], capture: i })
            })
            .collect();
        for arc in &arcs {
            softness[arc.capture] = arc.points.located.step.softness_px.clamp(0.6, 20.0);
        }
        seen = Light::of(&arcs, &frames[0].1);
        guess = joint::robust(&arcs, &guess, 20).ok_or_else(|| {
            Error::measure(
                "captures",
                "too few edge points for a circle",
                "take captures all round the rim",
            )
        })?;
    }
    let view = &frames[0].1;
    let shift = light.map(|light| light.shift(&arcs, view)).unwrap_or_default();
    Ok(Followed { arcs, robust: guess, shift, bow: Bow::of(view), view })
}
