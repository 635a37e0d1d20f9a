//! Numbers that look as if they were in another unit than the one asked for. They are told and taken as they stand: only
//! the user knows.

use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use crate::fit::robust::range;

/// Heights of burns, mm: in metres or micrometres the method's 1 to 50 mm lie outside.
const HEIGHTS_MM: RangeInclusive<f64> = 0.1..=1000.0;
/// Distances from a rotary axis to the tool point, mm.
const PIVOTS_MM: RangeInclusive<f64> = 5.0..=20_000.0;
/// Distances from the nozzle's end face to the focus, mm.
const STANDOFFS_MM: RangeInclusive<f64> = 0.05..=300.0;
/// Lengths of a ball bar, mm.
const BARS_MM: RangeInclusive<f64> = 20.0..=5000.0;
/// Diameters of a check rod, mm.
const RODS_MM: RangeInclusive<f64> = 1.0..=500.0;
/// Sizes of a pixel on the plane, mm.
const PIXELS_MM: RangeInclusive<f64> = 1e-4..=1.0;
/// Temperatures that no screw or head has in °C, but every one in kelvin.
const KELVIN: RangeInclusive<f64> = 233.0..=400.0;
/// Temperatures of parts of a machine, and their rises, °C.
const CELSIUS: RangeInclusive<f64> = -40.0..=150.0;
/// Angles over which a full circle is told in degrees, not radians.
const MOST_RADIANS: f64 = TAU + 0.02;

/// An angle column that moves over a machine's range: says so where the numbers look like radians.
pub fn swept_angles(name: &str, values: &[f64]) -> Option<String> {
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let whole = values.iter().all(|v| (v * 4.0 - (v * 4.0).round()).abs() < 1e-9);
    (largest > 0.0 && largest < 6.5 && !whole).then(|| {
        format!(
            "column '{name}' stays within ±{largest:.3}: if it is in radians, turn it into degrees"
        )
    })
}

/// Any angle column: says so where every number is a multiple of 5° in radians, as angles are set, and none is in degrees, and where one is many
/// turns away.
pub fn angles(name: &str, values: &[f64]) -> Option<String> {
    /// More than an axis winds up to.
    const MOST_DEG: f64 = 3600.0;
    if let Some(far) = values.iter().find(|v| v.abs() > MOST_DEG) {
        return Some(format!(
            "column '{name}' reaches {far}°, more than ten turns: is a decimal point missing?"
        ));
    }
    /// Numbers are rounded to three decimals or more.
    const ROUNDED: f64 = 6e-4;
    /// Of one angle to four decimals or more; one in degrees lies so near to a multiple once in a thousand times.
    const EXACT: f64 = 6e-5;
    let step = 5f64.to_radians();
    let (mut multiples, mut exact) = (BTreeSet::new(), true);
    for v in values.iter().filter(|v| **v != 0.0) {
        let multiple = (v / step).round();
        if multiple == 0.0 || v.abs() > MOST_RADIANS || (v - multiple * step).abs() > ROUNDED {
            return None;
        }
        multiples.insert(multiple as i64);
        exact &= multiple % 3.0 == 0.0 || (v - multiple * step).abs() < EXACT;
    }
    // Of fewer angles, to more digits than people set degrees to: quarters and twelfths of a turn, and what is exact.
    let set = |v: &f64| (v * 100.0 - (v * 100.0).round()).abs() < 1e-6;
    let few = exact && !values.iter().filter(|v| **v != 0.0).any(set);
    (multiples.len() >= 3 || !multiples.is_empty() && few).then(|| {
        format!("column '{name}' has multiples of 5° in radians alone: if it is in radians, turn it into degrees")
    })
}

/// Errors in mm: says so where the numbers look like metres or micrometres.
pub fn errors(name: &str, values: &[f64]) -> Option<String> {
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if largest > 0.0 && largest < 1e-4 {
        Some(format!(
            "column '{name}' stays within ±{largest:.1e}: if it is in metres, turn it into millimetres"
        ))
    } else if largest > 5.0 {
        Some(format!(
            "column '{name}' reaches {largest:.1}: if it is in micrometres, turn it into millimetres"
        ))
    } else {
        None
    }
}

/// Corrections of a rotary axis in degrees: says so where they are larger than any axis needs.
pub fn corrections(name: &str, values: &[f64]) -> Option<String> {
    const MOST_DEG: f64 = 1.0;
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    (largest > MOST_DEG).then(|| {
        format!(
            "column '{name}' reaches {largest:.1}°: if it is in seconds of arc or in thousandths, turn it into degrees"
        )
    })
}

