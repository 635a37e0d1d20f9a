//! Where light has clipped the picture beside a contour.

use crate::edge::Profiles;

/// Bins brighter than this part of the clip have lost light.
const LOST: f32 = 0.98;

/// Bins that have lost light, sector by sector.
pub struct Lost {
    angle_rad: Vec<f64>,
    /// Distances of a sector's bins, and how wide they are.
    bins_px: Vec<f64>,
    is_lost: Vec<bool>,
}

impl Lost {
    /// Of profiles as they were read.
    pub fn of(profiles: &Profiles) -> Self {
        let least = profiles.clip().map_or(f32::INFINITY, |top| LOST * top);
        let bins = profiles.count.iter().zip(&profiles.value);
        Self {
            angle_rad: profiles.angle_rad.clone(),
            bins_px: (0..profiles.bins).map(|b| profiles.bin_middle_px(b)).collect(),
            is_lost: bins.map(|(count, value)| *count > 0.0 && *value >= least).collect(),
        }
    }

    /// Whether any lies so near to a place.
    pub fn near(&self, angle_rad: f64, distance_px: f64, within_px: f64) -> bool {
        let next = self.angle_rad.partition_point(|a| *a < angle_rad - 1e-9);
        let sector = next.min(self.angle_rad.len().saturating_sub(1));
        let bins = self.is_lost.iter().skip(sector * self.bins_px.len());
        let near = |at: &f64| (at - distance_px).abs() <= within_px;
        self.bins_px.iter().zip(bins).any(|(at, lost)| *lost && near(at))
    }
}
