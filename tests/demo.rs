//! The demo closes the loop: corrections have the right sign for both signs of every error, and the machine's
//! numbers are found.

#![allow(clippy::unwrap_used)] // a test that cannot go on should stop

use pivotsight::demo::{Options, run, run_hidden};
use pivotsight::diagnose::report::Verdict as Diagnosis;
use pivotsight::uncertainty::Verdict;

#[test]
fn both_signs_of_every_error_are_corrected_and_the_machine_is_found() {
    let mut signs = [false; 2];
    for seed in [2, 3] {
        let folder = tempfile::tempdir().unwrap();
        let report = run(&Options { seed, folder: folder.path().to_owned() }).unwrap();
        assert!(report.closed, "seed {seed}: {report:#?}");
        let first = &report.burn_tests[0];
        let last = report.burn_tests.last().unwrap();
        assert_eq!((first.verdict, last.verdict), (Verdict::Fail, Verdict::Pass));
        signs[usize::from(first.true_tilt_deg[0] > 0.0)] = true;
        for axis in 0..2 {
            // Each correction turns against the tilt that truly was there.
            let turn = first.correction_deg.unwrap()[axis];
            assert!(turn * first.true_tilt_deg[axis] < 0.0, "seed {seed}: {report:#?}");
            let left = last.true_offset_mm[axis].abs();
            assert!(left < 0.25 * first.true_offset_mm[axis].abs(), "seed {seed}: {report:#?}");
        }
        assert!(report.rtcp_after_mm < 0.01 * report.rtcp_before_mm, "{report:#?}");
    }
    assert_eq!(signs, [true; 2], "the seeds show both signs of B's error");
}

#[test]
fn a_hidden_effect_is_named_from_pictures_and_the_corrected_model_agrees() {
    let folder = tempfile::tempdir().unwrap();
    let report = run_hidden(&Options { seed: 6, folder: folder.path().to_owned() }).unwrap();
    assert!(report.found, "{report:#?}");
    assert_eq!(report.named, std::slice::from_ref(&report.hidden));
    assert_eq!(
        (report.verdict, report.verdict_corrected),
        (Diagnosis::Named, Diagnosis::Consistent)
    );
    let g = &report.gap;
    let excess = |rms: f64| rms * rms - g.noise_rms_mm * g.noise_rms_mm;
    assert!(
        excess(g.heldout_after_rms_mm) < 0.1 * excess(g.heldout_before_rms_mm),
        "the gap closes on captures the fit has not seen: {g:?}"
    );
    for file in ["rod-01.png", "corrected.toml", "before/over-dir_y.svg", "after/index.html"] {
        assert!(folder.path().join(file).exists(), "{file}");
    }
}
