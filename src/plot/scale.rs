//! Axis ranges, round tick steps and the numbers written beside them.

/// Maps an interval of values to an interval of pixels.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    pub low: f64,
    pub high: f64,
    pub pixel_low: f64,
    pub pixel_high: f64,
}

impl Scale {
    /// A scale that shows every finite value with a margin of 4 %; constant or missing data get room around.
    pub fn fit(values: impl Iterator<Item = f64>, pixel_low: f64, pixel_high: f64) -> Self {
        // Beyond 1e100 differences could overflow; such values are not measurements.
        let (low, high) = values
            .filter(|v| v.abs() < 1e100)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let span = high - low;
        let magnitude = low.abs().max(high.abs());
        let margin = if span > 1e-9 * magnitude && span > 1e-100 {
            0.04 * span
        } else if magnitude == 0.0 {
            1.0
        } else {
            (0.1 * magnitude).max(1e-9)
        };
        Self { low: low - margin, high: high + margin, pixel_low, pixel_high }
    }

    /// The pixel for a value.
    pub fn pixel(&self, value: f64) -> f64 {
        self.pixel_low
            + (value - self.low) / (self.high - self.low) * (self.pixel_high - self.pixel_low)
    }

    /// Widens the values shown until one pixel is `per_pixel` units, keeping the middle.
    pub fn widen(&mut self, per_pixel: f64) {
        let half = 0.5 * per_pixel * (self.pixel_high - self.pixel_low).abs();
        let middle = 0.5 * (self.low + self.high);
        self.low = middle - half;
        self.high = middle + half;
    }

    /// Units in one pixel.
    pub fn per_pixel(&self) -> f64 {
        (self.high - self.low) / (self.pixel_high - self.pixel_low).abs()
    }

    /// Round values and their labels, `spacing` pixels apart or a little more.
    pub fn ticks(&self, spacing: f64) -> Vec<(f64, String)> {
        let step = round_up(self.per_pixel() * spacing);
        let first = (self.low / step).ceil();
        let count = ((self.high / step).floor() - first).clamp(0.0, 200.0) as usize;
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        let plain = (1e-7..1e7).contains(&self.low.abs().max(self.high.abs()));
        (0..=count)
            .map(|i| {
                let value = (first + i as f64) * step;
                let label =
                    if plain { format!("{value:.decimals$}") } else { format!("{value:.2e}") };
                (value, label.replace('-', "\u{2212}"))
            })
            .collect()
    }
}

/// The next number of 1, 2, 5 times a power of ten.
fn round_up(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= step).unwrap_or(10.0);
    factor * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let scale = Scale::fit([-92.0, 88.0].into_iter(), 0.0, 600.0);
        let labels: Vec<String> = scale.ticks(70.0).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["\u{2212}50", "0", "50"]);
        let scale = Scale::fit([0.0, 0.083].into_iter(), 300.0, 0.0);
        assert_eq!(scale.ticks(40.0)[1].1, "0.02");
    }
}
