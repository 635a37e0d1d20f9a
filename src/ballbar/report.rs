//! What `decouple` hands back.

use serde::{Deserialize, Serialize};

use crate::plot::{Figure, Panel};

/// An error the paths can see.
#[derive(Debug, Clone, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Value {
    /// Its name.
    pub name: String,
    /// In `unit`.
    pub value: f64,
    /// mm or deg.
    pub unit: String,
    /// Half-width of the 95 % interval, in `unit`.
    pub u95: f64,
}

/// A name with a number.
#[derive(Debug, Clone, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Term {
    /// The error's name.
    pub name: String,
    /// Its factor.
    pub value: f64,
}

/// `+6.9813 A0B -13.9626 A0Z`.
pub fn sum(terms: &[Term]) -> String {
    let parts: Vec<String> = terms.iter().map(|t| format!("{:+.4} {}", t.value, t.name)).collect();
    parts.join(" ")
}

/// A sum of errors that is visible though its parts are not.
#[derive(Debug, Clone, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Combination {
    /// Factors, mm for a mm or for a degree.
    pub terms: Vec<Term>,
    /// The sum.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// Half-width of its 95 % interval.
    pub u95: f64,
}

/// Errors taken apart.
#[derive(Debug, Clone, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Report {
    /// Number of independent combinations of the six errors the paths see.
    pub rank: usize,
    /// Change of length, rms over the points, for each mm (tilts at the pivot length), by size.
    pub singular_values: Vec<f64>,
    /// Errors with numbers.
    pub visible: Vec<Value>,
    /// Errors that get none.
    pub not_visible: Vec<String>,
    /// Sums of hidden errors that are visible.
    pub combinations: Vec<Combination>,
    /// Amounts of errors that together change no length.
    pub null_directions: Vec<Vec<Term>>,
    /// The visible errors as the particle swarm finds them.
    pub swarm: Vec<Term>,
    /// A further path that would show what is hidden.
    pub would_add: Option<String>,
    /// Number of lengths.
    pub points: usize,
    /// Paths in the data.
    pub paths: Vec<String>,
    /// Root mean square of measured minus nominal length (nuisances taken out), and of what the errors leave.
    pub before_rms_mm: f64,
    /// See `before_rms_mm`.
    pub after_rms_mm: f64,
    /// Path, B in degrees, measured minus fitted.
    #[serde(skip)]
    pub residuals: Vec<(usize, f64, f64)>,
    /// Measured minus nominal.
    #[serde(skip)]
    pub measured: Vec<f64>,
    /// What the user should know.
    #[serde(skip)]
    pub warnings: Vec<String>,
}

impl Report {
    /// Lines for people.
    pub fn text(&self) -> String {
        let mut out = format!(
            "{} points on {}: rank {} of 6\nsingular values (mm for mm): {}\n",
            self.points,
            self.paths.join(", "),
            self.rank,
            self.singular_values.iter().map(|s| format!("{s:.4}")).collect::<Vec<_>>().join(" ")
        );
        if !self.visible.is_empty() {
            out.push_str("\nerror       least squares        ±95 %   particle swarm\n");
        }
        for (v, s) in self.visible.iter().zip(&self.swarm) {
            out.push_str(&format!(
                "{:5} {:+14.5} {:3} {:12.5} {:+16.5}\n",
                v.name, v.value, v.unit, v.u95, s.value
            ));
        }
        for c in &self.combinations {
            out.push_str(&format!(
                "{} = {:+.5} ±{:.5} {}\n",
                sum(&c.terms),
                c.value,
                c.u95,
                c.unit
            ));
        }
        if !self.not_visible.is_empty() {
            out.push_str(&format!("\nnot visible: {}\n", self.not_visible.join(", ")));
            for n in &self.null_directions {
                out.push_str(&format!("  changes no length: {}\n", sum(n)));
            }
            match &self.would_add {
                Some(path) => out.push_str(&format!(
                    "the path {path} would add to this (ballbar plan --path {path})\n"
                )),
                None => out.push_str("no path of Z or X with B adds to this\n"),
            }
        }
        out.push_str(&format!(
            "\nrms {:.5} mm before, {:.5} mm after\n",
            self.before_rms_mm, self.after_rms_mm
        ));
        out
    }

    /// Measured deviations and residuals over B.
    pub fn figure(&self) -> Figure {
        let mut measured =
            Panel::new("B angle, °", "length - nominal, mm").title("Measured and fitted");
        let mut left =
            Panel::new("B angle, °", "length - fitted, mm").title("What the errors leave");
        for (i, name) in self.paths.iter().enumerate() {
            let of_path =
                || self.residuals.iter().zip(&self.measured).filter(move |(r, _)| r.0 == i);
            let points: Vec<_> = of_path().map(|(r, m)| (r.1, *m)).collect();
            let fitted: Vec<_> = of_path().map(|(r, m)| (r.1, m - r.2)).collect();
            let rest: Vec<_> = of_path().map(|(r, _)| (r.1, r.2)).collect();
            measured = measured.points(name, &points).line(format!("{name} fitted"), &fitted);
            left = left.points(name, &rest);
        }
        Figure::new("Ball bar").panel(measured).panel(left)
    }
}
