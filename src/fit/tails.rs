//! Tail probabilities of the F and χ² distributions, as logarithms so that strong evidence does not underflow.
//!
//! Continued fractions of the incomplete beta and gamma functions (Press et al., "Numerical Recipes", 6.2-6.4).

/// ln P(F > f) for `d1` and `d2` degrees of freedom; `d2 = ∞` is χ²/d1.
pub fn ln_f_tail(f: f64, d1: f64, d2: f64) -> f64 {
    if f.is_nan() || f <= 0.0 {
        return 0.0;
    }
    if !d2.is_finite() || d2 > 1e7 {
        return ln_chi2_tail(f * d1, d1);
    }
    let x = d2 / (d2 + d1 * f);
    ln_beta_regularised(d2 / 2.0, d1 / 2.0, x, d1 * f / (d2 + d1 * f))
}

/// ln P(χ² > x) for `dof` degrees of freedom.
pub fn ln_chi2_tail(x: f64, dof: f64) -> f64 {
    if x.is_nan() || x <= 0.0 {
        return 0.0;
    }
    let (a, x) = (dof / 2.0, x / 2.0);
    let front = a * x.ln() - x - ln_gamma(a);
    if x < a + 1.0 {
        let (mut sum, mut term, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..500 {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * 1e-16 {
                break;
            }
        }
        let lower = (front + sum.ln()).exp().min(1.0);
        return (1.0 - lower).max(1e-300).ln();
    }
    let tiny = 1e-300;
    let mut b = x + 1.0 - a;
    let mut c = 1.0 / tiny;
    let mut d = 1.0 / b;
    let mut h = d;
    for i in 1..500 {
        let an = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = non_zero(an * d + b).recip();
        c = non_zero(b + an / c);
        let step = d * c;
        h *= step;
        if (step - 1.0).abs() < 1e-15 {
            break;
        }
    }
    (front + h.ln()).min(0.0)
}

/// The f with P(F > f) = exp(ln_p) for `d1` and `d2` degrees of freedom, by bisection; with `d2 = ∞` it is χ²/d1.
pub fn f_quantile(ln_p: f64, d1: f64, d2: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while ln_f_tail(high, d1, d2) > ln_p && high < 1e12 {
        high *= 4.0;
    }
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if ln_f_tail(middle, d1, d2) > ln_p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn ln_beta_regularised(a: f64, b: f64, x: f64, one_minus_x: f64) -> f64 {
    if x <= 0.0 {
        return f64::NEG_INFINITY;
    }
    if one_minus_x <= 0.0 {
        return 0.0;
    }
    let front = ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * one_minus_x.ln();
    if x < (a + 1.0) / (a + b + 2.0) {
        (front + beta_fraction(a, b, x).ln() - a.ln()).min(0.0)
    } else {
        let upper = (front + beta_fraction(b, a, one_minus_x).ln() - b.ln()).exp().min(1.0);
        (1.0 - upper).max(1e-300).ln()
    }
}

fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    let mut c = 1.0;
    let mut d = non_zero(1.0 - (a + b) * x / (a + 1.0)).recip();
    let mut h = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = non_zero(1.0 + even * d).recip();
        c = non_zero(1.0 + even / c);
        h *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = non_zero(1.0 + odd * d).recip();
        c = non_zero(1.0 + odd / c);
        let step = d * c;
        h *= step;
        if (step - 1.0).abs() < 1e-15 {
            break;
        }
    }
    h
}

fn non_zero(v: f64) -> f64 {
    if v.abs() < 1e-300 { 1e-300 } else { v }
}

/// ln Γ(x) for x > 0 (Lanczos, g = 7).
fn ln_gamma(x: f64) -> f64 {
    const C: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    if x < 0.5 {
        let pi = std::f64::consts::PI;
        return (pi / (pi * x).sin()).ln() - ln_gamma(1.0 - x);
    }
    let x = x - 1.0;
    let t = x + 7.5;
    let sum: f64 = C[0] + (1..9).map(|i| C[i] / (x + i as f64)).sum::<f64>();
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_match_tables() {
        // scipy.stats: f.sf(4, 3, 20), chi2.sf(11.345, 3), f.sf(30, 1, 100), chi2.sf(200, 2) in logs.
        for (ours, table) in [
            (ln_f_tail(4.0, 3.0, 20.0), 0.022_135_f64.ln()),
            (ln_chi2_tail(11.344_866_73, 3.0), 0.01_f64.ln()),
            (ln_f_tail(30.0, 1.0, 100.0), 3.282e-7_f64.ln()),
            (ln_chi2_tail(200.0, 2.0), -100.0),
        ] {
            assert!((ours - table).abs() < 2e-2, "{ours} {table}");
        }
        assert!((3.0 * f_quantile(0.01_f64.ln(), 3.0, f64::INFINITY) - 11.3449).abs() < 1e-3);
        assert!((f_quantile(0.05_f64.ln(), 2.0, 6.0) - 5.1433).abs() < 1e-3);
    }
}
