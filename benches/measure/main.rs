//! What measuring costs, in copies of the frame, beside OpenCV on the same 12-megapixel pictures:
//! `cargo bench --bench measure [--features opencv]`; growth with pixels and edge length, as a picture:
//! `cargo bench --bench measure -- growth docs/growth.svg`.

#[path = "../../examples/accuracy/decoded.rs"]
mod decoded;
mod growth;
mod memory;
mod opencv;
mod work;

use rayon::prelude::*;
use work::{BURNS, Burn, Rod, frame_copy_ms, median_ms, one_thread};

use pivotsight::error::Result;
use pivotsight::frame::Picture;
use pivotsight::measure::{burn, circles};

fn main() -> Result<()> {
    // `cargo bench` adds a word of its own.
    let words: Vec<String> = std::env::args().skip(1).filter(|w| w != "--bench").collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["growth", path] => growth::plot(path),
        ["peak", ..] => memory::peak(&words[1..]),
        _ => tables(),
    }
}

fn tables() -> Result<()> {
    let burns = (0..BURNS).map(Burn::render).collect::<Result<Vec<_>>>()?;
    let copy_ms = frame_copy_ms(&burns[0].picture()?);
    println!(
        "4000×3000 px, 8 bits, one thread, medians; errors of the offset of {BURNS} burns of the typical preset\n"
    );
    println!("| | ms | copies of the frame | median µm | worst | answered |");
    println!("|---|---|---|---|---|---|");
    let cost = |name: &str, ms: f64| println!("| {name} | {ms:.1} | {:.1} | | | |", ms / copy_ms);
    cost("copy the frame", copy_ms);
    cost("decode PNG", one_thread(|| median_ms(5, || drop(burns[0].picture()))));
    row("`burn`", copy_ms, &burns, |b, picture| {
        let options = burn::Options::default();
        let report = burn::measure(picture, &b.calibration, &options, "bench").ok()?.report;
        Some((nalgebra::Vector2::from(report.offset.offset_mm) - b.offset_mm).norm())
    })?;
    row("`circles`, two", copy_ms, &burns, |b, picture| {
        let options = circles::Options {
            expect_mm: b.circles.iter().map(|c| 2.0 * c.radius).collect(),
            channel: Default::default(),
        };
        let report = circles::measure(picture, &b.calibration, &options, "bench").ok()?.report;
        Some((nalgebra::Vector2::from(report.pairs[0].offset_mm) - b.offset_mm).norm())
    })?;
    match pivotsight::cv::one_thread() {
        Ok(()) => {
            row(
                "OpenCV: blur, Canny, contours, ellipses, told where",
                copy_ms,
                &burns,
                opencv::contours,
            )?;
            row("OpenCV: blur, HoughCircles, radii known to 10 %", copy_ms, &burns, opencv::hough)?;
        }
        Err(e) => println!("\nwithout OpenCV: {e}"),
    }
    let rod = Rod::render()?;
    let ms = one_thread(|| median_ms(3, || rod.measure())) / rod.captures.len() as f64;
    cost("`rod`, a capture", ms);
    throughput(&burns);
    memory::table(&burns)
}

/// One way of measuring: what it costs, and how far it is off.
fn row(
    name: &str,
    copy_ms: f64,
    burns: &[Burn],
    job: impl Fn(&Burn, &Picture) -> Option<f64> + Sync,
) -> Result<()> {
    let (mut times, mut errors) = (Vec::new(), Vec::new());
    for b in burns {
        let picture = b.picture()?;
        times.push(one_thread(|| median_ms(3, || job(b, &picture))));
        errors.extend(one_thread(|| job(b, &picture)).map(|mm| 1e3 * mm));
    }
    times.sort_by(f64::total_cmp);
    errors.sort_by(f64::total_cmp);
    let ms = times[times.len() / 2];
    let error = |i: usize| errors.get(i).map_or("-".to_owned(), |e| format!("{e:.2}"));
    println!(
        "| {name} | {ms:.1} | {:.1} | {} | {} | {} of {} |",
        ms / copy_ms,
        error(errors.len() / 2),
        error(errors.len().saturating_sub(1)),
        errors.len(),
        burns.len()
    );
    Ok(())
}

/// A folder on all cores: decoding alone, and with measuring.
fn throughput(burns: &[Burn]) {
    let list: Vec<&Burn> = burns.iter().cycle().take(12).collect();
    let decode = median_ms(3, || list.par_iter().for_each(|b| drop(b.picture())));
    let both = median_ms(3, || {
        list.par_iter().for_each(|b| {
            let options = burn::Options::default();
            let measured =
                b.picture().and_then(|p| burn::measure(&p, &b.calibration, &options, "bench"));
            std::hint::black_box(measured).ok();
        });
    });
    println!(
        "\na folder of 12 such PNGs on {} threads: decoding {decode:.0} ms, decoding and measuring {both:.0} ms: {:.0} % of the throughput",
        rayon::current_num_threads(),
        100.0 * decode / both
    );
}
