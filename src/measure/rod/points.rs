//! The edge points as a table for `diagnose rod`.

use crate::measure::rod::{Capture, Measured};

/// CSV with `capture,x_mm,y_mm,c_deg,t_s,temp_c,dir_x,dir_y,u_px,v_px`; what not all captures tell is left empty.
pub fn points_csv(captures: &[Capture], measured: &Measured) -> String {
    let all = |f: fn(&Capture) -> bool| captures.iter().all(f);
    let (time, temperature) = (all(|c| c.t_s.is_some()), all(|c| c.temp_c.is_some()));
    let direction = all(|c| c.direction.is_some());
    let told = |there: bool, value: Option<f64>| {
        value.filter(|_| there).map_or_else(String::new, |v| v.to_string())
    };
    let mut text = String::from("capture,x_mm,y_mm,c_deg,t_s,temp_c,dir_x,dir_y,u_px,v_px\n");
    for p in measured.points.iter().filter(|p| p.used) {
        let c = &captures[p.capture];
        let along = |axis: usize| told(direction, c.direction.map(|d| d[axis]));
        text.push_str(&format!(
            "{},{:.6},{:.6},{},{},{},{},{},{:.5},{:.5}\n",
            p.capture + 1,
            c.position_mm.x,
            c.position_mm.y,
            c.c_deg,
            told(time, c.t_s),
            told(temperature, c.temp_c),
            along(0),
            along(1),
            p.pixel.x,
            p.pixel.y
        ));
    }
    text
}