/// Positions along a machine's axis in mm: says so where they look like metres or micrometres.
pub fn travel(name: &str, values: &[f64]) -> Option<String> {
    let (low, high) = range(values);
    let unit = match high - low {
        span if span > 0.0 && span < 5.0 => "metres",
        span if span > 20_000.0 => "micrometres",
        _ => return None,
    };
    Some(format!(
        "column '{name}' spans {:.4} mm: if it is in {unit}, turn it into millimetres",
        high - low
    ))
}

/// A standard uncertainty of a length that was read at a machine, mm.
pub fn uncertainty(name: &str, mm: f64) -> Option<String> {
    const MOST_MM: f64 = 0.1;
    (mm > MOST_MM)
        .then(|| format!("{name} is {mm} mm: if it is in micrometres, write {:.6} (mm)", 1e-3 * mm))
}

/// A limit of what is measured, mm: no limit of these is as wide.
pub fn limit(name: &str, mm: f64) -> Option<String> {
    const MOST_MM: f64 = 1.0;
    (mm > MOST_MM).then(|| {
        format!("{name} is {mm} mm, which nearly everything keeps: if it is in micrometres, write {:.6} (mm)", 1e-3 * mm)
    })
}

/// The distance from the nozzle's end face to the focus.
pub fn standoff(name: &str, mm: f64) -> Option<String> {
    if mm < 0.0 {
        return Some(format!(
            "{name} is {mm} mm, which puts the focus within the head: below the nozzle it is {} mm",
            -mm
        ));
    }
    length(name, mm, STANDOFFS_MM)
}

/// Machine positions from which pictures of one thing were taken: says so where they lie closer together, or farther apart, than what a picture
/// shows allows.
pub fn positions(places_mm: &[[f64; 2]], picture_mm: f64) -> Option<String> {
    let span_mm = (0..2)
        .map(|axis| range(&places_mm.iter().map(|p| p[axis]).collect::<Vec<_>>()))
        .map(|(low, high)| high - low)
        .fold(0.0, f64::max);
    let unit = match span_mm / picture_mm {
        parts if parts > 0.0 && parts < 0.01 => "metres",
        parts if parts > 100.0 => "micrometres",
        _ => return None,
    };
    Some(format!(
        "x_mm and y_mm span {span_mm:.4} mm, a picture {picture_mm:.1} mm: if they are in {unit}, turn them into millimetres"
    ))
}

/// Temperatures in °C: says so where the numbers look like kelvin, or single ones like a sensor that is not connected.
pub fn celsius(name: &str, values: &[f64]) -> Option<String> {
    if !values.is_empty() && values.iter().all(|v| KELVIN.contains(v)) {
        return Some(format!(
            "column '{name}' stays between 233 and 400: if it is in kelvin, subtract 273.15"
        ));
    }
    let mut strange = values.iter().enumerate().filter(|(_, v)| !CELSIUS.contains(v));
    let (first, value) = strange.next()?;
    let more = match strange.count() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Some(format!(
        "column '{name}': {value} in row {}{more} is no temperature of a machine, a sensor that is not connected reads so: leave such rows out",
        first + 1
    ))
}

/// The height of a burn.
pub fn height(name: &str, mm: f64) -> Option<String> {
    length(name, mm, HEIGHTS_MM)
}

/// The distance from a rotary axis to the tool point.
pub fn pivot(name: &str, mm: f64) -> Option<String> {
    length(name, mm, PIVOTS_MM)
}

/// The distance from a rotary axis to the tool's axis: beyond that to the tool point no head has it.
pub fn beside(name: &str, mm: f64, pivot_mm: f64) -> Option<String> {
    (pivot_mm > 0.0 && mm.abs() > pivot_mm).then(|| {
        format!(
            "{name} is {mm:.4} mm, more than the {pivot_mm:.4} mm to the nozzle: if it is in micrometres, write {:.6} (mm)",
            1e-3 * mm
        )
    })
}

/// The length of a ball bar.
pub fn bar(name: &str, mm: f64) -> Option<String> {
    length(name, mm, BARS_MM)
}

/// The diameter of a check rod.
pub fn rod(name: &str, mm: f64) -> Option<String> {
    length(name, mm, RODS_MM)
}

/// The size of a pixel.
pub fn pixel(name: &str, mm: f64) -> Option<String> {
    length(name, mm, PIXELS_MM)
}

/// A length in mm: says so where it looks like metres or micrometres.
fn length(name: &str, mm: f64, usual: RangeInclusive<f64>) -> Option<String> {
    if mm <= 0.0 || usual.contains(&mm) {
        return None;
    }
    let (other, meant) =
        if mm < *usual.start() { ("metres", 1e3 * mm) } else { ("micrometres", 1e-3 * mm) };
    Some(format!("{name} is {mm:.6} mm: if it is in {other}, write {meant:.6} (mm)"))
}

