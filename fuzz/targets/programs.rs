//! Programs of any content, moved onto a blank that lies askew, or refused with a message naming the line.
#![no_main]

mod scratch;

use std::path::Path;
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use pivotsight::align::Alignment;
use pivotsight::align::apply::{Form, Options, apply};
use pivotsight::machine::Machine;

const FORMS: [Form; 3] = [Form::Cl, Form::Apt, Form::Nc];

/// A blank that is tilted, turned and off its place.
const LIE: &str = r#"{"a_deg": 0.3, "a_u95_deg": 0.01, "b_deg": -0.2, "b_u95_deg": 0.01, "dz_mm": 0.4,
    "dz_u95_mm": 0.01, "center_mm": [0.5, -0.3], "center_u95_mm": [0.01, 0.01], "center_z_mm": 10.0,
    "z_ideal_mm": 20.0, "center_ideal_mm": [0.0, 0.0], "c_deg": 12.0, "touch_u_mm": 0.002,
    "face_rms_mm": 0.001, "face_points": 8}"#;

fn machine() -> &'static Machine {
    static MACHINE: OnceLock<Machine> = OnceLock::new();
    MACHINE.get_or_init(|| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../calib/machine.toml");
        Machine::read(path).expect("the program's own example")
    })
}

fuzz_target!(|fed: (u8, &[u8])| {
    let (choice, program) = fed;
    let lie: Alignment = serde_json::from_str(LIE).expect("an alignment");
    let input = scratch::file("fed.nc", program);
    let options = Options {
        from: Some(FORMS[usize::from(choice) % 3]),
        to: Some(FORMS[usize::from(choice) / 3 % 3]),
        inverse: choice & 0x40 != 0,
        rtcp: choice & 0x80 != 0,
        ..Options::default()
    };
    let _ = apply(&lie, machine(), &input, &scratch::place("moved.nc"), &options);
});
