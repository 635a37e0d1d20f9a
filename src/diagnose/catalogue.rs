//! The library's effects with all their parameters, whatever data are at hand: what a model file may hold, and `docs/effects.md`.

use std::fmt::Write;

use crate::camera::{Calibration, Mapping};
use crate::diagnose::data::plain::{self, PlainExperiment};
use crate::diagnose::data::rod::{self, RodExperiment};
use crate::diagnose::data::rtcp::{self, RtcpExperiment};
use crate::diagnose::data::spelt;
use crate::diagnose::effects::resolve;
use crate::diagnose::experiment::{EffectInfo, Experiment, Parameter};
use crate::error::{Error, Result};
use crate::machine::{DataKind, Head, Machine, Table as TableOrigin, Target};
use crate::table::Table;

/// The effects of one kind of data.
pub struct Kind {
    /// What the data are.
    pub kind: DataKind,
    /// Its library.
    pub effects: Vec<EffectInfo>,
}

/// The library of every kind of data, as plans that have all columns show it.
pub fn catalogue() -> Result<Vec<Kind>> {
    let machine = Machine {
        target: Some(Target { position_mm: [80.0, 0.0, 100.0] }),
        ..Machine::head_b_table_c(
            Head { delta_x_mm: 0.3, r_mm: 215.0, standoff_mm: 1.0 },
            TableOrigin::default(),
        )
    };
    let table = |name: &str, columns: (&[&str], &[&str]), csv: String| {
        Table::parse(name, csv, columns.0, columns.1)
    };
    let said = &mut Vec::new();
    let rtcp = table("rtcp", rtcp::COLUMNS, sweep())?;
    let rtcp = RtcpExperiment::from_table(&rtcp, &machine, said)?;
    let rod = table("rod", rod::COLUMNS, rim())?;
    let mapping = Mapping::Scale { mm_per_px: 0.01, rotation_deg: 0.0 };
    let scale = Calibration { name: String::new(), mapping, laser: None, gamma: 1.0 };
    let rod = RodExperiment::from_table(&rod, &scale, Some(&machine), said)?;
    let bar = table("ballbar", plain::BALLBAR_COLUMNS, bar())?;
    let bar = PlainExperiment::ballbar_table(&bar, &machine, said)?;
    let warm = table("thermal", plain::THERMAL_COLUMNS, warm())?;
    let warm = PlainExperiment::thermal_table(&warm, &machine, said)?;
    let burns = table("burn", plain::BURN_COLUMNS, burns())?;
    let burns = PlainExperiment::burn_table(&burns, &machine, said)?;
    let all: [&dyn Experiment; 5] = [&rtcp, &rod, &bar, &warm, &burns];
    Ok(all.map(|e| Kind { kind: e.kind(), effects: e.effects().to_vec() }).into())
}

/// Refuses what a machine file's effects cannot be: a misspelt name, a parameter that no form of the effect has.
pub fn check(machine: &Machine) -> Result<()> {
    if machine.effects.is_empty() {
        return Ok(());
    }
    let kinds = catalogue()?;
    for effect in &machine.effects {
        spelt(effect)?;
        // Those of the head's sensors are called after the sensors at hand.
        let known =
            kinds.iter().filter(|kind| kind.kind != DataKind::Thermal && effect.outputs.is_empty());
        let mut resolved = known
            .filter(|kind| kind.effects.iter().any(|info| info.name == effect.name))
            .map(|kind| resolve(&kind.effects, &effect.name, &effect.parameters))
            .collect::<Vec<_>>()
            .into_iter();
        let first = resolved.next();
        if let Some(Err(reason)) = first
            && !resolved.any(|other| other.is_ok())
        {
            return Err(Error::measure(
                format!("effects '{}'", effect.name),
                reason,
                "correct its parameters (docs/effects.md)",
            ));
        }
    }
    Ok(())
}

/// The page `docs/effects.md`.
pub fn markdown() -> Result<String> {
    let mut page = String::from(
        "# Effects by name\n\n\
         What `diagnose` knows by name and a machine file may hold as `[[effects]]` ([machine.md](machine.md)), by kind of data. Each set of parameters is\n\
         a form of the effect: give all of one set. Units are in the names; `x = 1` marks a switch. Made by\n\
         `PIVOTSIGHT_WRITE=1 cargo test --test diagnose_data the_page_of_effects`.\n",
    );
    for kind in catalogue()? {
        let _ = write!(
            page,
            "\n## {}\n\n| effect | what is wrong | parameters | seen best |\n|---|---|---|---|\n",
            kind.kind.name()
        );
        for effect in kind.effects {
            let mut sets: Vec<String> = Vec::new();
            for form in &effect.forms {
                let set = form.iter().map(Parameter::written).collect::<Vec<_>>().join(", ");
                let set = format!("`{set}`");
                if !sets.contains(&set) {
                    sets.push(set);
                }
            }
            let _ = writeln!(
                page,
                "| `{}` | {} | {} | {} |",
                effect.name,
                effect.meaning,
                sets.join("<br>"),
                effect.best
            );
        }
    }
    Ok(page)
}

