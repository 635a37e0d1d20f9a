//! Scatter and middle of values of which some are far off.

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
