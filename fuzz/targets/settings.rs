//! Settings of every kind: read or refused with a message, and what was read can be used.
#![no_main]

mod scratch;

use libfuzzer_sys::fuzz_target;
use pivotsight::camera::Calibration;
use pivotsight::diagnose::own;
use pivotsight::machine::Machine;
use pivotsight::render::{BurnScene, RodScene};
use pivotsight::rtcp::Session;
use pivotsight::rtcp::report::Solution;
use pivotsight::rtcp::solve::solve;

fuzz_target!(|text: &str| {
    if let Ok(machine) = Machine::parse("fed.toml", text) {
        let _ = machine.chain();
        let _ = machine.doubts();
        machine.to_toml();
    }
    let path = scratch::file("fed.toml", text.as_bytes());
    if let Ok(calibration) = Calibration::read(&path) {
        let _ = calibration.view(1600, 1200);
        calibration.to_toml();
    }
    if let Ok(session) = Session::read(&path)
        && let Ok(solved) = solve(&session.readings)
    {
        let machine = solved.machine(&session.name, session.c_sense, session.standoff_mm.value);
        let _ = Solution::new(&session, &solved, &machine);
    }
    if let Ok(scene) = BurnScene::read(&path) {
        let _ = scene.draw_camera(1);
    }
    if let Ok(scene) = RodScene::read(&path) {
        let _ = scene.draw_camera(1);
    }
    for kind in ["rtcp", "rod", "ballbar", "thermal", "burn"] {
        let _ = own::read(&path, kind);
    }
});
