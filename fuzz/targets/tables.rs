//! Tables of every kind: read or refused with a message naming the line, and what was read can be used.
#![no_main]

mod scratch;

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use pivotsight::align::{self, Touches};
use pivotsight::diagnose::load::Source;
use pivotsight::machine::DataKind;
use pivotsight::rotary::{self, Sweep};

const KINDS: [DataKind; 5] =
    [DataKind::Rtcp, DataKind::Rod, DataKind::Ballbar, DataKind::Thermal, DataKind::Burn];

fuzz_target!(|bytes: &[u8]| {
    let data = scratch::file("fed.csv", bytes);
    let calib = Path::new(env!("CARGO_MANIFEST_DIR")).join("../calib");
    for kind in KINDS {
        for measured in [true, false] {
            let source = Source {
                kind,
                data: data.clone(),
                model: Some(calib.join("machine.toml")),
                calib: (kind.name() == "rod").then(|| calib.join("scale.toml")),
                effects: None,
                diameter_mm: None,
                measured,
            };
            let _ = source.load(&mut Vec::new());
        }
    }
    for modulo in [true, false] {
        if let Ok(sweep) = Sweep::read(&data, modulo) {
            let options = rotary::Options { modulo, ..rotary::Options::new(600.0) };
            let _ = rotary::correct(&sweep, &options).map(|report| report.text());
        }
    }
    if let Ok(touches) = Touches::read(&data) {
        let _ = align::fit(&touches, &align::fit::Options::default(), &mut Vec::new());
    }
});
