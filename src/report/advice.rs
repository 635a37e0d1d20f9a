//! The verdict in a sentence, and what to do next.

use serde_json::{Map, Value};

use crate::batch::limits::number;

/// The verdict's word (`pass`, `fail`, `undecided`, or `measured` where no limit applies) and a sentence.
pub fn verdict(command: &str, result: &Value) -> (&'static str, String) {
    let empty = Map::new();
    let map = result.as_object().unwrap_or(&empty);
    let get = |key: &str| number(map, key).unwrap_or(f64::NAN);
    let stated = map.get("verdict").and_then(Value::as_str).unwrap_or("");
    if command == "batch" {
        let word = match () {
            () if get("failed") + get("fail") > 0.0 => "fail",
            () if get("undecided") > 0.0 => "undecided",
            () if get("pass") > 0.0 => "pass",
            () => "measured",
        };
        return (
            word,
            format!(
                "{} of {} pictures measured; {} pass, {} fail, {} undecided, {} not measurable.",
                get("measured"),
                get("pictures"),
                get("pass"),
                get("fail"),
                get("undecided"),
                get("failed")
            ),
        );
    }
    if command == "burn" && !stated.is_empty() {
        let of = format!(
            "The centres are {:.4} mm ± {:.4} mm apart; the limit is {} mm.",
            get("distance_mm"),
            get("distance_u95_mm"),
            get("tolerance_mm")
        );
        return (class(stated), of);
    }
    let sentence = match (command, stated) {
        ("solve", "pass") => "Every limit of the method that was checked is kept.".into(),
        ("solve", "fail") => "A limit of the method is broken: do not enter these values.".into(),
        ("solve", "undecided") => "A limit of the method lies inside the uncertainty.".into(),
        ("solve", "") => "No limit of the method was checked.".into(),
        ("diagnose", "consistent") => "The model explains the data: nothing is missing.".into(),
        ("diagnose", "named") => "All of the gap is explained by named effects.".into(),
        ("diagnose", "partly") => "Named effects were found, and more remains.".into(),
        ("diagnose", "unknown") => "Something is missing that is not in the library.".into(),
        (_, "pass") => "Within its limit, with certainty.".into(),
        (_, "fail") => "Outside its limit, with certainty.".into(),
        (_, "undecided") => "The limit lies inside the uncertainty.".into(),
        (_, "") => "No limit applies.".into(),
        (_, other) => format!("Verdict: {other}."),
    };
    (class(stated), sentence)
}

fn class(verdict: &str) -> &'static str {
    match verdict {
        "pass" | "consistent" => "pass",
        "fail" | "unknown" => "fail",
        "undecided" | "partly" => "undecided",
        _ => "measured",
    }
}

/// What to do next, a step a line.
pub fn next(command: &str, result: &Value) -> Vec<String> {
    let empty = Map::new();
    let map = result.as_object().unwrap_or(&empty);
    let get = |key: &str| number(map, key);
    let stated = map.get("verdict").and_then(Value::as_str).unwrap_or("");
    match (command, stated) {
        ("burn", "pass") => vec!["Nothing to correct. Repeat after a collision, a nozzle change or a change of the head.".into()],
        ("burn", _) => {
            let mut steps = Vec::new();
            if stated == "undecided" {
                steps.push(format!(
                    "Burn and photograph again: the uncertainty of {:.4} mm is too large to decide. Sharper light, a cleaner plate or several burns lower it.",
                    get("distance_u95_mm").unwrap_or(f64::NAN)
                ));
            }
            if let Some(b) = get("correction.b_deg") {
                steps.push(format!("Turn B by {b:+.4}° (corrects X)."));
            }
            match (get("correction.shim_mm"), get("correction.shim_deg")) {
                (Some(mm), _) => steps.push(format!("Shim the head's flange by {mm:+.4} mm (corrects Y).")),
                (None, Some(deg)) => steps.push(format!("Tilt the head's flange by {deg:+.4}° with shims (corrects Y); --flange-mm gives the thickness.")),
                _ => {}
            }
            steps.push("Burn again and measure: the offset must be gone.".into());
            steps
        }
        ("rod", _) => vec!["Give this file to the session file's [rod] result and run pivotsight solve.".into()],
        ("solve", _) if verdict(command, result).0 == "fail" => vec!["Find the reading that is wrong (sign, side, diameter), touch again, and solve again.".into()],
        ("solve", _) => vec!["Export the vectors with pivotsight export, enter them, and check with pivotsight verify.".into()],
        ("verify", "fail") => vec![
            "Find what the model lacks: pivotsight diagnose rtcp with the same machine file and data.".into(),
            "Correct it, enter the values, and measure the sweep again.".into(),
        ],
        ("verify", "undecided") => vec!["Measure the sweep again with less noise: average several readings a pose, or say with --noise-mm how good they are.".into()],
        ("verify", "pass") => vec!["Nothing to correct. Keep the sweep as the machine's reference (--records FILE).".into()],
        ("diagnose", _) => match map.get("next_measurement").and_then(|next| next.get("text")) {
            Some(Value::String(text)) => vec![text.clone()],
            _ => vec!["Correct the strongest named effect, measure again, and compare with the predicted gap.".into()],
        },
        ("batch", _) => {
            let mut steps = vec!["The rows are in results.csv.".to_owned()];
            if let Some(n) = get("failed").filter(|n| *n > 0.0) {
                steps.push(format!("Not measurable: {n}. Read the reasons, capture these again, then batch --resume --retry-failed."));
            }
            if let Some(n) = get("fail").filter(|n| *n > 0.0) {
                steps.push(format!("Out of limits: {n}. Correct what they show."));
            }
            if let Some(n) = get("undecided").filter(|n| *n > 0.0) {
                steps.push(format!("Undecided: {n}. Measure these again with less uncertainty."));
            }
            steps
        }
        (_, "pass" | "consistent") => vec!["Nothing to correct.".into()],
        (_, "fail") => vec!["Correct what is out of tolerance, then measure again.".into()],
        (_, "undecided") => vec!["Measure again with less uncertainty: more points, more runs, better light.".into()],
        _ => vec!["Keep this result with the machine's records (--records FILE) and compare it with the next one.".into()],
    }
}
