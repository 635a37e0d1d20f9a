//! The edge points as a table for `diagnose rod`.

use crate::measure::rod::{Capture, Measured};

/// CSV with `capture,x_mm,y_mm,c_deg,t_s,temp_c,dir_x,dir_y,u_px,v_px`; columns the captures do not have are left out.
pub fn points_csv(captures: &[Capture], measured: &Measured) -> String {
    let all = |f: fn(&Capture) -> bool| captures.iter().all(f);
    let (time, temperature) = (all(|c| c.t_s.is_some()), all(|c| c.temp_c.is_some()));
    let direction = all(|c| c.direction.is_some());
    let mut text = String::from("capture,x_mm,y_mm,c_deg");
    for (there, name) in [(time, ",t_s"), (temperature, ",temp_c"), (direction, ",dir_x,dir_y")] {
        if there {
            text.push_str(name);
        }
    }
    text.push_str(",u_px,v_px\n");
    for p in measured.points.iter().filter(|p| p.used) {
        let c = &captures[p.capture];
        text.push_str(&format!(
            "{},{:.6},{:.6},{}",
            p.capture + 1,
            c.position_mm.x,
            c.position_mm.y,
            c.c_deg
        ));
        if let (true, Some(t)) = (time, c.t_s) {
            text.push_str(&format!(",{t}"));
        }
        if let (true, Some(t)) = (temperature, c.temp_c) {
            text.push_str(&format!(",{t}"));
        }
        if let (true, Some([x, y])) = (direction, c.direction) {
            text.push_str(&format!(",{x},{y}"));
        }
        text.push_str(&format!(",{:.5},{:.5}\n", p.pixel.x, p.pixel.y));
    }
    text
}
