//! Shares with their intervals, and quantiles.

/// Wilson's 95 % interval of a share, `hits` of `all`.
pub fn wilson(hits: usize, all: usize) -> (f64, f64) {
    let (n, z) = (all.max(1) as f64, pivotsight::uncertainty::K95);
    let p = hits as f64 / n;
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + (z / (2.0 * n)).powi(2)).sqrt();
    let scale = 1.0 + z * z / n;
    (((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0))
}

/// A share in percent with its interval, as the tables print it.
pub fn share(hits: usize, all: usize) -> String {
    if all == 0 {
        return "-".to_owned();
    }
    let (low, high) = wilson(hits, all);
    let percent = 100.0 * hits as f64 / all as f64;
    format!("{percent:.1} % ({:.1}-{:.1})", 100.0 * low, 100.0 * high)
}

/// The value below which this part of the list lies; NaN of an empty list.
pub fn quantile(list: &[f64], part: f64) -> f64 {
    let mut sorted = list.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (part * sorted.len() as f64) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}
