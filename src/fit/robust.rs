//! Middle, scatter and ends of values of which some may be far off.

/// The middle one, the upper of two.
///
/// # Panics
/// On an empty list.
pub fn median(list: &mut [f64]) -> f64 {
    let middle = list.len() / 2;
    *list.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Standard deviation of normal deviations with these sizes (none below 0), by their median.
///
/// # Panics
/// On an empty list.
pub fn scatter(sizes: &mut [f64]) -> f64 {
    1.4826 * median(sizes)
}

/// Smallest and largest value.
pub fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)))
}
