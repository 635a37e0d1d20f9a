//! Residuals in order that repeat each other: how many independent ones they are worth.

/// The factor (1 + ρ)/(1 - ρ) on variances, 1 where the correlation ρ of neighbours is not significant, and ρ. `fitted` parameters
/// were taken from the residuals: slow ones, which take the slow part of the errors with them, so that ρ seems less than it is.
pub fn widening(residuals: &[f64], fitted: usize) -> (f64, f64) {
    let n = residuals.len() as f64;
    let square: f64 = residuals.iter().map(|r| r * r).sum();
    let cross: f64 = residuals.windows(2).map(|w| w[0] * w[1]).sum();
    let seen = if square > 0.0 { cross / square } else { 0.0 };
    // Two standard errors of an autocorrelation of white noise.
    if seen > 2.0 / n.sqrt() {
        // Kendall's bias of an estimated ρ, (1 + 3ρ)/n for a mean alone, and 2/n for each further parameter.
        let bias = (1.0 + 3.0 * seen + 2.0 * fitted.saturating_sub(1) as f64) / n;
        let rho = (seen + bias).min(0.99);
        ((1.0 + rho) / (1.0 - rho), rho)
    } else {
        (1.0, seen.max(-0.99))
    }
}