/// Numbers that look irregular and are always the same, 0 to 1.
fn irregular(i: usize) -> f64 {
    (0.5 + 0.618_033_988_749_895 * i as f64).fract()
}

fn side(i: usize) -> i32 {
    if irregular(i) < 0.5 { 1 } else { -1 }
}

fn temperature(t_s: usize) -> f64 {
    20.0 + 5.0 * (1.0 - (-(t_s as f64) / 2000.0).exp()) + irregular(t_s)
}

fn sweep() -> String {
    let mut csv = String::from("b_deg,c_deg,dir_b,dir_c,t_s,temp_c\n");
    for i in 0..156 {
        let at = i * 37 % 156;
        let (b, c) =
            ((at / 12) as f64 * 15.0 - 90.0, (at % 12) as f64 * 30.0 + 9.0 * irregular(at));
        let t = 30 * i;
        let (db, dc) = (side(3 * i), side(5 * i + 1));
        let _ = writeln!(csv, "{b},{c},{db},{dc},{t},{}", temperature(t));
    }
    csv
}

fn rim() -> String {
    let mut csv = String::from("capture,x_mm,y_mm,c_deg,t_s,temp_c,dir_x,dir_y,u_px,v_px\n");
    for k in 0..40 {
        let c = 9 * (k * 13 % 40);
        let place = [2.0 * irregular(7 * k) - 1.0, 2.0 * irregular(11 * k) - 1.0];
        let (t, dx, dy) = (30 * k, side(3 * k), side(5 * k + 1));
        for p in 0..12 {
            let (sin, cos) = (std::f64::consts::TAU * p as f64 / 12.0).sin_cos();
            let (u, v) =
                ((2.0 * cos - place[0]) / 0.01 + 799.5, 599.5 - (2.0 * sin - place[1]) / 0.01);
            let [x, y] = place;
            let _ = writeln!(csv, "{k},{x},{y},{c},{t},{},{dx},{dy},{u},{v}", temperature(t));
        }
    }
    csv
}

fn bar() -> String {
    let mut csv = String::from("b_deg,length_mm,z_mm,path,dir,t_s,temp_c\n");
    for (run, dir) in [1, -1, 1, -1].into_iter().enumerate() {
        let path = if run < 2 { "zb" } else { "zb-y150" };
        for i in 0..=120 {
            let at = if dir > 0 { i } else { 120 - i };
            let b = -0.5 * at as f64;
            let z = 430.0 * (1.0 - b.to_radians().cos());
            let length = if run < 2 { 400.0 } else { 400.0f64.hypot(150.0) };
            let t = 20 * (121 * run + i);
            let _ = writeln!(csv, "{b},{length},{z},{path},{dir},{t},{}", temperature(t));
        }
    }
    csv
}

fn warm() -> String {
    let mut csv = String::from(
        "t_s,axis,position_mm,screw_c,head_1_c,head_2_c,head_3_c,ambient_c,error_mm\n",
    );
    for i in 0..120 {
        let t = 120 * i;
        let axis = if i % 2 == 0 { "x" } else { "y" };
        let position = 100.0 * ((i / 2) % 9) as f64;
        let [a, b, c] = [2.0, 3.0, 5.0].map(|k| k * irregular(7 * i) + 0.01 * i as f64);
        let _ = writeln!(
            csv,
            "{t},{axis},{position},{},{a},{b},{c},{},0",
            temperature(t),
            20.0 + irregular(i)
        );
    }
    csv
}

fn burns() -> String {
    let mut csv = String::from("height_mm,power_w,b_deg,t_s,temp_c\n");
    for i in 0..60 {
        let t = 300 * i;
        let height = 5.0 + 45.0 * irregular(3 * i);
        let power = [100, 200, 300, 500][i % 4];
        let b = [-60, -30, 0, 30, 60][i / 2 % 5];
        let _ = writeln!(csv, "{height},{power},{b},{t},{}", temperature(t));
    }
    csv
}