/// Pictures that one scale cannot hold for: says which has another size than the first.
pub fn sizes<'n>(pictures: impl IntoIterator<Item = (&'n str, (usize, usize))>) -> Option<String> {
    let mut pictures = pictures.into_iter();
    let (first, (w, h)) = pictures.next()?;
    let (other, (width, height)) = pictures.find(|(_, size)| *size != (w, h))?;
    Some(format!(
        "'{other}' has {width}×{height} px where '{first}' has {w}×{h} px: one mm_per_px holds for one camera and resolution, and the camera axis is taken to be in the middle of each"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radians_are_told_and_degrees_are_not() {
        let degrees: Vec<f64> = (-9..=9).map(|k| 10.0 * f64::from(k)).collect();
        let radians: Vec<f64> =
            degrees.iter().map(|d| (1e4 * d.to_radians()).round() / 1e4).collect();
        assert!(angles("b_deg", &radians).unwrap().contains("'b_deg'"));
        assert!(angles("c_deg", &[0.0, 2.0944]).is_some());
        assert!(angles("c_deg", &[0.0, 1.7453]).is_some());
        assert!(angles("b_deg", &[0.0, 15.0, 20015.0]).unwrap().contains("20015°"));
        for right in [
            degrees,
            vec![0.0; 4],
            vec![-6.0, -3.0, 3.0, 6.0],
            vec![-0.002, 0.001, 2.3562],
            vec![0.0, 1.57],
            vec![0.0, 1.745],
        ] {
            assert_eq!(angles("b_deg", &right), None);
        }
        // As they are set, in steps of any tenth of a degree.
        let fine = (1..=62).map(|k| (1..=6).map(|i| f64::from(i * k) / 10.0).collect::<Vec<_>>());
        assert!(fine.into_iter().all(|v| angles("b_deg", &v).is_none()));
    }

    #[test]
    fn lengths_and_temperatures_of_another_unit_are_told() {
        let places = [[4.9, -8.9], [12.8, -15.5], [19.8, -7.0]];
        let scaled = |by: f64| places.map(|p| p.map(|v| by * v));
        assert_eq!(positions(&places, 9.6), None);
        assert!(positions(&scaled(1e-3), 9.6).unwrap().contains("in metres"));
        assert!(positions(&scaled(1e3), 9.6).unwrap().contains("in micrometres"));
        assert_eq!(positions(&[[3.0, 4.0]; 3], 9.6), None);
        assert_eq!([50.0, 3.0, 1.0, 0.5, 200.0].map(|h| height("h", h)), [const { None }; 5]);
        assert_eq!([6.0, 20.0, 150.0].map(|d| rod("d", d)), [const { None }; 3]);
        assert!(rod("rod.diameter_mm", 0.02).unwrap().contains("metres, write 20.0"));
        assert!(height("--ring-height-mm", 0.05).unwrap().contains("metres, write 50.0"));
        assert!(height("--ring-height-mm", 50_000.0).unwrap().contains("micrometres, write 50.0"));
        assert!(limit("--tolerance-mm", 15.0).unwrap().contains("write 0.015000"));
        assert_eq!((limit("--tolerance-mm", 0.5), standoff("s", 1.5)), (None, None));
        assert!(standoff("head.standoff_mm", 0.0015).unwrap().contains("metres"));
        assert!(standoff("head.standoff_mm", -1.5).unwrap().contains("within the head"));
        assert!(bar("length_mm", 0.4).unwrap().contains("metres, write 400.0"));
        assert!(pivot("--pivot-mm", 0.573).unwrap().contains("573.0"));
        assert_eq!(
            [283.0, -0.283, 120.0].map(|x| beside("x", x, 214.7).is_some()),
            [true, false, false]
        );
        assert!(pixel("scale.mm_per_px", 7.4).unwrap().contains("0.0074"));
        assert!(celsius("screw_c", &[293.15, 303.2]).unwrap().contains("kelvin"));
        let unplugged = [20.5, -127.0, 21.0, -127.0];
        assert!(celsius("head_1_c", &unplugged).unwrap().contains("-127 in row 2 and 1 more"));
        assert!(!celsius("screw_c", &[20.0, 293.0]).unwrap().contains("kelvin"));
        assert_eq!(celsius("screw_c", &[20.0, 93.0]), None);
        assert_eq!(sizes([("a", (8, 6)), ("b", (8, 6))]), None);
        assert!(sizes([("a", (8, 6)), ("b", (16, 12))]).unwrap().contains("'b' has 16×12 px"));
    }
}
