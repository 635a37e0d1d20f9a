//! Residuals in order that repeat each other: how many independent ones they are worth.

/// The factor (1 + ρ)/(1 - ρ) on variances, 1 where the correlation ρ of neighbours is not significant, and ρ.
pub fn widening(residuals: &[f64]) -> (f64, f64) {
    let square: f64 = residuals.iter().map(|r| r * r).sum();
    let cross: f64 = residuals.windows(2).map(|w| w[0] * w[1]).sum();
    let rho = if square > 0.0 { (cross / square).clamp(-0.99, 0.99) } else { 0.0 };
    // Two standard errors of an autocorrelation of white noise.
    if rho > 2.0 / (residuals.len() as f64).sqrt() {
        ((1.0 + rho) / (1.0 - rho), rho)
    } else {
        (1.0, rho)
    }
}
