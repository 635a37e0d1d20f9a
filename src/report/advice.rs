//! The verdict in a sentence, and what to do next.

use serde_json::{Map, Value};

use super::{ballbar, history, thermal};
use crate::batch::limits::number;
use crate::measure::offset::Correction;
use crate::uncertainty::text;

/// The verdict's word (`pass`, `fail`, `undecided`, `measured` where no limit applies, `computed` where nothing was to be measured, or
/// `not measured` where a picture was refused) and a sentence.
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
    if command == "history" {
        return history::verdict(result);
    }
    if let Some(reason) = refused(map) {
        return (REFUSED, reason.to_owned());
    }
    if command == "ballbar-decouple" {
        return ("measured", ballbar::sentence(result));
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
    if command == "machine" {
        return ("computed", "The file describes a machine to compute with.".into());
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
        ("center", "undecided") => {
            "The uncertainty that was asked for is not reached, or the limit lies inside it.".into()
        }
        (_, "undecided") => "The limit lies inside the uncertainty.".into(),
        (_, "") => "No limit applies.".into(),
        (_, other) => format!("Verdict: {other}."),
    };
    (class(stated), sentence)
}

/// The verdict's word where there is no result.
const REFUSED: &str = "not measured";

/// Why a picture of several gave no result.
fn refused(map: &Map<String, Value>) -> Option<&str> {
    map.get("error").and_then(Value::as_str)
}

/// The class of a verdict's word in the page's style.
pub fn class(verdict: &str) -> &'static str {
    match verdict {
        "pass" | "consistent" => "pass",
        "fail" | "unknown" => "fail",
        "undecided" | "partly" => "undecided",
        _ => "measured",
    }
}

/// What turns the head straight, or that it needs no turn.
fn turns(c: &Correction) -> [String; 2] {
    let b = match c.b_way() {
        Some(way) => format!(
            "Turn B by {}° about Y: the nozzle has to swing towards {way} (corrects X).",
            text(c.b_deg, c.b_u95_deg)
        ),
        None => "Leave B: the offset in X is within its uncertainty.".into(),
    };
    let shim = match (c.shim_way(), c.shim_mm.zip(c.shim_u95_mm)) {
        (None, _) => "Leave the head's flange: the offset in Y is within its uncertainty.".into(),
        (Some(way), Some((mm, u95))) => format!(
            "Turn the head about X with shims of {} mm under its flange: the nozzle has to swing towards {way} (corrects Y).",
            text(mm.abs(), u95)
        ),
        (Some(way), None) => format!(
            "Turn the head about X by {}° with shims under its flange: the nozzle has to swing towards {way} (corrects Y); --flange-mm gives their thickness.",
            text(c.shim_deg.abs(), c.shim_u95_deg)
        ),
    };
    [b, shim]
}

/// What to do next, a step a line.
pub fn next(command: &str, result: &Value) -> Vec<String> {
    let empty = Map::new();
    let map = result.as_object().unwrap_or(&empty);
    let get = |key: &str| number(map, key);
    let stated = map.get("verdict").and_then(Value::as_str).unwrap_or("");
    if refused(map).is_some() {
        return vec!["Do what the reason says, and capture this one again.".into()];
    }
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
            let correction = map.get("correction").cloned();
            let correction = correction.and_then(|c| serde_json::from_value::<Correction>(c).ok());
            steps.extend(correction.iter().flat_map(turns));
            steps.push("Burn again and measure: the offset must be gone.".into());
            steps
        }
        ("rod", _) => vec!["Give this file to the session file's [rod] result and run pivotsight solve.".into()],
        ("solve", _) if verdict(command, result).0 == "fail" => vec!["Find the reading that is wrong (sign, side, diameter), touch again, and solve again.".into()],
        ("solve", _) => vec!["Export the vectors with pivotsight export, enter them, and check with pivotsight verify.".into()],
        ("verify", "fail") => {
            // What is missing is missing from the values that the control held during the sweep.
            let input = |key: &str| map.get("input")?.get(key)?.as_str();
            let model = input("now").or(input("machine")).unwrap_or("FILE");
            let data = input("data").unwrap_or("CSV");
            vec![
                format!("Find what the model lacks: pivotsight diagnose rtcp --model {model} --data {data} --write-model NEW.toml (the model is the file whose values the control held)."),
                "Correct it, enter the values of NEW.toml, and measure the sweep again.".into(),
            ]
        }
        ("verify", "undecided") => vec!["Measure the sweep again with less noise: average several readings a pose, or say with --noise-mm how good they are.".into()],
        ("verify", "pass") => vec!["Nothing to correct. Keep the sweep as the machine's reference (--records FILE).".into()],
        ("diagnose", stated) => match (map.get("next_measurement").and_then(|next| next.get("text")), stated) {
            (Some(Value::String(text)), _) => vec![text.clone()],
            (_, "consistent") => vec!["Nothing to correct: what is left is noise. Keep the result with the machine's records (--records FILE).".into()],
            (_, "unknown") => vec!["Nothing to enter: no effect of the library explains the gap. Measure again to see whether it repeats, and look for a cause that follows what it depends on; an own effect (--effects FILE) can then be tested.".into()],
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
        ("history", _) => {
            let drifts = map.get("drift").and_then(Value::as_array).is_some_and(|d| !d.is_empty());
            vec![if drifts {
                "Measure what changed again; where it stays so, look for the cause, and measure the machine anew.".into()
            } else {
                "Go on keeping results here (--records FILE): the more there are, the smaller a change that shows.".into()
            }]
        }
        ("align", "" | "pass") => vec!["Move the program onto the blank: pivotsight align apply --align FILE --machine MACHINE.toml IN OUT, with this result as FILE.".into()],
        ("rotary", "" | "fail" | "undecided") => vec!["Enter the new table (comp new) and run the sweep again: what is left must lie within its predicted U. A deviation that has grown twofold says that the readings' sign is turned round.".into()],
        ("machine", _) => vec!["Plan a sweep that shows whether the machine is so: pivotsight verify --machine FILE --plan DIR --control NAME.".into()],
        ("ballbar-decouple", _) => ballbar::next(result),
        ("thermal-fit", _) => thermal::next(),
        ("center", stated) if stated != "pass" => {
            let by = |k: usize| {
                let of = |key: &str| get(&format!("{key}.{k}")).unwrap_or(f64::NAN);
                text(of("move_mm"), of("offset_u95_mm"))
            };
            vec![format!("Move X by {} mm and Y by {} mm, then center again.", by(0), by(1))]
        }
        (_, "pass" | "consistent") => vec!["Nothing to correct.".into()],
        (_, "fail") => vec!["Correct what is out of tolerance, then measure again.".into()],
        (_, "undecided") => vec!["Measure again with less uncertainty: more points, more runs, better light.".into()],
        _ => vec!["Keep this result with the machine's records (--records FILE) and compare it with the next one.".into()],
    }
}
